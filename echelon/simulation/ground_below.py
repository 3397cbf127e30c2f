"""The ground beneath a few points of the world, looked up on whatever terrain a scene has."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false, reportInvalidTypeForm=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python. There is no
# `from __future__ import annotations`, since the kernel's types are variables of the function that makes it.

from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from echelon.warp_kernels.frame import Terrain
from echelon.warp_kernels.frame_kernel import type_of


@lru_cache(maxsize=8)
def _look_down(look_up: Any, terrain_type: Any) -> Any:
    """The kernel that asks one kind of terrain."""

    @wp.kernel(module="unique", enable_backward=False)
    def look_down(terrain: terrain_type, points: wp.array[wp.vec3d], planes_out: wp.array[wp.vec4d]):
        i = wp.tid()
        planes_out[i] = look_up(0, points[i], terrain)

    return look_down


def ground_planes(terrain: Terrain, points: np.ndarray, device: str) -> np.ndarray:
    """Local planes n . x = d of the ground beneath points [m], shapes [n, 3] and [n, 4], float64."""
    where = wp.array(np.ascontiguousarray(points, dtype=np.float64), dtype=wp.vec3d, device=device)
    planes = wp.zeros(len(points), dtype=wp.vec4d, device=device)
    kernel = _look_down(terrain.look_up, type_of(terrain.data))
    wp.launch(kernel, len(points), inputs=[terrain.data, where], outputs=[planes], device=device)
    return planes.numpy().reshape(-1, 4)
