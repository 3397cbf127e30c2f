"""The hopper by what a person would notice: speed held, upright, falls that are falls."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.hopper import COLLISION_RADIUS, Hopper
from echelon.export.shapes import visual_mesh
from echelon.scenario import WorldSettings
from echelon.terrain.flat import FlatTerrain
from echelon.warp_kernels.frame import ChunkArrays, Engine

FRAME_RATE = 30
HOPPER = Hopper()
OPEN_GROUND = WorldSettings(ground="plane", corral=None)


class Flock:
    """Some hoppers on open ground or in a world, each with a command of its own, and what was seen of them."""

    def __init__(self, count: int, frames: int, world: WorldSettings = OPEN_GROUND) -> None:
        self.engine = Engine(HOPPER, count, FlatTerrain.of(world), threads=1)
        self.chunk = ChunkArrays.allocate(frames, count, HOPPER)
        self.engine.bind(self.chunk)
        people = HOPPER.population(count, seed=3, variation=0.03, in_phase=False)
        self.engine.set_q(people.q)
        for name, values in people.parameters.items():
            self.engine.set_parameter(name, values)
        for name, values in people.memory.items():
            self.engine.set_memory(name, values)
        self.frame = 0

    def command(self, velocity: np.ndarray) -> None:
        self.engine.set_command("velocity_x", velocity[:, 0])
        self.engine.set_command("velocity_y", velocity[:, 1])

    def run(self, frames: int) -> None:
        for _ in range(frames):
            self.engine.advance(self.frame)
            self.frame += 1

    def strike(self, who: np.ndarray, impulse: np.ndarray, point: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        q, u = self.engine.q.astype(float), self.engine.u.astype(float)
        u[who] += HOPPER.body.generalized_impulse(q[who], "body", point, impulse)
        self.engine.set_u(u)

    @property
    def positions(self) -> np.ndarray:
        """Of the bodies in the world [m], shape [frames, agents, 3]."""
        return (self.chunk.origins.numpy() + self.chunk.poses.numpy()[:, :, 0, :3])[: self.frame]

    @property
    def tilt(self) -> np.ndarray:
        """Angle of the bodies' z axis from the vertical [deg], shape [frames, agents]."""
        q = self.chunk.poses.numpy()[: self.frame, :, 0, 3:]
        return np.degrees(np.arccos(np.clip(1.0 - 2.0 * (q[..., 0] ** 2 + q[..., 1] ** 2), -1.0, 1.0)))

    @property
    def fallen(self) -> np.ndarray:
        return self.chunk.fallen.numpy()[: self.frame].astype(bool)

    def event(self, name: str) -> np.ndarray:
        """Where an event happened, shape [frames, agents]."""
        return self.chunk.events.numpy()[: self.frame, :, HOPPER.events.index(name)] >= 0


def test_holds_its_speed_in_any_direction_and_stays_upright() -> None:
    directions = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    wanted = np.concatenate(
        [speed * np.column_stack([np.cos(directions), np.sin(directions)]) for speed in (0.0, 1.0, 2.0)]
    )
    flock = Flock(len(wanted), 27 * FRAME_RATE)
    flock.command(wanted)
    flock.run(27 * FRAME_RATE)
    assert not flock.fallen.any()
    settled = flock.positions[7 * FRAME_RATE :]
    mean = (settled[-1] - settled[0])[:, :2] / ((len(settled) - 1) / FRAME_RATE)
    assert np.linalg.norm(mean - wanted, axis=1).max() < 0.15
    climb = np.diff(settled[:, :, 2], axis=0)
    apex = (climb[:-1] > 0.0) & (climb[1:] <= 0.0)
    assert apex.sum() > 20 * 1.5 * len(wanted)  # they hop, about twice a second
    assert flock.tilt[7 * FRAME_RATE + 1 : -1][apex].max() <= 15.0


def test_flies_between_steps_and_puts_its_foot_down_without_sliding() -> None:
    flock = Flock(6, 10 * FRAME_RATE)
    flock.command(np.tile([1.5, 0.0], (6, 1)))
    flock.run(10 * FRAME_RATE)
    late = slice(5 * FRAME_RATE, None)
    loaded = flock.chunk.contacts.numpy()[late].astype(bool)
    assert 0.25 < loaded.mean() < 0.55  # stance takes about a third of the time
    # The foot is the far end of the lower leg; while loaded in two frames on end it stays where it is.
    origins = flock.chunk.origins.numpy()[late]
    poses = flock.chunk.poses.numpy()[late][:, :, 2]
    foot = origins + poses[..., :3] + _rotate(poses[..., 3:], np.array([0.0, 0.0, -0.72]))
    both = loaded[1:] & loaded[:-1]
    moved = np.linalg.norm(np.diff(foot, axis=0)[both][:, :2], axis=1)
    assert np.median(moved) < 0.01  # a body at 1.5 m/s travels 0.05 m in a frame
    assert foot[..., 2].min() > 0.035 - 0.02  # the ball of the foot sinks in by less than 2 cm


