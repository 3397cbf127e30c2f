"""What stands beside a road stands there always, on the ground, and in nobody's way."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import KDTree

from echelon.terrain.course import Course, ScenerySettings
from echelon.terrain.roadside import COLORS, KINDS, ROOM, SIZES, Roadside, place_roadside


@pytest.fixture(scope="module")
def city() -> Course:
    return Course.load("city-race")


@pytest.fixture(scope="module")
def roadside(city: Course) -> Roadside:
    return place_roadside(city)


def reach_of(kind: str, scales: np.ndarray) -> np.ndarray:
    """From the middle of each to its farthest corner on the ground [m]."""
    sizes = scales[:, :2] * np.array(SIZES[kind][:2])
    return 0.5 * (np.hypot(*sizes.T) if kind == "house" else sizes.max(axis=1))


def test_riders_pass_plenty_all_along(city: Course, roadside: Roadside) -> None:
    assert set(roadside) == set(KINDS)
    counts = {kind: len(placement) for kind, placement in roadside.items()}
    assert sum(counts.values()) > 1000
    assert min(counts.values()) > 50
    along = np.sort(np.concatenate([placement.s for placement in roadside.values()]))
    assert np.diff(along).max() < 60.0  # something to pass at least every 60 m


def test_shapes_and_kinds(roadside: Roadside) -> None:
    for kind, placement in roadside.items():
        count = len(placement)
        assert placement.positions.shape == placement.scales.shape == (count, 3)
        assert placement.yaws.shape == placement.colors.shape == placement.s.shape == (count,)
        assert set(placement.colors.tolist()) <= set(range(COLORS[kind]))
        assert np.isfinite(placement.positions).all()
        assert placement.scales.min() > 0.5
        assert placement.scales.max() < 2.0


def test_nothing_stands_on_a_road(city: Course, roadside: Roadside) -> None:
    samples = KDTree(city.centreline.samples[:, :2])
    for kind, placement in roadside.items():
        gap = samples.query(placement.positions[:, :2])[0] - reach_of(kind, placement.scales)
        assert gap.min() > city.half_width + city.verge


def test_nothing_stands_on_a_side_street(city: Course, roadside: Roadside) -> None:
    for street in city.side_streets:
        ends = np.array(street)
        places = np.vstack([a + np.linspace(0.0, 1.0, 200)[:, None] * (b - a) for a, b in pairwise(ends)])
        tree = KDTree(places)
        for kind, placement in roadside.items():
            gap = tree.query(placement.positions[:, :2])[0] - reach_of(kind, placement.scales)
            assert gap.min() > 0.5 * city.side_street_width + 0.5 * ROOM


def test_nothing_stands_in_another(roadside: Roadside) -> None:
    places = np.vstack([placement.positions[:, :2] for placement in roadside.values()])
    reaches = np.concatenate([reach_of(kind, placement.scales) for kind, placement in roadside.items()])
    pairs = KDTree(places).query_pairs(2.0 * float(reaches.max()), output_type="ndarray")
    gaps = np.hypot(*(places[pairs[:, 0]] - places[pairs[:, 1]]).T)
    assert (gaps > reaches[pairs].sum(axis=1) - 1e-9).all()


def test_everything_stands_on_the_ground(city: Course, roadside: Roadside) -> None:
    for kind, placement in roadside.items():
        ground = city.surfaces.height(placement.positions[:, :2])
        if kind != "house":
            assert placement.positions[:, 2] == pytest.approx(ground, abs=1e-6)
            continue
        # No corner of a house floats, and none is deep in the ground.
        for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            half = 0.5 * placement.scales[:, :2] * np.array(SIZES[kind][:2]) * np.array([x, y])
            cos, sin = np.cos(placement.yaws), np.sin(placement.yaws)
            corner = placement.positions[:, :2] + np.stack(
                [half[:, 0] * cos - half[:, 1] * sin, half[:, 0] * sin + half[:, 1] * cos], axis=1
            )
            rise = city.surfaces.height(corner) - placement.positions[:, 2]
            assert rise.min() > -1e-6
            assert rise.max() < 3.0


def test_houses_and_lamps_look_at_the_road(city: Course, roadside: Roadside) -> None:
    for kind in ("house", "lamp", "hydrant"):
        placement = roadside[kind]
        ahead = placement.positions[:, :2] + np.stack([np.cos(placement.yaws), np.sin(placement.yaws)], axis=1)
        before, after = (np.abs(city.centreline.closest(xy)[1]) for xy in (placement.positions[:, :2], ahead))
        assert before - after == pytest.approx(1.0, abs=1e-3)


def block(**scenery: float) -> Course:
    t = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    points = np.stack([200.0 * np.cos(t), 150.0 * np.sin(t), 10.0 + 3.0 * np.sin(t)], axis=1)
    return Course.from_dict({"name": "block", "points": points.tolist(), "scenery": scenery})


def same(first: Roadside, second: Roadside, kind: str) -> bool:
    return np.array_equal(first[kind].positions, second[kind].positions) and np.array_equal(
        first[kind].scales, second[kind].scales
    )


def test_the_same_course_has_the_same_and_another_seed_another() -> None:
    course = block()
    first, again = place_roadside(course), place_roadside(Course.from_dict(course.to_dict()))
    assert all(same(first, again, kind) for kind in KINDS)
    other = place_roadside(replace(course, seed=2))
    assert not same(first, other, "tree")


def test_a_kind_is_left_out_and_the_others_stay() -> None:
    full, treeless = place_roadside(block()), place_roadside(block(tree_spacing=0))
    assert len(treeless["tree"]) == 0
    assert treeless["tree"].positions.shape == (0, 3)
    assert all(same(full, treeless, kind) for kind in ("house", "lamp", "hydrant"))
    none = place_roadside(block(**{f"{kind}_spacing": 0 for kind in KINDS}))
    assert sum(len(placement) for placement in none.values()) == 0


def test_spacing_decides_how_many() -> None:
    few, many = (len(place_roadside(block(tree_spacing=spacing))["tree"]) for spacing in (60.0, 20.0))
    assert 2.0 < many / few < 4.0
    assert ScenerySettings().lamp_spacing > 0.0
