"""What moved: the poses of a recording as whole arrays, cast by cast, in the forms a stage wants them.

Quaternions are (x, y, z, w) everywhere, which is also the order of `Gf.Quatf` in memory. Along the frames of one link
a quaternion never changes its sign: tools that interpolate the four numbers one by one then stay on the short way.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pxr import Tf

from echelon.errors import InputError
from echelon.export.removed import removed_agents
from echelon.export.stage.time_samples import WHOLE, Timing
from echelon.recording import Cast, Recording
from echelon.warp_kernels.model import Model

# A recording keeps float32 poses near a floating origin, good to some 1e-7 m and rad. A joint that has moved by less
# than this in a whole run has not moved.
STILL_TOLERANCE = 1e-5
FAST_TURN = 1.0  # [rad] in a frame, from which on two frames are not seen as one turn


@dataclass(frozen=True)
class CastMotion:
    """How the agents of one cast moved, all links in the world.

    Attributes:
        name: Name of the cast, as a prim can carry it.
        body: Their body.
        ids: Index of each agent in the recording, int32,            [agents]
        colors: Linear RGB of each individual, float32,              [agents, 3]
        positions: Origins of the link frames [m], float64,          [frames, agents, links, 3]
        orientations: Unit quaternions, sign-continuous, float64,    [frames, agents, links, 4]
        velocities: Of the first link's origin [m/s], float32,       [frames, agents, 3]
        phases: Controller phase, index of its name, int32,          [frames, agents]
        fallen: One while fallen, else zero, int32,                  [frames, agents]
        removed: Whether it has been taken away, bool,               [frames, agents]
        timing: How frames become time samples.
        beside: Frames at the beginning and at the end that are there for the sake of rates only.
        clip_by_clip: These are not all frames of the run, and others are written elsewhere in the same stage.
    """

    name: str
    body: Model
    ids: np.ndarray
    colors: np.ndarray
    positions: np.ndarray
    orientations: np.ndarray
    velocities: np.ndarray
    phases: np.ndarray
    fallen: np.ndarray
    removed: np.ndarray
    timing: Timing = WHOLE
    beside: tuple[int, int] = (0, 0)
    clip_by_clip: bool = False

    @property
    def frame_count(self) -> int:
        return self.positions.shape[0]

    @property
    def agent_count(self) -> int:
        return self.positions.shape[1]

    @property
    def agent_names(self) -> tuple[str, ...]:
        """A prim name for each agent: the cast's and the agent's index in the recording, so that they sort."""
        width = max(3, len(str(int(self.ids[-1])))) if len(self.ids) else 3
        return tuple(f"{self.name}_{index:0{width}d}" for index in self.ids.tolist())


def shown(motion: CastMotion) -> CastMotion:
    """The motion without the frames that are there for the sake of rates only."""
    kept = shown_frames(motion)
    return replace(
        motion,
        beside=(0, 0),
        **{name: getattr(motion, name)[kept] for name in _FRAME_ARRAYS},
    )


def shown_frames(motion: CastMotion) -> slice:
    """Which of a motion's frames are not there for the sake of rates only."""
    before, after = motion.beside
    return slice(before, motion.frame_count - after)


def present(motion: CastMotion, frame: int) -> CastMotion:
    """The motion of those who have not been taken away by a frame of it."""
    there = ~motion.removed[frame]
    if there.all():
        return motion
    arrays = {name: getattr(motion, name)[:, there] for name in _FRAME_ARRAYS}
    return replace(motion, ids=motion.ids[there], colors=motion.colors[there], **arrays)


_FRAME_ARRAYS = ("positions", "orientations", "velocities", "phases", "fallen", "removed")


def read_motion(recording: Recording, frames: slice = slice(None)) -> tuple[CastMotion, ...]:
    """The motion of every cast, or some frames of it; raises InputError where there is none or a pose is not finite."""
    if recording.frame_count < 1:
        raise InputError(f"{recording.path}: the recording has no frames yet")
    return tuple(_cast_motion(recording, cast, frames) for cast in recording.casts)


def local_transforms(motion: CastMotion) -> tuple[np.ndarray, np.ndarray]:
    """Links relative to their parents (roots relative to the world), joints that do not move held exactly.

    Returns:
        Translations [m], float64 [frames, agents, links, 3], and sign-continuous unit quaternions, float64
        [frames, agents, links, 4].
    """
    translations = motion.positions.copy()
    rotations = motion.orientations.copy()
    for index, link in enumerate(motion.body.links):
        parent = motion.body.parents[index]
        if parent < 0:
            continue
        inverse = conjugate(motion.orientations[:, :, parent])
        offset = motion.positions[:, :, index] - motion.positions[:, :, parent]
        translations[:, :, index] = rotated(inverse, offset)
        rotations[:, :, index] = continuous(product(inverse, motion.orientations[:, :, index]))
        joint = np.asarray(link.joint.position)
        still = np.abs(translations[:, :, index] - joint).max(axis=(0, 2)) < STILL_TOLERANCE
        translations[:, still, index] = joint
        unturned = np.abs(rotations[:, :, index, :3]).max(axis=(0, 2)) < STILL_TOLERANCE
        rotations[:, unturned, index] = (0.0, 0.0, 0.0, 1.0)
    return translations, rotations


