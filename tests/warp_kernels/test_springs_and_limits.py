"""Springs between links, joint limits and servos against closed forms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from engine_scenes import GRAVITY, STEP, diagonal, free_link, start

from echelon.agents.servo import ServoedBody
from echelon.warp_kernels import articulated
from echelon.warp_kernels.character import View
from echelon.warp_kernels.contact import JointForces, spring_forces
from echelon.warp_kernels.kinematics import kinematics
from echelon.warp_kernels.model import Joint, Link, Spring
from echelon.warp_kernels.program import Integrator
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.reference_run import ReferenceRun

INTEGRATORS: tuple[Integrator, ...] = ("semi-implicit", "rk4")


def passive(body: Body) -> ServoedBody:
    return ServoedBody(body, 0.0, 0.0)


def two_masses(spring: Spring, gravity: float = 0.0) -> Body:
    """Two free links, of two and three kilograms, and a spring; in space unless told otherwise."""
    one = free_link(2.0, diagonal(0.02, 0.02, 0.02), ()).links[0]
    other = replace(one, name="other", mass=3.0, joint=Joint("other root", "free", position=(0.5, 0.0, 0.0)))
    return Body(name="two masses", links=(one, other), springs=(spring,), gravity=gravity)


def slider(
    kg: float = 2.0, limits: tuple[tuple[float, float] | None, ...] = (), k: float = 0.0, c: float = 0.0
) -> Body:
    """A mass on a rail along z, in space: the plainest joint there is."""
    joint = Joint("rail", "slider", axes=((0.0, 0.0, 1.0),), limits=limits, limit_stiffness=k, limit_damping=c)
    return Body(name="slider", links=(Link("bead", None, joint, kg, inertia=diagonal(1, 1, 1)),), gravity=0.0)


def period_of(signal: np.ndarray, interval: float) -> float:
    """Mean time between rising zero crossings of a signal about its mean."""
    signal = signal - 0.5 * (signal.max() + signal.min())
    rising = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    times = rising + signal[rising] / (signal[rising] - signal[rising + 1])
    assert len(times) >= 2
    return float(np.mean(np.diff(times)) * interval)


def watch(character: ServoedBody, q: np.ndarray, u: np.ndarray, integrator: Integrator, substeps: int) -> np.ndarray:
    """[substeps, agents, q then u] of a run, one substep a frame."""
    flight = start(character, q, u, integrator=integrator, frame_rate=1200, substeps=1, tick=1)
    seen = []
    for _ in range(substeps):
        flight.advance(1)
        seen.append(np.concatenate([flight.q, flight.u], axis=1))
    return np.array(seen)


# ---- springs between links -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("rest_length", [0.0, 0.5])
def test_two_masses_on_a_spring_swing_at_the_frequency_of_their_reduced_mass(
    rest_length: float, integrator: Integrator
):
    stiffness, reduced = 400.0, 2.0 * 3.0 / 5.0
    spring = Spring("spring", "link", (0.0, 0.0, 0.0), "other", (0.0, 0.0, 0.0), stiffness, 0.0, rest_length)
    character = passive(two_masses(spring))
    q = character.body.q_reference
    q[7] = rest_length + 0.1
    seen = watch(character, q, np.zeros(12), integrator, 1400)[:, 0]
    gap = seen[:, 7] - seen[:, 0]
    assert period_of(gap, STEP) == pytest.approx(2.0 * np.pi * np.sqrt(reduced / stiffness), rel=1e-3)
    if rest_length > 0.0:
        assert np.max(gap) == pytest.approx(rest_length + 0.1, rel=0.02)
        assert np.min(gap) == pytest.approx(rest_length - 0.1, rel=0.02)
    # Nothing acts from outside: the centre of mass stays.
    np.testing.assert_allclose((2.0 * seen[:, 0] + 3.0 * seen[:, 7]) / 5.0, 0.6 * q[7], atol=1e-5)


def test_a_damped_spring_dies_down_as_it_should():
    stiffness, damping, reduced = 400.0, 6.0, 1.2
    spring = Spring("spring", "link", (0.0, 0.0, 0.0), "other", (0.0, 0.0, 0.0), stiffness, damping, 0.5)
    character = passive(two_masses(spring))
    q = character.body.q_reference
    q[7] = 0.6
    run = ReferenceRun(character, q[None], np.zeros((1, 12)), integrator="rk4", step=1 / 300)
    rate = damping / (2.0 * reduced)
    omega = np.sqrt(stiffness / reduced - rate**2)
    for _ in range(3):
        for _ in range(20):
            run.substep()
        t = run.state.substep[0] * run.step
        expected = 0.1 * np.exp(-rate * t) * (np.cos(omega * t) + rate / omega * np.sin(omega * t))
        assert run.q[0, 7] - run.q[0, 0] - 0.5 == pytest.approx(expected, abs=1e-7)


def test_springs_push_equally_and_oppositely_wherever_they_hold():
    """Off-centre sites on turned, moving links: forces and moments about the world's origin add up to nothing."""
    rng = np.random.default_rng(4)
    for rest_length in (0.0, 0.3):
        spring = Spring("spring", "link", (0.1, -0.2, 0.3), "other", (-0.3, 0.1, 0.2), 300.0, 20.0, rest_length)
        body = two_masses(spring)
        q = body.normalized(rng.normal(size=(50, 14)))
        u = rng.normal(size=(50, 12))
        kin = body.kinematics(q, u)
        forces = spring_forces(kin, body)
        total, about_origin = np.zeros((50, 3)), np.zeros((50, 3))
        assert set(forces) == {0, 1}
        for link, pairs in forces.items():
            rotation, origin = kin.world(body.tree.node_of_link[link])
            r = np.array([[np.broadcast_to(x, 50) for x in row] for row in rotation]).transpose(2, 0, 1)
            for moment, force in pairs:
                in_world = np.einsum("bij,bj->bi", r, np.stack(force, axis=1))
                total += in_world
                about_origin += np.einsum("bij,bj->bi", r, np.stack(moment, axis=1))
                about_origin += np.cross(np.stack(origin, axis=1), in_world)
        assert np.max(np.abs(total)) < 1e-10
        assert np.max(np.abs(about_origin)) < 1e-10


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_mass_hung_from_the_world_sags_and_swings(integrator: Integrator):
    """One end is the world's, once as the first end and once as the second."""
    stiffness = 800.0
    body = free_link(2.0, diagonal(0.02, 0.02, 0.02), ())
    up = Spring("first", None, (0.0, 0.0, 1.0), "link", (0.0, 0.0, 0.0), 0.25 * stiffness, 0.0)
    down = Spring("second", "link", (0.0, 0.0, 0.0), None, (0.0, 0.0, 1.0), 0.75 * stiffness, 0.0)
    character = passive(replace(body, springs=(up, down)))
    sag = 2.0 * GRAVITY / stiffness
    q = character.body.q_reference
    q[2] = 1.0 - sag + 0.05
    seen = watch(character, q, np.zeros(6), integrator, 1000)[:, 0, 2]
    assert period_of(seen, STEP) == pytest.approx(2.0 * np.pi * np.sqrt(2.0 / stiffness), rel=1e-3)
    assert 0.5 * (seen.max() + seen.min()) == pytest.approx(1.0 - sag, abs=5e-4)


