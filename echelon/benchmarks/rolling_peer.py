"""MuJoCo's half of the race with the cyclist: the same body, rolling, with a constraint in place of each loop's spring.

Hands and feet are held by `connect` constraints and the chain is a `joint` constraint; wheels are the same flat
ellipsoids as ours on a plane; what servos hold has springs and dampers of their gains. Hips and knees, which pedals
carry round, have the dampers alone. Nobody steers, so that the bicycle tips over sooner or later: it is set rolling
anew before that, with the cranks at another angle.

What was tried, and is not faster: the solvers CG and PGS and a sparse Jacobian (slower), elliptic cones (the same),
cylinders for wheels (slower: two contacts each), spheres (the same, but a wheel that leans then rolls on another
radius). CG that is cut off after two iterations is an eighth faster, but joint speeds are then up to 3 rad/s off; with
a solver that converges a step of 1/1200 s costs 0.04 rad/s, as it does in our engine.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's names live in an extension module that has no type stubs.)

from __future__ import annotations

import time
from collections.abc import Sequence

import mujoco
import numpy as np

from echelon.agents.riders import cyclist
from echelon.agents.riders.bicycle import FRONT_SPEED, REAR_ANGLE, REAR_SPEED, REAR_WHEEL
from echelon.agents.riders.body import CRANK, SIDES
from echelon.agents.riders.cyclist import Cyclist
from echelon.agents.riders.pedalling import CADENCE
from echelon.benchmarks.mujoco_peer import CoordinateOrder, Coupling, JointSpring, peer_model, without_log
from echelon.benchmarks.riding_run import RIDING_SPEED
from echelon.benchmarks.sanity import Verdict, judge_rolling, spring_gaps

ROLLING_TIME = 0.5  # it is set rolling anew after this time, before it tips over [s]
CRANK_ANGLES = (0.0, 0.5 * np.pi, np.pi, 1.5 * np.pi)  # that it is set rolling with
STARTS = 8  # a round


class RollingPeer:
    """The cyclist's body in MuJoCo, rolling at the speed that ours ride at.

    Attributes:
        model: What MuJoCo simulates.
    """

    contacts = 2

    def __init__(self, character: Cyclist, step: float, integrator: str) -> None:
        self.step, self.integrator = step, integrator
        self._character = character
        self._body = character.body
        self._gear = RIDING_SPEED / (character.bicycle.rear_wheel.radius * CADENCE)
        self._springs = joint_springs(character)
        self.model = peer_model(
            self._body,
            springs=self._springs,
            floor=True,
            use="usual",
            tied=True,
            couplings=[Coupling(REAR_WHEEL, CRANK, self._gear)],
            step=step,
            integrator=integrator,
        )
        self._data = mujoco.MjData(self.model)
        self._order = CoordinateOrder.of(self._body, self.model)
        self._starts = [self._start(angle) for angle in CRANK_ANGLES]

    def _start(self, crank: float) -> tuple[np.ndarray, np.ndarray]:
        """(q, u) of a rider at speed whose cranks stand at an angle [rad]."""
        still, speed = np.zeros(1), np.full(1, RIDING_SPEED)
        q, u = self._character.riding(still, speed, still, np.full(1, crank), np.full(1, self._gear))
        q[0, REAR_ANGLE] = self._gear * crank
        return q[0], u[0]

    def _set_rolling(self, q: np.ndarray, u: np.ndarray) -> None:
        mujoco.mj_resetData(self.model, self._data)
        self._order.write(self._data, q, u)
        # Springs hold the pose of the start.
        self.model.qpos_spring[:] = self._data.qpos

    def round(self) -> float:
        steps, seconds = max(round(ROLLING_TIME / self.step), 1), 0.0
        for start in range(STARTS):
            self._set_rolling(*self._starts[start % len(self._starts)])
            begin = time.perf_counter()
            mujoco.mj_step(self.model, self._data, nstep=steps)
            seconds += time.perf_counter() - begin
        return seconds / (STARTS * steps) * 1e6

    def verdict(self) -> Verdict:
        with without_log():
            verdicts = [self._judged(start) for start in range(len(self._starts))]
        return next((verdict for verdict in verdicts if not verdict.sane), verdicts[0])

    def rolled(self, start: int) -> tuple[np.ndarray, np.ndarray, float]:
        """What is timed, looked at after every step.

        Args:
            start: With which of the `CRANK_ANGLES`.

        Returns:
            q and u from the start to the end, shapes [steps + 1, q_count] and [steps + 1, u_count], and the part of
            the steps in which both wheels touched the ground.
        """
        self._set_rolling(*self._starts[start])
        states, bearing = [self._starts[start]], 0
        steps = max(round(ROLLING_TIME / self.step), 1)
        for _ in range(steps):
            mujoco.mj_step(self.model, self._data)
            states.append(self._order.read(self._data))
            bearing += self._data.ncon >= self.contacts
        q, u = (np.stack(parts) for parts in zip(*states, strict=True))
        return q, u, bearing / steps

    def _judged(self, start: int) -> Verdict:
        q, u, bearing = self.rolled(start)
        wheels = self._character.bicycle.rear_wheel, self._character.bicycle.front_wheel
        speed = np.hypot(u[:, 0], u[:, 1])
        slips = [speed - wheel.radius * u[:, at] for wheel, at in zip(wheels, (REAR_SPEED, FRONT_SPEED), strict=True)]
        return judge_rolling(
            self._body,
            q,
            u,
            self._spring_energy(q),
            bearing,
            float(np.max(spring_gaps(self._body, self._body.link_poses(q)))),
            float(np.max(np.abs(slips))),
        )

    def _spring_energy(self, q: np.ndarray) -> np.ndarray:
        """What joint springs hold [J], shape [steps]; those of the start are at rest in its first state."""
        energy = np.zeros(len(q))
        for index, link in enumerate(self._body.links):
            first = self._body.q_start(index)
            for axis, spring in enumerate(self._springs.get(link.joint.name, ())):
                energy += 0.5 * spring.stiffness * (q[:, first + axis] - q[0, first + axis]) ** 2
        return energy


def joint_springs(character: Cyclist) -> dict[str, Sequence[JointSpring]]:
    """Springs and dampers in place of a cyclist's servos and bearings, by name of the joint."""
    bicycle = character.bicycle
    springs: dict[str, Sequence[JointSpring]] = {
        "steer": (JointSpring(0.0, bicycle.fork_damping),),
        "rear_wheel": (JointSpring(0.0, bicycle.rolling_resistance),),
        "front_wheel": (JointSpring(0.0, bicycle.rolling_resistance),),
        "seat": (JointSpring(0.0, cyclist.SEAT_DAMPING),),
        "waist": [JointSpring(*cyclist.WAIST)] * 3,
    }
    shoulder = cyclist.SHOULDER, cyclist.SHOULDER, cyclist.SHOULDER_TURN
    for side, _ in SIDES:
        springs[f"{side}_shoulder"] = [JointSpring(*gains) for gains in shoulder]
        springs[f"{side}_elbow"] = (JointSpring(*cyclist.ELBOW),)
        springs[f"{side}_hip"] = (JointSpring(0.0, cyclist.HIP[1]),)
        springs[f"{side}_knee"] = (JointSpring(0.0, cyclist.KNEE[1]),)
        springs[f"{side}_ankle"] = (JointSpring(*cyclist.ANKLE),)
    return springs
