"""Momentum in flight: nothing but gravity acts from outside, so servos may move limbs and not the whole.

Drifts are per second and relative to the momentum at the start: of a somersault, limbs at rest, servos pulling every
joint to another pose. Runge-Kutta keeps momentum to its order. Under semi-implicit Euler it grows, where angular
velocity and momentum point different ways, by h/2 (omega x L)^2 / L^2 a second: the square of the spin counts, and the
step.
"""

from __future__ import annotations

import numpy as np
import pytest
from engine_scenes import as_float32, hopper, puppet, start

from echelon.warp_kernels.character import Character
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.reference_run import ReferenceRun

AGENTS = 8


def somersaults(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Different leaps: some 2 m/s forwards, 3 m/s up, about four rad/s mostly about y."""
    rng = np.random.default_rng(5)
    q = np.tile(body.q_reference, (AGENTS, 1))
    q[:, 2] += 2.0
    u = np.zeros((AGENTS, body.u_count))
    u[:, :3] = (2.0, 0.0, 3.0) + 0.5 * rng.normal(size=(AGENTS, 3))
    u[:, 3:6] = (0.0, 4.0, 0.0) + 0.3 * rng.normal(size=(AGENTS, 3))
    return as_float32(q), as_float32(u)


def poses_to_take(character: Character) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(9)
    return {name: as_float32(rng.uniform(-0.3, 0.3, size=AGENTS)) for name in character.parameters}


def drift(body: Body, before: np.ndarray, after: np.ndarray, seconds: float) -> tuple[float, float]:
    """(linear, angular) relative drift per second, the worst of all agents; gravity's part is taken out."""
    assert np.all(np.linalg.norm(before[:, 3:], axis=1) > 1.0)
    change = after - before
    change[:, 2] += body.mass * body.gravity * seconds
    parts = [
        np.linalg.norm(change[:, i : i + 3], axis=1) / np.linalg.norm(before[:, i : i + 3], axis=1) for i in (0, 3)
    ]
    return float(np.max(parts[0])) / seconds, float(np.max(parts[1])) / seconds


@pytest.mark.parametrize(("name", "substeps"), [("hopper", 120), ("mixed", 60), ("male", 16)])
def test_runge_kutta_in_float64(name: str, substeps: int):
    """From the start, where servos pull hardest."""
    character = puppet(name)
    body = character.body
    q, u = somersaults(body)
    run = ReferenceRun(character, q, u, integrator="rk4", parameters=poses_to_take(character))
    for _ in range(substeps):
        run.substep()
    assert np.max(np.abs(run.u[:, 6:])) > 0.5  # limbs move
    linear, angular = drift(body, body.momentum(q, u), body.momentum(run.q, run.u), substeps * run.step)
    assert linear <= 1e-6
    assert angular <= 1e-6


def drift_of_lanes(character: Character, substeps: int) -> tuple[float, float]:
    """Of a second under the default integrator in float32."""
    body = character.body
    q, u = somersaults(body)
    flight = start(character, q, u, substeps=substeps)
    for key, values in poses_to_take(character).items():
        flight.engine.set_parameter(key, values)
    before, limbs = body.momentum(q, u), np.zeros(1)
    for _ in range(30):
        flight.advance(1)
        limbs = np.maximum(limbs, np.max(np.abs(flight.u[:, 6:])))
    assert limbs > 1.0
    assert not np.any(flight.engine.frozen)
    return drift(body, before, body.momentum(flight.q, flight.u), 1.0)


@pytest.mark.parametrize("name", ["hopper", "mixed", "male"])
def test_the_implicit_default_over_a_second(name: str):
    character = puppet(name)
    linear, angular = drift_of_lanes(character, substeps=40)
    assert linear <= 5e-3
    assert angular <= 5e-3
    if name == "male":
        return  # the same code at another step takes seconds to compile
    half_linear, half_angular = drift_of_lanes(character, substeps=80)
    assert half_linear == pytest.approx(0.5 * linear, rel=0.15)
    assert half_angular == pytest.approx(0.5 * angular, rel=0.15)


def test_the_hopper_in_flight_under_its_own_control():
    """Its leg swings forward, shortens and lengthens again; half a second, before its body could touch the ground."""
    character = hopper()
    body = character.body
    q, u = somersaults(body)
    u[:, 3:6] *= 0.2
    flight = start(character, q, u)
    flight.engine.set_command("velocity_x", np.full(AGENTS, 1.0))
    before = body.momentum(q, u)
    flight.advance(15)
    assert np.all(flight.engine.memory("fallen") == 0.0)
    assert np.max(np.abs(flight.q[:, 7:10])) > 0.05
    change = body.momentum(flight.q, flight.u) - before
    change[:, 2] += body.mass * body.gravity * 0.5
    assert np.max(np.linalg.norm(change[:, 3:], axis=1) / np.linalg.norm(before[:, 3:], axis=1)) / 0.5 <= 5e-3
    assert np.max(np.linalg.norm(change[:, :3], axis=1) / np.linalg.norm(before[:, :3], axis=1)) / 0.5 <= 5e-3
