"""Our half of the race with the gymnast: people who stand and hold their balance, twelve points of their feet loaded.

Everything is in what is timed: the script, control with balance each tick, a servo at each of 47 joint axes, twelve
points at the soles and nineteen where a body falls (which nobody's do here), the dynamics of 53 degrees of freedom, and
the observation for the recording. After every round they are looked at.
"""

from __future__ import annotations

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.script import load_script
from echelon.benchmarks.sanity import Verdict, fault_of_states
from echelon.benchmarks.timed_engine import ROUND_FRAMES, Stride, bound_engine, flat_ground, timed_round
from echelon.warp_kernels.program import Integrator

STANDING_STRIDE = Stride(substeps=40, tick=4)
"""That of scenarios: 1/1200 s, a control tick every 1/300 s."""

MANEUVER = "stand"
SETTLING_FRAMES = 60  # in which they come to rest
SEED = 1
VARIATION = 0.03  # of their strength
FARTHEST = 0.05  # that the centre of mass of who balances is from the middle of the feet [m]


class GymnastRun:
    """Gymnasts who stand; every round goes on from the last and counts for the verdict."""

    def __init__(self, character: Gymnast, agents: int, stride: Stride, integrator: Integrator) -> None:
        self.engine, self._chunk = bound_engine(character, agents, stride, integrator, flat_ground())
        engine = self.engine
        people = character.population(agents, SEED, VARIATION, False)
        engine.set_q(people.q)
        engine.set_u(people.u)
        for name, values in people.parameters.items():
            engine.set_parameter(name, values)
        for name, values in people.memory.items():
            engine.set_memory(name, values)
        engine.set_scripts(load_script(MANEUVER).table(character.body)[None], np.zeros(agents, np.int64))
        engine.bind(self._chunk)
        for frame in range(SETTLING_FRAMES):
            engine.advance(frame % ROUND_FRAMES)
        self._farthest = 0.0

    def round(self) -> float:
        microseconds = timed_round(self.engine)
        off = np.hypot(self.engine.memory("com_x"), self.engine.memory("com_y"))
        self._farthest = max(self._farthest, float(off.max()))
        return microseconds

    def verdict(self) -> Verdict:
        engine = self.engine
        lost, down = int(engine.frozen.sum()), int((engine.memory("fallen") > 0.5).sum())
        if lost or down:
            return Verdict(False, f"{lost} states stopped being finite and {down} of {engine.agent_count} fell")
        fault = fault_of_states(engine.character.body, engine.q, engine.u)
        if fault:
            return Verdict(False, fault)
        text = f"all {engine.agent_count} stand, centre of mass at most {1e3 * self._farthest:.1f} mm off the middle"
        return Verdict(self._farthest <= FARTHEST, text)
