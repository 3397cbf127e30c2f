"""Cameras for a group that rides along a road: behind it, from the air, and from the roadside.

All look at the *group*: where most riders are, so that nobody who breaks away or is dropped takes the picture with him.
Its middle is the average about the rider who has the most others near; over time it is averaged with a raised cosine.
When another group becomes the largest, the picture is cut, rather than chased along an empty road. Along the way of
that middle, by its arc length, the camera that follows trails behind: it turns where the road turned, and looks ahead
along the road to come.

The roadside camera stands still and turns with the group. One place shows a stretch of road of `STATION_SPAN`; a shot
that takes longer is cut, like a race on television, from place to place.

Everything that a view depends on lies within `reach_seconds` of it, but for the roadside's: its places are shared out
evenly over the shot, so that a short one has its place beside what happens in its middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.ndimage import correlate1d

RoadCamera = Literal["follow", "roadside", "helicopter"]
ROAD_CAMERAS: tuple[RoadCamera, ...] = ("follow", "roadside", "helicopter")

TOGETHER = 10.0  # [m], riders nearer than about this are one group
COMPANY_SMOOTHING = 3.0  # [s] over which it is averaged how much company each rider has
CUT = 15.0  # [m] in a frame: the group's middle does not move like that, it is another group's
GROUP_REACH = 30.0  # [m] from its middle: who is farther away is not waited for
GROUP_SMOOTHING = 1.5  # [s] to either side
EXTENT_SMOOTHING = 3.0  # [s]
WAY_SECONDS = 12.0  # [s] before and after a picture, of the group's way that it may depend on

FOLLOW_GAP = 7.5  # [m] from the camera to the last of the group
FOLLOW_AHEAD = 7.0  # [m] ahead of the group's middle that the camera looks at
FOLLOW_HEIGHT = (2.3, 0.13)  # [m] above the road, and more for each metre that it is behind the middle
FOLLOW_FIELD = float(np.radians(38.0))

AIR_BEHIND, AIR_ASIDE, AIR_HEIGHT = 0.75, 0.35, 1.0  # as parts of how far away the group fits into the picture
AIR_LEAST_EXTENT = 9.0  # [m]
AIR_FIELD = float(np.radians(30.0))
AIR_SMOOTHING = 4.0  # [s]

STATION_SPAN = 90.0  # [m] of road that one place beside it shows
STATION_ASIDE = 8.5  # [m] from the group's way
STATION_HEIGHT = 1.6  # [m]
STATION_ROOM = 3.2  # [m] to trees and houses
STATION_FIELDS = (float(np.radians(9.0)), float(np.radians(46.0)))

BODY_HEIGHT = 0.95  # [m] of the middle of a rider above the road


@dataclass(frozen=True)
class CameraWay:
    """Where a camera is, frame by frame.

    Attributes:
        eyes: [m],                          shape [frames, 3]
        targets: What it looks at [m],      shape [frames, 3]
        fields: Of view, vertical [rad],    shape [frames]
    """

    eyes: np.ndarray
    targets: np.ndarray
    fields: np.ndarray


def reach_seconds() -> float:
    """How much of a run before and after a picture decides about it [s]; see this module's text."""
    return WAY_SECONDS + AIR_SMOOTHING + GROUP_SMOOTHING + COMPANY_SMOOTHING


def camera_way(
    camera: RoadCamera, places: np.ndarray, frame_rate: int, aspect: float, blocked: np.ndarray | None = None
) -> CameraWay:
    """Where a camera is at every frame of a shot.

    Args:
        camera: Which one.
        places: Of the riders on the road [m], float64, shape [frames, riders, 3].
        frame_rate: Frames a second.
        aspect: Width of the picture over its height.
        blocked: Where the roadside camera cannot stand, (x, y) [m], shape [n, 2].
    """
    return camera_ways((camera,), places, frame_rate, aspect, blocked)[camera]


def camera_ways(
    cameras: Sequence[RoadCamera],
    places: np.ndarray,
    frame_rate: int,
    aspect: float,
    blocked: np.ndarray | None = None,
) -> dict[RoadCamera, CameraWay]:
    """Where several cameras are at every frame of a shot; arguments as for `camera_way`."""
    groups = _groups(places, frame_rate)
    free = np.empty((0, 2)) if blocked is None else blocked
    ways: dict[RoadCamera, CameraWay] = {}
    for camera in cameras:
        if camera == "follow":
            parts = [_following(group, aspect) for group in groups]
        elif camera == "helicopter":
            parts = [_from_the_air(group, aspect) for group in groups]
        else:
            parts = [_beside_the_road(group, aspect, free) for group in groups]
        ways[camera] = CameraWay(
            np.concatenate([part.eyes for part in parts]),
            np.concatenate([part.targets for part in parts]),
            np.concatenate([part.fields for part in parts]),
        )
    return ways


