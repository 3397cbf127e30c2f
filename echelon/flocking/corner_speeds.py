"""How fast a road may be ridden: slowly enough for its corners, and for those ahead.

A corner of radius R is ridden at the speed at which it takes the lean that a rider allows for, v^2 = R g tan(lean), and
braked for in time, at `corner_braking`. Both depend only on the road and on the offset, which changes R, so they are
worked out once, for some offsets across the road and every metre along it: from the end back, v(s)^2 is the least of
v_corner(s')^2 + 2 a (s' - s) over all s' ahead.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import math

import numpy as np
import warp as wp

from echelon.flocking.road_riders import SHORTEST_PART
from echelon.scenario.road import PelotonSettings
from echelon.terrain.spline import Centreline
from echelon.terrain.spline_kernels import CentrelineData

wp.set_module_options({"enable_backward": False})

GRAVITY = 9.80665  # [m/s^2]
FASTEST = 60.0  # [m/s]; where the road is straight for good
SPEED_STEP = 1.0  # [m] between the samples of speeds along the road
SPEED_LANES = 9  # offsets for which there are some
SMOOTHED = 4.0  # [m]; over so much of the road a bicycle averages its curvature


@wp.struct
class CornerSpeeds:
    """Greatest speed along the road by arc length and offset.

    Attributes:
        squares: Of the speeds [m^2/s^2], shape [lanes, samples].
        step: Arc length between samples [m].
        edge: Offsets are even steps from minus this to this [m].
    """

    squares: wp.array2d[wp.float32]
    step: wp.float32
    edge: wp.float32


def corner_speeds(
    settings: PelotonSettings, path: Centreline, edge: float, device: wp.DeviceLike = None
) -> CornerSpeeds:
    """Work out how fast each place of a road may be ridden.

    Args:
        settings: For the lean, and for braking.
        path: The centreline.
        edge: Greatest offset [m].
        device: Where the arrays live.
    """
    count = max(8, math.ceil(path.length / SPEED_STEP))
    step = path.length / count
    s = np.arange(count) * step
    # The curvature of a spline jumps at its points; a bicycle, with the point it steers for so far ahead, does not.
    spread = np.linspace(-0.5 * SMOOTHED, 0.5 * SMOOTHED, 9)
    curvature = path.curvature(s[:, None] + spread).mean(axis=1)
    offsets = np.linspace(-edge, edge, SPEED_LANES)[:, None]
    part = np.maximum(1.0 - curvature * offsets, SHORTEST_PART)
    side = GRAVITY * math.tan(settings.corner_lean)
    squares = np.minimum(side * part / np.maximum(np.abs(curvature), 1e-9), FASTEST**2)
    # Twice round a closed road, so that what comes after the start is braked for before the end.
    laps = 2 if path.closed else 1
    squares, part = np.tile(squares, (1, laps)), np.tile(part, (1, laps))
    slack = 2.0 * settings.corner_braking * np.cumsum(part * step, axis=1)
    braked = np.minimum.accumulate((squares + slack)[:, ::-1], axis=1)[:, ::-1] - slack
    data = CornerSpeeds()
    data.squares = wp.array(braked[:, :count].astype(np.float32), dtype=wp.float32, device=device)
    data.step, data.edge = step, max(edge, 1e-3)
    return data


@wp.func
def corner_speed(s: float, offset: float, path: CentrelineData, speeds: CornerSpeeds) -> float:
    """Greatest speed at a place of the road [m/s]."""
    count = speeds.squares.shape[1]
    at = wp.max(s, 0.0) / speeds.step
    first = wp.min(int(at), count - 1)
    second = first + 1
    if second >= count:
        second = wp.where(path.closed == 1, 0, count - 1)
    part = wp.clamp(at - float(first), 0.0, 1.0)
    across = wp.clamp((offset / speeds.edge + 1.0) * 0.5, 0.0, 1.0) * float(speeds.squares.shape[0] - 1)
    lane = wp.min(int(across), speeds.squares.shape[0] - 2)
    near = wp.lerp(speeds.squares[lane, first], speeds.squares[lane, second], part)
    far = wp.lerp(speeds.squares[lane + 1, first], speeds.squares[lane + 1, second], part)
    return wp.sqrt(wp.lerp(near, far, across - float(lane)))
