"""The command: what it says, what it makes, and with which code it ends.

Most runs here are of a stand-in for the engine, so that what the command makes of every ending can be seen; the last
two are real.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from echelon import cli
from echelon.agents.bodies import load_body
from echelon.cli.commands import run
from echelon.cli.progress import Reporter, duration, size, speed_text
from echelon.errors import InputError
from echelon.export.renderer import RenderingUnavailable
from echelon.ranks import Ranks
from echelon.recording import Cast, Recording, RecordingFailed, RecordingWriter
from echelon.scenario import Scenario
from echelon.simulation.cost import PHASES, RunCost

COMMANDS = ("simulate", "resume", "sweep", "tune", "export", "render", "plot", "bench", "list", "describe")
REPORTED = {
    "scenario", "agents", "seed", "frames", "seconds", "falls", "collisions", "nonfinite", "in_corral", "wall_seconds",
    "real_time_factor", "state_hash", "recording", "stage", "threads", "ranks", "peak_memory_mb", "phase_seconds",
}  # fmt: skip


def stand_in(
    scenario: Scenario,
    *,
    recording: Path,
    threads: int | None,
    progress: Any,
    device: str = "cpu",
    ranks: Ranks | None = None,
    cost: RunCost | None = None,
    controls: np.ndarray | None = None,
    stop: Any = None,
) -> Recording:
    """A run in which everybody stands still; ``stop`` may raise after the second chunk."""
    assert ranks is None or ranks.size == 1
    assert controls is None
    if cost is not None:
        cost.threads = 3
    count, frames = scenario.crowd.count, scenario.step_count + 1
    cast = Cast("hopper", load_body("hopper"), 0, count, np.full((count, 3), 0.5))
    with RecordingWriter.create(
        recording,
        scenario=scenario.to_dict(),
        frame_rate=scenario.frame_rate,
        frame_limit=frames,
        casts=[cast],
        world={"ground": {"shape": "plane", "half_size": 20.0}, "walls": []},
        length=10,
    ) as writer:
        progress(1, frames)
        while writer.next_frame < frames:
            rows = min(10, frames - writer.next_frame)
            buffers = {name: array[:rows] for name, array in writer.buffers().items()}
            buffers["link_poses"][..., 6] = 1.0
            buffers["origins"][..., :2] = scenario.start_positions()
            buffers["origins"][..., 2] = 1.0
            writer.append(buffers, {"x": np.zeros(1)})
            progress(writer.next_frame, frames)
            if stop is not None and writer.next_frame == 20:
                stop()
        counts = dict.fromkeys(("falls", "collisions", "nonfinite", "in_corral"), 0)
        writer.finish({"frames": frames, "seconds": scenario.seconds, **counts, "state_hash": "0123abcd"})
    return Recording(recording)


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The stand-in, where the command looks for the simulation."""
    module = ModuleType("echelon.simulation")
    module.simulate = stand_in  # type: ignore[attr-defined]
    module.resume = stand_in  # type: ignore[attr-defined]
    module.RunCost = RunCost  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "echelon.simulation", module)
    return module


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


Said = Callable[[], tuple[str, str]]


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]) -> Said:
    """What was printed since: standard output, standard error."""
    return lambda: tuple(capsys.readouterr())  # type: ignore[return-value]


def refused(said: Said, code: int, *arguments: str) -> str:
    """The one line on standard error with which a command ends."""
    assert cli.run(list(arguments)) == code
    out, err = said()
    assert out == ""
    lines = err.splitlines()
    assert lines[-1].startswith("echelon: ")
    assert "Traceback" not in err
    return lines[-1]


# ---- help ----------------------------------------------------------------------------------------------------------
def test_the_top(said: Said) -> None:
    assert cli.run([]) == 0
    plain = said()[0]
    assert cli.run(["--help"]) == 0
    assert said()[0] == plain
    assert all(f"\n  {name} " in plain for name in COMMANDS)
    assert "echelon simulate border-collie --out herd.usd" in plain


