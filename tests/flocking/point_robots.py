"""Points that move like hopping robots: what the group layer is tested on without their bodies.

A robot takes up a new desired velocity at its own liftoffs only, about every half second. It flies on with the
velocity it had, and changes it while its foot is on the ground, so as to have the new one by the next liftoff: with
limited acceleration, and not exactly.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from echelon.flocking.group import Group
from echelon.scenario import Scenario

HOP_PERIOD = 0.5  # [s]
PERIOD_SPREAD = 0.03  # relative
FLIGHT_PART = 0.6  # of the period
MAX_ACCELERATION = 8.0  # [m/s^2]
VELOCITY_ERROR = 0.1  # [m/s]; standard deviation of what a hop reaches


class PointRobots:
    """Positions [m] and velocities [m/s], shape [robots, 2], advanced by one frame at a time."""

    def __init__(self, start: np.ndarray, frame_rate: int, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        count = len(start)
        self.positions = np.array(start, dtype=np.float64)
        self.velocities = np.zeros((count, 2))
        self.largest_change = 0.0
        self._targets = np.zeros((count, 2))
        self._period = HOP_PERIOD * (1.0 + PERIOD_SPREAD * self._random.uniform(-1.0, 1.0, count))
        self._phase = self._random.uniform(0.0, 1.0, count)
        self._step = 1.0 / frame_rate

    def advance(self, desired: np.ndarray) -> None:
        """Hop on for one frame, with the desired velocities [m/s] of its beginning, shape [robots, 2]."""
        self._phase += self._step / self._period
        lifting_off = self._phase >= 1.0
        self._phase[lifting_off] -= 1.0
        count = int(lifting_off.sum())
        if count:
            change = np.linalg.norm(desired[lifting_off] - self.velocities[lifting_off], axis=1).max()
            self.largest_change = max(self.largest_change, float(change))
            error = VELOCITY_ERROR * self._random.standard_normal((count, 2))
            self._targets[lifting_off] = desired[lifting_off] + error
        on_ground = self._phase > FLIGHT_PART
        time_left = np.maximum((1.0 - self._phase) * self._period, self._step)
        change = (self._targets - self.velocities) * np.minimum(1.0, self._step / time_left)[:, None]
        size = np.linalg.norm(change, axis=1)
        change *= np.minimum(1.0, MAX_ACCELERATION * self._step / np.maximum(size, 1e-9))[:, None]
        self.velocities += change * on_ground[:, None]
        self.positions += self.velocities * self._step


class GroupRun:
    """A scenario's group layer, driving point robots.

    Attributes:
        group: The group layer.
        robots: The points.
        frame: Number of the frame that comes next.
    """

    def __init__(self, scenario: Scenario, robot_seed: int = 0) -> None:
        count = scenario.crowd.count
        self.group = Group(scenario, "cpu")
        self.robots = PointRobots(scenario.start_positions(), scenario.frame_rate, robot_seed)
        self.frame = 0
        self.positions = wp.zeros(count, dtype=wp.vec3, device="cpu")
        self.velocities = wp.zeros(count, dtype=wp.vec3, device="cpu")
        self.fallen = wp.zeros(count, dtype=wp.int32, device="cpu")
        self.desired = wp.zeros(count, dtype=wp.vec2, device="cpu")

    def want(self) -> np.ndarray:
        """Let everybody see and want; the desired velocities [m/s], shape [robots, 2], valid until the next call."""
        self.positions.numpy()[:, :2] = self.robots.positions
        self.velocities.numpy()[:, :2] = self.robots.velocities
        self.group.step(self.frame, self.positions, self.velocities, self.desired, self.fallen)
        self.frame += 1
        return self.desired.numpy()

    def advance(self, frames: int = 1) -> None:
        """Let everybody see, want and move for some frames."""
        for _ in range(frames):
            self.robots.advance(self.want())
