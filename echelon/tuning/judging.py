"""How a performance is judged: formulas at moments, costs, successes; all gymnasts of a batch at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.tuning.objective import Asked, Condition, Term


@dataclass(frozen=True)
class Watched:
    """What was seen of a batch, frame by frame.

    Attributes:
        measures: By name, shape [frames, agents].
        constants: By name; numbers, or shape [agents]: the parameters of each gymnast's script, and what is known
            of the body.
        rows: Row of its script in which each gymnast was after each frame, shape [frames, agents], int.
        row_names: Of the script.
        frame_rate: Frames a second.
    """

    measures: Mapping[str, np.ndarray]
    constants: Mapping[str, float | np.ndarray]
    rows: np.ndarray
    row_names: tuple[str, ...]
    frame_rate: int

    def value(self, asked: Asked) -> np.ndarray:
        """A formula at its moment, shape [agents]; NaN where that never came, and where it has no value."""
        formula = asked.formula
        shape = self.rows.shape
        if asked.at in ("least", "most", "mean"):
            numbers = {name: self.measures.get(name, self.constants.get(name)) for name in formula.names}
            values = np.broadcast_to(np.asarray(formula.value(numbers), dtype=np.float64), shape)
            there = np.full(shape, True) if not asked.row else self.rows == self.row_names.index(asked.row)
            return _over_time(values, there, asked.at)
        frames, came = self._moment(asked)
        agents = np.arange(shape[1])
        numbers = {
            name: self.measures[name][frames, agents] if name in self.measures else self.constants[name]
            for name in formula.names
        }
        value = np.broadcast_to(np.asarray(formula.value(numbers), dtype=np.float64), shape[1:])
        return np.where(came & np.isfinite(value), value, np.nan)

    def _moment(self, asked: Asked) -> tuple[np.ndarray, np.ndarray]:
        """The frame of a moment for each gymnast, and whether it came."""
        frames, agents = self.rows.shape
        if asked.at == "end":
            return np.full(agents, frames - 1), np.full(agents, True)
        if asked.at == "time":
            frame = round((asked.time or 0.0) * self.frame_rate) - 1
            return np.full(agents, min(max(frame, 0), frames - 1)), np.full(agents, frame < frames)
        there = self.rows == self.row_names.index(asked.row)
        came = there.any(axis=0)
        arrival = there.argmax(axis=0)
        if asked.at == "arrival":
            return arrival, came
        # The last frame of the first stay; one who is there at the end has not left.
        away = ~there & (np.arange(frames)[:, None] > arrival)
        left = came & away.any(axis=0)
        return np.maximum(away.argmax(axis=0) - 1, 0), left


def _over_time(values: np.ndarray, there: np.ndarray, how: str) -> np.ndarray:
    """Least, most or mean of values [frames, agents] where `there`; NaN where nowhere."""
    there = there & np.isfinite(values)
    count = there.sum(axis=0)
    if how == "least":
        found = np.where(there, values, np.inf).min(axis=0)
    elif how == "most":
        found = np.where(there, values, -np.inf).max(axis=0)
    else:
        found = np.where(there, values, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, found, np.nan)


def cost(term: Term, values: np.ndarray) -> np.ndarray:
    """What values of a term cost, weighted; shape as given."""
    if term.target is not None:
        raw = ((values - term.target) / term.scale) ** 2
    elif term.least is not None or term.most is not None:
        outside = np.zeros_like(values)
        if term.least is not None:
            outside = np.maximum(outside, term.least - values)
        if term.most is not None:
            outside = np.maximum(outside, values - term.most)
        raw = (outside / term.scale) ** 2
    else:
        raw = values / term.scale
    # What is negative is a gain, and not bounded.
    bounded = np.where(raw > 0.0, raw / (1.0 + np.maximum(raw, 0.0) / term.limit), raw)
    missing = term.limit if term.missing is None else term.missing
    return term.weight * np.where(np.isnan(values), missing, bounded)


def holds(condition: Condition, values: np.ndarray) -> np.ndarray:
    """Where a condition holds, bool; not where the moment never came."""
    good = ~np.isnan(values)
    if condition.least is not None:
        good &= values >= condition.least
    if condition.most is not None:
        good &= values <= condition.most
    return good


def costs(terms: Sequence[Term], watched: Watched, copies: int = 1) -> np.ndarray:
    """What each term costs each gymnast, shape [terms, agents].

    Args:
        terms: Of an objective's stage.
        watched: What was seen.
        copies: How many gymnasts in a row are copies of one candidate.
    """
    found = [_cost_of_copies(term, watched.value(term).reshape(-1, copies)).ravel() for term in terms]
    return np.array(found).reshape(len(terms), watched.rows.shape[1])


def _cost_of_copies(term: Term, values: np.ndarray) -> np.ndarray:
    """What values [candidates, copies] of a term cost."""
    each = cost(term, values)
    if term.spread is None:
        return each
    came = ~np.isnan(values)
    count = np.maximum(came.sum(axis=1, keepdims=True), 1)
    mean = np.where(came, values, 0.0).sum(axis=1, keepdims=True) / count
    variance = np.where(came, values - mean, 0.0) ** 2
    scattered = variance.sum(axis=1, keepdims=True) / count / term.spread**2
    return each + term.weight * scattered / (1.0 + scattered / term.limit)


def successes(conditions: Sequence[Condition], watched: Watched) -> np.ndarray:
    """Who succeeded, shape [agents], bool; everybody where nothing is asked."""
    good = np.full(watched.rows.shape[1], True)
    for condition in conditions:
        good &= holds(condition, watched.value(condition))
    return good
