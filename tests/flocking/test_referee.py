"""Who is in, who came in or went out, who ran into whom; against plain counting over all pairs."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from echelon.flocking.herd import Herd
from echelon.flocking.referee import PARTNER_LIMIT, Referee
from echelon.scenario import CorralSettings, HerdSettings, WorldSettings

WORLD = WorldSettings(corral=CorralSettings(center=(20.0, 5.0), facing=(0.0, -1.0), penned_fraction=0.75))
SETTINGS = HerdSettings()
LEAST = 2.0 * SETTINGS.radius


class Watched:
    """A crowd whose places the test decides, frame by frame."""

    def __init__(self, count: int, world: WorldSettings = WORLD) -> None:
        self.herd = Herd(SETTINGS, world, count, frame_rate=30, seed=1, device="cpu")
        self.referee = Referee(SETTINGS, world, count, device="cpu")
        self.frame = wp.zeros(1, dtype=wp.int32, device="cpu")
        self.nobody = wp.zeros(count, dtype=wp.int32, device="cpu")

    def look(self, frame: int, places: np.ndarray) -> dict[str, int]:
        positions = np.column_stack([places, np.ones(len(places))]).astype(np.float32)
        self.frame.fill_(frame)
        self.herd.enqueue_look(wp.array(positions, dtype=wp.vec3, device="cpu"), self.nobody)
        self.referee.enqueue(self.frame, self.herd.arrays.table)
        return self.referee.totals()


def overlapping(places: np.ndarray) -> set[tuple[int, int]]:
    places = places.astype(np.float32)
    squares = ((places[:, None] - places[None]) ** 2).sum(axis=2)
    first, second = np.nonzero(np.triu(squares < np.float32(LEAST) ** 2, k=1))
    return set(zip(first.tolist(), second.tolist(), strict=True))


def test_collisions_are_reported_once_when_they_begin() -> None:
    random = np.random.default_rng(3)
    watched = Watched(200)
    places = random.uniform(-7.0, 7.0, (200, 2))
    velocities = random.normal(0.0, 1.0, (200, 2))
    before: set[tuple[int, int]] = set()
    total = 0
    for frame in range(60):
        totals = watched.look(frame, places)
        now = overlapping(places)
        assert watched.referee.collisions() == sorted(now - before)
        total += len(now - before)
        assert totals["collisions"] == total
        before = now
        places = places + velocities / 30.0
    assert total > 100


def test_who_parts_and_meets_again_collides_again() -> None:
    watched = Watched(2)
    gaps = [2.0, 0.69, 0.3, 0.71, 0.69, 0.5]
    begun = [watched.look(k, np.array([[0.0, 0.0], [gap, 0.0]]))["collisions"] for k, gap in enumerate(gaps)]
    assert begun == [0, 1, 1, 1, 2, 2]


def test_of_many_at_once_all_are_counted_and_the_first_named() -> None:
    watched = Watched(9)
    apart = np.column_stack([np.arange(9) * 5.0, np.zeros(9)])
    watched.look(0, apart)
    heap = np.column_stack([np.arange(9)[::-1] * 0.01, np.zeros(9)])
    assert watched.look(1, heap)["collisions"] == 36
    pairs = watched.referee.collisions()
    assert [b for a, b in pairs if a == 0] == list(range(1, 1 + PARTNER_LIMIT))
    assert [b for a, b in pairs if a == 7] == [8]


def test_a_body_whose_place_is_lost_collides_with_nobody() -> None:
    watched = Watched(3)
    totals = watched.look(0, np.array([[0.0, 0.0], [np.nan, 0.0], [0.1, 0.0]]))
    assert totals["collisions"] == 1
    assert watched.referee.collisions() == [(0, 2)]


@pytest.mark.parametrize(
    ("place", "inside"),
    [((20.0, 5.0), True), ((15.01, 0.01), True), ((24.99, 9.99), True), ((14.9, 5.0), False), ((20.0, -0.01), False)],
)
def test_inside_is_within_the_square(place: tuple[float, float], inside: bool) -> None:
    assert Watched(1).look(0, np.array([place]))["inside"] == int(inside)


def test_gates_are_passages_in_and_out() -> None:
    watched = Watched(3)
    outside, inside = (20.0, -2.0), (20.0, 2.0)
    frames = [
        [inside, outside, outside],  # who begins inside has not come in
        [inside, inside, outside],
        [outside, inside, outside],
        [outside, inside, inside],
    ]
    seen = []
    for frame, places in enumerate(frames):
        totals = watched.look(frame, np.array(places))
        seen.append((totals["inside"], totals["gates"], watched.referee.arrays.gates.numpy().tolist()))
    assert seen == [(1, 0, [0, 0, 0]), (2, 1, [0, 1, 0]), (1, 2, [-1, 0, 0]), (2, 3, [0, 0, 1])]


def test_penned_frames_are_counted_on_end() -> None:
    watched = Watched(4)
    inside, outside = (20.0, 5.0), (0.0, 0.0)
    spread = np.array([[0.0, 0.0], [1.5, 0.0], [0.0, 1.5], [-1.5, 0.0]])
    counts = []
    for frame, enough in enumerate([True, True, False, True, True, True]):
        places = np.array([inside, inside, inside if enough else outside, outside]) + spread
        counts.append(watched.look(frame, places)["penned_frames"])
    assert counts == [1, 2, 0, 1, 2, 3]


def test_looking_twice_at_a_frame_counts_nothing_twice() -> None:
    watched = Watched(3)
    watched.look(0, np.array([[20.0, -2.0], [0.0, 0.0], [5.0, 0.0]]))
    places = np.array([[20.0, 2.0], [0.0, 0.0], [0.5, 0.0]])
    once = watched.look(1, places)
    assert watched.look(1, places) == once
    assert once == {"inside": 1, "penned_frames": 0, "gates": 1, "collisions": 1}


def test_frames_before_the_first_may_be_numbered_below_zero() -> None:
    watched = Watched(2)
    outside, inside = np.array([[20.0, -2.0], [0.0, 0.0]]), np.array([[20.0, 2.0], [0.0, 0.0]])
    for frame, places in ((-2, outside), (-1, outside), (0, inside)):
        totals = watched.look(frame, places)
    assert totals["gates"] == 1


def test_without_a_corral_nobody_is_inside() -> None:
    totals = Watched(2, WorldSettings()).look(0, np.array([[0.0, 0.0], [5.0, 0.0]]))
    assert totals == {"inside": 0, "penned_frames": 0, "gates": 0, "collisions": 0}
