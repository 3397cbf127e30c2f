"""The examples run, and come to the end that they promise."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import echelon

EXAMPLES = Path(__file__).parents[1] / "examples"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_herd(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = load("herd").main(agents=5, seconds=6.0, out=tmp_path)
    assert found["same"] == 1.0
    assert 0.2 < found["greatest speed of the herd [m/s]"] < 2.5
    assert 0.3 < found["time between touchdowns [s]"] < 0.8
    assert 0.2 < found["part of the time on the ground"] < 0.6
    assert 1.0 < found["mean distance to the nearest neighbour at the end [m]"] < 4.0
    assert 0.4 < found["height of the centre of mass of robot 0 at the end [m]"] < 1.2
    run = echelon.open_recording(tmp_path / "herd.recording")
    assert run.status == "done"
    assert (run.frame_count, run.agent_count) == (181, 5)
    assert (tmp_path / "herd.usd").stat().st_size > 10_000
    assert "the same state" in capsys.readouterr().out


def test_bicycle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example = load("bicycle")
    found = example.main(out=tmp_path / "bicycle.png")
    assert found["balances itself from [m/s]"] == pytest.approx(4.292, abs=0.05)
    assert found["up to [m/s]"] == pytest.approx(6.024, abs=0.1)
    assert found["greatest difference from theory [1/s]"] < 0.02
    said = capsys.readouterr().out
    assert "at 3.0 m/s, after 8 s it has fallen" in said
    assert "at 5.0 m/s, after 8 s it leans by 0.1 degrees" in said
    assert (tmp_path / "bicycle.png").stat().st_size > 20_000
    # Less trail, and it balances itself at lower speeds.
    other = example.main(trail=0.05, out=tmp_path / "other.png")
    assert other["up to [m/s]"] < found["up to [m/s]"] - 0.5


def test_center_of_mass_is_that_of_the_reference() -> None:
    """The example works it out from poses; the body from its coordinates."""
    example, body = load("herd"), echelon.load_body("hopper")
    q = body.q_reference + 0.2 * np.random.default_rng(5).normal(size=body.q_count)
    q = body.normalized(q)
    poses = body.link_poses(q)
    centers = [example.world_point(pose, link.com) for pose, link in zip(poses, body.links, strict=True)]
    masses = [link.mass for link in body.links]
    np.testing.assert_allclose(np.average(centers, axis=0, weights=masses), body.center_of_mass(q), atol=1e-12)


def test_every_example_says_what_it_shows_and_how_to_run_it() -> None:
    programs = sorted(EXAMPLES.glob("*.py"))
    assert programs
    for program in programs:
        text = program.read_text(encoding="utf-8")
        assert text.startswith('"""')
        assert f"python examples/{program.name}" in text
        told = subprocess.run([sys.executable, program, "--help"], capture_output=True, text=True, check=True)
        assert "--out" in told.stdout


def test_turn() -> None:
    """The herd of the scenario walks one way, and the other way once the collie has come."""
    run = echelon.simulate(EXAMPLES / "turn.toml")
    velocity = run.velocities[:, :, :2].mean(axis=1)
    before, after = velocity[105:125].mean(axis=0), velocity[180:210].mean(axis=0)
    assert before[0] < -0.5
    assert after[0] > 0.5
    assert run.summary["falls"] == run.summary["collisions"] == 0
