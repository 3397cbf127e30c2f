"""Where the nodes of a tree are and how they turn, written once over scalars.

After chapter 5 of Featherstone, *Rigid Body Dynamics Algorithms* (2008): from the root outwards, in link coordinates.
Linear velocities are never computed unless a contact or a spring asks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from echelon.warp_kernels.spatial import (
    Matrix,
    Vector,
    add,
    apply_onto,
    apply_transposed,
    apply_transposed_onto,
    cross,
    identity,
    is_zero,
    multiply,
    quaternion_matrix,
    quaternion_product,
    scale,
    skew,
)
from echelon.warp_kernels.trace import sincos
from echelon.warp_kernels.tree import Tree


@dataclass
class Kinematics:
    """Where the nodes are and how they turn.

    Attributes:
        rotation: For each node, the matrix that takes its vectors to its parent's axes.
        offset: For each node, its origin in its parent's frame [m].
        omega: For each node, its angular velocity in its own axes [rad/s].
        rate: For each node, the part of omega that its own joint adds.
    """

    tree: Tree
    q: Sequence[Any]
    u: Sequence[Any]
    rotation: list[Matrix]
    offset: list[Vector]
    omega: list[Vector]
    rate: list[Vector]
    _world: dict[int, tuple[Matrix, Vector]] = field(default_factory=dict)
    _velocity: dict[int, Vector] = field(default_factory=dict)

    def world(self, place: int) -> tuple[Matrix, Vector]:
        """Rotation matrix (node to world) and origin in the world of a node [m]."""
        if place not in self._world:
            node = self.tree.nodes[place]
            if node.parent < 0:
                self._world[place] = (self.rotation[place], self.offset[place])
            else:
                turn, origin = self.world(node.parent)
                self._world[place] = (
                    multiply(turn, self.rotation[place]),
                    apply_onto(origin, turn, self.offset[place]),
                )
        return self._world[place]

    def world_velocity(self, place: int) -> Vector:
        """Velocity of a node's origin along the world's axes [m/s]."""
        if place not in self._velocity:
            node = self.tree.nodes[place]
            if node.kind == "free":
                velocity = list(self.u[node.u : node.u + 3])
            elif node.parent < 0:
                velocity = [0.0, 0.0, 0.0]
            else:
                parent = node.parent
                turn, _ = self.world(parent)
                velocity = self.world_velocity(parent)
                relative = cross(self.omega[parent], self.offset[place])
                if node.kind == "prismatic":
                    relative = add(relative, scale(self.u[node.u], list(node.axis)))
                if not all(is_zero(x) for x in relative):
                    velocity = apply_onto(velocity, turn, relative)
            if node.parent < 0 and node.kind == "prismatic":
                velocity = scale(self.u[node.u], list(node.axis))
            self._velocity[place] = velocity
        return self._velocity[place]

    def velocity(self, place: int) -> Vector:
        """Velocity of a node's origin in its own axes [m/s]."""
        return apply_transposed(self.world(place)[0], self.world_velocity(place))


def kinematics(tree: Tree, q: Sequence[Any], u: Sequence[Any]) -> Kinematics:
    """Rotations, offsets and angular velocities of every node."""
    kin = Kinematics(tree, q, u, [], [], [], [])
    for node in tree.nodes:
        offset = list(node.offset)
        if node.kind == "free":
            rotation = quaternion_matrix(list(q[node.q + 3 : node.q + 7]))
            offset = list(q[node.q : node.q + 3])
            rate = list(u[node.u + 3 : node.u + 6])
        elif node.kind == "ball":
            rotation = quaternion_matrix(list(q[node.q : node.q + 4]))
            rate = list(u[node.u : node.u + 3])
        elif node.kind == "revolute":
            rotation = axis_rotation(node.axis, q[node.q])
            rate = scale(u[node.u], list(node.axis))
        else:
            rotation = identity()
            offset = add(offset, scale(q[node.q], list(node.axis)))
            rate = [0.0, 0.0, 0.0]
        omega = rate if node.parent < 0 else apply_transposed_onto(rate, rotation, kin.omega[node.parent])
        kin.rotation.append(rotation)
        kin.offset.append(offset)
        kin.omega.append(omega)
        kin.rate.append(rate)
    return kin


def axis_rotation(axis: Sequence[float], angle: Any) -> Matrix:
    """Rotation by an angle about a fixed unit axis; sparse for a coordinate axis."""
    sine, cosine = sincos(angle)
    for i in range(3):
        if abs(axis[i]) == 1.0:
            sine = sine if axis[i] > 0.0 else -sine
            j, k = (i + 1) % 3, (i + 2) % 3
            rotation = identity()
            rotation[j][j] = rotation[k][k] = cosine
            rotation[j][k], rotation[k][j] = -sine, sine
            return rotation
    rest = 1.0 - cosine
    a = list(axis)
    return [
        [
            rest * (a[i] * a[j]) + (cosine if i == j else sine * skew(a)[i][j])
            for j in range(3)
        ]
        for i in range(3)
    ]  # fmt: skip


def velocity_product(kin: Kinematics, place: int) -> tuple[Vector, Vector]:
    """What velocities add to a node's acceleration: the angular part in the node's axes, and the linear part.

    Returns:
        c: angular [rad/s^2], node axes.
        b: linear [m/s^2], **parent's** axes: centripetal, and for a slider Coriolis, acceleration of the node's origin.
    """
    node = kin.tree.nodes[place]
    if node.kind == "free" or node.parent < 0:
        b = [0.0, 0.0, 0.0]
    else:
        omega, r = kin.omega[node.parent], kin.offset[place]
        b = cross(omega, cross(omega, r))
        if node.kind == "prismatic":
            # 2 w x (axis rate); a prismatic node does not turn, so the axis is the same in both frames.
            b = add(b, scale(2.0, cross(omega, scale(kin.u[node.u], list(node.axis)))))
    if node.kind == "free":
        return [0.0, 0.0, 0.0], b
    return cross(kin.omega[place], kin.rate[place]), b


def link_poses(kin: Kinematics) -> list[Vector]:
    """Pose of every link in the world, quaternions chained from the joints' (no sign is chosen)."""
    turns: list[Vector] = []
    for node in kin.tree.nodes:
        if node.kind == "free":
            turn = list(kin.q[node.q + 3 : node.q + 7])
        elif node.kind == "ball":
            turn = list(kin.q[node.q : node.q + 4])
        elif node.kind == "revolute":
            sine, cosine = sincos(0.5 * kin.q[node.q])
            turn = [*scale(sine, list(node.axis)), cosine]
        else:
            turn = [0.0, 0.0, 0.0, 1.0]
        turns.append(turn if node.parent < 0 else quaternion_product(turns[node.parent], turn))
    return [[*kin.world(place)[1], *turns[place]] for place in kin.tree.node_of_link]
