"""What becomes of those who fall: they lie, stand up again, or are taken away; and nobody else is harmed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from echelon.agents.characters import character_named
from echelon.errors import InputError
from echelon.recording import Recording
from echelon.scenario import Scenario
from echelon.simulation import Simulation, resume
from echelon.terrain.course import Course
from echelon.warp_kernels.reference import Body
from tests.simulation.falls import both, frames_of, in_phase, push, recorded, same_files, struck
from tests.test_ranks import launch, needs_mpi

PITCH = 4  # of a root's speeds


def hoppers(*overrides: str) -> Scenario:
    return Scenario.load("herd", ["seconds=9", "crowd.count=4", "crowd.fallen_seconds=1.5", *overrides])


def lowest_sites(body: Body, poses: np.ndarray) -> np.ndarray:
    """The lowest point of any contact site with the ground [m], from link poses [frames, links, 7]."""
    lowest = np.full(len(poses), np.inf)
    for site in body.contacts:
        if site.surface != "ground":
            continue
        pose = poses[:, body.link_index(site.link)]
        turn = Rotation.from_quat(pose[:, 3:])
        reach = np.linalg.norm(np.array(site.radii) * turn.inv().apply([0.0, 0.0, 1.0]), axis=1)
        lowest = np.minimum(lowest, pose[:, 2] + turn.apply(site.position)[:, 2] - reach)
    return lowest


# ---- hoppers ---------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def stood_up(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Hopper 2 is thrown over, lies, gets up and hops on."""
    with pytest.MonkeyPatch.context() as patch:
        struck(patch, 60, push(2, PITCH, 9.0))
        return recorded(hoppers("crowd.fallen='stand'"), tmp_path_factory.mktemp("falls") / "stood")


def test_a_hopper_stands_up_and_hops_on(stood_up: Recording) -> None:
    (fell,), (stood,) = frames_of(stood_up, "fall", 2), frames_of(stood_up, "stand", 2)
    rising = in_phase(stood_up, "getting up", 2)
    assert rising[0] > fell + 45
    assert rising[-1] + 1 == stood
    np.testing.assert_array_equal(np.diff(rising), 1)
    assert 1.5 <= len(rising) / 30.0 <= 2.0
    assert stood_up.fallen[fell:stood, 2].all()
    assert not stood_up.fallen[stood:, 2].any()
    assert len([f for f in frames_of(stood_up, "touchdown", 2) if f > stood]) > 3
    assert stood_up.summary["stood_up"] == 1
    assert stood_up.summary["falls"] == 1


def test_it_gets_up_where_it_lies_smoothly_and_above_the_ground(stood_up: Recording) -> None:
    poses = stood_up.link_poses[:, 2]
    rising = in_phase(stood_up, "getting up", 2)
    # From the last frame in which it lay to the last before it leaves the ground.
    path = poses[rising[0] - 1 : rising[-1] + 1]
    speeds = np.linalg.norm(np.diff(path[..., :3], axis=0), axis=-1) * 30.0
    assert speeds[0].max() < 0.2  # it begins from rest
    assert speeds.max() < 3.0
    assert np.abs(np.diff(speeds, axis=0)).max() < 0.5  # and nothing jerks
    away = (poses[rising[-1] + 1, 0, :3] - path[-1, 0, :3]) * 30.0
    assert np.linalg.norm(away) == pytest.approx(speeds[-1, 0], abs=0.25)  # the first hop goes on from there
    body = character_named("hopper").body
    assert lowest_sites(body, path).min() > -0.012
    assert np.linalg.norm(path[-1, 0, :2] - path[0, 0, :2]) < 0.05
    # Upright, facing as it did: by the shortest turn.
    before, after = (Rotation.from_quat(path[i, 0, 3:]) for i in (0, -1))
    assert after.apply([0.0, 0.0, 1.0])[2] > 0.99
    tilt = np.arccos(before.apply([0.0, 0.0, 1.0])[2])
    assert (before.inv() * after).magnitude() == pytest.approx(tilt, abs=0.03)
    recorded_speed = stood_up.velocities[rising[0] + 1 : rising[-1], 2]
    np.testing.assert_allclose(recorded_speed, np.gradient(path[1:, 0, :3], 1 / 30, axis=0)[1:-1], atol=0.12)


