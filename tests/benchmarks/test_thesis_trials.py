"""What experiments of the fidelity report ask of the gymnasts that they watched."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.gymnasts.script import parse_script
from echelon.benchmarks.thesis.experiments import FidelitySettings
from echelon.benchmarks.thesis.published import EXPERIMENTS, published_rows, rows_by_body
from echelon.benchmarks.thesis.trials import (
    STANDS_AFTER,
    STILL,
    arrivals,
    first_frame,
    gymnast_of,
    in_frame,
    rests_on_feet,
    stays,
    trials,
)

TIME = np.array([[0.0], [1.0], [2.0], [3.0], [4.0], [5.0]])
SCRIPT = parse_script(
    """
[[row]]
name = "fall"
phase = "standing"
next = [{ to = "stand", when = { row_age = [1.0, inf] } }]
[[row]]
name = "stand"
phase = "standing"
""",
    "a script of two rows",
)


def frames(*of_agents: list[float]) -> np.ndarray:
    return np.array(of_agents).T


def test_the_first_frame_in_a_row_and_the_moment_it_was_reached() -> None:
    seen = {
        "row": frames([0, 0, 1, 1], [0, 1, 0, 1], [0, 0, 0, 0]),
        "time": frames(*[[1.0, 2.0, 3.0, 4.0]] * 3),
        "row_age": frames([0.5, 1.5, 0.25, 1.25], [0.5, 0.75, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]),
    }
    assert first_frame(SCRIPT, seen, "stand").tolist() == [2, 1, -1]
    np.testing.assert_array_equal(arrivals(SCRIPT, seen, "stand"), [2.75, 1.25, np.nan])


def test_each_gymnast_s_value_in_a_frame_of_its_own() -> None:
    values = frames([1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0])
    assert in_frame(values, np.array([2, 0, -1])).tolist() == [3.0, 4.0, 7.0]
    pairs = np.stack([values, -values], axis=2)
    assert in_frame(pairs, np.array([2, 0, -1])).tolist() == [[3.0, -3.0], [4.0, -4.0], [7.0, -7.0]]


def test_who_stays_so_is_so_from_its_moment_to_the_end() -> None:
    late = [False, False, False, True, True, True]
    once = [True, True, True, True, False, True]
    so = np.array([late, late, once, [True] * 6, [True] * 6]).T
    since = np.array([3.0, 2.0, 0.0, 6.0, np.nan])
    assert stays(so, np.tile(TIME, 5), since).tolist() == [True, False, False, False, False]


@pytest.mark.parametrize(
    ("changed", "rests"),
    [
        ({}, True),
        ({"vx": [9.0, 9.0, 9.0, 9.0, 0.0, 0.0]}, True),
        ({"vx": [0.0, 0.0, 0.0, 0.0, 2.0 * STILL, 0.0]}, False),
        ({"fallen": [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]}, False),
        ({"hands_unloaded": [0.0, 0.0, 0.0, 1.0, 2.0, 3.5]}, False),
        ({"hands_unloaded": [0.0, 0.0, 1.0, 2.0, 3.0, 4.5]}, True),
    ],
)
def test_who_rests_is_still_and_has_no_hand_on_the_ground_after_touchdown(
    changed: dict[str, list[float]], rests: bool
) -> None:
    touchdown = np.array([4.0 - STANDS_AFTER])
    seen = {name: np.zeros((6, 1)) for name in ("vx", "vy", "vz", "fallen")}
    seen |= {"time": TIME, "hands_unloaded": TIME + 1.0} | {name: frames(values) for name, values in changed.items()}
    assert rests_on_feet(seen, touchdown, hands_until=touchdown).tolist() == [rests]
    assert rests_on_feet(seen, np.array([np.nan]), hands_until=touchdown).tolist() == [False]


def test_rows_by_body_are_all_rows() -> None:
    for one in EXPERIMENTS:
        by_body = rows_by_body(one.name)
        assert all(row.body == body for body, rows in by_body.items() for row in rows)
        assert sum(map(len, by_body.values())) == len(published_rows(one.name))


def test_a_finer_step_keeps_the_time_between_control_ticks() -> None:
    character = gymnast_of("male")
    assert gymnast_of("male") is character
    for times in (1, 2):
        settings = FidelitySettings(threads=1, steps_per_second=times * character.steps_per_second)
        run = trials(character, SCRIPT, [{}, {}], settings, frame_rate=60)
        seen = run.run(0.5, ["time"])["time"]
        run.close()
        assert seen.shape == (30, 2)
        assert run.engine.tick == times * character.steps_per_tick
        np.testing.assert_allclose(seen[-1], 0.5, atol=1e-4)
