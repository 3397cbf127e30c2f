"""The same body in MuJoCo: another algorithm, by other people, to test ours against.

`echelon.benchmarks.mujoco_peer` says how a body is put together there. Contacts, springs, limits and damping are left
out, as `Body.forward_dynamics` leaves them out.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's names live in an extension module that has no type stubs.)

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from echelon.benchmarks.mujoco_peer import CoordinateOrder, peer_model
from echelon.warp_kernels.model import Model


class MujocoOracle:
    """A model in MuJoCo; methods take and give what those of `Body` do, with at most one leading batch axis."""

    def __init__(self, model: Model) -> None:
        self.gravity = np.array([0.0, 0.0, -model.gravity])
        self.link_names = model.link_names
        self.mj_model = peer_model(model, energy=True)
        self.data = mujoco.MjData(self.mj_model)
        self.bodies = [self.mj_model.body(name).id for name in model.link_names]
        self.total_mass = float(sum(link.mass for link in model.links))
        self.order = CoordinateOrder.of(model, self.mj_model)

    # ---- what is compared --------------------------------------------------------------------------------------------
    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        def one(q: np.ndarray) -> np.ndarray:
            self._set(q)
            mujoco.mj_forward(self.mj_model, self.data)
            full = np.zeros((self.mj_model.nv, self.mj_model.nv))
            mujoco.mj_fullM(self.mj_model, self.data, full)
            ours = np.empty_like(full)
            ours[np.ix_(self.order.qvel_from_u, self.order.qvel_from_u)] = full
            return ours

        return _each(one, q)

    def forward_dynamics(self, q: np.ndarray, u: np.ndarray, tau: np.ndarray) -> np.ndarray:
        def one(q: np.ndarray, u: np.ndarray, tau: np.ndarray) -> np.ndarray:
            self._set(q, u)
            self.data.qfrc_applied[:] = tau[self.order.qvel_from_u]
            mujoco.mj_forward(self.mj_model, self.data)
            return self.order.to_u(self.data.qacc)

        return _each(one, q, u, tau)

    def link_poses(self, q: np.ndarray) -> np.ndarray:
        def one(q: np.ndarray) -> np.ndarray:
            self._set(q)
            mujoco.mj_kinematics(self.mj_model, self.data)
            quaternions = self.data.xquat[self.bodies][:, [1, 2, 3, 0]]
            return np.concatenate([self.data.xpos[self.bodies], quaternions], axis=-1)

        return _each(one, q)

    def link_accelerations(self, q: np.ndarray, u: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """From Jacobians and their rates of change: J qdd + dJ/dt u."""

        def one(q: np.ndarray, u: np.ndarray, qdd: np.ndarray) -> np.ndarray:
            self._set(q, u)
            mujoco.mj_forward(self.mj_model, self.data)
            size = (3, self.mj_model.nv)
            jacobian, rotational, rate, rotational_rate = (np.zeros(size) for _ in range(4))
            qvel, qacc = u[self.order.qvel_from_u], qdd[self.order.qvel_from_u]
            result = np.empty((len(self.bodies), 6))
            for index, body in enumerate(self.bodies):
                point = self.data.xpos[body]
                mujoco.mj_jac(self.mj_model, self.data, jacobian, rotational, point, body)
                mujoco.mj_jacDot(self.mj_model, self.data, rate, rotational_rate, point, body)
                result[index, :3] = jacobian @ qacc + rate @ qvel
                result[index, 3:] = rotational @ qacc + rotational_rate @ qvel
            return result

        return _each(one, q, u, qdd)

    def sensed_link_accelerations(self, q: np.ndarray, u: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """The same from MuJoCo's recursion, which an accelerometer would read: gravity is in it and taken out here."""

        def one(q: np.ndarray, u: np.ndarray, qdd: np.ndarray) -> np.ndarray:
            self._set(q, u)
            mujoco.mj_forward(self.mj_model, self.data)
            self.data.qacc[:] = qdd[self.order.qvel_from_u]
            mujoco.mj_rnePostConstraint(self.mj_model, self.data)
            result = np.empty((len(self.bodies), 6))
            spatial = np.zeros(6)
            for index, body in enumerate(self.bodies):
                kind = mujoco.mjtObj.mjOBJ_XBODY
                mujoco.mj_objectAcceleration(self.mj_model, self.data, kind, body, spatial, 0)
                result[index] = [*(spatial[3:] + self.gravity), *spatial[:3]]
            return result

        return _each(one, q, u, qdd)

    def momentum(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        def one(q: np.ndarray, u: np.ndarray) -> np.ndarray:
            self._set(q, u)
            mujoco.mj_forward(self.mj_model, self.data)
            mujoco.mj_subtreeVel(self.mj_model, self.data)
            return np.concatenate([self.total_mass * self.data.subtree_linvel[0], self.data.subtree_angmom[0]])

        return _each(one, q, u)

    def energy(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        def one(q: np.ndarray, u: np.ndarray) -> np.ndarray:
            self._set(q, u)
            mujoco.mj_forward(self.mj_model, self.data)
            potential, kinetic = self.data.energy
            return np.array([kinetic, potential])

        return _each(one, q, u)

    # ---- states ------------------------------------------------------------------------------------------------------
    def _set(self, q: np.ndarray, u: np.ndarray | None = None) -> None:
        mujoco.mj_resetData(self.mj_model, self.data)
        self.order.write(self.data, q, u)


def _each(function: Callable[..., np.ndarray], *states: np.ndarray) -> np.ndarray:
    """Call with one state or, where there is a batch axis, with one after another."""
    if states[0].ndim == 1:
        return function(*states)
    return np.stack([function(*one) for one in zip(*states, strict=True)])