def test_a_spring_of_no_length_is_no_division_by_zero():
    spring = Spring("spring", "link", (0.0, 0.0, 0.0), "other", (0.0, 0.0, 0.0), 300.0, 1.0, rest_length=0.2)
    character = passive(two_masses(spring))
    q = character.body.q_reference
    q[7] = 0.0
    flight = start(character, q).advance(2)
    assert np.all(np.isfinite(flight.q))
    assert not np.any(flight.engine.frozen)


# ---- joint limits ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("implicit", [True, False])
def test_limits_push_back_and_never_pull(implicit: bool):
    """Thousands of positions and speeds on both sides: the force is towards the range, and none is inside it."""
    k, c = 500.0, 40.0
    body = slider(limits=((-0.2, 0.3),), k=k, c=c)
    rng = np.random.default_rng(2)
    q, u = rng.uniform(-0.4, 0.5, size=(5000, 1)), rng.normal(size=(5000, 1)) * 3.0
    h = STEP if implicit else 0.0
    joints = JointForces.none(1)
    joints.limits(body, [q[:, 0]], [u[:, 0]], h)
    tau, extra = joints.tau[0], joints.implicit[0]
    over, under = q[:, 0] > 0.3, q[:, 0] < -0.2
    assert np.all(tau[over] <= 0.0)
    assert np.all(tau[under] >= 0.0)
    assert np.all(tau[~over & ~under] == 0.0)
    beyond = np.where(over, q[:, 0] - 0.3, np.where(under, q[:, 0] + 0.2, 0.0))
    spring_and_damper = -k * (beyond + h * u[:, 0]) - c * u[:, 0]
    pushing = spring_and_damper * beyond < 0.0
    np.testing.assert_allclose(tau, np.where(pushing, spring_and_damper, 0.0), atol=1e-12)
    np.testing.assert_allclose(extra, np.where(pushing, h * (c + h * k), 0.0), atol=1e-15)
    assert np.count_nonzero(pushing) > 1000
    # With the implicit part as well, over the step as a whole: not past rest and away from the limit.
    kin = kinematics(body.tree, [q[:, 0]], [u[:, 0]])
    qdd = articulated.forward_dynamics(kin, joints.tau, joints.implicit)[0]
    assert np.all((2.0 * qdd)[over] <= 1e-12)
    assert np.all((2.0 * qdd)[under] >= -1e-12)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_limit_stops_a_joint_as_a_spring_does(integrator: Integrator):
    """It goes past by v sqrt(m / k) and comes back as fast as it came; with a damper, slower."""
    mass, k = 2.0, 5000.0
    for damping, back in ((0.0, 1.0), (60.0, None)):
        character = passive(slider(mass, ((-0.2, 0.3),), k, damping))
        seen = watch(character, np.array([0.25]), np.array([1.0]), integrator, 400)[:, 0]
        left = int(np.flatnonzero((seen[:, 0] < 0.3) & (np.arange(400) > 80))[0])
        speed = -seen[left, 1]
        if back is not None:
            assert seen[:, 0].max() == pytest.approx(0.3 + np.sqrt(mass / k), rel=0.01)
            # The implicit spring damps a little of itself.
            assert speed == pytest.approx(back, rel=0.01 if integrator == "rk4" else 0.08)
        else:
            assert 0.0 < speed < 0.6
            assert seen[:, 0].max() < 0.3 + 0.9 * np.sqrt(mass / k)
        np.testing.assert_allclose(seen[left:200, 1], -speed, rtol=1e-6)


