"""Pins that turn without end: their angle stays small and precise, and nobody notices where it is taken back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from engine_scenes import diagonal, free_link, start

from echelon.agents.servo import ServoedBody
from echelon.warp_kernels.model import Joint, Link, Model, ModelError
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.reference_run import ReferenceRun

SPIN = 43.0  # [rad/s], a racing wheel at 14 m/s


def unicycle(**joint: Any) -> Body:
    """A wheel on a frame, in space."""
    frame = free_link(5.0, diagonal(0.4, 0.4, 0.4), ()).links[0]
    axle = Joint("axle", "pin", axes=((0.0, 1.0, 0.0),), **joint)
    wheel = Link("wheel", "link", axle, 1.5, inertia=diagonal(0.05, 0.1, 0.05))
    return Body(name="unicycle", links=(frame, wheel), gravity=0.0)


def test_a_wheel_that_turns_for_long_stays_precise():
    character = ServoedBody(unicycle(continuous=True), 0.0, 0.0)
    u = np.zeros(7)
    u[4], u[6] = -0.1 * SPIN / 0.5, SPIN  # as much angular momentum one way as the other
    flight = start(character, character.body.q_reference, u, substeps=24, tick=6)
    rate = flight.u[0, 6]
    angles, quaternions = [], []
    for _ in range(900):
        flight.advance(1)
        angles.append(flight.q[0, 7])
        quaternions.append(flight.chunk.poses.numpy()[0, 0, 1, 3:])
    angles, quaternions = np.array(angles), np.array(quaternions)
    # It is taken back at the start of a frame, so it may stand beyond by what it turns in one.
    assert np.max(np.abs(angles)) <= 2.0 * np.pi + SPIN / 30.0 + 1e-3
    expected = rate * np.arange(1, 901) / 30.0
    error = (angles - expected + np.pi) % (2.0 * np.pi) - np.pi
    # 200 turns: rounding of angles below two turns adds up slowly; that of 1290 rad would be 1e-4 at once.
    assert np.max(np.abs(error)) < 5e-3
    # The quaternion turns on without changing its sign: from frame to frame by half the angle.
    assert np.min(np.sum(quaternions[1:] * quaternions[:-1], axis=1)) > np.cos(0.5 * 1.6)


def test_lanes_and_reference_take_it_back_alike():
    character = ServoedBody(unicycle(continuous=True), 0.0, 0.0)
    q = np.tile(character.body.q_reference, (3, 1))
    q[:, 7] = (6.2, -6.2, 0.3)
    u = np.zeros((3, 7))
    u[:, 6] = (SPIN, -SPIN, 5.0)
    flight, run = start(character, q, u), ReferenceRun(character, q, u)
    for _ in range(6):
        flight.advance(1)
        run.frame(40)
    np.testing.assert_allclose(flight.q, run.q, atol=2e-4)
    assert np.max(np.abs(run.q[:, 7])) < 9.0


def test_other_pins_are_left_alone():
    character = ServoedBody(unicycle(), 0.0, 0.0)
    u = np.zeros(7)
    u[6] = SPIN
    assert start(character, character.body.q_reference, u).advance(30).q[0, 7] > 20.0


@pytest.mark.parametrize("joint", [{"limits": ((-1.0, 1.0),)}, {"kind": "slider"}])
def test_only_a_free_pin_can_be_continuous(joint: dict[str, Any]):
    data = unicycle(continuous=True).to_dict()
    data["links"][1]["joint"] |= joint
    with pytest.raises(ModelError, match="continuous"):
        Model.from_dict(data)


def test_it_is_true_or_false():
    data = unicycle().to_dict()
    data["links"][1]["joint"]["continuous"] = "yes"
    with pytest.raises(ModelError, match="true or false"):
        Model.from_dict(data)
