"""MuJoCo's half of the race: `mj_step` in C, many steps a call, on one core, timed round by round and then judged."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's names live in an extension module that has no type stubs.)

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Protocol

import mujoco
import numpy as np

from echelon.agents import hopper
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.riders.cyclist import Cyclist
from echelon.agents.servo import ServoedBody
from echelon.benchmarks.engine_runs import JUDGED_AGENTS, flight_states
from echelon.benchmarks.gymnast_peer import GymnastPeer
from echelon.benchmarks.mujoco_peer import CoordinateOrder, JointSpring, peer_model, without_log
from echelon.benchmarks.rolling_peer import RollingPeer
from echelon.benchmarks.sanity import Verdict, judge_flight, judge_standing
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.model import Q_COUNT
from echelon.warp_kernels.reference import Body

STANDING_TIME = 0.25  # it is set down anew after this time, before it could topple [s]
STANDING_STARTS = 20  # a round
DROP_TIME = 0.5  # of the fall from a hop's height that is looked at, not timed [s]
STANDING_TILT = 0.03  # [rad]
FLIGHT_TIME = 1.0  # [s]
FLIGHT_STARTS = 4  # a round
FLIGHT_SAMPLES = 5


class PeerRun(Protocol):
    """A run of MuJoCo that is timed in rounds.

    Attributes:
        step: Its time step [s].
        integrator: Its integrator, by MuJoCo's name.
        contacts: Sites that can touch the floor.
    """

    step: float
    integrator: str
    contacts: int

    def round(self) -> float:
        """Advance by one round; how long a step took [us]."""
        ...

    def verdict(self) -> Verdict:
        """Whether the steps that are timed are sane."""
        ...


def start_peer(character: Character, step: float, integrator: str) -> PeerRun:
    """The run in which MuJoCo is timed on a character's body."""
    if isinstance(character, ServoedBody):
        return FlightPeer(character, step, integrator)
    if isinstance(character, Cyclist):
        return RollingPeer(character, step, integrator)
    if isinstance(character, Gymnast):
        return GymnastPeer(character, step, integrator)
    return StandingPeer(character.body, step, integrator)


def standing_springs() -> dict[str, tuple[JointSpring, ...]]:
    """Springs and dampers of a hopper that stands, by name of the joint."""
    hip = JointSpring(hopper.TILT_STIFFNESS, hopper.TILT_DAMPING)
    twist = JointSpring(hopper.YAW_STIFFNESS, hopper.YAW_DAMPING)
    return {"hip": (hip, hip, twist), "leg": (JointSpring(hopper.LEG_STIFFNESS, hopper.LEG_DAMPING),)}


def spring_stiffness(body: Body, springs: Mapping[str, Sequence[JointSpring]]) -> np.ndarray:
    """Of every coordinate's spring about zero [N m/rad or N/m], shape [q_count]."""
    stiffness = np.zeros(body.q_count)
    for index, link in enumerate(body.links):
        for axis, spring in enumerate(springs.get(link.joint.name, ())):
            stiffness[body.q_start(index) + axis] = spring.stiffness
    return stiffness


def standing_pose(body: Body, height: float = 0.0) -> np.ndarray:
    """Upright but for a small tilt, the foot so high above the floor [m]; shape [q_count]."""
    q = body.q_reference
    q[2] += height
    q[3:7] = [np.sin(0.5 * STANDING_TILT), 0.0, 0.0, np.cos(0.5 * STANDING_TILT)]
    return q