# ---- the group -----------------------------------------------------------------------------------------------------
class _Group:
    """Where most riders are, how far they reach, and the way they take: one stretch of a shot without a cut."""

    def __init__(self, places: np.ndarray, middle: np.ndarray, frame_rate: int) -> None:
        self.frame_rate = frame_rate
        self.frame_count = len(places)
        self.middle = _smooth(middle, GROUP_SMOOTHING, frame_rate)
        steps = np.linalg.norm(np.diff(self.middle[:, :2], axis=0), axis=1)
        self.distance = np.concatenate([[0.0], np.cumsum(steps)])
        near = np.linalg.norm(places[..., :2] - self.middle[:, None, :2], axis=2)
        counted = np.where(near <= GROUP_REACH, near, 0.0)
        self.extent = _smooth(counted.max(axis=1), EXTENT_SMOOTHING, frame_rate)
        # The way as a line with distances that grow, for a group that stands still now and then.
        moved = np.concatenate([[True], np.diff(self.distance) > 1e-9])
        self._knots, self._line = self.distance[moved], self.middle[moved]
        self._ends = (self._direction(0), self._direction(-1))

    def way(self, distance: np.ndarray) -> np.ndarray:
        """Where the group's middle was or will be at a distance along its way [m], straight on beyond what is known."""
        place = np.stack([np.interp(distance, self._knots, self._line[:, axis]) for axis in range(3)], axis=1)
        before = np.minimum(distance - self._knots[0], 0.0)[:, None]
        after = np.maximum(distance - self._knots[-1], 0.0)[:, None]
        return place + before * self._ends[0] + after * self._ends[1]

    def heading(self, seconds: float) -> np.ndarray:
        """Unit vectors along the way on the map, over so long either side, shape [frames, 2]."""
        steps = max(round(seconds * self.frame_rate), 1)
        frames = np.arange(self.frame_count)
        after, before = np.minimum(frames + steps, self.frame_count - 1), np.maximum(frames - steps, 0)
        way = self.middle[after, :2] - self.middle[before, :2]
        length = np.linalg.norm(way, axis=1, keepdims=True)
        return np.where(length > 0.05, way / np.maximum(length, 1e-9), self._ends[0][:2])

    def _direction(self, end: int) -> np.ndarray:
        """The way's slope at an end: (x, y, z) for each metre on the map."""
        if len(self._knots) < 2:
            return np.array([1.0, 0.0, 0.0])
        span = min(len(self._knots) - 1, 8)
        first, last = (0, span) if end == 0 else (-1 - span, -1)
        return (self._line[last] - self._line[first]) / (self._knots[last] - self._knots[first])


