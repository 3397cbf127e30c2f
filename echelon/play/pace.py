"""Keeping a loop at wall-clock pace: no drift while the machine keeps up, and even slowness where it does not."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable

CATCH_UP = 1.25  # a frame after a hitch comes so much faster than real time, until what was lost has been made up
FORGIVEN = 1.0  # [s]; whoever is farther behind than this cannot keep up, and time is let go
SHOWN_OVER = 2.0  # [s] over which the share of real time is measured


class Pace:
    """When the next frame is due.

    Frames are due at whole multiples of their duration after a start that is kept, so that rounding and sleeping
    late never add up. After a hitch (a chunk written, a page loading) the frames that were missed are made up for, a
    little faster than real time. Where the loop falls `FORGIVEN` behind, the machine cannot keep up: the start is
    moved, so that every frame takes as long as it takes and none is left out.

    Attributes:
        lost: Time by which the start has been moved so far [s].
    """

    def __init__(
        self,
        frame_rate: float,
        *,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """
        Args:
            frame_rate: Frames a second.
            clock: Tells the time [s].
            sleep: Waits [s].
        """
        self._period = 1.0 / frame_rate
        self._clock, self._sleep = clock, sleep
        self.lost = 0.0
        self.restart()

    def restart(self) -> None:
        """The next frame is due a frame's duration from now: after a pause nothing is made up for."""
        self._start, self._frames = self._clock(), 0
        self._last = self._start
        self._waits: deque[tuple[float, float]] = deque()  # (when, lost until then) at the end of each wait

    def wait(self) -> None:
        """Return when the next frame is due, or at once where it has been due for long enough."""
        self._frames += 1
        due = self._start + self._frames * self._period
        now = self._clock()
        behind = now - due
        if behind > FORGIVEN:
            self._start += behind - FORGIVEN
            self.lost += behind - FORGIVEN
        else:
            # Made up for evenly: not all missed frames at once.
            until = max(due, self._last + self._period / CATCH_UP)
            if until > now:
                self._sleep(until - now)
                now = self._clock()
        self._last = now
        self._waits.append((now, self.lost))
        while self._waits and self._waits[0][0] < now - SHOWN_OVER:
            self._waits.popleft()

    @property
    def drift(self) -> float:
        """How far the loop is behind the clock, time let go included [s]."""
        return self._clock() - self._start - self._frames * self._period + self.lost

    @property
    def real_time(self) -> float:
        """Share of the wall clock's pace that is reached at present, 1 where the machine keeps up."""
        if len(self._waits) < 2:
            return 1.0
        (first, lost_before), (last, lost) = self._waits[0], self._waits[-1]
        return max(0.0, 1.0 - (lost - lost_before) / max(last - first, 1e-9))

    @property
    def slow(self) -> bool:
        """Whether the machine cannot keep up."""
        return self.real_time < 0.98

    @property
    def until_due(self) -> float:
        """Time left until the next frame is due, negative where it is late [s]."""
        return self._start + (self._frames + 1) * self._period - self._clock()


def frames_between(fraction: float, rate: float) -> tuple[int, float]:
    """Slow motion: how many frames to simulate for a picture, and how far the picture is then on to the next.

    Args:
        fraction: How far the picture before was on to the next frame, from 0 to 1.
        rate: Frames a picture, up to 1 for slow motion.
    """
    reached = fraction + rate
    whole = math.floor(reached + 1e-9)
    return whole, max(reached - whole, 0.0)
