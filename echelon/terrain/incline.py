"""Inclines side by side: straight lanes along x that climb or fall, each at a grade of its own.

Riding and hopping uphill is tried and measured here, many bodies on different grades in one run.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

wp.set_module_options({"enable_backward": False})

LANE_WIDTH = 200.0  # [m]


@wp.struct
class Inclines:
    """Grades of lanes, on the device.

    Attributes:
        grades: Rise over run along x of each lane; lane i is centred on y = i `LANE_WIDTH`,   shape [lanes], float64
        walls: Where a wall that faces back along x stands across each lane [m],               shape [lanes], float64
    """

    grades: wp.array[wp.float64]
    walls: wp.array[wp.float64]


@wp.func
def look_up_incline(surface: int, point: wp.vec3d, inclines: Inclines) -> wp.vec4d:
    """The plane of the lane that a point is in, or that of the lane's wall."""
    lane = int(wp.floor(point[1] / wp.float64(LANE_WIDTH) + wp.float64(0.5)))
    lane = wp.clamp(lane, 0, inclines.grades.shape[0] - 1)
    if surface != 0:
        return wp.vec4d(wp.float64(-1.0), wp.float64(0.0), wp.float64(0.0), -inclines.walls[lane])
    grade = inclines.grades[lane]
    size = wp.sqrt(wp.float64(1.0) + grade * grade)
    return wp.vec4d(-grade / size, wp.float64(0.0), wp.float64(1.0) / size, wp.float64(0.0))


@dataclass(frozen=True)
class InclineTerrain:
    """Lanes of different grades through the line x = 0, z = 0.

    Attributes:
        data: What `look_up` reads.
        look_up: The Warp function that gives a site its local plane.
        level: Whether the ground's normal is +z everywhere; it is not.
        rough: Whether planes change within a frame; nobody changes lanes.
    """

    data: Any
    look_up: Any = look_up_incline
    level: bool = False
    rough: bool = False

    @classmethod
    def of(
        cls,
        grades: Sequence[float] | np.ndarray,
        walls: Sequence[float] | np.ndarray | None = None,
        device: wp.DeviceLike = None,
    ) -> InclineTerrain:
        """Lanes of these grades, rise over run, and where walls stand across them [m]; none if not given."""
        data = Inclines()
        places = np.full(len(grades), 1e6) if walls is None else np.asarray(walls, dtype=np.float64)
        data.walls = wp.array(places, dtype=wp.float64, device=device)
        data.grades = wp.array(np.asarray(grades, dtype=np.float64), dtype=wp.float64, device=device)
        return cls(data)

    @staticmethod
    def starts(count: int) -> np.ndarray:
        """Where to start in the first `count` lanes [m], shape [count, 3]."""
        return np.column_stack([np.zeros(count), LANE_WIDTH * np.arange(count), np.zeros(count)])
