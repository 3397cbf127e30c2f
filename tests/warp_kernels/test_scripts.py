"""Scripts: paths are smooth, the kernel changes rows as the reference does, and captures say what was missed."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.characters import character_named
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.script import parse_script
from echelon.simulation.performance import Performance, padded
from echelon.warp_kernels.reference_run import ReferenceRun
from echelon.warp_kernels.scripts import path_now

SCRIPT = """
name = "nod"
[parameters]
time = 0.0485
[[row]]
name = "first"
duration = 0.2
channels = { knee = 0.3, left_elbow = 0.9, shoulder = 0.4 }
settings = { balance = 1, com_x = 0.01 }
next = [{ to = "third", when = { com_height = [5.0, inf] } }, { to = "second", when = { row_age = ["time", inf] } }]
[[row]]
name = "second"
phase = "crouch"
start = "measured"
duration = 0.1
channels = { left_elbow = 0.1, spine_bend = 0.2 }
gains = { hip = [0.8, 1.2] }
settings = { balance = 0.5 }
capture = { com_height = [0.5, 1.5], vz = [3.0, 4.0], upright = [0.9, 1.0] }
[[row]]
name = "third"
channels = { knee = 2.0 }
"""


@pytest.fixture(scope="module")
def male() -> Gymnast:
    character = character_named("gymnast-male")
    assert isinstance(character, Gymnast)
    return character


def test_a_path_starts_with_its_slope_and_ends_at_rest() -> None:
    path = {"start": 0.3, "slope": 2.0, "target": -0.5, "duration": 0.4}
    ages = np.linspace(0.0, 0.6, 601)
    value, rate = path_now({**path, "age": ages})
    assert value[0] == pytest.approx(0.3)
    assert rate[0] == pytest.approx(2.0)
    assert value[ages >= 0.4] == pytest.approx(-0.5)
    assert rate[ages >= 0.4] == pytest.approx(0.0, abs=1e-12)
    # The rate is the value's derivative.
    assert np.gradient(value, ages)[1:399] == pytest.approx(rate[1:399], abs=2e-3)


def test_the_kernel_changes_rows_as_the_reference_does(male: Gymnast) -> None:
    script = parse_script(SCRIPT, "nod.toml")
    tables = [script.table(male.body), script.table(male.body, {"time": 0.0185})]
    people = male.population(2, 0, 0.0, True)
    native = Performance(male, tables)
    reference = ReferenceRun(
        male,
        people.q,
        people.u,
        step=1.0 / 1200.0,
        tick=native.engine.tick,
        parameters=people.parameters,
        memory={**people.memory, "first_row": np.array([0.0, 3.0])},
        scripts=padded(tables).reshape(-1, Gymnast.script.row_size),
    )
    rows = []
    for _ in range(2):
        native.run(1.0 / 30.0)
        reference.frame(40)
        rows.append(native.now("row").tolist())
        for name in ("row_age", "missed", "wanted.left_elbow", "wanted_rate.left_elbow", "com_height", "row.kp.hip"):
            assert native.now(name) == pytest.approx(reference.state.memory[name], abs=2e-4), name
        assert native.now("q") == pytest.approx(reference.q, abs=2e-4)
    # The one whose time is shorter left its first row in the first frame, the other in the second.
    assert rows == [[0.0, 1.0], [1.0, 1.0]]
    # Of three captures only that of the vertical speed failed.
    assert native.now("missed").tolist() == [2.0, 2.0]
    assert native.now("row.balance").tolist() == [0.5, 0.5]


def test_a_row_that_is_not_finite_harms_nobody_else(male: Gymnast) -> None:
    script = parse_script(SCRIPT, "nod.toml")
    sound = script.table(male.body)
    broken = sound.copy()
    broken[1, Gymnast.script.setting_place] = np.inf
    alone = Performance(male, [sound, sound])
    beside = Performance(male, [sound, broken])
    for run in (alone, beside):
        run.run(0.2)
    assert beside.engine.frozen.tolist() == [False, True]
    assert np.array_equal(alone.now("q")[0], beside.now("q")[0])


def test_everybody_does_the_same_whatever_the_threads(male: Gymnast) -> None:
    script = parse_script(SCRIPT, "nod.toml")
    tables = [script.table(male.body, {"time": 0.01 * (1 + place % 7)}) for place in range(24)]
    seen = []
    for threads in (1, 2):
        run = Performance(male, tables, threads=threads)
        run.run(0.2)
        seen.append(run.engine.full_state()["state"])
        run.close()
    assert np.array_equal(seen[0], seen[1])
