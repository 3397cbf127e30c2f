"""Characters that touch: robots in a crush, riders who lean on one another and take others down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from echelon.agents.characters import character_named
from echelon.scenario import WorldSettings
from echelon.terrain.flat import FlatTerrain
from echelon.warp_kernels.crossing import deepest_crossing
from echelon.warp_kernels.frame import ChunkArrays, Engine
from echelon.warp_kernels.meetings import ContactSettings
from echelon.warp_kernels.start import start_warp

DEEPEST = 0.05  # crossing deeper than this is a failure [m]


@dataclass
class Crowd:
    """Characters on open ground, frame by frame.

    Attributes:
        poses: First links in the world, [agents, 7] a frame.
        measures: What the character records, [agents, records] a frame.
        touches: How many began to touch, a frame.
    """

    engine: Engine
    chunk: ChunkArrays
    poses: list[np.ndarray] = field(default_factory=list)
    measures: list[np.ndarray] = field(default_factory=list)
    touches: list[int] = field(default_factory=list)

    def run(self, frames: int, steer: Callable[[Crowd, int], None]) -> None:
        """Frames, before each of which commands are given."""
        for frame in range(frames):
            steer(self, frame)
            self.engine.advance(0)
            poses = self.chunk.poses.numpy()[0, :, 0].astype(float)
            poses[:, :3] += self.chunk.origins.numpy()[0]
            self.poses.append(poses)
            self.measures.append(self.chunk.measures.numpy()[0].copy())
            self.touches.append(int((self.chunk.touches.numpy() >= 0).sum()))

    @property
    def deepest(self) -> float:
        """Deepest crossing of any two [m]."""
        return float(deepest_crossing(self.engine.character.capsules, np.stack(self.poses)).max())  # type: ignore[attr-defined]

    @property
    def fallen(self) -> np.ndarray:
        """Who has fallen."""
        return self.engine.memory("fallen") > 0.5


def hoppers(places: np.ndarray, contact: ContactSettings | None) -> Crowd:
    """Robots that stand at places [agents, 2]."""
    start_warp()
    character, count = character_named("hopper"), len(places)
    people = character.population(count, 1, 0.06, in_phase=False)
    return crowd(character, people, places, contact, 24, 6)


def riders(places: np.ndarray, speed: float, contact: ContactSettings | None) -> Crowd:
    """Riders on their way along x from places [agents, 2]."""
    start_warp()
    character = character_named("cyclist")
    people = character.population(len(places), 1, 0.0, in_phase=True, heading=0.0, speed=speed)  # type: ignore[call-arg]
    return crowd(character, people, places, contact, 30, 10)


def crowd(character, people, places: np.ndarray, contact: ContactSettings | None, substeps: int, tick: int) -> Crowd:
    """A population at its places that has been looked at."""
    count = len(places)
    ground = FlatTerrain.of(WorldSettings(ground="plane", corral=None))
    engine = Engine(
        character, count, ground, frame_rate=30, substeps=substeps, tick=tick, threads=1, contact=contact, lanes=8
    )
    chunk = ChunkArrays.allocate(1, count, character)
    engine.bind(chunk)
    engine.set_q(people.q)
    engine.set_u(people.u)
    for name, values in people.parameters.items():
        engine.set_parameter(name, values)
    for name, values in people.memory.items():
        engine.set_memory(name, values)
    engine.set_origins(np.column_stack([places, np.zeros(count)]))
    engine.advance(0, observe_only=True)
    return Crowd(engine, chunk)


def square(count: int, spacing: float) -> np.ndarray:
    """Places on a square grid about the middle, a little off it, shape [count^2, 2]."""
    rng = np.random.default_rng(2)
    grid = (np.stack(np.meshgrid(np.arange(count), np.arange(count)), -1).reshape(-1, 2) - 0.5 * (count - 1)) * spacing
    return grid + rng.uniform(-0.05, 0.05, size=grid.shape)


def test_robots_that_meet_in_the_air_get_opposite_impulses():
    places = np.array([[0.0, 0.0], [0.6, 0.15]])
    met = hoppers(places, ContactSettings())
    body, frames = met.engine.character.body, 14
    u = np.zeros((2, body.u_count))
    u[:, 0], u[:, 2] = (1.5, -0.5), 2.0
    met.engine.set_u(u)
    met.engine.set_origins(np.column_stack([places, (3.0, 3.1)]))
    met.engine.advance(0, observe_only=True)
    before = body.momentum(met.engine.q.astype(float), met.engine.u.astype(float))[:, :3]
    met.run(frames, lambda crowd, frame: None)
    got = body.momentum(met.engine.q.astype(float), met.engine.u.astype(float))[:, :3] - before
    got[:, 2] += body.mass * body.gravity * frames / 30.0
    assert np.linalg.norm(got[0]) > 10.0
    assert np.linalg.norm(got.sum(axis=0)) < 0.01 * np.linalg.norm(got[0])


def inwards(speed: float) -> Callable[[Crowd, int], None]:
    """Everybody to the middle."""

    def steer(crowd: Crowd, frame: int) -> None:
        places = crowd.engine.positions.numpy()[:, :2]
        away = np.linalg.norm(places, axis=1, keepdims=True)
        wanted = -speed * places / np.maximum(away, 0.3)
        crowd.engine.set_command("velocity_x", wanted[:, 0])
        crowd.engine.set_command("velocity_y", wanted[:, 1])

    return steer


def test_robots_that_all_want_to_one_place_jostle_and_do_not_pass_through_each_other():
    met = hoppers(square(4, 1.0), ContactSettings())
    met.run(120, inwards(1.5))
    assert np.all(np.isfinite(met.engine.q))
    assert sum(met.touches) > 50
    assert met.deepest < DEEPEST
    assert np.linalg.norm(met.engine.velocities.numpy(), axis=1).max() < 5.0
    ghosts = hoppers(square(4, 1.0), None)
    ghosts.run(120, inwards(1.5))
    assert ghosts.deepest > 2.0 * DEEPEST
    assert sum(ghosts.touches) == 0


def ahead(speed: float, steering: dict[int, float]) -> Callable[[Crowd, int], None]:
    """Everybody straight on, but some aside by a part of their speed, for a second."""

    def steer(crowd: Crowd, frame: int) -> None:
        count = len(crowd.poses[-1]) if crowd.poses else crowd.engine.agent_count
        aside = np.zeros(count)
        for rider, part in steering.items():
            aside[rider] = part * speed if frame < 30 else 0.0
        crowd.engine.set_command("velocity_x", np.full(count, speed))
        crowd.engine.set_command("velocity_y", aside)
        crowd.engine.set_command("look_ahead", np.full(count, 10.0))

    return steer


def test_a_rider_who_is_ridden_into_wobbles():
    places = np.array([[0.0, 0.0], [0.1, 0.66], [-3.0, 4.0]])
    met, alone = (riders(places, 9.0, contact) for contact in (ContactSettings(), None))
    for pack in (met, alone):
        pack.run(75, ahead(9.0, {0: 0.6}))
    lean = met.engine.character.records.index("lean")
    leans, usual = (np.degrees(np.stack(pack.measures)[:, :, lean]) for pack in (met, alone))
    assert sum(met.touches) >= 2
    assert np.abs(usual[:, 1]).max() < 2.0
    assert np.abs(leans[:, 1]).max() > 4.0
    assert met.deepest < DEEPEST < alone.deepest
    # Who is far from it rides as if nothing had happened.
    assert np.array_equal(np.stack(met.poses)[:, 2], np.stack(alone.poses)[:, 2])


@pytest.mark.parametrize("contact", [True, False])
def test_a_rider_who_is_thrown_over_takes_a_neighbour_down(contact: bool):
    places = np.array([[0.0, -0.62], [0.0, 0.0], [0.0, 0.62]])
    pack = riders(places, 9.0, ContactSettings() if contact else None)
    pack.run(10, ahead(9.0, {}))
    u = pack.engine.u
    u[1, 3] += 7.0  # to the right
    pack.engine.set_u(u)
    pack.run(60, ahead(9.0, {}))
    assert np.all(np.isfinite(pack.engine.q))
    assert pack.fallen[1]
    assert pack.fallen[0] == contact
    assert pack.fallen.sum() == 1 + contact
