"""A world that is simulated while people watch, without the page: commands in, pictures and takes out."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.flocking.person import CONTROLS, DEVELOPMENTS, FIRST_GEAR
from echelon.play.controls import Controls
from echelon.play.live import Live
from echelon.play.replayed import Replayed
from echelon.play.takes import Take, free_folder, ridable
from echelon.play.web.messages import Gear, LetGo, Pause, Play, Rate, Restart, Ride, Save, Seek, Slow
from echelon.recording import Recording
from echelon.scenario import Scenario
from echelon.simulation import simulate

PEDAL = Ride(1.0, 0.0, 0.0, False)


def scene(*more: str) -> Scenario:
    return ridable(Scenario.load("border-collie", ["crowd.count=3", *more]))


def live(folder: Path, *more: str) -> Live:
    return Live(Take, scene(*more), folder)


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# ---- controls --------------------------------------------------------------------------------------------------------
def row(controls: Controls, power: float | None = None) -> dict[str, float]:
    return dict(zip(CONTROLS, controls.row(power).tolist(), strict=True))


def test_hands_and_feet_become_controls() -> None:
    controls = Controls()
    controls.hear(Ride(0.5, 0.25, -1.0, True))
    found = row(controls)
    assert (found["effort"], found["brake"], found["leaning"], found["gear"]) == (0.5, 0.25, 1.0, FIRST_GEAR)
    assert found["steering"] == pytest.approx(-math.radians(20.0))
    controls.hear(LetGo())
    assert row(controls) | {"leaning": 0.0, "gear": 0.0} == dict.fromkeys(CONTROLS, 0.0)


def test_gears_end() -> None:
    controls = Controls()
    for step, last in ((1, len(DEVELOPMENTS)), (-1, 1)):
        for _ in range(20):
            controls.hear(Gear(step))
        assert controls.gear == last


def test_a_trainer_pedals_instead_of_keys() -> None:
    controls = Controls()
    controls.hear(PEDAL)
    assert (row(controls, 210.0)["effort"], row(controls, 210.0)["power"]) == (0.0, 210.0)


# ---- live ------------------------------------------------------------------------------------------------------------
def test_it_waits_for_its_rider_then_goes_on_frame_by_frame(tmp_path: Path) -> None:
    world = live(tmp_path)
    for _ in range(5):
        world.picture()
    assert (world.state()["frame"], world.state()["paused"], world.standing_still) == (0, True, True)
    world.hear(PEDAL)
    for _ in range(45):
        world.picture()
    state = world.state()
    assert (state["frame"], state["paused"]) == (45, False)
    assert state["rider"]["speed"] > 1.0
    assert state["rider"]["power"] > 50.0
    assert state["herd"] == {"in_corral": 0, "agents": 3, "fallen": 0}
    world.close()
    (take,) = world.kept
    assert take == (tmp_path / "border-collie-take-1.recording", 1.5)
    assert Recording(take[0]).status == "done"


def test_the_rider_sees_the_herd_ahead() -> None:
    scenario = scene()
    assert scenario.collie is not None
    to = scenario.start_positions().mean(axis=0) - scenario.collie.start
    heading = scenario.collie.heading
    assert np.dot(to, [math.cos(heading), math.sin(heading)]) == pytest.approx(np.linalg.norm(to))


def test_a_take_simulated_again_is_the_same_bytes(tmp_path: Path) -> None:
    world = live(tmp_path)
    commands = {0: PEDAL, 20: Ride(0.7, 0.0, 0.6, False), 35: Gear(1), 60: Ride(0.0, 1.0, 0.0, True), 80: LetGo()}
    for picture in range(120):
        if picture in commands:
            world.hear(commands[picture])
        world.picture()
    world.close()
    take = Recording(world.kept[0][0])
    plan = Scenario.from_dict(take.scenario, source="take")
    simulate(plan, recording=tmp_path / "again", controls=take.controls[:])
    assert files(take.path) == files(tmp_path / "again")


def test_pause_and_slow_motion(tmp_path: Path) -> None:
    world = live(tmp_path)
    world.hear(PEDAL)
    for _ in range(10):
        world.picture()
    world.hear(Pause(True))
    still = [world.picture() for _ in range(5)]
    assert world.state()["frame"] == 10
    np.testing.assert_array_equal(still[0].links, still[-1].links)
    world.hear(Pause(False))
    world.hear(Slow(0.25))
    steps = np.array([world.picture().rider for _ in range(40)])
    assert world.state()["frame"] == 20
    moved = np.linalg.norm(np.diff(steps[8:, :3], axis=0), axis=1)
    assert moved.min() > 0.0
    assert moved.max() < 2.0 * moved.min()
    world.close()


def test_a_restart_begins_another_take_with_another_crowd(tmp_path: Path) -> None:
    world = live(tmp_path)
    world.hear(PEDAL)
    for _ in range(40):
        world.picture()
    assert world.hear(Restart(seed=9, agents=5))
    assert (world.welcome["seed"], world.welcome["agents"]) == (9, 5)
    assert world.picture().links.shape[0] == 5
    assert [path.name for path, _ in world.kept] == ["border-collie-take-1.recording"]
    assert world.take.folder.name == "border-collie-take-2.recording"
    assert not world.hear(Restart(seed=None, agents=100_000)), "they do not fit into the field"
    assert "crowd" in world.state()["note"]
    assert world.take.scenario.crowd.count == 5
    world.close()


def test_a_take_that_was_given_up_at_once_is_not_kept(tmp_path: Path) -> None:
    world = live(tmp_path)
    world.hear(PEDAL)
    for _ in range(5):
        world.picture()
    world.close()
    assert world.kept == []
    assert list(tmp_path.iterdir()) == []


def test_the_end_of_a_run_ends_the_take_and_stands_still(tmp_path: Path) -> None:
    world = Live(Take, replace(scene(), seconds=1.5), tmp_path)
    world.hear(PEDAL)
    for _ in range(60):
        world.picture()
    last, state = world.picture(), world.state()
    assert (state["ended"], state["frame"]) == (True, 45)
    np.testing.assert_array_equal(last.links, world.picture().links)
    world.hear(Save())
    assert "border-collie-take-1.recording" in world.state()["note"]
    world.close()


def test_takes_never_replace_one_another(tmp_path: Path) -> None:
    (tmp_path / "herd-take-1.recording").mkdir()
    assert free_folder("herd", tmp_path).name == "herd-take-2.recording"


def test_somebody_else_goes_on_with_a_take(tmp_path: Path) -> None:
    first = live(tmp_path)
    first.hear(Ride(1.0, 0.0, 0.3, False))
    for _ in range(90):
        first.picture()
    first.close()
    take = Recording(first.kept[0][0])

    second = Live(lambda plan, folder: Take(plan, folder, after=take, frame=60), scene(), tmp_path)
    assert second.state()["frame"] == 60
    second.hear(Ride(0.0, 1.0, 0.0, False))
    for _ in range(60):
        second.picture()
    second.close()
    other = Recording(second.kept[0][0])
    np.testing.assert_array_equal(other.link_poses[:60], take.link_poses[:60])
    assert np.linalg.norm(other.actor_poses[-1, 0, :3] - other.actor_poses[-2, 0, :3]) < 1e-3


def test_a_run_without_a_rider_is_not_gone_on_with(tmp_path: Path) -> None:
    plan = Scenario.load("border-collie", ["crowd.count=2", "seconds=0.5"])
    run = simulate(plan, recording=tmp_path / "run")
    with pytest.raises(InputError, match="nobody rode in it"):
        Take(scene(), tmp_path / "take", after=run, frame=3)


def test_gymnasts_are_watched(tmp_path: Path) -> None:
    plan = ridable(Scenario.load("toe-touch", ["seconds=1"]))
    world = Live(Take, plan, tmp_path)
    assert world.welcome["mode"] == "watch"
    for _ in range(3):
        world.picture()
    assert world.state()["frame"] == 3
    world.close()


# ---- replay ----------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    plan = Scenario.load("border-collie", ["crowd.count=2", "seconds=2"])
    return simulate(plan, recording=tmp_path_factory.mktemp("run") / "run")


def test_a_recording_plays_to_its_end_and_again(recorded: Recording) -> None:
    shown = Replayed(recorded)
    for frame in range(1, 61):
        moment = shown.picture()
        assert shown.state()["frame"] == frame
        if frame == 60:
            np.testing.assert_array_equal(moment.links, recorded.link_poses[60])
    assert (shown.state()["ended"], shown.standing_still) == (True, True)
    shown.hear(Play(True))
    shown.picture()
    assert shown.state()["frame"] == 1


def test_scrubbing_shows_the_frame_that_is_asked_for(recorded: Recording) -> None:
    shown = Replayed(recorded)
    shown.hear(Play(False))
    for frame in (17, 3, 60, 10**6, 0):
        shown.hear(Seek(frame))
        np.testing.assert_array_equal(shown.picture().links, recorded.link_poses[min(frame, 60)])


def test_it_plays_backwards_and_slowly(recorded: Recording) -> None:
    shown = Replayed(recorded)
    shown.hear(Seek(30))
    shown.hear(Rate(-2.0))
    shown.picture()
    assert shown.at == 28.0
    shown.hear(Rate(0.5))
    middle = shown.picture()
    expected = 0.5 * (recorded.link_poses[28, :, :, :3] + recorded.link_poses[29, :, :, :3])
    np.testing.assert_allclose(middle.links[..., :3], expected, atol=1e-9)


def test_what_is_shown_of_the_herd(recorded: Recording) -> None:
    shown = Replayed(recorded)
    assert shown.state()["herd"] == {"in_corral": 0, "agents": 2, "fallen": 0}
    assert (shown.welcome["mode"], shown.welcome["frames"]) == ("replay", 61)