# ---- rates -------------------------------------------------------------------------------------------------------
def rates(values: np.ndarray, frame_rate: int) -> np.ndarray:
    """Rate of change along the frames, by central differences, one-sided at both ends; same shape, per second."""
    if len(values) < 2:
        return np.zeros_like(values)
    return np.gradient(values, axis=0) * frame_rate


def angular_velocities(orientations: np.ndarray, frame_rate: int) -> np.ndarray:
    """Angular velocities in the outer frame [rad/s], shape [frames, ..., 3], from quaternions [frames, ..., 4]."""
    frames = len(orientations)
    before = np.maximum(np.arange(frames) - 1, 0)
    after = np.minimum(np.arange(frames) + 1, frames - 1)
    turn = rotation_vectors(product(orientations[after], conjugate(orientations[before])))
    # A wheel may turn by more than half a turn in two frames, which would look like turning back.
    step = rotation_vectors(product(orientations[1:], conjugate(orientations[:-1])))
    fast = np.linalg.norm(step, axis=-1, keepdims=True) > FAST_TURN
    if fast.any():
        backward = np.concatenate([np.zeros_like(turn[:1]), step])
        forward = np.concatenate([step, np.zeros_like(turn[:1])])
        turn = np.where(fast[before.clip(max=frames - 2)] | fast[after - 1], backward + forward, turn)
    span = np.maximum(after - before, 1) / frame_rate
    return turn / span.reshape(-1, *([1] * (turn.ndim - 1)))


# ---- quaternions (x, y, z, w), any leading shape -----------------------------------------------------------------
def conjugate(q: np.ndarray) -> np.ndarray:
    """Inverse of unit quaternions."""
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rotation b followed by a."""
    av, aw, bv, bw = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    vector = aw * bv + bw * av + np.cross(av, bv)
    return np.concatenate([vector, aw * bw - np.sum(av * bv, axis=-1, keepdims=True)], axis=-1)


def rotated(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors [..., 3] turned by unit quaternions [..., 4]."""
    twice = 2.0 * np.cross(q[..., :3], v)
    return v + q[..., 3:] * twice + np.cross(q[..., :3], twice)


def rotation_vectors(q: np.ndarray) -> np.ndarray:
    """Axis times angle [rad], the short way round, of unit quaternions."""
    q = np.where(q[..., 3:] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., 3:])
    return q[..., :3] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)


def continuous(q: np.ndarray) -> np.ndarray:
    """The same rotations with the sign of the frame before; frames are the first axis."""
    dots = np.sum(q[1:] * q[:-1], axis=-1, keepdims=True)
    signs = np.cumprod(np.where(dots < 0.0, -1.0, 1.0), axis=0)
    return np.concatenate([q[:1], q[1:] * signs])


# ---- names and reading -------------------------------------------------------------------------------------------
def prim_name(name: str) -> str:
    """A name that a prim can carry: letters, digits and underscores, no digit in front."""
    return Tf.MakeValidIdentifier(f"_{name}" if name[:1].isdigit() else name)


def prim_names(names: Sequence[str]) -> tuple[str, ...]:
    """Names that prims side by side can carry: those that would be the same get a number."""
    found: list[str] = []
    for name in names:
        plain, candidate, count = prim_name(name), prim_name(name), 1
        while candidate in found:
            count += 1
            candidate = f"{plain}_{count}"
        found.append(candidate)
    return tuple(found)


def _cast_motion(recording: Recording, cast: Cast, frames: slice) -> CastMotion:
    agents = slice(cast.first_agent, cast.first_agent + cast.agent_count)
    links = len(cast.body.links)
    poses = np.asarray(recording.link_poses[frames, agents], dtype=np.float64)[:, :, :links]
    if not np.all(np.isfinite(poses)):
        frame, agent = np.argwhere(~np.isfinite(poses).all(axis=(2, 3)))[0] + (frames.start or 0, 0)
        raise InputError(
            f"{recording.path}: link_poses of agent {cast.first_agent + agent} at frame {frame} are not finite numbers"
        )
    orientations = poses[..., 3:] / np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    return CastMotion(
        name=prim_name(cast.name),
        body=cast.body,
        ids=np.arange(agents.start, agents.stop, dtype=np.int32),
        colors=np.asarray(cast.colors, dtype=np.float32).reshape(-1, 3),
        positions=poses[..., :3],
        orientations=continuous(orientations),
        velocities=np.asarray(recording.velocities[frames, agents], dtype=np.float32),
        phases=np.asarray(recording.phases[frames, agents], dtype=np.int32),
        fallen=np.asarray(recording.fallen[frames, agents], dtype=np.int32),
        removed=removed_agents(recording, frames)[:, agents],
    )
