"""Rotating off the front, breaking away, closing a gap: each happens, and nobody dithers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from echelon.flocking.tactics import TACTICS
from echelon.scenario.road import PelotonSettings, TacticsSettings
from tests.flocking.point_cyclists import FRAME_RATE, PelotonRun, straight

RIDE, ROTATE, ATTACK, CHASE = range(4)


def choices(
    tactics: TacticsSettings | None, frames: int, *, seed: int = 1, count: int = 8
) -> tuple[PelotonRun, np.ndarray]:
    """A run and what each did in each frame, shape [frames, riders]."""
    settings = PelotonSettings(tactics=tactics, columns=2, start_speed=10.0)
    run = PelotonRun(settings, straight(4000.0), count=count, seed=seed)
    rows = []
    for _ in range(frames):
        run.advance()
        rows.append(run.peloton.tactics.choice.numpy().copy())
    return run, np.array(rows)


def test_nobody_has_any_unless_asked_for() -> None:
    _, done = choices(None, 300)
    np.testing.assert_array_equal(done, RIDE)


@pytest.mark.parametrize("seed", [1, 2])
def test_whatever_is_chosen_is_kept_for_the_dwelling_time(seed: int) -> None:
    eager = TacticsSettings(pull_seconds=5.0, attacks=1200.0, attack_seconds=6.0, rest_seconds=4.0, chase_gap=4.0)
    run, done = choices(eager, 4500, seed=seed, count=16)
    assert {TACTICS[choice] for choice in np.unique(done)} == set(TACTICS), "everything happens"
    for rider in done.T:
        changes = np.flatnonzero(np.diff(rider)) + 1
        assert np.diff(changes).min(initial=10**6) >= eager.dwell_seconds * FRAME_RATE - 1
        for before, after in pairwise(changes):
            if rider[before] == ATTACK:
                assert after - before == pytest.approx(eager.attack_seconds * FRAME_RATE, abs=1)
        after_effort = [k for k in changes if rider[k - 1] in (ATTACK, CHASE)]
        for k in after_effort:
            assert rider[k] == RIDE
            rest = rider[k : k + int(eager.rest_seconds * FRAME_RATE) - 1]
            assert not np.isin(rest, (ATTACK, CHASE)).any()
    totals = run.peloton.referee.totals()
    assert (totals["off_road"], totals["collisions"]) == (0, 0)


def test_turns_at_the_front_are_taken_by_many() -> None:
    run, done = choices(TacticsSettings(pull_seconds=10.0, attacks=0.0), 4500)
    turns = np.diff((done == ROTATE).astype(int), axis=0) == 1
    assert turns.sum() >= 4
    assert turns.any(axis=0).sum() >= 3
    assert set(np.unique(done)) <= {RIDE, ROTATE, CHASE}
    totals = run.peloton.referee.totals()
    assert (totals["off_road"], totals["collisions"]) == (0, 0)


def test_who_rotates_off_goes_to_the_side_and_to_the_back() -> None:
    settings = PelotonSettings(tactics=TacticsSettings(pull_seconds=10.0, attacks=0.0), columns=1, start_speed=10.0)
    run = PelotonRun(settings, straight(4000.0), count=4)
    first = None
    for _ in range(1800):
        run.advance()
        rotating = np.flatnonzero(run.peloton.tactics.choice.numpy() == ROTATE)
        if first is None and len(rotating):
            first = int(rotating[0])
            progress = run.peloton.referee.arrays.progress.numpy()
            assert progress[first] == progress.max()
        if first is not None and run.peloton.tactics.choice.numpy()[first] == RIDE:
            break
    assert first is not None
    progress = run.peloton.referee.arrays.progress.numpy()
    assert progress[first] == progress.min()


def test_a_gap_is_closed() -> None:
    gaps = []
    for tactics in (None, TacticsSettings(attacks=0.0, pull_seconds=1000.0)):
        settings = PelotonSettings(tactics=tactics, columns=1, training_spread=0.0, distance_gain=0.0)
        run = PelotonRun(settings, straight(4000.0), count=3, power=900.0)
        run.put(np.array([100.0, 103.5, 133.0]), np.zeros(3), 11.0)
        run.advance(1500)
        progress = np.sort(run.peloton.referee.arrays.progress.numpy())
        gaps.append(progress[2] - progress[1])
    assert gaps[0] == pytest.approx(29.5, abs=0.5)
    assert gaps[1] < 3.0 + 2.0


def test_who_attacks_gets_away() -> None:
    tactics = TacticsSettings(attacks=240.0, attack_seconds=20.0, pull_seconds=1000.0)
    run, done = choices(tactics, 1800, seed=4)
    assert (done == ATTACK).any()
    progress = run.peloton.referee.arrays.progress.numpy()
    assert progress.max() - progress.min() > 15.0


def test_a_riders_chances_do_not_depend_on_how_many_there_are() -> None:
    """Two of a group and the same two alone draw the same numbers: they set out in the same second."""
    tactics = TacticsSettings(attacks=400.0, pull_seconds=1000.0, chase_gap=500.0, dwell_seconds=1.0)
    settings = PelotonSettings(tactics=tactics, columns=2, start_speed=10.0)
    begun = []
    for count in (2, 4):
        run = PelotonRun(settings, straight(4000.0), count=count, seed=9)
        s = np.array([200.0, 195.0, 120.0, 115.0])[:count]
        found = None
        for _ in range(900):
            run.put(s, np.array([0.6, -0.6, 0.6, -0.6])[:count], 10.0)
            run.want()
            if found is None and run.peloton.tactics.choice.numpy()[0] == ATTACK:
                found = run.frame
        begun.append(found)
    assert begun[0] is not None
    assert begun[0] == begun[1]
