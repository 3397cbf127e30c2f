"""Wakes, and what a group saves."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.scenario.road import PelotonSettings
from tests.flocking.point_cyclists import DRAG, ROLLING, PelotonRun, straight

SETTINGS = PelotonSettings(drafting=True)
LENGTH = SETTINGS.body_length


def shelters(s: list[float], offsets: list[float], drafting: bool = True) -> np.ndarray:
    run = PelotonRun(PelotonSettings(drafting=drafting), straight(), count=len(s))
    run.put(np.array(s), np.array(offsets), 11.0)
    commands = run.want()
    np.testing.assert_array_equal(commands[:, 3], run.peloton.riders.shelter.numpy()[: len(s)])
    return commands[:, 3].copy()


def test_behind_one_rider_nearly_half_is_spared_and_it_fades() -> None:
    gaps = [0.5, 1.0, 2.0, 4.0, 6.0, 10.0]
    behind = [float(shelters([100.0, 100.0 + LENGTH + gap], [0.0, 0.0])[0]) for gap in gaps]
    assert behind[0] == pytest.approx(0.45, abs=0.01)
    assert (np.diff(behind) < 0.0).all()
    assert behind[4] < 0.1
    assert behind[5] < 0.03


def test_the_first_has_no_shelter_and_beside_there_is_little() -> None:
    first = shelters([100.0, 103.0, 103.0], [0.0, 0.0, 1.2])
    assert first[1] < 0.05
    assert first[2] < 0.05
    sides = [float(shelters([100.0, 102.2], [0.0, side])[0]) for side in (0.0, 0.3, 0.6, 0.9, 1.2)]
    assert (np.diff(sides) < 0.0).all()
    assert sides[-1] < 0.1 * sides[0]


def test_several_ahead_spare_more_than_one() -> None:
    one = shelters([100.0, 103.0], [0.0, 0.0])[0]
    two = shelters([100.0, 103.0, 106.0], [0.0, 0.0, 0.0])[0]
    crowd = shelters([100.0, 103.0, 106.0, 103.0, 103.0], [0.0, 0.0, 0.0, 0.9, -0.9])[0]
    assert one < two < crowd <= 0.5


def test_shelter_changes_without_jumps() -> None:
    gaps = np.arange(-LENGTH - 0.5, 8.0, 0.2)
    values = np.array([shelters([100.0, 100.0 + LENGTH + gap], [0.0, 0.05])[0] for gap in gaps])
    assert np.abs(np.diff(values)).max() < 0.12


def test_in_the_middle_of_a_group_a_third_of_the_power_is_saved() -> None:
    """Sixteen at about 11 m/s: those with others ahead and beside save 30 to 40 % of their power, as Burke measured."""
    run = PelotonRun(PelotonSettings(drafting=True, start_speed=10.0), straight(3000.0))
    run.advance(2400)
    watched = run.watch(600)
    assert watched.speed[-1] == pytest.approx(10.7, abs=0.4)
    alone = DRAG * watched.speed**3 + ROLLING * watched.speed**2
    saved = 1.0 - watched.power.mean(axis=0) / alone.mean(axis=0)
    from_front = np.argsort(-watched.progress[-1])
    assert saved[from_front[:2]].max() < 0.05
    assert 0.30 < saved[from_front[8:]].mean() < 0.40
    assert saved.max() < 0.42


def test_off_it_spares_nothing() -> None:
    np.testing.assert_array_equal(shelters([100.0, 102.2, 104.4], [0.0, 0.0, 0.0], drafting=False), 0.0)
