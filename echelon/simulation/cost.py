"""What a run took: time by phase, memory, threads and ranks. Never part of what it comes to."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from echelon.ranks import Ranks

try:
    import resource
except ImportError:  # Windows
    resource = None

PHASES = ("see", "want", "act", "exchange", "record", "write")
"""See: the hash grid, the neighbours of each, collisions. Want: what everybody decides on, and the collie or the user.
Act: bodies, contact, and what becomes of the fallen. Exchange: with other ranks, waiting for
them included. Record: noting what happened, and handing it over a chunk at a time, waiting for the disk included.
Write: in a thread of its own, beside the others."""


class PhaseClock:
    """A stopwatch for the phases of a run.

    Attributes:
        seconds: Spent in each of `PHASES` so far, by name.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = dict.fromkeys(PHASES, 0.0)
        self._since = 0.0

    def start(self) -> None:
        """A phase begins now."""
        self._since = time.perf_counter()

    def lap(self, phase: str) -> None:
        """What was done since the last lap or start was this phase; another begins now."""
        now = time.perf_counter()
        self.seconds[phase] += now - self._since
        self._since = now


@dataclass
class RunCost:
    """Filled in by `echelon.simulation.simulate` and `resume`.

    Attributes:
        threads: Used by each rank.
        ranks: Processes that the crowd was dealt to.
        peak_memory_mb: Largest resident memory of all ranks together [MB]; None where it is not known.
        phase_seconds: Time by phase (`PHASES`) [s]; of several ranks, the longest of each.
    """

    threads: int = 1
    ranks: int = 1
    peak_memory_mb: float | None = None
    phase_seconds: dict[str, float] = field(default_factory=dict)

    def fill_in(self, clock: PhaseClock, threads: int, ranks: Ranks) -> None:
        """At the end of a run; all ranks call it at once. Only the first knows what the others took."""
        own = [*clock.seconds.values(), peak_memory() or 0.0]
        rows = ranks.gather(np.array([own]))
        if len(rows):
            seconds, memory = rows[:, :-1].max(axis=0), float(rows[:, -1].sum())
            self.phase_seconds = {name: round(float(s), 6) for name, s in zip(clock.seconds, seconds, strict=True)}
            self.peak_memory_mb = round(memory / 1e6, 1) or None
        self.threads, self.ranks = threads, ranks.size

    def as_dict(self) -> dict[str, Any]:
        """Plain data, as `echelon simulate --json` reports it."""
        return {
            "threads": self.threads,
            "ranks": self.ranks,
            "peak_memory_mb": self.peak_memory_mb,
            "phase_seconds": self.phase_seconds,
        }


def peak_memory() -> float | None:
    """Largest resident memory that this process has had [bytes]; None where the system does not say."""
    if resource is None:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak if sys.platform == "darwin" else peak * 1024)
