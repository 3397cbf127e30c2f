"""The reference: a body whose dynamics NumPy computes in float64, for any number of states at once.

`Body` calls the very functions that are traced into the engine's native code (see `articulated`), with NumPy arrays
for scalars. It is slow, exact to rounding, can be stepped through in a debugger, and is what the native code is
measured against.

Every method takes leading batch axes: ``q`` has shape [..., q_count], ``u``, ``tau`` and ``qdd`` [..., u_count], and
what comes back has the same leading axes. `echelon.warp_kernels.model` says what the coordinates are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from echelon.warp_kernels import articulated
from echelon.warp_kernels.integrate import position_rate, semi_implicit_positions
from echelon.warp_kernels.kinematics import Kinematics, kinematics
from echelon.warp_kernels.model import Model
from echelon.warp_kernels.spatial import add, apply, cross, quaternion_normalized, scale
from echelon.warp_kernels.tree import Tree, unroll

Array = np.ndarray


class Body(Model):
    """A model with its mechanics: mass matrix, forward dynamics, kinematics, momentum and energy.

    Angles in rad, lengths in m, masses in kg; the world is x forward, y left, z up.
    """

    @cached_property
    def tree(self) -> Tree:
        """The model unrolled into one-axis nodes, as the engine sees it."""
        return unroll(self)

    # ---- dynamics --------------------------------------------------------------------------------------------------
    def forward_dynamics(self, q: Array, u: Array, tau: Array) -> Array:
        """Rate of the generalised speeds, by the articulated-body algorithm.

        Args:
            q: Generalised positions, shape [..., q_count].
            u: Generalised speeds, shape [..., u_count].
            tau: Generalised forces [N, N m], shape [..., u_count]; for a free joint the force on its origin in the
                world frame, then the moment about its origin in the link's frame.

        Returns:
            qdd [m/s^2, rad/s^2], shape [..., u_count]. Gravity acts; contacts and springs do not.
        """
        kin = self.kinematics(q, u)
        return _joined(articulated.forward_dynamics(kin, _split(tau)), np.asarray(q), np.asarray(u), np.asarray(tau))

    def inverse_dynamics(self, q: Array, u: Array, qdd: Array) -> Array:
        """Generalised forces [N, N m] that give accelerations ``qdd`` against gravity, shape [..., u_count]."""
        kin = self.kinematics(q, u)
        return _joined(articulated.inverse_dynamics(kin, _split(qdd)), np.asarray(q), np.asarray(u), np.asarray(qdd))

    def mass_matrix(self, q: Array) -> Array:
        """Mass matrix, symmetric and positive definite, shape [..., u_count, u_count]."""
        q = np.asarray(q, dtype=float)
        count = self.u_count
        # One unit acceleration a row, all at once along a new axis; what gravity alone needs is taken away.
        spread = np.broadcast_to(q[..., None, :], (*q.shape[:-1], count, q.shape[-1]))
        still = np.zeros((*q.shape[:-1], count, count))
        unit = np.broadcast_to(np.eye(count), still.shape)
        rows = self.inverse_dynamics(spread, still, unit) - self.inverse_dynamics(spread, still, still)
        return 0.5 * (rows + np.swapaxes(rows, -1, -2))

    # ---- kinematics ------------------------------------------------------------------------------------------------
    def kinematics(self, q: Array, u: Array) -> Kinematics:
        """The first pass of the algorithm, for those who want its intermediate values."""
        q, u = np.asarray(q, dtype=float), np.asarray(u, dtype=float)
        if q.shape[-1:] != (self.q_count,) or u.shape[-1:] != (self.u_count,):
            raise ValueError(
                f"body {self.name!r}: q and u end in {q.shape[-1:]} and {u.shape[-1:]}, "
                f"not ({self.q_count},) and ({self.u_count},)"
            )
        return kinematics(self.tree, _split(q), _split(u))

    def link_poses(self, q: Array) -> Array:
        """Pose of every link frame in the world: x y z [m] and quaternion x y z w, shape [..., link_count, 7]."""
        q = np.asarray(q, dtype=float)
        kin = self.kinematics(q, np.zeros((*q.shape[:-1], self.u_count)))
        poses = np.empty((*q.shape[:-1], len(self.links), 7))
        for index, place in enumerate(self.tree.node_of_link):
            rotation, origin = kin.world(place)
            for i in range(3):
                poses[..., index, i] = origin[i]
            poses[..., index, 3:] = quaternion_of_matrix(_matrix(rotation, q.shape[:-1]))
        return poses

    def link_velocities(self, q: Array, u: Array) -> Array:
        """Velocity of every link's origin [m/s] and angular velocity [rad/s], both along the world's axes.

        Shape [..., link_count, 6], linear first.
        """
        kin = self.kinematics(q, u)
        shape = np.broadcast_shapes(np.shape(q)[:-1], np.shape(u)[:-1])
        result = np.empty((*shape, len(self.links), 6))
        for index, place in enumerate(self.tree.node_of_link):
            rotation, _ = kin.world(place)
            for i, value in enumerate([*apply(rotation, kin.velocity(place)), *apply(rotation, kin.omega[place])]):
                result[..., index, i] = value
        return result

    def link_accelerations(self, q: Array, u: Array, qdd: Array) -> Array:
        """Classical acceleration of every link's origin [m/s^2] and angular acceleration [rad/s^2], world axes.

        Shape [..., link_count, 6], linear first. It is what a motion with speeds ``u`` changing at ``qdd`` has; no
        gravity is added or taken away.
        """
        kin = self.kinematics(q, u)
        shape = np.broadcast_shapes(np.shape(q)[:-1], np.shape(u)[:-1], np.shape(qdd)[:-1])
        result = np.empty((*shape, len(self.links), 6))
        every = articulated.link_accelerations(kin, _split(qdd))
        for index, place in enumerate(self.tree.node_of_link):
            rotation, _ = kin.world(place)
            angular, linear = every[place]
            for i, value in enumerate([*apply(rotation, linear), *apply(rotation, angular)]):
                result[..., index, i] = value - (self.gravity if i == 2 else 0.0)
        return result

    # ---- invariants ------------------------------------------------------------------------------------------------
    def center_of_mass(self, q: Array) -> Array:
        """Centre of mass of the whole body in the world [m], shape [..., 3]."""
        q = np.asarray(q, dtype=float)
        kin = self.kinematics(q, np.zeros((*q.shape[:-1], self.u_count)))
        return _joined(self._center(kin), q)[..., :]

    def momentum(self, q: Array, u: Array) -> Array:
        """Linear momentum [kg m/s] and angular momentum about the centre of mass [kg m^2/s], world axes; [..., 6]."""
        kin = self.kinematics(q, u)
        center = self._center(kin)
        linear: list[Any] = [0.0, 0.0, 0.0]
        angular: list[Any] = [0.0, 0.0, 0.0]
        for index, place in enumerate(self.tree.node_of_link):
            inertia, (rotation, origin) = self.tree.inertias[index], kin.world(place)
            omega, velocity = kin.omega[place], kin.velocity(place)
            momentum = add(scale(inertia.mass, velocity), cross(omega, inertia.moment))
            spin = add(apply(inertia.inertia, omega), cross(inertia.moment, velocity))
            in_world = apply(rotation, momentum)
            arm = [o - c for o, c in zip(origin, center, strict=True)]
            linear = add(linear, in_world)
            angular = add(angular, add(apply(rotation, spin), cross(arm, in_world)))
        return _joined([*linear, *angular], np.asarray(q), np.asarray(u))

    def energy(self, q: Array, u: Array) -> Array:
        """Kinetic and potential energy [J], the latter of gravity alone and zero at z = 0; shape [..., 2]."""
        kin = self.kinematics(q, u)
        kinetic: Any = 0.0
        for index, place in enumerate(self.tree.node_of_link):
            inertia, omega, velocity = self.tree.inertias[index], kin.omega[place], kin.velocity(place)
            momentum = add(scale(inertia.mass, velocity), cross(omega, inertia.moment))
            spin = add(apply(inertia.inertia, omega), cross(inertia.moment, velocity))
            for a, b in zip([*omega, *velocity], [*spin, *momentum], strict=True):
                kinetic = kinetic + 0.5 * a * b
        potential = self.mass * self.gravity * self._center(kin)[2]
        return _joined([kinetic, potential], np.asarray(q), np.asarray(u))

    def _center(self, kin: Kinematics) -> list[Any]:
        total: list[Any] = [0.0, 0.0, 0.0]
        for index, place in enumerate(self.tree.node_of_link):
            inertia, (rotation, origin) = self.tree.inertias[index], kin.world(place)
            total = add(total, add(scale(inertia.mass, origin), apply(rotation, inertia.moment)))
        return scale(1.0 / self.mass, total)

    # ---- motion ----------------------------------------------------------------------------------------------------
    def generalized_impulse(self, q: Array, link: str, point: Sequence[float], impulse: Array) -> Array:
        """Change of the generalised speeds from a blow.

        Args:
            q: Generalised positions, shape [..., q_count].
            link: Name of the link that is struck.
            point: Where, in the link's frame [m].
            impulse: In the world frame [N s], shape [..., 3].

        Returns:
            The change of u, shape [..., u_count].
        """
        q, impulse = np.asarray(q, dtype=float), np.asarray(impulse, dtype=float)
        place = self.tree.node_of_link[self.link_index(link)]
        shape = np.broadcast_shapes(q.shape[:-1], impulse.shape[:-1])
        transmitted = np.zeros((*shape, self.u_count))
        for speed in range(self.u_count):
            unit = np.zeros((*q.shape[:-1], self.u_count))
            unit[..., speed] = 1.0
            kin = self.kinematics(q, unit)
            rotation, _ = kin.world(place)
            velocity = apply(rotation, add(kin.velocity(place), cross(kin.omega[place], list(point))))
            transmitted[..., speed] = sum(velocity[i] * impulse[..., i] for i in range(3))
        matrix = np.broadcast_to(self.mass_matrix(q), (*shape, self.u_count, self.u_count))
        return np.linalg.solve(matrix, transmitted[..., None])[..., 0]

    def step_semi_implicit(self, q: Array, u: Array, qdd: Array, step: float) -> tuple[Array, Array]:
        """One semi-implicit Euler step of ``step`` seconds: the speeds first, then positions with the new speeds."""
        u_next = np.asarray(u, dtype=float) + step * np.asarray(qdd, dtype=float)
        q_next = semi_implicit_positions(self.tree, _split(q), _split(u_next), step)
        return _joined(q_next, np.asarray(q), u_next), u_next

    def step_runge_kutta(
        self, q: Array, u: Array, acceleration: Callable[[Array, Array], Array], step: float
    ) -> tuple[Array, Array]:
        """One classical fourth-order Runge-Kutta step of ``step`` seconds.

        Args:
            acceleration: Gives qdd for (q, u).
        """
        q, u = np.asarray(q, dtype=float), np.asarray(u, dtype=float)

        def rate(at_q: Array, at_u: Array) -> tuple[Array, Array]:
            return _joined(position_rate(self.tree, _split(at_q), _split(at_u)), at_q, at_u), acceleration(at_q, at_u)

        q1, u1 = rate(q, u)
        q2, u2 = rate(q + 0.5 * step * q1, u + 0.5 * step * u1)
        q3, u3 = rate(q + 0.5 * step * q2, u + 0.5 * step * u2)
        q4, u4 = rate(q + step * q3, u + step * u3)
        q_next = q + step / 6.0 * (q1 + 2.0 * (q2 + q3) + q4)
        u_next = u + step / 6.0 * (u1 + 2.0 * (u2 + u3) + u4)
        return self.normalized(q_next), u_next

    def normalized(self, q: Array) -> Array:
        """``q`` with every quaternion scaled to unit length."""
        parts = _split(np.asarray(q, dtype=float))
        for node in self.tree.nodes:
            if node.kind in ("free", "ball"):
                start = node.q + (3 if node.kind == "free" else 0)
                parts[start : start + 4] = quaternion_normalized(parts[start : start + 4])
        return _joined(parts, np.asarray(q))


def quaternion_of_matrix(matrix: Array) -> Array:
    """Unit quaternions (x, y, z, w), w not negative, of rotation matrices; shapes [..., 3, 3] to [..., 4]."""
    m = np.asarray(matrix, dtype=float)
    # Each row is four times one component times the whole quaternion; take the row with the largest component.
    rows = np.empty((*m.shape[:-2], 4, 4))
    diagonal = [m[..., i, i] for i in range(3)]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rows[..., i, i] = 1.0 + diagonal[i] - diagonal[j] - diagonal[k]
        rows[..., i, j] = rows[..., j, i] = m[..., j, i] + m[..., i, j]
        rows[..., i, 3] = rows[..., 3, i] = m[..., k, j] - m[..., j, k]
    rows[..., 3, 3] = 1.0 + diagonal[0] + diagonal[1] + diagonal[2]
    largest = np.argmax(np.stack([rows[..., i, i] for i in range(4)], axis=-1), axis=-1)
    chosen = np.take_along_axis(rows, largest[..., None, None], axis=-2)[..., 0, :]
    chosen = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
    return np.where(chosen[..., 3:] < 0.0, -chosen, chosen)


def _split(values: Any) -> list[Any]:
    array = np.asarray(values, dtype=float)
    return [array[..., i] for i in range(array.shape[-1])]


def _joined(scalars: Sequence[Any], *shaped: Array) -> Array:
    """Scalars as one array along a new last axis, with the leading axes that the arguments share."""
    shape = np.broadcast_shapes(*(array.shape[:-1] for array in shaped))
    result = np.empty((*shape, len(scalars)))
    for i, scalar in enumerate(scalars):
        result[..., i] = scalar
    return result


def _matrix(rows: Sequence[Sequence[Any]], shape: tuple[int, ...]) -> Array:
    result = np.empty((*shape, 3, 3))
    for i in range(3):
        for j in range(3):
            result[..., i, j] = rows[i][j]
    return result