def test_a_run_with_somebody_getting_up_goes_on_to_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    struck(monkeypatch, 20, both(push(2, PITCH, 9.0), push(1, PITCH, -9.0)))
    plan = hoppers("crowd.fallen='stand'", "seconds=42", "crowd.fallen_seconds=12.5")
    whole = recorded(plan, tmp_path / "whole")
    assert whole.summary["stood_up"] == 2
    assert whole.frame_count > 2 * whole.chunk_frames
    assert whole.chunk_frames in in_phase(whole, "getting up", 2)  # the state that is gone on from holds it half way

    def stop(done: int, total: int) -> None:
        if done == total - 20:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        recorded(plan, tmp_path / "part", progress=stop)
    assert Recording(tmp_path / "part").frame_count == 2 * whole.chunk_frames
    assert resume(tmp_path / "part").summary == whole.summary
    assert same_files(tmp_path / "whole", tmp_path / "part")


@pytest.mark.parametrize("mode", ["stand", "remove"])
def test_what_becomes_of_the_fallen_does_not_depend_on_lanes(
    mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    struck(monkeypatch, 20, both(push(2, PITCH, 9.0), push(1, PITCH, -9.0)))
    found = set()
    for lanes in (1, 4, 16):
        plan = hoppers(f"crowd.fallen={mode!r}", f"engine.lanes={lanes}", "seconds=6", "crowd.fallen_seconds=1")
        summary = recorded(plan, tmp_path / "run").summary
        assert summary["stood_up" if mode == "stand" else "removed"] == 2
        found.add(summary["state_hash"])
    assert len(found) == 1


@needs_mpi
@pytest.mark.parametrize("mode", ["stand", "remove"])
def test_nor_on_ranks(mode: str, tmp_path: Path) -> None:
    """Two who trip, being asked for 6 m/s at once, on a rank each."""
    settings = ["crowd.count=2", "crowd.start_spacing=2", "population_seed=12", "seconds=7", f"crowd.fallen={mode}"]
    settings += ["herd.desired_velocity=[6, 0]", "herd.max_speed=6", "crowd.fallen_seconds=1"]
    alone = recorded(Scenario.load("straight", settings), tmp_path / "alone").summary
    assert alone["falls"] == alone["stood_up" if mode == "stand" else "removed"] == 2
    arguments = [f"--set={setting}" for setting in settings]
    done = launch(2, "simulate", "straight", *arguments, "--json", "--recording", str(tmp_path / "ranks"))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["state_hash"] == alone["state_hash"]


def test_nobody_stands_up_where_somebody_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hopper 1 is kept beside the fallen hopper 0 for six seconds, and then taken far away."""
    advance = Simulation.advance

    def beside(self: Simulation, *arguments: object) -> None:
        if self.frame == 20:
            push(0, PITCH, 16.0)(self)
        if self.frame > 20:
            places = self.engine.positions.numpy().astype(float)
            q, u = self.engine.q, self.engine.u
            q[1, :3] = (0.0, 0.0, 0.8)
            q[1, 3:], u[1] = self.character.body.q_reference[3:], 0.0
            self.engine.set_q(q)
            self.engine.set_u(u)
            away = (0.8, 0.0) if self.frame < 200 else (12.0, 0.0)
            origins = self.engine.origins.numpy().copy()[:2]
            origins[1] = (places[0, 0] + away[0], places[0, 1] + away[1], 0.0)
            self.engine.set_origins(origins)
        advance(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Simulation, "advance", beside)
    plan = Scenario.load("straight", ["seconds=9", "crowd.count=2", "crowd.fallen='stand'", "crowd.fallen_seconds=1"])
    rising = in_phase(recorded(plan, tmp_path / "beside"), "getting up", 0)
    assert 200 < rising[0] <= 211


# ---- taken away ------------------------------------------------------------------------------------------------------
def test_who_is_taken_away_is_no_longer_there_for_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    struck(monkeypatch, 20, push(2, PITCH, 9.0))
    seen: list[np.ndarray] = []
    advance = Simulation.advance

    def looking(self: Simulation, *arguments: object) -> None:
        advance(self, *arguments)  # type: ignore[arg-type]
        seen.append(self.engine.positions.numpy().copy())

    monkeypatch.setattr(Simulation, "advance", looking)
    recording = recorded(hoppers("crowd.fallen='remove'", "seconds=6", "crowd.count=8"), tmp_path / "removed")
    (fell,), (gone,) = frames_of(recording, "fall", 2), frames_of(recording, "remove", 2)
    assert fell + 45 <= gone <= fell + 47
    assert recording.summary["removed"] == 1
    removed = recording.removed[:]
    assert not removed[:gone].any()
    np.testing.assert_array_equal(removed[gone:], np.tile(np.arange(8) == 2, (len(removed) - gone, 1)))
    assert recording.removed.dtype == bool
    positions = np.array(seen)
    assert np.isfinite(positions[:gone]).all()
    assert np.isinf(positions[gone:, 2]).all()
    assert np.isfinite(np.delete(positions[gone:], 2, axis=1)).all()
    # What is recorded of it stays where it lay.
    assert np.isfinite(recording.link_poses[:]).all()
    np.testing.assert_array_equal(
        recording.link_poses[gone:, 2], recording.link_poses[[gone] * len(positions[gone:]), 2]
    )
    assert not recording.velocities[gone:, 2].any()
    # The others close up over the place: somebody comes nearer to it than they would to a body.
    assert recording.summary["falls"] == 1


def test_a_lost_one_never_stands_up_but_may_be_taken_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    struck(monkeypatch, 20, push(2, PITCH, np.nan))
    for mode, phase in (("stand", "getting up"), ("remove", "removed")):
        recording = recorded(hoppers(f"crowd.fallen={mode!r}", "seconds=4", "crowd.fallen_seconds=1"), tmp_path / mode)
        assert recording.summary["nonfinite"] == 1
        assert len(in_phase(recording, phase, 2)) == (0 if mode == "stand" else recording.frame_count - 51)
        assert np.isfinite(recording.velocities[:]).all()


# ---- riders ----------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def rode_on(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Two of four riders on a climb are thrown over, one to each side."""
    plan = Scenario.load(
        "hill",
        [
            *("seconds=11", "crowd.count=4", "peloton.start_distance=4720", "peloton.start_speed=7"),
            *("crowd.fallen='stand'", "crowd.fallen_seconds=2"),
        ],
    )
    with pytest.MonkeyPatch.context() as patch:
        struck(patch, 20, both(push(1, 3, 3.5), push(2, 3, -4.0)))
        return recorded(plan, tmp_path_factory.mktemp("rides") / "rode")


@pytest.mark.parametrize("rider", [1, 2])
def test_a_rider_stands_up_and_rides_on(rode_on: Recording, rider: int) -> None:
    (fell,), (stood,) = frames_of(rode_on, "fall", rider), frames_of(rode_on, "stand", rider)
    rising = in_phase(rode_on, "getting up", rider)
    assert rising[0] >= fell + 60
    assert rising[-1] + 1 == stood
    assert 1.5 <= len(rising) / 30.0 <= 2.1
    assert not rode_on.fallen[stood:, rider].any()
    assert rode_on.frame_count - stood > 60
    path = rode_on.link_poses[rising[0] - 1 : stood + 2, rider]
    speeds = np.linalg.norm(np.diff(path[..., :3], axis=0), axis=-1) * 30.0
    assert speeds[0].max() < 0.6
    assert speeds.max() < 8.0
    speed = np.linalg.norm(rode_on.velocities[stood:, rider], axis=1)
    assert speed.min() > 1.0  # up a hill
    # On the slope as it is, no lower than what lies or rolls on it.
    surfaces = Course.from_dict(rode_on.world["course"]).surfaces
    flat = path.copy()
    flat[..., 2] -= surfaces.height(path[:, 0, :2])[:, None]
    assert abs(surfaces.height(path[-1:, 0, :2] + [[1.0, 0.0]])[0] - surfaces.height(path[-1:, 0, :2])[0]) > 0.02
    assert flat[:, 0, 2].min() > -0.02


# ---- settings --------------------------------------------------------------------------------------------------------
def test_the_run_is_the_same_as_ever_where_nothing_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    struck(monkeypatch, 20, push(2, PITCH, 9.0))
    recording = recorded(hoppers("seconds=4"), tmp_path / "lie")
    assert recording.scenario["crowd"]["fallen"] == "lie"
    assert recording.phase_names == character_named("hopper").phase_names
    assert not {"stood_up", "removed"} & set(recording.summary)
    assert recording.fallen[-1, 2]
    assert not recording.removed[:].any()
    assert not any(name.startswith("fallen.") for name in recording.state(0))


def test_who_cannot_get_up_is_said_in_one_line(tmp_path: Path) -> None:
    plan = Scenario.load("steady", ["crowd.character=point-mass", "crowd.fallen='stand'"])
    with pytest.raises(InputError, match=r"crowd\.fallen = 'stand': a point-mass cannot get up"):
        recorded(plan, tmp_path / "points")


def test_a_wrong_way_to_treat_them_is_refused() -> None:
    with pytest.raises(InputError, match=r"crowd\.fallen"):
        Scenario.load("herd", ["crowd.fallen=fly"])
