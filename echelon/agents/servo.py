"""Any body with a servo at each of its joints: a puppet that holds, or moves to, a pose.

tau = kp (desired - q) - kv u, equation 3.3 of *Simulation of Leaping, Tumbling, Landing, and Balancing Humans*, taken
implicitly. It is the engine's plainest character: with gains of zero the body is left to itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from echelon.warp_kernels.character import Population, View
from echelon.warp_kernels.contact import JointForces
from echelon.warp_kernels.model import AXIS_COUNT
from echelon.warp_kernels.reference import Body


class ServoedBody:
    """A body held by servos, as a `Character`.

    Its parameters are the desired coordinates, one for each axis of a one-axis joint (`<coordinate>`); a ball joint is
    held at its reference orientation, a free joint is free.

    Args:
        body: What is held.
        stiffness: kp, one for all joints or one a speed [N m/rad or N/m].
        damping: kv, likewise [N m s/rad or N s/m].
    """

    commands: tuple[str, ...] = ()
    phase_names: tuple[str, ...] = ("held",)
    events: tuple[str, ...] = ()
    records: tuple[str, ...] = ()
    steps_per_second: int = 1200
    steps_per_tick: int = 10
    memory: Mapping[str, float] = {"phase": 0.0, "fallen": 0.0, "loaded": 0.0}

    def __init__(self, body: Body, stiffness: float | Sequence[float], damping: float | Sequence[float]) -> None:
        self.name = f"servoed-{body.name}"
        self.body = body
        self.stiffness = _each(stiffness, body.u_count)
        self.damping = _each(damping, body.u_count)
        self.parameters: Mapping[str, float] = {
            body.coordinate_names[body.q_start(index) + axis]: 0.0
            for index, link in enumerate(body.links)
            for axis in range(AXIS_COUNT[link.joint.kind])
        }

    def population(self, count: int, seed: int, variation: float, in_phase: bool) -> Population:
        """Bodies in their reference pose; nothing differs."""
        return Population(
            np.tile(self.body.q_reference, (count, 1)), np.zeros((count, self.body.u_count)), parameters={}, memory={}
        )

    def control(self, view: View) -> None:
        """Nothing to decide."""

    def actuate(self, view: View, joints: JointForces) -> None:
        """A servo at each joint."""
        body = self.body
        for index, link in enumerate(body.links):
            at_q, at_u = body.q_start(index), body.u_start(index)
            if link.joint.kind == "ball":
                kp, kv = self.stiffness[at_u], self.damping[at_u]
                if kp != 0.0 or kv != 0.0:
                    at_rest = [0.0, 0.0, 0.0, 1.0]
                    joints.ball_servo(
                        at_u, list(view.q[at_q : at_q + 4]), list(view.u[at_u : at_u + 3]), at_rest, kp, kv,
                        view.implicit_step,
                    )  # fmt: skip
                continue
            for axis in range(AXIS_COUNT[link.joint.kind]):
                kp, kv = self.stiffness[at_u + axis], self.damping[at_u + axis]
                if kp == 0.0 and kv == 0.0:
                    continue
                desired = view.parameters[body.coordinate_names[at_q + axis]]
                joints.servo(
                    at_u + axis, view.q[at_q + axis], view.u[at_u + axis], desired, 0.0, kp, kv, view.implicit_step
                )


def _each(value: float | Sequence[float], count: int) -> tuple[float, ...]:
    if isinstance(value, float | int):
        return (float(value),) * count
    if len(value) != count:
        raise ValueError(f"{len(value)} gains for {count} speeds")
    return tuple(float(x) for x in value)
