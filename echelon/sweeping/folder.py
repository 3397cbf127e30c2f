"""A sweep's folder: what is swept, a row for each run that is done, and the table of them all.

    sweep.json             what is swept; another sweep is refused
    rows/0000012.json      a run's row, written beside and renamed as soon as the run is done
    rows/0000012.begun     while it runs, how often it has been begun: what is left where everything died at once
    table.csv              all rows in the sweep's order; numbers, words and truths
    table.jsonl            the same as JSON, a line each, lists and tables included
    recordings/0000012     recordings, if they are kept

Nothing in rows or tables depends on the clock, on the executor, or on which run was done first.
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from echelon.errors import InputError
from echelon.recording.layout import replace_file
from echelon.recording.place import lock
from echelon.sweeping.plan import Plan, PlannedRun

Row = dict[str, Any]

DONE, FAILED, WAITING = "done", "failed", "waiting"
"""What has become of a run; only those that are done are not run again."""

FORMAT = "echelon sweep"
VERSION = 1

MANIFEST, ROWS, RECORDINGS = "sweep.json", "rows", "recordings"
TABLE, LINES = "table.csv", "table.jsonl"


class SweepFolder:
    """The folder of a sweep that is under way; made by `open`.

    Attributes:
        path: The folder.
        plan: What is swept.
        rows: Row of each run that has one, by number.
        deaths: How often each run was begun and never came to an end, by number, where that has happened.
    """

    def __init__(self, path: Path, plan: Plan) -> None:
        self.path, self.plan = path, plan
        self.rows: dict[int, Row] = {}
        self.deaths: dict[int, int] = {}

    @classmethod
    @contextmanager
    def open(cls, path: Path, plan: Plan) -> Iterator[SweepFolder]:
        """Make the folder, or go on with it; nobody else can until the context ends.

        Raises:
            InputError: It is the folder of another sweep, or of something else, or is in use, or cannot be written.
        """
        try:
            if path.exists() and not path.is_dir():
                raise InputError(f"{path}: is a file; must be the name of a folder to make, or of this sweep's")
            if not path.exists() and not path.absolute().parent.is_dir():
                raise InputError(f"{path}: cannot be made; there is no folder {path.absolute().parent}")
            path.mkdir(exist_ok=True)
            held = lock(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from None
        try:
            folder = cls(path, plan)
            try:
                folder._begin()
            except OSError as error:
                raise InputError(f"{path}: cannot be written ({error.strerror})") from None
            yield folder
        finally:
            if held is not None:
                os.close(held)

    def _begin(self) -> None:
        manifest, here = self.path / MANIFEST, _manifest(self.plan)
        if manifest.exists():
            self._check_same(manifest, here)
            self._read_rows()
            return
        if any(self.path.iterdir()):
            raise InputError(f"{self.path}: exists and is not a sweep; remove it or choose another place")
        (self.path / ROWS).mkdir()
        replace_file(manifest, (json.dumps(here, indent=1) + "\n").encode())

    def _check_same(self, manifest: Path, here: Mapping[str, Any]) -> None:
        try:
            there = json.loads(manifest.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            there = None
        if not isinstance(there, dict) or there.get("format") != FORMAT:
            raise InputError(f"{manifest}: cannot be read as a sweep's; remove {self.path} or choose another place")
        for key, value in here.items():
            if there.get(key) != value:
                raise InputError(
                    f"{self.path}: holds another sweep ({_difference(key, there.get(key), value)}); "
                    "choose another place, or remove it"
                )

    def _read_rows(self) -> None:
        for run in self.plan.runs:
            path, begun = self._row_path(run.number), self._begun_path(run.number)
            if begun.exists():
                text = begun.read_text(encoding="ascii", errors="replace")
                self.deaths[run.number] = int(text) if text.isdecimal() else 1
            if not path.exists():
                continue
            try:
                row = json.loads(path.read_text(encoding="utf-8"))
            except (OSError, ValueError):
                row = None
            if not isinstance(row, dict) or row.get("status") not in (DONE, FAILED):
                raise InputError(f"{path}: cannot be read as a run's row; remove it to have the run done again")
            self.rows[run.number] = row

    # ---- rows --------------------------------------------------------------------------------------------------------
    def _row_path(self, number: int) -> Path:
        return self.path / ROWS / f"{number:07d}.json"

    def _begun_path(self, number: int) -> Path:
        return self.path / ROWS / f"{number:07d}.begun"

    def begin(self, run: PlannedRun, times: int) -> None:
        """A run is begun for the so many-th time: should everything die now, that is known later."""
        replace_file(self._begun_path(run.number), str(times).encode())

    def take_back(self, run: PlannedRun) -> None:
        """A run is given up in good order, and may be begun again as if it had not been."""
        self._begun_path(run.number).unlink(missing_ok=True)

    def recording_path(self, run: PlannedRun) -> Path:
        """Where a run's recording is kept; the folder above it is made."""
        place = self.path / RECORDINGS
        place.mkdir(exist_ok=True)
        return place / f"{run.number:07d}"

    def keep(self, run: PlannedRun, outcome: Mapping[str, Any]) -> Row:
        """Write the row of a run; returns it.

        Args:
            run: Which.
            outcome: What `run_once` returned.
        """
        row: Row = {"run": run.number, "parameters": dict(run.parameters), "seed": run.seed}
        if "failed" in outcome:
            row |= {"status": FAILED, "why": outcome["failed"], "summary": {}}
        else:
            row |= {"status": DONE, "why": "", "summary": outcome["summary"]}
        replace_file(self._row_path(run.number), (json.dumps(row) + "\n").encode())
        self.take_back(run)
        # As it will be read again: lists for tuples, for one.
        self.rows[run.number] = json.loads(json.dumps(row))
        return self.rows[run.number]

    # ---- the table ---------------------------------------------------------------------------------------------------
    def table(self) -> list[Row]:
        """A row for every run, in order; one that has none yet is "waiting"."""
        waiting = {"status": WAITING, "why": "", "summary": {}}
        return [
            self.rows.get(run.number)
            or {"run": run.number, "parameters": dict(run.parameters), "seed": run.seed, **waiting}
            for run in self.plan.runs
        ]

    def write_table(self) -> Path:
        """Write table.csv and table.jsonl anew; returns the path of the first."""
        table = self.table()
        replace_file(self.path / LINES, "".join(json.dumps(row) + "\n" for row in table).encode())
        replace_file(self.path / TABLE, csv_text(table, self.plan.keys).encode())
        return self.path / TABLE


