"""A recording as one page to send to somebody: it opens from a file, without a server, and moves.

The page is viser's own client with everything that it would have been sent, in the order and at the times. Poses are
most of it: they are rounded, because numbers whose last digits are noise do not compress.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from echelon.errors import InputError
from echelon.export.picture_files import checked_path, replacing
from echelon.play.drawing.cameras import overview
from echelon.play.drawing.quiet_server import close_server, open_server
from echelon.play.drawing.view import View
from echelon.recording import Recording

FRAMES_PER_SECOND = 15
POSITION_BITS = 10  # of a metre: a millimetre
TURN_BITS = 11  # of a quaternion's parts: 0.03 degrees

Progress = Callable[[int, int], None]


def save_page(
    recording: Recording,
    path: str | Path,
    *,
    first: int = 0,
    last: int | None = None,
    frames_per_second: int = FRAMES_PER_SECOND,
    progress: Progress | None = None,
) -> Path:
    """Write a self-contained page that shows a recording, over and over, with a timeline.

    Args:
        recording: What it shows.
        path: Of the page, .html; it is written beside and renamed.
        first, last: Frames, the last one left out; None for all there are.
        frames_per_second: Of the page; the recording's frames are thinned to about as many.
        progress: Called with how many of the page's frames are done, and how many there are.

    Returns:
        The path.

    Raises:
        InputError: The recording has no frames, or none in the range; the path cannot be written or does not end in
            .html; the rate is not positive.
    """
    path = checked_path(path, (".html",))
    frames = _frames(recording, first, last, frames_per_second)
    step = int(frames[1] - frames[0]) if len(frames) > 1 else 1
    server = open_server()
    try:
        view = View(
            server,
            casts=recording.casts,
            actors=recording.actors,
            world=recording.world,
            frame_rate=recording.frame_rate,
        )
        serializer = None
        for done, number in enumerate(frames.tolist()):
            links, actors = (_rounded(array[number]) for array in (recording.link_poses, recording.actor_poses))
            removed = np.asarray(recording.removed[number])
            there = np.concatenate([links[~removed, 0, :3], actors[:, :3]])
            # A page's camera belongs to who looks at it and cannot ride along: the world moves instead.
            around = np.median(there, axis=0) if view.is_road else np.zeros(3)
            view.show(links, actors, removed, around)
            if serializer is None:
                shot = overview(there)
                camera = server.initial_camera
                camera.position, camera.look_at, camera.up = shot.eye - around, shot.target - around, shot.up
                camera.fov = shot.field_of_view
                serializer = server.get_scene_serializer()
            serializer.insert_sleep(step / recording.frame_rate)
            if progress is not None:
                progress(done + 1, len(frames))
        page = serializer.as_html() if serializer is not None else ""
    finally:
        close_server(server)
    with replacing(path) as beside:
        beside.write_text(page, encoding="utf-8")
    return path


def _frames(recording: Recording, first: int, last: int | None, frames_per_second: int) -> np.ndarray:
    """Numbers of the frames that are shown."""
    count = recording.frame_count
    if count < 1:
        raise InputError(f"{recording.path}: has no frames yet, so there is nothing to show")
    end = count if last is None else last
    if not 0 <= first < end <= count:
        raise InputError(f"{recording.path}: frames {first} to {end}: must lie from 0 to {count}, the first before it")
    if frames_per_second < 1:
        raise InputError(f"{recording.path}: frames_per_second = {frames_per_second}: must be at least 1")
    return np.arange(first, end, max(1, round(recording.frame_rate / frames_per_second)))


def _rounded(poses: np.ndarray) -> np.ndarray:
    """Poses [..., 7] in as many binary digits as can be seen."""
    places = np.round(poses[..., :3] * 2.0**POSITION_BITS) / 2.0**POSITION_BITS
    turns = np.round(poses[..., 3:] * 2.0**TURN_BITS) / 2.0**TURN_BITS
    return np.concatenate([places, turns], axis=-1)
