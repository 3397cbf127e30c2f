"""What `echelon bench engine` found, for people: a table on the terminal, CSV files, a page of the documentation.

    python -m echelon.benchmarks.engine_report docs/benchmarks MACHINE

measures this machine into ``docs/benchmarks/MACHINE/engine.csv`` and writes ``docs/benchmarks/engine.md`` anew from
the files of all machines; without MACHINE it only does the latter.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from echelon.benchmarks.csv_rows import Row, read_csv, write_csv
from echelon.benchmarks.engine import LARGEST_STEP, SAME_STEP, run_engine_benchmark


def _number(key: str, digits: int, scale: float = 1.0) -> Callable[[Row], str]:
    """A column of numbers; three digits where more would be noise, a dash where there is none."""

    def text(row: Row) -> str:
        value = row.get(key)
        return "–" if value is None else f"{scale * value:,.{digits}f}"

    return text


def _plain(key: str) -> Callable[[Row], str]:
    return lambda row: "–" if row.get(key) is None else str(row[key])


Column = tuple[str, Callable[[Row], str]]

COLUMNS_A_STEP: tuple[Column, ...] = (
    ("body", _plain("body")),
    ("integrator", _plain("integrator")),
    ("step [ms]", _number("step_seconds", 3, 1e3)),
    ("contact sites", lambda row: f"{row['contacts']} / {_plain('peer_contacts')(row)}"),
    ("Echelon [µs]", _number("substep_us", 4)),
    ("MuJoCo [µs]", _number("peer_step_us", 2)),
    ("its integrator", _plain("peer_integrator")),
    ("ratio", _number("ratio", 1)),
)
COLUMNS_A_SECOND: tuple[Column, ...] = (
    ("body", _plain("body")),
    ("step [ms]", _number("step_seconds", 3, 1e3)),
    ("Echelon [µs]", _number("substep_us", 4)),
    ("s per s", _number("real_time_factor", 0)),
    ("step [ms]", _number("peer_step_seconds", 3, 1e3)),
    ("MuJoCo [µs]", _number("peer_step_us", 2)),
    ("s per s", _number("peer_real_time_factor", 0)),
    ("its integrator", _plain("peer_integrator")),
    ("ratio", lambda row: _ratio_of_seconds(row)),
)
WORDS = ("body", "integrator", "its integrator")
"""Headings of columns that hold words, not numbers."""

SECTIONS: tuple[tuple[str, str, tuple[Column, ...]], ...] = (
    (SAME_STEP, "One agent's step of the same length", COLUMNS_A_STEP),
    (LARGEST_STEP, "Seconds of one agent's life a second, each engine at its largest sane step", COLUMNS_A_SECOND),
)
"""For each measure its title, and headings with units with what stands below them."""


def _ratio_of_seconds(row: Row) -> str:
    ours, theirs = row.get("real_time_factor"), row.get("peer_real_time_factor")
    return "–" if ours is None or theirs is None else f"{ours / theirs:,.1f}"


def what_was_measured(rows: Sequence[Row]) -> str:
    """One line: on which machine, how much of it, with which versions."""
    if not rows:
        return "Nothing was measured."
    row = rows[0]
    peer = f", {row['peer']} ({row['peer_precision']})" if row.get("peer") else ""
    return (
        f"One agent's substep (one core, {row['agents']} agents at once in {row['lanes']} lanes of {row['precision']}, "
        f"recording included) on {row['machine']}; {row['versions']}{peer}."
    )


def compile_times(rows: Sequence[Row]) -> list[str]:
    """One line on compilation, if it was measured."""
    found = [
        f"{row['body']} {row['compile_seconds']:.1f} s ({row['load_seconds']:.2f} s from the cache)"
        for row in rows
        if row["compile_seconds"] is not None and row["measure"] == SAME_STEP
    ]
    return [f"First compilation after Warp's own start-up: {', '.join(found)}."] if found else []


def remarks(rows: Sequence[Row]) -> list[str]:
    """A line for every rate that is not given, and one if there was nobody to compare with."""
    lines = []
    for row in rows:
        here = f"{row['body']} ({row['measure']}, {row['integrator']})"
        if not row["sane"]:
            lines.append(f"{here}: no rate, since {row['why']}.")
        if row.get("peer_sane") is False:
            lines.append(f"{here}: no rate of MuJoCo's, since {row['peer_why']}.")
    absent = sorted({row["peer_why"] for row in rows if row.get("peer") is None})
    return [*lines, *(f"{why}." for why in absent)]


def print_table(rows: Sequence[Row], console: Console | None = None) -> None:
    """Print what `run_engine_benchmark` returned: a table, what was measured, and why a rate is missing."""
    console = console or Console()
    for measure, title, columns in SECTIONS:
        chosen = [row for row in rows if row["measure"] == measure]
        if not chosen:
            continue
        table = Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), title_justify="left")
        for heading, text in columns:
            # As narrow as can be, for narrow terminals: headings wrap, what stands below them does not. Brackets hold
            # units here, not markup.
            width = max(map(len, [*heading.split(), *(text(row) for row in chosen)]))
            table.add_column(Text(heading), justify="left" if heading in WORDS else "right", width=width)
        for row in chosen:
            table.add_row(*(text(row) for _, text in columns))
        console.print(table)
    for line in (what_was_measured(rows), *compile_times(rows), *remarks(rows)):
        console.print(line, markup=False, highlight=False)


# ---- files -----------------------------------------------------------------------------------------------------------
def page(folder: Path) -> str:
    """The documentation's page, in Markdown, from every machine's ``engine.csv`` in a folder."""
    parts = [PAGE]
    for path in sorted(folder.glob("*/engine.csv")):
        rows = read_csv(path)
        parts.append(f"## {path.parent.name}\n\n{what_was_measured(rows)}\n")
        for measure, title, columns in SECTIONS:
            lines = [" | ".join(heading for heading, _ in columns), " | ".join("---" for _ in columns)]
            lines += [" | ".join(text(row) for _, text in columns) for row in rows if row["measure"] == measure]
            parts.append(f"{title}:\n\n" + "\n".join(f"| {line} |" for line in lines) + "\n")
        parts += [f"{line}\n" for line in compile_times(rows)]
        notes = [
            f"* {row['body']}, {row['measure']}, {row['integrator']}: {row['why']}; MuJoCo: {row['peer_why']}."
            for row in rows
        ]
        parts.append("\n".join(notes) + "\n")
    return "\n".join(parts)


def write_page(folder: Path) -> Path:
    """Write ``engine.md`` in a folder from the machines' files there; returns its path."""
    path = folder / "engine.md"
    beside = path.with_name(f".{path.name}.new")
    beside.write_text(page(folder), encoding="utf-8")
    os.replace(beside, path)
    return path