def test_takes_up_a_new_velocity_only_at_liftoff() -> None:
    flock = Flock(8, 8 * FRAME_RATE)
    wanted = []
    for frame in range(8 * FRAME_RATE):
        flock.command(np.tile([np.sin(0.9 * frame), np.cos(1.7 * frame)], (8, 1)))
        flock.run(1)
        wanted.append(flock.engine.memory("wanted_x"))
    changed = np.diff(np.array(wanted), axis=0) != 0.0
    phases = flock.chunk.phases.numpy()[: flock.frame]
    took_off = (phases[1:] == 0) & (phases[:-1] != 0)
    assert changed.sum() > 8 * 10
    assert not (changed & ~took_off).any()


def test_survives_a_push_of_12_newton_seconds() -> None:
    count = 100
    random = np.random.default_rng(7)
    heading, speed = random.uniform(0.0, 2.0 * np.pi, count), random.uniform(0.0, 2.0, count)
    flock = Flock(count, 11 * FRAME_RATE)
    flock.command(speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)]))
    struck = random.integers(4 * FRAME_RATE, 5 * FRAME_RATE, count)  # two hops: any phase
    angle = random.uniform(0.0, 2.0 * np.pi, count)
    impulse = 12.0 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    for frame in range(11 * FRAME_RATE):
        who = np.flatnonzero(struck == frame)
        if len(who):
            flock.strike(who, impulse[who])
        flock.run(1)
    assert (~flock.fallen[-1]).sum() >= 95


def test_asked_too_much_it_falls_and_comes_to_rest_on_the_ground() -> None:
    count = 16
    flock = Flock(count, 14 * FRAME_RATE)
    flock.command(np.tile([1.0, 0.0], (count, 1)))
    flock.run(3 * FRAME_RATE)
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    impulse = 90.0 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    flock.strike(np.arange(count), impulse, (0.0, 0.0, 0.1))
    flock.run(11 * FRAME_RATE)
    assert flock.fallen[-1].all()
    assert (flock.event("fall").sum(axis=0) == 1).all()  # once each
    assert not flock.chunk.frozen.numpy().any()
    # It goes down under gravity, not at once, and not through the ground.
    heights = flock.positions[:, :, 2]
    assert heights.min() > 0.10
    assert heights[-1].max() < 0.36
    speed = np.linalg.norm(flock.chunk.velocities.numpy()[-1], axis=-1)
    assert speed.max() < 0.05


def test_a_wall_stops_it() -> None:
    world = WorldSettings(ground="oval", half_length=12.0, half_width=8.0, corral=None)
    flock = Flock(8, 14 * FRAME_RATE, world)
    angle = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    flock.command(1.2 * np.column_stack([np.cos(angle), np.sin(angle)]))
    flock.run(14 * FRAME_RATE)
    inside = world.room(flock.positions[:, :, :2])
    assert inside.min() > COLLISION_RADIUS - 0.12  # it gives a little, and nobody is through
    assert (inside[-1] < 1.5).sum() >= 6  # they did get there


def test_is_drawn_with_about_five_hundred_polygons() -> None:
    meshes = [visual_mesh(visual) for link in HOPPER.body.links for visual in link.visuals]
    assert 300 <= sum(len(mesh.face_vertex_counts) for mesh in meshes) <= 900


def test_individuals_do_not_depend_on_how_many_there_are() -> None:
    few = HOPPER.population(5, seed=11, variation=0.05, in_phase=False)
    many = HOPPER.population(50, seed=11, variation=0.05, in_phase=False)
    np.testing.assert_array_equal(few.q, many.q[:5])
    for name, values in few.parameters.items():
        np.testing.assert_array_equal(values, many.parameters[name][:5])
        assert np.std(many.parameters[name]) / np.mean(many.parameters[name]) == pytest.approx(0.05, rel=0.4)


def _rotate(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    axis, w = quaternion[..., :3], quaternion[..., 3:]
    return vector + 2.0 * (w * np.cross(axis, vector) + np.cross(axis, np.cross(axis, vector)))
