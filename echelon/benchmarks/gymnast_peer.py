"""MuJoCo's half of the race with the gymnast: the same body on its feet, a spring and damper for each servo.

The soles are twelve spheres on a plane, where ours have points; what touches the ground in a fall only is left out, as
are balance and any other control. The ankles' springs alone are stiff enough to keep the body up for a while: it is set
down anew before it could drift.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's names live in an extension module that has no type stubs.)

from __future__ import annotations

import time
from dataclasses import replace

import mujoco
import numpy as np

from echelon.agents.gymnasts.channels import LIMBS, NECK, NECK_JOINT, SIDES, SPINE, SPINE_JOINTS
from echelon.agents.gymnasts.gymnast import ARMS_SPREAD, GAINS, SPINE_GAINS, Gymnast
from echelon.agents.gymnasts.standing import standing_q
from echelon.benchmarks.mujoco_peer import CoordinateOrder, JointSpring, peer_model, without_log
from echelon.benchmarks.sanity import Verdict, fault_of_states
from echelon.warp_kernels.model import ContactSite

STANDING_TIME = 0.25  # it is set down anew after this time [s]
STANDING_STARTS = 8  # a round
SOLE_RADIUS = 0.005  # of the spheres under the soles [m]
FARTHEST = 0.03  # that the centre of mass may move meanwhile [m]
LOADED = 0.9  # of the steps, in which at least half of the spheres must bear


class GymnastPeer:
    """A gymnast's body that stands; see the module's text.

    Attributes:
        model: What MuJoCo simulates.
    """

    def __init__(self, character: Gymnast, step: float, integrator: str) -> None:
        self.step, self.integrator = step, integrator
        self._body = character.body
        soles = tuple(_sphere(site) for site in character.body.contacts if site.use == "usual")
        self.contacts = len(soles)
        shod = replace(character.body, contacts=soles)
        self.model = peer_model(shod, springs=joint_springs(character), floor=True, step=step, integrator=integrator)
        self._data = mujoco.MjData(self.model)
        self._order = CoordinateOrder.of(shod, self.model)
        self._pose = standing_q(character.body, arms=0.5 * np.pi - ARMS_SPREAD)

    def _set_down(self) -> None:
        mujoco.mj_resetData(self.model, self._data)
        self._order.write(self._data, self._pose, np.zeros(self._body.u_count))
        # Springs hold the pose of the start.
        self.model.qpos_spring[:] = self._data.qpos

    def round(self) -> float:
        steps, seconds = max(round(STANDING_TIME / self.step), 1), 0.0
        for _ in range(STANDING_STARTS):
            self._set_down()
            begin = time.perf_counter()
            mujoco.mj_step(self.model, self._data, nstep=steps)
            seconds += time.perf_counter() - begin
        return seconds / (STANDING_STARTS * steps) * 1e6

    def verdict(self) -> Verdict:
        with without_log():
            return self._judged()

    def _judged(self) -> Verdict:
        self._set_down()
        states, bearing = [self._order.read(self._data)], 0
        steps = max(round(STANDING_TIME / self.step), 1)
        for _ in range(steps):
            mujoco.mj_step(self.model, self._data)
            states.append(self._order.read(self._data))
            bearing += 2 * self._data.ncon >= self.contacts
        q, u = (np.stack(parts) for parts in zip(*states, strict=True))
        fault = fault_of_states(self._body, q, u)
        if fault:
            return Verdict(False, fault)
        centers = np.stack([self._body.center_of_mass(row) for row in q])
        moved = float(np.linalg.norm(centers - centers[0], axis=1).max())
        share = bearing / steps
        text = f"stands, its centre of mass moved by {1e3 * moved:.1f} mm, on its feet {share:.0%} of the time"
        return Verdict(moved <= FARTHEST and share >= LOADED, text)


def _sphere(site: ContactSite) -> ContactSite:
    """A point of a sole as a small sphere that touches the same ground."""
    x, y, z = site.position
    return replace(site, position=(x, y, z + SOLE_RADIUS), radii=(SOLE_RADIUS,) * 3)


def joint_springs(character: Gymnast) -> dict[str, tuple[JointSpring, ...]]:
    """Springs and dampers with the gains of a gymnast's servos, by name of the joint."""
    found: dict[str, list[tuple[float, float]]] = {}

    def servo(joint: str, axis: int, gains: tuple[float, float]) -> None:
        axes = found.setdefault(joint, [])
        axes += [(0.0, 0.0)] * (axis + 1 - len(axes))
        axes[axis] = gains

    for side in SIDES:
        for joint in LIMBS.values():
            servo(f"{side}_{joint.joint}", joint.axis, GAINS[joint.group])
        servo(f"{side}_shoulder", 0, GAINS["shoulder"])
    for joint in SPINE_JOINTS:
        for axis in SPINE.values():
            servo(joint, axis, SPINE_GAINS[joint])
    for axis in NECK.values():
        servo(NECK_JOINT, axis, GAINS["neck"])
    return {
        joint: tuple(JointSpring(character.gain * kp, character.gain * kv) for kp, kv in gains)
        for joint, gains in found.items()
    }
