"""Equations of motion of a tree of rigid links: the articulated-body algorithm, written once over scalars.

After Featherstone, *Rigid Body Dynamics Algorithms* (2008): recursive Newton-Euler of chapter 5 over `kinematics`, the
articulated-body algorithm of chapter 7, in link coordinates and with its symbols (I_A, p_A, U, D, u). Three choices
differ from the book, each because it makes straight-line code shorter:

* **Accelerations are classical**, those of a link's origin as an observer at rest would measure them, not spatial
  ones. A link's bias force then needs its angular velocity only,
  p = (w x I w, w x (w x h)), with h = mass times centre of mass, and linear velocities are never computed unless a
  contact or a spring asks. The price is w x (w x r) on the way to a child at r, and most nodes have r = 0, since:
* **A joint of several axes is a chain of one-axis nodes** at one place, all but the last without mass.
* **Gravity is an acceleration of the world** upwards, so it appears at the root alone.

An articulated inertia is kept as blocks (I, H, M) of

    | I    H |     angular
    | H^T  M |     linear

with I and M symmetric. A ball or free joint eliminates its freedoms one after the other in the link's own axes; this
is the Cholesky-like factorisation of its block D, and needs no matrix inverse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from echelon.warp_kernels.kinematics import Kinematics, velocity_product
from echelon.warp_kernels.spatial import (
    Matrix,
    Vector,
    add,
    apply,
    apply_onto,
    apply_transposed,
    apply_transposed_onto,
    cross,
    cross_onto,
    dot,
    dot_onto,
    identity,
    is_zero,
    multiply,
    negate,
    scale,
    skew,
    subtract,
    transpose,
)
from echelon.warp_kernels.tree import Node, Tree

AXES: tuple[Vector, Vector, Vector] = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])


# ---- forward dynamics ----------------------------------------------------------------------------------------------
@dataclass
class ArticulatedInertia:
    """Blocks of a symmetric 6x6 inertia and its bias force (moment, force) about the node's origin."""

    inertia: Matrix
    coupling: Matrix
    mass: Matrix
    moment: Vector
    force: Vector


@dataclass(frozen=True)
class ContactLoad:
    """A force on a link and how it falls as the link accelerates, both about the link's origin in its axes.

    The force applied is (moment, force) - inertia * (angular, linear acceleration), where the acceleration is the
    classical one less gravity, as the algorithm has it.
    """

    moment: Vector
    force: Vector
    inertia: Matrix
    coupling: Matrix
    mass: Matrix


@dataclass
class _Elimination:
    """One freedom taken out: qdd = gain - U_over_D . acceleration."""

    speed: int
    direction: int | None
    axis: Vector
    angular: bool
    U_over_D: tuple[Vector, Vector]
    gain: Any


def _bias(kin: Kinematics, tree: Tree, place: int) -> ArticulatedInertia | None:
    """A node's own inertia and bias force, None where it has no mass."""
    link = tree.nodes[place].link
    if link is None or (tree.inertias[link].mass == 0.0 and not np.any(tree.inertias[link].inertia)):
        return None
    body, omega = tree.inertias[link], kin.omega[place]
    return ArticulatedInertia(
        inertia=[list(row) for row in body.inertia],
        coupling=skew(body.moment),
        mass=[[body.mass if i == j else 0.0 for j in range(3)] for i in range(3)],
        moment=cross(omega, apply(body.inertia, omega)),
        force=cross(omega, cross(omega, body.moment)),
    )


