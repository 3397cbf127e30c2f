"""The start grid: riders in rows across the road, each at the offset to keep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from echelon.errors import InputError
from echelon.scenario.road import PelotonSettings, UserSettings
from echelon.terrain.spline import Centreline

START_MARGIN = 2.0
"""On an open road the last row starts at least so far from its start [m]."""


@dataclass(frozen=True)
class StartGrid:
    """Where riders start, the user last if there is one; places are those of rear wheels' contacts.

    Attributes:
        s: Along the road, negative behind the start of a closed one [m], shape [riders].
        offsets: From the centreline, positive to the left [m], shape [riders].
        positions: In the world, at the height of the centreline [m], shape [riders, 3].
        headings: Along the road, from x toward y [rad], shape [riders].
        grades: Rise over run along the road, shape [riders].
        speeds: [m/s], shape [riders].
        training_speeds: At which each rides alone [m/s], shape [riders].
    """

    s: np.ndarray
    offsets: np.ndarray
    positions: np.ndarray
    headings: np.ndarray
    grades: np.ndarray
    speeds: np.ndarray
    training_speeds: np.ndarray


def start_grid(
    settings: PelotonSettings,
    path: Centreline,
    half_width: float,
    count: int,
    *,
    seed: int,
    user: UserSettings | None = None,
) -> StartGrid:
    """Where everybody starts. A rider starts at the same place however many others there are behind.

    Args:
        settings: The grid, and the training speeds.
        path: The centreline.
        half_width: Of the road [m].
        count: How many riders there are, the user aside.
        seed: Of the training speeds.
        user: Who rides with them, if anybody does.

    Raises:
        InputError: The road is too narrow to ride on, or too short for the grid, or the user starts among the others.
    """
    edge = riding_edge(settings, half_width)
    columns = min(settings.columns, int(2.0 * edge / settings.lateral_spacing + 1e-6) + 1)
    rows, places = np.divmod(np.arange(count), columns)
    depth = settings.row_spacing * int(rows.max(initial=0))
    front = settings.start_distance if path.closed else max(settings.start_distance, depth + START_MARGIN)
    if depth + START_MARGIN > path.length or (not path.closed and front >= path.length):
        raise InputError(
            f"peloton.start_distance = {settings.start_distance:g}: a grid {depth:.1f} m long does not fit on a road "
            f"of {path.length:.1f} m"
        )
    s = front - settings.row_spacing * rows
    offsets = settings.lateral_spacing * (places - 0.5 * (columns - 1))
    training = settings.training_speed + settings.training_spread * _spread(count, seed)
    if user is not None:
        user_s, user_offset = front + user.ahead, float(np.clip(user.keys[0][2], -edge, edge))
        near = (np.abs(s - user_s) < settings.body_length) & (
            np.abs(offsets - user_offset) < 2.0 * settings.body_half_width
        )
        if near.any():
            raise InputError(
                f"user.ahead = {user.ahead:g}: the user would start where rider {int(np.flatnonzero(near)[0])} does"
            )
        if not path.closed and not 0.0 <= user_s <= path.length:
            raise InputError(f"user.ahead = {user.ahead:g}: the user would start {user_s:.1f} m along, off the road")
        s, offsets = np.append(s, user_s), np.append(offsets, user_offset)
        training = np.append(training, user.keys[0][1])

    tangents = path.tangent(s)
    positions = path.position(s)
    positions[:, :2] += offsets[:, None] * path.left(s)
    return StartGrid(
        s=s,
        offsets=offsets,
        positions=positions,
        headings=np.arctan2(tangents[:, 1], tangents[:, 0]),
        grades=path.grade(s),
        speeds=np.full(len(s), settings.start_speed),
        training_speeds=training,
    )


def riding_edge(settings: PelotonSettings, half_width: float) -> float:
    """Greatest offset of a wheel that riders allow themselves [m].

    Raises:
        InputError: The road is narrower than the margins.
    """
    edge = half_width - settings.edge_margin
    if edge < 0.0:
        raise InputError(
            f"peloton.edge_margin = {settings.edge_margin:g}: must be at most half the width of the road, "
            f"{half_width:g} m"
        )
    return edge


def _spread(count: int, seed: int) -> np.ndarray:
    """A number from -1 to 1 for each rider, from a counter: a rider's does not depend on the count."""
    bits = np.random.Philox(key=seed).random_raw(count)
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0
