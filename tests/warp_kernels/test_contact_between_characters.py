"""Contact between characters in the engine: both sides, any order, any lanes, beside whomever; and against float64."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from engine_scenes import SlopedTerrain, hopper
from free_bodies import STEP, FreeBody, rod

from echelon.warp_kernels.character import NO_EVENT, Character
from echelon.warp_kernels.crossing import deepest_crossing
from echelon.warp_kernels.frame import ChunkArrays, Engine
from echelon.warp_kernels.meeting import Law
from echelon.warp_kernels.meeting_code import DUE_SIZE, contact_frequency, ghost_size
from echelon.warp_kernels.meetings import ContactSettings
from echelon.warp_kernels.reference_run import ReferenceMeeting, ReferenceRun
from echelon.warp_kernels.replay import Graphs
from echelon.warp_kernels.restitution import restitution_damping


@dataclass
class Start:
    """Where bodies start: places [agents, 3], attitudes [agents, 4], velocities and spins [agents, 3]."""

    places: np.ndarray
    attitudes: np.ndarray
    velocities: np.ndarray
    spins: np.ndarray

    def of(self, order: Sequence[int] | np.ndarray) -> Start:
        """The same bodies in another order, or some of them."""
        return Start(self.places[order], self.attitudes[order], self.velocities[order], self.spins[order])


def swarm(count: int, seed: int = 3) -> Start:
    """Rods that tumble towards the middle of a ball."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1.0, 1.0, size=(count, 3)) * (1.6, 1.6, 0.8)
    attitudes = rng.normal(size=(count, 4))
    attitudes /= np.linalg.norm(attitudes, axis=1, keepdims=True)
    return Start(
        places, attitudes, -2.0 * places + rng.normal(size=(count, 3)) * 0.2, rng.normal(size=(count, 3)) * 3.0
    )


def engine_of(character: Character, start: Start, *, restitution: float = 0.3, **options: Any) -> Engine:
    """An engine of bodies far from the world's origin that has been looked at."""
    count = len(start.places)
    settings = options.pop("contact", ContactSettings(restitution, 0.3))
    engine = Engine(
        character, count, SlopedTerrain.of(0.0), frame_rate=30, substeps=24, tick=6, contact=settings, **options
    )
    engine.bind(ChunkArrays.allocate(1, count, character))
    q = np.tile(character.body.q_reference, (count, 1))
    q[:, :3], q[:, 3:7] = 0.0, start.attitudes
    u = np.zeros((count, character.body.u_count))
    u[:, :3], u[:, 3:6] = start.velocities, start.spins
    engine.set_origins(start.places + np.array([4_000.0, -3_000.0, 50.0]))
    engine.set_q(q)
    engine.set_u(u)
    engine.advance(0, observe_only=True)
    return engine


def row_of_balls(places: Sequence[float], speeds: Sequence[float]) -> Start:
    """Balls on a line, moving along it."""
    count = len(places)
    along = np.zeros((count, 3))
    along[:, 0] = places
    moving = np.zeros((count, 3))
    moving[:, 0] = speeds
    return Start(along, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)), moving, np.zeros((count, 3)))


def bits(engine: Engine, agent: int) -> bytes:
    """All there is of one agent, but for the numbers that others go by."""
    full = engine.full_state()
    return b"".join(array[agent].tobytes() for name, array in full.items() if name != "public.partners")


@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.7, 1.0])
def test_two_who_meet_part_as_asked_for(restitution: float):
    engine = engine_of(FreeBody(), row_of_balls([0.0, 0.57], [2.0, -1.0]), restitution=restitution)
    for _ in range(6):
        engine.advance(0)
    speeds = engine.u[:, 0]
    assert (speeds[1] - speeds[0]) / 3.0 == pytest.approx(restitution, abs=0.08)
    assert speeds.sum() == pytest.approx(1.0, abs=1e-3)


def test_three_in_a_row_keep_momentum_and_gain_no_energy():
    engine = engine_of(FreeBody(), row_of_balls([0.0, 0.62, 1.125], [3.0, 0.0, 0.0]), restitution=0.8)
    energies = []
    for _ in range(12):
        engine.advance(0)
        energies.append(float((engine.u[:, 0] ** 2).sum()))
    assert engine.u[:, 0].sum() == pytest.approx(3.0, rel=1e-3)
    assert max(energies) <= 9.0 * 1.0001
    assert np.all(np.diff(engine.u[:, 0]) > 0.0)


def test_the_order_of_agents_changes_no_bit():
    start, count = swarm(20), 20
    order = np.random.default_rng(1).permutation(count)
    one, two = engine_of(rod(), start), engine_of(rod(), start.of(order))
    touched = 0
    for _ in range(25):
        one.advance(0)
        two.advance(0)
        assert one.meetings is not None
        touched += int((one.meetings.counts.numpy()[:count] > 0).sum())
    assert touched > 50
    assert all(bits(one, int(agent)) == bits(two, place) for place, agent in enumerate(order))