def forward_dynamics(
    kin: Kinematics,
    tau: Sequence[Any],
    implicit: Sequence[Any] | None = None,
    loads: Mapping[int, Sequence[ContactLoad]] | None = None,
    forces: Mapping[int, Sequence[tuple[Vector, Vector]]] | None = None,
) -> list[Any]:
    """Accelerations of the generalised speeds, by the articulated-body algorithm.

    Args:
        kin: Kinematics of the present state.
        tau: Generalised force for each speed [N, N m]; of a free joint the force in the world frame, then the moment
            in the link's frame about its origin.
        implicit: For each speed, what an implicit servo adds to the joint's own inertia [kg m^2 or kg].
        loads: For a link index, implicit forces from the ground.
        forces: For a link index, (moment, force) in the link's axes about its origin [N m], [N].

    Returns:
        qdd, the rate of u, one scalar a speed; a free joint's linear part in the world frame.
    """
    tree = kin.tree
    gravity = tree.model.gravity
    node_count = len(tree.nodes)
    total: list[ArticulatedInertia | None] = [_bias(kin, tree, place) for place in range(node_count)]
    for link, entries in (loads or {}).items():
        place = tree.node_of_link[link]
        for load in entries:
            total[place] = _accumulate(
                total[place],
                ArticulatedInertia(load.inertia, load.coupling, load.mass, negate(load.moment), negate(load.force)),
            )
    for link, pairs in (forces or {}).items():
        place = tree.node_of_link[link]
        for moment, force in pairs:
            here = total[place]
            if here is None:
                raise ValueError("a force on a link without inertia")
            total[place] = ArticulatedInertia(
                here.inertia, here.coupling, here.mass, subtract(here.moment, moment), subtract(here.force, force)
            )

    # Pass 2: from the tips inwards, take out each node's freedoms and hand the rest to its parent.
    eliminations: list[list[_Elimination]] = [[] for _ in range(node_count)]
    products = [velocity_product(kin, place) for place in range(node_count)]
    for place in range(node_count - 1, -1, -1):
        node, articulated = tree.nodes[place], total[place]
        if articulated is None:
            raise ValueError(f"node {place} carries no inertia")
        for speed, axis, direction, angular in _freedoms(node):
            force = tau[speed]
            if node.kind == "free" and not angular:
                # The generalised force is along the world's axes, the elimination along the link's.
                force = dot(
                    [kin.rotation[place][row][direction or 0] for row in range(3)], list(tau[node.u : node.u + 3])
                )
            extra = 0.0 if implicit is None else implicit[speed]
            articulated, elimination = _eliminate(articulated, axis, direction, angular, force, extra, speed)
            eliminations[place].append(elimination)
        if node.parent >= 0:
            c, b = products[place]
            turn = next((i for i in range(3) if abs(node.axis[i]) == 1.0), None) if node.kind == "revolute" else None
            shifted = _to_parent(articulated, kin.rotation[place], turn, kin.offset[place], c, b)
            total[node.parent] = _accumulate(total[node.parent], shifted)

    # Pass 3: from the root outwards, accelerations.
    qdd: list[Any] = [0.0] * tree.model.u_count
    angular_of: list[Vector] = []
    linear_of: list[Vector] = []
    for place, node in enumerate(tree.nodes):
        if node.kind == "free":
            alpha, a = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        else:
            c, b = products[place]
            if node.parent < 0:
                alpha_outer, a_outer = [0.0, 0.0, 0.0], [0.0, 0.0, gravity]
            else:
                alpha_outer = angular_of[node.parent]
                a_outer = add(cross_onto(linear_of[node.parent], alpha_outer, kin.offset[place]), b)
            alpha = apply_transposed_onto(c, kin.rotation[place], alpha_outer)
            a = apply_transposed(kin.rotation[place], a_outer)
        for step in reversed(eliminations[place]):
            acceleration = dot_onto(dot_onto(step.gain, step.U_over_D[0], negate(alpha)), step.U_over_D[1], negate(a))
            qdd[step.speed] = acceleration
            if step.angular:
                alpha = add(alpha, scale(acceleration, step.axis))
            else:
                a = add(a, scale(acceleration, step.axis))
        if node.kind == "free":
            in_world = apply(kin.rotation[place], a)
            qdd[node.u : node.u + 3] = [in_world[0], in_world[1], in_world[2] - gravity]
        angular_of.append(alpha)
        linear_of.append(a)
    return qdd


def _freedoms(node: Node) -> list[tuple[int, Vector, int | None, bool]]:
    """(speed, axis, coordinate direction or None, angular) of a node's freedoms, in order of elimination."""
    if node.kind == "free":
        return [(node.u + (3 + i) % 6, AXES[i % 3], i % 3, i < 3) for i in range(6)]
    if node.kind == "ball":
        return [(node.u + i, AXES[i], i, True) for i in range(3)]
    direction = next((i for i in range(3) if abs(node.axis[i]) == 1.0), None)
    return [(node.u, list(node.axis), direction, node.kind == "revolute")]


def _eliminate(
    body: ArticulatedInertia,
    axis: Vector,
    direction: int | None,
    angular: bool,
    tau: Any,
    implicit: Any,
    speed: int,
) -> tuple[ArticulatedInertia, _Elimination]:
    """Take one freedom out of an articulated inertia: I_A - U U^T / D, p_A + U u / D."""
    if angular:
        U = (apply(body.inertia, axis), apply_transposed(body.coupling, axis))
        D = dot(axis, U[0]) + implicit
        u = tau - dot(axis, body.moment)
    else:
        U = (apply(body.coupling, axis), apply(body.mass, axis))
        D = dot(axis, U[1]) + implicit
        u = tau - dot(axis, body.force)
    inverse = 1.0 / D
    scaled = (scale(inverse, U[0]), scale(inverse, U[1]))
    gain = u * inverse
    # Without an implicit term the freedom's own row and column vanish exactly: keep them as structural zeros.
    gone = direction if is_zero(implicit) else None
    inertia = _symmetric(lambda i, j: _reduced(body.inertia[i][j], scaled[0][i], U[0][j]), gone if angular else None)
    mass = _symmetric(lambda i, j: _reduced(body.mass[i][j], scaled[1][i], U[1][j]), None if angular else gone)
    coupling = [
        [
            0.0
            if gone is not None and gone == (i if angular else j)
            else _reduced(body.coupling[i][j], scaled[0][i], U[1][j])
            for j in range(3)
        ]
        for i in range(3)
    ]
    reduced = ArticulatedInertia(
        inertia, coupling, mass, add(body.moment, scale(gain, U[0])), add(body.force, scale(gain, U[1]))
    )
    return reduced, _Elimination(speed, direction, axis, angular, scaled, gain)


