"""How a sweep is carried out: as many runs under way as there are workers, each row kept as soon as it is there.

When a worker dies, a pool of processes is lost with all runs that were under way, and nobody can say whose fault it
was. They are tried again, all of them; the last time each alone, so that a run is marked as failed only for what
happened while nothing else ran.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from echelon.errors import InputError
from echelon.scenario import Scenario
from echelon.sweeping.executors import ExecutorName, Pool, start_pool
from echelon.sweeping.folder import DONE, FAILED, Row, SweepFolder
from echelon.sweeping.one_run import run_once
from echelon.sweeping.plan import (
    Axis,
    PlannedRun,
    axis_of_values,
    checked_seeds,
    plan_sweep,
)
from echelon.sweeping.statistics import Point, points_of

Progress = Callable[[int, int], None]
"""Called with (runs done, of how many)."""

ATTEMPTS = 3
"""A run under which workers die so often is marked as failed."""

TABLE_SECONDS = 10.0
"""While runs are going on the table is written anew this often, at most [s]."""


@dataclass(frozen=True)
class SweepResult:
    """What a sweep came to.

    Attributes:
        path: Its folder.
        csv: The table.
        keys: What was varied, the seed aside.
        rows: A row for each run, in order: "run", "parameters", "seed", "status" ("done", "failed" or "waiting"),
            "why" it failed, and "summary" as the run reported it.
        ran: How many were run now; the others had been done before.
    """

    path: Path
    csv: Path
    keys: tuple[str, ...]
    rows: tuple[Row, ...]
    ran: int

    @property
    def failed(self) -> tuple[Row, ...]:
        """Rows of runs that failed."""
        return tuple(row for row in self.rows if row["status"] == FAILED)

    @property
    def points(self) -> tuple[Point, ...]:
        """Mean, least and most over the seeds, for each combination of parameters."""
        return points_of(self.rows)


def sweep(
    scenario: str | PathLike[str] | Scenario,
    *,
    out: str | PathLike[str],
    over: Mapping[str, Iterable[Any]] | Sequence[Axis] = (),
    seeds: Iterable[int] | None = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
    executor: ExecutorName = "processes",
    workers: int | None = None,
    dask_address: str | None = None,
    threads: int = 1,
    keep_recordings: bool = False,
    progress: Progress | None = None,
) -> SweepResult | None:
    """Run a scenario over parameters and seeds; go on with it if it was begun before.

    A program that calls this with processes must be importable, as `multiprocessing` asks: what it does beside
    defining things stands under ``if __name__ == "__main__":``.

    Args:
        scenario: Name of one that ships, path of a .toml file, or a `Scenario`.
        out: Folder of the sweep; one that holds the same sweep is gone on with.
        over: What varies: ``{"herd.spacing": [2.0, 2.5]}``. Every value is combined with every other key's.
        seeds: What happens at random; None takes the scenario's own.
        settings: Other keys of the scenario, for all runs: ``{"seconds": 20.0}``.
        executor: "processes" here, "mpi" under mpiexec, "dask" for a cluster.
        workers: How many runs at a time; None takes one a core, or as many as there are.
        dask_address: Of the Dask scheduler; None starts one here.
        threads: Of each run.
        keep_recordings: Keep every run's recording in the folder, rather than its summary alone.
        progress: Called after each run.

    Returns:
        The table; None in an MPI process other than the first, when all is done.

    Raises:
        InputError: One line that says what is wrong with the scenario, an option, or the folder.
    """
    if threads < 1:
        raise InputError(f"--threads {threads}: must be at least 1")
    with start_pool(executor, workers, dask_address) as pool:
        if pool is None:
            return None
        plan = plan_sweep(
            scenario,
            [axis_of_values(key, values) for key, values in over.items()] if isinstance(over, Mapping) else over,
            None if seeds is None else checked_seeds(seeds),
            _settings(settings),
        )
        with SweepFolder.open(Path(out), plan) as folder:
            todo = [run for run in plan.runs if folder.rows.get(run.number, {}).get("status") != DONE]
            work = _Work(pool, folder, todo, threads, keep_recordings, progress)
            try:
                work.carry_out()
            finally:
                table = folder.write_table()
            return SweepResult(folder.path, table, plan.keys, tuple(folder.table()), len(todo))


def _settings(settings: Mapping[str, Any] | Sequence[str]) -> Sequence[str]:
    if not isinstance(settings, Mapping):
        return settings
    return [f"{key}={axis_of_values(key, [value]).texts[0]}" for key, value in settings.items()]


class _Work:
    """The runs that are still to do, and those under way."""

    def __init__(
        self,
        pool: Pool,
        folder: SweepFolder,
        todo: Sequence[PlannedRun],
        threads: int,
        keep_recordings: bool,
        progress: Progress | None,
    ) -> None:
        self._pool, self._folder, self._threads = pool, folder, threads
        self._keep, self._progress = keep_recordings, progress
        self._written = time.monotonic()
        self._waiting: deque[PlannedRun] = deque()
        self._suspects: deque[PlannedRun] = deque()  # to be tried alone, for the last time
        self._under_way: dict[Future[dict[str, Any]], PlannedRun] = {}
        self._finished = len(folder.plan.runs) - len(todo)
        self._deaths = {run.number: folder.deaths.get(run.number, 0) for run in todo}
        for run in todo:
            self._put(run)

    def carry_out(self) -> None:
        """Until every run has a row."""
        self._report()
        try:
            self._carry_out()
        except BaseException:
            for run in self._under_way.values():
                self._folder.take_back(run)
            raise

    def _carry_out(self) -> None:
        while self._waiting or self._suspects or self._under_way:
            self._fill()
            done, _ = wait(self._under_way, return_when=FIRST_COMPLETED)
            lost: list[PlannedRun] = []
            for future in done:
                run = self._under_way.pop(future)
                error = future.exception()
                if error is None:
                    self._done(run, future.result())
                elif isinstance(error, self._pool.broken):
                    lost.append(run)
                elif isinstance(error, self._pool.refused):
                    self._done(run, {"failed": "workers died under it again and again"})
                else:
                    self._folder.take_back(run)
                    raise error
            if lost:
                self._start_again(lost)

    def _fill(self) -> None:
        """Hand out runs; no more than can be computed at once, so that it is known which were when a worker died."""
        while self._waiting and len(self._under_way) < self._pool.width:
            if not self._submit(self._waiting[0]):
                return
            self._waiting.popleft()
        if self._suspects and not self._under_way and self._submit(self._suspects[0]):
            self._suspects.popleft()

    def _submit(self, run: PlannedRun) -> bool:
        kept = str(self._folder.recording_path(run).absolute()) if self._keep else None
        try:
            future = self._pool.submit(run_once, run.scenario, self._threads, kept, self._pool.scratch)
        except self._pool.broken:
            # A worker died since the last look; whose runs are lost is found out from those under way.
            if not self._under_way:
                self._pool.restart()
            return False
        self._under_way[future] = run
        self._folder.begin(run, self._deaths[run.number] + 1)
        return True

    def _put(self, run: PlannedRun) -> None:
        """Where a run belongs that is to be tried, or tried again."""
        deaths = self._deaths[run.number]
        if deaths >= ATTEMPTS:
            self._done(run, {"failed": f"its process died {ATTEMPTS} times, the last time with nothing else running"})
        else:
            (self._suspects if deaths == ATTEMPTS - 1 else self._waiting).append(run)

    def _start_again(self, lost: list[PlannedRun]) -> None:
        """A worker died, and all runs under way are lost but those that were just done."""
        for future, run in self._under_way.items():
            error = future.exception()
            if error is None:
                self._done(run, future.result())
            else:
                lost.append(run)
        self._under_way.clear()
        self._pool.restart()
        for run in sorted(lost, key=lambda run: run.number):
            self._deaths[run.number] += 1
            self._put(run)

    def _done(self, run: PlannedRun, outcome: Mapping[str, Any]) -> None:
        self._folder.keep(run, outcome)
        self._finished += 1
        self._report()
        if time.monotonic() - self._written > TABLE_SECONDS:
            self._folder.write_table()
            self._written = time.monotonic()

    def _report(self) -> None:
        if self._progress is not None:
            self._progress(self._finished, len(self._folder.plan.runs))
