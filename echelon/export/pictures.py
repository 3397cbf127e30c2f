"""Films, stills and filmstrips of a run, from its recording or from a stage that was written of it."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from fractions import Fraction
from numbers import Real
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from echelon.errors import InputError
from echelon.export.camera import View
from echelon.export.drawn_bodies import MovingScene
from echelon.export.drawn_road import DrawnRoad
from echelon.export.film import FilmWriter
from echelon.export.picture_files import checked_path, replacing
from echelon.export.picture_source import PictureSource, RecordedSource
from echelon.export.renderer import Renderer
from echelon.export.road_scenery import RoadScenery, Window
from echelon.export.scenery import scenery
from echelon.export.shot_views import Camera, ShotViews
from echelon.recording import Recording

Progress = Callable[[int, int], None]
Source = Recording | str | os.PathLike[str]

FILM_SIZE = (960, 540)  # [pixels]
STILL_SIZE = (1280, 720)  # [pixels]
SNAPSHOT_SIZE = (480, 300)  # [pixels], one of a strip
SIZE_LIMITS = (16, 8192)  # [pixels]
SNAPSHOT_LIMIT = 60
SNAPSHOTS_IN_ROW = 6
DETAIL = 32.0  # [pixels] that a metre measures in the picture, from which on bodies on a road show every detail
GUTTER = 4  # [pixels] between the snapshots of a strip

_FRAMES_AT_ONCE = 64  # read from the recording


# ---- what people call ----------------------------------------------------------------------------------------------
def render_film(
    source: Source,
    path: str | Path,
    *,
    size: tuple[int, int] = FILM_SIZE,
    fps: float | None = None,
    start: float | None = None,
    seconds: float | None = None,
    camera: Camera = "follow",
    progress: Progress | None = None,
) -> Path:
    """Write a film, .mp4.

    Args:
        source: A `Recording`, its path, or the path of a stage that Echelon wrote.
        path: Of the film.
        size: Width and height, even numbers [pixels].
        fps: Pictures a second; None for the recording's frame rate. Each shows the nearest frame.
        start: Time of the first picture [s]; None for the beginning.
        seconds: How long [s]; None for the rest. What reaches beyond the end is left out.
        camera: In a field, "follow" keeps all bodies in the picture, and actors that are near, "side" follows low and
            close from their right, "overview" shows all of it, "corral" the corral. On a road, "follow" rides behind
            the group, "helicopter" flies above it, "roadside" stands beside the road and turns with it, and "overview"
            shows where all ride from one place. Or a `View`.
        progress: Called with (pictures done, pictures to do).

    Raises:
        InputError: A wrong path, size, rate, time or camera, or a source that cannot be read.
        RenderingUnavailable: There is no working OpenGL.
    """
    shot = _Shot(_opened(source), path, (".mp4",), size)
    if any(length % 2 for length in shot.size):
        raise InputError(f"{shot.path}: size {_times(shot.size)} must be two even numbers for a film")
    rate = shot.source.frame_rate
    per_second = Fraction(rate) if fps is None else Fraction(_number(shot.path, "fps", fps, 0.1, 240.0))
    per_second = per_second.limit_denominator(1001)
    first = shot.frame("start", 0.0 if start is None else start)
    left = (shot.source.frame_count - first) / rate
    length = left if seconds is None else min(_number(shot.path, "seconds", seconds, 1.0 / rate, math.inf), left)
    count = max(math.ceil(Fraction(length).limit_denominator(10**6) * per_second), 1)
    frames = [min(round(first + step * rate / per_second), shot.source.frame_count - 1) for step in range(count)]
    with (
        closing(shot.pictures(frames, camera)) as pictures,
        replacing(shot.path) as beside,
        FilmWriter(beside, shot.size, per_second) as film,
    ):
        for done, picture in enumerate(pictures, start=1):
            film.add(picture)
            if progress is not None:
                progress(done, count)
    return shot.path


def render_still(
    source: Source,
    path: str | Path,
    *,
    time: float = 0.0,
    size: tuple[int, int] = STILL_SIZE,
    camera: Camera = "follow",
) -> Path:
    """Write a picture of the frame nearest to `time` [s], .png; arguments and errors as for `render_film`."""
    shot = _Shot(_opened(source), path, (".png",), size)
    (picture,) = list(shot.pictures([shot.frame("time", time)], camera))
    _write_png(shot.path, Image.fromarray(picture))
    return shot.path


def render_strip(
    source: Source,
    path: str | Path,
    *,
    interval: float,
    start: float | None = None,
    count: int | None = None,
    size: tuple[int, int] = SNAPSHOT_SIZE,
    camera: Camera | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write snapshots side by side, .png, each with its time, all from one camera that stands still.

    Where the way from the first to the last is too long to be seen from one place, the camera follows.

    Args:
        source, path: As for `render_film`.
        interval: Time from one snapshot to the next [s].
        start: Time of the first [s]; None for the beginning.
        count: How many; None for as many as there are, five at most. More than six go into several rows.
        size: Of one snapshot, width and height [pixels].
        camera: None or "follow" frames all bodies of all snapshots; otherwise as for `render_film`.
        progress: Called with (snapshots done, snapshots to do).

    Raises:
        InputError, RenderingUnavailable: As for `render_film`; also when the run ends before the last snapshot.
    """
    shot = _Shot(_opened(source), path, (".png",), size)
    interval = _number(shot.path, "interval", interval, 1.0 / shot.source.frame_rate, math.inf)
    begin = shot.frame("start", 0.0 if start is None else start)
    step = interval * shot.source.frame_rate
    available = int((shot.source.frame_count - 1 - begin) / step + 1e-9) + 1
    if count is None:
        count = min(available, 5)
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= min(available, SNAPSHOT_LIMIT):
        raise InputError(
            f"{shot.path}: count is {count!r}, must be from 1 to {min(available, SNAPSHOT_LIMIT)} "
            f"snapshots {interval:g} s apart from {begin / shot.source.frame_rate:g} s on"
        )
    frames = [round(begin + index * step) for index in range(count)]
    chosen = shot.common_view(frames) or "follow" if camera in (None, "follow") else camera
    snapshots = []
    for done, picture in enumerate(shot.pictures(frames, chosen), start=1):
        snapshots.append(_labelled(picture, f"{frames[done - 1] / shot.source.frame_rate:.2f} s"))
        if progress is not None:
            progress(done, count)
    _write_png(shot.path, _side_by_side(snapshots))
    return shot.path


