"""Where to ride on the road: past who is slower, past what is in the way, and back to one's own offset.

A few times a second each rider compares offsets across the road. What speaks against one:

* it is away from the wanted offset, and from the present one;
* whoever rides there ahead is slower than one wants to ride, or so near that one would have to drop back;
* somebody rides between here and there, or there;
* an obstacle or somebody who has fallen is in the way there, or near.

What is chosen is kept for some seconds unless it turns out to be blocked, and given up only for something clearly
better, so that nobody dithers. Riders choose in turn, a part of them in every frame, so that neighbours see one
another's choice.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

from echelon.flocking.clearance import CLEAR_OF, clear_of, follow_speed, gap_to_plan, is_beside, is_left, lead_speed
from echelon.flocking.corner_speeds import CornerSpeeds, corner_speed
from echelon.flocking.road_obstacles import BLOCKED, RoadObstacles, hurry_cost, obstacle_cost
from echelon.flocking.road_riders import (
    FALLEN,
    RIDING,
    RidersSeen,
    RoadRiders,
    RoadRules,
    half_width_of,
    is_before,
    planned_lane,
)
from echelon.terrain.spline_kernels import CentrelineData

wp.set_module_options({"enable_backward": False})

CHOICES_PER_SECOND = 5
DWELL_SECONDS = 2.0  # a choice that is not blocked is kept for so long
BLOCKED_DWELL_SECONDS = 0.5  # one that is, for so long
CANDIDATE_SPACING = wp.constant(0.2)  # [m]
CLEARLY = wp.constant(0.35)  # by so much another offset must be better

AWAY = wp.constant(0.5)  # cost of each metre from the wanted offset
ACROSS = wp.constant(0.15)  # cost of each metre from the present one
TOO_NEAR = wp.constant(2.0)  # cost of each metre that the clearance to somebody beside falls short
IN_BETWEEN = wp.constant(10.0)  # cost of having somebody in between
SLOWEST_COUNTED = wp.constant(5.0)  # [m/s]; cost of riding slower, one for each m/s, at most
PASSING_CLEARANCE = wp.constant(0.25)  # [m] sideways to somebody beside, at least
PASSING_TIME = wp.constant(1.5)  # [s]; who will be beside within this is
LOOK_AHEAD = wp.constant(30.0)  # [m]; who is farther ahead than this is not slow yet


@wp.func
def lane_cost(
    lane: float,
    pace: float,
    rider: int,
    rules: RoadRules,
    path: CentrelineData,
    seen: RidersSeen,
    riders: RoadRiders,
    obstacles: RoadObstacles,
) -> float:
    """What speaks against riding at an offset [m], for somebody who would like to ride at `pace` [m/s]."""
    cost = AWAY * wp.abs(lane - riders.wanted_offset[rider]) + ACROSS * wp.abs(lane - riders.lane[rider])
    cost += obstacle_cost(lane, rider, rules, path, riders, obstacles)
    slower = wp.float32(0.0)
    between = wp.float32(0.0)
    for k in range(seen.found[rider]):
        other = seen.indices[rider, k]
        ahead = seen.ahead[rider, k]
        if wp.abs(ahead) < LOOK_AHEAD:
            width = rules.body_half_width + half_width_of(other, rules, riders)
            if is_beside(rider, other, ahead, PASSING_TIME, rules, riders):
                side = wp.where(is_left(other, rider, riders), 1.0, -1.0)
                room = side * (planned_lane(other, riders) - lane) - width
                room_now = side * (planned_lane(other, riders) - riders.lane[rider]) - width
                cost += TOO_NEAR * wp.clamp(rules.side_clearance - room, 0.0, rules.side_clearance)
                if room < wp.min(PASSING_CLEARANCE, room_now - 0.05):
                    between = wp.float32(IN_BETWEEN)
            if is_before(other, rider, ahead):
                lead = lead_speed(other, riders)
                fastest = follow_speed(ahead - rules.body_length, lead, riders.along[rider], rules)
                clear = clear_of(wp.abs(gap_to_plan(lane, other, riders)) - width)
                slower = wp.max(slower, pace - fastest - CLEAR_OF * clear)
                if riders.presence[other] == FALLEN:
                    gap = ahead - rules.body_length
                    across = wp.abs(riders.offset[other] - riders.lane[rider]) + width
                    if clear < 1.0:
                        cost += BLOCKED
                    elif (riders.offset[other] - riders.lane[rider]) * (riders.offset[other] - lane) < 0.0:
                        cost += hurry_cost(gap, riders.along[rider], across, rider, rules, riders)
    return cost + between + wp.min(slower, SLOWEST_COUNTED)


@wp.kernel
def choose(
    first: int,
    # model
    rules: RoadRules,
    path: CentrelineData,
    speeds: CornerSpeeds,
    every: int,
    dwell: int,
    blocked_dwell: int,
    # state in
    frame_in: wp.array[wp.int32],
    seen: RidersSeen,
    obstacles: RoadObstacles,
    # state in and out
    riders: RoadRiders,
):
    """Choose an offset to ride at, each rider in its turn; in between follow the wanted offset if that was chosen."""
    rider = first + wp.tid()
    if riders.presence[rider] != RIDING:
        return
    wanted = riders.wanted_offset[rider]
    if riders.keeping[rider] == 1:
        riders.target[rider] = wanted
    frame = frame_in[0]
    if (frame + rider) % every != 0:
        return
    age = frame - riders.chosen[rider]
    if age < blocked_dwell:
        return

    # Nobody goes out to pass at a speed that is out of reach: on a climb, or in a corner.
    pace = wp.min(riders.wanted_speed[rider], riders.speed[rider] + rules.eagerness)
    pace = wp.min(pace, corner_speed(riders.s[rider], riders.offset[rider], path, speeds))
    present = riders.target[rider]
    present_cost = lane_cost(present, pace, rider, rules, path, seen, riders, obstacles)
    if present_cost < BLOCKED and age < dwell:
        return
    best = wanted
    best_cost = lane_cost(wanted, pace, rider, rules, path, seen, riders, obstacles)
    steps = int(2.0 * rules.edge / CANDIDATE_SPACING)
    for k in range(steps + 1):
        lane = -rules.edge + CANDIDATE_SPACING * (float(k) + 0.5)
        lane = wp.min(lane, rules.edge)
        # Whatever else costs nothing, the way costs this much: most offsets are out of the question at once.
        if AWAY * wp.abs(lane - wanted) + ACROSS * wp.abs(lane - riders.lane[rider]) < best_cost:
            cost = lane_cost(lane, pace, rider, rules, path, seen, riders, obstacles)
            if cost < best_cost:
                best = lane
                best_cost = cost
    if best_cost < present_cost - CLEARLY:
        riders.target[rider] = best
        riders.keeping[rider] = wp.where(best == wanted, 1, 0)
        riders.chosen[rider] = frame
