"""The land beside a road: it meets the road's edge, follows the road's heights nearby, and rolls gently farther away.

Three heights are blended by the distance d from the road:

* *beside the road* an average of the road's heights, weighted by nearness, so that the ground is level across the
  verge and has no step inside a bend, where one stretch of the road ceases to be the nearest and another begins;
* *between stretches* the thin plate that passes through the road, the smoothest surface that does;
* *away from it* that plate with low hills upon it, drawn from a seed.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import KDTree

from echelon.terrain.spline import Centreline

NEAR_SPACING = 2.0  # [m] between the places on the road whose heights are averaged
NEAR_REACH = 60.0  # [m] from which a place on the road is felt
PLATE_SPACING = 30.0  # [m] between the places on the road that the plate passes through
PLATE_PLACES = 1500  # at most: its equations are dense
HILLS_BEGIN = 30.0  # [m] from the road's edge
_WAVES = 8
_CHUNK = 20_000  # places looked up at a time: bounds the memory


class LandHeights:
    """Heights of the ground around a road, anywhere on the map; smooth, and the same for the same course."""

    def __init__(self, centreline: Centreline, edge: float, hills: float, hill_size: float, seed: int):
        """Fit the land to a road.

        Args:
            centreline: Of the road.
            edge: Distance from it up to which the ground is level across [m].
            hills: How far hills rise and valleys fall, about [m].
            hill_size: From one hill to the next, about [m].
            seed: Of the hills.
        """
        self._edge = edge
        count = max(8, math.ceil(centreline.length / NEAR_SPACING))
        samples = centreline.position(np.arange(count) * (centreline.length / count))
        if not centreline.closed:
            samples = np.vstack([samples, centreline.position(centreline.length)])
        self._road = samples
        self._tree = KDTree(samples[:, :2])
        spacing = max(PLATE_SPACING, centreline.length / PLATE_PLACES)
        places = samples[_thinned(samples[:, :2], spacing)]
        self._middle = places.mean(axis=0)
        # Kilometres, so that the plate's equations are well scaled; a little smoothing, for the road may cross itself.
        flat = (places[:, :2] - self._middle[:2]) / 1000.0
        self._plate = None
        if np.linalg.matrix_rank(np.c_[flat, np.ones(len(flat))], tol=1e-6) == 3:
            self._plate = RBFInterpolator(flat, places[:, 2], kernel="thin_plate_spline", smoothing=1e-6)
        draws = _uniform(4 * _WAVES, seed).reshape(4, _WAVES)
        size = hill_size * (0.6 + 1.0 * draws[0])
        self._waves = np.stack([np.cos(2 * np.pi * draws[1]), np.sin(2 * np.pi * draws[1])]) * (2 * np.pi / size)
        self._phases = 2 * np.pi * draws[2]
        self._amplitudes = hills * (0.5 + draws[3]) / math.sqrt(0.5 * _WAVES) / 2.0
        self._hill_size = hill_size

    def __call__(self, xy: np.ndarray) -> np.ndarray:
        """Heights [m], shape [...].

        Args:
            xy: Places on the map [m], shape [..., 2].
        """
        places = np.asarray(xy, dtype=np.float64)
        flat = places.reshape(-1, 2)
        heights = np.concatenate(
            [np.empty(0), *(self._of(flat[start : start + _CHUNK]) for start in range(0, len(flat), _CHUNK))]
        )
        return heights.reshape(places.shape[:-1])

    def _of(self, places: np.ndarray) -> np.ndarray:
        distance = self._tree.query(places)[0] - self._edge
        heights = np.full(len(places), self._middle[2])
        if self._plate is not None:
            heights = self._plate((places - self._middle[:2]) / 1000.0)
        waves = np.sin(places @ self._waves + self._phases) @ self._amplitudes
        heights = heights + _smooth_step(distance, HILLS_BEGIN, HILLS_BEGIN + 0.5 * self._hill_size) * waves
        reach = NEAR_REACH - self._edge
        near = np.flatnonzero(distance < 0.75 * reach)
        if len(near):
            share = 1.0 - _smooth_step(distance[near], 0.0, 0.75 * reach)
            heights[near] += share * (self._beside(places[near]) - heights[near])
        return heights

    def _beside(self, places: np.ndarray) -> np.ndarray:
        """The road's heights averaged by nearness, for places within reach of it (Franke and Little's weights)."""
        pairs = KDTree(places).sparse_distance_matrix(self._tree, NEAR_REACH, output_type="coo_matrix")
        gap = np.maximum(pairs.data, 0.25)
        weights = ((NEAR_REACH - gap) / gap) ** 4
        total = np.bincount(pairs.row, weights, len(places))
        return np.bincount(pairs.row, weights * self._road[pairs.col, 2], len(places)) / total


def _thinned(places: np.ndarray, spacing: float) -> np.ndarray:
    """Indices of places of which no two are nearer than about half the spacing: every so many, one of a grid cell."""
    stride = max(1, round(spacing / NEAR_SPACING))
    chosen = np.arange(0, len(places), stride)
    cells = np.floor(places[chosen] / spacing).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return chosen[np.sort(first)]


def _smooth_step(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 up to `low`, 1 from `high`, and smooth up to the second derivative between."""
    part = np.clip((value - low) / (high - low), 0.0, 1.0)
    return part**3 * (10.0 + part * (6.0 * part - 15.0))


def _uniform(count: int, seed: int) -> np.ndarray:
    """Numbers from 0 to 1 from a counter, shape [count]."""
    bits = np.random.Philox(key=seed).random_raw(count)
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53