# ---- a shot --------------------------------------------------------------------------------------------------------
class _Shot:
    """A source, a file and a size that have been checked, and the way from frames to pictures."""

    def __init__(
        self, source: PictureSource, path: str | Path, suffixes: tuple[str, ...], size: tuple[int, int]
    ) -> None:
        self.source = source
        self.path = checked_path(path, suffixes)
        self.size = _checked_size(self.path, size)
        self._views = ShotViews(source, self.path, self.size[0] / self.size[1])

    def frame(self, key: str, time: float) -> int:
        """The frame nearest to a time [s]; raises InputError where the run has none."""
        last = (self.source.frame_count - 1) / self.source.frame_rate
        # Half a frame of slack: the last frame is still the nearest.
        _number(self.path, key, time, 0.0, last + 0.5 / self.source.frame_rate, shown_limit=last)
        return min(round(time * self.source.frame_rate), self.source.frame_count - 1)

    def pictures(self, frames: Sequence[int], camera: Camera) -> Generator[np.ndarray]:
        """RGB pictures of frames, in ascending order, as uint8 [height, width, 3]."""
        views = self._views.views(frames, camera)
        moving = MovingScene(self.source.casts, self.source.actors)
        if self.source.world.road is not None:
            return self._on_a_road(self.source.world.road, frames, views, moving)
        return self._in_a_field(frames, views, moving)

    def _in_a_field(self, frames: Sequence[int], views: Sequence[View], moving: MovingScene) -> Generator[np.ndarray]:
        targets = np.array([view.target for view in views])[:, :2]
        low, high = targets.min(axis=0), targets.max(axis=0)
        # Single precision is fine near the action, wherever in the world that is.
        origin = np.round(0.5 * (low + high))
        shift = np.array([origin[0], origin[1], 0.0])
        with Renderer(self.size, scenery(self.source.world, low, high, origin)) as renderer:
            for view, (links, actors, removed) in zip(views, self._poses(frames), strict=True):
                ground = None
                if self.source.world.platform is not None:
                    ground = self.source.world.platform.planes(np.concatenate([links[:, 0, :3], actors[:, :3]]))
                surfaces = moving.surfaces(_moved(links, -shift), _moved(actors, -shift), ground, removed=removed)
                yield renderer.draw(view.moved(-shift), surfaces)

    def _on_a_road(
        self, road: DrawnRoad, frames: Sequence[int], views: Sequence[View], moving: MovingScene
    ) -> Generator[np.ndarray]:
        beside = RoadScenery(road)
        window: Window | None = None
        with Renderer(self.size, []) as renderer:
            for view, (links, actors, removed) in zip(views, self._poses(frames), strict=True):
                cell = beside.cell(view.eye)
                if window is None or cell != window.cell:
                    window = beside.window(cell)
                    renderer.replace_scenery(window.surfaces)
                places = np.concatenate([links[:, 0, :3], actors[:, :3]])
                ground = beside.shadow_planes(places)
                ground[:, 3] -= ground[:, :3] @ window.origin
                close = self._pixels_a_metre(view, places) > DETAIL
                surfaces = moving.surfaces(
                    _moved(links, -window.origin), _moved(actors, -window.origin), ground, close, removed
                )
                yield renderer.draw(view.moved(-window.origin), surfaces)

    def _pixels_a_metre(self, view: View, places: np.ndarray) -> np.ndarray:
        """How large a metre is in the picture at places [m], shape [n, 3]."""
        distances = np.linalg.norm(places - np.asarray(view.eye), axis=1)
        return self.size[1] / (2.0 * np.tan(0.5 * view.field_of_view) * np.maximum(distances, 1e-3))

    def common_view(self, frames: Sequence[int]) -> View | None:
        """One view of all bodies at all of some frames; None where they move too far for that."""
        return self._views.common(frames)

    def _poses(self, frames: Sequence[int]) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Link and actor poses of ascending frames, and who has been taken away; read many at once."""
        begin = end = 0
        links = actors = removed = np.empty(0)
        for frame in frames:
            if not begin <= frame < end:
                begin, end = frame, min(frame + _FRAMES_AT_ONCE, frames[-1] + 1)
                links, actors = self.source.link_poses(begin, end), self.source.actor_poses(begin, end)
                removed = self.source.removed(begin, end)
            yield links[frame - begin], actors[frame - begin], removed[frame - begin]


def _opened(source: Source) -> PictureSource:
    if not isinstance(source, str | os.PathLike):
        return RecordedSource(source)
    if Path(source).is_dir():
        return RecordedSource(Recording(Path(source)))
    # USD takes its time to load, and only stages need it.
    from echelon.export.stage_source import StageSource

    return StageSource(Path(source))


def _moved(poses: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Poses [..., 7] moved by an offset [m]."""
    return np.concatenate([poses[..., :3] + offset, poses[..., 3:]], axis=-1)