PAGE = """\
# The engine's speed

`echelon bench engine` races Echelon's engine against [MuJoCo](https://mujoco.org) on the same bodies, in the same run,
on one core. The two take turns second by second, and what stands here are medians.

* **hopper**: our whole substep (control, contact, dynamics, integration) while robots hop at 0, 1 and 2 m/s in all
  directions. MuJoCo's step is of the same body, set down on its foot again and again so that it is in contact, with
  leg spring and hip springs, but without control, joint limits or walls.
  Contact sites are ours / MuJoCo's: foot, belly and the sphere that walls stop, which MuJoCo does without.
* **cyclist**: our whole substep (steering and pedalling, two wheels whose ground is looked up in a road's quadtree each
  control tick, springs at hands and feet, chain, dynamics, integration) while riders ride at 6 m/s on a road that goes
  up and down. MuJoCo's step is of the same body, 28 degrees of freedom, with `connect` constraints at hands and feet, a
  `joint` constraint for the chain and the same ellipsoids for wheels on a plane. In place of servos there are springs
  and dampers of the same gains at the pose of the start, at hips and knees, which pedals carry round, dampers alone. It
  is without control, air, and what touches the ground in a fall; so it is set rolling at 6 m/s, its cranks at one angle
  and another, and anew after 0.5 s, before it tips over.
* **gymnast**: our whole substep (the script that it follows, balance, a servo at every joint, twelve points of the
  soles that bear it and nineteen more that meet the ground in a fall, dynamics, integration) while people stand and
  hold their balance. MuJoCo's step is of the same body, 53 degrees of freedom, on twelve small spheres on a plane, with
  springs and dampers of the servos' gains at the pose of the start. It is without control and without what touches the
  ground in a fall; its ankles' springs hold it up, and it is set down anew after 0.25 s.
* **male**, **female**: servos and dynamics in free flight, 53 degrees of freedom. MuJoCo has a spring and damper of the
  same gains at every joint; its constraints are switched off.

Both count one agent's step. Ours computes in float32, many agents at once in the lanes of a vector register; MuJoCo
computes one agent in float64. MuJoCo uses whichever of its Euler, implicitfast and discrete integrators is the fastest
that is sane, Euler also with explicit damping ("plain euler"), which saves it a factorisation. Its solver is Newton's
with pyramidal cones and a dense Jacobian, its search for islands switched off. For the rider CG and PGS, elliptic
cones, a sparse Jacobian, and cylinders for wheels were tried; none is faster as long as the solver may converge. CG
that is cut off after two iterations is, by an eighth, and looks sane, but it is no longer the same motion: joint speeds
are off by up to 3 rad/s. What the step of 1/1200 s costs, against much smaller ones, is 0.04 rad/s in both engines.

A rate per step rewards small steps. *Largest sane step* therefore gives each engine the largest step of a short ladder
up to which it stayed sane, and "s per s" is how many seconds of one agent's life a second of computing gives.

**Sane** means for both that everything is finite and every quaternion of unit length. In flight, angular momentum
drifts by at most 2 % a second and the energy about the centre of mass does not rise by more than 1 %. Our hoppers must
all stand and hold their mean velocity within 0.15 m/s, over 20 s (10 s on the ladder). MuJoCo's hopper, which has no
control, must not fall and its energy must not rise, set down and dropped from a hop's height; its step is no longer
than the 1/120 s in which control must be able to act. Our gymnasts must all stand, the centre of mass within 5 cm of
the middle of the feet; MuJoCo's may move it by 3 cm and must bear on its feet. Of riders, ours and MuJoCo's, no hand or
foot may be more than a centimetre from where it belongs, and nobody may lean by more than 5 degrees. Ours must not fall
and must hold their speed within 0.3 m/s at every frame; MuJoCo's must stay on both wheels, slip by no more than 0.1
m/s, and its energy must not rise. A run that is not sane has no rate.

Compilation is timed from a character to a kernel that can be launched, with an empty kernel cache but after Warp's own
start-up and precompiled header, and again in the next process, from the cache.

Made by `python -m echelon.benchmarks.engine_report docs/benchmarks MACHINE`, which also writes a machine's CSV file.
"""


def main(arguments: Sequence[str]) -> None:
    """Measure and write (see the module's text)."""
    if len(arguments) not in (1, 2):
        raise SystemExit("usage: python -m echelon.benchmarks.engine_report FOLDER [MACHINE]")
    folder = Path(arguments[0])
    if len(arguments) == 2:
        rows = run_engine_benchmark(progress=lambda done, total: print(f"{done} of {total}", file=sys.stderr))
        print_table(rows)
        write_csv(rows, folder / arguments[1] / "engine.csv")
    print(write_page(folder))


if __name__ == "__main__":
    main(sys.argv[1:])