def _reduced(entry: Any, a: Any, b: Any) -> Any:
    return entry if is_zero(a) or is_zero(b) else entry - a * b


def _symmetric(entry: Any, gone: int | None) -> Matrix:
    """A symmetric matrix from a function of its upper triangle, with one row and column zero."""
    result = identity()
    for i in range(3):
        for j in range(i, 3):
            result[i][j] = result[j][i] = 0.0 if gone in (i, j) else entry(i, j)
    return result


def _to_parent(
    body: ArticulatedInertia, R: Matrix, direction: int | None, r: Vector, c: Vector, b: Vector
) -> ArticulatedInertia:
    """An articulated inertia and its bias in the parent's frame.

    R turns about coordinate axis ``direction`` (None: about any other); c in the node's axes and b in the parent's are
    the accelerations that velocities add on the way (see `velocity_product`).
    """
    moment = apply_onto(body.moment, body.inertia, c)
    force = apply_transposed_onto(body.force, body.coupling, c)
    if direction is None:
        inertia, mass = _rotate_symmetric(body.inertia, R), _rotate_symmetric(body.mass, R)
        coupling = multiply(multiply(R, body.coupling), transpose(R))
    else:
        twice = _double_angle(R, direction)
        inertia = _turn_symmetric(body.inertia, R, direction, twice)
        mass = _turn_symmetric(body.mass, R, direction, twice)
        coupling = _turn(body.coupling, R, direction, twice)
    moment = apply_onto(apply(R, moment), coupling, b)
    force = apply_onto(apply(R, force), mass, b)
    if all(is_zero(x) for x in r):
        return ArticulatedInertia(inertia, coupling, mass, moment, force)
    # With v_child = v_parent - [r] w:  H' = H + [r] M,  I' = I - H [r] + [r] H'^T.
    rx, back = skew(r), skew(negate(r))
    shifted_coupling = [
        [dot_onto(coupling[i][j], rx[i], [mass[k][j] for k in range(3)]) for j in range(3)] for i in range(3)
    ]
    shifted = _symmetric(
        lambda i, j: dot_onto(
            dot_onto(inertia[i][j], coupling[i], [back[k][j] for k in range(3)]), rx[i], shifted_coupling[j]
        ),
        None,
    )
    return ArticulatedInertia(shifted, shifted_coupling, mass, cross_onto(moment, r, force), force)


def _rotate_symmetric(m: Matrix, R: Matrix) -> Matrix:
    """R m R^T of a symmetric m."""
    half = multiply(R, m)
    return _symmetric(lambda i, j: dot(half[i], R[j]), None)


def _double_angle(R: Matrix, k: int) -> tuple[Any, Any]:
    """Halves of the cosine and sine of twice the angle of a turn R about coordinate axis k."""
    j, i = (k + 1) % 3, (k + 2) % 3
    cosine, sine = R[j][j], R[i][j]
    return 0.5 - sine * sine, sine * cosine


def _turn_symmetric(m: Matrix, R: Matrix, k: int, twice: tuple[Any, Any]) -> Matrix:
    """R m R^T of a symmetric m for a turn about coordinate axis k.

    In the plane across the axis the trace stays, and the rest turns by twice the angle: fewer operations than two
    products, and structural zeros stay.
    """
    j, i = (k + 1) % 3, (k + 2) % 3
    cosine, sine = R[j][j], R[i][j]
    total, difference = m[j][j] + m[i][i], m[j][j] - m[i][i]
    turned = dot([twice[0], -twice[1]], [difference, m[j][i] + m[j][i]])
    mean = 0.5 * total
    result = identity()
    result[k][k] = m[k][k]
    result[k][j] = result[j][k] = dot([cosine, -sine], [m[k][j], m[k][i]])
    result[k][i] = result[i][k] = dot([sine, cosine], [m[k][j], m[k][i]])
    result[j][j], result[i][i] = mean + turned, mean - turned
    result[j][i] = result[i][j] = dot([twice[1], twice[0]], [difference, m[j][i] + m[j][i]])
    return result


