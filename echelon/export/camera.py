"""Where the camera stands: fixed views, and a view that follows the action without ever cutting a body off.

The camera never turns, it only travels, and that makes framing exact and simple. Let its axes be ``right``, ``up`` and
``back``, and ``w``, ``h`` half the width and height of the picture at unit distance. A point ``p`` is in the picture of
an eye ``e`` when it is on the inner side of four planes through the eye,

    n . (p - e) >= 0    for n = right - w back, -right - w back, up - h back, -up - h back,

and all points are when ``n . e <= m`` with ``m`` the least ``n . p``: four numbers a frame say all there is to know
about the action. The eye that satisfies them from the least distance follows in closed form. Where that leaves room,
above and below in a wide picture say, two more numbers, the nearest and the farthest point along ``back``, divide it
evenly to the eye.

To follow, each of these numbers is lowered to its least within `SMOOTHING` either side, and then averaged over as
long with a raised cosine. An average of numbers none of which is above the need of the frame in the middle is not above
it either: the motion is smooth, looks ahead, and still frames every body in every frame. It depends on nothing farther
away than twice `SMOOTHING`, so that a still shows what the film shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import correlate1d, minimum_filter1d

from echelon.warp_kernels.model import Vec3

FIELD_OF_VIEW = float(np.radians(30.0))  # vertical
AZIMUTH = float(np.radians(-118.0))  # where the camera stands, seen from what it looks at, from x towards y
ELEVATION = float(np.radians(17.0))  # above the horizon
OVERVIEW_ELEVATION = float(np.radians(34.0))
SIDE_ELEVATION = float(np.radians(6.0))

SMOOTHING = 1.5  # [s]
SIDE_SMOOTHING = 0.4  # [s]
LOWEST_SEEN = 0.3  # [m]; whoever is lower, under water say, is not followed further
BODY_REACH = 1.2  # [m] about a body's first link, in which all of it is, arms and legs stretched
BODY_HEIGHT = 0.9  # [m] of the middle of what must be seen of a body, above its place on the ground
BODY_RADIUS = 1.1  # [m] about that middle
LEAST_SPAN = 3.0  # [m] either side of the middle of the action that is in the picture as well
MARGIN = 0.05  # of the picture, all round, that is kept free
ACTOR_REACH = 12.0  # [m] from the circle of the bodies, as far as the camera opens for an actor


@dataclass(frozen=True)
class View:
    """A camera.

    Attributes:
        eye: Where it stands [m].
        target: What it looks at [m].
        field_of_view: From the bottom of the picture to its top [rad].
    """

    eye: Vec3
    target: Vec3
    field_of_view: float = FIELD_OF_VIEW

    def pose(self) -> np.ndarray:
        """Matrix from the camera's frame (x right, y up, looking along -z) to the world's, shape [4, 4]."""
        pose = np.eye(4)
        pose[:3, :3] = _axes(np.subtract(self.eye, self.target))
        pose[:3, 3] = self.eye
        return pose

    def moved(self, offset: np.ndarray) -> View:
        """The same view from elsewhere; offset [m], shape [3]."""
        return View(_vec3(np.add(self.eye, offset)), _vec3(np.add(self.target, offset)), self.field_of_view)


class Framing:
    """The direction a camera looks in, the shape of its picture, and the eyes that have points in it."""

    def __init__(self, aspect: float, elevation: float = ELEVATION, azimuth: float = AZIMUTH) -> None:
        """
        Args:
            aspect: Width of the picture over its height.
            elevation: Of the camera above the horizon, less than a right angle [rad].
            azimuth: Of the camera, seen from what it looks at, from x towards y [rad].
        """
        flat = np.cos(elevation)
        self._axes = _axes(np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]))
        right, up, back = self._axes.T
        self._half_height = np.tan(0.5 * FIELD_OF_VIEW) * (1.0 - 2.0 * MARGIN)
        self._half_width = np.tan(0.5 * FIELD_OF_VIEW) * (aspect - 2.0 * MARGIN)
        across, upward = self._half_width * back, self._half_height * back
        self._planes = np.stack([right - across, -right - across, up - upward, -up - upward])

    def limits(self, points: np.ndarray, radius: float) -> np.ndarray:
        """What balls of a radius [m] about points [..., n, 3] demand of the eye; shape [..., 6].

        Four planes (left, right, below, above), then minus the nearest point along ``back``, then the farthest.
        """
        demands = (points @ self._planes.T).min(axis=-2) - radius * np.linalg.norm(self._planes, axis=1)
        toward = points @ self._axes[:, 2]
        return np.concatenate(
            [demands, -toward.max(axis=-1, keepdims=True), toward.min(axis=-1, keepdims=True)], axis=-1
        )

    def view(self, limits: np.ndarray) -> View:
        """The view from the nearest eye that meets the demands, shape [6]."""
        left, right, below, above, nearest, farthest = limits
        # The eye in the camera's axes: x - w z <= left, -x - w z <= right, and the same with y and h.
        z = max(-(left + right) / (2.0 * self._half_width), -(below + above) / (2.0 * self._half_height))
        near, far = z + nearest, z - farthest
        highest, lowest = below + self._half_height * z, -(above + self._half_height * z)
        y = highest - (highest - lowest) * near / (near + far)
        eye = self._axes @ [0.5 * (left - right), y, z]
        back = self._axes[:, 2]
        return View(_vec3(eye), _vec3(eye - eye[2] / back[2] * back))


def fixed_view(places: np.ndarray, aspect: float, elevation: float = ELEVATION, azimuth: float = AZIMUTH) -> View:
    """One view of bodies at all of some places on the ground.

    Args:
        places: [m], shape [n, 2], n at least 1.
        aspect: Width of the picture over its height.
        elevation, azimuth: See `Framing`.
    """
    framing = Framing(aspect, elevation, azimuth)
    return framing.view(framing.limits(_with_least_span(places[None]), BODY_RADIUS)[0])


def following_views(bodies: np.ndarray, actors: np.ndarray, frame_rate: int, aspect: float) -> list[View]:
    """A view for each frame, moving smoothly, with all bodies in the picture.

    Args:
        bodies: Places of the bodies on the ground [m], shape [frames, bodies, 2].
        actors: Places of the actors [m], shape [frames, actors, 2]; in the picture while they are near the bodies.
        frame_rate: Frames a second.
        aspect: Width of the picture over its height.
    """
    framing = Framing(aspect)
    places = np.concatenate([bodies, _near(bodies, actors)], axis=1)
    limits = framing.limits(_with_least_span(places), BODY_RADIUS)
    return [framing.view(smooth) for smooth in _smoothed(limits, smoothing_frames(frame_rate))]


def side_views(bodies: np.ndarray, heading: float, frame_rate: int, aspect: float) -> list[View]:
    """A view for each frame, from the right of those who face a heading, low and close, following up and down too.

    Args:
        bodies: Places of the bodies' first links [m], shape [frames, bodies, 3].
        heading: Which way they face, from x towards y [rad].
        frame_rate: Frames a second.
        aspect: Width of the picture over its height.
    """
    framing = Framing(aspect, SIDE_ELEVATION, heading - 0.5 * np.pi)
    reach = max(round(SIDE_SMOOTHING * frame_rate), 1)
    seen = bodies.copy()
    seen[..., 2] = np.maximum(seen[..., 2], LOWEST_SEEN)
    # The camera goes along with them, at no cost in size however fast they are; what must be in the picture is seen
    # from there.
    way = correlate1d(0.5 * (seen.min(axis=1) + seen.max(axis=1)), _bell(reach), axis=0, mode="nearest")
    smooth = _smoothed(framing.limits(seen - way[:, None], BODY_REACH), reach)
    return [framing.view(smooth[frame]).moved(way[frame]) for frame in range(len(way))]


def smoothing_frames(frame_rate: int) -> int:
    """Frames either side over which `following_views` averages; twice as many decide about one view."""
    return max(round(SMOOTHING * frame_rate), 1)


def _smoothed(limits: np.ndarray, reach: int) -> np.ndarray:
    """Demands frame by frame, made smooth over some frames either side, so that each frame's own are still met."""
    lowest = minimum_filter1d(limits, 2 * reach + 1, axis=0, mode="nearest")
    return correlate1d(lowest, _bell(reach), axis=0, mode="nearest")


