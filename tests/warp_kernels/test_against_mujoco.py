"""The reference against MuJoCo, on 100 random states of every body: relative error at most 1e-9.

MuJoCo builds the mass matrix by the composite-rigid-body algorithm in world-aligned coordinates about the centre of
mass and solves with its factors; the reference runs the articulated-body algorithm in link coordinates. They share no
code and no method, so what they agree on is mechanics.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from echelon.agents.bodies import body_names, load_body
from echelon.warp_kernels.model import AXIS_COUNT, Joint, JointKind, Link
from echelon.warp_kernels.reference import Body

pytest.importorskip("mujoco")
sys.path.append(str(Path(__file__).parent))  # test files are imported one by one, not as a package
from mujoco_oracle import MujocoOracle

TOLERANCE = 1e-9
STATES = 100
LARGEST_CONDITION = 5e6  # of the mass matrix; the humans' median is 4e5
KINDS: tuple[JointKind, ...] = ("ball", "pin", "universal", "gimbal", "slider")  # free ones are roots in all of them


# ---- bodies ----------------------------------------------------------------------------------------------------------
def branching_tree(kinds: tuple[JointKind, ...], root: JointKind, seed: int) -> Body:
    """A root with two branches of two links each, joints of the given kinds in turn, oblique in everything.

    Axes are random unit vectors, neither along the frames' axes nor at right angles; inertias are those of six random
    points, with products as large as moments.
    """
    rng = np.random.default_rng(seed)
    links: list[Link] = []
    for index, parent in enumerate((None, 0, 1, 0, 3)):
        kind = root if parent is None else kinds[(index - 1) % len(kinds)]
        axes = rng.normal(size=(AXIS_COUNT[kind], 3))
        points = rng.normal(size=(6, 3)) * 0.2
        inertia = sum((np.eye(3) * (p @ p) - np.outer(p, p) for p in points), start=np.zeros((3, 3)))
        joint = Joint(
            name=f"joint {index}",
            kind=kind,
            position=tuple(rng.normal(size=3) * 0.5),
            axes=tuple(tuple(axis / np.linalg.norm(axis)) for axis in axes),
        )
        links.append(
            Link(
                name=f"link {index}",
                parent=None if parent is None else f"link {parent}",
                joint=joint,
                mass=float(rng.uniform(0.5, 3.0)),
                com=tuple(rng.normal(size=3) * 0.3),
                inertia=tuple(tuple(row) for row in inertia),  # type: ignore[arg-type]
            )
        )
    return Body(name=f"{root} {kinds}", links=tuple(links))


def two_free_bodies() -> Body:
    """Two trees in one model: a free link with a child, and a free link alone."""
    tree = branching_tree(("gimbal",), "free", seed=7)
    alone = replace(tree.links[3], name="alone", parent=None, joint=replace(tree.links[0].joint, name="alone"))
    return Body(name="two free bodies", links=(*tree.links[:2], alone), gravity=1.62)


def trees() -> dict[str, Callable[[], Body]]:
    """Every joint type below a free root and below a root of its own type, and all of them together."""
    builders: dict[str, Callable[[], Body]] = {}
    for seed, kind in enumerate(KINDS):
        builders[f"{kind} on free"] = partial(branching_tree, (kind,), "free", seed)
        builders[f"{kind} on {kind}"] = partial(branching_tree, (kind,), kind, 10 + seed)
    builders["all on free"] = partial(branching_tree, ("gimbal", "ball", "universal", "slider"), "free", 20)
    builders["all on slider"] = partial(branching_tree, ("ball", "pin", "gimbal", "universal"), "slider", 21)
    builders["two free bodies"] = two_free_bodies
    return builders


BODIES: dict[str, Callable[[], Body]] = {**trees(), **{name: partial(load_body, name) for name in body_names()}}


@cache
def body_of(name: str) -> Body:
    return BODIES[name]()


@cache
def oracle_of(name: str) -> MujocoOracle:
    return MujocoOracle(body_of(name))


@cache
def states_of(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return random_states(body_of(name))


def random_states(body: Body, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q all the way round and within two metres, u of some rad/s and m/s, and numbers for forces or accelerations.

    States close to gimbal lock are left out: there the mass matrix is nearly singular, and whoever solves with it
    loses as many digits as its condition number has (MuJoCo some more of them than the reference).
    """
    rng = np.random.default_rng(seed)
    candidates = 2 * STATES

    def turns() -> np.ndarray:
        quaternions = rng.normal(size=(candidates, 4))
        return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)

    columns: list[np.ndarray] = []
    for link in body.links:
        match link.joint.kind:
            case "free":
                columns += [rng.uniform(-2.0, 2.0, size=(candidates, 3)), turns()]
            case "ball":
                columns += [turns()]
            case "slider":
                columns += [rng.uniform(-2.0, 2.0, size=(candidates, 1))]
            case _:
                columns += [rng.uniform(-np.pi, np.pi, size=(candidates, len(link.joint.axes)))]
    q = np.concatenate(columns, axis=1)
    q = q[np.linalg.cond(body.mass_matrix(q)) < LARGEST_CONDITION][:STATES]
    assert len(q) == STATES
    return q, 3.0 * rng.normal(size=(STATES, body.u_count)), 30.0 * rng.normal(size=(STATES, body.u_count))