def _turn(m: Matrix, R: Matrix, k: int, twice: tuple[Any, Any]) -> Matrix:
    """R m R^T of any m for a turn about coordinate axis k (see `_turn_symmetric`)."""
    j, i = (k + 1) % 3, (k + 2) % 3
    cosine, sine = R[j][j], R[i][j]
    difference, shear = m[j][j] - m[i][i], m[j][i] + m[i][j]
    mean, spin = 0.5 * (m[j][j] + m[i][i]), 0.5 * (m[j][i] - m[i][j])
    turned = dot([twice[0], -twice[1]], [difference, shear])
    sheared = dot([twice[1], twice[0]], [difference, shear])
    result = identity()
    result[k][k] = m[k][k]
    result[k][j], result[k][i] = dot([cosine, -sine], [m[k][j], m[k][i]]), dot([sine, cosine], [m[k][j], m[k][i]])
    result[j][k], result[i][k] = dot([cosine, -sine], [m[j][k], m[i][k]]), dot([sine, cosine], [m[j][k], m[i][k]])
    result[j][j], result[i][i] = mean + turned, mean - turned
    result[j][i], result[i][j] = sheared + spin, sheared - spin
    return result


def _sum(a: Matrix, b: Matrix) -> Matrix:
    return [add(x, y) for x, y in zip(a, b, strict=True)]


def _accumulate(first: ArticulatedInertia | None, second: ArticulatedInertia) -> ArticulatedInertia:
    if first is None:
        return second
    return ArticulatedInertia(
        _sum(first.inertia, second.inertia),
        _sum(first.coupling, second.coupling),
        _sum(first.mass, second.mass),
        add(first.moment, second.moment),
        add(first.force, second.force),
    )


# ---- given accelerations -------------------------------------------------------------------------------------------
def link_accelerations(kin: Kinematics, qdd: Sequence[Any]) -> list[tuple[Vector, Vector]]:
    """(angular, linear) classical acceleration of every node in its own axes, less gravity [rad/s^2], [m/s^2].

    "Less gravity" means that a body at rest shows gravity upwards, as an accelerometer would.
    """
    tree = kin.tree
    result: list[tuple[Vector, Vector]] = []
    for place, node in enumerate(tree.nodes):
        R = kin.rotation[place]
        if node.kind == "free":
            linear = [qdd[node.u], qdd[node.u + 1], qdd[node.u + 2] + tree.model.gravity]
            result.append((list(qdd[node.u + 3 : node.u + 6]), apply_transposed(R, linear)))
            continue
        c, b = velocity_product(kin, place)
        if node.parent < 0:
            alpha, a = [0.0, 0.0, 0.0], [0.0, 0.0, tree.model.gravity]
        else:
            alpha, a = result[node.parent]
            a = add(add(a, cross(alpha, kin.offset[place])), b)
        alpha, a = add(apply_transposed(R, alpha), c), apply_transposed(R, a)
        if node.kind == "ball":
            alpha = add(alpha, list(qdd[node.u : node.u + 3]))
        elif node.kind == "revolute":
            alpha = add(alpha, scale(qdd[node.u], list(node.axis)))
        else:
            a = add(a, scale(qdd[node.u], list(node.axis)))
        result.append((alpha, a))
    return result


def inverse_dynamics(kin: Kinematics, qdd: Sequence[Any]) -> list[Any]:
    """Generalised forces that give accelerations, by recursive Newton-Euler; the conventions of forward_dynamics."""
    tree = kin.tree
    accelerations = link_accelerations(kin, qdd)
    tau: list[Any] = [0.0] * tree.model.u_count
    moments: list[Vector] = [[0.0, 0.0, 0.0] for _ in tree.nodes]
    forces: list[Vector] = [[0.0, 0.0, 0.0] for _ in tree.nodes]
    for place in range(len(tree.nodes) - 1, -1, -1):
        node = tree.nodes[place]
        bias = _bias(kin, tree, place)
        moment, force = moments[place], forces[place]
        if bias is not None:
            alpha, a = accelerations[place]
            moment = add(moment, add(bias.moment, add(apply(bias.inertia, alpha), apply(bias.coupling, a))))
            force = add(force, add(bias.force, add(apply_transposed(bias.coupling, alpha), apply(bias.mass, a))))
        R = kin.rotation[place]
        if node.kind == "free":
            tau[node.u : node.u + 6] = [*apply(R, force), *moment]
        elif node.kind == "ball":
            tau[node.u : node.u + 3] = moment
        else:
            tau[node.u] = dot(list(node.axis), moment if node.kind == "revolute" else force)
        if node.parent >= 0:
            in_parent = apply(R, force)
            moments[node.parent] = add(moments[node.parent], add(apply(R, moment), cross(kin.offset[place], in_parent)))
            forces[node.parent] = add(forces[node.parent], in_parent)
    return tau
