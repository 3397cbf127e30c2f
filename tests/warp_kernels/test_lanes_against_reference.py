"""Native float32 lanes against the float64 reference: accelerations, a frame of flight, and a foot on the ground."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from engine_scenes import STEP, Flight, as_float32, body_named, emitted, hopper, puppet, start

from echelon.warp_kernels import articulated
from echelon.warp_kernels.kinematics import kinematics
from echelon.warp_kernels.program import Integrator
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.reference_run import ReferenceRun

BODIES = ("hopper", "male", "female", "mixed")
FRAME = 40  # substeps
STATES = 100


def random_states(body: Body, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Any place and orientation; joints within a radian or half a metre of the reference pose; lively speeds.

    A gimbal's axes fall together at 90 degrees. Accelerations grow without bound on the way there, and digits go.
    """
    rng = np.random.default_rng(seed)
    columns: list[np.ndarray] = []
    for link in body.links:
        match link.joint.kind:
            case "free":
                columns += [rng.uniform(-2.0, 2.0, size=(count, 3)), rng.normal(size=(count, 4))]
            case "ball":
                columns += [rng.normal(size=(count, 4))]
            case "slider":
                columns += [rng.uniform(-0.5, 0.5, size=(count, 1))]
            case _:
                columns += [rng.uniform(-1.0, 1.0, size=(count, len(link.joint.axes)))]
    q = body.normalized(np.concatenate(columns, axis=1))
    u = 3.0 * rng.normal(size=(count, body.u_count))
    return as_float32(q), as_float32(u), as_float32(30.0 * rng.normal(size=(count, body.u_count)))


class Accelerations:
    """q, u and tau of a body, one after the other, to its accelerations."""

    def __init__(self, body: Body) -> None:
        self.body = body

    def __call__(self, x: list[Any]) -> list[Any]:
        q, u = self.body.q_count, self.body.q_count + self.body.u_count
        kin = kinematics(self.body.tree, x[:q], x[q:u])
        return articulated.forward_dynamics(kin, x[u:])


