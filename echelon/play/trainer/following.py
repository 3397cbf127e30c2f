"""A number that follows another within a limit and no faster than a rate: what may drive a motor or a brake."""

from __future__ import annotations

import math


class Follower:
    """A value that starts at zero and follows a target.

    Attributes:
        value: Where it is, at most `limit` from zero.
    """

    def __init__(self, limit: float, rate: float) -> None:
        """
        Args:
            limit: Its greatest absolute value, in its own unit.
            rate: Its greatest change in a second.
        """
        self.value = 0.0
        self._limit = limit
        self._rate = rate

    def step(self, target: float, duration: float) -> float:
        """The value after so long [s], nearer to the target."""
        target = max(-self._limit, min(self._limit, target))
        reach = self._rate * duration
        self.value += max(-reach, min(reach, target - self.value))
        return self.value


def finite(name: str, value: float) -> float:
    """The value.

    Raises:
        ValueError: It is infinite or no number: such a target would pass every comparison that limits it.
    """
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value}; must be finite")
    return float(value)
