"""The two integrators: their orders, what they keep, and motions that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from engine_scenes import GRAVITY, STEP, as_float32, diagonal, free_link, puppet, random_motion, start

from echelon.agents.servo import ServoedBody
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.model import Joint, Link
from echelon.warp_kernels.program import Integrator
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.reference_run import ReferenceRun

INTEGRATORS: tuple[Integrator, ...] = ("semi-implicit", "rk4")


def run_for(
    character: Character, q: np.ndarray, u: np.ndarray, integrator: Integrator, seconds: float, step: float
) -> tuple[np.ndarray, np.ndarray]:
    run = ReferenceRun(character, q, u, integrator=integrator, step=step)
    for _ in range(round(seconds / step)):
        run.substep()
    return run.q, run.u


def passive(body: Body) -> ServoedBody:
    """The body left to itself."""
    return ServoedBody(body, 0.0, 0.0)


def pendulum(damping: float = 0.0) -> ServoedBody:
    """A kilogram on a metre of massless rod, hung on a pin along y."""
    link = Link(
        "rod",
        None,
        Joint("pivot", "pin", axes=((0.0, 1.0, 0.0),)),
        1.0,
        com=(0.0, 0.0, -1.0),
        inertia=diagonal(0, 0, 0),
    )
    return ServoedBody(Body(name="pendulum", links=(link,)), 0.0, damping)


# ---- order -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("integrator", "seconds", "step", "least", "most"),
    [("rk4", 0.05, 1 / 100, 3.5, 5.0), ("semi-implicit", 0.04, 1 / 400, 0.85, 1.15)],
)
def test_order_by_step_halving(integrator: Integrator, seconds: float, step: float, least: float, most: float):
    """Every joint there is, swinging and held by servos: differences between one step length and half of it."""
    character = puppet("mixed")
    q, u = random_motion(character.body, 4, seed=2, angle=0.3, speed=1.0)
    ends = [np.concatenate(run_for(character, q, u, integrator, seconds, step / n), axis=1) for n in (1, 2, 4)]
    coarse, fine = np.max(np.abs(ends[0] - ends[1]), axis=1), np.max(np.abs(ends[1] - ends[2]), axis=1)
    orders = np.log2(coarse / fine)
    assert np.all(orders >= least), orders
    assert np.all(orders <= most), orders


def test_the_body_steps_as_the_reference_run_does():
    """`Body.step_runge_kutta` and `Body.step_semi_implicit`, which have no servos, against the run's."""
    character = passive(puppet("mixed").body)
    body = character.body
    q, u = random_motion(body, 3, seed=4)

    def acceleration(at_q: np.ndarray, at_u: np.ndarray) -> np.ndarray:
        return body.forward_dynamics(at_q, at_u, np.zeros_like(at_u))

    expected = run_for(character, q, u, "rk4", STEP, STEP)
    np.testing.assert_allclose(
        np.concatenate(body.step_runge_kutta(q, u, acceleration, STEP), 1), np.concatenate(expected, 1), atol=1e-13
    )
    expected = run_for(character, q, u, "semi-implicit", STEP, STEP)
    np.testing.assert_allclose(
        np.concatenate(body.step_semi_implicit(q, u, acceleration(q, u), STEP), 1),
        np.concatenate(expected, 1),
        atol=1e-13,
    )


# ---- closed forms ----------------------------------------------------------------------------------------------------
def test_a_thrown_body_flies_a_parabola():
    character = passive(free_link(2.0, diagonal(0.1, 0.2, 0.3), ()))
    u = np.array([[3.0, -1.0, 4.0, 0.0, 0.0, 0.0]])
    q = np.tile(character.body.q_reference, (1, 1))
    seconds = 0.5
    drop = 0.5 * GRAVITY * seconds**2
    for integrator, late in zip(INTEGRATORS, (0.5 * GRAVITY * seconds * STEP, 0.0), strict=True):
        # Semi-implicit Euler falls half a step too far: the speeds come first.
        expected = np.array([3.0, -1.0, 4.0]) * seconds - (0.0, 0.0, drop + late)
        found, _ = run_for(character, q, u, integrator, seconds, STEP)
        np.testing.assert_allclose(found[0, :3], expected, atol=1e-12)
        flight = start(character, q, u, integrator=integrator).advance(15)
        # In float32 a steady g h is rounded the same way hundreds of times over.
        np.testing.assert_allclose(flight.q[0, :3], expected, atol=5e-5)


