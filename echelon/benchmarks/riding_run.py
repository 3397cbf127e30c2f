"""Our half of the race with the cyclist: riders on a rolling road, and all that a race takes but the group.

They ride straight ahead at one speed along a road that goes up and down, each on a place of its own, and everything is
in what is timed: both wheels' look-ups in the road's quadtree, each tick; control; tyres, springs, chain and air; the
dynamics; and the observation for the recording. After every round all of its frames are looked at.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from echelon.agents.riders.cyclist import Cyclist
from echelon.benchmarks.sanity import Verdict, judge_riding, lean_of, spring_gaps
from echelon.benchmarks.timed_engine import ROUND_FRAMES, Stride, bound_engine, timed_round
from echelon.terrain.road import RoadSurfaces, RoadTerrain
from echelon.terrain.spline import Centreline
from echelon.warp_kernels.frame import Terrain
from echelon.warp_kernels.program import Integrator
from echelon.warp_kernels.start import start_warp

RIDING_STRIDE = Stride(substeps=30, tick=10)
"""That of scenarios: 1/900 s, which the springs at hands and feet need; a control tick every 1/90 s."""

RIDING_SPEED = 6.0  # [m/s]
LOOK_AHEAD = 9.0  # to the point that they steer for: a second and a half away [m]
SETTLING_FRAMES = 90  # in which starting has died away
SEED = 1  # of the riders and of their places
VARIATION = 0.03  # of their powers

ROAD_LENGTH = 600.0  # [m]
START, START_LENGTH = 20.0, 200.0  # of the stretch on which riders start [m]
HALF_WIDTH, VERGE = 4.0, 1.5  # [m]
START_HALF_WIDTH = 3.0  # [m]
WAVES = ((90.0, 0.30), (37.0, 0.05))  # the road's ups and downs: length and amplitude [m]


@lru_cache(maxsize=1)
def rolling_road() -> RoadSurfaces:
    """The straight road along x that riders are timed on, made once."""
    x = np.arange(0.0, ROAD_LENGTH + 1.0, 5.0)
    places = np.column_stack([x, np.zeros_like(x)])
    centreline = Centreline(np.column_stack([places, _land(places)]), closed=False)
    return RoadSurfaces(centreline, HALF_WIDTH, VERGE, _land, land_margin=20.0)


def _land(xy: np.ndarray) -> np.ndarray:
    """Heights of the land at places on the map [m], shape [..., 2] to [...]."""
    return sum((amplitude * np.sin(2.0 * np.pi * xy[..., 0] / length) for length, amplitude in WAVES), np.zeros(()))


@lru_cache(maxsize=1)
def riding_ground() -> Terrain:
    """The same road as wheels feel it."""
    start_warp()
    return RoadTerrain.of(rolling_road(), "cpu")


class RidingRun:
    """Riders at one speed on a rolling road; every round goes on from the last and counts for the verdict."""

    def __init__(self, character: Cyclist, agents: int, stride: Stride, integrator: Integrator) -> None:
        road = rolling_road()
        self.engine, self._chunk = bound_engine(character, agents, stride, integrator, riding_ground())
        # Row by row: the first places are the same however many there are.
        part = np.random.default_rng(SEED).random((agents, 2))
        places = np.column_stack([START + START_LENGTH * part[:, 0], START_HALF_WIDTH * (2.0 * part[:, 1] - 1.0)])
        normal = road.normal(places)
        people = character.population(
            agents, SEED, VARIATION, in_phase=False, speed=RIDING_SPEED, grade=-normal[:, 0] / normal[:, 2]
        )
        engine = self.engine
        engine.set_q(people.q)
        engine.set_u(people.u)
        for name, values in people.parameters.items():
            engine.set_parameter(name, values)
        for name, values in people.memory.items():
            engine.set_memory(name, values)
        engine.set_origins(np.column_stack([places, road.height(places)]))
        engine.set_command("velocity_x", np.full(agents, RIDING_SPEED))
        engine.set_command("look_ahead", np.full(agents, LOOK_AHEAD))
        for frame in range(SETTLING_FRAMES):
            engine.advance(frame % ROUND_FRAMES)
        self._speed_error, self._lean, self._gap = np.zeros((3, agents))

    def round(self) -> float:
        microseconds = timed_round(self.engine)
        self._look()
        return microseconds

    def _look(self) -> None:
        """The worst of every frame of the round that was timed last."""
        poses, velocities = self._chunk.poses.numpy(), self._chunk.velocities.numpy()
        speed = np.linalg.norm(velocities, axis=-1)
        lean = np.abs(lean_of(poses[:, :, 0, 3:7].astype(float)))
        gap = spring_gaps(self.engine.character.body, poses).max(axis=-1)
        for worst, found in ((self._speed_error, np.abs(speed - RIDING_SPEED)), (self._lean, lean), (self._gap, gap)):
            np.maximum(worst, found.max(axis=0), out=worst)

    def verdict(self) -> Verdict:
        engine = self.engine
        fallen = engine.memory("fallen") > 0.5
        return judge_riding(
            engine.character.body,
            engine.q,
            engine.u,
            fallen,
            engine.frozen,
            self._speed_error,
            self._lean,
            self._gap,
        )