def test_limits_of_some_axes_only():
    """A gimbal of which only the second axis is limited: the others swing free."""
    joint = Joint(
        "joint",
        "gimbal",
        axes=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        limits=(None, (-0.1, 0.1), None),
        limit_stiffness=50.0,
        limit_damping=1.0,
    )
    body = Body(name="gimbal", links=(Link("bob", None, joint, 1.0, inertia=diagonal(0.1, 0.1, 0.1)),), gravity=0.0)
    joints = JointForces.none(3)
    q = [np.array([2.0, -2.0]), np.array([0.5, 0.05]), np.array([2.0, 2.0])]
    joints.limits(body, q, [np.zeros(2)] * 3, STEP)
    assert isinstance(joints.tau[0], float)
    assert isinstance(joints.tau[2], float)
    np.testing.assert_allclose(joints.tau[1], [-50.0 * 0.4, 0.0])


# ---- servos ----------------------------------------------------------------------------------------------------------
def test_a_servo_moves_a_mass_as_the_closed_form_says():
    """Under-damped, critical and over-damped, from rest to a new desired position."""
    mass, desired = 2.0, 0.3
    for stiffness, damping in ((200.0, 8.0), (200.0, 40.0), (200.0, 120.0)):
        character = ServoedBody(slider(mass), stiffness, damping)
        run = ReferenceRun(
            character, np.zeros((1, 1)), np.zeros((1, 1)), integrator="rk4", parameters={"rail": desired}
        )
        roots = np.roots([mass, damping, stiffness]).astype(complex)
        roots[0] += 1e-6  # a double root is the limit of two that lie close
        for _ in range(120):
            run.substep()
        t = 120 * STEP
        a, b = roots
        expected = desired * (1.0 - np.real((a * np.exp(b * t) - b * np.exp(a * t)) / (a - b)))
        assert run.q[0, 0] == pytest.approx(expected, rel=1e-6)


