"""A soak: a large crowd for a long time, recorded all the while, with the memory of the process sampled.

    python -m echelon.benchmarks.soak --agents 10000 --minutes 10

Memory is to be *flat*: once the first chunks of the recording have been written, it grows no more. That is judged by
the straight line through the samples of the second half of the run.

The run is an ordinary one, written to disk for real: every frame of every agent, checkpoints and events. Ten thousand
agents leave some forty gigabytes in ten minutes, so chunks that have been written are *hollowed out* (``--record
hollow``, the default): their files keep their size and give their blocks back to the disk, all but the last few. With
``--record keep`` everything stays.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from echelon.benchmarks.machine import machine_name, package_versions
from echelon.errors import InputError
from echelon.scenario import Scenario
from echelon.simulation import simulate

Record = Literal["hollow", "keep"]
Progress = Callable[[int, int], None]

SAMPLES = 600  # of the memory, in a run
KEPT_CHUNKS = 3  # the last ones are not hollowed out
FLAT_SHARE = 0.01  # of the memory, by which the second half of the run may grow...
FLAT_MEGABYTES = 4.0  # ... or this much [MB]: what allocators do on their own
MEGABYTE = 2**20


@dataclass(frozen=True)
class Soak:
    """What a soak came to.

    Attributes:
        agents: How many.
        seconds: Simulated [s].
        wall_seconds: That it took [s].
        falls, nonfinite: As the run's summary has them.
        written_gb: What was written to disk in all [GB].
        first_mb: Memory at the first sample, after the first frame [MB].
        settled_mb: Memory in the middle of the run [MB].
        largest_mb: The most at any sample [MB].
        last_mb: At the last one [MB].
        slope_mb_per_minute: Of the line through the second half, for each simulated minute [MB].
        growth_mb: What that line rises by over the second half [MB].
        flat: Whether that is next to nothing.
        samples: (simulated seconds, MB) of each sample.
    """

    agents: int
    seconds: float
    wall_seconds: float
    falls: int
    nonfinite: int
    written_gb: float
    first_mb: float
    settled_mb: float
    largest_mb: float
    last_mb: float
    slope_mb_per_minute: float
    growth_mb: float
    flat: bool
    samples: tuple[tuple[float, float], ...]


def resident_megabytes() -> float:
    """Memory of this process that is in use [MB]; where the system does not say, the most it ever was."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / MEGABYTE
    except OSError:
        import resource

        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return most / MEGABYTE if sys.platform == "darwin" else most / 1024.0


def soak_scenario(agents: int, seconds: float) -> Scenario:
    """A herd that wanders over a field that is large enough for it."""
    half = 60.0 + 2.0 * agents**0.5
    return Scenario.load(
        "herd",
        [
            *(f"crowd.count={agents}", f"seconds={seconds}", "name=soak"),
            *(f"world.half_length={1.5 * half:.0f}", f"world.half_width={half:.0f}"),
        ],
    )


def soak(
    agents: int = 10_000,
    minutes: float = 10.0,
    *,
    record: Record = "hollow",
    folder: Path | None = None,
    threads: int = 0,
    progress: Progress | None = None,
) -> Soak:
    """Run one.

    Args:
        agents: How many.
        minutes: To simulate [min].
        record: Whether what is written stays.
        folder: Where to write; None for a temporary folder beside other temporary files.
        threads: 0 decides by the work there is.
        progress: Called with (frames done, of how many).

    Raises:
        InputError: It cannot be written there.
        RecordingFailed: Writing failed on the way.
    """
    plan = soak_scenario(agents, 60.0 * minutes)
    place = Path(tempfile.mkdtemp(prefix="echelon-soak-")) if folder is None else folder
    watch = _Watch(place / "soak.recording", plan, record, progress)
    begun = time.perf_counter()
    try:
        recording = simulate(plan, recording=watch.path, threads=threads, progress=watch)
        summary, written = recording.summary, watch.written()
    finally:
        if folder is None:
            shutil.rmtree(place, ignore_errors=True)
    return _judged(agents, time.perf_counter() - begun, summary, written, watch.samples)


