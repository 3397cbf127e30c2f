"""Maneuver files: what they mean, and what is said of those that are wrong."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from echelon.agents.gymnasts.body import gymnast_body
from echelon.agents.gymnasts.formulas import formula
from echelon.agents.gymnasts.gymnast import SETTINGS, Gymnast
from echelon.agents.gymnasts.script import load_script, parse_script
from echelon.errors import InputError

ROW = '[[row]]\nname = "stand"\n'
LAYOUT = Gymnast.script


def test_a_row_is_laid_out_as_its_file_says() -> None:
    text = (
        "[parameters]\nbend = 0.4\n"
        + ROW
        + 'duration = 0.5\nchannels = { knee = "bend + 0.1", left_elbow = 1.0 }\ndurations = { knee = 0.2 }\n'
        + 'gains = { hip = 0.8, ankle = [4.0, 0.5] }\nsettings = { com_x = "table(bend, [0, 1], [0, 0.1])" }\n'
        + 'next = [{ to = "stand", when = { vz = [-1, inf] } }]\n'
    )
    (row,) = parse_script(text, "a.toml").table(gymnast_body("male"), {"bend": 0.6})

    def setting(name: str) -> float:
        return float(row[LAYOUT.setting_place + list(SETTINGS).index(name)])

    for side in ("left", "right"):
        assert row[LAYOUT.channels.index(f"{side}_knee")] == pytest.approx(0.7)
        assert row[LAYOUT.duration_place + LAYOUT.channels.index(f"{side}_knee")] == pytest.approx(0.2)
    assert row[LAYOUT.channels.index("left_elbow")] == 1.0
    assert math.isnan(row[LAYOUT.channels.index("right_elbow")])
    assert (setting("kp.hip"), setting("kv.hip"), setting("kp.ankle"), setting("kv.ankle")) == pytest.approx(
        (0.8, 1.0, 4.0, 0.5)
    )
    assert setting("com_x") == pytest.approx(0.06)
    measure = LAYOUT.measures.index("vz")
    assert row[LAYOUT.transition_place : LAYOUT.transition_place + 4].tolist() == [0.0, measure, -1.0, math.inf]


def test_individuals_differ_within_the_spread_whatever_the_count() -> None:
    script = parse_script("[parameters]\na = { value = 1.0, spread = 0.1 }\nb = 2.0\n" + ROW, "a.toml")
    many = script.varied(500, 3)
    values = np.array([one["a"] for one in many])
    assert script.varied(7, 3) == many[:7]
    assert set(many[0]) == {"a"}
    assert values.min() > 0.9
    assert values.max() < 1.1
    assert values.std() == pytest.approx(0.2 / math.sqrt(12.0), rel=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", r"a\.toml: is not TOML"),
        ("a = " + "[" * 5000, r"a\.toml: is not TOML: nested too deeply"),
        ("", "needs rows"),
        ("row = 3", "needs rows"),
        ("row = [3]", "needs rows"),
        ("weight = 3\n" + ROW, "'weight' is not known"),
        ('body = "dog"\n' + ROW, "body: 'dog' is not known; known are female, male"),
        ("parameters = 3\n" + ROW, "parameters = 3: must be a table"),
        ("[parameters]\nleg = 1.0\n" + ROW, "'leg' must be a word .* not leg or pi"),
        ('[parameters]\na = "soon"\n' + ROW, "must be a number, or a table with a value"),
        ('[parameters]\na = { value = "x" }\n' + ROW, r"parameters\.a\.value = 'x': 'x' is not known"),
        ("[parameters]\na = { value = 3.0, most = 2.0 }\n" + ROW, "nor value beyond least and most"),
        ("[parameters]\na = { value = 3.0, spread = -1 }\n" + ROW, "spread must not be negative"),
        ("[parameters]\na = nan\n" + ROW, "must be a finite number"),
        (ROW + ROW, "'stand' stands twice"),
        (ROW + "lengths = 3", "'lengths' is not known; did you mean 'legs'"),
        (ROW + "channels = 3", "channels = 3: must be a table"),
        (ROW + "channels = { kne = 1 }", "'kne' is not known; did you mean 'knee'"),
        (ROW + 'channels = { knee = "bend" }', "'bend' is not known"),
        (ROW + 'channels = { knee = "1 / 0" }', "must be a finite number"),
        (ROW + 'channels = { knee = "__import__(1)" }', "is no formula"),
        (ROW + "channels = { knee = true }", "must be a number or a formula"),
        (ROW + "channels = { knee = inf }", "must be a finite number"),
        (ROW + 'duration = "soon"', "duration = 'soon': 'soon' is not known"),
        (ROW + "duration = [1]", "must be a number or a formula"),
        (ROW + 'phase = "fligt"', "did you mean 'flight'"),
        (ROW + 'pose = "tuk"', "did you mean 'tuck'"),
        (ROW + 'start = "here"', "'here' is not known"),
        (ROW + "legs = { hip = 1 }", "legs: needs a length"),
        (ROW + "gains = { hip = [1, 2, 3] }", r"must be kp, or \[kp, kv\]"),
        (ROW + "settings = { balanc = 1 }", "did you mean 'balance'"),
        (ROW + "capture = { vz = 3 }", r"must be \[least, most\]"),
        (ROW + 'next = "stand"', "next = 'stand': must be a list"),
        (ROW + "next = [3]", "next: 3 must be a table"),
        (ROW + 'next = [{ to = "sit" }]', "'sit' is not known"),
        (ROW + "next = [{ when = { vz = [0, 1] } }]", "needs the row that it leads to"),
        (ROW + 'next = [{ to = "stand", when = { speed = [0, 1] } }]', "'speed' is not known"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        parse_script(text, "a.toml")
    assert str(error.value).startswith("a.toml")
    assert "\n" not in str(error.value)


def test_files_that_are_none_are_said_so(tmp_path: Path) -> None:
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe9'")
    for path, message in (
        ("standing-back-somersalt", "did you mean 'standing-back-somersault'"),
        (tmp_path / "none.toml", "cannot be read"),
        (tmp_path / "n\0ne.toml", "cannot be read"),
        (tmp_path / "latin.toml", "is not UTF-8"),
    ):
        with pytest.raises(InputError, match=message):
            load_script(path)


def test_a_parameter_that_a_script_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match="'heigth' is not known; did you mean 'height'"):
        load_script("vertical-leap").table(gymnast_body("male"), {"heigth": 1.0})


def test_formulas_are_of_numbers_and_of_arrays() -> None:
    found = formula("here", "table(x, [0, 1, 2], [0, 10, 0]) + max(-x, 0.5) * pi")
    assert found.names == ("x",)
    x = np.array([0.5, 1.5, -2.0])
    assert found.value({"x": x}) == pytest.approx([5.0 + 0.5 * math.pi, 5.0 + 0.5 * math.pi, 2.0 * math.pi])
    for wrong in ("table(1, [1], [1, 2])", "table(1, 2, 3)", "[1, 2]", "x.y", "abs(1, 2)", "1 +"):
        with pytest.raises(InputError, match="is no formula"):
            formula("here", wrong)
