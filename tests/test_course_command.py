"""`echelon course`: what it says, what it writes, and with which code it ends."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from echelon import cli
from echelon.terrain.course import Course
from tests.terrain.gps_tracks import ellipse, written


@pytest.fixture
def ride(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return written(tmp_path, ellipse())


def test_a_track_is_imported_and_what_was_done_is_said(ride: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["course", "import", ride.name]) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert "closed course of 22" in err
    assert "bound 5 m" in err
    assert "wrote ride.toml" in err
    course = Course.load("ride.toml")
    assert course.closed
    assert course.width == 6.0


def test_options_reach_the_course(ride: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = "--out sunday.toml --name sunday --width 7 --smooth 2 --gap 50 --close 0 --track 1 --json"
    assert cli.run(["course", "import", ride.name, *line.split()]) == 0
    out, err = capsys.readouterr()
    report = json.loads(out)
    assert err == ""
    assert report["course"] == "sunday.toml"
    assert report["name"] == "sunday"
    assert report["bound"] == 2.0
    assert report["closed"] is False
    course = Course.load("sunday.toml")
    assert (course.name, course.width, course.closed) == ("sunday", 7.0, False)


def test_quiet_says_nothing(ride: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["course", "import", ride.name, "--quiet"]) == 0
    assert cli.run(["course", "plot", "ride.toml", "--out", "ride.png", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_describe_tells_length_climbs_and_corners(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["course", "describe", "city-race"]) == 0
    text = capsys.readouterr().out
    assert "counter-clockwise" in text
    assert "+12.9" in text
    assert "climb at" in text
    assert "corner at" in text
    assert cli.run(["course", "describe", "city-race", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["length"] == pytest.approx(13_000.0, rel=0.01)
    assert facts["counter_clockwise"] is True
    assert len(facts["corners"]) >= 12
    assert len(facts["climbs"]) >= 6


@pytest.mark.parametrize("name", ["ride.png", "ride.svg", "ride.pdf"])
def test_a_course_is_drawn(name: str, ride: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["course", "plot", ride.name, "--out", name]) == 0
    assert f"wrote {name}" in capsys.readouterr().err
    assert Path(name).stat().st_size > 5_000


@pytest.mark.parametrize(
    "line",
    [
        "course import none.gpx",
        "course import ride.gpx --out ride.gpx",
        "course import ride.gpx --out nowhere/ride.toml",
        "course import ride.gpx --smooth 0",
        "course import ride.gpx --width x",
        "course import ride.gpx --track 7",
        "course import ride.gpx --name a/b",
        "course import",
        "course describe nothing",
        "course describe none.toml",
        "course plot city-race",
        "course plot city-race --out picture.bmp",
        "course plot none.gpx --out ride.png",
        "course draw city-race",
        "course",
    ],
)
def test_wrong_input_is_one_line_and_code_2(line: str, ride: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(path.name for path in ride.parent.iterdir())
    assert cli.run(line.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("echelon: ")
    assert err.count("\n") == 1
    assert sorted(path.name for path in ride.parent.iterdir()) == before
