"""Noise taken out of a track without moving any of it farther than allowed, and one height where it meets itself.

Both are least squares, in the plane and in height apart. Among all lines q through even steps of the track p,

    sum w_i |q_i - p_i|^2  +  (l / h)^4 sum |q_(i-1) - 2 q_i + q_(i+1)|^2  +  tie sum (q_i - q_j)^2

is made least: the first term holds on to the track, the second asks for little bending (waves shorter than about 2 pi l
go, h is the step), the third, for heights only, joins places i and j where the track passes itself. All weights begin
as 1. Wherever the result is farther from the track than the bound, the weight is raised and the whole solved again, so
that a sharp corner stays sharp while noise beside it goes.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

_ROUNDS = 60
_TIE = 1e3  # of one pair, against a weight of 1


def smoothed(
    track: np.ndarray, step: float, length: float, bound: float, closed: bool, pairs: np.ndarray | None = None
) -> np.ndarray:
    """A smooth line that stays within a bound of a track.

    Args:
        track: Places at even steps [m], shape [n, dimensions].
        step: Between them [m].
        length: Waves shorter than about six times this go [m].
        bound: No place moves farther than this [m]; where `pairs` ask for more, those near them do.
        closed: Whether the last is followed by the first.
        pairs: Indices of places that shall be one, shape [pairs, 2].

    Returns:
        As `track`.
    """
    count = len(track)
    if count < 4:
        return track.copy()
    stiffness = (length / step) ** 4 * _bending(count, closed)
    tied = felt_by(np.empty((0, 2), np.int64) if pairs is None else pairs, count, step, length, closed)
    if pairs is not None and len(pairs):
        ones = np.ones(len(pairs))
        rows = np.arange(len(pairs))
        tie = csc_array(
            (np.r_[ones, -ones], (np.r_[rows, rows], np.r_[pairs[:, 0], pairs[:, 1]])), shape=(len(pairs), count)
        )
        stiffness = stiffness + _TIE * (tie.T @ tie)
    weights = np.ones(count)
    result, excess = track, np.zeros(count)
    for _ in range(_ROUNDS):
        result = splu(csc_array(diags_array(weights) + stiffness)).solve(weights[:, None] * track)
        excess = np.linalg.norm(result - track, axis=1) / max(bound, 1e-9)
        over = (excess > 0.98) & ~tied
        if not over.any():
            return result
        weights[over] *= np.minimum(1.5 * excess[over], 10.0)
    # What is left over the bound by a hair, after so many rounds, is put back to it.
    share = np.where(tied, 1.0, np.minimum(1.0, 1.0 / np.maximum(excess, 1e-12)))
    return track + share[:, None] * (result - track)


def felt_by(pairs: np.ndarray, count: int, step: float, length: float, closed: bool) -> np.ndarray:
    """Which of so many places a pair of `meetings` pulls at, itself or through those beside it, shape [count]."""
    felt = np.zeros(count, dtype=bool)
    reach = round(3.0 * length / step)
    for shift in range(-reach, reach + 1) if len(pairs) else ():
        at = pairs.ravel() + shift
        felt[at % count if closed else np.clip(at, 0, count - 1)] = True
    return felt


def _bending(count: int, closed: bool) -> csc_array:
    """The matrix of the sum of squared second differences, sparse, shape [count, count]."""
    rows = np.arange(count if closed else count - 2)
    columns = (rows[:, None] + np.arange(3)) % count
    values = np.tile([1.0, -2.0, 1.0], len(rows))
    second = csc_array((values, (np.repeat(rows, 3), columns.ravel())), shape=(len(rows), count))
    return csc_array(second.T @ second)


def meetings(places: np.ndarray, step: float, near: float, apart: float, closed: bool) -> np.ndarray:
    """Where a line passes itself.

    Args:
        places: On the map, at even steps [m], shape [n, 2].
        step: Between them [m].
        near: Places nearer than this to one another meet [m]...
        apart: ... if they are farther than this along the line [m].
        closed: Whether the last is followed by the first.

    Returns:
        For each place the nearest of those that it meets, as pairs (i, j) with i < j, shape [pairs, 2].
    """
    found = KDTree(places).query_pairs(near, output_type="ndarray")
    along = np.abs(found[:, 1] - found[:, 0]) * step
    if closed:
        along = np.minimum(along, len(places) * step - along)
    found = found[along > apart]
    if not len(found):
        return np.empty((0, 2), dtype=np.int64)
    gaps = np.hypot(*(places[found[:, 0]] - places[found[:, 1]]).T)
    both = np.vstack([np.column_stack([found, gaps]), np.column_stack([found[:, ::-1], gaps])])
    both = both[np.lexsort((both[:, 1], both[:, 2], both[:, 0]))]
    _, first = np.unique(both[:, 0], return_index=True)
    pairs = np.sort(both[first, :2].astype(np.int64), axis=1)
    return np.unique(pairs, axis=0)


def meeting_count(pairs: np.ndarray, step: float, apart: float) -> int:
    """How many places or stretches `meetings` found: pairs that follow on one another are one."""
    if not len(pairs):
        return 0
    first = np.sort(pairs[:, 0])
    return 1 + int((np.diff(first) * step > apart).sum())
