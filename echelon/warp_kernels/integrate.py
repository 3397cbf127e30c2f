"""From speeds to positions: what one step of an integrator does to the coordinates.

Two integrators share these: semi-implicit Euler (speeds first, then positions with the new speeds) and classical
fourth-order Runge-Kutta, which needs the rates of the coordinates themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from echelon.warp_kernels.spatial import quaternion_normalized, quaternion_product, quaternion_rate
from echelon.warp_kernels.trace import floor
from echelon.warp_kernels.tree import Tree

TWO_TURNS = 4.0 * math.pi
"""By so much angles of continuous joints are taken back [rad]: one turn would change the sign of a quaternion."""


def semi_implicit_positions(tree: Tree, q: Sequence[Any], u: Sequence[Any], step: Any) -> list[Any]:
    """Positions after ``step`` seconds [s] at the speeds ``u``; quaternions turn about the link's axes and stay unit.

    A turn by the small vector v = step * omega is the quaternion (v / 2, 1), normalised: exact to third order in |v|.
    """
    result = list(q)
    for node in tree.nodes:
        if node.kind in ("free", "ball"):
            at_q, at_u = node.q, node.u
            if node.kind == "free":
                for i in range(3):
                    result[at_q + i] = q[at_q + i] + step * u[at_u + i]
                at_q, at_u = at_q + 3, at_u + 3
            turn = [(0.5 * step) * u[at_u + i] for i in range(3)]
            turned = quaternion_product(list(q[at_q : at_q + 4]), [*turn, 1.0])
            result[at_q : at_q + 4] = quaternion_normalized(turned)
        else:
            result[node.q] = q[node.q] + step * u[node.u]
    return result


def position_rate(tree: Tree, q: Sequence[Any], u: Sequence[Any]) -> list[Any]:
    """Rates of the coordinates at the speeds ``u`` [m/s, rad/s, 1/s]."""
    result: list[Any] = [0.0] * len(q)
    for node in tree.nodes:
        if node.kind in ("free", "ball"):
            at_q, at_u = node.q, node.u
            if node.kind == "free":
                result[at_q : at_q + 3] = list(u[at_u : at_u + 3])
                at_q, at_u = at_q + 3, at_u + 3
            result[at_q : at_q + 4] = quaternion_rate(list(q[at_q : at_q + 4]), list(u[at_u : at_u + 3]))
        else:
            result[node.q] = u[node.u]
    return result


def wrapped_positions(tree: Tree, q: Sequence[Any]) -> dict[int, Any]:
    """New values, by place in q, of the coordinates that turn without end: back by two turns where they are beyond."""
    return {
        node.q: q[node.q] - TWO_TURNS * floor(q[node.q] * (1.0 / TWO_TURNS) + 0.5)
        for node in tree.nodes
        if node.continuous
    }