def csv_text(table: Sequence[Row], keys: Sequence[str]) -> str:
    """A table as CSV: run, parameters, seed, status, what the runs reported, and why some failed.

    Args:
        table: Rows in order.
        keys: The parameters, in order.
    """
    reported = dict.fromkeys(name for row in table for name, value in row["summary"].items() if _flat(value))
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["run", *keys, "seed", "status", *reported, "why"])
    for row in table:
        parameters = [_cell(row["parameters"][key]) for key in keys]
        results = [_cell(row["summary"].get(name)) for name in reported]
        writer.writerow([row["run"], *parameters, row["seed"], row["status"], *results, row["why"]])
    return file.getvalue()


def _flat(value: Any) -> bool:
    return value is None or isinstance(value, bool | int | float | str)


def _cell(value: Any) -> Any:
    """What stands in a cell: numbers to the last digit, lists as JSON, nothing where there is nothing."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return value if isinstance(value, str) else json.dumps(value)


def _manifest(plan: Plan) -> dict[str, Any]:
    """What makes two sweeps the same, as JSON gives it back."""
    import echelon

    first = dict(plan.runs[0].scenario)
    first.pop("seed")
    return json.loads(
        json.dumps(
            {
                "format": FORMAT,
                "version": VERSION,
                "echelon": echelon.__version__,
                "scenario": plan.name,
                "over": {axis.key: list(axis.values) for axis in plan.axes},
                "seeds": list(plan.seeds),
                "first": first,
            }
        )
    )


def _difference(key: str, there: Any, here: Any) -> str:
    """In a few words, in what another sweep differs."""
    if key == "first":
        names = sorted(
            name for name in {*(there or {}), *here} if not isinstance(there, dict) or there.get(name) != here.get(name)
        )
        return f"its scenario differs in {', '.join(names)}"
    texts = [text if len(text) <= 60 else text[:57] + "..." for text in (json.dumps(there), json.dumps(here))]
    return f"its {key} is {texts[0]}, not {texts[1]}"
