"""A sweep's table in short: for each combination of parameters the mean, least and most over its seeds."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

DONE = "done"


@dataclass(frozen=True)
class Spread:
    """Of a number over runs.

    Attributes:
        mean, least, most: In the number's own unit.
    """

    mean: float
    least: float
    most: float


@dataclass(frozen=True)
class Point:
    """One combination of parameters.

    Attributes:
        parameters: Value of each, by key.
        runs: How many there are, whatever became of them.
        done: How many are done; the numbers are of these.
        numbers: Spread of each number that runs report; of a truth, 1 for true and 0 for false.
    """

    parameters: Mapping[str, Any]
    runs: int
    done: int
    numbers: Mapping[str, Spread]

    def plain(self) -> dict[str, Any]:
        """As plain data, for JSON."""
        numbers = {name: {"mean": s.mean, "min": s.least, "max": s.most} for name, s in self.numbers.items()}
        return {"parameters": dict(self.parameters), "runs": self.runs, "done": self.done, "numbers": numbers}


def points_of(rows: Sequence[Mapping[str, Any]]) -> tuple[Point, ...]:
    """The points of a table, in its order."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(json.dumps(row["parameters"]), []).append(row)
    return tuple(_point(group) for group in groups.values())


def _point(rows: Sequence[Mapping[str, Any]]) -> Point:
    done = [row["summary"] for row in rows if row["status"] == DONE]
    names = dict.fromkeys(name for summary in done for name in summary)
    numbers: dict[str, Spread] = {}
    for name in names:
        values = [float(summary[name]) for summary in done if isinstance(summary.get(name), bool | int | float)]
        if values:
            numbers[name] = Spread(math.fsum(values) / len(values), min(values), max(values))
    return Point(rows[0]["parameters"], len(rows), len(done), numbers)


def telling(points: Sequence[Point]) -> tuple[str, ...]:
    """The numbers that are not the same in all runs: those worth a column."""
    names = dict.fromkeys(name for point in points for name in point.numbers)
    return tuple(name for name in names if len(_ends(points, name)) > 1)


def _ends(points: Sequence[Point], name: str) -> set[float]:
    return {end for point in points if name in point.numbers for end in _least_and_most(point.numbers[name])}


def _least_and_most(spread: Spread) -> tuple[float, float]:
    return spread.least, spread.most
