"""A course: the circuit that ships, what a file may hold, what is refused, and what follows from it."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.terrain.course import Course, course_names, write_course
from echelon.terrain.course_facts import course_facts

BLOCK = {
    "name": "block",
    "points": [[0, 0, 20], [150, 0, 22], [200, 60, 24], [150, 120, 24], [0, 120, 22], [-50, 60, 20]],
    "side_streets": [[[75, -4], [75, -60]]],
}


@pytest.fixture(scope="module")
def city() -> Course:
    return Course.load("city-race")


# ---- the circuit that ships ------------------------------------------------------------------------------------------
def test_circuit_has_the_length_the_way_round_and_the_grades_of_the_papers(city: Course) -> None:
    facts = course_facts(city)
    assert city.closed
    assert facts.length == pytest.approx(13_000.0, rel=0.01)
    assert facts.counter_clockwise
    assert 0.127 <= facts.steepest_up <= 0.13
    assert -0.04 <= facts.steepest_down <= -0.037
    assert facts.climb == pytest.approx(facts.descent, abs=1e-6)


def test_circuit_starts_in_the_south_east_corner_and_goes_north(city: Course) -> None:
    places = city.centreline.samples[:, :2]
    low, high = places.min(axis=0), places.max(axis=0)
    x, y = (city.centreline.position(0.0)[:2] - low) / (high - low)
    assert x > 0.9
    assert y < 0.1
    assert city.centreline.tangent(0.0)[1] > 0.9


def test_circuit_has_street_corners_and_nothing_that_kicks_a_bicycle(city: Course) -> None:
    facts = course_facts(city)
    street_corners = [corner for corner in facts.corners if corner.radius < 15.5]
    assert len(street_corners) >= 12
    assert all(abs(corner.angle) > np.radians(70.0) for corner in street_corners)
    assert facts.sharpest >= 12.0
    assert facts.crest > 300.0  # [m]: at 10 m/s a third of a m/s^2 up or down
    # A street corner comes within no less than five metres: the curvature of 4 m of road changes by less than a fifth
    # of its most in a metre. (Of a point it steps where one piece of the spline ends.)
    heading = np.unwrap(np.arctan2(*city.centreline.tangent(np.arange(0.0, city.length, 0.5))[:, 1::-1].T))
    curvature = (heading[8:] - heading[:-8]) / 4.0
    assert np.abs(curvature[2:] - curvature[:-2]).max() < 0.2 / facts.sharpest


def test_side_streets_leave_the_road_and_do_not_come_back(city: Course) -> None:
    assert len(city.side_streets) > 50
    for street in city.side_streets:
        offsets = np.abs(city.centreline.closest(np.array(street))[1])
        assert offsets[0] < city.half_width + 8.0
        assert offsets[-1] > city.half_width + 20.0


def test_circuit_says_that_it_is_no_survey(city: Course) -> None:
    assert "no survey" in city.description


# ---- land and paint --------------------------------------------------------------------------------------------------
def test_land_meets_the_road_along_its_verge(city: Course) -> None:
    line = city.centreline
    s = np.arange(0.0, city.length, 5.0)
    places, left = line.position(s), line.left(s)
    for offset in (-6.0, -3.0, 0.0, 3.0, 6.0):
        heights = city.land_height(places[:, :2] + offset * left)
        assert np.abs(heights - places[:, 2]).max() < 0.12
    far = city.land_height(places[:, :2] + 150.0 * left) - places[:, 2]
    assert far.std() > 1.0  # hills
    assert np.abs(far).max() < 40.0


def test_land_has_no_steps(city: Course) -> None:
    """Across the inside of a street corner, where the nearest stretch of road changes."""
    corner = course_facts(city).corners[0]
    apex, left = city.centreline.position(corner.s)[:2], city.centreline.left(corner.s)
    inside = np.sign(corner.angle) * left
    along = city.centreline.tangent(corner.s)[:2]
    for depth in (15.0, 25.0, 40.0):
        line = apex + depth * inside + np.arange(-5.0, 5.0, 0.05)[:, None] * along
        assert np.abs(np.diff(city.land_height(line))).max() < 0.02


def test_land_depends_on_the_seed_but_not_at_the_road() -> None:
    courses = [Course.from_dict(BLOCK | {"seed": seed}) for seed in (1, 2)]
    away, near = np.array([75.0, 260.0]), np.array([75.0, 0.0])
    heights = [[float(course.land_height(place)) for place in (away, near)] for course in courses]
    assert abs(heights[0][0] - heights[1][0]) > 0.05
    assert heights[0][1] == pytest.approx(heights[1][1], abs=1e-9)


def test_straight_open_road_has_land() -> None:
    """All its points in one line: no plane is given by them."""
    course = Course(name="line", closed=False, points=tuple((float(x), 0.0, 5.0) for x in range(0, 400, 20)))
    assert course.land_height(np.array([[200.0, 0.0], [200.0, 5.0]])) == pytest.approx([5.0, 5.0], abs=1e-6)


def test_paint_stays_on_the_road(city: Course) -> None:
    lines = city.lines()
    assert set(lines) == {"edge", "centre", "start"}
    for strips in lines.values():
        assert (strips[:, 0] < strips[:, 1]).all()
        assert (strips[:, 2] < strips[:, 3]).all()
        assert strips[:, :2].min() >= 0.0
        assert strips[:, :2].max() <= city.length
        assert np.abs(strips[:, 2:]).max() <= city.half_width
    open_road = Course(name="line", closed=False, points=((0, 0, 0), (100, 0, 0)))
    assert "finish" in open_road.lines()


# ---- files -----------------------------------------------------------------------------------------------------------
def test_plain_data_and_toml_are_lossless(city: Course, tmp_path: Path) -> None:
    for course in (city, Course.from_dict(BLOCK)):
        assert Course.from_dict(course.to_dict()) == course
        assert Course.from_dict(json.loads(json.dumps(course.to_dict()))) == course
        assert Course.from_dict(tomllib.loads(course.to_toml())) == course
        assert Course.load(write_course(course, tmp_path / "written.toml")) == course
    assert [path.name for path in tmp_path.iterdir()] == ["written.toml"]


def test_name_comes_from_the_file(tmp_path: Path) -> None:
    (tmp_path / "my block.toml").write_text("points = [[0, 0, 0], [99, 0, 0], [99, 99, 0], [0, 99, 0]]")
    assert Course.load(tmp_path / "my block.toml").name == "my-block"


def test_shipped_courses_are_listed() -> None:
    assert course_names() == ("city-race",)


def test_the_file_in_the_documentation_is_a_course() -> None:
    page = (Path(__file__).parents[2] / "docs" / "courses.md").read_text(encoding="utf-8")
    (text,) = (block for block in re.split(r"^```\w*$", page, flags=re.M) if "points = [" in block)
    course = Course.from_dict({"name": "documented"} | tomllib.loads(text))
    assert course.scenery == Course.from_dict(BLOCK).scenery


CURVE = [[x, 0, 0] for x in range(0, 100, 10)]
BAD: list[tuple[dict[str, Any], str]] = [
    ({"points": []}, "points: has 0"),
    ({"points": BLOCK["points"][:3]}, "at least 4"),
    ({"points": [[0, 0, 0]], "closed": False}, "at least 2"),
    ({"points": [*BLOCK["points"], [0, 0, 20]]}, "must not repeat its first point"),
    ({"points": [[0, 0, 0], [50, 0, 0], [50, 0, 1], [0, 50, 0]]}, r"points\[2\]"),
    ({"points": [[0, 0], [50, 0], [50, 50], [0, 50]]}, r"points\[0\] = \[0, 0\]: must be a list of 3"),
    ({"points": [[0, 0, "high"], *BLOCK["points"]]}, "must be a number"),
    ({"points": [[0, 0, float("nan")], *BLOCK["points"]]}, "must be a finite number"),
    ({"points": [[0, 0, 2e5], *BLOCK["points"]]}, "at most 100000"),
    ({"points": "a road"}, "must be a list"),
    ({"points": [[0, 0, 0], [900, 0, 0], [900, 900, 0], [0, 900, 0]]}, "from 0.2 to 500 m"),
    ({"points": [[0, 0, 0], [100, 0, 60], [100, 100, 60], [0, 100, 0]]}, "% steep"),
    ({"points": [[0, 0, 0], [5, 0, 0], [5, 5, 0], [0, 5, 0]]}, "radius"),
    ({"points": [[0, 0, 0], [50, 0, 0], [51, 1, 0], [0, 1, 0]]}, "radius"),
    ({"points": [[0, 0, 0], [1, 0, 0], [2, 0, 0]], "closed": False}, "long"),
    ({"points": [*CURVE, [-50, 60, 0]], "width": 40}, "width"),
    ({"width": 1}, "width = 1"),
    ({"width": "wide"}, "must be a number"),
    ({"verge": -1}, "verge"),
    ({"laps": 0}, "laps"),
    ({"laps": 1.5}, "whole number"),
    ({"laps": 3, "closed": False}, "not closed"),
    ({"closed": 1}, "true or false"),
    ({"seed": -4}, "seed"),
    ({"name": ""}, "letters"),
    ({"name": "a/b"}, "letters"),
    ({"title": 4}, "a string"),
    ({"widht": 4}, "did you mean 'width'"),
    ({"side_streets": [[[0, 0]]]}, r"side_streets\[0\]: has 1 points"),
    ({"side_streets": [[[0, 0], [0, 0]]]}, r"side_streets\[0\]\[1\]"),
    ({"side_streets": [[[0, 0, 0], [9, 0, 0]]]}, "must be a list of 2"),
    ({"side_streets": 4}, "must be a list"),
    ({"side_street_width": 0}, "side_street_width"),
    ({"land": 3}, "must be a table"),
    ({"land": {"hills": -1}}, "land.hills"),
    ({"land": {"margin": 0}}, "land.margin"),
    ({"land": {"hill": 1}}, "land.hill: unknown key"),
    ({"scenery": {"house_spacing": 1}}, "must be 0 or at least 4"),
    ({"scenery": {"tree_spacing": float("inf")}}, "finite"),
    ({"scenery": {"depth": 1}}, "scenery.depth"),
    ({"scenery": {"depth": 195}}, "scenery.depth"),
]


@pytest.mark.parametrize(
    ("change", "words"), BAD, ids=[f"{index}-{words[:20]}" for index, (_, words) in enumerate(BAD)]
)
def test_what_cannot_be_is_refused_in_one_line(change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        Course.from_dict(BLOCK | change, source="block.toml")
    assert str(caught.value).startswith("block.toml: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"points = [", "not valid TOML"),
        (b"\xff\xfe", "not UTF-8"),
        (b"points = " + b"[" * 5000, "TOML"),
        (b"", "points: has 0"),
        (None, "no such file"),
    ],
)
def test_what_is_no_course_file_is_refused_in_one_line(content: bytes | None, words: str, tmp_path: Path) -> None:
    path = tmp_path / "road.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        Course.load(path)
    assert "road.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_names_get_a_hint() -> None:
    with pytest.raises(InputError, match="did you mean 'city-race'"):
        Course.load("city-rase")


def test_bridges_are_refused() -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 80, endpoint=False)
    eight = np.stack([200 * np.sin(t), 150 * np.sin(t) * np.cos(t), 3 * np.cos(t)], axis=1)
    with pytest.raises(InputError, match="no bridges"):
        Course.from_dict({"name": "eight", "points": eight.tolist()})
    eight[:, 2] = 0.0
    assert Course.from_dict({"name": "eight", "points": eight.tolist()}).length > 500.0


def test_a_course_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_course(Course.from_dict(BLOCK), tmp_path / "nowhere" / "block.toml")
    assert not list(tmp_path.iterdir())
