"""Flat ground at z = 0 with upright walls, as the local planes that contacts meet."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from echelon.scenario import WorldSettings
from echelon.terrain.walls import SURFACE_WALL, WallGrid, wall_grid, wall_plane

wp.set_module_options({"enable_backward": False})

WALL_REACH = 2.0
"""Walls nearer than this to a body are found [m]; more than its radius and what it travels in a frame."""


@wp.func
def look_up_flat(surface: int, point: wp.vec3d, walls: WallGrid) -> wp.vec4d:
    """The local plane (n_x, n_y, n_z, d) of n . x = d, in the world, that a site of this surface at `point` meets."""
    if surface == SURFACE_WALL:
        return wall_plane(point, walls)
    return wp.vec4d(wp.float64(0.0), wp.float64(0.0), wp.float64(1.0), wp.float64(0.0))


@dataclass(frozen=True)
class FlatTerrain:
    """Flat ground and the walls of a world on a device.

    Attributes:
        data: What `look_up` reads.
        look_up: The Warp function that gives a site its local plane.
        level: Whether the ground's normal is +z everywhere; it is.
        rough: Whether planes change within a frame; here never.
    """

    data: Any
    look_up: Any = look_up_flat
    level: bool = True
    rough: bool = False

    @classmethod
    def of(cls, world: WorldSettings, device: wp.DeviceLike = None) -> FlatTerrain:
        """The flat terrain of a world's settings."""
        return cls(wall_grid(world, WALL_REACH, device))
