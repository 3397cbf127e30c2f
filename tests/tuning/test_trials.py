"""Trials: one batch after another on the same engine, copies alike for all candidates."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.characters import character_named
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.script import parse_script
from echelon.simulation.performance import Performance
from echelon.tuning.objective import parse_objective
from echelon.tuning.trials import Trials
from tests.tuning.toy import OBJECTIVE, SCRIPT

TOY = parse_script(SCRIPT, "bend.toml")
KNEES = parse_objective(OBJECTIVE, "knees.toml")


@pytest.fixture(scope="module")
def male() -> Gymnast:
    character = character_named("gymnast-male")
    assert isinstance(character, Gymnast)
    return character


def test_a_restarted_performance_is_a_new_one_to_the_last_bit(male: Gymnast) -> None:
    first = [TOY.table(male.body, {"deep": deep}) for deep in (0.84, 0.7, 0.75)]
    second = [TOY.table(male.body, {"deep": deep, "arms": 1.0}) for deep in (0.72, 0.8, 0.83)]
    performance = Performance(male, first, threads=1)
    performance.run(0.3)
    performance.restart(second)
    assert performance.frames == 0
    seen = performance.run(0.3, ["q", "row", "com_x"])
    # Tables of another shape, and back.
    performance.restart([table[:1] for table in first])
    performance.run(0.1)
    performance.restart(second)
    again = performance.run(0.3, ["q", "row", "com_x"])
    fresh = Performance(male, second, threads=1).run(0.3, ["q", "row", "com_x"])
    for name, values in fresh.items():
        assert np.array_equal(seen[name], values)
        assert np.array_equal(again[name], values)
    with pytest.raises(ValueError, match="2 scripts to follow for 3 gymnasts"):
        performance.restart(second[:2])


def test_copies_cover_the_spreads_evenly(male: Gymnast) -> None:
    trials = Trials(male, TOY, KNEES, seed=5)
    offsets = trials.perturbations(8, 0, 1.5)
    assert all(offset.keys() == {"deep"} for offset in offsets)
    parts = sorted(int((offset["deep"] / (1.5 * 0.01) + 1.0) / 2.0 * 8.0) for offset in offsets)
    assert parts == list(range(8))
    assert trials.perturbations(8, 0, 1.5) == offsets
    assert trials.perturbations(8, 1, 1.5) != offsets
    assert Trials(male, TOY, KNEES, seed=6).perturbations(8, 0, 1.5) != offsets


def test_verdicts_do_not_depend_on_threads_or_company(male: Gymnast) -> None:
    stage = KNEES.stage[1]
    candidates = [{"deep": 0.70 + 0.01 * i, "arms": 0.1 * i} for i in range(10)]
    one = Trials(male, TOY, KNEES, threads=1).judge(stage, candidates, copies=2, number=3)
    trials = Trials(male, TOY, KNEES, threads=2)
    two = trials.judge(stage, candidates, copies=2, number=3)
    few = trials.judge(stage, candidates[4:6], copies=2, number=3)
    assert np.array_equal(one.objective, two.objective)
    assert np.array_equal(one.terms, two.terms)
    assert np.array_equal(one.success, two.success)
    assert np.array_equal(few.objective, one.objective[4:6])
    # The objective is what the terms and the failures cost, the mean of the copies.
    assert one.objective == pytest.approx(one.terms.sum(axis=1) + stage.failures * (1.0 - one.success))
    assert one.terms[:, 0] == pytest.approx(
        [abs(0.1 * i - 1.0) / (1.0 + abs(0.1 * i - 1.0) / 100.0) for i in range(10)]
    )
