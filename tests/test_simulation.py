"""The frame loop and what comes of it: herds that settle, robots that are penned, runs that repeat to the bit."""

from __future__ import annotations

import filecmp
from pathlib import Path

import numpy as np
import pytest

import echelon
from echelon.recording import EVENT_NAMES, Recording
from echelon.scenario import Scenario
from echelon.simulation import Simulation, colors, resume, simulate


def run(scenario: Scenario, folder: Path, **options: object) -> Recording:
    return simulate(scenario, recording=folder / f"{scenario.name}.recording", **options)  # type: ignore[arg-type]


def events(recording: Recording, name: str) -> np.ndarray:
    return recording.events[recording.events["kind"] == EVENT_NAMES.index(name)]


# ---- the herd ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("count", [16, 105])
def test_an_undisturbed_herd_settles_in_a_circle_without_fall_or_collision(count: int, tmp_path: Path) -> None:
    plan = Scenario.load("herd", [f"crowd.count={count}", "seconds=60", "herd.wander=false"])
    recording = run(plan, tmp_path)
    assert recording.summary["falls"] == 0
    assert recording.summary["collisions"] == 0
    places = recording.link_poses[-1, :, 0, :2]
    spread = np.linalg.eigvalsh(np.cov(places.T))
    assert np.sqrt(spread[1] / spread[0]) <= 1.35
    gaps = np.linalg.norm(places[:, None] - places[None], axis=-1)
    np.fill_diagonal(gaps, np.inf)
    nearest = gaps.min(axis=1)
    assert nearest.std() / nearest.mean() <= 0.15


@pytest.mark.parametrize("population", [1, 2, 3, 4])
def test_started_in_phase_they_hop_out_of_phase_after_ten_seconds(population: int, tmp_path: Path) -> None:
    plan = Scenario.load("herd", ["crowd.in_phase=true", "seconds=14", f"population_seed={population}"])
    recording = run(plan, tmp_path)
    touchdowns = events(recording, "touchdown")
    time = touchdowns["frame"] / 30.0 + touchdowns["substep"] / (30.0 * plan.engine.stride(30, 720, 6)[0])

    def phases(at: float) -> np.ndarray:
        found = []
        for agent in range(16):
            mine = time[touchdowns["agent"] == agent]
            last, following = mine[mine <= at].max(), mine[mine > at].min()
            found.append(2.0 * np.pi * (at - last) / (following - last))
        return np.array(found)

    def variance(angles: np.ndarray) -> float:
        return 1.0 - abs(np.exp(1j * angles).mean())

    assert variance(phases(1.0)) < 0.2  # they did start together
    assert variance(phases(11.0)) >= 0.5


def test_random_velocity_changes_fell_nobody(tmp_path: Path) -> None:
    plan = Scenario.load("velocity-changes", ["seconds=60"])
    assert plan.crowd.count == 105
    assert plan.herd.change == 1.0
    assert plan.herd.period == 2.0
    recording = run(plan, tmp_path)
    assert recording.summary["falls"] == 0
    assert recording.summary["nonfinite"] == 0
    speeds = np.linalg.norm(recording.velocities[600:, :, :2], axis=-1)
    assert speeds.mean() > 0.5  # they were on their way


# ---- the corral ----------------------------------------------------------------------------------------------------
def test_the_dog_pens_the_herd_for_at_least_eight_of_ten_seeds(tmp_path: Path) -> None:
    penned = 0
    for seed in range(10):
        recording = run(Scenario.load("border-collie", [f"seed={seed}", f"population_seed={seed}"]), tmp_path)
        summary = recording.summary
        assert summary["falls"] == 0
        assert summary["seconds"] <= 180.0
        if summary["penned"]:
            penned += 1
            last = recording.in_corral[-300:]
            assert last.min() >= 12  # for ten seconds on end
            _check_inside(recording, int(last[-1]))
    assert penned >= 8


def _check_inside(recording: Recording, counted: int) -> None:
    corral = recording.world["corral"]
    places = recording.link_poses[-1, :, 0, :2] - np.array(corral["center"])
    assert (np.abs(places).max(axis=1) < corral["size"] / 2).sum() == counted


def test_robots_stay_inside_the_fences(tmp_path: Path) -> None:
    plan = Scenario.load("border-collie", ["seed=5"])
    recording = run(plan, tmp_path)
    places = recording.link_poses[:, :, 0, :2]
    assert plan.world.room(places).min() > 0.2
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1)
    assert steps.max() < 4.0 / 30.0  # nobody jumps


# ---- runs that repeat ----------------------------------------------------------------------------------------------
def short(**changes: object) -> Scenario:
    return Scenario.load("border-collie", ["seconds=4", *(f"{k.replace('__', '.')}={v}" for k, v in changes.items())])


def test_the_same_scenario_gives_the_same_bits_on_any_number_of_threads_and_lanes(tmp_path: Path) -> None:
    hashes = {run(short(), tmp_path).summary["state_hash"] for _ in range(2)}
    hashes.add(run(short(), tmp_path, threads=2).summary["state_hash"])
    for lanes in (1, 8, 16):
        hashes.add(run(short(engine__lanes=lanes), tmp_path).summary["state_hash"])
    assert len(hashes) == 1
    assert run(short(seed=2), tmp_path).summary["state_hash"] not in hashes


