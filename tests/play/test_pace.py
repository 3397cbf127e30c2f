"""The loop keeps the wall clock's pace, makes up for hitches, and slows evenly where the machine cannot keep up."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.play.pace import FORGIVEN, Pace, frames_between

RATE = 30


class Machine:
    """A clock that goes on while a loop works and sleeps, a little longer than it was told to."""

    def __init__(self, oversleeps: float = 0.0) -> None:
        self.now = 1000.0
        self._oversleeps = oversleeps
        self.pace = Pace(RATE, clock=lambda: self.now, sleep=self._sleep)

    def _sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.now += seconds + self._oversleeps

    def frames(self, count: int, work: float) -> np.ndarray:
        """When each frame began, where each takes so long to work out."""
        begun = []
        for _ in range(count):
            begun.append(self.now)
            self.now += work
            self.pace.wait()
        return np.array(begun)


def test_ten_minutes_drift_less_than_a_frame() -> None:
    machine = Machine(oversleeps=0.0007)
    start = machine.now
    machine.frames(600 * RATE, work=0.011)
    assert abs(machine.now - start - 600.0) < 1.0 / RATE
    assert abs(machine.pace.drift) < 1.0 / RATE
    assert machine.pace.lost == 0.0
    assert machine.pace.real_time == 1.0


def test_a_hitch_is_made_up_for_evenly() -> None:
    machine = Machine()
    start = machine.now
    machine.frames(30, work=0.01)
    machine.frames(1, work=0.16)
    after = np.diff(machine.frames(59, work=0.01))
    assert after.min() > 0.75 / RATE
    assert machine.now - start == pytest.approx(90 / RATE, abs=1e-6)
    assert machine.pace.lost == 0.0
    assert not machine.pace.slow


def test_a_machine_that_cannot_keep_up_says_so_and_slows_evenly() -> None:
    machine = Machine()
    begun = machine.frames(300, work=0.05)
    assert machine.pace.slow
    assert machine.pace.real_time == pytest.approx((1.0 / RATE) / 0.05, abs=0.06)
    np.testing.assert_allclose(np.diff(begun), 0.05, rtol=1e-6)
    assert machine.pace.drift >= machine.pace.lost > 0.0


def test_it_recovers() -> None:
    machine = Machine()
    machine.frames(100, work=0.05)
    machine.frames(120, work=0.01)
    assert not machine.pace.slow
    lost = machine.pace.lost
    machine.frames(60, work=0.01)
    assert machine.pace.lost == lost


def test_nothing_is_made_up_for_after_a_pause() -> None:
    machine = Machine()
    machine.frames(10, work=0.01)
    machine.now += 20.0
    machine.pace.restart()
    steps = np.diff(machine.frames(30, work=0.01))
    np.testing.assert_allclose(steps, 1.0 / RATE, rtol=1e-9)
    assert machine.pace.lost == 0.0


def test_what_is_forgiven_is_counted() -> None:
    machine = Machine()
    machine.now += FORGIVEN + 1.0
    machine.pace.wait()
    assert machine.pace.lost == pytest.approx(1.0 - 1.0 / RATE)
    assert machine.pace.drift == pytest.approx(machine.pace.lost + FORGIVEN)


@pytest.mark.parametrize("rate", [1.0, 0.5, 0.25, 0.1, 0.05])
def test_slow_motion_simulates_every_frame_once(rate: float) -> None:
    part, counts, parts = 0.0, [], []
    for _ in range(200):
        count, part = frames_between(part, rate)
        counts.append(count)
        parts.append(part)
    assert sum(counts) == pytest.approx(200 * rate, abs=1.0)
    assert max(counts) <= 1
    shown = np.cumsum(counts) + np.array(parts)
    np.testing.assert_allclose(np.diff(shown), rate, atol=1e-9)