def _bell(reach: int) -> np.ndarray:
    """Weights of an average over so many frames either side, a raised cosine."""
    weights = 1.0 + np.cos(np.pi * np.arange(-reach, reach + 1) / (reach + 1))
    return weights / weights.sum()


def _near(bodies: np.ndarray, actors: np.ndarray) -> np.ndarray:
    """Places to frame for the actors [m], shape [frames, actors, 2]: their own while near, drawn in when far away.

    An actor beyond `ACTOR_REACH` is let go little by little, not chased across the field.
    """
    centers = 0.5 * (bodies.min(axis=1) + bodies.max(axis=1))[:, None]
    radii = np.linalg.norm(bodies - centers, axis=2).max(axis=1)[:, None]
    gaps = actors - centers
    distances = np.linalg.norm(gaps, axis=2)
    beyond = np.clip((distances - radii) / ACTOR_REACH - 1.0, 0.0, 1.0)
    kept = 1.0 - beyond * beyond * (3.0 - 2.0 * beyond)
    framed = np.minimum(distances, radii + ACTOR_REACH) * kept
    return centers + gaps * (framed / np.maximum(distances, 1e-9))[..., None]


def _with_least_span(places: np.ndarray) -> np.ndarray:
    """Middles of bodies [m], shape [frames, n, 3], and around their middle what is framed in any case."""
    middle = 0.5 * (places.min(axis=1) + places.max(axis=1))[:, None]
    span = LEAST_SPAN * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    framed = np.concatenate([places, middle + span], axis=1)
    return np.concatenate([framed, np.full((*framed.shape[:2], 1), BODY_HEIGHT)], axis=2)


def _axes(back: np.ndarray) -> np.ndarray:
    """Columns right, up, back of a camera level with the horizon, from the direction it stands in; shape [3, 3]."""
    back = back / np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    # Straight down there is no horizon to be level with; x is as good as any.
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.column_stack([right, np.cross(back, right), back])


def _vec3(values: np.ndarray) -> Vec3:
    return (float(values[0]), float(values[1]), float(values[2]))