def largest_relative_error(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference in a state over the largest number of that state, the worst of all states."""
    assert np.all(np.isfinite(found))
    return float(np.max(np.abs(found - expected).max(axis=1) / np.abs(expected).max(axis=1)))


# ---- accelerations ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", BODIES)
def test_accelerations(name: str):
    body = body_named(name)
    q, u, tau = random_states(body, STATES, seed=11)
    inputs = np.concatenate([q, u, tau], axis=1)
    found = emitted(Accelerations(body), inputs.shape[1], 8)(inputs)
    assert largest_relative_error(found, body.forward_dynamics(q, u, tau)) <= 3e-6


@pytest.mark.parametrize("name", ["hopper", "mixed"])
def test_accelerations_of_the_whole_substep(name: str):
    """From rest, what one substep adds to the speeds is h times the acceleration and nothing is lost in subtracting."""
    character = puppet(name)
    body = character.body
    q, u, _ = random_states(body, 16, seed=12)
    flight = start(character, q, 0.0 * u, substeps=1, tick=1, frame_rate=1200).advance(1)
    run = ReferenceRun(character, q, 0.0 * u, step=STEP)
    run.substep()
    assert largest_relative_error(flight.u, run.u) <= 3e-6


# ---- a frame of free flight ------------------------------------------------------------------------------------------
def in_flight(name: str, integrator: Integrator, substeps: int) -> tuple[Flight, ReferenceRun]:
    """Eight lanes and the reference from the same states: tumbling, limbs moving, servos pulling elsewhere."""
    character, count = puppet(name), 8
    body = character.body
    rng = np.random.default_rng(13)
    q = np.tile(body.q_reference, (count, 1)) + 0.2 * rng.normal(size=(count, body.q_count))
    q[:, 2] += 3.0
    q, u = as_float32(body.normalized(q)), as_float32(rng.normal(size=(count, body.u_count)))
    wanted = {key: as_float32(rng.uniform(-0.4, 0.4, size=count)) for key in character.parameters}
    flight = start(character, q, u, integrator=integrator, substeps=substeps, frame_rate=1200 // substeps)
    for key, values in wanted.items():
        flight.engine.set_parameter(key, values)
    return flight, ReferenceRun(character, q, u, integrator=integrator, parameters=wanted)


@pytest.mark.parametrize(
    ("name", "integrator", "substeps"),
    [
        ("hopper", "semi-implicit", FRAME),
        ("hopper", "rk4", FRAME),
        ("mixed", "semi-implicit", FRAME),
        ("mixed", "rk4", FRAME),
        ("male", "semi-implicit", FRAME),
        ("female", "rk4", 10),  # the reference takes a quarter of a second a substep
    ],
)
def test_state_after_a_frame_of_free_flight(name: str, integrator: Integrator, substeps: int):
    flight, run = in_flight(name, integrator, substeps)
    before = run.q
    flight.advance(1)
    run.frame(substeps)
    assert np.max(np.abs(run.q - before)) > 1e-3 * substeps
    # Positions and angles are of about one, so theirs is the absolute error; speeds are of some rad/s.
    assert np.max(np.abs(flight.q - run.q)) <= 1e-5
    assert largest_relative_error(flight.u, run.u) <= 1e-5


# ---- with contact ----------------------------------------------------------------------------------------------------
def test_hopper_lands_and_stands_as_the_reference_does():
    """Two frames of stance: what differs is float32 only, amplified by the stiffness of the ground."""
    character = hopper()
    body = character.body
    count = 6
    q = np.tile(body.q_reference, (count, 1))
    q[:, 2] -= np.linspace(0.0, 0.004, count)
    q[:, 7:9] = as_float32(np.random.default_rng(3).uniform(-0.1, 0.1, size=(count, 2)))
    u = np.zeros((count, body.u_count))
    u[:, 0], u[:, 1], u[:, 2] = np.linspace(-0.5, 0.5, count), 0.1, -1.2
    long_in_flight = np.full(count, 100.0)  # so that the leg is not drawn up
    q, u = as_float32(q), as_float32(u)
    command = {"velocity_x": 0.5, "velocity_y": -0.25}
    flight, run = start(character, q, u), ReferenceRun(character, q, u, command=command)
    flight.engine.set_memory("in_phase", long_in_flight)
    run.state.memory["in_phase"] = long_in_flight.copy()
    for key, value in command.items():
        flight.engine.set_command(key, np.full(count, value))
    for frames in (1, 2):
        flight.advance(1)
        run.frame(FRAME)
        loaded = run.state.memory["loaded"] > 0.5
        assert np.all(loaded), f"frame {frames}: {loaded}"
        assert np.max(np.abs(flight.q - run.q)) <= 2e-6
        assert np.max(np.abs(flight.u - run.u)) <= 1e-4
        for name in ("phase", "touched", "touchdown", "loaded", "fallen", "in_phase", "stance"):
            np.testing.assert_array_equal(flight.engine.memory(name), run.state.memory[name], err_msg=name)
        strain = np.stack(run.state.strains[0], axis=1)
        first = flight.engine.layout.strain[0]
        found = flight.engine.full_state()["state"][:, first : first + 4]
        assert np.max(np.abs(strain)) > 1e-4
        assert np.max(np.abs(found - strain)) <= 2e-8


def test_fallen_hopper_lies_as_the_reference_does():
    """On belly and foot, limp, at its joints' limits: what is rarely computed, and skipped for those who stand."""
    character = hopper()
    body = character.body
    count = 6
    q = np.tile(body.q_reference, (count, 1))
    q[:, 2] = 0.257
    q[:, 3], q[:, 6] = np.sin(0.75), np.cos(0.75)  # rolled over by 86 degrees
    q[:, 7] = np.linspace(-1.15, 1.15, count)
    q[3:, 2] += 0.6  # three fall from above and touch nothing yet
    u = 0.3 * np.random.default_rng(8).normal(size=(count, body.u_count))
    u[:, 2] = -0.4
    q, u = as_float32(q), as_float32(u)
    flight, run = start(character, q, u, substeps=10, frame_rate=120), ReferenceRun(character, q, u)
    for part in range(4):
        flight.advance(1)
        run.frame(10)
        if part == 0:
            # One is pushed off again by its hip, which is bent past its limit.
            assert np.flatnonzero(run.state.strains[1][0] != 0.0).tolist() == [1, 2]
        assert np.all(run.state.memory["fallen"] == 1.0)
        np.testing.assert_array_equal(flight.engine.memory("fallen"), run.state.memory["fallen"])
        assert np.max(np.abs(flight.q - run.q)) <= 2e-6
        assert np.max(np.abs(flight.u - run.u)) <= 2e-4
