"""Cameras of a stage. The one in a field keeps its direction and moves so that the herd just fits.

With the direction fixed, a point is inside the picture when it is on the inner side of four planes through the camera.
In the camera's axes (a to the right, b up, c forward) and with k the tangent of half the field of view, the left and
right planes ask for

    k camera_c - camera_a <= k c - a    and    k camera_c + camera_a <= k c + a

of every point, so the whole herd comes down to four numbers a frame, the least right-hand sides; they are then made
smooth. A least value over a window, averaged over the same window, is never more than the value in its middle: what
was framed stays framed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from echelon.export.road_cameras import CameraWay
from echelon.export.stage.motion import continuous

PITCH = np.radians(20.0)  # downwards
FOCAL_LENGTH = 0.035  # [m]
APERTURE = (0.036, 0.02025)  # [m], 16 : 9
MARGIN = 1.2  # [m] about each agent
LEAST_DISTANCE = 6.0  # [m] from camera to the middle of the action
COLLIE_DISTANCE = 15.0  # [m] from the herd's middle within which the collie is part of the action
SMOOTHING_SECONDS = 1.5  # to either side


@dataclass(frozen=True)
class CameraMove:
    """Where a camera is, which way it looks, and how far it sees.

    Attributes:
        positions: [m], float64,                                                            shape [frames, 3]
        orientations: Quaternions (x, y, z, w) from the camera's axes (x right, y up, looking along -z) to the
            world's; a single one where it does not turn,                                   shape [frames or 1, 4]
        focal_lengths: [m]; a single one where it does not change,                          shape [frames or 1]
        focus_distances: To the middle of the action [m],                                   shape [frames]
    """

    positions: np.ndarray
    orientations: np.ndarray
    focal_lengths: np.ndarray
    focus_distances: np.ndarray


def looking(way: CameraWay) -> CameraMove:
    """The move of a camera beside or above a road."""
    back = way.eyes - way.targets
    distance = np.linalg.norm(back, axis=1, keepdims=True)
    back = back / distance
    right = np.stack([-back[:, 1], back[:, 0], np.zeros(len(back))], axis=1)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    axes = np.stack([right, np.cross(back, right), back], axis=2)
    lengths = 0.5 * APERTURE[1] / np.tan(0.5 * way.fields)
    return CameraMove(way.eyes, continuous(Rotation.from_matrix(axes).as_quat()), lengths, distance[:, 0])


def framed(herd: np.ndarray, others: np.ndarray, frame_rate: int) -> CameraMove:
    """A camera move that keeps every agent in the picture.

    Args:
        herd: Positions that must be seen [m], shape [frames, agents, 3], at least one agent.
        others: Positions that should be seen while they are near [m], shape [frames, actors, 3].
        frame_rate: Frames a second.
    """
    axes = _axes(herd)
    middle = herd.mean(axis=1, keepdims=True)
    far = np.linalg.norm(others - middle, axis=-1, keepdims=True) > COLLIE_DISTANCE
    points = np.concatenate([herd, np.where(far, middle, others)], axis=1)
    right, up, forward = points @ axes[0], points @ axes[1], -(points @ axes[2])
    bounds = []
    for across, aperture in ((right, APERTURE[0]), (up, APERTURE[1])):
        slope = 0.5 * aperture / FOCAL_LENGTH
        margin = MARGIN * np.hypot(1.0, slope)
        bounds.append((slope, (slope * forward - across).min(axis=1), (slope * forward + across).min(axis=1), margin))
    camera = np.zeros((len(herd), 3))
    camera[:, 2] = _smooth((middle[:, 0] @ -axes[2]) - LEAST_DISTANCE, frame_rate)
    for axis, (slope, first, second, margin) in enumerate(bounds):
        first, second = (_smooth(bound - margin, frame_rate) for bound in (first, second))
        camera[:, axis] = 0.5 * (second - first)
        camera[:, 2] = np.minimum(camera[:, 2], (first + second) / (2.0 * slope))
    positions = camera[:, :1] * axes[0] + camera[:, 1:2] * axes[1] - camera[:, 2:] * axes[2]
    orientation = Rotation.from_matrix(axes.T).as_quat()[None]
    return CameraMove(positions, orientation, np.array([FOCAL_LENGTH]), (middle[:, 0] @ -axes[2]) - camera[:, 2])


def _axes(herd: np.ndarray) -> np.ndarray:
    """Look across the direction in which the action stretches most, from its right, a little down."""
    plan = herd[..., :2].reshape(-1, 2)
    spread = np.cov(plan.T) if len(plan) > 1 else np.eye(2)
    _, directions = np.linalg.eigh(spread)
    along = directions[:, -1]
    along = along if along[np.argmax(np.abs(along))] > 0.0 else -along
    heading = np.array([-along[1], along[0], 0.0])
    forward = np.cos(PITCH) * heading - np.array([0.0, 0.0, np.sin(PITCH)])
    right = np.array([along[0], along[1], 0.0])
    return np.stack([right, np.cross(right, forward), -forward])


def _smooth(bound: np.ndarray, frame_rate: int) -> np.ndarray:
    """A smooth lower envelope: the least over a window, averaged over the same window with bell-shaped weights."""
    reach = max(int(SMOOTHING_SECONDS * frame_rate), 1)
    least = _windows(bound, reach).min(axis=1)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) * (2.5 / reach)) ** 2)
    return _windows(least, reach) @ (weights / weights.sum())


def _windows(values: np.ndarray, reach: int) -> np.ndarray:
    """The values around each value, those at both ends continued; shape [n, 2 reach + 1]."""
    return np.lib.stride_tricks.sliding_window_view(np.pad(values, reach, mode="edge"), 2 * reach + 1)