def relative_error(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Largest difference in a state over the largest number of that state, the worst of all states."""
    assert ours.shape == theirs.shape
    assert np.all(np.isfinite(theirs))
    axes = tuple(range(1, theirs.ndim))
    return float(np.max(np.abs(ours - theirs).max(axis=axes) / np.abs(theirs).max(axis=axes)))


every_body = pytest.mark.parametrize("name", BODIES)


# ---- the comparisons -------------------------------------------------------------------------------------------------
@every_body
def test_mass_matrix(name: str):
    body = body_of(name)
    q, _, _ = states_of(name)
    assert relative_error(body.mass_matrix(q), oracle_of(name).mass_matrix(q)) <= TOLERANCE


@every_body
def test_forward_dynamics(name: str):
    body = body_of(name)
    q, u, tau = states_of(name)
    assert relative_error(body.forward_dynamics(q, u, tau), oracle_of(name).forward_dynamics(q, u, tau)) <= TOLERANCE


@every_body
def test_link_poses(name: str):
    body = body_of(name)
    q, _, _ = states_of(name)
    ours, theirs = body.link_poses(q), oracle_of(name).link_poses(q)
    # A quaternion and its negative are the same turn.
    same_sign = np.sign(np.sum(ours[..., 3:] * theirs[..., 3:], axis=-1, keepdims=True))
    assert relative_error(ours[..., :3], theirs[..., :3]) <= TOLERANCE
    assert relative_error(ours[..., 3:], same_sign * theirs[..., 3:]) <= TOLERANCE


@every_body
def test_link_accelerations(name: str):
    body, oracle = body_of(name), oracle_of(name)
    q, u, qdd = states_of(name)
    ours = body.link_accelerations(q, u, qdd)
    for theirs in (oracle.link_accelerations(q, u, qdd), oracle.sensed_link_accelerations(q, u, qdd)):
        assert relative_error(ours[..., :3], theirs[..., :3]) <= TOLERANCE
        if np.any(theirs[..., 3:]):
            assert relative_error(ours[..., 3:], theirs[..., 3:]) <= TOLERANCE


@every_body
def test_momentum(name: str):
    body = body_of(name)
    q, u, _ = states_of(name)
    ours, theirs = body.momentum(q, u), oracle_of(name).momentum(q, u)
    assert relative_error(ours[:, :3], theirs[:, :3]) <= TOLERANCE
    assert relative_error(ours[:, 3:], theirs[:, 3:]) <= TOLERANCE


@every_body
def test_energy(name: str):
    body = body_of(name)
    q, u, _ = states_of(name)
    ours, theirs = body.energy(q, u), oracle_of(name).energy(q, u)
    assert relative_error(ours[:, :1], theirs[:, :1]) <= TOLERANCE
    # Heights may cancel, so the potential is measured against what the weight gains over a metre.
    weight = body.mass * body.gravity
    assert np.max(np.abs(ours[:, 1] - theirs[:, 1])) <= TOLERANCE * weight


@every_body
def test_one_state_is_one_row_of_a_batch(name: str):
    body = body_of(name)
    q, u, tau = states_of(name)
    batch = body.forward_dynamics(q.reshape(10, 10, -1), u.reshape(10, 10, -1), tau.reshape(10, 10, -1))
    alone = body.forward_dynamics(q[37], u[37], tau[37])
    assert batch.shape == (10, 10, body.u_count)
    np.testing.assert_allclose(batch[3, 7], alone, rtol=1e-12, atol=1e-12 * np.abs(alone).max())


def test_the_tolerance_would_notice_a_wrong_sign_of_a_small_product_of_inertia():
    """The female's chest has products of inertia of a hundredth of its moments: turned over, nothing agrees."""
    body = body_of("female")
    index = body.link_index("CHEST1")
    wrong = tuple(
        tuple(value if i == j else -value for j, value in enumerate(row))
        for i, row in enumerate(body.links[index].inertia)
    )
    links = (*body.links[:index], replace(body.links[index], inertia=wrong), *body.links[index + 1 :])  # type: ignore[arg-type]
    other = MujocoOracle(replace(body, links=links))
    q, u, tau = states_of("female")
    assert relative_error(body.mass_matrix(q), other.mass_matrix(q)) > 1000 * TOLERANCE
    assert relative_error(body.forward_dynamics(q, u, tau), other.forward_dynamics(q, u, tau)) > 1000 * TOLERANCE
