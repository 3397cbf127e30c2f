"""Flat ground at z = 0 with upright walls, as the local planes that contacts meet."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from echelon.scenario import WorldSettings
from echelon.terrain.walls import WallGrid, nearest_wall_within, wall_grid

wp.set_module_options({"enable_backward": False})

SURFACE_GROUND = wp.constant(0)
SURFACE_WALL = wp.constant(1)
NOWHERE = wp.constant(wp.float64(-1.0e6))  # [m], offset of a plane that nothing reaches

WALL_REACH = 2.0
"""Walls nearer than this to a body are found [m]; more than its radius and what it travels in a frame."""


@wp.func
def look_up_flat(surface: int, point: wp.vec3d, walls: WallGrid) -> wp.vec4d:
    """The local plane (n_x, n_y, n_z, d) of n . x = d, in the world, that a site of this surface at `point` meets."""
    if surface == SURFACE_WALL:
        flat = wp.vec2(wp.float32(point[0]), wp.float32(point[1]))
        hit = nearest_wall_within(flat, walls)
        away = flat - wp.vec2(hit[0], hit[1])
        distance = wp.length(away)
        # On the wall itself there is no telling which side is the inside: wait for the next look.
        if hit[3] < 0.0 or distance < 1.0e-4:
            return wp.vec4d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0), NOWHERE)
        n_x, n_y = wp.float64(away[0] / distance), wp.float64(away[1] / distance)
        return wp.vec4d(n_x, n_y, wp.float64(0.0), n_x * wp.float64(hit[0]) + n_y * wp.float64(hit[1]))
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
