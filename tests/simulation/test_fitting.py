"""Maneuvers that were tuned for somebody else: said before a run, in one line each."""

from __future__ import annotations

from pathlib import Path

import pytest

from echelon.agents.characters import character_named
from echelon.agents.fingerprint import fingerprint
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.scenario import Scenario
from echelon.simulation.fitting import misfits

ROWS = '[[row]]\nname = "stand"\nsettings = { balance = 1.0 }\n'


def tuned_for_the_male() -> str:
    character = character_named("gymnast-male")
    assert isinstance(character, Gymnast)
    return "[tuned]\n" + "".join(f'{name} = "{value}"\n' for name, value in fingerprint(character).plain().items())


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ([], []),
        (["crowd.character='gymnast-female'"], ["body"]),
        (["engine.substeps=80", "engine.tick=8"], ["step"]),
    ],
)
def test_a_line_for_each_script_that_does_not_fit(settings: list[str], said: list[str], tmp_path: Path) -> None:
    script = tmp_path / "tuned.toml"
    script.write_text(ROWS + tuned_for_the_male())
    free = tmp_path / "free.toml"
    free.write_text(ROWS)
    scenario = Scenario.load("standing-back-somersault", [f"performance.maneuver=['{script}', '{free}']", *settings])
    lines = misfits(scenario)
    assert len(lines) == len(said)
    for line, what in zip(lines, said, strict=True):
        assert f"another {what} " in line
        assert str(script) in line


def test_herds_follow_no_scripts() -> None:
    assert misfits(Scenario.load("herd")) == ()
