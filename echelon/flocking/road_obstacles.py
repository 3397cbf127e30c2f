"""What stands or runs in the way: joggers, parked cars, barriers that narrow the road.

An obstacle is a box along the road. All that changes about it is where a jogger is, and that follows from the time
alone. Riders see it from `sight` away and choose an offset that clears it at once (`overtaking`): then there is time to
move across gently, and to file through where there is not room for all.

Until a rider is clear of it, an obstacle limits the speed: to what leaves the time to get clear, or, where no way past
has been found, to what can still be braked from.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from echelon.errors import InputError
from echelon.flocking.road_riders import RoadRiders, RoadRules, left_of, level_tangent, line_gap, sideways_limit
from echelon.scenario.road import ObstacleSettings, PelotonSettings
from echelon.terrain.spline import Centreline
from echelon.terrain.spline_kernels import CentrelineData, centreline_grade, centreline_position

wp.set_module_options({"enable_backward": False})

LEAST_CLEARANCE = wp.constant(0.45)  # [m]; nobody plans to pass nearer than this
NO_LIMIT = wp.constant(1.0e6)  # [m/s]
SETTLING = wp.constant(1.5)  # [s]; how long it takes to begin and to end a move across the road
KEEP_SIDE = wp.constant(5.0)  # [s]; an obstacle nearer than this bounds the room to move on its side
BLOCKED = wp.constant(40.0)  # cost of an offset that an obstacle is in the way of, at least...
BLOCKED_NEAR = wp.constant(100.0)  # ... and of one right ahead: what comes after it has time
HALF_AS_BAD = wp.constant(40.0)  # [m]; half of that for an obstacle so far away
HURRY = wp.constant(4.0)  # cost of each m/s that one must slow down by to get clear in time...
HURRY_AT_MOST = wp.constant(15.0)  # ... but no more than this: who is late goes on, and slowly
NEARNESS = wp.constant(6.0)  # cost of each metre that the clearance falls short


@wp.struct
class RoadObstacles:
    """Obstacles as kernels see them, arrays of shape [obstacles].

    Attributes:
        start: Arc length of the middle at frame 0 [m].
        speed: Along the road [m/s].
        half_length: [m].
        low, high: Least and greatest offset [m].
        upright: 1 for those that do not tilt with the road.
        s: Where the middle is in this frame [m].
        poses: In the world in the next frame; origin on the ground, x forward, y left, z up.
    """

    start: wp.array[wp.float32]
    speed: wp.array[wp.float32]
    half_length: wp.array[wp.float32]
    low: wp.array[wp.float32]
    high: wp.array[wp.float32]
    upright: wp.array[wp.int32]
    s: wp.array[wp.float32]
    poses: wp.array[wp.transform]


@wp.func
def obstacle_at(obstacle: int, time: float, path: CentrelineData, obstacles: RoadObstacles) -> float:
    """Arc length of an obstacle's middle at a time [m]."""
    s = obstacles.start[obstacle] + obstacles.speed[obstacle] * time
    if path.closed == 1:
        s -= path.length * wp.floor(s / path.length)
    return s


@wp.kernel
def move_obstacles(
    # model
    path: CentrelineData,
    step: float,
    # in
    frame_in: wp.array[wp.int32],
    # state in and out
    obstacles: RoadObstacles,
):
    """Where each obstacle is in this frame, and its pose in the next."""
    obstacle = wp.tid()
    frame = frame_in[0]
    obstacles.s[obstacle] = obstacle_at(obstacle, float(frame) * step, path, obstacles)
    s = obstacle_at(obstacle, float(frame + 1) * step, path, obstacles)
    tangent = level_tangent(path, s)
    place = centreline_position(path, s)
    left = 0.5 * (obstacles.low[obstacle] + obstacles.high[obstacle]) * left_of(tangent)
    facing = wp.where(obstacles.speed[obstacle] < 0.0, -1.0, 1.0)
    yaw = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), wp.atan2(facing * tangent[1], facing * tangent[0]))
    pitch = wp.where(obstacles.upright[obstacle] == 1, 0.0, wp.atan(centreline_grade(path, s)))
    tilt = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), -facing * pitch)
    point = wp.vec3(place[0] + left[0], place[1] + left[1], place[2])
    obstacles.poses[obstacle] = wp.transform(point, yaw * tilt)


# ---- what a rider sees of one ----------------------------------------------------------------------------------------
@wp.func
def obstacle_gap(
    obstacle: int, rider: int, rules: RoadRules, path: CentrelineData, riders: RoadRiders, obstacles: RoadObstacles
) -> float:
    """From the front of a rider to an obstacle, less than 0 beside it; minus `NO_LIMIT` once it has been passed [m]."""
    ahead = line_gap(path, riders.s[rider], riders.offset[rider], obstacles.s[obstacle])
    half = obstacles.half_length[obstacle]
    if ahead + half + rules.body_behind < -0.2:
        return -NO_LIMIT
    return ahead - half - (rules.body_length - rules.body_behind)


