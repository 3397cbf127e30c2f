"""Sunlight and skylight at vertices, and the shadows that the sun throws on ground that is flat nearby.

A shadow is the body itself, flattened along the sun's rays, drawn dark and half transparent. Where flattened parts
overlap they must not darken twice: each part lies a hair lower than the one drawn before it, so the depth test rejects
it where there is shadow already; and of each part, which is convex, only the side turned to the sun is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_SUN = np.array([-0.74, -0.24, 0.88])
SUN = _SUN / np.linalg.norm(_SUN)  # direction towards the sun: left of the camera, so that shadows fall to the right

SUN_COLOR = np.array([1.16, 1.06, 0.90], dtype=np.float32)  # warm key light, linear RGB
SKY_COLOR = np.array([0.26, 0.31, 0.40], dtype=np.float32)  # cool fill from above
BOUNCE_COLOR = np.array([0.16, 0.19, 0.11], dtype=np.float32)  # what the grass throws back

SHADOW_COLOR = np.array([0.02, 0.05, 0.10, 0.46], dtype=np.float32)  # display-encoded RGB, opacity


@dataclass(frozen=True)
class ShadowLayers:
    """Horizontal planes just above the ground, on which shadows lie in the order in which they are drawn.

    Attributes:
        top: Height of the first [m].
        bottom: None lies lower than this [m].
        least_count: So many layers at least are told apart.
    """

    top: float
    bottom: float
    least_count: int

    def heights(self, layers: np.ndarray, count_together: int) -> np.ndarray:
        """Heights [m] of layers by number; so many next to one another must not share one."""
        count = max(self.least_count, count_together)
        return self.top - (self.top - self.bottom) / count * (layers % count)


MOVING_SHADOWS = ShadowLayers(top=0.014, bottom=0.005, least_count=48)
STANDING_SHADOWS = ShadowLayers(top=0.004, bottom=0.001, least_count=13)


def lit(albedo: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Display-encoded colours of matt surfaces.

    Args:
        albedo: Linear RGB from 0 to 1, broadcast against the normals.
        normals: Unit normals, shape [..., 3].

    Returns:
        RGB from 0 to 1, float32, shape [..., 3].
    """
    facing = np.maximum(normals @ SUN.astype(np.float32), 0.0)[..., None]
    upward = 0.5 + 0.5 * normals[..., 2:3]
    light = SUN_COLOR * facing + SKY_COLOR * upward + BOUNCE_COLOR * (1.0 - upward)
    return display_encoded(albedo * light)


def display_encoded(linear: np.ndarray) -> np.ndarray:
    """sRGB values of linear RGB, clipped to 0 and 1, float32."""
    clipped = np.clip(linear, 0.0, 1.0).astype(np.float32)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** np.float32(1.0 / 2.4) - 0.055)


LEVEL = np.array([0.0, 0.0, 1.0, 0.0])
"""The plane z = 0 as (n_x, n_y, n_z, d), n . x = d."""


def flattened(points: np.ndarray, heights: np.ndarray, planes: np.ndarray = LEVEL) -> np.ndarray:
    """Points moved along the sun's rays on to planes [m].

    Args:
        points: [m], shape [..., 3]; those below the ground stay beneath themselves.
        heights: Above the ground, of the layer for each point [m], broadcast to shape [...].
        planes: The ground for each point as (n_x, n_y, n_z, d), n . x = d, broadcast to shape [..., 4].
    """
    normals = planes[..., :3].astype(points.dtype)
    above = np.sum(points * normals, axis=-1) - planes[..., 3].astype(points.dtype)
    fall = np.maximum(above, 0.0) / (normals @ SUN.astype(points.dtype))
    lift = (heights - np.minimum(above, 0.0))[..., None] * normals
    return (points - fall[..., None] * SUN.astype(points.dtype) + lift).astype(points.dtype)
