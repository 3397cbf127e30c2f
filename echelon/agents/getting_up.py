"""How those who have fallen get up: a posture that their joints are brought to, and when.

Getting up is not simulated: nobody has a controller for it. It is a *kinematic* motion from where a body lies to where
its controller can start anew, along Hermite curves in time s from 0 to 1:

    posture      joints and attitude that the body is brought to, which may move themselves
    joints       how far the joints have come from where they lay to the posture
    turn         how far the attitude has
    advance      how far the body has gone along its heading

The root's height follows: whatever part of the body is lowest touches the ground, so that a body that turns over and
draws in its leg rises as far as its shape makes it, and nothing is ever below the ground. At both ends, where bodies
sink a little into soft contacts, the height is what it was and what it will be.

A hopper draws in its leg and turns upright, then pushes off the ground into its first flight. A rider, who still sits
on the bicycle, takes bars and pedals, is set upright, and rolls off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from echelon.agents import hopper
from echelon.agents.hopper import Hopper
from echelon.agents.riders.bicycle import FRONT_SPEED, REAR_SPEED
from echelon.agents.riders.body import CRANK
from echelon.agents.riders.cyclist import Cyclist
from echelon.agents.riders.pedalling import CADENCE, HIGHEST_GEAR, LOWEST_GEAR, PEAK_TIME
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.reference import Body

# ---- the hopper ------------------------------------------------------------------------------------------------------
HOPPER_SECONDS = 1.7
HOPPER_CLEARANCE = 1.0  # nobody else may be nearer [m]
CROUCH = -0.29  # displacement of the leg while it turns upright [m]
PUSH_FROM = 0.66  # part of the time at which it begins to push
PUSH_SPEED = 1.1  # upward at the end [m/s]
FOOT_CLEARANCE = 0.015  # at the end [m]

# ---- the rider -------------------------------------------------------------------------------------------------------
RIDER_SECONDS = 2.0
RIDER_CLEARANCE = 2.5  # [m]
RIDER_SPEED = 3.5  # at which a rider sets off again [m/s]
ROLL_FROM = 0.4  # part of the time at which the wheels begin to roll


@dataclass(frozen=True)
class Fresh:
    """Individuals as their controllers start anew.

    Attributes:
        q: Generalised positions, the root's relative to the ground beneath it, shape [agents, q_count].
        u: Generalised speeds, shape [agents, u_count].
        memory: Where the controllers' memory differs from the usual, by name, shape [agents] each.
    """

    q: np.ndarray
    u: np.ndarray
    memory: Mapping[str, np.ndarray]


class GettingUp(Protocol):
    """How those of one character get up; s is the part of the time that has passed, 0 to 1, shape [agents].

    Attributes:
        body: Whose.
        seconds: How long it takes [s].
        clearance: Nobody else may be nearer to where one gets up, and to where that ends [m].
    """

    body: Body
    seconds: float
    clearance: float

    def posture(self, s: np.ndarray, lying: np.ndarray, heading: np.ndarray, grade: np.ndarray) -> np.ndarray:
        """What a body is brought to, shape [agents, q_count]; where its root is does not matter.

        Args:
            s: See above.
            lying: Generalised positions as each lay, shape [agents, q_count].
            heading: Direction that each faces in plan, from x towards y [rad].
            grade: Of the ground along it, rise over run.
        """
        ...

    def joints(self, s: np.ndarray) -> np.ndarray:
        """How far the joints have come, 0 to 1."""
        ...

    def turn(self, s: np.ndarray) -> np.ndarray:
        """How far the attitude has come, 0 to 1."""
        ...

    def advance(self, s: np.ndarray) -> np.ndarray:
        """How far the root has gone along the heading [m]."""
        ...

    def fresh(
        self, lying: np.ndarray, heading: np.ndarray, grade: np.ndarray, parameters: Mapping[str, np.ndarray]
    ) -> Fresh:
        """How they start anew; arguments as for `posture`, and the individuals' parameters by name."""
        ...


def getting_up(character: Character) -> GettingUp | None:
    """How a character gets up; None if it cannot."""
    if isinstance(character, Hopper):
        return HopperGettingUp(character)
    if isinstance(character, Cyclist):
        return RiderGettingUp(character)
    return None


