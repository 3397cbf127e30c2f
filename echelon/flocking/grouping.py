"""Riding together: the goal of Brogan, Metoyer and Hodgins (1998), where those one sees are, the nearest counting most.

    p_goal = (sum p_i / d_i + p_user / d_user) / (sum 1 / d_i + 1 / d_user)
    v      = v_road + k_d e + k_v de/dt,   e = p_goal - p

with v_road the training speed along the road. (As printed, e = p - p_goal would drive riders apart.) The user counts
however far away.

Along the road v sets the speed, up to a limit. Across it, v would lead everybody into the middle of the others and off
their own offsets, and in a wide group off the road; so it only moves the wanted offset, by as much as v would have
moved the point that is steered for, and no more than `gathering`. Ahead and behind are measured along the road:
in a corner the group does not pull riders across the inside.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

from echelon.flocking.road_riders import RIDING, UNFINISHED, RidersSeen, RoadRiders, RoadRules, line_gap
from echelon.terrain.spline_kernels import CentrelineData

wp.set_module_options({"enable_backward": False})

RIDE_OUT = wp.constant(0.5)  # [m/s^2]; who has finished on an open road slows down by this
NEAREST = wp.constant(1.0)  # [m]; others nearer than this count no more than from here


@wp.func
def aim_distance(speed: float, rules: RoadRules) -> float:
    """How far ahead the point is that a rider steers for [m]."""
    if rules.pursuit == 0:
        return rules.lookahead
    return wp.max(rules.pursuit_distance, rules.pursuit_time * speed)


@wp.kernel
def group(
    first: int,
    # model
    rules: RoadRules,
    path: CentrelineData,
    user_keys: wp.array[wp.vec3],
    by_distance: int,
    user_start: float,
    # state in
    frame_in: wp.array[wp.int32],
    finish_frame_in: wp.array[wp.int32],
    seen: RidersSeen,
    # state in and out
    riders: RoadRiders,
):
    """Wanted speed and offset: the group's for everybody, the script's for the user.

    Who has come to the finish of an open road rides out slowly: the road ends.
    """
    rider = first + wp.tid()
    if riders.presence[rider] != RIDING:
        riders.wanted_speed[rider] = 0.0
        riders.wanted_offset[rider] = riders.home[rider]
        return
    if rider == rules.first_user:
        when = rules.step * float(frame_in[0])
        if by_distance == 1:
            when = riders.s[rider] + float(riders.laps[rider]) * path.length - user_start
        script = scripted(when, user_keys)
        riders.wanted_speed[rider] = script[0]
        riders.wanted_offset[rider] = wp.clamp(script[1], -rules.edge, rules.edge)
        return

    goal = wp.vec2(0.0, 0.0)  # (ahead, to the left) of the rider
    drift = wp.float32(0.0)
    weights = wp.float32(0.0)
    sees_user = wp.bool(False)
    for k in range(seen.found[rider]):
        other = seen.indices[rider, k]
        if riders.presence[other] == RIDING:
            sees_user = sees_user or other == rules.first_user
            weight = 1.0 / wp.max(seen.distances[rider, k], NEAREST)
            goal += weight * wp.vec2(seen.ahead[rider, k], riders.offset[other] - riders.offset[rider])
            drift += weight * (riders.along[other] - riders.along[rider])
            weights += weight
    user = rules.first_user
    if user < riders.s.shape[0] and not sees_user:
        ahead = line_gap(path, riders.s[rider], riders.offset[rider], riders.s[user])
        if riders.presence[user] == RIDING:
            weight = 1.0 / wp.max(wp.abs(ahead), NEAREST)
            goal += weight * wp.vec2(ahead, riders.offset[user] - riders.offset[rider])
            drift += weight * (riders.along[user] - riders.along[rider])
            weights += weight
    # On a climb, what one can ride: whoever climbs better waits for the group as much as on the flat.
    speed = wp.min(riders.training[rider], riders.speed[rider] + rules.eagerness)
    offset = riders.home[rider]
    if weights > 0.0:
        asked = (rules.distance_gain * goal[0] + rules.velocity_gain * drift) / weights
        # Whoever waits rides no slower than a little slower than the others, or the wait would end in a halt.
        waiting = wp.min(speed, riders.along[rider] + drift / weights) - rules.grouping_limit
        speed = wp.max(speed + wp.clamp(asked, -rules.grouping_limit, rules.grouping_limit), waiting)
        turn = rules.distance_gain * goal[1] / (weights * wp.max(speed, 1.0))
        offset += wp.clamp(turn * aim_distance(speed, rules), -rules.gathering, rules.gathering)
    finished = finish_frame_in[rider]
    if path.closed == 0 and finished != UNFINISHED:
        speed -= RIDE_OUT * rules.step * float(frame_in[0] - finished)
    riders.wanted_speed[rider] = wp.max(speed, rules.slowest)
    riders.wanted_offset[rider] = wp.clamp(offset, -rules.edge, rules.edge)


@wp.func
def scripted(when: float, keys: wp.array[wp.vec3]) -> wp.vec2:
    """Speed and offset of a script (time or distance, speed, offset) between its keys."""
    last = keys.shape[0] - 1
    if when <= keys[0][0]:
        return wp.vec2(keys[0][1], keys[0][2])
    for k in range(last):
        a = keys[k]
        b = keys[k + 1]
        if when < b[0]:
            part = (when - a[0]) / (b[0] - a[0])
            return wp.vec2(wp.lerp(a[1], b[1], part), wp.lerp(a[2], b[2], part))
    return wp.vec2(keys[last][1], keys[last][2])
