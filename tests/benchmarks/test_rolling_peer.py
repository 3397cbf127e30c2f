"""MuJoCo's rider is ours: the same wheels, held where ours are held, geared as ours are, for as long as it is timed."""

from __future__ import annotations

import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")

from echelon.agents.riders.bicycle import FRONT_TYRE, REAR_ANGLE, REAR_TYRE  # noqa: E402 (only where MuJoCo is)
from echelon.agents.riders.body import CRANK  # noqa: E402
from echelon.agents.riders.cyclist import Cyclist  # noqa: E402
from echelon.benchmarks.mujoco_peer import CoordinateOrder, Coupling, peer_model  # noqa: E402
from echelon.benchmarks.peer_runs import start_peer  # noqa: E402
from echelon.benchmarks.rolling_peer import RollingPeer, joint_springs  # noqa: E402
from echelon.benchmarks.sanity import spring_gaps  # noqa: E402

CYCLIST = Cyclist()
GEAR = 2.5


def rider_at(lean: float) -> tuple[np.ndarray, np.ndarray]:
    """A rider at speed in gear, tilted to the right about the line on the ground [rad]."""
    one = np.ones(1)
    q, u = CYCLIST.riding(0.0 * one, 6.0 * one, 0.0 * one, 0.4 * one, GEAR * one)
    q[0, REAR_ANGLE] = GEAR * 0.4
    q[0, 2:7] = (0.0, np.sin(0.5 * lean), 0.0, 0.0, np.cos(0.5 * lean))
    return q[0], u[0]


def test_its_constraints_are_our_springs_and_chain():
    peer = peer_model(CYCLIST.body, floor=True, use="usual", tied=True, couplings=[Coupling("rear_wheel", CRANK, GEAR)])
    assert peer.neq == len(CYCLIST.body.springs) + 1 == 5
    assert peer.nv == CYCLIST.body.u_count == 28
    assert peer.body_mass.sum() == pytest.approx(CYCLIST.body.mass)
    order, data = CoordinateOrder.of(CYCLIST.body, peer), mujoco.MjData(peer)
    q, u = rider_at(0.0)
    q[CYCLIST.body.coordinate_names.index("left_elbow")] += 0.1
    order.write(data, q, u)
    mujoco.mj_forward(peer, data)
    errors = data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
    gaps = spring_gaps(CYCLIST.body, CYCLIST.body.link_poses(q[None]))[0]
    assert gaps.max() > 0.02
    for tie, gap in enumerate(gaps):
        assert np.linalg.norm(errors[3 * tie : 3 * tie + 3]) == pytest.approx(gap, abs=1e-9)
    assert errors[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("lean", [0.0, 0.3, -0.8])
def test_its_wheels_touch_where_ours_do(lean: float):
    peer = peer_model(CYCLIST.body, floor=True, use="usual")
    order, data = CoordinateOrder.of(CYCLIST.body, peer), mujoco.MjData(peer)
    q, u = rider_at(lean)
    q[2] -= 0.02
    order.write(data, q, u)
    mujoco.mj_forward(peer, data)
    assert data.ncon == 2
    poses = CYCLIST.body.link_poses(q[None])[0]
    for site in CYCLIST.body.contacts:
        if site.name not in (REAR_TYRE, FRONT_TYRE):
            continue
        x, y, z, w = poses[CYCLIST.body.link_index(site.link), 3:]
        down = np.array([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)])  # the link's axes' z
        lowest = poses[CYCLIST.body.link_index(site.link), 2] - np.linalg.norm(np.array(site.radii) * down)
        assert np.min(np.abs(data.contact.dist - lowest)) < 1e-6


@pytest.mark.parametrize("integrator", ["euler", "plain euler"])
def test_it_is_sane_for_as_long_as_it_is_timed(integrator: str):
    peer = start_peer(CYCLIST, 1.0 / 1200.0, integrator)
    assert isinstance(peer, RollingPeer)
    verdict = peer.verdict()
    assert verdict.sane, verdict.why
    assert peer.round() > 0.0


def test_it_is_refused_where_its_hands_come_off(tmp_path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    verdict = start_peer(CYCLIST, 1.0 / 60.0, "euler").verdict()
    assert not verdict.sane
    assert "from where it belongs" in verdict.why or "not finite" in verdict.why
    assert list(tmp_path.iterdir()) == []


def test_every_joint_that_ours_drives_or_damps_has_a_spring_or_a_damper():
    springs = joint_springs(CYCLIST)
    for link in CYCLIST.body.links:
        if link.joint.kind != "free" and link.joint.name != CRANK:
            assert len(springs[link.joint.name]) == len(link.joint.axes)
            assert all(spring.damping > 0.0 for spring in springs[link.joint.name])


def test_its_solver_converges_and_its_step_is_small_enough():
    """Joint speeds of the timed step and solver against those of a fourth of the step; and CG, cut off, as a foil."""

    def speeds(steps_a_second: int, iterations: int | None = None) -> np.ndarray:
        peer = RollingPeer(CYCLIST, 1.0 / steps_a_second, "plain euler")
        if iterations is not None:
            peer.model.opt.solver, peer.model.opt.iterations = int(mujoco.mjtSolver.mjSOL_CG), iterations
        return peer.rolled(0)[1][:: steps_a_second // 120]

    fine = speeds(4800)
    assert np.max(np.abs(speeds(1200) - fine)) < 0.1
    assert np.max(np.abs(speeds(1200, iterations=2) - fine)) > 1.0