class StandingPeer:
    """The hopper's body on its foot: leg spring and hip springs on, the foot on the floor, set down again and again."""

    def __init__(self, body: Body, step: float, integrator: str) -> None:
        self.step, self.integrator = step, integrator
        self.contacts = sum(site.surface == "ground" for site in body.contacts)
        springs = standing_springs()
        self._body = body
        self._model = peer_model(body, springs=springs, floor=True, step=step, integrator=integrator)
        self._data = mujoco.MjData(self._model)
        self._order = CoordinateOrder.of(body, self._model)
        self._stiffness = spring_stiffness(body, springs)

    def _set_down(self, height: float) -> None:
        """Upright but for a small tilt, at rest, the foot this high above the floor [m]."""
        mujoco.mj_resetData(self._model, self._data)
        self._order.write(self._data, standing_pose(self._body, height), np.zeros(self._body.u_count))

    def round(self) -> float:
        steps, seconds = max(round(STANDING_TIME / self.step), 1), 0.0
        for _ in range(STANDING_STARTS):
            self._set_down(0.0)
            start = time.perf_counter()
            mujoco.mj_step(self._model, self._data, nstep=steps)
            seconds += time.perf_counter() - start
        return seconds / (STANDING_STARTS * steps) * 1e6

    def verdict(self) -> Verdict:
        with without_log():
            return self._judged()

    def _judged(self) -> Verdict:
        dropped = self._watched(hopper.HOP_HEIGHT, DROP_TIME)
        return self._watched(0.0, STANDING_TIME) if dropped.sane else Verdict(False, f"dropped: {dropped.why}")

    def _watched(self, height: float, seconds: float) -> Verdict:
        self._set_down(height)
        states, touches = [self._order.read(self._data)], 0
        for _ in range(max(round(seconds / self.step), 1)):
            mujoco.mj_step(self._model, self._data)
            states.append(self._order.read(self._data))
            touches += self._data.ncon > 0
        q, u = (np.stack(parts) for parts in zip(*states, strict=True))
        return judge_standing(self._body, q, u, self._stiffness, touches / (len(states) - 1))


class FlightPeer:
    """A body in free flight with a spring and damper at each joint in place of a servo, constraints off."""

    contacts = 0

    def __init__(self, character: ServoedBody, step: float, integrator: str) -> None:
        self.step, self.integrator = step, integrator
        body = character.body
        springs: dict[str, list[JointSpring]] = {}
        for index, link in enumerate(body.links):
            kind, first = link.joint.kind, body.u_start(index)
            if kind != "free":
                count = 1 if kind == "ball" else Q_COUNT[kind]
                gains = zip(character.stiffness[first:], character.damping[first:], strict=False)
                springs[link.joint.name] = [JointSpring(*pair) for _, pair in zip(range(count), gains, strict=False)]
        self._body = body
        self._stiffness = max(character.stiffness)
        self._model = peer_model(body, springs=springs, step=step, integrator=integrator)
        self._data = mujoco.MjData(self._model)
        self._order = CoordinateOrder.of(body, self._model)
        self._starts = flight_states(body, JUDGED_AGENTS)

    def round(self) -> float:
        steps, seconds = max(round(FLIGHT_TIME / self.step), 1), 0.0
        for start_q, start_u in list(zip(*self._starts, strict=True))[:FLIGHT_STARTS]:
            self._launch(start_q, start_u)
            start = time.perf_counter()
            mujoco.mj_step(self._model, self._data, nstep=steps)
            seconds += time.perf_counter() - start
        return seconds / (FLIGHT_STARTS * steps) * 1e6

    def verdict(self) -> Verdict:
        with without_log():
            return self._judged()

    def _judged(self) -> Verdict:
        steps = max(round(FLIGHT_TIME / (FLIGHT_SAMPLES * self.step)), 1)
        samples = [[(q.copy(), u.copy())] for q, u in zip(*self._starts, strict=True)]
        for (q, u), seen in zip(zip(*self._starts, strict=True), samples, strict=True):
            self._launch(q, u)
            for _ in range(FLIGHT_SAMPLES):
                mujoco.mj_step(self._model, self._data, nstep=steps)
                seen.append(self._order.read(self._data))
        together = [
            (np.stack([q for q, _ in at_once]), np.stack([u for _, u in at_once]))
            for at_once in zip(*samples, strict=True)
        ]
        return judge_flight(self._body, together, FLIGHT_SAMPLES * steps * self.step, self._stiffness)

    def _launch(self, q: np.ndarray, u: np.ndarray) -> None:
        mujoco.mj_resetData(self._model, self._data)
        self._order.write(self._data, q, u)
