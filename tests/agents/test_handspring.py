"""The back handspring that ships: over the hands onto the feet, balanced also when disturbed; and its failure falls."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.characters import character_named
from echelon.agents.gymnast import Gymnast
from echelon.agents.script import Script, load_script
from echelon.benchmarks.thesis.experiments import FidelitySettings
from echelon.benchmarks.thesis.handspring import FAILURE, Handsprings, perform
from echelon.simulation.performance import Performance

DISTURBED = 38


@pytest.fixture(scope="module")
def character() -> Gymnast:
    found = character_named("gymnast-male")
    assert isinstance(found, Gymnast)
    return found


@pytest.fixture(scope="module")
def script() -> Script:
    return load_script("back-handspring")


@pytest.fixture(scope="module")
def performed(character: Gymnast, script: Script) -> Handsprings:
    """The usual one, the failure, and disturbed ones."""
    return perform(character, script, [{}, FAILURE, *script.varied(DISTURBED, 7)], FidelitySettings())


def test_ends_balanced(performed: Handsprings) -> None:
    assert performed.balanced[0]


def test_most_disturbed_ones_end_balanced(performed: Handsprings) -> None:
    assert np.mean(performed.balanced[2:]) >= 0.8


def test_turns_backwards_over_the_hands(performed: Handsprings) -> None:
    moments = [performed.liftoff[0], performed.hands[0], performed.release[0], performed.touchdown[0]]
    assert np.all(np.diff(moments) > 0.1)
    # The hands add momentum for the second half.
    assert performed.second[0] < performed.first[0] < -60.0


def test_failure_falls_backwards(performed: Handsprings) -> None:
    assert performed.fell_backwards[1]
    assert not performed.balanced[1]
    assert performed.feet[1] > performed.feet[0] + 0.2  # too far forward


def test_goes_through_all_its_rows(character: Gymnast, script: Script) -> None:
    performance = Performance(character, [script.table(character.body)], frame_rate=60)
    rows = performance.run(6.0, ["row"])["row"][:, 0]
    performance.close()
    assert [script.row_names[int(row)] for row in dict.fromkeys(rows)] == list(script.row_names)
