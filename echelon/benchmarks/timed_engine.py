"""Our engine on one core, bound, and timed round by round.

A round is a second of simulation for everybody; it includes all that a frame takes: lookups, control, contact,
dynamics, integration, and the observation of link poses for the recording. Kernels are compiled before the first.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

from echelon.benchmarks.sanity import Verdict
from echelon.scenario import WorldSettings
from echelon.terrain.flat import FlatTerrain
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.frame import ChunkArrays, Engine, Terrain
from echelon.warp_kernels.program import Integrator
from echelon.warp_kernels.start import start_warp

FRAME_RATE = 30  # [1/s]
ROUND_FRAMES = 30  # one second


@dataclass(frozen=True)
class Stride:
    """How a frame is divided.

    Attributes:
        substeps: Substeps a frame.
        tick: Substeps a control tick.
    """

    substeps: int
    tick: int

    @property
    def step(self) -> float:
        """Length of a substep [s]."""
        return 1.0 / (FRAME_RATE * self.substeps)


STRIDE = Stride(substeps=24, tick=6)
"""The engine's usual one: 1/720 s, a control tick every 1/120 s."""


class Run(Protocol):
    """A run that is timed in rounds.

    Attributes:
        engine: The engine, compiled and bound.
    """

    engine: Engine

    def round(self) -> float:
        """Advance by one round; how long one agent's substep took [us]."""
        ...

    def verdict(self) -> Verdict:
        """Whether all rounds so far were sane."""
        ...


def flat_ground() -> Terrain:
    """A plane without walls."""
    start_warp()
    return FlatTerrain.of(WorldSettings(ground="plane", corral=None), "cpu")


def bound_engine(
    character: Character, agents: int, stride: Stride, integrator: Integrator, ground: Terrain
) -> tuple[Engine, ChunkArrays]:
    """An engine on one thread, compiled, and the chunk that it observes into."""
    start_warp()
    engine = Engine(
        character,
        agents,
        ground,
        frame_rate=FRAME_RATE,
        substeps=stride.substeps,
        tick=stride.tick,
        integrator=integrator,
        threads=1,
    )
    chunk = ChunkArrays.allocate(ROUND_FRAMES, agents, character, "cpu")
    engine.bind(chunk)
    return engine, chunk


def timed_round(engine: Engine) -> float:
    """Advance by one round; how long one agent's substep took [us]."""
    start = time.perf_counter()
    for slot in range(ROUND_FRAMES):
        engine.advance(slot)
    return (time.perf_counter() - start) / (ROUND_FRAMES * engine.substeps * engine.agent_count) * 1e6
