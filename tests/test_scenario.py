"""Scenario files: what is right is read and written back, what is wrong is one clear line."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from echelon.cli import run
from echelon.errors import InputError
from echelon.scenario import CollieSettings, CrowdSettings, HerdSettings, Scenario, ShotSettings, WorldSettings
from echelon.scenario.files import scenario_names
from echelon.scenario.starting_places import hexagonal_places, overlapping_pair
from echelon.settings import to_toml

ROAD = '[world]\nground = "road"\ncourse = "city-race"\n[crowd]\ncharacter = "cyclist"\n'

# Each: what is wrong, the file, and what the line must say.
MALFORMED: list[tuple[str, str | bytes, str]] = [
    # not TOML
    ("not TOML", "seconds 3", "not valid TOML"),
    ("line of the error", "seconds = 3\n\nseed = = 1\n", "line 3"),
    ("unfinished table", "[crowd\ncount = 3", "line 1"),
    ("unfinished string", 'title = "no end', "not valid TOML"),
    ("key twice", "seed = 1\nseed = 2", "not valid TOML"),
    ("table twice", "[herd]\n[herd]", "not valid TOML"),
    ("JSON", '{"seconds": 3}', "not valid TOML"),
    ("not UTF-8", b'title = "\xff\xfe"', "not UTF-8"),
    ("NUL bytes", b"\0\0\0\0", "not valid TOML"),
    ("deeply nested", "x = " + "[" * 5000, "TOML"),
    # unknown keys and names
    ("unknown key", "secnds = 3", "did you mean 'seconds'"),
    ("unknown key in a table", "[crowd]\ncuont = 3", "did you mean 'count'"),
    ("unknown key far from any", "[herd]\nzzzzzz = 3", "known are"),
    ("unknown table", "[sheep]\ncount = 3", "sheep: unknown key"),
    ("key in the wrong table", "[herd]\ncount = 3", "herd.count: unknown key"),
    ("unknown key in the corral", "[world.corral]\nopnening = 3", "did you mean 'opening'"),
    ("key with a line break", '"a\\nb" = 1', "unknown key"),
    ("unknown character", '[crowd]\ncharacter = "hoper"', "did you mean 'hopper'"),
    ("unknown mode", '[herd]\nmode = "heard"', "did you mean 'herd'"),
    ("unknown driver", '[collie]\ndriver = "cat"', "'dog', 'waypoints'"),
    ("unknown ground", '[world]\nground = "moon"', "'oval', 'plane'"),
    ("unknown integrator", '[engine]\nintegrator = "euler"', "'semi-implicit', 'rk4'"),
    ("unknown until", 'until = "tired"', "'penned'"),
    ("unknown camera", '[shot]\ncamera = "folow"', "did you mean 'follow'"),
    # roads
    ("road without a course", '[world]\nground = "road"\n[crowd]\ncharacter = "cyclist"', "must name a course"),
    ("course without a road", '[world]\ncourse = "city-race"', "needs world.ground = 'road'"),
    (
        "rider at rest on a field",
        '[crowd]\ncharacter = "cyclist"',
        "crowd.start_velocity = [0.0, 0.0]: must be at least 2 m/s for a cyclist",
    ),
    ("hopper on a road", '[world]\nground = "road"\ncourse = "city-race"', "must be one of cyclist"),
    ("corral on a road", ROAD + "[world.corral]\nsize = 12", "must be left out"),
    ("collie on a road", ROAD + "[collie]\nmax_speed = 3", "must be left out on a road"),
    ("positions on a road", ROAD + "positions = [[0, 0]]", "must be left out on a road"),
    ("user on a field", "[user]\nahead = 3", "needs world.ground = 'road'"),
    ("obstacles on a field", '[[obstacles]]\nkind = "car"\ndistance = 3', "needs world.ground = 'road'"),
    ("unknown obstacle", ROAD + '[[obstacles]]\nkind = "cow"\ndistance = 3', "'jogger', 'car', 'barrier'"),
    ("obstacle nowhere", ROAD + '[[obstacles]]\nkind = "car"', "distance"),
    ("moving car", ROAD + '[[obstacles]]\nkind = "car"\ndistance = 3\nspeed = 2', "must be 0 for a car"),
    ("finish on a field", 'until = "finished"', "needs world.ground = 'road'"),
    ("unsorted script", ROAD + "[user]\nkeys = [[5, 3, 0], [4, 3, 0]]", "must be more than 5"),
    ("slow start", ROAD + "[peloton]\nstart_speed = 1", "must be at least slowest"),
    ("all the same lane", ROAD + "[peloton]\nlateral_spacing = 0.3", "riders would overlap"),
    # wrong types
    ("true for a count", "[crowd]\ncount = true", "must be a whole number"),
    ("float for a count", "[crowd]\ncount = 16.0", "must be a whole number"),
    ("string for a number", 'seconds = "20"', "must be a number"),
    ("true for a number", "[herd]\nspacing = true", "must be a number"),
    ("number for a string", "title = 3", "must be a string"),
    ("number for true", "[herd]\nwander = 1", "must be true or false"),
    ("string for a list", '[crowd]\nstart_center = "0, 0"', "must be a list"),
    ("number for a table", "crowd = 3", "must be a table"),
    ("list of tables for a table", "[[crowd]]\ncount = 3", "must be a table"),
    ("table for a number", "[seconds]\nx = 1", "must be a number"),
    ("three numbers for a place", "[crowd]\nstart_center = [0, 0, 0]", "must be a list of 2"),
    ("places that are numbers", "[crowd]\npositions = [1, 2]", "crowd.positions[0] = 1"),
    ("a date for a number", "seconds = 1979-05-27", "must be a number"),
    ("true for a frame rate", "frame_rate = true", "24, 25, 30, 50, 60"),
    # numbers out of bounds
    ("frame rate", "frame_rate = 29", "24, 25, 30, 50, 60"),
    ("negative count", "[crowd]\ncount = -1", "crowd.count = -1: must be at least 1"),
    ("nobody", "[crowd]\ncount = 0", "must be at least 1"),
    ("too many", "[crowd]\ncount = 100000000000", "at most 1000000"),
    ("no time", "seconds = 0", "must be above 0"),
    ("less than a frame", "seconds = 0.001", "at least one frame"),
    ("negative time", "seconds = -20.0", "seconds = -20.0: must be above 0"),
    ("NaN time", "seconds = nan", "must be a finite number"),
    ("infinite time", "seconds = inf", "must be a finite number"),
    ("beyond floats", "seconds = 1" + "0" * 400, "must be a finite number"),
    ("NaN in a place", "[crowd]\nstart_center = [0.0, nan]", "crowd.start_center[1] = nan"),
    ("infinite position", "[crowd]\npositions = [[0.0, -inf]]", "crowd.positions[0][1] = -inf"),
    ("NaN gain", "[herd]\ngain = nan", "herd.gain = nan"),
    ("negative seed", "seed = -1", "at least 0"),
    ("seed beyond 31 bits", "seed = 2147483648", "at most 2147483647"),
    ("negative radius", "[herd]\nradius = -0.35", "herd.radius"),
    ("fewer than no substeps", "[engine]\nsubsteps = -6", "at least 0"),
    ("negative threads", "[engine]\nthreads = -2", "at least 0"),
    ("lanes of no machine", "[engine]\nlanes = 3", "0, 1, 4, 8, 16"),
    ("tick that does not divide", "[engine]\nsubsteps = 40\ntick = 7", "must divide the substeps"),
    ("picture too small", "[shot]\nsize = [0, 360]", "at least 16 and at most 8192 pixels"),
    ("shot that ends first", "[shot]\nfirst_frame = 9\nlast_frame = 5", "shot.last_frame"),
    ("shot that ends first, from the end", "[shot]\nfirst_frame = -9\nlast_frame = -20", "shot.last_frame"),
    ("picture of an odd size", "[shot]\nsize = [641, 360]", "even numbers"),
    # what does not go together
    ("name", 'name = "../up"', "must be letters, digits"),
    ("no name", 'name = ""', "must be letters, digits"),
    ("penned without a corral", 'until = "penned"', "needs a world.corral"),
    ("oval wider than long", "[world]\nhalf_length = 20.0", "world.half_length = 20: must be"),
    ("opening wider than the corral", "[world.corral]\nopening = 12.0", "at most the size, 10 m"),
    ("corral outside", "[world.corral]\ncenter = [44.0, 0.0]", "must be inside the infield"),
    ("corral that faces nowhere", "[world.corral]\nfacing = [0.0, 0.0]", "direction of length 1"),
    (
        "the same place twice",
        "[crowd]\npositions = [[1, 1], [2, 2], [1, 1]]",
        "crowd.positions[2] = [1.0, 1.0]: overlaps",
    ),
    ("places that overlap", "[crowd]\npositions = [[0, 0], [0.5, 0.4]]", "twice the radius, 0.7 m"),
    ("pattern that overlaps", "[crowd]\nstart_spacing = 0.5", "crowd.start_spacing = 0.5"),
    ("jitter that overlaps", "[crowd]\ncount = 105\nstart_jitter = 5.0", "jitter of 5 m"),
    ("place outside", "[crowd]\npositions = [[60, 0]]", "outside the infield"),
    ("pattern outside", "[crowd]\nstart_center = [0, 100]", "outside the infield"),
    (
        "crowd larger than the field",
        "[crowd]\ncount = 2000",
        "across a fence; about 453 fit: lower crowd.count or crowd.start_spacing (2.5 m), or raise world.half_width "
        "and world.half_length to 60 m",
    ),
    (
        "more than a corral leaves room for",
        "[world.corral]\n[crowd]\ncount = 700",
        "or move crowd.start_center or the fences",
    ),
    ("place across a fence", "[world.corral]\n[crowd]\npositions = [[30, 0]]", "across a fence"),
    ("count of places", "[crowd]\ncount = 3\npositions = [[0, 0]]", "must be the number of positions, 1"),
    ("collie outside", "[collie]\nstart = [-60, 0]", "collie.start"),
    ("waypoints missing", '[collie]\ndriver = "waypoints"', "at least one"),
    ("waypoints out of order", "[collie]\nwaypoints = [[5, 0, 0], [3, 1, 0]]", "collie.waypoints[1]"),
    ("waypoints at one time", "[collie]\nwaypoints = [[5, 0, 0], [5, 1, 0]]", "later than 5 s"),
    ("waypoint in the past", "[collie]\nwaypoints = [[-1, 0, 0]]", "at least 0 s"),
    ("waypoint outside", "[collie]\nwaypoints = [[1, 0, 40]]", "inside the infield"),
    ("collie that starts too fast", "[collie]\nstart_speed = 9.0", "at most max_speed"),
]


def refused(file: Path, expected: str = "", overrides: tuple[str, ...] = ()) -> None:
    """Loading ``file`` gives an InputError of one line that names it."""
    with pytest.raises(InputError) as error:
        Scenario.load(file, overrides)
    text = str(error.value)
    assert text.isprintable(), text
    assert len(text) - len(str(file)) < 640
    assert str(file) in text
    assert expected in text


def test_a_crowd_fits_where_the_message_says() -> None:
    """The number it gives fits, one more does not; and so does everybody in the field that it gives."""
    assert Scenario.load("herd", ["crowd.count=453"]).crowd.count == 453
    with pytest.raises(InputError, match="about 453 fit"):
        Scenario.load("herd", ["crowd.count=454"])
    wide = ["world.half_width=60", "world.half_length=60"]
    assert Scenario.load("herd", ["crowd.count=2000", *wide]).crowd.count == 2000


@pytest.mark.parametrize(("text", "expected"), [case[1:] for case in MALFORMED], ids=[case[0] for case in MALFORMED])
def test_malformed_files(
    tmp_path: Path,
    text: str | bytes,
    expected: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One line from Python; from the command the same line, exit code 2, and nothing written."""
    file = tmp_path / "wrong.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    refused(file, expected)

    monkeypatch.chdir(tmp_path)
    assert run(["simulate", str(file), "--out", str(tmp_path / "stage.usd")]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert expected in said.err
    assert list(tmp_path.iterdir()) == [file]


def test_there_are_at_least_fifty_malformed_files() -> None:
    assert len(MALFORMED) >= 50


# ---- generated -----------------------------------------------------------------------------------------------------
def leaves(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Every value that is not a table, and the way to it."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from leaves(value, (*path, key))
    elif isinstance(data, list) and data:
        for index, value in enumerate(data):
            yield from leaves(value, (*path, index))
    else:
        yield path, data


def replaced(data: Any, path: tuple[Any, ...], value: Any) -> Any:
    """A copy of plain data with one value replaced."""
    if not path:
        return value
    if isinstance(data, dict):
        return {key: replaced(inner, path[1:], value) if key == path[0] else inner for key, inner in data.items()}
    return [replaced(inner, path[1:], value) if index == path[0] else inner for index, inner in enumerate(data)]


COMPLETE = Scenario.load("border-collie", ["collie.waypoints=[[1,0,0],[2,1,0]]"]).to_dict()
NUMBERS = [path for path, value in leaves(COMPLETE) if isinstance(value, int | float) and not isinstance(value, bool)]
OTHERS = [path for path, _ in leaves(COMPLETE) if path not in NUMBERS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("generated")


quick = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@quick
@given(path=st.sampled_from(NUMBERS), value=st.sampled_from([math.nan, math.inf, -math.inf, "7", [], {"x": 1}, False]))
def test_a_number_that_is_none(folder: Path, path: tuple[Any, ...], value: Any) -> None:
    file = folder / "number.toml"
    file.write_text(to_toml(replaced(COMPLETE, path, value)))
    refused(file)


@quick
@given(path=st.sampled_from(OTHERS), value=st.sampled_from([math.nan, 3, -1.5, [[[]]], {"x": 1}, "nonsense/", [{}]]))
def test_a_word_or_list_that_is_none(folder: Path, path: tuple[Any, ...], value: Any) -> None:
    free_text = path[-1] in ("title", "description") and isinstance(value, str)
    if not free_text:
        file = folder / "word.toml"
        file.write_text(to_toml(replaced(COMPLETE, path, value)))
        refused(file)


@quick
@given(path=st.sampled_from(NUMBERS + OTHERS), letters=st.text(min_size=1, max_size=12))
def test_a_key_that_is_unknown(folder: Path, path: tuple[Any, ...], letters: str) -> None:
    keys = [part for part in path if isinstance(part, str)]
    table = COMPLETE
    for key in keys[:-1]:
        table = table[key]
    if letters in table:
        return
    try:
        text = to_toml(replaced(COMPLETE, tuple(keys[:-1]), {**table, letters: 1}))
        file = folder / "key.toml"
        file.write_text(text)
    except UnicodeEncodeError:
        return
    refused(file, "unknown key")


@quick
@given(junk=st.binary(min_size=1, max_size=60), place=st.integers(0, 2000))
def test_bytes_thrown_into_a_file(folder: Path, junk: bytes, place: int) -> None:
    """Whatever stands in a file, it is a scenario or the one line."""
    text = to_toml(COMPLETE).encode()
    file = folder / "junk.toml"
    file.write_bytes(text[:place] + junk + text[place:])
    try:
        Scenario.load(file)
    except InputError:
        refused(file)


@quick
@given(text=st.text(max_size=40))
def test_anything_as_an_override(text: str) -> None:
    assert complaint(text).isprintable()


def complaint(override: str) -> str:
    """What is said about an override; nothing about a good one."""
    try:
        Scenario.load("border-collie", [override])
    except InputError as error:
        return str(error)
    return ""


# ---- what is right -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", scenario_names())
def test_the_scenarios_that_ship(name: str, tmp_path: Path) -> None:
    scenario = Scenario.load(name)
    assert scenario.name == name
    assert scenario.title
    assert scenario.description.endswith(".")
    assert "\n" not in scenario.description
    assert Scenario.from_dict(scenario.to_dict()) == scenario
    file = tmp_path / "again.toml"
    file.write_text(scenario.to_toml())
    assert Scenario.load(file) == scenario


def test_the_scenarios_of_the_paper() -> None:
    collie = Scenario.load("border-collie")
    assert (collie.crowd.count, collie.seconds, collie.until) == (16, 180.0, "penned")
    corral = collie.world.corral
    assert corral is not None
    assert (corral.size, corral.opening, corral.penned_fraction, corral.penned_seconds) == (10.0, 6.0, 0.75, 10.0)
    assert collie.herd.flee_distance == 15.0
    changes = Scenario.load("velocity-changes")
    assert (changes.crowd.count, changes.herd.mode, changes.herd.change, changes.herd.period) == (
        105,
        "random",
        1.0,
        2.0,
    )


def test_the_name_is_that_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "my scene.toml"
    file.write_text("seconds = 3")
    assert Scenario.load(file).name == "my-scene"
    assert Scenario.load(file).step_count == 90


def test_overrides() -> None:
    scenario = Scenario.load(
        "border-collie",
        ["crowd.count=3", "herd.mode=constant", 'title="a = b"', "world.corral.opening = 4", "herd.wander=false"],
    )
    assert scenario.crowd.count == 3
    assert scenario.herd.mode == "constant"
    assert scenario.title == "a = b"
    assert scenario.world.corral is not None
    assert scenario.world.corral.opening == 4.0
    assert scenario.herd.wander is False
    assert Scenario.load("herd", ["collie.driver=dog"]).collie == CollieSettings()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("crowd.count", "must be key=value"),
        ("=3", "must be key=value"),
        ("crowd..count=3", "must be key=value"),
        ("crowd.count=", "must be a whole number"),
        ("crowd.cuont=3", "border-collie, overridden: crowd.cuont: unknown key; did you mean 'count'"),
        ("crowd.count=-4", "border-collie, overridden: crowd.count = -4"),
        ("crowd.count.x=3", "crowd.count is not a table"),
        ("seconds=nan", "finite"),
        ("herd.mode='random\n'", "must be"),
        ("seconds=3\nseed=2", "must be a number"),
    ],
)
def test_wrong_overrides(text: str, expected: str) -> None:
    with pytest.raises(InputError) as error:
        Scenario.load("border-collie", [text])
    assert expected in str(error.value)
    assert str(error.value).isprintable()


def test_an_error_beside_an_override_is_not_laid_to_it(tmp_path: Path) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text("seconds = -3")
    with pytest.raises(InputError) as error:
        Scenario.load(file, ["seed=3"])
    assert "overridden" not in str(error.value)


def test_files_that_are_not_there(tmp_path: Path) -> None:
    refused(tmp_path / "none.toml", "no such file")
    (tmp_path / "folder.toml").mkdir()
    refused(tmp_path / "folder.toml", "cannot be read")
    with pytest.raises(InputError, match="did you mean 'border-collie'"):
        Scenario.load("border-colie")
    with pytest.raises(InputError, match=r"known are .*border-collie"):
        Scenario.load("sheep")
    with pytest.raises(InputError, match="no such scenario") as error:
        Scenario.load("two\nlines")
    assert "\n" not in str(error.value)


def test_settings_made_in_python_are_checked_alike() -> None:
    with pytest.raises(InputError, match=r"herd\.spacing = -1"):
        HerdSettings(spacing=-1.0)
    with pytest.raises(InputError, match=r"crowd\.count = 2\.5"):
        CrowdSettings(count=2.5)  # type: ignore[arg-type]
    assert HerdSettings(spacing=3).spacing == 3.0
    assert isinstance(HerdSettings(spacing=3).spacing, float)
    scenario = Scenario("python", crowd=CrowdSettings(positions=((0.0, 0.0), (1.0, 0.0)), count=2))
    np.testing.assert_array_equal(scenario.start_positions(), [[0, 0], [1, 0]])


def test_overrides_leave_the_callers_data_alone() -> None:
    data = Scenario.load("herd").to_dict()
    before = Scenario.load("herd").to_dict()
    Scenario.from_dict(data, overrides=["crowd.count=3", "world.half_length=50"])
    assert data == before


@quick
@given(
    st.recursive(
        st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(st.characters(exclude_categories=["Cs"])),
        lambda inner: st.lists(inner, max_size=3),
        max_leaves=5,
    ),
    st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=5),
)  # fmt: skip
def test_toml_is_read_back(value: Any, key: str) -> None:
    data = {key: value, "table": {key: value, "inner": {"x": value}}}
    if key != "table":
        assert tomllib.loads(to_toml(data)) == data