def test_the_implicit_servo_is_the_implicit_step_of_its_equation():
    """(m + h c + h^2 k) dv = h (k (desired - x - h v) - c v), for gains that would throw an explicit servo."""
    mass, stiffness, damping, desired = 0.01, 3000.0, 50.0, 0.2
    assert STEP * damping / mass > 2.0
    x, v = 0.05, -1.0
    flight = start(
        ServoedBody(slider(mass), stiffness, damping), np.array([x]), np.array([v]), frame_rate=1200, substeps=1, tick=1
    )
    flight.engine.set_parameter("rail", np.array([desired]))
    for _ in range(100):
        change = STEP * (stiffness * (desired - x - STEP * v) - damping * v)
        v += change / (mass + STEP * damping + STEP**2 * stiffness)
        x += STEP * v
        flight.advance(1)
        assert flight.u[0, 0] == pytest.approx(v, rel=1e-4, abs=1e-6)
    assert flight.q[0, 0] == pytest.approx(desired, rel=0.01)


def test_a_ball_servo_turns_back_the_shorter_way():
    body = Body(
        name="ball",
        links=(Link("bob", None, Joint("joint", "ball"), 1.0, inertia=diagonal(0.2, 0.2, 0.2)),),
        gravity=0.0,
    )
    character = ServoedBody(body, 20.0, 4.0)
    turn = np.array([1.0, 2.0, -0.5])
    turn = turn / np.linalg.norm(turn)
    for angle in (0.3, 1.5, 3.0, 5.5):
        q = np.array([*(turn * np.sin(0.5 * angle)), np.cos(0.5 * angle)])
        short = angle if angle < np.pi else angle - 2.0 * np.pi
        # Equal inertias and one axis: the angle's half sine is what the spring sees.
        run = ReferenceRun(character, q[None], np.zeros((1, 3)))
        qdd = np.array(run.evaluate(run.state, 0.0, 0.0).qdd)[:, 0]
        np.testing.assert_allclose(qdd, -turn * 20.0 / 0.2 * 2.0 * np.sin(0.5 * short), atol=1e-9)
        flight = start(character, q).advance(90)
        assert 1.0 - abs(flight.q[0, 3]) < 1e-6


class Holding(ServoedBody):
    """Holds on by its spring as long as its memory says so."""

    memory: Mapping[str, float] = {**ServoedBody.memory, "hold": 1.0}

    def actuate(self, view: View, joints: JointForces) -> None:
        super().actuate(view, joints)
        view.springs["spring"] = view.memory["hold"]


def test_a_controller_lets_go_of_a_spring():
    """Two masses on a stretched spring, one pair of which lets go: it keeps its distance, in lanes and reference."""
    spring = Spring("spring", "link", (0.0, 0.0, 0.0), "other", (0.0, 0.0, 0.0), 400.0, 6.0, 0.5)
    character = Holding(two_masses(spring), 0.0, 0.0)
    q = np.tile(character.body.q_reference, (2, 1))
    q[:, 7] = 0.6
    flight = start(character, q)
    flight.engine.set_memory("hold", np.array([1.0, 0.0]))
    flight.advance(2)
    run = ReferenceRun(character, q, np.zeros((2, 12)))
    run.state.memory["hold"] = np.array([1.0, 0.0])
    run.frame(40)
    run.frame(40)
    gaps = flight.q[:, 7] - flight.q[:, 0]
    assert gaps[1] == pytest.approx(0.6, abs=1e-7)
    assert abs(gaps[0] - 0.6) > 0.05
    np.testing.assert_allclose(gaps, run.q[:, 7] - run.q[:, 0], atol=1e-5)
