"""MuJoCo's side of the race has the body, the springs and the contacts that it is said to have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")

from echelon.agents.bodies import load_body  # noqa: E402 (only where MuJoCo is)
from echelon.agents.servo import ServoedBody  # noqa: E402
from echelon.benchmarks.mujoco_peer import CoordinateOrder, JointSpring, peer_model  # noqa: E402
from echelon.benchmarks.peer_runs import start_peer  # noqa: E402

STIFFNESS, DAMPING = 300.0, 20.0


@pytest.mark.parametrize("name", ["hopper", "male"])
def test_its_springs_are_our_servos(name: str):
    """Accelerations of random states: MuJoCo's with springs, ours with the torques that servos would give."""
    body = load_body(name)
    springs = {
        link.joint.name: [JointSpring(STIFFNESS, DAMPING)] * max(len(link.joint.axes), 1)
        for link in body.links
        if link.joint.kind != "free"
    }
    order = CoordinateOrder.of(body, peer := peer_model(body, springs=springs))
    data = mujoco.MjData(peer)
    rng = np.random.default_rng(4)
    for _ in range(10):
        q = body.normalized(body.q_reference + 0.3 * rng.normal(size=body.q_count))
        u = rng.normal(size=body.u_count)
        tau = np.zeros(body.u_count)
        for index, link in enumerate(body.links):
            at_q, at_u, kind = body.q_start(index), body.u_start(index), link.joint.kind
            if kind == "free":
                continue
            if kind == "ball":
                # A ball joint's spring pulls along the rotation vector.
                vector, w = q[at_q : at_q + 3], q[at_q + 3]
                length = np.linalg.norm(vector)
                angle = 2.0 * np.arctan2(np.copysign(length, w), np.abs(w))
                tau[at_u : at_u + 3] = -STIFFNESS * angle * vector / length - DAMPING * u[at_u : at_u + 3]
            else:
                axes = len(link.joint.axes)
                tau[at_u : at_u + axes] = -STIFFNESS * q[at_q : at_q + axes] - DAMPING * u[at_u : at_u + axes]
        order.write(data, q, u)
        mujoco.mj_forward(peer, data)
        ours, theirs = body.forward_dynamics(q, u, tau), order.to_u(data.qacc)
        assert np.max(np.abs(ours - theirs)) <= 1e-9 * np.max(np.abs(ours))


def test_its_floor_carries_foot_and_belly():
    body = load_body("hopper")
    peer = peer_model(body, floor=True)
    order, data = CoordinateOrder.of(body, peer), mujoco.MjData(peer)
    shapes = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID
    assert sorted(map(int, peer.geom_type)) == sorted(map(int, shapes))
    assert peer.body_mass.sum() == pytest.approx(body.mass)  # shapes weigh nothing
    for height, contacts in ((0.001, 0), (-0.001, 1)):
        q = body.q_reference
        q[2] += height
        order.write(data, q, np.zeros(body.u_count))
        mujoco.mj_forward(peer, data)
        assert data.ncon == contacts
    q = body.q_reference
    q[2] = 0.18  # the belly is down, the leg through the floor
    order.write(data, q)
    mujoco.mj_forward(peer, data)
    assert data.ncon == 2


def test_coordinates_come_back():
    body = load_body("male")
    peer = peer_model(body)
    order, data = CoordinateOrder.of(body, peer), mujoco.MjData(peer)
    rng = np.random.default_rng(1)
    q, u = rng.normal(size=body.q_count), rng.normal(size=body.u_count)
    order.write(data, q, u)
    found = order.read(data)
    assert np.array_equal(found[0], q)
    assert np.array_equal(found[1], u)


def test_an_unstable_run_is_not_sane_and_leaves_no_log(tmp_path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    stiff = ServoedBody(replace(load_body("male"), contacts=()), 300.0, 20.0)
    verdict = start_peer(stiff, 1.0 / 60.0, "rk4").verdict()
    assert not verdict.sane
    assert list(tmp_path.iterdir()) == []


def test_a_hopper_set_down_stands_for_as_long_as_it_is_timed():
    from echelon.agents.hopper import Hopper

    peer = start_peer(Hopper(), 1.0 / 720.0, "euler")
    verdict = peer.verdict()
    assert verdict.sane, verdict.why
    assert peer.round() > 0.0
