"""Which captures failed: what a row of a script says should hold on arrival, and did not.

A transition leads on whether or not the captures of the row that it leads to hold; that they did not says why a landing
went wrong. The engine notes with each arrival which of them failed and what they asked about, and the recording keeps
that frame by frame. An agent that arrives in several rows within one frame tells of the last.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.measures import MEASURES
from echelon.errors import InputError
from echelon.recording import Recording
from echelon.scenario import Scenario
from echelon.simulation.casts import casts_of
from echelon.simulation.roles import Role, roles_of
from echelon.warp_kernels.scripts import CAPTURED, CLAUSE_SIZE

START = "start"
"""Where who arrives in the first row of a script comes from."""


@dataclass(frozen=True)
class MissedCapture:
    """A capture that failed.

    Attributes:
        time: Of the frame in which the agent arrived [s].
        agent: Its number.
        cast: Whose it is.
        maneuver: What it performs.
        from_row, to_row: Names of rows of its script; `from_row` is that of the frame before.
        measure: What the capture asks about.
        measured: What that was on arrival.
        least, most: Between which it should have been.
    """

    time: float
    agent: int
    cast: str
    maneuver: str
    from_row: str
    to_row: str
    measure: str
    measured: float
    least: float
    most: float

    def as_dict(self) -> dict[str, Any]:
        """Plain data; a bound that is infinite is None."""
        return {key: None if value in (np.inf, -np.inf) else value for key, value in asdict(self).items()}

    def __str__(self) -> str:
        allowed = (
            f"at most {self.most:.4g}"
            if self.least == -np.inf
            else f"at least {self.least:.4g}"
            if self.most == np.inf
            else f"{self.least:.4g} to {self.most:.4g}"
        )
        return (
            f"{self.time:.2f} s, agent {self.agent} ({self.cast}), {self.maneuver}, {self.from_row} -> {self.to_row}: "
            f"{self.measure} was {self.measured:.4g}, should be {allowed}"
        )


def missed_captures(recording: Recording) -> list[MissedCapture]:
    """Every capture that failed in a recording, by time and agent.

    Raises:
        InputError: Nobody in it follows a script, or it is damaged.
    """
    scenario = Scenario.from_dict(recording.scenario, source=str(recording.path))
    if not scenario.performs:
        raise InputError(f"{recording.path}: nobody in this recording follows a script; must be one of gymnasts")
    casts = casts_of(scenario)
    roles = roles_of(scenario, casts)
    tables, which = roles.tables
    rows = tables.shape[1]
    names = {agent: cast.name for cast in casts for agent in cast.agents}
    place = Gymnast.script.capture_place
    found: list[MissedCapture] = []
    for frame, agent, before, here, missed, captured in _arrivals(recording):
        role = roles.each[agent]
        to_row = int(here) % rows
        for index in np.flatnonzero((int(missed) >> np.arange(len(CAPTURED))) & 1).tolist():
            clause = tables[which[agent], to_row, place + index * CLAUSE_SIZE : place + (index + 1) * CLAUSE_SIZE]
            found.append(
                MissedCapture(
                    frame / recording.frame_rate,
                    agent,
                    names[agent],
                    role.maneuver,
                    _row_name(role, int(before), rows),
                    role.row_names[to_row],
                    MEASURES[int(clause[0])],
                    float(captured[index]),
                    float(clause[1]),
                    float(clause[2]),
                )
            )
    return found


def _row_name(role: Role, row: int, rows: int) -> str:
    return START if row < 0 else role.row_names[row % rows]


def _arrivals(recording: Recording) -> Iterator[tuple[int, int, float, float, float, np.ndarray]]:
    """Frame, agent, row before, row, failed captures as bits, and what they asked about, where any failed."""
    column = {name: place for place, name in enumerate(recording.measure_names)}
    captured = [column[name] for name in CAPTURED]
    last: np.ndarray | None = None
    for first in range(0, recording.frame_count, recording.chunk_frames):
        chunk = recording.measures[first : first + recording.chunk_frames]
        arrivals, rows, missed = (chunk[:, :, column[name]] for name in ("arrivals", "row", "missed"))
        before = np.concatenate([chunk[:1] if last is None else last, chunk[:-1]])
        arrived = (arrivals != before[:, :, column["arrivals"]]) & (missed > 0.5)
        for frame, agent in np.argwhere(arrived).tolist():
            row_before = float(before[frame, agent, column["row"]])
            yield (
                first + frame,
                agent,
                row_before,
                float(rows[frame, agent]),
                float(missed[frame, agent]),
                chunk[frame, agent, captured],
            )
        last = chunk[-1:]