# ---- where they start ----------------------------------------------------------------------------------------------
def test_start_positions_do_not_depend_on_how_many_there_are() -> None:
    few, many = (Scenario.load("herd", [f"crowd.count={count}"]).start_positions() for count in (16, 105))
    np.testing.assert_array_equal(many[:16], few)
    other = Scenario.load("herd", ["population_seed=2"]).start_positions()
    assert not np.any(other == few)
    np.testing.assert_array_equal(Scenario.load("herd", ["seed=2"]).start_positions(), few)
    assert np.abs(other - few).max() <= 0.6


def test_the_pattern_is_hexagonal() -> None:
    places = hexagonal_places(500)
    gaps = np.linalg.norm(places[:, None] - places, axis=-1) + 9.0 * np.eye(500)
    assert gaps.min() == pytest.approx(1.0)
    inside = np.linalg.norm(places, axis=1) < 8.0
    assert set((gaps < 1.001).sum(axis=1)[inside]) == {6}
    assert np.all(np.diff(np.linalg.norm(places, axis=1)) > -1e-9)


@quick
@given(
    st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=1, max_size=40),
    st.floats(0.05, 3.0),
)
def test_overlaps_are_found(points: list[tuple[float, float]], least: float) -> None:
    positions = np.array(points)
    gaps = np.hypot(*(positions[:, None] - positions).transpose(2, 0, 1))
    gaps[np.tril_indices(len(points))] = np.inf
    pair = overlapping_pair(positions, least)
    assert (pair is not None) == bool((gaps < least).any())
    if pair is not None:
        a, b, distance = pair
        assert a < b
        assert distance == gaps[a, b] < least


@pytest.mark.parametrize(
    ("first", "last", "frames"),
    [
        (0, -1, (0, 99)),
        (10, 20, (10, 20)),
        (-30, -1, (70, 99)),
        (10, 500, (10, 99)),
        (-500, 3, (0, 3)),
        (300, -1, (99, 99)),
    ],
)
def test_the_frames_of_a_shot(first: int, last: int, frames: tuple[int, int]) -> None:
    assert ShotSettings(first_frame=first, last_frame=last).frames(100) == frames


def test_room_and_clearance() -> None:
    world = WorldSettings(ground="oval", half_length=45.0, half_width=28.0)
    points = np.array([[0.0, 0.0], [0.0, 27.0], [45.0, 0.0], [46.0, 0.0], [17.0, -28.0], [17 + 28 / math.sqrt(2)] * 2])
    np.testing.assert_allclose(world.room(points)[:5], [28.0, 1.0, 0.0, -1.0, 0.0])
    penned = Scenario.load("border-collie").world
    np.testing.assert_allclose(penned.clearance(np.array([[25.0, 0.0], [20.0, 0.0], [31.0, 0.0]])), [5.0, 3.0, 1.0])
    assert np.isinf(WorldSettings(ground="plane").clearance(np.array([1e6, 0.0])))
