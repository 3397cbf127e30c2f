"""From what a person's hands and feet do, and a trainer measures, to the controls of a frame."""

from __future__ import annotations

import numpy as np

from echelon.flocking.person import CONTROLS, DEVELOPMENTS, FIRST_GEAR, STEERING_LIMIT, hands_off
from echelon.play.web.messages import Command, Gear, LetGo, Ride

_AT = {name: place for place, name in enumerate(CONTROLS)}


class Controls:
    """What whoever rides is doing now.

    Attributes:
        gear: That is in, from 1.
    """

    def __init__(self) -> None:
        self.gear = FIRST_GEAR
        self._held = Ride(0.0, 0.0, 0.0, False)

    def hear(self, command: Command) -> None:
        """Take a command of the rider's; those about other things change nothing."""
        if isinstance(command, Ride):
            self._held = command
        elif isinstance(command, LetGo):
            self._held = Ride(0.0, 0.0, 0.0, self._held.lean)
        elif isinstance(command, Gear):
            self.gear = min(max(self.gear + command.step, 1), len(DEVELOPMENTS))

    def row(self, power: float | None = None) -> np.ndarray:
        """The controls of a frame, by `CONTROLS`, float32.

        Args:
            power: What a trainer measures [W]; None where there is none, and pedals are what the person holds.
        """
        controls = hands_off()
        controls[_AT["effort"]] = self._held.pedal if power is None else 0.0
        controls[_AT["power"]] = 0.0 if power is None else max(power, 0.0)
        controls[_AT["brake"]] = self._held.brake
        controls[_AT["steering"]] = self._held.steer * STEERING_LIMIT
        controls[_AT["leaning"]] = float(self._held.lean)
        controls[_AT["gear"]] = self.gear
        return controls
