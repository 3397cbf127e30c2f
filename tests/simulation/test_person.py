"""A person on the user's bicycle: what pedals, brake, handlebars and gears do, and that a take comes out again."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.flocking.person import CONTROLS, DEVELOPMENTS, cadence_of, hands_off, power_of
from echelon.recording import Recording, RecordingWriter, branch
from echelon.scenario import Scenario
from echelon.simulation import Simulation, resume, simulate
from echelon.simulation.recorded import RecordedRun, recording_of

HERD = ["collie.driver='person'", "crowd.count=4", "seconds=60"]
RACE = ["user.by='person'", "crowd.count=2", "seconds=60"]


def herd(*more: str) -> Scenario:
    return Scenario.load("border-collie", [*HERD, *more])


def doing(**what: float) -> np.ndarray:
    """Controls of a person who does this."""
    controls = hands_off()
    for name, value in what.items():
        controls[CONTROLS.index(name)] = value
    return controls


def ridden(scenario: Scenario, folder: Path, controls: np.ndarray) -> Recording:
    """What comes of controls, shape [frames, controls]."""
    return simulate(scenario, recording=folder, controls=controls)


def places(recording: Recording) -> np.ndarray:
    return recording.actor_poses[:, 0, :3]


def speeds(recording: Recording) -> np.ndarray:
    return np.linalg.norm(np.diff(places(recording), axis=0), axis=1) * recording.frame_rate


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# ---- the bicycle -----------------------------------------------------------------------------------------------------
def test_nobody_moves_who_does_nothing(tmp_path: Path) -> None:
    run = ridden(herd(), tmp_path / "a", np.tile(hands_off(), (31, 1)))
    np.testing.assert_array_equal(places(run), np.broadcast_to(places(run)[0], places(run).shape))


def test_pedalling_speeds_up_coasting_slows_and_the_brake_stops(tmp_path: Path) -> None:
    rows = [doing(effort=1.0)] * 120 + [hands_off()] * 60 + [doing(brake=1.0)] * 90
    speed = speeds(ridden(herd(), tmp_path / "a", np.array(rows)))
    assert np.all(np.diff(speed[1:118]) > -1e-3)
    assert 3.5 < speed[118] < 6.0
    assert np.all(np.diff(speed[122:178]) < 0.0)
    assert speed[178] > 0.8 * speed[118]
    assert speed[-1] < 1e-3


def test_it_turns_left_and_right_and_leaning_does_too(tmp_path: Path) -> None:
    for name, sign in (("left", 1.0), ("right", -1.0)):
        for leaning in (0.0, 1.0):
            asked = doing(effort=0.6, steering=sign * math.radians(12.0), leaning=leaning)
            path = places(ridden(herd(), tmp_path / f"{name}{leaning}", np.tile(asked, (150, 1))))
            steps = np.diff(path[30:, :2], axis=0)
            turned = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
            assert sign * (turned[-1] - turned[0]) > 0.4


def test_steering_is_limited_to_the_bicycles(tmp_path: Path) -> None:
    hard, harder = (
        places(ridden(herd(), tmp_path / str(angle), np.tile(doing(effort=0.3, steering=angle), (90, 1))))
        for angle in (math.radians(20.2), 3.0)
    )
    np.testing.assert_allclose(hard, harder, atol=1e-4)


def test_a_high_gear_goes_on_where_a_low_one_spins(tmp_path: Path) -> None:
    scenario = Scenario.load("olympic-race", RACE)
    low, high = (
        speeds(ridden(scenario, tmp_path / str(gear), np.tile(doing(effort=1.0, gear=gear), (240, 1))))
        for gear in (1.0, 6.0)
    )
    assert low.max() < 2.0 * 1.5 * DEVELOPMENTS[0]
    assert high[-1] > low[-1] + 2.0


def test_a_low_gear_starts_faster(tmp_path: Path) -> None:
    low, high = (
        speeds(ridden(herd(), tmp_path / str(gear), np.tile(doing(effort=1.0, gear=gear), (45, 1))))[-1]
        for gear in (1.0, 9.0)
    )
    assert low > 1.5 * high


def test_measured_power_goes_into_speed_height_air_and_rolling(tmp_path: Path) -> None:
    scenario = Scenario.load("olympic-race", RACE)
    run = ridden(scenario, tmp_path / "a", np.tile(doing(power=300.0), (300, 1)))
    user = scenario.user
    assert user is not None
    speed, heights = speeds(run), places(run)[:, 2]
    between = slice(1, -1)  # of speeds; each is that between two frames
    kinetic = 0.5 * user.mass * (speed[-1] ** 2 - speed[0] ** 2)
    potential = user.mass * 9.80665 * (heights[-2] - heights[1])
    lost = np.sum(speed[between] * (0.6 * user.drag_area * speed[between] ** 2 + user.mass * 9.80665 * 0.005)) / 30.0
    assert kinetic + potential + lost == pytest.approx(300.0 * (len(speed) - 1) / 30.0, rel=0.02)


def test_cadence_and_power_are_those_of_the_gear() -> None:
    assert cadence_of(6.3, 1) == pytest.approx(3.0)
    best = 1.5 * DEVELOPMENTS[4]
    controls = doing(effort=0.5, gear=5.0)
    assert power_of(controls, best, 400.0) == pytest.approx(200.0)
    assert power_of(controls, 2.0 * best, 400.0) == pytest.approx(0.0, abs=1e-6)
    assert power_of(doing(power=250.0), 3.0, 400.0) == 250.0


def test_the_herd_flees_from_a_person(tmp_path: Path) -> None:
    scenario = Scenario.load("border-collie", ["collie.driver='person'", "crowd.count=8", "collie.heading=1.9"])
    run = ridden(scenario, tmp_path / "a", np.tile(doing(effort=0.7), (300, 1)))
    away = run.link_poses[:, :, 0, :2].mean(axis=1) - places(run)[:, :2]
    distance = np.linalg.norm(away, axis=1)
    wanted = np.sum(run.desired_velocities[:].mean(axis=1) * away, axis=1) / distance
    assert np.all(wanted[distance < scenario.herd.flee_distance - 1.0] > 0.0)
    assert wanted[distance < 0.6 * scenario.herd.flee_distance].min() > 0.5


# ---- takes -----------------------------------------------------------------------------------------------------------
def wandering(frames: int) -> np.ndarray:
    """Controls that change all the time."""
    time = np.arange(frames) / 30.0
    return np.array(
        [doing(effort=0.5 + 0.5 * math.sin(t), steering=0.3 * math.sin(0.7 * t), gear=1.0 + int(t) % 6) for t in time],
        dtype=np.float32,
    )


def test_a_take_comes_out_again_without_the_person(tmp_path: Path) -> None:
    scenario = herd()
    simulation = Simulation(scenario)
    with recording_of(simulation, tmp_path / "take") as writer:
        run = RecordedRun(simulation, writer)
        for controls in wandering(700):
            run.advance(controls)
        run.finish()
    simulation.close()
    take = Recording(tmp_path / "take")
    assert (take.frame_count, take.control_names) == (700, CONTROLS)
    simulate(Scenario.from_dict(take.scenario, source="take"), recording=tmp_path / "again", controls=take.controls[:])
    assert files(tmp_path / "take") == files(tmp_path / "again")


@pytest.mark.parametrize("frame", [0, 250, 600, 605, 700])
def test_a_take_is_gone_on_with_from_any_frame(tmp_path: Path, frame: int) -> None:
    controls = wandering(700)
    first = ridden(herd(), tmp_path / "first", controls)
    other = np.concatenate([controls[:frame], np.tile(doing(effort=1.0, steering=-0.2), (60, 1))])
    expected = ridden(herd(), tmp_path / "expected", other)

    branch(first, tmp_path / "second", frame)
    simulation = Simulation(herd())
    writer, state = RecordingWriter.reopen(tmp_path / "second")
    with writer:
        if state is not None:
            simulation.load_state(state, writer.next_frame)
        run = RecordedRun(simulation, writer)
        while simulation.frame < len(other):
            run.advance(other[simulation.frame])
        run.finish()
    simulation.close()
    assert expected.frame_count == frame + 60
    assert files(tmp_path / "second") == files(tmp_path / "expected")
    assert Recording(tmp_path / "first").frame_count == 700


def test_an_interrupted_take_ends_where_it_was(tmp_path: Path) -> None:
    scenario = herd("seconds=100")
    simulation = Simulation(scenario)
    with recording_of(simulation, tmp_path / "take") as writer:
        run = RecordedRun(simulation, writer)
        for controls in wandering(writer.chunk_frames + 40):
            run.advance(controls)
    simulation.close()
    kept = Recording(tmp_path / "take")
    assert kept.status == "running"
    ended = resume(tmp_path / "take")
    assert (ended.status, ended.frame_count) == ("done", kept.chunk_frames)
    assert ended.summary["frames"] == kept.chunk_frames


def test_who_is_to_ride_has_to(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is for a person to ride in; start it with echelon play"):
        simulate(herd(), recording=tmp_path / "a")
    assert not (tmp_path / "a").exists()


def test_branches_are_refused_where_they_cannot_be(tmp_path: Path) -> None:
    take = ridden(herd(), tmp_path / "a", wandering(20))
    with pytest.raises(InputError, match="frame 21: must be from 0 to 20"):
        branch(take, tmp_path / "b", 21)
    with pytest.raises(InputError, match="is what is to be gone on from"):
        branch(take, tmp_path / "a", 10)
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "letter").write_text("mine")
    with pytest.raises(InputError, match="is not a recording"):
        branch(take, tmp_path / "c", 10)