def _groups(places: np.ndarray, frame_rate: int) -> list[_Group]:
    """The group to look at, stretch by stretch: where another one becomes the largest, the picture is cut."""
    parts = np.array_split(places, max(len(places) // 2048, 1))
    company = np.concatenate([_company(part) for part in parts])
    # Of groups of one size that counts which has the lower numbers in it, so that the choice stays.
    company = _smooth(company, COMPANY_SMOOTHING, frame_rate) + 0.4 * np.linspace(1.0, 0.0, places.shape[1])
    middle = places[np.arange(len(places)), company.argmax(axis=1)]
    # Twice, so that it hardly matters whose company was the best.
    for reach in (TOGETHER, 1.5 * TOGETHER):
        weights = np.exp(-((np.linalg.norm(places[..., :2] - middle[:, None, :2], axis=2) / reach) ** 2))
        middle = (places * weights[..., None]).sum(axis=1) / weights.sum(axis=1)[:, None]
    jumps = np.linalg.norm(np.diff(middle[:, :2], axis=0), axis=1) > CUT
    bounds = [0, *(1 + np.flatnonzero(jumps)).tolist(), len(places)]
    return [_Group(places[a:b], middle[a:b], frame_rate) for a, b in pairwise(bounds)]


def _company(places: np.ndarray) -> np.ndarray:
    """How many others are near each rider, fewer the farther away, shape [frames, riders]."""
    gaps = np.linalg.norm(places[:, :, None, :2] - places[:, None, :, :2], axis=3)
    return np.exp(-((gaps / TOGETHER) ** 2)).sum(axis=2)


def _smooth(values: np.ndarray, seconds: float, frame_rate: int) -> np.ndarray:
    """Averages along the frames with a raised cosine, so long to either side; straight on beyond both ends."""
    reach = max(round(seconds * frame_rate), 1)
    weights = 1.0 + np.cos(np.pi * np.arange(-reach, reach + 1) / (reach + 1))
    rows = values.reshape(len(values), -1)
    # Mirrored through the end points: a group that rides on at its pace is not held back at the ends.
    known = min(reach, len(rows) - 1)
    head = 2.0 * rows[:1] - rows[known:0:-1] if known else rows[:0]
    tail = 2.0 * rows[-1:] - rows[-2 : -2 - known : -1] if known else rows[:0]
    padded = np.concatenate([head, rows, tail])
    smooth = correlate1d(padded, weights / weights.sum(), axis=0, mode="nearest")[known : known + len(rows)]
    return smooth.reshape(values.shape)


# ---- the cameras ---------------------------------------------------------------------------------------------------
def _following(group: _Group, aspect: float) -> CameraWay:
    """Behind the group and above it, looking ahead along the road."""
    room = FOLLOW_GAP * max(1.0, 1.6 / aspect)
    behind = group.extent + room
    eyes = group.way(group.distance - behind)
    low, rise = FOLLOW_HEIGHT
    eyes[:, 2] = np.maximum(eyes[:, 2], group.middle[:, 2] - 0.12 * behind) + low + rise * behind
    targets = group.way(group.distance + FOLLOW_AHEAD)
    targets[:, 2] += 0.6
    return CameraWay(eyes, targets, np.full(group.frame_count, FOLLOW_FIELD))


def _from_the_air(group: _Group, aspect: float) -> CameraWay:
    """High up, behind to the right, moving with the group."""
    heading = _smooth(group.heading(0.5 * AIR_SMOOTHING), AIR_SMOOTHING, group.frame_rate)
    heading /= np.maximum(np.linalg.norm(heading, axis=1, keepdims=True), 1e-6)
    half = np.tan(0.5 * AIR_FIELD) * min(aspect, 1.0)
    away = np.maximum(group.extent, AIR_LEAST_EXTENT) / half
    right = np.stack([heading[:, 1], -heading[:, 0]], axis=1)
    eyes = group.middle.copy()
    eyes[:, :2] += away[:, None] * (AIR_ASIDE * right - AIR_BEHIND * heading)
    eyes[:, 2] += AIR_HEIGHT * away
    return CameraWay(eyes, group.middle + [0.0, 0.0, BODY_HEIGHT], np.full(group.frame_count, AIR_FIELD))


def _beside_the_road(group: _Group, aspect: float, blocked: np.ndarray) -> CameraWay:
    """At a fixed place beside the road, from place to place in a long shot, turning with the group."""
    total = float(group.distance[-1])
    count = max(int(np.ceil(total / STATION_SPAN)), 1)
    station = np.minimum((group.distance / max(total, 1e-9) * count).astype(int), count - 1)
    middles = (np.arange(count) + 0.55) * total / count
    eyes = np.array([_station(group, float(middle), blocked) for middle in middles])[station]
    targets = group.middle + [0.0, 0.0, BODY_HEIGHT]
    distance = np.linalg.norm(targets - eyes, axis=1)
    wanted = 2.0 * np.arctan(np.maximum(0.85 * group.extent / aspect, 2.2) / np.maximum(distance, 1.0))
    return CameraWay(eyes, targets, np.clip(wanted, *STATION_FIELDS))


def _station(group: _Group, distance: float, blocked: np.ndarray) -> np.ndarray:
    """A place for a camera beside the group's way near a distance along it: clear of what stands there [m]."""
    best, best_room = np.zeros(3), -1.0
    for shift in (0.0, 5.0, -5.0, 10.0, -10.0, 15.0, -15.0):
        ahead, here, behind = group.way(distance + shift + np.array([8.0, 0.0, -8.0]))
        along = (ahead - behind)[:2] / max(float(np.linalg.norm((ahead - behind)[:2])), 1e-9)
        left = np.array([-along[1], along[0]])
        bend = float((ahead - here)[0] * (here - behind)[1] - (ahead - here)[1] * (here - behind)[0])
        # On the outside of a bend the riders come towards the camera and lean away from it.
        for side in (1.0, -1.0) if bend > 0.0 else (-1.0, 1.0):
            place = here + [*(side * STATION_ASIDE * left), STATION_HEIGHT]
            room = float(np.linalg.norm(blocked - place[:2], axis=1).min(initial=np.inf))
            if room >= STATION_ROOM:
                return place
            if room > best_room:
                best, best_room = place, room
    return best
