"""Which way a shot is seen: from a camera's name to a view for each of its pictures."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from echelon.errors import InputError
from echelon.export.camera import (
    ELEVATION,
    OVERVIEW_ELEVATION,
    View,
    fixed_view,
    following_views,
    side_views,
    smoothing_frames,
)
from echelon.export.picture_source import PictureSource
from echelon.export.road_cameras import RoadCamera, camera_way, reach_seconds

Camera = Literal["follow", "side", "overview", "corral", "roadside", "helicopter"] | View
FIELD_CAMERAS = ("follow", "side", "overview", "corral")
ROAD_CAMERAS = ("follow", "overview", "roadside", "helicopter")

# Where a camera may stand that shows a road from one place: as low as it can, unless something is in the way.
ROAD_ELEVATIONS = tuple(np.radians((18.0, 26.0, 36.0, 50.0)).tolist())
ROAD_AZIMUTHS = tuple(np.radians((-140.0, 140.0, -100.0, 100.0, -60.0, 60.0, -20.0, 20.0)).tolist())  # from its heading

COMMON_REACH = 300.0  # [m]; a crowd that moves farther is not seen from one place

_FRAMES_AT_ONCE = 64  # read from the recording


class ShotViews:
    """Views of a source's frames in pictures of one shape."""

    def __init__(self, source: PictureSource, path: Path, aspect: float) -> None:
        """
        Args:
            source: What is seen.
            path: Of the file that is made, for messages.
            aspect: Width of the picture over its height.
        """
        self._source, self._path, self._aspect = source, path, aspect

    def views(self, frames: Sequence[int], camera: Camera) -> list[View]:
        """A view for each of some frames, in ascending order; raises InputError where a camera cannot be had."""
        if isinstance(camera, View):
            if self._source.world.road is None and not camera.eye[2] > 0.0:
                raise InputError(f"{self._path}: the camera's eye is at z = {camera.eye[2]:g} m, must be above 0")
            return [camera] * len(frames)
        on_road = self._source.world.road is not None
        known = ROAD_CAMERAS if on_road else FIELD_CAMERAS
        if camera not in known:
            where = "on a road" if on_road else "in a field"
            raise InputError(f"{self._path}: camera {camera!r} is not one of {', '.join(known)}, those {where}")
        if camera == "corral":
            return [self._corral_view()] * len(frames)
        if camera == "overview":
            return [self._overview(frames)] * len(frames)
        if camera == "side":
            return self._following(frames, from_the_side=True)
        if camera in ("roadside", "helicopter") or on_road:
            return self._along_the_road(frames, camera)
        return self._following(frames)

    def common(self, frames: Sequence[int]) -> View | None:
        """One view of all bodies at all of some frames; None where they move too far for that."""
        places = np.concatenate([self._places(frame, frame + 1)[0] for frame in frames])
        if np.linalg.norm(np.ptp(places.mean(axis=1), axis=0)) > COMMON_REACH:
            return None
        return self._fixed(places, ELEVATION)

    def _fixed(self, places: np.ndarray, elevation: float) -> View:
        """A view of bodies at places, frame by frame [m], shape [frames, bodies, 3]."""
        road = self._source.world.road
        if road is None:
            return fixed_view(places[..., :2].reshape(-1, 2), self._aspect, elevation)
        # The ground of a road is where it is: on a level with the middle of the bodies.
        way = places[-1].mean(axis=0) - places[0].mean(axis=0)
        heading = float(np.arctan2(way[1], way[0]))
        level = np.array([0.0, 0.0, 0.5 * (places[..., 2].min() + places[..., 2].max())])
        flat = places[..., :2].reshape(-1, 2)
        bodies = places.reshape(-1, 3)[:: max(places.shape[0] * places.shape[1] // 200, 1)] + [0.0, 0.0, 1.0]
        blockers = road.blockers()
        best, least = None, np.inf
        for rise, aside in itertools.product(ROAD_ELEVATIONS, ROAD_AZIMUTHS):
            view = fixed_view(flat, self._aspect, max(elevation, rise), heading + aside).moved(level)
            hidden = blockers.hidden(np.asarray(view.eye), bodies)
            if best is None or hidden < least - 1e-9:
                best, least = view, hidden
            if least == 0.0:
                break
        assert best is not None
        return best

    def _along_the_road(self, frames: Sequence[int], camera: RoadCamera) -> list[View]:
        assert self._source.world.road is not None
        reach = 0 if camera == "roadside" else round(reach_seconds() * self._source.frame_rate)
        if camera == "roadside" and frames[-1] - frames[0] < self._source.frame_rate:
            reach = self._source.frame_rate  # to know which way the group goes
        first, last = max(frames[0] - reach, 0), min(frames[-1] + reach + 1, self._source.frame_count)
        places, _ = self._places(first, last)
        way = camera_way(camera, places, self._source.frame_rate, self._aspect, self._source.world.road.places)
        return [
            View(
                (float(way.eyes[row, 0]), float(way.eyes[row, 1]), float(way.eyes[row, 2])),
                (float(way.targets[row, 0]), float(way.targets[row, 1]), float(way.targets[row, 2])),
                float(way.fields[row]),
            )
            for row in (frame - first for frame in frames)
        ]

    def _following(self, frames: Sequence[int], from_the_side: bool = False) -> list[View]:
        reach = 2 * smoothing_frames(self._source.frame_rate)
        first = max(frames[0] - reach, 0)
        last = min(frames[-1] + reach + 1, self._source.frame_count)
        bodies, actors = self._places(first, last)
        if from_the_side:
            views = side_views(bodies, self._source.world.heading, self._source.frame_rate, self._aspect)
        else:
            views = following_views(bodies[..., :2], actors, self._source.frame_rate, self._aspect)
        return [views[frame - first] for frame in frames]

    def _overview(self, frames: Sequence[int]) -> View:
        fences = [fence.mesh.points[:, :2].astype(np.float64) for fence in self._source.world.fences]
        if fences:
            return fixed_view(np.concatenate(fences), self._aspect, OVERVIEW_ELEVATION)
        return self._fixed(self._places(frames[0], frames[-1] + 1)[0], OVERVIEW_ELEVATION)

    def _corral_view(self) -> View:
        pen = self._source.world.pen
        if pen is None:
            raise InputError(f"{self._path}: camera 'corral' needs a corral, and this run has none")
        half = 0.5 * pen.size + 1.0
        corners = np.asarray(pen.center) + half * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
        return fixed_view(corners, self._aspect)

    def _places(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Places of bodies [frames, agents, 3] and of actors [frames, actors, 2], last left out [m]."""
        bodies, actors = [], []
        for begin in range(first, last, _FRAMES_AT_ONCE):
            end = min(begin + _FRAMES_AT_ONCE, last)
            bodies.append(self._source.body_places(begin, end))
            actors.append(self._source.actor_poses(begin, end)[:, :, :2])
        return np.concatenate(bodies), np.concatenate(actors)
