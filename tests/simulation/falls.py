"""Runs in which somebody is struck, at a given frame, by what no rule would ever ask for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echelon.recording import EVENT_NAMES, Recording
from echelon.scenario import Scenario
from echelon.simulation import Simulation, simulate

Blow = Callable[[Simulation], None]


def struck(patch: pytest.MonkeyPatch, frame: int, blow: Blow) -> None:
    """From now on every simulation gets a blow before it advances to a frame, however often it is resumed."""
    advance: Callable[..., None] = Simulation.advance

    def advance_struck(self: Simulation, *arguments: Any) -> None:
        if self.frame == frame:
            blow(self)
        advance(self, *arguments)

    patch.setattr(Simulation, "advance", advance_struck)


def push(agent: int, speed: int, change: float) -> Blow:
    """A blow that changes one generalised speed of an agent."""

    def give(simulation: Simulation) -> None:
        u = simulation.engine.u
        u[agent, speed] += change
        simulation.engine.set_u(u)

    return give


def both(*blows: Blow) -> Blow:
    """Several blows at once."""

    def give(simulation: Simulation) -> None:
        for blow in blows:
            blow(simulation)

    return give


def recorded(plan: Scenario, path: Path, **options: Any) -> Recording:
    return simulate(plan, recording=path, **options)


def frames_of(recording: Recording, name: str, agent: int) -> list[int]:
    """The frames in which something happened to an agent."""
    table = recording.events
    return table["frame"][(table["kind"] == EVENT_NAMES.index(name)) & (table["agent"] == agent)].tolist()


def in_phase(recording: Recording, name: str, agent: int) -> np.ndarray:
    """Frames in which an agent is in a phase."""
    return np.flatnonzero(recording.phases[:, agent] == recording.phase_names.index(name))


def same_files(a: Path, b: Path) -> bool:
    """Whether two folders hold the same files with the same bytes."""
    files = sorted(p.relative_to(a) for p in a.rglob("*") if p.is_file())
    if files != sorted(p.relative_to(b) for p in b.rglob("*") if p.is_file()):
        return False
    return all((a / name).read_bytes() == (b / name).read_bytes() for name in files)
