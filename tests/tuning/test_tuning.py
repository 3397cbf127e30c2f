"""Tuning: found, kept, gone on with, refused."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echelon.agents.gymnasts.script import load_script
from echelon.cli.commands import run
from echelon.errors import InputError
from echelon.tuning import TuningProgress, TuningResult, tune
from echelon.tuning.folder import STATE, Batch, TuningFolder
from echelon.tuning.tuning import _character
from tests.tuning.toy import OBJECTIVE, SCRIPT


def fit(script: Path, objective: Path, name: str, **options: Any) -> TuningResult:
    options = {"from_nothing": True, "seed": 3, "threads": 1, "minutes": 1.0} | options
    return tune(script, objective=objective, out=script.with_name(name), **options)


@pytest.fixture(scope="module")
def told() -> list[TuningProgress]:
    """What was told of the search below."""
    return []


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, told: list[TuningProgress]) -> TuningResult:
    """A search from nothing, not interrupted."""
    place = tmp_path_factory.mktemp("whole")
    script, objective = place / "bend.toml", place / "knees.toml"
    script.write_text(SCRIPT)
    objective.write_text(OBJECTIVE)
    return fit(script, objective, "whole.toml", progress=told.append)


def test_a_toy_is_found_from_nothing(whole: TuningResult, told: list[TuningProgress]) -> None:
    result = whole
    assert result.done
    assert result.success == 1.0
    # From hip to ankle for knees that are bent by 0.8 rad in a standing man: by the law of cosines, and sag.
    assert result.values["deep"] == pytest.approx(0.78, abs=0.03)
    assert abs(result.values["arms"] - 1.0) < 0.2
    assert result.terms["knees"] < 0.3
    assert [one.stage for one in told] == sorted(one.stage for one in told)
    assert {one.stage_name for one in told} == {"bend", "arms"}
    assert (result.folder / "convergence.png").read_bytes()[:4] == b"\x89PNG"


def test_the_tuned_script_is_the_old_one_with_other_numbers(
    whole: TuningResult, script_file: Path, objective_file: Path
) -> None:
    result = whole
    text = result.path.read_text()
    assert "# How deep." in text
    assert "# of whom we know" in text
    assert text.count("[tuned]") == 1
    tuned = load_script(result.path)
    assert {name: tuned.parameters[name].value for name in result.values} == dict(result.values)
    assert tuned.parameters["deep"].spread == 0.01
    assert tuned.parameters["still"].value == 0.15
    assert tuned.rows == load_script(script_file).rows
    assert tuned.tuned["for"] == "male"
    # And it can be tuned again.
    script_file.write_text(text)
    again = fit(script_file, objective_file, "again.toml", from_nothing=False, minutes=1e-9)
    assert again.path.read_text().count("[tuned]") == 1
    assert again.note == ""


def test_an_interrupted_search_ends_with_the_same_bytes(
    whole: TuningResult, script_file: Path, objective_file: Path
) -> None:

    class Interrupted(Exception):
        pass

    seen = 0

    def interrupt(progress: TuningProgress) -> None:
        nonlocal seen
        seen += 1
        if seen == 3:
            raise Interrupted

    with pytest.raises(Interrupted):
        fit(script_file, objective_file, "parts.toml", progress=interrupt)
    state = script_file.with_name("parts.tuning") / STATE
    assert len(json.loads(state.read_text())["batches"]) == 3
    parts = fit(script_file, objective_file, "parts.toml", resume=True, threads=2)
    assert parts.path.read_bytes() == whole.path.read_bytes()
    for name in (STATE, "convergence.png"):
        assert (parts.folder / name).read_bytes() == (whole.folder / name).read_bytes()
    # Once more: everything is known, and nothing performs.
    again = fit(script_file, objective_file, "parts.toml", resume=True)
    assert again.performed == 0
    assert again.path.read_bytes() == whole.path.read_bytes()


def test_a_search_that_is_out_of_time_goes_on_as_if_it_had_not_been(
    whole: TuningResult, script_file: Path, objective_file: Path
) -> None:
    short = fit(script_file, objective_file, "short.toml", minutes=1e-9)
    assert not short.done
    assert short.values == {"deep": pytest.approx(0.775), "arms": pytest.approx(0.75)}
    assert short.path.exists()
    fit(script_file, objective_file, "short.toml", resume=True)
    assert short.path.read_bytes() == whole.path.read_bytes()


def test_a_stage_that_leads_nowhere_begins_anew(script_file: Path, objective_file: Path) -> None:
    objective_file.write_text(
        objective_file.read_text().replace("generations = 12\nenough = 0.0002", "enough = -1\ngenerations = 1")
    )
    result = fit(script_file, objective_file, "out.toml", minutes=0.05)
    assert not result.done
    assert result.rounds > 1
    assert {one.stage for one in result.history} == {0}
    # Other candidates each time.
    firsts = [one.best for one in result.history if one.number == 0]
    assert len(set(firsts)) == len(firsts)


def test_a_script_that_was_tuned_for_somebody_else_says_so(
    whole: TuningResult, script_file: Path, objective_file: Path
) -> None:
    text = whole.path.read_text()
    script_file.write_text(text.replace(whole.script.tuned["body"], "somebody"))
    note = fit(script_file, objective_file, "out.toml", from_nothing=False, minutes=1e-9).note
    assert note.startswith(f"{script_file}: was tuned for another body somebody, not {whole.script.tuned['body']}")
    assert "\n" not in note


def test_bodies_are_said_in_words() -> None:
    assert _character("female", None, None)[1] == "female"
    small, words = _character("male", 1.7, 65.0)
    assert words == "male, 1.7 m, 65 kg"
    assert small.body.mass == pytest.approx(65.0)


# ---- the folder ------------------------------------------------------------------------------------------------------
def test_a_folder_keeps_numbers_to_the_last_bit(tmp_path: Path) -> None:
    batch = Batch((1 / 3, 2e-17), (0.1, 1.0), (np.pi,))
    candidates = [{"a": 1 / 7}, {"a": 2 / 7}]
    with TuningFolder.open(tmp_path / "t", {"seed": 1}, False) as folder:
        folder.keep(candidates, batch)
    with TuningFolder.open(tmp_path / "t", {"seed": 1}, True) as folder:
        assert folder.known(0, candidates) == batch
        assert folder.known(1, candidates) is None
        with pytest.raises(InputError, match="batch 0 was of other candidates"):
            folder.known(0, candidates[::-1])


def test_a_folder_is_taken_only_for_what_it_is(tmp_path: Path) -> None:
    with TuningFolder.open(tmp_path / "t", {"seed": 1}, False):
        pass
    cases = [
        (tmp_path / "t", {"seed": 1}, False, "--resume goes on with it"),
        (tmp_path / "t", {"seed": 2}, True, "differs in seed"),
        (tmp_path / "none", {"seed": 1}, True, "holds no tuning to go on with"),
        (tmp_path / "no" / "where", {"seed": 1}, False, "there is no folder"),
    ]
    for path, settings, resume, message in cases:
        with pytest.raises(InputError, match=message), TuningFolder.open(path, settings, resume):
            pass
    (tmp_path / "t" / STATE).write_text("{}")
    with pytest.raises(InputError, match="cannot be read as a tuning's"), TuningFolder.open(tmp_path / "t", {}, True):
        pass


# ---- the command -----------------------------------------------------------------------------------------------------
def test_the_command_tunes(script_file: Path, objective_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = script_file.with_name("out.toml")
    arguments = ["tune", str(script_file), "--objective", str(objective_file), "--out", str(out), "--seed", "3"]
    assert run([*arguments, "--from-nothing", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["done"] is True
    assert report["script"] == str(out)
    assert run(arguments) == 2
    assert "--resume goes on with it" in capsys.readouterr().err
    assert run([*arguments, "--resume"]) == 2  # it was from nothing
    assert "differs in from_nothing" in capsys.readouterr().err
    assert run([*arguments, "--from-nothing", "--resume"]) == 0
    said = capsys.readouterr()
    assert "100% of 8 perturbed copies succeed" in said.out
    assert str(out.with_suffix(".tuning") / "convergence.png") in said.out


def test_the_command_says_when_it_has_not_got_there(
    script_file: Path, objective_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    objective_file.write_text(objective_file.read_text().replace("least = 0.6\nmost = 1.0", "least = 2.6"))
    out = script_file.with_name("out.toml")
    code = run(["tune", str(script_file), "--objective", str(objective_file), "-o", str(out), "--minutes", "0.03"])
    assert code == 1
    assert "0% of 8 succeed, 80% should; --resume" in capsys.readouterr().err
    assert out.exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--minutes", "0"], "--minutes 0: must be above 0"),
        (["--population", "2"], "--population 2: must be at least 4"),
        (["--body", "child"], "--body child: must be one of male, female"),
        (["--height", "9"], "height"),
        (["--objective", "nonsense"], "objective 'nonsense': must be the path of a .toml file"),
        (["--objective", "nothing.toml"], "nothing.toml: cannot be read"),
        (["--out", "out.json"], "--out out.json: must be the name of a .toml file"),
        (["--out", "no/such/folder/out.toml"], "must be the name of a file, in a folder that is there"),
        (["--seed", "-1"], "--seed -1: must be from 0"),
    ],
)
def test_bad_options_are_one_line(
    options: list[str],
    message: str,
    script_file: Path,
    objective_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    given = [] if "--objective" in options else ["--objective", str(objective_file)]
    assert run(["tune", str(script_file), *given, *options]) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("echelon: ")
    assert message in said
    assert "\n" not in said
    assert not list(tmp_path.glob("*.tuning"))


def test_without_the_package_it_says_how_to_get_it(
    script_file: Path, objective_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "cmaes", None)
    assert run(["tune", str(script_file), "--objective", str(objective_file)]) == 2
    assert "`pip install 'echelon[tune]'` adds it" in capsys.readouterr().err


def test_a_script_without_an_objective_says_where_to_give_one(
    script_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["tune", str(script_file)]) == 2
    assert "bend: no objective ships for it" in capsys.readouterr().err