class Interrupted(Exception):
    """Stands for whatever ends a process."""


def same_files(a: Path, b: Path) -> bool:
    listing = sorted(p.relative_to(a) for p in a.rglob("*") if p.is_file())
    if listing != sorted(p.relative_to(b) for p in b.rglob("*") if p.is_file()):
        return False
    return all(filecmp.cmp(a / name, b / name, shallow=False) for name in listing)


LONG = Scenario.load("border-collie", ["seconds=44", "until=''"])


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """The recording of a run that nothing interrupts."""
    return simulate(LONG, recording=tmp_path_factory.mktemp("whole") / "whole.recording")


@pytest.mark.parametrize("at", [100, 700, 1290])
def test_an_interrupted_run_goes_on_to_the_same_bytes(at: int, whole: Recording, tmp_path: Path) -> None:

    def stop(done: int, total: int) -> None:
        if done == at:
            raise Interrupted

    with pytest.raises(Interrupted):
        simulate(LONG, recording=tmp_path / "part.recording", progress=stop)
    part = Recording(tmp_path / "part.recording")
    assert part.status == "running"
    assert part.frame_count <= at
    again = resume(tmp_path / "part.recording", threads=2)
    assert again.summary == whole.summary
    assert same_files(whole.path, tmp_path / "part.recording")


def test_one_that_diverges_is_frozen_and_harms_nobody(tmp_path: Path) -> None:
    plan = Scenario.load("straight", ["seconds=4", "crowd.count=9"])
    simulation = Simulation(plan, threads=1)
    clean = Simulation(plan, threads=1)
    from echelon.simulation.scene import SceneFrames
    from echelon.warp_kernels.frame import ChunkArrays

    found = []
    for sim, poisoned in ((simulation, True), (clean, False)):
        chunk = ChunkArrays.allocate(60, 9, sim.character)
        sim.engine.bind(chunk)
        seen = SceneFrames.allocate(60, sim.scene, 9)
        for frame in range(60):
            if poisoned and frame == 20:
                u = sim.engine.u
                u[4, 2] = np.nan
                sim.engine.set_u(u)
            sim.advance(frame, seen)
        found.append(chunk)
    frozen = found[0].frozen.numpy().astype(bool)
    assert frozen[20:, 4].all()
    assert not frozen[:, [0, 1, 2, 3, 5, 6, 7, 8]].any()
    assert np.isfinite(found[0].poses.numpy()).all()
    others = [0, 1, 2, 3, 5, 6, 7, 8]
    np.testing.assert_array_equal(found[0].poses.numpy()[:, others], found[1].poses.numpy()[:, others])
    np.testing.assert_array_equal(found[0].poses.numpy()[20:, 4], found[0].poses.numpy()[[20] * 40, 4])


# ---- the public face -----------------------------------------------------------------------------------------------
def test_simulate_from_python_gives_a_recording(tmp_path: Path) -> None:
    calls: list[tuple[int, int]] = []
    result = echelon.simulate(
        "border-collie",
        agents=7,
        seconds=2,
        seed=3,
        settings={"herd.spacing": 3.0},
        progress=lambda done, total: calls.append((done, total)),
    )
    assert calls[-1] == (61, 61)
    assert result.frame_count == 61
    assert result.link_poses.shape == (61, 7, 3, 7)
    assert result.scenario["herd"]["spacing"] == 3.0
    np.testing.assert_allclose(result.times, np.arange(61) / 30.0)
    assert result.casts[0].body.link_names == ("body", "upper_leg", "lower_leg")
    stage = result.export(tmp_path / "herd.usda")
    assert stage.exists()


def test_a_temporary_recording_goes_with_its_result() -> None:
    result = echelon.simulate("straight", agents=1, seconds=0.2)
    folder = result.path
    assert folder.exists()
    del result
    assert not folder.exists()


def test_preroll_moves_the_start() -> None:
    late = echelon.simulate("straight", agents=3, seconds=1, settings={"shot.preroll": 2.0})
    early = echelon.simulate("straight", agents=3, seconds=3)
    np.testing.assert_allclose(late.link_poses[0], early.link_poses[59], atol=1e-6)


def test_events_come_in_order_and_make_sense(tmp_path: Path) -> None:
    recording = run(Scenario.load("straight", ["seconds=6", "crowd.count=4"]), tmp_path)
    table = recording.events
    keys = list(zip(table["frame"], table["substep"], table["agent"], table["kind"], strict=True))
    assert keys == sorted(keys)
    for agent in range(4):
        mine = table[table["agent"] == agent]
        names = [EVENT_NAMES[k] for k in mine["kind"]]
        assert names == (["touchdown", "liftoff"] * len(names))[: len(names)]
        assert len(names) > 15


def test_everybody_has_a_colour_of_their_own() -> None:
    found = colors(105)
    assert found.shape == (105, 3)
    assert found.min() >= 0.0
    assert found.max() <= 1.0
    assert len(np.unique(found.round(3), axis=0)) == 105


def test_recording_folder_is_replaced(tmp_path: Path) -> None:
    first = run(short(), tmp_path)
    second = run(short(seconds=2), tmp_path)
    assert first.path == second.path
    assert Recording(second.path).frame_count == 61
