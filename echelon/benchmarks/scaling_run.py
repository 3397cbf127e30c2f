"""One crowd of `echelon bench scaling`, measured in a process of its own, so that its memory is its own.

    python -m echelon.benchmarks.scaling_run '{"kind": "hoppers", "agents": 105, "threads": [1, 2]}'

prints the rows as JSON. Runs with one thread and with more take turns, so that a machine that grows slower slows all;
of each the fastest counts. A run is `echelon.simulation.simulate`, recorded to disk like any other. Its time is that of
its frames: what comes before the first and after the last is not in it. Beside each run goes a shorter one that is not
recorded, to see what recording takes of more than one thread.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from echelon.agents.characters import character_named
from echelon.benchmarks.machine import machine_name, package_versions
from echelon.benchmarks.scaling_scenes import KINDS, Kind, Scene, scene_of
from echelon.recording import Recording
from echelon.recording.layout import chunk_frames
from echelon.scenario import Scenario
from echelon.simulation.cost import RunCost
from echelon.simulation.loop import Simulation
from echelon.simulation.recorded import simulate
from echelon.simulation.scene import SceneFrames
from echelon.warp_kernels.emit import host_lanes
from echelon.warp_kernels.frame import ChunkArrays

Row = dict[str, Any]

ROUNDS = 5
ROUND_SECONDS = 1.0  # that a run should last at least [s]
LONG_SECONDS = 6.0  # and need not last longer than, if it has so many chunks as ... [s]
CHUNKS = 4  # ... this: the disk must keep up, and only from the second chunk on is it waited for
LEAST_FRAMES = 24
TRIAL_FRAMES = 6

FALLEN_LIMIT = 0.02
"""Part of a crowd that may fall in a run whose rate counts."""


def measure(kind: Kind, agents: int, threads: Sequence[int], rounds: int = ROUNDS) -> list[Row]:
    """Rows for one crowd, one for each number of threads.

    Args:
        kind: Who.
        agents: How many.
        threads: How many at a time, 0 for as many as are worth it; the first is what the others are measured against.
        rounds: Runs with each.
    """
    with tempfile.TemporaryDirectory(prefix="echelon-scaling-") as name:
        folder = Path(name)
        scene = scene_of(kind, agents, folder)
        trial, _ = _run(scene, TRIAL_FRAMES, threads[0], folder)
        frames = _frames(scene, _frame_seconds(trial, TRIAL_FRAMES), folder)
        few = _unrecorded_frames(_frame_seconds(trial, TRIAL_FRAMES), frames)
        best: dict[int, RunCost] = {}
        unrecorded: dict[int, float] = {}
        found: list[dict[str, Any]] = []
        memory = 0.0
        for turn in range(rounds):
            for count in threads:
                cost, summary = _run(scene, frames, count, folder)
                found.append(summary)
                if not memory:  # of the first run alone, though with what the trial left
                    memory = cost.peak_memory_mb or 0.0
                if turn == 0 or _loop_seconds(cost) < _loop_seconds(best[count]):
                    best[count] = cost
                unrecorded[count] = min(unrecorded.get(count, math.inf), _unrecorded(scene, few, count))
        sane, why = _judged(found, agents)
        best, unrecorded = _pooled(best, unrecorded)
        return [
            _row(scene, frames, count, threads[0], best, unrecorded, memory, sane, why, found[0]) for count in threads
        ]


def _pooled(
    costs: Mapping[int, RunCost], unrecorded: Mapping[int, float]
) -> tuple[dict[int, RunCost], dict[int, float]]:
    """The fastest of all runs that took the same number of threads, whether asked for or chosen: they are the same."""
    alike = {count: [c for c in costs if costs[c].threads == costs[count].threads] for count in costs}
    return (
        {count: min((costs[c] for c in those), key=_loop_seconds) for count, those in alike.items()},
        {count: min(unrecorded[c] for c in those) for count, those in alike.items()},
    )


def _run(scene: Scene, frames: int, threads: int, folder: Path) -> tuple[RunCost, dict[str, Any]]:
    """Simulate so many frames; what it took, and what it came to."""
    scenario = replace(scene.scenario, seconds=frames / scene.scenario.frame_rate)
    cost = RunCost()
    recording: Recording = simulate(scenario, recording=folder / "recording", threads=threads, cost=cost)
    return cost, dict(recording.summary)


def _unrecorded(scene: Scene, frames: int, threads: int) -> float:
    """Seconds of a frame that nobody keeps, over so many from the start."""
    simulation = Simulation(scene.scenario, threads=threads)
    engine = simulation.engine
    engine.bind(ChunkArrays.allocate(1, engine.agent_count, engine.character, engine.device))
    seen = SceneFrames.allocate(1, simulation.scene, engine.agent_count)
    simulation.advance(0, seen)  # captures
    begun = time.perf_counter()
    for _ in range(frames):
        simulation.advance(0, seen)
        seen.events.clear()
    seconds = (time.perf_counter() - begun) / frames
    simulation.close()
    return seconds


def _unrecorded_frames(frame_seconds: float, most: int) -> int:
    return min(max(round(ROUND_SECONDS / frame_seconds), LEAST_FRAMES), most)


def _loop_seconds(cost: RunCost) -> float:
    """All that frames took [s]; writing goes on beside, and waiting for it counts as recording."""
    return sum(seconds for phase, seconds in cost.phase_seconds.items() if phase != "write")


def _frame_seconds(cost: RunCost, frames: int) -> float:
    return _loop_seconds(cost) / (frames + 1)


def _frames(scene: Scene, frame_seconds: float, folder: Path) -> int:
    """How many frames a run has: enough to be timed and to fill several chunks, not more than needed."""
    scenario: Scenario = scene.scenario
    recording = Recording(folder / "recording")
    chunk = chunk_frames(
        scenario.frame_rate,
        scenario.step_count + 1,
        scene.agents,
        len(recording.casts[0].body.links),
        len(recording.actors),
        len(recording.measure_names),
    )
    wanted = max(ROUND_SECONDS / frame_seconds, min(CHUNKS * chunk, LONG_SECONDS / frame_seconds), LEAST_FRAMES)
    return min(round(wanted), scenario.step_count)


def _judged(summaries: Sequence[dict[str, Any]], agents: int) -> tuple[bool, str]:
    """Whether runs were sane, and what was found."""
    if len({summary["state_hash"] for summary in summaries}) > 1:
        return False, "runs with different threads came to different bytes"
    falls, lost = summaries[0]["falls"], summaries[0]["nonfinite"]
    if lost:
        return False, f"{lost} of {agents} agents' states stopped being finite"
    if falls > FALLEN_LIMIT * agents:
        return False, f"{falls} of {agents} agents fell, more than {100 * FALLEN_LIMIT:g} %"
    return True, f"{falls} of {agents} fell" if falls else "nobody fell"


def _row(
    scene: Scene,
    frames: int,
    threads: int,
    first_threads: int,
    costs: Mapping[int, RunCost],
    unrecorded: Mapping[int, float],
    memory: float,
    sane: bool,
    why: str,
    summary: dict[str, Any],
) -> Row:
    """One row.

    Args:
        scene, frames, threads: What was measured; the threads that were asked for.
        first_threads: The number to compare with.
        costs: Of the fastest run with each number of threads that was asked for.
        unrecorded: Time of a frame that is not recorded, likewise [s].
        memory: Most that the process had with the first number of threads [MB].
        sane, why: What was found.
        summary: What the runs came to.
    """
    scenario = scene.scenario
    cost, first = costs[threads], costs[first_threads]
    character = character_named(scenario.crowd.character)
    substeps, tick = scenario.engine.stride(scenario.frame_rate, character.steps_per_second, character.steps_per_tick)
    seconds = _frame_seconds(cost, frames)
    phases = {f"{name}_ms": 1e3 * total / (frames + 1) for name, total in cost.phase_seconds.items()}
    rates = {
        "frame_ms": 1e3 * seconds,
        **phases,
        "agent_us": 1e6 * seconds / scene.agents,
        "substep_us": 1e6 * seconds / (scene.agents * substeps),
        "real_time_factor": 1.0 / (scenario.frame_rate * seconds),
        "speedup": _frame_seconds(first, frames) / seconds,
        "efficiency": first.threads * _frame_seconds(first, frames) / (cost.threads * seconds),
        "unrecorded_ms": 1e3 * unrecorded[threads],
        "unrecorded_efficiency": first.threads * unrecorded[first_threads] / (cost.threads * unrecorded[threads]),
    }
    return {
        "engine": "Echelon",
        "kind": scene.kind,
        "agents": scene.agents,
        "asked_threads": threads,
        "threads": cost.threads,
        "scene": scene.described,
        "integrator": scenario.engine.integrator,
        "precision": scenario.engine.precision,
        "step_seconds": 1.0 / (scenario.frame_rate * substeps),
        "substeps": substeps,
        "tick_seconds": tick / (scenario.frame_rate * substeps),
        "contacts": len(character.body.contacts),
        "lanes": host_lanes(),
        "frames": frames,
        **{name: value if sane else None for name, value in rates.items()},
        "peak_memory_mb": memory or None,
        "falls": summary["falls"],
        "collisions": summary["collisions"],
        "sane": sane,
        "why": why,
        "machine": machine_name(),
        "versions": package_versions(),
    }


def main(arguments: Sequence[str]) -> None:
    """Measure what is asked for, and print the rows."""
    asked = json.loads(arguments[0])
    if asked["kind"] not in KINDS:
        raise SystemExit(f"kind {asked['kind']!r}: must be one of {', '.join(KINDS)}")
    rows = measure(asked["kind"], asked["agents"], asked["threads"], asked.get("rounds", ROUNDS))
    print(json.dumps(rows))


if __name__ == "__main__":
    main(sys.argv[1:])
