"""A platform high above the water, as divers leap from: level up to an edge, and beyond it nothing.

The water, at z = 0, holds nobody: a dive ends where it is met. Up on the platform the ground of each contact site is
looked up where the site stands, so that heels hang over the edge while the balls of the feet carry.

The edge stands across x at the origin or, turned, across another direction. A diver who faces the platform has it
ahead; the platform is as wide as it needs to be.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})

DEPTH = 1.0e4
"""How far beneath the water the plane lies that stands for no ground [m]: out of reach, yet a plane like any other."""


@wp.struct
class PlatformEdge:
    """A platform's height and edge, on the device.

    Attributes:
        height: Of its surface over the water [m].
        edge_x, edge_y: A point of the edge [m].
        inward_x, inward_y: Unit vector across the edge, onto the platform.
    """

    height: wp.float64
    edge_x: wp.float64
    edge_y: wp.float64
    inward_x: wp.float64
    inward_y: wp.float64


@wp.func
def look_up_platform(surface: int, point: wp.vec3d, edge: PlatformEdge) -> wp.vec4d:
    """The platform's plane for a point above it, a plane out of reach for one beyond the edge, and for walls."""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    inward = (point[0] - edge.edge_x) * edge.inward_x + (point[1] - edge.edge_y) * edge.inward_y
    if surface == 0 and inward >= zero:
        return wp.vec4d(zero, zero, one, edge.height)
    return wp.vec4d(zero, zero, one, wp.float64(-DEPTH))


@dataclass(frozen=True)
class PlatformTerrain:
    """A level platform that ends at a straight edge, on a device.

    Attributes:
        data: What `look_up` reads.
        look_up: The Warp function that gives a site its local plane.
        level: Whether the ground's normal is +z everywhere; it is.
        rough: Whether planes change within a frame; they do, for feet at the edge.
    """

    data: Any
    look_up: Any = look_up_platform
    level: bool = True
    rough: bool = True

    @classmethod
    def of(
        cls,
        height: float = 10.0,
        edge: tuple[float, float] = (0.0, 0.0),
        heading: float = 0.0,
    ) -> PlatformTerrain:
        """A platform.

        Args:
            height: Of its surface over the water [m].
            edge: A point of its edge [m].
            heading: Where one faces who stands at the edge with the back to the water [rad]: 0 has it reach along +x.
        """
        data = PlatformEdge()
        data.height = height
        data.edge_x, data.edge_y = edge
        data.inward_x, data.inward_y = math.cos(heading), math.sin(heading)
        return cls(data)
