"""The hash grid against a k-d tree, and what it promises besides: order, determinism, linear cost."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import math
import time

import numpy as np
import pytest
import warp as wp
from scipy.spatial import KDTree

from echelon.warp_kernels.neighbours import CellTable, cell_table, empty_cells, enter_agent, nearest_neighbours

CELL = 1.75  # [m]


@wp.kernel
def enter_in_order(places: wp.array[wp.vec2], order: wp.array[wp.int32], table: CellTable):
    agent = order[wp.tid()]
    enter_agent(agent, places[agent], table)


@wp.kernel
def search_all(
    visibility: float,
    table: CellTable,
    indices_out: wp.array2d[wp.int32],
    distances_out: wp.array2d[wp.float32],
    found_out: wp.array[wp.int32],
):
    agent = wp.tid()
    found_out[agent] = nearest_neighbours(agent, visibility, table, indices_out, distances_out)


class GridSearch:
    """One crowd in a hash grid, and a search for everybody."""

    def __init__(self, places: np.ndarray, cap: int, visibility: float, cell: float = CELL) -> None:
        count = len(places)
        self.visibility = visibility
        self.places = wp.array(places.astype(np.float32), dtype=wp.vec2, device="cpu")
        self.order = wp.array(np.arange(count, dtype=np.int32), dtype=wp.int32, device="cpu")
        self.table = cell_table(count, cell, visibility, "cpu")
        self.indices = wp.full((count, cap), -1, dtype=wp.int32, device="cpu")
        self.distances = wp.full((count, cap), math.inf, dtype=wp.float32, device="cpu")
        self.found = wp.zeros(count, dtype=wp.int32, device="cpu")

    def run(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Indices (-1 beyond those found), distances and counts."""
        count = len(self.found)
        empty_cells(self.table)
        wp.launch(enter_in_order, count, [self.places, self.order], [self.table], device="cpu")
        outputs = [self.indices, self.distances, self.found]
        wp.launch(search_all, count, [self.visibility, self.table], outputs, device="cpu")
        return self.indices.numpy(), self.distances.numpy(), self.found.numpy()


def expected_neighbours(places: np.ndarray, cap: int, visibility: float) -> tuple[list[list[int]], list[list[float]]]:
    """By (distance in float32, index), from a k-d tree that finds who is in sight."""
    places = places.astype(np.float32)
    indices: list[list[int]] = []
    distances: list[list[float]] = []
    for agent, near in enumerate(KDTree(places).query_ball_point(places, visibility * 1.0001)):
        others = np.array([other for other in near if other != agent], dtype=int)
        gaps = places[others] - places[agent]
        squares = gaps[:, 0] * gaps[:, 0] + gaps[:, 1] * gaps[:, 1]
        in_sight = squares <= np.float32(visibility) * np.float32(visibility)
        others, squares = others[in_sight], squares[in_sight]
        order = np.lexsort((others, squares))[:cap]
        indices.append(others[order].tolist())
        distances.append(np.sqrt(squares[order]).tolist())
    return indices, distances


def random_places(count: int, density: float, seed: int) -> np.ndarray:
    side = math.sqrt(count / density)
    return np.random.default_rng(seed).uniform(-0.5 * side, 0.5 * side, (count, 2)).astype(np.float32)


@pytest.mark.parametrize("count", [1, 2, 16, 105, 2000])
@pytest.mark.parametrize("density", [0.002, 0.35, 5.0])
def test_neighbours_are_those_of_a_tree(count: int, density: float) -> None:
    places = random_places(count, density, seed=count)
    indices, distances, found = GridSearch(places, cap=8, visibility=12.0).run()
    expected, expected_distances = expected_neighbours(places, 8, 12.0)
    assert found.tolist() == [len(row) for row in expected]
    for agent, row in enumerate(expected):
        # Two whose squared distances differ in the last bit of a fused product may change places.
        np.testing.assert_allclose(distances[agent, : len(row)], expected_distances[agent], rtol=1e-6)
        same = indices[agent, : len(row)] == row
        if not same.all():
            np.testing.assert_allclose(
                np.linalg.norm(places[indices[agent, : len(row)]] - places[agent], axis=1),
                expected_distances[agent],
                rtol=1e-6,
            )


@pytest.mark.parametrize(
    ("visibility", "cell", "cap"), [(2.0, 1.75, 3), (12.0, 0.4, 8), (300.0, 1.0, 12), (5.0, 40.0, 1)]
)
def test_any_cell_size_finds_the_same(visibility: float, cell: float, cap: int) -> None:
    places = random_places(400, 0.35, seed=3) + np.float32([200.0, -300.0])
    _, distances, found = GridSearch(places, cap, visibility, cell).run()
    expected, expected_distances = expected_neighbours(places, cap, visibility)
    assert found.tolist() == [len(row) for row in expected]
    for agent, row in enumerate(expected_distances):
        np.testing.assert_allclose(distances[agent, : len(row)], row, rtol=1e-6)


def test_ties_are_broken_by_index() -> None:
    square = np.array([[1, 0], [0, 0], [0, 1], [-1, 0], [0, -1], [0, 0]], dtype=np.float32) * 2.0
    indices, distances, found = GridSearch(square, cap=4, visibility=3.0).run()
    assert found.tolist() == [4, 4, 4, 4, 4, 4]
    assert indices[1].tolist() == [5, 0, 2, 3]
    assert indices[5].tolist() == [1, 0, 2, 3]
    assert distances[1].tolist() == [0.0, 2.0, 2.0, 2.0]


def test_the_order_of_entering_changes_nothing() -> None:
    search = GridSearch(random_places(500, 2.0, seed=4), cap=8, visibility=6.0)
    first = [array.copy() for array in search.run()]
    search.order.assign(np.random.default_rng(5).permutation(500).astype(np.int32))
    for before, after in zip(first, search.run(), strict=True):
        np.testing.assert_array_equal(before, after)


def test_those_who_are_nowhere_are_seen_by_nobody_and_see_nobody() -> None:
    places = random_places(60, 0.35, seed=6)
    lost = [0, 17, 41, 59]
    whole = np.delete(np.arange(60), lost)
    places[lost] = [[math.nan, 0.0], [math.inf, 1.0], [0.0, -math.inf], [1e30, -1e30]]
    indices, _, found = GridSearch(places, cap=8, visibility=12.0).run()
    assert found[lost].tolist() == [0, 0, 0, 0]
    alone, _, _ = GridSearch(places[whole], cap=8, visibility=12.0).run()
    np.testing.assert_array_equal(indices[whole], whole[alone])


def test_cost_is_linear_in_agents() -> None:
    def seconds(count: int) -> float:
        search = GridSearch(random_places(count, 0.35, seed=7), cap=8, visibility=12.0)
        search.run()
        best = math.inf
        for _ in range(5):
            begin = time.perf_counter()
            search.run()
            best = min(best, time.perf_counter() - begin)
        return best

    few, many = seconds(5_000), seconds(40_000)
    # All pairs would cost 64 times as much; caches and a busy machine take their share of eight.
    assert many < 24.0 * few, f"{many * 1e3:.2f} ms for 40,000, {few * 1e3:.2f} ms for 5,000"
