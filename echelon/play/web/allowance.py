"""How much somebody may send: a bucket of tokens that refills with time."""

from __future__ import annotations


class Allowance:
    """So much a second, and at most one second's worth at once.

    Args:
        rate: Tokens a second.
        now: A clock's reading [s]; the same clock is read in every call.
    """

    def __init__(self, rate: float, now: float) -> None:
        self._rate = rate
        self._left = rate
        self._read = now

    def wait_for(self, amount: float, now: float) -> float:
        """Takes ``amount`` and returns for how long [s] the taker has overdrawn; 0 while within the allowance."""
        self._left = min(self._rate, self._left + (now - self._read) * self._rate) - amount
        self._read = now
        return max(0.0, -self._left / self._rate)
