"""A model unrolled into a tree of nodes, each a free or ball joint or a single axis of any other.

A joint of several axes is a chain of one-axis nodes at one place, all but the last without mass: straight-line code
over such nodes is shorter than over joints (see `articulated`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from echelon.warp_kernels.model import AXIS_COUNT, Model
from echelon.warp_kernels.spatial import Matrix, Vector

NodeKind = Literal["free", "ball", "revolute", "prismatic"]


@dataclass(frozen=True)
class Node:
    """One step of the tree: a free or ball joint, or a single axis of any other joint.

    Attributes:
        parent: Index of the node it hangs on, -1 for the world.
        axis: Unit axis; unused for free and ball.
        offset: Origin in the parent node's frame [m].
        q, u: Index of its first coordinate and speed.
        link: Index of the link that moves with it, None for a massless intermediate.
        continuous: Whether it turns without end (see `Joint`).
    """

    parent: int
    kind: NodeKind
    axis: tuple[float, float, float]
    offset: tuple[float, float, float]
    q: int
    u: int
    link: int | None
    continuous: bool = False


@dataclass(frozen=True)
class LinkInertia:
    """Inertia of a link about its frame's origin.

    Attributes:
        mass: [kg].
        moment: Mass times centre of mass, h [kg m].
        inertia: Inertia tensor about the origin [kg m^2].
    """

    mass: float
    moment: Vector
    inertia: Matrix


@dataclass(frozen=True)
class Tree:
    """A model unrolled into nodes, parents first."""

    model: Model
    nodes: tuple[Node, ...]
    node_of_link: tuple[int, ...]
    inertias: tuple[LinkInertia, ...]
    children: tuple[tuple[int, ...], ...]


def unroll(model: Model) -> Tree:
    """Turn a model's joints into nodes."""
    nodes: list[Node] = []
    node_of_link: list[int] = []
    q = u = 0
    for index, link in enumerate(model.links):
        joint = link.joint
        parent = -1 if model.parents[index] < 0 else node_of_link[model.parents[index]]
        offset = joint.position
        if joint.kind in ("free", "ball"):
            nodes.append(Node(parent, joint.kind, (0.0, 0.0, 0.0), offset, q, u, index))  # type: ignore[arg-type]
            q, u = (q + 7, u + 6) if joint.kind == "free" else (q + 4, u + 3)
        else:
            kind: NodeKind = "prismatic" if joint.kind == "slider" else "revolute"
            count = AXIS_COUNT[joint.kind]
            for place, axis in enumerate(joint.axes):
                last = place == count - 1
                nodes.append(Node(parent, kind, axis, offset, q, u, index if last else None, joint.continuous))
                parent, offset = len(nodes) - 1, (0.0, 0.0, 0.0)
                q, u = q + 1, u + 1
        node_of_link.append(len(nodes) - 1)
    children = tuple(tuple(i for i, node in enumerate(nodes) if node.parent == place) for place in range(len(nodes)))
    return Tree(model, tuple(nodes), tuple(node_of_link), tuple(map(_link_inertia, model.links)), children)


def _link_inertia(link: Any) -> LinkInertia:
    com = np.array(link.com, dtype=float)
    tensor = np.array(link.inertia, dtype=float)
    tensor = 0.5 * (tensor + tensor.T) + link.mass * (com @ com * np.eye(3) - np.outer(com, com))
    return LinkInertia(
        float(link.mass), [float(x) for x in link.mass * com], [[float(x) for x in row] for row in tensor]
    )