@pytest.mark.parametrize("name", COMMANDS)
def test_help(name: str, said: Said) -> None:
    assert cli.run([name, "--help"]) == 0
    text, err = said()
    assert err == ""
    usage, _, rest = text.partition("Examples:\n")
    assert usage.startswith(f"Usage: echelon {name}")
    assert rest.strip().startswith(f"echelon {name}")
    undocumented = re.findall(r"^  (?:-\w, )?--[\w-]+(?: [\w.|<>=]+)?$(?!\n {20,}\S)", text, flags=re.MULTILINE)
    assert undocumented == []


def test_help_is_there_at_once() -> None:
    """What takes long to import waits until a command needs it."""
    heavy = ("numpy", "scipy", "warp", "zarr", "pxr", "rich", "matplotlib", "pyrender", "av", "PIL")
    code = f"import sys; from echelon.cli import run; run(['--help']); print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_device_that_is_not_there(tmp_path: Path, said: Said) -> None:
    folder = tmp_path / "herd.recording"
    assert cli.run(["simulate", "herd", "--device", "cuda:99", "--recording", str(folder)]) == 2
    assert re.fullmatch(r"echelon: device 'cuda:99': not on this machine; must be one of cpu.*\n", said()[1])
    assert not folder.exists()


def test_python_runs_the_package() -> None:
    done = subprocess.run([sys.executable, "-m", "echelon", "--version"], capture_output=True, text=True, check=True)
    assert re.fullmatch(r"echelon \d+\.\d+\.\d+\S*\n", done.stdout)


def test_version(said: Said) -> None:
    assert cli.run(["--version"]) == 0
    assert re.fullmatch(r"echelon \d+\.\d+\.\d+\S*\n", said()[0])