# ---- strips --------------------------------------------------------------------------------------------------------
def _labelled(picture: np.ndarray, text: str) -> Image.Image:
    """The picture with a text on a light plate in its lower left corner."""
    image = Image.fromarray(picture).convert("RGBA")
    height = max(image.height // 16, 10)
    font = ImageFont.load_default(size=height)
    plate = Image.new("RGBA", image.size, (255, 255, 255, 0))
    pen = ImageDraw.Draw(plate)
    margin = height // 2
    anchor = (margin + height // 2, image.height - margin - height // 4)
    left, top, right, bottom = pen.textbbox(anchor, text, font=font, anchor="ls")
    pad = height // 3
    pen.rounded_rectangle((left - pad, top - pad, right + pad, bottom + pad), radius=pad, fill=(255, 255, 255, 200))
    pen.text(anchor, text, font=font, anchor="ls", fill=(20, 24, 28, 255))
    return Image.alpha_composite(image, plate).convert("RGB")


def _side_by_side(snapshots: Sequence[Image.Image]) -> Image.Image:
    rows = math.ceil(len(snapshots) / SNAPSHOTS_IN_ROW)
    columns = math.ceil(len(snapshots) / rows)
    width, height = snapshots[0].size
    strip = Image.new("RGB", (columns * (width + GUTTER) - GUTTER, rows * (height + GUTTER) - GUTTER), (255, 255, 255))
    for index, snapshot in enumerate(snapshots):
        row, column = divmod(index, columns)
        strip.paste(snapshot, (column * (width + GUTTER), row * (height + GUTTER)))
    return strip


def _write_png(path: Path, image: Image.Image) -> None:
    with replacing(path) as beside:
        image.save(beside, format="PNG", optimize=False, compress_level=6)


# ---- checks --------------------------------------------------------------------------------------------------------
def _number(
    path: Path, key: str, value: float, least: float, greatest: float, shown_limit: float | None = None
) -> float:
    """The value as a number within limits; raises InputError where it is not."""
    if isinstance(value, bool) or not isinstance(value, Real) or not least <= value <= greatest:
        top = greatest if shown_limit is None else shown_limit
        allowed = f"at least {least:g}" if math.isinf(top) else f"from {least:g} to {top:g}"
        raise InputError(f"{path}: {key} is {value!r}, must be a number {allowed}")
    return float(value)


def _checked_size(path: Path, size: tuple[int, int]) -> tuple[int, int]:
    least, greatest = SIZE_LIMITS
    numbers = tuple(size) if isinstance(size, tuple | list) else ()
    if len(numbers) != 2 or not all(
        isinstance(length, int | np.integer) and not isinstance(length, bool) and least <= length <= greatest
        for length in numbers
    ):
        raise InputError(f"{path}: size is {size!r}, must be a width and a height from {least} to {greatest} pixels")
    return int(numbers[0]), int(numbers[1])


def _times(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"
