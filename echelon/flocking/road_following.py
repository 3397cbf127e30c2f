"""Following the road: along which line, how fast, and what a rider is told.

**Line.** The plan moves from one offset to another like a critically damped spring, with limits on how fast: a
bicycle leans one way first, and then the other. A rider steers for a point ahead on the plan, so much further across
as the plan moves until the rider is there; without that, a rider would trail behind the plan by the distance to that
point.

**Command.** Direction to that point and speed along it, and the distance to the point, from which the rider takes the
curvature (`echelon.agents`). In the mode "lookahead" the point is 30 m ahead, and the distance is given as 0: steer by
the heading alone, as the papers do.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

from echelon.flocking.clearance import room_between_others, speed_behind_others
from echelon.flocking.corner_speeds import CornerSpeeds, corner_speed
from echelon.flocking.grouping import aim_distance
from echelon.flocking.road_obstacles import RoadObstacles, room_past_obstacles, speed_before_obstacles
from echelon.flocking.road_riders import (
    RIDING,
    RidersSeen,
    RoadRiders,
    RoadRules,
    left_of,
    level_tangent,
    on_map,
    sideways_limit,
)
from echelon.terrain.spline_kernels import CentrelineData, centreline_curvature, centreline_position
from echelon.warp_kernels.neighbours import CellTable

wp.set_module_options({"enable_backward": False})

LANE_RATE = wp.constant(0.9)  # [1/s]; of the spring that moves the plan
LANE_ACCELERATION = wp.constant(0.4)  # [m/s^2], at most
AIM_SIDEWAYS = wp.constant(1.5)  # [m]; the point steered for is never farther beside the plan than this


@wp.func
def move_plan(rider: int, rules: RoadRules, seen: RidersSeen, riders: RoadRiders, room: wp.vec2):
    """Move the plan of a rider by one frame toward the target, as far as there is room."""
    free = room_between_others(rider, rules.side_clearance, room, rules, seen, riders)
    goal = wp.clamp(riders.target[rider], free[0], free[1])
    if free[0] > free[1]:
        goal = wp.clamp(0.5 * (free[0] + free[1]), room[0], room[1])
    lane = riders.lane[rider]
    rate = riders.lane_rate[rider]
    fastest = sideways_limit(rider, rules, riders)
    push = LANE_RATE * (LANE_RATE * (goal - lane) - 2.0 * rate)
    rate += rules.step * wp.clamp(push, -LANE_ACCELERATION, LANE_ACCELERATION)
    rate = wp.clamp(rate, -fastest, fastest)
    riders.lane_rate[rider] = rate
    riders.lane[rider] = wp.clamp(lane + rules.step * rate, -rules.edge, rules.edge)


@wp.kernel
def command(
    first: int,
    # model
    rules: RoadRules,
    path: CentrelineData,
    speeds: CornerSpeeds,
    # state in
    seen: RidersSeen,
    obstacles: RoadObstacles,
    table: CellTable,
    # state in and out
    riders: RoadRiders,
    # out
    wish_out: wp.array[wp.float32],
    commands_out: wp.array2d[wp.float32],
):
    """Tell everybody where to steer and how fast to ride: (velocity x, y [m/s], distance of the aim [m], shelter).

    The user gets a speed [m/s] and steers along its plan (`road_user`).
    """
    rider = first + wp.tid()
    if riders.presence[rider] != RIDING:
        riders.command_speed[rider] = 0.0
        # Whoever gets up again makes new plans, from where that is.
        riders.lane[rider] = wp.clamp(riders.offset[rider], -rules.edge, rules.edge)
        riders.lane_rate[rider] = 0.0
        if rider == rules.first_user:
            wish_out[0] = 0.0
        else:
            for k in range(4):
                commands_out[rider, k] = 0.0
        return

    room = room_past_obstacles(rider, rules, path, riders, obstacles)
    move_plan(rider, rules, seen, riders, room)

    speed = wp.min(riders.wanted_speed[rider], riders.speed[rider] + rules.eagerness)
    speed = wp.min(speed, corner_speed(riders.s[rider], riders.offset[rider], path, speeds))
    speed = wp.min(speed, speed_behind_others(rider, rules, seen, riders))
    speed = wp.min(speed, speed_before_obstacles(rider, rules, path, riders, obstacles))
    speed = wp.max(speed, rules.slowest)
    riders.command_speed[rider] = speed
    if rider == rules.first_user:
        wish_out[0] = speed
        return

    distance = aim_distance(riders.speed[rider], rules)
    lane = riders.lane[rider]
    across = riders.lane_rate[rider] * distance / wp.max(riders.speed[rider], 1.0)
    aim_offset = wp.clamp(lane + wp.clamp(across, -AIM_SIDEWAYS, AIM_SIDEWAYS), -rules.edge, rules.edge)
    bend = centreline_curvature(path, riders.s[rider] + 0.5 * distance)
    aim_s = riders.s[rider] + distance / wp.max(1.0 - bend * lane, 0.5)
    aim = on_map(centreline_position(path, aim_s)) + aim_offset * left_of(level_tangent(path, aim_s))
    way = aim - table.places[rider]
    length = wp.max(wp.length(way), 1.0e-3)
    commands_out[rider, 0] = speed * way[0] / length
    commands_out[rider, 1] = speed * way[1] / length
    commands_out[rider, 2] = wp.where(rules.pursuit == 1, length, 0.0)
    commands_out[rider, 3] = riders.shelter[rider]
