"""What happened in a run: poses, velocities, phases, events, streamed to disk and read back lazily.

`Recording` reads; `RecordingWriter` writes; `layout` says how it lies on disk, `manifest` what it says of itself.

Frame k is at time k / frame_rate; frame 0 is the start pose. Arrays have one row a frame. A pose is seven numbers,
x y z in metres and a quaternion qx qy qz qw, of a link's frame in the world.
"""

from echelon.recording.branch import branch
from echelon.recording.layout import EVENT_DTYPE, estimate_bytes
from echelon.recording.manifest import (
    EVENT_NAMES,
    PHASE_NAMES,
    REMOVED_PHASE,
    Actor,
    Cast,
    RecordingFailed,
    is_recording,
)
from echelon.recording.place import check_place
from echelon.recording.reader import LazyFrames, LazyPoses, Recording
from echelon.recording.writer import RecordingWriter

__all__ = [
    "EVENT_DTYPE",
    "EVENT_NAMES",
    "PHASE_NAMES",
    "REMOVED_PHASE",
    "Actor",
    "Cast",
    "LazyFrames",
    "LazyPoses",
    "Recording",
    "RecordingFailed",
    "RecordingWriter",
    "branch",
    "check_place",
    "estimate_bytes",
    "is_recording",
]
