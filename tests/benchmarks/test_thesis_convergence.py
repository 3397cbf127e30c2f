"""What half the step changes: who is told of, what counts as a share of what, and that a maneuver holds it."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.benchmarks.thesis.convergence import greatest_change, maneuver_named, measured
from echelon.benchmarks.thesis.experiments import FidelitySettings
from echelon.benchmarks.thesis.published import CONVERGED, LEAST_MOMENTUM, published_rows
from echelon.benchmarks.thesis.rows import FidelityRow
from echelon.benchmarks.thesis.trials import filtered_peak, gymnast_of

SETTINGS = FidelitySettings(threads=1)


def test_the_command_that_changes_most_is_told_of() -> None:
    before, after = np.array([0.1, 0.5, 1.0]), np.array([0.101, 0.47, 1.04])
    change = greatest_change("rise", ["low", "middle", "high"], before, after)
    assert change.command == "middle"
    assert change.share == pytest.approx(6.0)
    assert (change.before, change.after) == (0.5, 0.47)


def test_momentum_of_who_should_not_turn_is_no_share_of_next_to_nothing() -> None:
    change = greatest_change("angular momentum", [""], np.array([0.01]), np.array([-0.02]))
    assert change.share == pytest.approx(100.0 * 0.03 / LEAST_MOMENTUM)
    assert greatest_change("peak force", [""], np.array([0.01]), np.array([-0.02])).share == pytest.approx(300.0)


def test_what_came_to_nothing_has_changed_wholly() -> None:
    assert greatest_change("rise", ["", "lost"], np.array([1.0, 1.0]), np.array([1.0, np.nan])).command == "lost"


def test_a_filtered_plate_tells_the_weight_of_who_stands_and_spreads_a_spike() -> None:
    body, rate = gymnast_of("male").body, 1200
    still = np.zeros((rate, 2))
    stopped = still.copy()
    stopped[: rate // 2, 1] = -1.0  # stopped within a frame
    peaks = filtered_peak(stopped, body, rate)
    weight = body.mass * body.gravity
    assert peaks[0] == pytest.approx(weight)
    assert peaks[1] == pytest.approx(weight + body.mass * 1.0 / 0.01, rel=1e-6)
    later = np.roll(stopped, 1, axis=0)
    later[0] = stopped[0]
    np.testing.assert_allclose(filtered_peak(later, body, rate), peaks)


def test_every_maneuver_that_is_published_can_be_done() -> None:
    for row in published_rows("convergence"):
        assert row.rule == CONVERGED
        assert len(maneuver_named(str(row.given["maneuver"]), row.body).commands) >= 1


def test_the_back_handspring_is_converged() -> None:
    rows = [row for row in published_rows("convergence") if row.given["maneuver"] == "back handspring"]
    found = [FidelityRow.of(one) for one in measured(rows, SETTINGS)]
    assert {row.quantity for row in found} == {
        "change of rise",
        "change of angular momentum",
        "change of peak force",
    }
    assert all(row.met for row in found)
