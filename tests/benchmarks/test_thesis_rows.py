"""The fidelity report's frame: the published numbers, the rules that judge ours, and what is printed of them."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from echelon.agents.bodies import body_names
from echelon.benchmarks.csv_rows import read_csv
from echelon.benchmarks.thesis import (
    EXPERIMENTS,
    FidelityRow,
    FidelitySettings,
    Measured,
    Published,
    offered_experiments,
    print_tables,
    published_rows,
    run_thesis_benchmark,
    write_files,
)
from echelon.benchmarks.thesis.experiments import chosen_experiments, joined
from echelon.benchmarks.thesis.published import GROUPS
from echelon.benchmarks.thesis.report import verdict
from echelon.benchmarks.thesis.rows import AtLeast, AtMost, Between, Rule, Within, condition_text
from echelon.cli.commands import app
from echelon.errors import InputError

ROWS = [row for one in EXPERIMENTS for row in published_rows(one.name)]


def as_published(settings: FidelitySettings) -> list[Measured]:
    """The inertias, as if ours were the thesis's, but the last, which is 10 % too large."""
    rows = published_rows("tumble-inertia")
    found = [Measured(row, row.thesis) for row in rows[:-1]]
    return [*found, Measured(rows[-1], 1.1 * (rows[-1].thesis or 0.0), "the hips do not flex that far")]


# ---- what was published ----------------------------------------------------------------------------------------------
def test_every_experiment_has_rows_of_bodies_that_ship_and_no_row_twice() -> None:
    assert len({one.name for one in EXPERIMENTS}) == len(EXPERIMENTS)
    for one in EXPERIMENTS:
        assert one.group in GROUPS
        assert published_rows(one.name)
    assert {row.body for row in ROWS} <= set(body_names())
    keys = [(row.experiment, row.body, row.condition, row.quantity, row.unit) for row in ROWS]
    assert len(set(keys)) == len(keys)


def test_a_row_shows_something_to_compare_with() -> None:
    for row in ROWS:
        offsets = row.experiment in ("balance-offset", "balance-backpack")  # curves alone, and nothing asked
        assert offsets or row.thesis is not None or row.human is not None or row.rule is not None


def test_what_was_published_is_as_asked_wherever_the_thesis_has_a_number() -> None:
    for row in ROWS:
        if row.thesis is not None and row.rule is not None:
            assert FidelityRow.of(Measured(row, row.thesis)).met, row


@pytest.mark.parametrize(
    ("experiment", "body", "condition", "quantity", "thesis"),
    [
        ("leap-table", "male", "l_hip 0.45 m, hip -1.8 rad", "rise", 0.948),
        ("leap-table", "female", "l_hip 0.4 m, hip -1.5 rad", "rise", 1.158),
        ("broad-table", "female", "l_hip 0.52 m, offset 0.04 m, shoulder 2.8 rad", "distance", 0.69),
        ("tumble-inertia", "male", "tuck", "inertia", 4.84),
        ("land-speed", "female", "speed 3 m/s", "correction of the feet", -0.06),
        ("land-backpack", "female", "backpack 4 kg, speed -1 m/s", "correction of the feet", -0.105),
        ("land-drop", "male", "", "greatest fall", 1.15),
        ("balance-slope", "male", "direction 180 deg", "steepest slope", 38.6),
        ("dives", "female", "back 1 1/2 with 2 1/2 twists", "twist at entry", 900.0),
        ("forward-somersault", "female", "backpack 4 kg, tuned again", "later opening", -0.12),
    ],
)
def test_numbers_of_the_thesis(experiment: str, body: str, condition: str, quantity: str, thesis: float) -> None:
    found = [
        r.thesis for r in published_rows(experiment) if (r.body, r.condition, r.quantity) == (body, condition, quantity)
    ]
    assert found == [thesis]


def test_what_was_set_can_be_read_as_numbers_and_as_words() -> None:
    assert condition_text({"l_hip [m]": 0.85, "position": "tuck", "trials": 3.0}) == "l_hip 0.85 m, tuck, trials 3"
    row = published_rows("leap-table")[1]
    assert (row.number("l_hip [m]"), row.number("hip [rad]")) == (0.75, -0.5)
    with pytest.raises(ValueError, match="'tuck', not a number"):
        published_rows("tumble-inertia")[2].number("position")


# ---- what is asked of ours -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("rule", "thesis", "good", "bad", "text"),
    [
        (Within(0.05), 0.3, 0.349, 0.351, "0.3 ± 0.05"),
        (Within(relative=0.08), 4.84, 4.84 * 1.079, 4.84 * 0.919, "4.84 ± 8 %"),
        (Within(0.1, of=2.0), None, 1.91, 2.11, "2 ± 0.1"),
        (Within(1.0), 0.0, -0.9, -1.1, "0 ± 1"),
        (AtLeast(), 1.15, 1.15, 1.14, ">= 1.15"),
        (AtLeast(110.0), None, 110.0, 105.0, ">= 110"),
        (AtMost(), 5.8, 5.8, 5.9, "<= 5.8"),
        (Between(-15.0, 0.0), None, -15.0, 0.1, "-15 to 0"),
    ],
)
def test_a_rule_judges_ours(rule: Rule, thesis: float | None, good: float, bad: float, text: str) -> None:
    row = Published("any", "male", {}, "rise", "m", thesis, None, rule)
    assert FidelityRow.of(Measured(row, good)).met is True
    assert FidelityRow.of(Measured(row, bad)).met is False
    assert FidelityRow.of(Measured(row, None, "fell")).met is False
    assert FidelityRow.of(Measured(row, good)).asked == text