def test_a_symmetric_top_precesses():
    """Torque-free: in the body's axes the spin turns about the axis of symmetry at (C - A)/A times its spin."""
    a, c = 0.4, 0.1
    character = passive(free_link(1.0, diagonal(a, a, c), ()))
    q = np.tile(character.body.q_reference, (1, 1))
    omega = np.array([2.0, 0.0, 6.0])
    u = np.concatenate([[0.0, 0.0, 0.0], omega])[None]
    seconds = 0.5
    _, found = run_for(character, q, u, "rk4", seconds, 1 / 600)
    phase = (c - a) / a * omega[2] * seconds
    expected = (omega[0] * np.cos(phase), omega[0] * np.sin(phase), omega[2])
    np.testing.assert_allclose(found[0, 3:], expected, atol=1e-9)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_pendulum_keeps_its_time(integrator: Integrator):
    """Of large swings the period is the complete elliptic integral's, here by its arithmetic-geometric mean."""
    amplitude = 1.2
    mean, other = 1.0, np.cos(0.5 * amplitude)
    for _ in range(6):
        mean, other = 0.5 * (mean + other), np.sqrt(mean * other)
    period = 2.0 * np.pi * np.sqrt(1.0 / GRAVITY) / mean
    flight = start(pendulum(), np.array([[amplitude]]), integrator=integrator, frame_rate=1200, substeps=1, tick=1)
    angles = [flight.advance(1).q[0, 0] for _ in range(round(2.2 * period * 1200))]
    crossings = np.flatnonzero((np.array(angles[:-1]) < 0.0) & (np.array(angles[1:]) >= 0.0))
    times = [(i + 1 + angles[i] / (angles[i] - angles[i + 1])) / 1200 for i in crossings]
    assert len(times) == 2
    assert times[1] - times[0] == pytest.approx(period, rel=1e-5)


# ---- energy ----------------------------------------------------------------------------------------------------------
def total_energy(body: Body, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    return body.energy(q, u).sum(axis=-1)


def test_runge_kutta_keeps_energy():
    character = passive(puppet("mixed").body)
    body = character.body
    q, u = random_motion(body, 4, seed=6, angle=0.3, speed=1.0)
    before = total_energy(body, q, u)
    after = total_energy(body, *run_for(character, q, u, "rk4", 0.05, 1 / 600))
    kinetic = body.energy(q, u)[:, 0]
    assert np.max(np.abs(after - before) / kinetic) < 1e-6


def test_semi_implicit_euler_keeps_energy_near_over_long_times():
    """A minute of a large swing: energy shivers by a part that is of the order of the step, and does not wander."""
    character = pendulum()
    amplitude = np.linspace(0.5, 2.5, 8)[:, None]
    flight = start(character, amplitude)
    swing = GRAVITY * (1.0 - np.cos(amplitude[:, 0]))
    first, last = [], []
    for frame in range(60 * 30):
        flight.advance(1)
        if not 300 <= frame < 1500:
            energy = total_energy(character.body, flight.q, flight.u) + GRAVITY
            (first if frame < 300 else last).append(energy / swing + np.cos(amplitude[:, 0]) * GRAVITY / swing)
    assert np.max(np.abs(np.array(first + last) - np.median(first, axis=0))) < 5e-3
    np.testing.assert_allclose(np.mean(first, axis=0), np.mean(last, axis=0), atol=2e-4)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_dampers_only_take_energy(integrator: Integrator):
    character = pendulum(damping=0.4)
    flight = start(character, np.array([[2.0]]), integrator=integrator)
    energies = []
    for _ in range(300):
        energies.append(total_energy(character.body, flight.q, flight.u)[0])
        flight.advance(1)
    drops = -np.diff(energies)
    assert np.min(drops) > -2e-3 * (energies[0] + GRAVITY)  # of the order of the step, at the turning points
    assert energies[-1] + GRAVITY < 0.03 * (energies[0] + GRAVITY)


def test_quaternions_stay_of_unit_length():
    character = puppet("mixed")
    q, u = random_motion(character.body, 8, seed=7)
    for integrator in INTEGRATORS:
        flight = start(character, as_float32(q), as_float32(u), integrator=integrator).advance(30)
        body = character.body
        np.testing.assert_allclose(body.normalized(flight.q), flight.q, atol=2e-7)
