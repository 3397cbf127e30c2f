"""Points that move like cyclists: what the peloton is tested on without their bodies.

A point is a rear wheel's contact. Curvature follows the command through two lags, as a bicycle leans first and then
turns, and no further than a lean of 25 degrees. Speed follows through one lag, as far as the rider's power reaches
against drag, rolling resistance and grade, and brakes no harder than at 1.5 m/s^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from echelon.flocking.peloton import Peloton
from echelon.scenario.road import ObstacleSettings, PelotonSettings, UserSettings
from echelon.terrain.spline import Centreline

FRAME_RATE = 30
GRAVITY = 9.80665  # [m/s^2]
LEAN_LAG = 0.2  # [s], of each of two
SPEED_LAG = 1.5  # [s]
STEEPEST_LEAN = np.radians(25.0)
BRAKING = 1.5  # [m/s^2]
MASS = 98.0  # [kg]
DRAG = 0.5 * 1.2 * 0.29  # [N s^2/m^2]
ROLLING = 2 * 0.028 / 0.335**2  # [N s/m]
HEADING_GAIN = 0.8  # [1/s], where there is a heading to steer for and no point


class PointCyclists:
    """Places [m], shape [riders, 2], and the rest, advanced by one frame at a time."""

    def __init__(self, places: np.ndarray, headings: np.ndarray, speeds: np.ndarray, power: np.ndarray) -> None:
        self.places = np.array(places, dtype=np.float64)
        self.headings = np.array(headings, dtype=np.float64)
        self.speeds = np.array(speeds, dtype=np.float64)
        self.curvatures = np.zeros(len(places))
        self.power_limit = np.array(power, dtype=np.float64)
        self.power = np.zeros(len(places))
        self._leaning = np.zeros(len(places))

    @property
    def directions(self) -> np.ndarray:
        return np.stack([np.cos(self.headings), np.sin(self.headings)], axis=1)

    def advance(self, commands: np.ndarray, grades: np.ndarray) -> None:
        """Ride on for a frame, with the commands of its beginning, shape [riders, 4], on these grades."""
        step = 1.0 / FRAME_RATE
        wanted = np.hypot(commands[:, 0], commands[:, 1])
        error = np.arctan2(commands[:, 1], commands[:, 0]) - self.headings
        error = np.arctan2(np.sin(error), np.cos(error))
        pursued = 2.0 * np.sin(error) / np.maximum(commands[:, 2], 1.0)
        steered = HEADING_GAIN * np.clip(error, -0.6, 0.6) / np.maximum(self.speeds, 2.0)
        limit = GRAVITY * np.tan(STEEPEST_LEAN) / np.maximum(self.speeds, 1.0) ** 2
        curvature = np.clip(np.where(commands[:, 2] > 0.0, pursued, steered), -limit, limit)
        self._leaning += (curvature - self._leaning) * step / LEAN_LAG
        self.curvatures += (self._leaning - self.curvatures) * step / LEAN_LAG

        resistance = DRAG * (1.0 - commands[:, 3]) * self.speeds**2 + ROLLING * self.speeds + MASS * GRAVITY * grades
        most = (self.power_limit / np.maximum(self.speeds, 2.0) - resistance) / MASS
        gain = np.clip((wanted - self.speeds) / SPEED_LAG, -BRAKING, np.maximum(most, -BRAKING))
        self.power = np.maximum(MASS * gain + resistance, 0.0) * self.speeds
        self.speeds = np.maximum(self.speeds + gain * step, 0.0)
        turn = self.speeds * self.curvatures * step
        middle = self.headings + 0.5 * turn
        self.places += (self.speeds * step)[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=1)
        self.headings += turn


class PelotonRun:
    """The group layer of a ride, with point cyclists on a road.

    Attributes:
        peloton: The group layer.
        cyclists: The points.
        frame: Number of the frame that comes next.
    """

    def __init__(
        self,
        settings: PelotonSettings,
        path: Centreline,
        half_width: float = 4.0,
        count: int = 16,
        *,
        seed: int = 1,
        obstacles: Sequence[ObstacleSettings] = (),
        user: UserSettings | None = None,
        laps: int = 1,
        power: float = 450.0,
        power_spread: float = 0.1,
    ) -> None:
        self.path = path
        self.peloton = Peloton(
            settings,
            path,
            half_width,
            count,
            frame_rate=FRAME_RATE,
            seed=seed,
            obstacles=obstacles,
            user=user,
            laps=laps,
            device="cpu",
        )
        grid = self.peloton.grid
        limits = power * (1.0 + power_spread * np.random.default_rng(seed).uniform(-1.0, 1.0, count))
        self.cyclists = PointCyclists(grid.positions[:count, :2], grid.headings[:count], grid.speeds[:count], limits)
        self.count = count
        self.frame = 0
        self.positions = wp.zeros(count, dtype=wp.vec3, device="cpu")
        self.velocities = wp.zeros(count, dtype=wp.vec3, device="cpu")
        self.commands: Any = wp.zeros((count, 4), dtype=wp.float32, device="cpu")
        self.fallen = wp.zeros(count, dtype=wp.int32, device="cpu")

    def put(self, s: np.ndarray, offsets: np.ndarray, speeds: np.ndarray | float) -> None:
        """Put everybody at places along the road, riding along it."""
        tangents = self.path.tangent(s)
        self.cyclists.places[:] = self.path.position(s)[:, :2] + np.asarray(offsets)[:, None] * self.path.left(s)
        self.cyclists.headings[:] = np.arctan2(tangents[:, 1], tangents[:, 0])
        self.cyclists.speeds[:] = speeds

    def want(self) -> np.ndarray:
        """Let everybody see and want; the commands, shape [riders, 4], valid until the next call."""
        cyclists = self.cyclists
        self.positions.numpy()[:, :2] = cyclists.places
        self.velocities.numpy()[:, :2] = cyclists.speeds[:, None] * cyclists.directions
        self.peloton.step(self.frame, self.positions, self.velocities, self.commands, self.fallen)
        self.frame += 1
        return self.commands.numpy()

    def advance(self, frames: int = 1) -> None:
        """Let everybody see, want and move for some frames."""
        for _ in range(frames):
            commands = self.want()
            self.cyclists.advance(commands, self.path.grade(self.peloton.riders.s.numpy()[: self.count]))

    def watch(self, frames: int) -> Watched:
        """The same, keeping what happened in each frame."""
        riders, referee = self.peloton.riders, self.peloton.referee.arrays
        rows = []
        for _ in range(frames):
            self.advance()
            arrays = (referee.progress, riders.offset, riders.speed, riders.target, riders.shelter)
            state = [array.numpy()[: self.count].astype(np.float64) for array in arrays]
            rows.append([*state, self.cyclists.curvatures.copy(), self.cyclists.power.copy()])
        return Watched(*np.array(rows).swapaxes(0, 1))


class Watched:
    """What riders did, each of shape [frames, riders]."""

    def __init__(
        self,
        progress: np.ndarray,
        offset: np.ndarray,
        speed: np.ndarray,
        target: np.ndarray,
        shelter: np.ndarray,
        curvature: np.ndarray,
        power: np.ndarray,
    ) -> None:
        self.progress, self.offset, self.speed, self.target = progress, offset, speed, target
        self.shelter, self.curvature, self.power = shelter, curvature, power

    @property
    def lean(self) -> np.ndarray:
        """[rad]."""
        return np.arctan(self.speed**2 * self.curvature / GRAVITY)


# ---- roads -----------------------------------------------------------------------------------------------------------
def straight(length: float = 1500.0, grade: float = 0.0) -> Centreline:
    """An open road along x."""
    x = np.arange(0.0, length + 1.0, 20.0)
    return Centreline(np.stack([x, np.zeros_like(x), grade * x], axis=1), closed=False)


def rounded(half_length: float, half_width: float, radius: float, hills: float = 0.0) -> Centreline:
    """A closed road counter-clockwise round a rectangle with rounded corners, hills [m] high on its long sides."""
    corners = [(1, -1), (1, 1), (-1, 1), (-1, -1)]
    points: list[tuple[float, float]] = []
    for k, (sx, sy) in enumerate(corners):
        center = np.array([sx * (half_length - radius), sy * (half_width - radius)])
        for angle in np.linspace(-np.pi / 2 + k * np.pi / 2, k * np.pi / 2, 7):
            x, y = center + radius * np.array([np.cos(angle), np.sin(angle)])
            points.append((float(x), float(y)))
        turn = np.array(corners[(k + 1) % 4])
        end = np.array(points[-1])
        ahead = turn * np.array([half_length - radius, half_width - radius])
        goal = ahead + radius * np.array([np.cos(k * np.pi / 2), np.sin(k * np.pi / 2)])
        steps = max(2, int(np.linalg.norm(goal - end) / 15.0))
        points += [tuple(end + (goal - end) * part) for part in np.linspace(0.0, 1.0, steps, endpoint=False)[1:]]
    plan = np.array(points)
    height = hills * (1.0 - np.cos(2.0 * np.pi * plan[:, 0] / half_length)) * 0.5
    return Centreline(np.column_stack([plan, height]), closed=True)
