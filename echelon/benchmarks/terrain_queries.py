"""How many times a second the ground can be asked for its height and normal, by one thread inside a kernel."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import warp as wp

from echelon.terrain.quadtree import GroundTree, ground_plane
from echelon.terrain.road import RoadSurfaces

wp.set_module_options({"enable_backward": False})

RIDERS = 16  # whose wheels ask in turn along the road
ROUNDS = 5  # of which the fastest counts


@wp.kernel
def look_down(ground: GroundTree, points: wp.array[wp.vec3d], planes_out: wp.array[wp.vec4d]):
    """The plane below each point."""
    i = wp.tid()
    planes_out[i] = ground_plane(ground, points[i])


@dataclass(frozen=True)
class QueryRates:
    """Queries of the ground a second.

    Attributes:
        triangles: How many there are.
        anywhere: At random places of the land.
        on_road: At random places of the road.
        riding: At the wheels of riders, tick by tick.
    """

    triangles: int
    anywhere: float
    on_road: float
    riding: float


def measure_queries(surfaces: RoadSurfaces, device: wp.DeviceLike = "cpu", count: int = 1_000_000) -> QueryRates:
    """Ask the ground of a road `count` times in each way; on a CPU that is one thread."""
    random = np.random.default_rng(1)
    land, line = surfaces.land, surfaces.centreline
    anywhere = random.uniform([land.range_u[0], land.range_v[0]], [land.range_u[1], land.range_v[1]], (count, 2))

    def beside(s: np.ndarray, offset: np.ndarray) -> np.ndarray:
        return line.position(s)[:, :2] + offset[:, None] * line.left(s)

    on_road = beside(random.uniform(0.0, line.length, count), random.uniform(-1.0, 1.0, count) * surfaces.half_width)
    # 12 m/s and 240 ticks a second, riders 2 m from one another, a wheel each time.
    tick, rider = np.divmod(np.arange(count), RIDERS)
    riding = beside(0.05 * tick + 2.0 * rider, np.where(rider % 2, 1.0, -1.0))
    ground = surfaces.quadtree.data(device)
    rates = [_rate(ground, places, device) for places in (anywhere, on_road, riding)]
    return QueryRates(len(surfaces.quadtree.placements), *rates)


def _rate(ground: GroundTree, places: np.ndarray, device: wp.DeviceLike) -> float:
    """Queries a second at places on the map [m], shape [n, 2]."""
    points = wp.array(np.c_[places, np.zeros(len(places))], dtype=wp.vec3d, device=device)
    planes = wp.zeros(len(places), dtype=wp.vec4d, device=device)
    wp.launch(look_down, len(places), [ground, points], [planes], device=device)  # compiles
    wp.synchronize_device(device)
    seconds = np.inf
    for _ in range(ROUNDS):
        start = time.perf_counter()
        wp.launch(look_down, len(places), [ground, points], [planes], device=device)
        wp.synchronize_device(device)
        seconds = min(seconds, time.perf_counter() - start)
    return len(places) / seconds