def test_without_a_rule_there_is_no_verdict() -> None:
    row = FidelityRow.of(Measured(Published("any", "male", {}, "rise", "m", 1.0), 5.0))
    assert row.met is None
    assert row.asked == ""


@pytest.mark.parametrize("rule", [Within(0.1), AtLeast(), AtMost()])
def test_a_rule_needs_something_to_compare_with(rule: Rule) -> None:
    with pytest.raises(ValueError, match="nothing to compare with"):
        Published("any", "male", {}, "rise", "m", None, None, rule)


def test_no_value_needs_a_reason_and_a_value_is_finite() -> None:
    row = published_rows("tumble-inertia")[0]
    with pytest.raises(ValueError, match="no note"):
        Measured(row, None)
    with pytest.raises(ValueError, match="no finite number"):
        Measured(row, float("nan"))


# ---- what is run -----------------------------------------------------------------------------------------------------
def test_rows_come_in_the_published_order_with_a_verdict() -> None:
    calls: list[tuple[int, int]] = []
    rows = run_thesis_benchmark(
        measured_by={"tumble-inertia": lambda settings: as_published(settings)[::-1]},
        progress=lambda done, total: calls.append((done, total)),
    )
    assert [row.ours for row in rows[:3]] == [18.31, 5.84, 4.84]
    assert [row.met for row in rows] == [True] * 5 + [False]
    assert calls == [(1, 1)]
    assert verdict(rows) == "5 of 6 rows are as asked; 0 more are reported without a verdict."


def test_a_row_left_out_measured_twice_or_strange_is_refused() -> None:
    found = as_published(FidelitySettings())
    with pytest.raises(ValueError, match=r"tuck, inertia: measured 0 times"):
        joined("tumble-inertia", found[:-1])
    with pytest.raises(ValueError, match=r"layout, inertia: measured 2 times"):
        joined("tumble-inertia", [*found, found[0]])
    with pytest.raises(ValueError, match="not published"):
        joined("tumble-inertia", [*found, Measured(published_rows("leap-table")[0], 1.0)])


def test_only_what_is_measured_is_offered_and_can_be_chosen() -> None:
    offered = ["leap-table", "tumble-inertia", "tumble-rate"]
    assert chosen_experiments((), offered) == offered
    assert chosen_experiments(("tumble",), offered) == offered[1:]
    assert chosen_experiments(("tumble-rate", "leap-table"), offered) == ["leap-table", "tumble-rate"]
    with pytest.raises(InputError, match=r"--only land: allowed are leap, tumble, leap-table, tumble-inertia"):
        chosen_experiments(("land",), offered)
    assert set(offered_experiments()) <= {one.name for one in EXPERIMENTS}


# ---- what is shown ---------------------------------------------------------------------------------------------------
def test_tables_name_the_source_and_say_what_is_not_met() -> None:
    rows = run_thesis_benchmark(measured_by={"tumble-inertia": as_published})
    text = io.StringIO()
    print_tables(rows, Console(file=text, width=160))
    lines = text.getvalue().splitlines()
    assert lines[0].strip() == "Figure 5.2: Inertia about the somersault axis (tumble-inertia)"
    last = next(line for line in lines if "2.112" in line)
    assert last.split() == ["female", "tuck", "inertia", "1.92", "2.112", "kg", "m^2", "1.92", "±", "8", "%", "NO"]
    assert any("the hips do not flex that far" in line for line in lines)
    assert lines[-1].startswith("5 of 6 rows")


def test_a_range_of_people_is_a_list_in_json_and_words_in_a_table(tmp_path: Path) -> None:
    row = next(row for row in published_rows("land-drop") if row.human == (5.0, 7.0))
    found = FidelityRow.of(Measured(row, 6.0))
    assert json.loads(json.dumps(found.plain()))["human"] == [5.0, 7.0]
    assert list(found.plain())[:9] == [
        "experiment", "body", "condition", "quantity", "unit", "thesis", "human", "ours", "met",
    ]  # fmt: skip
    (path,) = write_files([found], tmp_path / "thesis")
    assert read_csv(path)[0] == found.plain() | {"human": "5 to 7", "asked": None, "note": None}


def test_the_command_says_which_experiments_there_are() -> None:
    result = CliRunner().invoke(app, ["bench", "thesis", "--only", "nonsense"])
    assert isinstance(result.exception, InputError)
    assert str(result.exception).startswith("--only nonsense: allowed are ")
    result = CliRunner().invoke(app, ["bench", "thesis", "--seeds", "3"])
    assert str(result.exception) == "--seeds: not for bench thesis"
