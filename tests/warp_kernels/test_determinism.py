"""The same bits, however agents are dealt out: to lanes, blocks and threads, beside whomever, before or after a break.

Compared within one run on one machine: another processor may have another square root.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pytest
from engine_scenes import SlopedTerrain, as_float32, hopper, puppet

from echelon.warp_kernels.character import Character
from echelon.warp_kernels.frame import ChunkArrays, Engine

AGENTS = 20


@dataclass
class Crowd:
    """A character, how many frames to run it, and what its agents start from."""

    character: Character
    frames: int
    q: np.ndarray
    u: np.ndarray
    origins: np.ndarray
    commands: dict[str, np.ndarray]
    parameters: dict[str, np.ndarray]


@dataclass
class Outcome:
    """The full state of all agents at the end and what was recorded of them, [frames, agents, ...] each."""

    full: dict[str, np.ndarray]
    recorded: dict[str, np.ndarray]

    def agent(self, index: int) -> bytes:
        """All there is of one agent."""
        last = b"".join(self.full[name][index].tobytes() for name in self.full)
        return last + b"".join(self.recorded[name][:, index].tobytes() for name in self.recorded)


def hoppers() -> Crowd:
    """Twenty hoppers in the air and on the ground, going everywhere, far from home; two thirds of a second."""
    character = hopper()
    rng = np.random.default_rng(41)
    body = character.body
    q = np.tile(body.q_reference, (AGENTS, 1))
    q[:, :2] = 0.0
    q[:, 2] += rng.uniform(-0.003, 0.1, size=AGENTS)
    q[:, 3:6] = rng.normal(size=(AGENTS, 3)) * 0.05
    q[:, 7:10] = rng.normal(size=(AGENTS, 3)) * 0.1
    u = rng.normal(size=(AGENTS, body.u_count)) * 0.5
    q[3, 3:7] = (1.0, 0.0, 0.0, 0.2)  # one lies on its side
    origins = np.stack(
        [rng.uniform(-1e4, 1e4, size=AGENTS), rng.uniform(-1e4, 1e4, size=AGENTS), np.zeros(AGENTS)], axis=1
    )
    commands = {name: as_float32(rng.uniform(-2.0, 2.0, size=AGENTS)) for name in character.commands}
    parameters = {
        name: as_float32(usual * rng.uniform(0.97, 1.03, size=AGENTS)) for name, usual in character.parameters.items()
    }
    return Crowd(character, 20, as_float32(body.normalized(q)), as_float32(u), origins, commands, parameters)


def males() -> Crowd:
    """Twenty men in flight, every joint moving and pulled elsewhere; three frames."""
    character = puppet("male")
    rng = np.random.default_rng(43)
    body = character.body
    q = body.normalized(np.tile(body.q_reference, (AGENTS, 1)) + 0.2 * rng.normal(size=(AGENTS, body.q_count)))
    u = rng.normal(size=(AGENTS, body.u_count))
    parameters = {name: as_float32(rng.uniform(-0.4, 0.4, size=AGENTS)) for name in character.parameters}
    return Crowd(character, 3, as_float32(q), as_float32(u), rng.normal(size=(AGENTS, 3)) * 1e3, {}, parameters)


CROWDS: dict[str, Callable[[], Crowd]] = {"hopper": hoppers, "male": males}


def prepare(crowd: Crowd, order: np.ndarray, lanes: int = 8, threads: int = 1, **part: Any) -> Engine:
    """An engine with the agents of a crowd in some order."""
    engine = Engine(
        crowd.character, len(order), SlopedTerrain.of(0.0), substeps=40, tick=5, lanes=lanes, threads=threads, **part
    )
    engine.set_q(crowd.q[order])
    engine.set_u(crowd.u[order])
    engine.set_origins(crowd.origins[order])
    for name, values in crowd.parameters.items():
        engine.set_parameter(name, values[order])
    for name, values in crowd.commands.items():
        engine.set_command(name, values[order])
    return engine


def advance(engine: Engine, frames: int) -> Outcome:
    chunk = ChunkArrays.allocate(frames, engine.agent_count, engine.character)
    engine.bind(chunk)
    for frame in range(frames):
        engine.advance(frame)
    recorded = {entry.name: getattr(chunk, entry.name).numpy() for entry in fields(chunk)}
    return Outcome(engine.full_state(), recorded)


def run(crowd: Crowd, order: np.ndarray, lanes: int = 8, threads: int = 1) -> Outcome:
    engine = prepare(crowd, order, lanes, threads)
    try:
        return advance(engine, crowd.frames)
    finally:
        engine.close()


def differing(found: Outcome, expected: Outcome, order: np.ndarray) -> list[int]:
    """Which agents, by their number in the crowd, are not the same to the last bit."""
    return [int(agent) for place, agent in enumerate(order) if found.agent(place) != expected.agent(int(agent))]


@pytest.fixture(scope="module", params=list(CROWDS))
def crowd(request: pytest.FixtureRequest) -> Crowd:
    return CROWDS[request.param]()


@pytest.fixture(scope="module")
def expected(crowd: Crowd) -> Outcome:
    """Everybody in order, eight lanes, one thread."""
    outcome = run(crowd, np.arange(AGENTS))
    assert np.all(np.isfinite(outcome.full["state"][:, : crowd.character.body.q_count]))
    # It would be no test if nothing happened or all did the same.
    assert np.max(np.abs(outcome.recorded["velocities"][-1] - outcome.recorded["velocities"][0])) > 0.1
    assert len({outcome.agent(i) for i in range(AGENTS)}) == AGENTS
    return outcome


def test_again(crowd: Crowd, expected: Outcome):
    order = np.arange(AGENTS)
    assert differing(run(crowd, order), expected, order) == []


@pytest.mark.parametrize("lanes", [1, 16])
def test_with_other_numbers_of_lanes(crowd: Crowd, expected: Outcome, lanes: int):
    order = np.arange(AGENTS)
    assert differing(run(crowd, order, lanes=lanes), expected, order) == []


@pytest.mark.parametrize("lanes", [1, 8])
def test_on_two_threads(crowd: Crowd, expected: Outcome, lanes: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("echelon.warp_kernels.frame.THREAD_WORK", 1)  # or there would be too little to do for two
    order = np.arange(AGENTS)
    engine = prepare(crowd, order, lanes, threads=2)
    assert engine.team.size == 2
    engine.close()
    assert differing(run(crowd, order, lanes=lanes, threads=2), expected, order) == []


def test_in_parts_of_a_crowd(crowd: Crowd, expected: Outcome):
    """As processes have them; each writes its own rows of what all see, and reads its own commands."""
    found = []
    for first, end in ((0, 5), (5, AGENTS)):
        order = np.arange(first, end)
        engine = prepare(crowd, order, first_agent=first, crowd_count=AGENTS)
        found.append(advance(engine, crowd.frames))
        others = np.delete(np.arange(AGENTS), order)
        for name, array in engine.public.items():
            assert not np.any(array.numpy()[others]), name
        assert differing(found[-1], expected, order) == []
    rows = np.concatenate([part.full["public.positions"] for part in found])
    np.testing.assert_array_equal(rows, expected.full["public.positions"])


def test_alone(crowd: Crowd, expected: Outcome):
    for agent in (0, 3, 7, 19):
        order = np.array([agent])
        assert differing(run(crowd, order), expected, order) == []


def test_in_another_lane_of_another_block(crowd: Crowd, expected: Outcome):
    for order in (np.arange(AGENTS)[::-1].copy(), np.random.default_rng(1).permutation(AGENTS)[:13]):
        assert differing(run(crowd, order), expected, order) == []


@pytest.mark.parametrize("lanes", [8, 16])
def test_beside_a_nan(crowd: Crowd, expected: Outcome, lanes: int):
    """Three are not numbers from the start, in full blocks and in the padded one; nobody else notices."""
    order = np.arange(AGENTS)
    lost = [2, 11, 18]
    engine = prepare(crowd, order, lanes)
    q = crowd.q.copy()
    q[lost, 1], q[lost[0]] = np.nan, np.inf
    engine.set_q(q)
    outcome = advance(engine, crowd.frames)
    assert differing(outcome, expected, order) == lost
    assert np.flatnonzero(engine.frozen).tolist() == lost
    assert np.flatnonzero(outcome.recorded["frozen"][-1]).tolist() == lost


def test_one_whose_state_overflows_is_frozen_where_it_last_was(crowd: Crowd, expected: Outcome):
    """After two good frames its speed goes out of bounds: it keeps the pose it had, and is flagged."""
    order = np.arange(AGENTS)
    lost, good = 5, 2
    engine = prepare(crowd, order)
    before = advance(engine, good)
    body = crowd.character.body
    q, frame = engine.q[lost], expected.recorded
    u = engine.u
    u[lost, body.u_count - 2] = 3e38
    engine.set_u(u)
    after = advance(engine, 3)
    assert np.flatnonzero(engine.frozen).tolist() == [lost]
    assert not before.recorded["frozen"].any()
    assert after.recorded["frozen"][:, lost].tolist() == [1, 1, 1]
    assert np.all(np.isfinite(after.recorded["poses"][:, lost]))
    # Its position has moved into the origin, as everybody's does at the start of a frame.
    origin = before.recorded["origins"][-1, lost] + before.recorded["poses"][-1, lost, 0, :3].astype(np.float64)
    np.testing.assert_array_equal(after.recorded["origins"][:, lost], np.tile(origin, (3, 1)))
    assert np.all(engine.q[lost, :3] == 0.0)
    np.testing.assert_array_equal(engine.q[lost, 3:], q[3:])
    for part in range(1, 3):
        np.testing.assert_array_equal(after.recorded["poses"][part, lost], after.recorded["poses"][0, lost])
    # The others have gone on as ever.
    others = np.delete(order, lost)
    last = min(good + 3, crowd.frames) - good
    np.testing.assert_array_equal(after.recorded["poses"][:last, others], frame["poses"][good : good + last, others])


def test_padding_lanes_are_harmless(crowd: Crowd, expected: Outcome):
    """The last block has four agents and four lanes of padding, here full of rubbish."""
    order = np.arange(AGENTS)
    engine = prepare(crowd, order)
    for rubbish in (np.nan, np.inf, 1e30):
        engine = prepare(crowd, order)
        for array in (engine.state, engine.parameters):
            host: np.ndarray = array.numpy()
            assert len(host) == 3
            host[2, :, 4:] = rubbish
            array.assign(host)
        outcome = advance(engine, crowd.frames)
        assert differing(outcome, expected, order) == []


def test_a_checkpoint_goes_on_with_the_same_bits(crowd: Crowd, expected: Outcome):
    """Another engine, other lanes, half way: the full state is all that the next frame depends on."""
    order = np.arange(AGENTS)
    half = crowd.frames // 2
    first = prepare(crowd, order)
    advance(first, half)
    kept = {name: array.copy() for name, array in first.full_state().items()}
    for lanes in (8, 16):
        second = Engine(crowd.character, AGENTS, SlopedTerrain.of(0.0), substeps=40, tick=5, lanes=lanes)
        second.load_full_state(kept)
        for name, array in second.full_state().items():
            assert array.tobytes() == kept[name].tobytes(), name
        rest = advance(second, crowd.frames - half)
        for name, array in rest.full.items():
            assert array.tobytes() == expected.full[name].tobytes(), name
        for name, array in rest.recorded.items():
            assert array.tobytes() == expected.recorded[name][half:].tobytes(), name
