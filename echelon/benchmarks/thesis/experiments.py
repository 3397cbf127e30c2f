"""Which experiments are measured, and how: the measuring modules, and what runs them.

A measuring module has the name of a group and holds ``MEASURES``: for each experiment a function that is given the
settings and returns one `Measured` for each of the experiment's published rows. An experiment for which there is none
is not offered.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from echelon.benchmarks.thesis.published import EXPERIMENTS, GROUPS, published_rows
from echelon.benchmarks.thesis.rows import FidelityRow, Measured
from echelon.errors import InputError

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class FidelitySettings:
    """How experiments are run.

    Attributes:
        threads: Threads of a batch of trials; None for as many as are worth it.
        steps_per_second: Substeps a second [1/s]; None for the body's own. Another number shows what the step changes.
    """

    threads: int | None = None
    steps_per_second: int | None = None


Measure = Callable[[FidelitySettings], Sequence[Measured]]


def measures() -> dict[str, Measure]:
    """Measuring functions by experiment, in the thesis's order.

    Raises:
        ValueError: A module measures an experiment that is not of its group.
    """
    found: dict[str, Measure] = {}
    for group in GROUPS:
        module = f"{__package__}.{group}"
        if importlib.util.find_spec(module) is not None:
            found |= _of_group(group, importlib.import_module(module).MEASURES)
    return {one.name: found[one.name] for one in EXPERIMENTS if one.name in found}


def _of_group(group: str, given: Mapping[str, Measure]) -> Mapping[str, Measure]:
    strange = set(given) - {one.name for one in EXPERIMENTS if one.group == group}
    if strange:
        raise ValueError(f"{group}: {', '.join(sorted(strange))}: no experiment of this group")
    return given


def offered_experiments() -> tuple[str, ...]:
    """Names of the experiments that are measured, in the thesis's order."""
    return tuple(measures())


def chosen_experiments(only: Sequence[str], offered: Sequence[str]) -> list[str]:
    """Names that are asked for, in the order in which they are offered.

    Args:
        only: Names of experiments or of groups; all if there are none.
        offered: Names to choose from.

    Raises:
        InputError: A word names nothing that is offered.
    """
    group_of = {one.name: one.group for one in EXPERIMENTS}
    for word in only:
        if not any(word in (name, group_of[name]) for name in offered):
            allowed = [*(group for group in GROUPS if any(group_of[name] == group for name in offered)), *offered]
            raise InputError(f"--only {word}: allowed are {', '.join(allowed) or 'none yet'}")
    return [name for name in offered if not only or name in only or group_of[name] in only]


def run_thesis_benchmark(
    *,
    only: Sequence[str] = (),
    settings: FidelitySettings | None = None,
    progress: Progress | None = None,
    measured_by: Mapping[str, Measure] | None = None,
) -> list[FidelityRow]:
    """Run experiments; their rows in the order in which they were published.

    Args:
        only: Names of experiments or of groups; all that are offered if there are none.
        settings: How to run them.
        progress: Called with (experiments done, experiments).
        measured_by: Measuring functions by experiment to use instead of those that ship.

    Raises:
        InputError: A word in ``only`` names nothing that is offered.
        ValueError: A measuring function left out a published row, or measured another one.
    """
    functions = measures() if measured_by is None else measured_by
    todo = chosen_experiments(only, list(functions))
    rows: list[FidelityRow] = []
    for done, name in enumerate(todo):
        rows += joined(name, functions[name](settings or FidelitySettings()))
        if progress is not None:
            progress(done + 1, len(todo))
    return rows


def joined(experiment: str, found: Sequence[Measured]) -> list[FidelityRow]:
    """Rows of an experiment: each published one with what was measured for it.

    Raises:
        ValueError: A published row was measured not at all or twice, or what was measured is of another experiment.
    """
    by_row = {one.row: one for one in found}
    published = published_rows(experiment)
    for row in (*published, *by_row):
        count = sum(one.row == row for one in found)
        if count != 1 or row not in published:
            wrong = f"measured {count} times" if row in published else "not published"
            raise ValueError(f"{experiment}: {row.body}, {row.condition}, {row.quantity}: {wrong}")
    return [FidelityRow.of(by_row[row]) for row in published]
