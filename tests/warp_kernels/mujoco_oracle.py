"""The same body in MuJoCo: another algorithm, by other people, to test ours against.

Every link becomes one MuJoCo body at its joint's position: a pin one hinge, a universal joint two and a gimbal three
hinges in the same place, a slider a slide joint, ball and free what they are there. Inertia goes in as a full tensor
about the centre of mass. Contacts, springs, limits and damping are left out, as `Body.forward_dynamics` leaves them
out. Coordinates mean the same on both sides, so conversion is a permutation: MuJoCo orders bodies depth first and
writes quaternions w first.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's names live in an extension module that has no type stubs.)

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from echelon.warp_kernels.model import Link, Model

_QUATERNION_WXYZ = (3, 0, 1, 2)  # where w x y z stand among our x y z w


class MujocoOracle:
    """A model in MuJoCo; methods take and give what those of `Body` do, with at most one leading batch axis."""

    def __init__(self, model: Model) -> None:
        self.gravity = np.array([0.0, 0.0, -model.gravity])
        self.link_names = model.link_names
        self.mj_model = _compiled(model)
        self.data = mujoco.MjData(self.mj_model)
        self.bodies = [self.mj_model.body(name).id for name in model.link_names]
        self.total_mass = float(sum(link.mass for link in model.links))
        self.qpos_from_q, self.qvel_from_u = _permutations(model, self.mj_model)

    # ---- what is compared --------------------------------------------------------------------------------------------
    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        def one(q: np.ndarray) -> np.ndarray:
            self._set(q)
            mujoco.mj_forward(self.mj_model, self.data)
            full = np.zeros((self.mj_model.nv, self.mj_model.nv))
            mujoco.mj_fullM(self.mj_model, self.data, full)
            ours = np.empty_like(full)
            ours[np.ix_(self.qvel_from_u, self.qvel_from_u)] = full
            return ours

        return _each(one, q)

    def forward_dynamics(self, q: np.ndarray, u: np.ndarray, tau: np.ndarray) -> np.ndarray:
        def one(q: np.ndarray, u: np.ndarray, tau: np.ndarray) -> np.ndarray:
            self._set(q, u)
            self.data.qfrc_applied[:] = tau[self.qvel_from_u]
            mujoco.mj_forward(self.mj_model, self.data)
            return self._to_u(self.data.qacc)

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
            qvel, qacc = u[self.qvel_from_u], qdd[self.qvel_from_u]
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
            self.data.qacc[:] = qdd[self.qvel_from_u]
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
        self.data.qpos[:] = q[self.qpos_from_q]
        if u is not None:
            self.data.qvel[:] = u[self.qvel_from_u]

    def _to_u(self, qvel: np.ndarray) -> np.ndarray:
        ours = np.empty_like(qvel)
        ours[self.qvel_from_u] = qvel
        return ours


def _each(function: Callable[..., np.ndarray], *states: np.ndarray) -> np.ndarray:
    """Call with one state or, where there is a batch axis, with one after another."""
    if states[0].ndim == 1:
        return function(*states)
    return np.stack([function(*one) for one in zip(*states, strict=True)])


# ---- the model -------------------------------------------------------------------------------------------------------
def _compiled(model: Model) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.autolimits = False
    spec.option.gravity = [0.0, 0.0, -model.gravity]
    spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    bodies = {}
    for link in model.links:
        parent = spec.worldbody if link.parent is None else bodies[link.parent]
        body = parent.add_body(name=link.name, pos=link.joint.position)
        body.explicitinertial = True
        body.mass = link.mass
        body.ipos = link.com
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = link.inertia
        body.fullinertia = [xx, yy, zz, xy, xz, yz]
        _add_joints(body, link)
        bodies[link.name] = body
    return spec.compile()


def _add_joints(body: mujoco.MjsBody, link: Link) -> None:
    name, kind = link.joint.name, link.joint.kind
    if kind == "free":
        body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_FREE)
    elif kind == "ball":
        body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_BALL)
    else:
        moving = mujoco.mjtJoint.mjJNT_SLIDE if kind == "slider" else mujoco.mjtJoint.mjJNT_HINGE
        for number, axis in enumerate(link.joint.axes):
            body.add_joint(name=f"{name} {number}", type=moving, axis=axis)


def _permutations(model: Model, mj_model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """For every entry of qpos (and qvel) the index of the same thing in our q (and u)."""
    qpos_from_q = np.full(mj_model.nq, -1)
    qvel_from_u = np.full(mj_model.nv, -1)
    for index, link in enumerate(model.links):
        q, u, kind = model.q_start(index), model.u_start(index), link.joint.kind
        first = link.joint.name if kind in ("free", "ball") else f"{link.joint.name} 0"
        joint = mj_model.joint(first).id
        qpos, qvel = mj_model.jnt_qposadr[joint], mj_model.jnt_dofadr[joint]
        if kind == "free":
            qpos_from_q[qpos : qpos + 7] = [q, q + 1, q + 2, *(q + 3 + i for i in _QUATERNION_WXYZ)]
            qvel_from_u[qvel : qvel + 6] = range(u, u + 6)
        elif kind == "ball":
            qpos_from_q[qpos : qpos + 4] = [q + i for i in _QUATERNION_WXYZ]
            qvel_from_u[qvel : qvel + 3] = range(u, u + 3)
        else:
            for number in range(len(link.joint.axes)):
                qpos_from_q[qpos + number] = q + number
                qvel_from_u[qvel + number] = u + number
    assert sorted(qpos_from_q) == list(range(model.q_count))
    assert sorted(qvel_from_u) == list(range(model.u_count))
    return qpos_from_q, qvel_from_u