def eased(s: np.ndarray, start: float, end: float) -> np.ndarray:
    """Hermite curve from 0 at `start` to 1 at `end` with level ends."""
    x = np.clip((s - start) / (end - start), 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


class HopperGettingUp:
    """See `GettingUp`."""

    seconds = HOPPER_SECONDS
    clearance = HOPPER_CLEARANCE

    def __init__(self, character: Hopper) -> None:
        self.body = character.body

    def posture(self, s: np.ndarray, lying: np.ndarray, heading: np.ndarray, grade: np.ndarray) -> np.ndarray:
        q = self._upright(heading)
        # The push: from rest to the speed of liftoff.
        x = np.clip((s - PUSH_FROM) / (1.0 - PUSH_FROM), 0.0, 1.0)
        slope = PUSH_SPEED * self.seconds * (1.0 - PUSH_FROM)
        q[:, hopper.LEG] = CROUCH * (1.0 - x * x * (3.0 - 2.0 * x)) + slope * (x**3 - x**2)
        return q

    def joints(self, s: np.ndarray) -> np.ndarray:
        return eased(s, 0.0, 0.55)

    def turn(self, s: np.ndarray) -> np.ndarray:
        return eased(s, 0.08, 0.76)

    def advance(self, s: np.ndarray) -> np.ndarray:
        return np.zeros_like(s)

    def fresh(
        self, lying: np.ndarray, heading: np.ndarray, grade: np.ndarray, parameters: Mapping[str, np.ndarray]
    ) -> Fresh:
        q = self._upright(heading)
        q[:, 2] += FOOT_CLEARANCE
        u = np.zeros((len(q), self.body.u_count))
        u[:, 2] = PUSH_SPEED
        return Fresh(q, u, {"heading": heading})

    def _upright(self, heading: np.ndarray) -> np.ndarray:
        q = np.tile(self.body.q_reference, (len(heading), 1))
        q[:, 5], q[:, 6] = np.sin(0.5 * heading), np.cos(0.5 * heading)
        return q


class RiderGettingUp:
    """See `GettingUp`."""

    seconds = RIDER_SECONDS
    clearance = RIDER_CLEARANCE

    def __init__(self, character: Cyclist) -> None:
        self._rider = character
        self.body = character.body
        # All joints but the root have one speed a coordinate, so that their places differ by one.
        self._rear, self._front = REAR_SPEED + 1, FRONT_SPEED + 1
        self._crank = self.body.coordinate_names.index(CRANK)
        radius = character.bicycle.rear_wheel.radius
        self._gear = float(np.clip(RIDER_SPEED / (radius * CADENCE), LOWEST_GEAR, HIGHEST_GEAR))

    def posture(self, s: np.ndarray, lying: np.ndarray, heading: np.ndarray, grade: np.ndarray) -> np.ndarray:
        return self._rolling(s, lying, heading, grade)[0]

    def joints(self, s: np.ndarray) -> np.ndarray:
        return eased(s, 0.0, 0.6)

    def turn(self, s: np.ndarray) -> np.ndarray:
        return eased(s, 0.15, 0.85)

    def advance(self, s: np.ndarray) -> np.ndarray:
        # From rest to the speed at which it rides off: the cubic with a slope at its end only.
        x = np.clip((s - ROLL_FROM) / (1.0 - ROLL_FROM), 0.0, 1.0)
        return RIDER_SPEED * self.seconds * (1.0 - ROLL_FROM) / 3.0 * x**3

    def fresh(
        self, lying: np.ndarray, heading: np.ndarray, grade: np.ndarray, parameters: Mapping[str, np.ndarray]
    ) -> Fresh:
        q, u = self._rolling(np.ones(len(lying)), lying, heading, grade)
        reserve = PEAK_TIME * (parameters["power_peak"] - parameters["power_sustained"])
        return Fresh(q, u, {"gear": np.full(len(lying), self._gear), "reserve": reserve})

    def _rolling(
        self, s: np.ndarray, lying: np.ndarray, heading: np.ndarray, grade: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """q and u of riders who ride off, wheels and cranks turned as far as they have rolled."""
        bicycle, rolled = self._rider.bicycle, self.advance(s)
        crank = lying[:, self._crank] + rolled / (bicycle.rear_wheel.radius * self._gear)
        crank = crank - 2.0 * math.pi * np.round(crank / (2.0 * math.pi))
        gear = np.full(len(s), self._gear)
        q, u = self._rider.riding(heading, np.full(len(s), RIDER_SPEED), grade, crank, gear)
        # The same angle as it lay, and on from there, so that it does not spin on the way.
        turns = np.round((lying[:, self._crank] - crank) / (2.0 * math.pi))
        q[:, self._crank] = crank + 2.0 * math.pi * turns
        q[:, self._rear] = lying[:, self._rear] + rolled / bicycle.rear_wheel.radius
        q[:, self._front] = lying[:, self._front] + rolled / bicycle.front_wheel.radius
        return q, u