@wp.func
def obstacle_apart(low: float, high: float, obstacle: int, rules: RoadRules, obstacles: RoadObstacles) -> float:
    """Clearance beside an obstacle of a body whose middle moves from offset `low` to `high`, 0 or less: none [m]."""
    return wp.max(obstacles.low[obstacle] - high, low - obstacles.high[obstacle]) - rules.body_half_width


@wp.func
def obstacle_cost(
    lane: float, rider: int, rules: RoadRules, path: CentrelineData, riders: RoadRiders, obstacles: RoadObstacles
) -> float:
    """What obstacles have against riding at an offset; `BLOCKED` or more where one is in the way."""
    cost = wp.float32(0.0)
    for k in range(obstacles.start.shape[0]):
        gap = obstacle_gap(k, rider, rules, path, riders, obstacles)
        if gap > -NO_LIMIT and gap < rules.sight:
            apart = obstacle_apart(lane, lane, k, rules, obstacles)
            middle = 0.5 * (obstacles.low[k] + obstacles.high[k])
            beyond = gap < 0.0 and (lane - middle) * (riders.offset[rider] - middle) < 0.0
            if apart < LEAST_CLEARANCE or beyond:
                cost += BLOCKED + BLOCKED_NEAR * HALF_AS_BAD / (HALF_AS_BAD + wp.max(gap, 0.0)) - wp.min(apart, 0.0)
            else:
                cost += NEARNESS * wp.max(rules.obstacle_clearance - apart, 0.0)
                now = riders.lane[rider]
                if obstacle_apart(wp.min(lane, now), wp.max(lane, now), k, rules, obstacles) < LEAST_CLEARANCE:
                    across = across_to_clear(now, lane, k, rules, obstacles)
                    closing = riders.along[rider] - obstacles.speed[k]
                    cost += hurry_cost(gap, closing, across, rider, rules, riders)
    return cost


@wp.func
def across_to_clear(now: float, lane: float, obstacle: int, rules: RoadRules, obstacles: RoadObstacles) -> float:
    """How far it is from one offset to be clear of an obstacle on the side of another [m]."""
    across = now - obstacles.low[obstacle]
    if lane > 0.5 * (obstacles.low[obstacle] + obstacles.high[obstacle]):
        across = obstacles.high[obstacle] - now
    return wp.max(across + rules.body_half_width, 0.0)


@wp.func
def time_across(across: float, rider: int, rules: RoadRules, riders: RoadRiders) -> float:
    """How long it takes to move so far across the road [s]."""
    return SETTLING + across / sideways_limit(rider, rules, riders)


@wp.func
def hurry_cost(gap: float, closing: float, across: float, rider: int, rules: RoadRules, riders: RoadRiders) -> float:
    """Cost of having to slow down in order to be across before what is in the way has been reached."""
    in_time = wp.max(gap, 0.0) / time_across(across, rider, rules, riders)
    return wp.min(HURRY * wp.max(closing - in_time, 0.0), HURRY_AT_MOST)


@wp.func
def room_past_obstacles(
    rider: int, rules: RoadRules, path: CentrelineData, riders: RoadRiders, obstacles: RoadObstacles
) -> wp.vec2:
    """Least and greatest offset that near obstacles leave on the side on which the plan passes them [m]."""
    low = -rules.edge
    high = rules.edge
    target = riders.target[rider]
    for k in range(obstacles.start.shape[0]):
        gap = obstacle_gap(k, rider, rules, path, riders, obstacles)
        closing = wp.max(riders.along[rider] - obstacles.speed[k], 0.0)
        if gap > -NO_LIMIT and gap < KEEP_SIDE * closing:
            margin = rules.body_half_width + LEAST_CLEARANCE
            if target >= obstacles.high[k] + margin:
                low = wp.max(low, obstacles.high[k] + margin)
            elif target <= obstacles.low[k] - margin:
                high = wp.min(high, obstacles.low[k] - margin)
    return wp.vec2(low, high)


