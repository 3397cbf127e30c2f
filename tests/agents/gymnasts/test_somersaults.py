"""The standing somersaults that ship: they come round once, land on the feet, and end balanced, also when disturbed."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from echelon.agents.gymnasts.script import Script, load_script
from echelon.benchmarks.thesis.trials import gymnast_of
from echelon.simulation.performance import Performance

SOMERSAULTS = {"standing-back-somersault": -1.0, "standing-forward-somersault": 1.0}
"""By name, which way they turn: backward is negative."""
DISTURBED = 32
SECONDS = 5.4
WATCHED = (
    "row", "fallen", "somersault", "momentum_y", "foot_force", "hands_unloaded", "time", "vx", "vy", "vz", "upright",
)  # fmt: skip


@pytest.fixture(scope="module", params=list(SOMERSAULTS))
def performed(request: pytest.FixtureRequest) -> tuple[float, Script, Mapping[str, np.ndarray]]:
    """Its sense, the script, and what was seen of the usual one (first) and of disturbed ones."""
    script = load_script(request.param)
    character = gymnast_of(script.body)
    values = [{}, *script.varied(DISTURBED, 3)]
    performance = Performance(character, [script.table(character.body, one) for one in values])
    seen = performance.run(SECONDS, WATCHED)
    performance.close()
    return SOMERSAULTS[request.param], script, seen


def balanced(sense: float, seen: Mapping[str, np.ndarray]) -> np.ndarray:
    """Who stands still on the feet after one turn, with hands that never touched the ground."""
    speed = np.sqrt(seen["vx"][-1] ** 2 + seen["vy"][-1] ** 2 + seen["vz"][-1] ** 2)
    turned = abs(seen["somersault"][-1] - sense * 2.0 * math.pi) < 0.2
    no_hands = seen["hands_unloaded"][-1] > seen["time"][-1] - 0.1
    return (seen["fallen"][-1] < 0.5) & (speed < 0.05) & turned & no_hands & (seen["upright"][-1] > 0.95)


def test_ends_balanced(performed: tuple[float, Script, Mapping[str, np.ndarray]]) -> None:
    sense, script, seen = performed
    assert balanced(sense, seen)[0]
    assert script.row_names[int(seen["row"][-1, 0])] == "balanced"


def test_most_disturbed_ones_end_balanced(performed: tuple[float, Script, Mapping[str, np.ndarray]]) -> None:
    sense, _, seen = performed
    assert np.mean(balanced(sense, seen)[1:]) >= 0.8


def test_momentum_stays_in_flight(performed: tuple[float, Script, Mapping[str, np.ndarray]]) -> None:
    sense, script, seen = performed
    rows = [script.row_names.index(name) for name in ("tuck", "open")]
    flight = (seen["row"][:, 0] >= rows[0]) & (seen["row"][:, 0] <= rows[1]) & (seen["foot_force"][:, 0] == 0.0)
    momentum = seen["momentum_y"][flight, 0]
    assert len(momentum) > 10
    assert np.all(sense * momentum > 0.0)
    np.testing.assert_allclose(momentum, momentum.mean(), rtol=0.02)


def test_goes_through_all_its_rows(performed: tuple[float, Script, Mapping[str, np.ndarray]]) -> None:
    _, script, seen = performed
    passed = [script.row_names[int(row)] for row in dict.fromkeys(seen["row"][:, 0])]
    assert [name for name in passed if name != "wait"] == [name for name in script.row_names if name != "wait"]
