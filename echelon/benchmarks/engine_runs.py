"""Our engine's half of the race: who runs and how; hoppers, and bodies in flight (for riders see `riding_run`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from echelon.agents.bodies import load_body
from echelon.agents.characters import character_named
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.hopper import Hopper
from echelon.agents.riders.cyclist import Cyclist
from echelon.agents.servo import ServoedBody
from echelon.benchmarks.gymnast_run import STANDING_STRIDE, GymnastRun
from echelon.benchmarks.riding_run import RIDING_STRIDE, RidingRun, riding_ground
from echelon.benchmarks.sanity import Verdict, fault_of_states, judge_flight, judge_hopping
from echelon.benchmarks.timed_engine import (
    FRAME_RATE,
    ROUND_FRAMES,
    STRIDE,
    Run,
    Stride,
    bound_engine,
    flat_ground,
    timed_round,
)
from echelon.errors import InputError
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.frame import Terrain
from echelon.warp_kernels.program import Integrator
from echelon.warp_kernels.reference import Body

SETTLING_FRAMES = 150  # hoppers get up to speed in this time
SPEEDS = (0.0, 1.0, 2.0)  # that hoppers are asked for [m/s]
SERVO_STIFFNESS, SERVO_DAMPING = 300.0, 20.0  # of every joint of a body in flight [N m/rad], [N m s/rad]
SAMPLE_FRAMES = 6  # between two looks at a body in flight
JUDGED_AGENTS = 16  # whose momentum and energy in flight are looked at, the same leaps for both engines

HOPPER, CYCLIST, GYMNAST = "hopper", "cyclist", "gymnast"


def character_of(body_name: str) -> Character:
    """Who represents a body in the race: a hopper that hops, a cyclist who rides, a gymnast who stands, any other with
    a servo a joint.

    Raises:
        InputError: If there is no such body, or its root is not free.
    """
    if body_name == HOPPER:
        return Hopper()
    if body_name == CYCLIST:
        return Cyclist()
    if body_name == GYMNAST:
        return character_named("gymnast-male")
    body = load_body(body_name)
    if body.links[0].joint.kind != "free":
        raise InputError(f"body {body_name!r}: its root joint is {body.links[0].joint.kind}, must be free to fly")
    return ServoedBody(replace(body, contacts=(), springs=()), SERVO_STIFFNESS, SERVO_DAMPING)


def stride_of(character: Character) -> Stride:
    """How a frame is divided for a character in scenarios."""
    if isinstance(character, Gymnast):
        return STANDING_STRIDE
    return RIDING_STRIDE if isinstance(character, Cyclist) else STRIDE


def ground_of(character: Character) -> Terrain:
    """What a character is timed on."""
    return riding_ground() if isinstance(character, Cyclist) else flat_ground()


def start_run(character: Character, agents: int, stride: Stride, integrator: Integrator) -> Run:
    """The run in which a character is timed."""
    if isinstance(character, ServoedBody):
        return FlightRun(character, agents, stride, integrator)
    if isinstance(character, Cyclist):
        return RidingRun(character, agents, stride, integrator)
    if isinstance(character, Gymnast):
        return GymnastRun(character, agents, stride, integrator)
    return HoppingRun(character, agents, stride, integrator)


class HoppingRun:
    """Hoppers at 0, 1 and 2 m/s, in all directions; every round goes on from the last and counts for the verdict."""

    def __init__(self, character: Character, agents: int, stride: Stride, integrator: Integrator) -> None:
        self.engine, self._chunk = bound_engine(character, agents, stride, integrator, flat_ground())
        engine = self.engine
        q = np.tile(character.body.q_reference, (agents, 1))
        q[:, 2] += 0.1
        engine.set_q(q)
        directions = np.linspace(0.0, 2.0 * np.pi, agents, endpoint=False)
        speeds = np.resize(SPEEDS, agents)
        self._wanted = np.stack([speeds * np.cos(directions), speeds * np.sin(directions)], axis=-1)
        engine.set_command("velocity_x", self._wanted[:, 0])
        engine.set_command("velocity_y", self._wanted[:, 1])
        for frame in range(SETTLING_FRAMES):
            engine.advance(frame % ROUND_FRAMES)
        self._start = self._places()
        self._frames = 0

    def _places(self) -> np.ndarray:
        """Where everybody's root is in the world [m], shape [agents, 3]."""
        return self.engine.origins.numpy()[: self.engine.agent_count] + self.engine.q[:, :3]

    def round(self) -> float:
        self._frames += ROUND_FRAMES
        return timed_round(self.engine)

    def verdict(self) -> Verdict:
        engine = self.engine
        mean = (self._places() - self._start)[:, :2] / max(self._frames / FRAME_RATE, 1e-9)
        error = np.linalg.norm(mean - self._wanted, axis=-1)
        fallen = engine.memory("fallen") > 0.5
        return judge_hopping(engine.character.body, engine.q, engine.u, fallen, engine.frozen, error)


class FlightRun:
    """A servoed body in free flight; every round starts from the same tumbling, twisted states."""

    def __init__(self, character: ServoedBody, agents: int, stride: Stride, integrator: Integrator) -> None:
        self.engine, self._chunk = bound_engine(character, agents, stride, integrator, flat_ground())
        self._stiffness = max(character.stiffness)
        q, u = flight_states(character.body, agents)
        self.engine.set_q(q)
        self.engine.set_u(u)
        self._start = self.engine.full_state()
        self._end = self._start

    def round(self) -> float:
        self.engine.load_full_state(self._start)
        microseconds = timed_round(self.engine)
        self._end = self.engine.full_state()
        return microseconds

    def verdict(self) -> Verdict:
        # The round once more, looked at on its way; it must be the round that was timed, bit for bit.
        engine = self.engine
        engine.load_full_state(self._start)
        samples = [self._state()]
        for frame in range(ROUND_FRAMES):
            engine.advance(frame)
            if (frame + 1) % SAMPLE_FRAMES == 0:
                samples.append(self._state())
        lost = np.count_nonzero(engine.frozen)
        if lost:
            return Verdict(False, f"{lost} of {engine.agent_count} agents' states stopped being finite")
        again = engine.full_state()
        if any(again[name].tobytes() != self._end[name].tobytes() for name in again):
            return Verdict(False, "the same round gave other bits when it was run again")
        body = engine.character.body
        fault = fault_of_states(body, *samples[-1])
        if fault:
            return Verdict(False, fault)
        judged = [(q[:JUDGED_AGENTS], u[:JUDGED_AGENTS]) for q, u in samples]
        return judge_flight(body, judged, ROUND_FRAMES / FRAME_RATE, self._stiffness)

    def _state(self) -> tuple[np.ndarray, np.ndarray]:
        """(q, u) in the world, float64."""
        q = self.engine.q.astype(float)
        q[:, :3] += self.engine.origins.numpy()[: self.engine.agent_count]
        return q, self.engine.u.astype(float)


def flight_states(body: Body, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Leaps of a body that both engines start from: half a turn a second, joints turned and turning at random.

    Returns:
        q and u, rounded to float32, shapes [count, q_count] and [count, u_count].
    """
    # A generator each, so that the first leaps are the same however many there are.
    q = np.tile(body.q_reference, (count, 1)) + 0.2 * np.random.default_rng(2).normal(size=(count, body.q_count))
    u = 0.5 * np.random.default_rng(3).normal(size=(count, body.u_count))
    u[:, :3] += (2.0, 0.0, 3.0)
    u[:, 3:6] += (0.0, 3.0, 0.0)
    q = body.normalized(q)
    return q.astype(np.float32).astype(float), u.astype(np.float32).astype(float)
