"""`echelon bench scaling`: what a frame costs, phase by phase, from a few characters to a hundred thousand.

Hoppers in a herd and riders in a peloton (`scaling_scenes`), recorded to disk, with one thread and with all; each size
in a process of its own (`scaling_run`), so that its memory is its own. Other engines follow (`scaling_peers`), each in
a process of its own too: many of the hopper's body at once, in worlds of their own.

A rate counts only if the run was sane: nobody's state stopped being finite, hardly anybody fell, and runs with
different threads came to the same bytes. A row whose run was not sane, or whose engine is not installed, has no rate;
`why` says so.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import echelon
from echelon.benchmarks.machine import machine_name, package_versions
from echelon.benchmarks.scaling_peers import AGENTS as PEER_AGENTS
from echelon.benchmarks.scaling_peers import PACKAGES, WHAT, missing
from echelon.benchmarks.scaling_scenes import KINDS, Kind, sizes_of
from echelon.errors import InputError

Progress = Callable[[int, int], None]
Row = dict[str, Any]

THREADS_MOST = 1024


def run_scaling_benchmark(
    *,
    only: str | None = None,
    most: int | None = None,
    threads: Sequence[int] | None = None,
    progress: Progress | None = None,
) -> list[Row]:
    """Measure frames, phase by phase.

    Args:
        only: One kind of crowd; None measures both, and other engines.
        most: No crowd larger than this.
        threads: How many at a time, 0 for as many as are worth it, up to all cores, as in scenarios; efficiency is
            against the first. None takes one, and as many as are worth it.
        progress: Called with (processes done, of how many).

    Returns:
        Rows of plain data, ready for JSON. "engine" is "Echelon" or another; times in milliseconds a frame
        (`frame_ms`, and `..._ms` of each phase, of which writing goes on beside the others) and microseconds of one
        agent's frame (`agent_us`) and step (`substep_us`).

    Raises:
        InputError: There is no such kind, no crowd is so small, or a number of threads is out of range.
        RuntimeError: A process that measures a crowd fails.
    """
    counts = _checked_threads(threads)
    kinds: tuple[Kind, ...] = tuple(kind for kind in KINDS if only is None or only == kind)
    if not kinds:
        raise InputError(f"--only {only}: must be one of {', '.join(KINDS)} for bench scaling")
    smallest = {kind: sizes_of(kind, None)[0] for kind in kinds}
    if most is not None and most < min(smallest.values()):
        raise InputError(f"--most {most}: must be at least {min(smallest.values())}, the smallest crowd")
    jobs: list[Callable[[], list[Row]]] = []
    for kind in kinds:
        for size in sizes_of(kind, most) if most is None or most >= smallest[kind] else ():
            jobs.append(lambda kind=kind, size=size: _crowd(kind, size, counts))
    if only != "riders":
        agents = PEER_AGENTS if most is None else min(PEER_AGENTS, most)
        jobs += [lambda engine=engine: _peer(engine, agents, counts) for engine in PACKAGES]
    rows: list[Row] = []
    for done, job in enumerate(jobs):
        if progress is not None:
            progress(done, len(jobs))
        rows += job()
    if progress is not None:
        progress(len(jobs), len(jobs))
    return rows


def threads_of_text(text: str) -> tuple[int, ...]:
    """Numbers of threads from "1,2,4".

    Raises:
        InputError: They are none.
    """
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts):
        raise InputError(f"--threads {text}: must be numbers of threads, as in 1,2,4")
    return _checked_threads([int(part) for part in parts])


def _checked_threads(threads: Sequence[int] | None) -> tuple[int, ...]:
    if threads is None:
        threads = (1, 0)
    for count in threads:
        if not 0 <= count <= THREADS_MOST:
            raise InputError(f"--threads {count}: must be from 0, as many as are worth it, to {THREADS_MOST}")
    if not threads:
        raise InputError("--threads: must be at least one number")
    return tuple(dict.fromkeys(threads))


# ---- processes -------------------------------------------------------------------------------------------------------
def _crowd(kind: Kind, agents: int, threads: Sequence[int]) -> list[Row]:
    return _in_a_process("scaling_run", {"kind": kind, "agents": agents, "threads": list(threads)})


def _peer(engine: str, agents: int, threads: Sequence[int]) -> list[Row]:
    why = missing(engine)
    if not why:
        try:
            # They do not decide by work: all cores.
            counts = list(dict.fromkeys(count or os.cpu_count() or 1 for count in threads))
            return _in_a_process("scaling_peers", {"engine": engine, "agents": agents, "threads": counts})
        except RuntimeError as error:  # another version of it, that works otherwise: the rest is measured all the same
            why = str(error)
    return [
        {
            "engine": engine,
            "kind": "hoppers",
            "agents": agents,
            "threads": None,
            "scene": WHAT,
            "substep_us": None,
            "sane": None,
            "why": why,
            "machine": machine_name(),
            "versions": package_versions(),
        }
    ]


def _in_a_process(module: str, asked: dict[str, Any]) -> list[Row]:
    """Rows that a module of this room prints.

    Raises:
        RuntimeError: The process fails; the message is the last line that it wrote.
    """
    above = str(Path(echelon.__file__).parent.parent)
    path = os.pathsep.join(entry for entry in (above, os.environ.get("PYTHONPATH")) if entry)
    done = subprocess.run(
        [sys.executable, "-m", f"echelon.benchmarks.{module}", json.dumps(asked)],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        raise RuntimeError(f"{json.dumps(asked)}: measuring it failed: {lines[-1] if lines else 'no message'}")
    return json.loads(done.stdout.splitlines()[-1])