class _Watch:
    """Samples memory and hollows out chunks as a run goes on."""

    def __init__(self, path: Path, plan: Scenario, record: Record, progress: Progress | None) -> None:
        self.path = path
        self.samples: list[tuple[float, float]] = []
        self._rate = plan.frame_rate
        self._every = max(1, plan.step_count // SAMPLES)
        self._record, self._progress = record, progress
        # Of each array the next chunk to hollow out, and how the names of its chunks end.
        self._arrays: dict[str, tuple[int, str]] = {}

    def __call__(self, done: int, total: int) -> None:
        if done % self._every == 1 or done == total or self._every == 1:
            self.samples.append(((done - 1) / self._rate, resident_megabytes()))
        if self._record == "hollow" and done % self._rate == 0:
            self._hollow_out()
        if self._progress is not None:
            self._progress(done, total)

    def written(self) -> int:
        """How large all files of the recording are together [bytes]."""
        return sum(file.stat().st_size for file in self.path.rglob("*") if file.is_file())

    def _hollow_out(self) -> None:
        """Give back the blocks of all chunks but the last few of each array."""
        for folder in (entry for entry in self.path.iterdir() if entry.is_dir()):
            if folder.name not in self._arrays:
                first = next(folder.glob("c.0*"), None)
                if first is None or first.suffix == ".part":
                    continue
                self._arrays[folder.name] = (0, first.name.removeprefix("c.0"))
            index, rest = self._arrays[folder.name]
            while (folder / f"c.{index + KEPT_CHUNKS}{rest}").exists():
                file = folder / f"c.{index}{rest}"
                size = file.stat().st_size
                os.truncate(file, 0)
                os.truncate(file, size)
                index += 1
            self._arrays[folder.name] = (index, rest)


def _judged(
    agents: int, wall: float, summary: dict[str, Any], written: int, samples: Sequence[tuple[float, float]]
) -> Soak:
    times, sizes = np.array(samples).T
    late = times >= 0.5 * times[-1]
    span = float(times[late][-1] - times[late][0])
    slope = float(np.polyfit(times[late], sizes[late], 1)[0]) if span > 0.0 else 0.0
    settled = float(sizes[late][0])
    growth = slope * span
    return Soak(
        agents=agents,
        seconds=float(summary["seconds"]),
        wall_seconds=wall,
        falls=int(summary["falls"]),
        nonfinite=int(summary["nonfinite"]),
        written_gb=written / 1e9,
        first_mb=float(sizes[0]),
        settled_mb=settled,
        largest_mb=float(sizes.max()),
        last_mb=float(sizes[-1]),
        slope_mb_per_minute=60.0 * slope,
        growth_mb=growth,
        flat=growth <= max(FLAT_SHARE * settled, FLAT_MEGABYTES),
        samples=tuple(samples),
    )


def soak_text(found: Soak) -> str:
    """A soak in a few lines."""
    return "\n".join(
        [
            f"{found.agents} hoppers, {found.seconds / 60.0:.3g} simulated minutes in {found.wall_seconds:.0f} s, "
            f"{found.written_gb:.3g} GB written; {found.falls} falls, {found.nonfinite} not finite",
            f"memory: {found.first_mb:.0f} MB at first, {found.settled_mb:.0f} MB half way, {found.last_mb:.0f} MB at "
            f"the end, {found.largest_mb:.0f} MB at most",
            f"second half: {found.slope_mb_per_minute:+.3f} MB a minute, {found.growth_mb:+.2f} MB in all: "
            f"{'flat' if found.flat else 'NOT FLAT'}",
            f"{machine_name()}; {package_versions()}",
        ]
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run as a program; returns its exit code, 1 where memory was not flat."""
    parser = argparse.ArgumentParser(
        prog="python -m echelon.benchmarks.soak", description="A soak: a large crowd for a long time."
    )
    parser.add_argument("--agents", type=int, default=10_000)
    parser.add_argument("--minutes", type=float, default=10.0, help="to simulate")
    parser.add_argument("--record", choices=("hollow", "keep"), default="hollow", help="whether what is written stays")
    parser.add_argument("--folder", type=Path, help="where to write; a temporary one otherwise")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="one JSON object, with all samples")
    options = parser.parse_args(arguments)

    def show(done: int, total: int) -> None:
        if done % 300 == 0 or done == total:
            print(f"\r{done} of {total} frames, {resident_megabytes():.0f} MB", end="", file=sys.stderr, flush=True)

    try:
        found = soak(
            options.agents,
            options.minutes,
            record=options.record,
            folder=options.folder,
            threads=options.threads,
            progress=None if options.json else show,
        )
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if not options.json:
        print(file=sys.stderr)
    print(json.dumps(asdict(found)) if options.json else soak_text(found))
    return 0 if found.flat else 1


if __name__ == "__main__":
    sys.exit(main())