@wp.func
def speed_before_obstacles(
    rider: int, rules: RoadRules, path: CentrelineData, riders: RoadRiders, obstacles: RoadObstacles
) -> float:
    """Greatest speed along the road that obstacles in the way allow [m/s]."""
    limit = float(NO_LIMIT)
    low = wp.min(riders.offset[rider], riders.lane[rider])
    high = wp.max(riders.offset[rider], riders.lane[rider])
    target = riders.target[rider]
    for k in range(obstacles.start.shape[0]):
        gap = obstacle_gap(k, rider, rules, path, riders, obstacles)
        apart = obstacle_apart(low, high, k, rules, obstacles)
        if gap > -NO_LIMIT and gap < rules.sight and apart < 0.5 * LEAST_CLEARANCE:
            moving = obstacles.speed[k]
            room = wp.max(gap - rules.gap, 0.0)
            # Behind a jogger one can ride; toward one who comes the other way there is only so much time.
            fastest = wp.max(moving, 0.0) + wp.min(wp.sqrt(2.0 * rules.braking * room), 0.5 * room)
            if obstacle_apart(target, target, k, rules, obstacles) >= LEAST_CLEARANCE:
                from_low = across_to_clear(low, target, k, rules, obstacles)
                from_high = across_to_clear(high, target, k, rules, obstacles)
                clearing = time_across(wp.max(from_low, from_high), rider, rules, riders)
                fastest = wp.max(fastest, moving + room / clearing)
            limit = wp.min(limit, fastest)
    return limit


# ---- setting them up -------------------------------------------------------------------------------------------------
def road_obstacles(
    obstacles: Sequence[ObstacleSettings],
    settings: PelotonSettings,
    path: Centreline,
    half_width: float,
    device: wp.DeviceLike = None,
) -> RoadObstacles:
    """Obstacles as kernels see them, where they are at frame 0.

    Args:
        obstacles: The settings of each.
        settings: Of those who are to pass.
        path: The centreline.
        half_width: Of the road [m].
        device: Where the arrays live.

    Raises:
        InputError: One lies beyond the end of the road, or they leave no way past.
    """
    _check(obstacles, settings, path, half_width)
    sizes = np.array([obstacle.size for obstacle in obstacles], dtype=np.float64).reshape(-1, 2)
    offsets = np.array([obstacle.offset for obstacle in obstacles], dtype=np.float64)

    def numbers(values: Sequence[float] | np.ndarray) -> wp.array:
        return wp.array(np.asarray(values, dtype=np.float32), dtype=wp.float32, device=device)

    data = RoadObstacles()
    data.start = numbers([obstacle.distance for obstacle in obstacles])
    data.speed = numbers([obstacle.speed for obstacle in obstacles])
    data.half_length = numbers(0.5 * sizes[:, 0])
    data.low, data.high = numbers(offsets - 0.5 * sizes[:, 1]), numbers(offsets + 0.5 * sizes[:, 1])
    upright = [int(obstacle.kind == "jogger") for obstacle in obstacles]
    data.upright = wp.array(upright, dtype=wp.int32, device=device)
    data.s = wp.zeros(len(obstacles), dtype=wp.float32, device=device)
    data.poses = wp.zeros(len(obstacles), dtype=wp.transform, device=device)
    return data


def obstacle_outline(obstacle: ObstacleSettings, path: Centreline) -> np.ndarray:
    """Corners of an obstacle on the map at frame 0, counter-clockwise [m], shape [4, 2]."""
    length, width = obstacle.size
    along, left = path.tangent(obstacle.distance)[:2], path.left(obstacle.distance)
    along = along / np.hypot(*along)
    middle = path.position(obstacle.distance)[:2] + obstacle.offset * left
    ends = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) * (0.5 * length, 0.5 * width)
    return middle + ends[:, :1] * along + ends[:, 1:] * left


def _check(
    obstacles: Sequence[ObstacleSettings], settings: PelotonSettings, path: Centreline, half_width: float
) -> None:
    """Where obstacles stand side by side, some gap must let a body through."""
    needed = 2.0 * (settings.body_half_width + LEAST_CLEARANCE)
    edge = max(half_width - settings.edge_margin, 0.0) + settings.body_half_width + LEAST_CLEARANCE
    for index, obstacle in enumerate(obstacles):
        here = f"obstacles[{index}]"
        if obstacle.distance > path.length:
            raise InputError(
                f"{here}.distance = {obstacle.distance:g}: must be at most the length of the road, {path.length:.1f} m"
            )
        beside = sorted(
            (other.offset - 0.5 * other.size[1], other.offset + 0.5 * other.size[1])
            for other in obstacles
            if other is obstacle
            or (
                other.speed == obstacle.speed
                and abs(float(path.difference(other.distance, obstacle.distance)))
                < 0.5 * (other.size[0] + obstacle.size[0]) + settings.body_length
            )
        )
        widest, reached = 0.0, -edge
        for low, high in [*beside, (edge, edge)]:
            widest = max(widest, min(low, edge) - reached)
            reached = max(reached, high)
        if widest < needed:
            raise InputError(
                f"{here}.offset = {obstacle.offset:g}: leaves a gap of {max(widest, 0.0):.2f} m on a road of "
                f"{2.0 * half_width:g} m; must leave at least {needed:.2f} m"
            )