def test_the_installed_command(tmp_path: Path) -> None:
    command = Path(sys.executable).with_name("echelon")
    if not command.exists():
        pytest.skip("Echelon is not installed as a command here")
    good = subprocess.run([command, "list"], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert (good.returncode, good.stderr) == (0, "")
    bad = subprocess.run([command, "simulate", "no-such"], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert (bad.returncode, bad.stdout, bad.stderr.count("\n")) == (2, "", 1)


# ---- wrong input ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["simulat", "herd"], "No such command 'simulat'"),
        (["simulate"], "Missing argument"),
        (["simulate", "herd", "again"], "unexpected extra argument"),
        (["simulate", "herd", "--agnets", "3"], "No such option"),
        (["simulate", "herd", "--agents", "three"], "--agents"),
        (["simulate", "herd", "--agents", "0"], "--agents"),
        (["simulate", "herd", "--seed", "-1"], "--seed"),
        (["simulate", "herd", "--threads", "0"], "--threads"),
        (["simulate", "herd", "--set"], "--set"),
        (["simulate", "herd", "--set", "nonsense"], "must be key=value"),
        (["simulate", "herd", "--set", "crowd.count=-3"], "crowd.count = -3"),
        (["simulate", "herd", "--seconds", "nan"], "seconds = nan: must be a finite number"),
        (["simulate", "herd", "--seconds", "-5"], "seconds = -5.0: must be above 0"),
        (["simulate", "herd", "--agents", "100000"], "about 453 fit"),
        (["simulate", "hrd"], "did you mean 'herd'"),
        (["simulate", "none.toml"], "none.toml: no such file"),
        (["simulate", "herd", "--representation", "mesh"], "representation"),
        (["simulate", "herd", "--out", "no/herd.usd"], "there is no folder"),
        (["simulate", "herd", "--out", "herd.fbx"], "herd.fbx"),
        (["simulate", "herd", "--film", "herd.gif"], "must end in .mp4"),
        (["simulate", "herd", "--film", "no/herd.mp4"], "does not exist"),
        (["simulate", "herd", "--recording", "no/herd"], "there is no folder"),
        (["simulate", "herd", "--recording", "kept"], "not a recording"),
        (["resume", "none"], "none: no such recording"),
        (["resume", "kept"], "kept: not a recording"),
        (["export", "none", "--out", "a.usd"], "no such recording"),
        (["export", "kept"], "--out"),
        (["render", "none", "--out", "a.mp4"], "no such recording"),
        (["render", "kept", "--out", "a.mp4"], "not a recording"),
        (["plot", "none", "--out", "a.png"], "no such recording"),
        (["describe", "sheep"], "no such scenario, maneuver, body or recording"),
        (["describe", "border-colie"], "did you mean 'border-collie'"),
        (["describe", "none.toml"], "no such file"),
        (["bench", "herd"], "'engine'"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_input(here: Path, said: Said, arguments: list[str], expected: str) -> None:
    """One line, exit code 2, nothing written."""
    (here / "kept").mkdir()
    (here / "kept" / "work.txt").write_text("years of it")
    assert cli.run(arguments) == 2
    out, err = said()
    assert out == ""
    assert err.startswith("echelon: ")
    assert err.count("\n") == 1
    assert expected in err
    assert sorted(str(path.relative_to(here)) for path in here.rglob("*")) == ["kept", "kept/work.txt"]


# ---- simulate ------------------------------------------------------------------------------------------------------
def test_simulate_json(engine: ModuleType, here: Path, said: Said) -> None:
    assert cli.run(["simulate", "herd", "--agents", "3", "--seconds", "1", "--seed", "7", "--json"]) == 0
    out, err = said()
    assert err == ""
    assert out.count("\n") == 1
    report = json.loads(out)
    assert set(report) >= REPORTED
    assert (report["scenario"], report["agents"], report["seed"], report["frames"]) == ("herd", 3, 7, 31)
    assert (report["recording"], report["stage"], report["film"]) == ("herd.recording", None, None)
    assert report["real_time_factor"] == pytest.approx(1.0 / report["wall_seconds"], rel=0.05)
    stored = Recording(here / "herd.recording").scenario
    assert (stored["crowd"]["count"], stored["seconds"], stored["seed"]) == (3, 1.0, 7)


def test_what_libraries_print_does_not_get_into_the_json(engine: ModuleType, here: Path, said: Said) -> None:
    def chatty(*arguments: Any, **options: Any) -> Recording:
        print("Module 42 load on device 'cpu' took 3 ms")
        return stand_in(*arguments, **options)

    engine.simulate = chatty  # type: ignore[attr-defined]
    assert cli.run(["simulate", "herd", "--seconds", "0.5", "--json"]) == 0
    out, err = said()
    assert json.loads(out)["frames"] == 16
    assert "Module 42" in err


def test_simulate_for_people(engine: ModuleType, here: Path, said: Said) -> None:
    assert cli.run(["simulate", "herd", "--agents", "3", "--seconds", "1"]) == 0
    out, err = said()
    assert re.search(r"herd: 3 hoppers, 1 s at 30 frames a second; takes about [\d.]+ s and [\d.]+ \w?B of disk", err)
    assert out.startswith("herd: 3 agents, 1 s simulated in ")
    for key, value in (("falls", "0"), ("state hash", "0123abcd"), ("recording", r"herd\.recording")):
        assert re.search(rf"^  {key} +{value}$", out, flags=re.MULTILINE)
    assert "stage" not in out
    assert cli.run(["simulate", "herd", "--seconds", "1"]) == 0
    assert "replacing the recording herd.recording" in said()[1]


def test_quiet(engine: ModuleType, here: Path, said: Said) -> None:
    assert cli.run(["simulate", "herd", "--seconds", "1", "--quiet", "--out", "herd.usd"]) == 0
    assert said() == ("", "")
    assert (here / "herd.usd").stat().st_size > 1000


def test_simulate_writes_the_stage_and_records_beside_it(engine: ModuleType, here: Path, said: Said) -> None:
    (here / "shots").mkdir()
    arguments = ["simulate", "herd", "--agents", "2", "--seconds", "0.5", "--out", "shots/herd.usda", "--json"]
    assert cli.run([*arguments, "--representation", "points"]) == 0
    report = json.loads(said()[0])
    assert (report["stage"], report["recording"]) == ("shots/herd.usda", "shots/herd.recording")
    text = (here / "shots" / "herd.usda").read_text()
    assert text.startswith("#usda 1.0")
    assert "PointInstancer" in text
    assert Recording(here / "shots" / "herd.recording").status == "done"


def test_interrupted(engine: ModuleType, here: Path, said: Said) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    def stopped(*arguments: Any, **options: Any) -> Recording:
        return stand_in(*arguments, **options, stop=interrupt)

    engine.simulate = stopped  # type: ignore[attr-defined]
    line = refused(said, 1, "simulate", "herd", "--agents", "2", "--seconds", "2", "--out", "herd.usd")
    assert line == "echelon: interrupted; go on with: echelon resume herd.recording"
    assert not (here / "herd.usd").exists()
    left = Recording(here / "herd.recording")
    assert (left.status, left.frame_count) == ("running", 20)
    writer, state = RecordingWriter.reopen(here / "herd.recording")
    assert (writer.next_frame, state is not None) == (10, True)
    writer.close()


def test_interrupted_before_anything_was_recorded(engine: ModuleType, here: Path, said: Said) -> None:
    def stopped(*arguments: Any, **options: Any) -> Recording:
        raise KeyboardInterrupt

    assert cli.run(["simulate", "herd", "--seconds", "0.5", "--quiet"]) == 0  # an older one, finished, is still there
    engine.simulate = stopped  # type: ignore[attr-defined]
    for place in ("herd.recording", "another"):
        assert refused(said, 1, "simulate", "herd", "--recording", place) == "echelon: interrupted"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (RecordingFailed("herd.recording: cannot be written (No space left on device)"), 1),
        (PermissionError(13, "Permission denied", "herd.recording"), 1),
        (MemoryError(), 1),
        (InputError("body 'hopper': no mass"), 2),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else "",
)
def test_a_run_that_fails(engine: ModuleType, here: Path, said: Said, error: Exception, code: int) -> None:
    def failing(*arguments: Any, **options: Any) -> Recording:
        raise error

    engine.simulate = failing  # type: ignore[attr-defined]
    line = refused(said, code, "simulate", "herd", "--seconds", "1")
    assert str(error.args[-1] if error.args else "memory").strip("'") in line


def test_a_disk_that_is_too_small(engine: ModuleType, here: Path, said: Said, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("echelon.recording.estimate_bytes", lambda *args, **options: 10**18)
    assert "needs about 1e+09 GB, but only" in refused(said, 1, "simulate", "herd")
    assert not list(here.iterdir())


def test_without_rendering_the_stage_is_still_written(
    engine: ModuleType, here: Path, said: Said, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unavailable(*arguments: Any, **options: Any) -> Path:
        raise RenderingUnavailable("no EGL: install libegl1 and libgl1-mesa-dri")

    monkeypatch.setattr("echelon.export.pictures.render_film", unavailable)
    arguments = ["simulate", "herd", "--seconds", "0.5", "--out", "herd.usd", "--film", "herd.mp4"]
    assert cli.run([*arguments, "--json"]) == 1
    out, err = said()
    assert err == "echelon: herd.mp4: no film was made: no EGL: install libegl1 and libgl1-mesa-dri\n"
    report = json.loads(out)
    assert (report["stage"], report["film"]) == ("herd.usd", None)
    assert (here / "herd.usd").exists()


def test_the_film_is_of_the_shot(engine: ModuleType, here: Path, said: Said, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}
    monkeypatch.setattr("echelon.export.pictures.render_film", lambda *args, **options: asked.update(options))
    shot = ["shot.first_frame=-31", "shot.film_every=2", "shot.size=[320, 180]", "shot.camera=overview"]
    overrides = [word for setting in shot for word in ("--set", setting)]
    assert cli.run(["simulate", "herd", "--seconds", "3", "--film", "herd.mp4", "--quiet", *overrides]) == 0
    del asked["progress"]
    assert asked.pop("seconds") == pytest.approx(31 / 30)
    assert asked == {"start": 2.0, "fps": 15.0, "size": (320, 180), "camera": "overview"}


def test_resume(engine: ModuleType, here: Path, said: Said) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    scenario = Scenario.load("herd", ["seconds=2", "crowd.count=2"])
    with pytest.raises(KeyboardInterrupt):
        stand_in(scenario, recording=here / "run", threads=None, progress=lambda *_: None, stop=interrupt)

    def going_on(
        path: Path, *, threads: int | None, progress: Any, device: str, ranks: Ranks, cost: RunCost
    ) -> Recording:
        assert device == "cpu"
        return stand_in(scenario, recording=path, threads=threads, progress=progress, ranks=ranks, cost=cost)

    engine.resume = going_on  # type: ignore[attr-defined]
    assert cli.run(["resume", "run", "--out", "herd.usd"]) == 0
    out, err = said()
    assert "herd: going on after 20 frames of at most 61; when it was interrupted at most a chunk, 10 frames" in err
    assert re.search(r"stage +herd\.usd", out)
    assert "finished (61 frames); nothing to resume" in refused(said, 2, "resume", "run")


# ---- what is made of a recording -----------------------------------------------------------------------------------
@pytest.fixture
def recorded(here: Path) -> str:
    scenario = Scenario.load("herd", ["seconds=1", "crowd.count=2"])
    stand_in(scenario, recording=here / "run", threads=None, progress=lambda *_: None)
    return "run"


@pytest.mark.parametrize(("count", "chosen"), [(2, "rig"), (150, "rig"), (151, "points")])
def test_the_size_of_the_crowd_chooses_the_representation(
    count: int, chosen: str, engine: ModuleType, here: Path, said: Said
) -> None:
    """A line says what was chosen, and how to choose otherwise; who chooses gets that, and no line."""
    wide = ["--set", "world.ground=plane", "--agents", str(count), "--seconds", "0.2", "--out", "a.usda"]
    assert cli.run(["simulate", "herd", *wide]) == 0
    line = f"a.usda: {count} agents as {chosen}; --representation takes "
    assert said()[1].count(line) == 1
    assert cli.run(["export", "a.recording", "--out", "b.usda"]) == 0
    assert f"b.usda: {count} agents as {chosen}; --representation takes " in said()[1]
    assert ("PointInstancer" in (here / "a.usda").read_text()) == (chosen == "points")
    assert (here / "a.usda").read_bytes() == (here / "b.usda").read_bytes()
    other = "rig" if chosen == "points" else "points"
    assert cli.run(["export", "a.recording", "--out", "c.usda", "--representation", other]) == 0
    assert "--representation" not in said()[1]
    assert ("PointInstancer" in (here / "c.usda").read_text()) == (other == "points")


def test_export(recorded: str, here: Path, said: Said) -> None:
    arguments = ["export", recorded, "--out", "crowd.usda", "--representation", "skel", "--also", "points"]
    assert cli.run(arguments) == 0
    assert re.fullmatch(r"wrote crowd\.usda \([\d.]+ .?B\)\n", said()[1])
    text = (here / "crowd.usda").read_text()
    assert "SkelAnimation" in text
    assert "PointInstancer" in text
    assert cli.run(["export", recorded, "--out", "physics.usda", "--physics", "3"]) == 0
    assert "PhysicsScene" in (here / "physics.usda").read_text()
    said()
    assert "frame" in refused(said, 2, "export", recorded, "--out", "physics.usda", "--physics", "99")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--out", "a.mp4", "--time", "3"], "--time: not for a film"),
        (["--out", "a.png", "--fps", "3"], "--fps: not for a still"),
        (["--out", "a.png", "--strip", "0.5", "--time", "3"], "--time: not for a filmstrip"),
        (["--out", "a.mp4", "--strip", "0.5"], "a filmstrip is a .png"),
        (["--out", "a.png", "--size", "640"], "must be WIDTHxHEIGHT"),
        (["--out", "a.png", "--size", "-6x3"], "must be WIDTHxHEIGHT"),
        (["--out", "a.jpg"], "must end in .png"),
        (["--out", "a.png", "--camera", "below"], "camera"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_pictures(recorded: str, said: Said, arguments: list[str], expected: str) -> None:
    assert expected in refused(said, 2, "render", recorded, *arguments)


def test_each_kind_of_picture_is_asked_for(
    recorded: str, here: Path, said: Said, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, Any, dict[str, Any]]] = []

    def note(kind: str) -> Callable[..., None]:
        def draw(source: Any, path: Path, **options: Any) -> None:
            options.pop("progress", None)
            asked.append((kind, source, options))
            path.write_bytes(b"picture")

        return draw

    for kind in ("film", "still", "strip"):
        monkeypatch.setattr(f"echelon.export.pictures.render_{kind}", note(kind))
    (here / "herd.usd").write_bytes(b"stage")
    assert cli.run(["render", recorded, "--out", "a.png", "--time", "0.5", "--size", "64x48"]) == 0
    assert cli.run(["render", recorded, "--out", "b.png", "--strip", "0.2", "--count", "3", "--camera", "corral"]) == 0
    assert cli.run(["render", recorded, "--out", "c.mp4", "--start", "0.5", "--fps", "10"]) == 0
    assert cli.run(["render", "herd.usd", "--out", "d.mp4"]) == 0
    kinds, sources, options = zip(*asked, strict=True)
    assert kinds == ("still", "strip", "film", "film")
    assert all(isinstance(source, Recording) for source in sources[:3])
    assert sources[3] == Path("herd.usd")
    assert options == (
        {"time": 0.5, "size": (64, 48)},
        {"interval": 0.2, "count": 3, "camera": "corral"},
        {"start": 0.5, "fps": 10.0, "size": (640, 360), "camera": "follow"},
        {},
    )


def test_rendering_that_is_not_there(recorded: str, said: Said, monkeypatch: pytest.MonkeyPatch) -> None:
    def unavailable(*arguments: Any, **options: Any) -> Path:
        raise RenderingUnavailable("no EGL: install libegl1")

    monkeypatch.setattr("echelon.export.pictures.render_still", unavailable)
    assert refused(said, 1, "render", recorded, "--out", "a.png") == "echelon: a.png: no EGL: install libegl1"


# ---- list and describe ---------------------------------------------------------------------------------------------
def test_list(said: Said) -> None:
    assert cli.run(["list"]) == 0
    text = said()[0]
    assert cli.run(["list", "--json"]) == 0
    found = json.loads(said()[0])
    assert set(found) == {"scenarios", "maneuvers", "courses", "bodies", "characters"}
    assert "border-collie" in found["scenarios"]
    assert {"hopper", "male", "female"} <= set(found["bodies"])
    for names in found.values():
        for name, line in names.items():
            assert line
            assert re.search(rf"^  {name} +{re.escape(line)}$", text, flags=re.MULTILINE)


def test_describe_a_scenario(said: Said, here: Path) -> None:
    """What is printed is a scenario file."""
    assert cli.run(["describe", "border-collie"]) == 0
    (here / "mine.toml").write_text(said()[0])
    assert Scenario.load(here / "mine.toml") == Scenario.load("border-collie")
    assert cli.run(["describe", "mine.toml", "--json"]) == 0
    assert json.loads(said()[0])["crowd"]["count"] == 16


def test_describe_a_body(said: Said) -> None:
    assert cli.run(["describe", "male"]) == 0
    assert "53 degrees of freedom, 97.84 kg" in said()[0]
    assert cli.run(["describe", "hopper", "--json"]) == 0
    assert json.loads(said()[0])["link_names"] == list(load_body("hopper").link_names)


def test_describe_a_maneuver(said: Said, here: Path) -> None:
    """What is printed is a maneuver's file."""
    assert cli.run(["describe", "stand-on-slope"]) == 0
    (here / "mine.toml").write_text(said()[0])
    assert cli.run(["describe", "mine.toml", "--json"]) == 0
    data = json.loads(said()[0])
    assert data["name"] == "stand-on-slope"
    assert data["rows"]


def test_describe_a_recording(recorded: str, said: Said) -> None:
    assert cli.run(["describe", recorded]) == 0
    text = said()[0]
    assert re.search(r"length +31 frames at 30 a second, 1\.0 s", text)
    assert re.search(r"casts +2 hopper", text)
    assert cli.run(["describe", recorded, "--json"]) == 0
    data = json.loads(said()[0])
    assert (data["frames"], data["status"], data["summary"]["state_hash"]) == (31, "done", "0123abcd")


# ---- progress ------------------------------------------------------------------------------------------------------
def test_lines_where_there_is_no_terminal(said: Said, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter(np.arange(0.0, 100.0, 1.0).tolist())
    monkeypatch.setattr("time.perf_counter", lambda: next(clock))
    with Reporter(quiet=False).progress("herd", "frames", 30) as progress:
        for done in range(0, 1000, 100):
            progress(done, 1000)
    lines = said()[1].splitlines()
    assert lines[0] == "herd: 200 of 1000 frames, 50/s (1.67 x real time), 16 s left"
    assert 2 <= len(lines) <= 4


def test_a_bar_on_a_terminal() -> None:
    """On a terminal there is a bar while the work goes on, and nothing afterwards."""
    pty = pytest.importorskip("pty")
    code = (
        "import time\nfrom echelon.cli.progress import Reporter\n"
        "with Reporter(False).progress('herd', 'frames', 30) as progress:\n"
        "    time.sleep(0.4)\n"
        "    for done in range(0, 101, 10):\n        progress(done, 100)\n        time.sleep(0.05)\n"
    )
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", code], stderr=theirs, stdout=subprocess.DEVNULL, env={**os.environ, "COLUMNS": "120"}
    )
    os.close(theirs)
    text = b""
    while True:
        try:
            data = os.read(ours, 4096)
        except OSError:  # the other end is closed
            break
        if not data:
            break
        text += data
    os.close(ours)
    assert process.wait() == 0
    assert b"starting" in text
    assert b"of 100 frames" in text
    assert b"/s (" in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (duration(0.04), "0.0 s"),
        (duration(9.96), "10.0 s"),
        (duration(59.4), "59 s"),
        (duration(200.0), "3 min 20 s"),
        (duration(7500.0), "2 h 5 min"),
        (size(999), "999 bytes"),
        (size(1000), "1 kB"),
        (size(3_400_000), "3.4 MB"),
        (size(1.25e9), "1.25 GB"),
        (speed_text(0.0, 30), ""),
        (speed_text(4800.0, 30), ", 4800/s (160 x real time)"),
        (speed_text(5.25, 0), ", 5.2/s"),
    ],
)
def test_figures(text: str, expected: str) -> None:
    assert text == expected


# ---- with the engine -----------------------------------------------------------------------------------------------
def test_a_real_run(here: Path, said: Said) -> None:
    """The same seed gives the same state on one thread and on two, another seed another."""
    reports = []
    for options in (["--threads", "1"], ["--threads", "2", "--out", "herd.usdc"], ["--seed", "9"]):
        assert cli.run(["simulate", "border-collie", "--agents", "5", "--seconds", "1.5", "--json", *options]) == 0
        out, err = said()
        assert err == ""
        reports.append(json.loads(out))
    assert all(set(report) >= REPORTED for report in reports)
    assert all(set(report["phase_seconds"]) == set(PHASES) and report["ranks"] == 1 for report in reports)
    assert all(report["phase_seconds"]["act"] > 0.0 and report["phase_seconds"]["write"] > 0.0 for report in reports)
    assert reports[0]["state_hash"] == reports[1]["state_hash"] != reports[2]["state_hash"]
    assert (reports[0]["frames"], reports[0]["falls"], reports[0]["nonfinite"]) == (46, 0, 0)
    assert reports[1]["recording"] == "herd.recording"
    assert (here / "herd.usdc").read_bytes().startswith(b"PXR-USDC")


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs a system with SIGKILL")
def test_a_real_run_killed_and_resumed(here: Path, said: Said) -> None:
    """What is resumed ends with the bytes of a run that was not interrupted."""
    arguments = ["simulate", "herd", "--agents", "4", "--seconds", "300", "--quiet", "--recording"]
    command = [sys.executable, "-c", "import sys; from echelon.cli import run; sys.exit(run(sys.argv[1:]))"]
    process = subprocess.Popen([*command, *arguments, "cut"])
    try:
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline and process.poll() is None:
            if (here / "cut").exists() and Recording(here / "cut").frame_count:
                break
            time.sleep(0.01)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    left = Recording(here / "cut")
    assert 0 < left.frame_count < 9001
    assert left.status == "running"

    assert cli.run(["resume", "cut", "--quiet"]) == 0
    assert cli.run([*arguments, "whole"]) == 0
    assert said() == ("", "")
    files = sorted(path.relative_to(here / "whole") for path in (here / "whole").rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(here / "cut") for path in (here / "cut").rglob("*") if path.is_file())
    assert all((here / "cut" / file).read_bytes() == (here / "whole" / file).read_bytes() for file in files)


def test_a_recording_is_simulated_again(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    first, again = tmp_path / "first.recording", tmp_path / "again.recording"
    assert run(["simulate", "straight", "--seconds", "0.5", "--recording", str(first), "--quiet"]) == 0
    assert run(["simulate", str(first), "--recording", str(again), "--quiet"]) == 0
    for file in first.rglob("*"):
        if file.is_file():
            assert file.read_bytes() == (again / file.relative_to(first)).read_bytes()
    assert run(["simulate", str(first), "--recording", str(first)]) == 2
    assert "is what is to be simulated again; name another with --recording" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "takes one of SCENARIO, --replay RECORDING and --continue TAKE; none was given"),
        (["herd", "--replay", "x"], "SCENARIO and --replay were given"),
        (["--replay", "x", "--seed", "2"], "--seed: changes a scenario; --replay has one already"),
        (["herd", "--from", "2"], "--from: says from when on a take is gone on with"),
        (["--replay", "x", "--trainer", "nearest"], "--trainer: nobody rides in a recording"),
        (["herd", "--pitch", "9000"], "--pitch: is driven beside a trainer"),
        (["--replay", "nowhere"], "nowhere: no such recording"),
        (["herd", "--takes", "nowhere"], "--takes nowhere: there is no such folder"),
        (["hird"], "no such scenario"),
    ],
)
def test_play_refuses_in_one_line(arguments: list[str], message: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["play", *arguments, "--no-open"]) == 2
    err = capfd.readouterr().err
    assert message in err
    assert err.count("\n") == 1


def test_what_a_page_cannot_be_made_of(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    first = tmp_path / "first.recording"
    assert run(["simulate", "straight", "--seconds", "0.5", "--recording", str(first), "--quiet"]) == 0
    for options, message in (
        (["--start", "9"], "--start 9: must be from 0 to 0.5 s"),
        (["--size", "10x10"], "--size: not for a page"),
        (["--strip", "0.1"], "is a page; a filmstrip is a .png"),
    ):
        assert run(["render", str(first), "--out", str(tmp_path / "page.html"), *options]) == 2
        assert message in capfd.readouterr().err