@pytest.mark.parametrize(("lanes", "threads"), [(1, 1), (4, 2), (16, 2)])
def test_lanes_and_threads_change_no_bit(lanes: int, threads: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("echelon.warp_kernels.frame.THREAD_WORK", 1)
    start = swarm(21)
    one, two = engine_of(rod(), start, lanes=8, threads=1), engine_of(rod(), start, lanes=lanes, threads=threads)
    for _ in range(15):
        one.advance(0)
        two.advance(0)
    assert all(bits(one, agent) == bits(two, agent) for agent in range(21))
    one.close()
    two.close()


def test_a_part_of_a_crowd_gets_the_same_bits():
    start, count = swarm(18), 18
    whole = engine_of(rod(), start)
    parts = [
        engine_of(rod(), start.of(range(first, first + 9)), first_agent=first, crowd_count=count) for first in (0, 9)
    ]
    for _ in range(15):
        for mine in parts:
            for other in parts:
                for name, array in other.public.items():
                    host = mine.public[name].numpy()
                    host[other.mine] = array.numpy()[other.mine]
                    mine.public[name].assign(host)
        for engine in (whole, *parts):
            engine.advance(0)
    assert all(bits(whole, agent) == bits(parts[agent // 9], agent % 9) for agent in range(count))


def test_a_lane_that_is_not_finite_harms_nobody():
    start = swarm(16)
    away = swarm(16)
    away.places[5] += 500.0
    sick, well = engine_of(rod(), start), engine_of(rod(), away)
    u = sick.u
    u[5, 2] = np.nan
    sick.set_u(u)
    sick.advance(0, observe_only=True)
    for _ in range(12):
        sick.advance(0)
        well.advance(0)
    assert sick.frozen[5]
    # Where it lies frozen nobody feels it, as if it were far away.
    assert all(bits(sick, agent) == bits(well, agent) for agent in range(16) if agent != 5)


def test_who_meets_nobody_has_the_bits_of_a_world_without_contact():
    character = hopper()
    count = 5
    places = np.column_stack([np.arange(count) * 3.0, np.zeros(count), np.full(count, -49.2)])
    start = Start(places, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)), np.zeros((count, 3)), np.zeros((count, 3)))
    with_contact, without = engine_of(character, start), engine_of(character, start, contact=None)
    for _ in range(20):
        with_contact.advance(0)
        without.advance(0)
    assert np.array_equal(with_contact.q, without.q)
    assert np.array_equal(with_contact.u, without.u)


def test_the_engine_agrees_with_the_reference_beside_the_same_ghosts():
    character, start = rod(), swarm(16, seed=9)
    engine = engine_of(character, start)
    meetings = engine.meetings
    assert meetings is not None
    choosing = Graphs(meetings.phases(1, engine.state, engine.origins, engine.velocities), "cpu")
    size, omega = ghost_size(meetings.bumper), contact_frequency(STEP)
    law = Law(omega, restitution_damping(0.3, omega * STEP), 0.3)
    pushed = 0
    for _ in range(15):
        choosing.replay(engine.team)
        counts = meetings.counts.numpy()[:16].copy()
        numbers = meetings.ghosts.numpy().copy()
        q, before = engine.q.astype(float), engine.u.astype(float)
        q[:, :3] = 0.0
        engine.advance(0)
        due = numbers[np.arange(16) // engine.lanes, :DUE_SIZE, np.arange(16) % engine.lanes]
        met = np.flatnonzero((counts == 1) & ~due.any(axis=1))
        if len(met) == 0:
            continue
        run = ReferenceRun(character, q[met], before[met], step=STEP, tick=6)
        rows = numbers[met // engine.lanes, DUE_SIZE : DUE_SIZE + size, met % engine.lanes].astype(float)
        run.meeting = ReferenceMeeting(
            meetings.bumper, law, [[rows[:, i] for i in range(size)]], np.full(len(met), NO_EVENT)
        )
        run.frame(24)
        change = np.abs(run.u - before[met]).max(axis=1)
        pushed += int((change > 0.05).sum())
        assert np.abs(engine.u[met] - run.u).max() < 2e-3 * max(1.0, change.max())
    assert pushed > 3


def test_only_the_first_touch_after_a_frame_without_one_is_an_event():
    character = FreeBody()
    chunk = ChunkArrays.allocate(1, 2, character)
    engine = engine_of(character, row_of_balls([0.0, 0.498], [0.2, -0.2]), restitution=0.0)
    engine.bind(chunk)
    found = []
    for _ in range(4):
        engine.advance(0)
        found.append(chunk.touches.numpy()[0].tolist())
    assert found[0] == [0, 0]
    assert all(later == [-1, -1] for later in found[1:])


def test_who_is_removed_or_not_touchable_is_no_ghost():
    engine = engine_of(FreeBody(), row_of_balls([0.0, 0.52], [1.0, -1.0]))
    bearings = engine.public["bearings"].numpy()
    assert bearings.tolist() == [1, 1]
    bearings[1] = 0
    engine.public["bearings"].assign(bearings)
    engine.advance(0)
    assert engine.u[0, 0] == pytest.approx(1.0)


def test_the_deepest_crossing_is_that_of_the_capsules():
    capsules = rod().capsules
    poses = np.zeros((3, 3, 7))
    poses[..., 6] = 1.0
    poses[:, 2, 0] = 50.0
    poses[0, 1, :3] = (0.0, 0.25, 0.0)  # side by side, 0.3 m thick together
    poses[1, 1, :3] = (1.0, 0.0, 0.0)  # end to end, 1.1 m long together
    poses[2, 1, :3] = (0.0, 0.0, 0.29)
    poses[2, 1, 3:] = (0.0, 0.0, np.sin(0.7), np.cos(0.7))  # crossed
    assert np.allclose(deepest_crossing(capsules, poses), [0.05, 0.1, 0.01], atol=1e-9)
    poses[:, 1, 0] = np.inf
    assert np.array_equal(deepest_crossing(capsules, poses), np.zeros(3))
