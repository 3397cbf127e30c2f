"""Scripts as the reference follows them: what `scripts.arrive_function` does, over NumPy columns in float64."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from echelon.warp_kernels.scripts import (
    CAPTURES,
    CLAUSE_SIZE,
    CLAUSES,
    PATH_PARTS,
    TRANSITION_SIZE,
    TRANSITIONS,
    ScriptLayout,
)


def arrive_reference(layout: ScriptLayout, memory: dict[str, np.ndarray], scripts: np.ndarray) -> None:
    """Change rows where it is time, agent by agent.

    Args:
        layout: Of the scripts.
        memory: The controllers' variables by name, shape [agents] each; changed in place.
        scripts: All rows, shape [rows, row size].
    """
    for agent in range(len(memory["row"])):
        _arrive(layout, memory, scripts, agent)


def _arrive(layout: ScriptLayout, memory: Mapping[str, np.ndarray], scripts: np.ndarray, agent: int) -> None:
    first, row = int(memory["first_row"][agent]), int(memory["row"][agent])
    following = first if row < 0 else -1
    if row >= 0:
        for transition in range(TRANSITIONS):
            at = layout.transition_place + transition * TRANSITION_SIZE
            target = int(scripts[row, at])
            clauses = [at + 1 + clause * CLAUSE_SIZE for clause in range(CLAUSES)]
            if target >= 0 and all(_holds(layout, memory, scripts[row], place, agent) for place in clauses):
                following = first + target
                break
    if following < 0:
        return
    reached = scripts[following]
    memory["row"][agent] = following
    memory["row_age"][agent] = 0.0
    memory["arrivals"][agent] += 1.0
    memory["phase"][agent] = reached[layout.phase_place]
    captures = [layout.capture_place + capture * CLAUSE_SIZE for capture in range(CAPTURES)]
    missed = [not _holds(layout, memory, reached, place, agent) for place in captures]
    memory["missed"][agent] = sum(2.0**bit for bit, failed in enumerate(missed) if failed)
    for place, name in enumerate(layout.settings):
        memory[f"row.{name}"][agent] = reached[layout.setting_place + place]
    for name in layout.resets:
        memory[name][agent] = 0.0
    from_measured = reached[layout.start_place] > 0.5
    for place, channel in enumerate(layout.channels):
        if np.isnan(reached[place]):
            continue
        start = memory[f"{'measured' if from_measured else 'wanted'}.{channel}"][agent]
        slope = 0.0 if from_measured else memory[f"wanted_rate.{channel}"][agent]
        values = (start, slope, reached[place], reached[layout.duration_place + place], 0.0)
        for part, value in zip(PATH_PARTS, values, strict=True):
            memory[f"path.{channel}.{part}"][agent] = value


def _holds(layout: ScriptLayout, memory: Mapping[str, np.ndarray], row: np.ndarray, place: int, agent: int) -> bool:
    measure = int(row[place])
    if measure < 0:
        return True
    return bool(row[place + 1] <= memory[layout.measures[measure]][agent] <= row[place + 2])
