"""Keeping clear of one another: how fast behind the wheel ahead, how near to those beside.

**Behind.** A rider may go as fast as who is ahead in the same line, faster by what the gap has to spare, slower by what
it lacks. The speed of who is ahead is what it rides or what it is about to ride, whichever is less: who follows slows
with who leads, not after. Who is ahead in the same line is whoever takes up, or is about to take up, some of the same
breadth of road and comes before. So two who want the same place do not ride into it together: the one behind yields.
Places are compared with places and plans with plans: in a corner all riders drift to the same side together.

**Beside.** Everyone whose body is beside one's own, or is about to be, bounds the room to move on that side. Where the
bounds leave nothing, a rider stays in the middle between them.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

from echelon.flocking.road_obstacles import NO_LIMIT
from echelon.flocking.road_riders import (
    RIDING,
    RidersSeen,
    RoadRiders,
    RoadRules,
    half_width_of,
    is_before,
    planned_lane,
    planned_target,
)

wp.set_module_options({"enable_backward": False})

FOLLOW_GAIN = wp.constant(0.6)  # [1/s]; speed for each metre that the gap is too short or too long
SIDE_MARGIN = wp.constant(0.3)  # [m]; nearer than this sideways, who is ahead is not wholly out of the way
CLEAR_OF = wp.constant(5.0)  # [m/s]; so much faster one may be past somebody who is barely out of the way
ANTICIPATED = wp.constant(1.5)  # [s]; the gap counts as what will be left of it after so long at this speed
FORESEEN = wp.constant(0.7)  # [m/s]
DROP_BACK = wp.constant(2.0)  # [m/s]; never slower than who is ahead by more than this
YIELD = wp.constant(1.2)  # [m/s]; the same where one only means to move behind another
SHARED = wp.constant(0.6)  # part of what two are too near that one of them moves away by
BESIDE = wp.constant(0.4)  # [m]; a body so little ahead or behind counts as beside...
BESIDE_TIME = wp.constant(1.0)  # [s]; ... or one that will be so soon


@wp.func
def follow_speed(gap: float, lead: float, own: float, rules: RoadRules) -> float:
    """How fast a rider who moves at `own` may go with a gap [m] to a wheel that moves at `lead` [m/s]."""
    room = gap - rules.gap - rules.headway * lead - ANTICIPATED * wp.max(own - lead, 0.0)
    if room < 0.0:
        return lead + wp.max(FOLLOW_GAIN * room, -DROP_BACK)
    return wp.min(lead + FOLLOW_GAIN * room, wp.sqrt(lead * lead + 2.0 * rules.braking * room))


@wp.func
def lead_speed(other: int, riders: RoadRiders) -> float:
    """Speed along the road that can be counted on of who is ahead [m/s].

    Of what another is about to slow down by, no more than `FORESEEN` counts: where many yield to one another, each a
    little slower than the next is about to be, they would all come to a halt.
    """
    along = wp.max(riders.along[other], 0.0)
    if riders.presence[other] != RIDING:
        return along
    return wp.min(along, wp.max(riders.known_speed[other], along - FORESEEN))


@wp.func
def nearer(a: float, b: float) -> float:
    """The one of two gaps that is smaller, none where they have different signs: in between is a crossing."""
    if a * b <= 0.0:
        return 0.0
    return wp.where(wp.abs(a) < wp.abs(b), a, b)


@wp.func
def gap_to_plan(lane: float, other: int, riders: RoadRiders) -> float:
    """From an offset to where the plan of another has it, now or later, whichever is nearer [m]."""
    return nearer(planned_lane(other, riders) - lane, planned_target(other, riders) - lane)


@wp.func
def clear_of(room: float) -> float:
    """How far a line with so much room [m] beside a body is clear of it: 0 in the way, 1 clear.

    In between, who drifts a little to the side need not brake as if for a wall.
    """
    return wp.clamp(room / SIDE_MARGIN, 0.0, 1.0)


@wp.func
def speed_behind_others(rider: int, rules: RoadRules, seen: RidersSeen, riders: RoadRiders) -> float:
    """Greatest speed along the road that those ahead allow [m/s]."""
    limit = float(NO_LIMIT)
    for k in range(seen.found[rider]):
        other = seen.indices[rider, k]
        ahead = seen.ahead[rider, k]
        if is_before(other, rider, ahead):
            lead = lead_speed(other, riders)
            fastest = follow_speed(ahead - rules.body_length, lead, riders.along[rider], rules)
            if fastest < limit:
                width = rules.body_half_width + half_width_of(other, rules, riders)
                between = riders.offset[other] - riders.offset[rider]
                now = nearer(between, gap_to_plan(riders.lane[rider], other, riders))
                limit = wp.min(limit, fastest + CLEAR_OF * clear_of(wp.abs(now) - width))
                later = nearer(now, gap_to_plan(riders.target[rider], other, riders))
                limit = wp.min(limit, wp.max(fastest, lead - YIELD) + CLEAR_OF * clear_of(wp.abs(later) - width))
    return limit


@wp.func
def is_beside(rider: int, other: int, ahead: float, time: float, rules: RoadRules, riders: RoadRiders) -> bool:
    """Whether another body is beside a rider's or will be within `time` [s], and not in the same line."""
    between = wp.abs(ahead) - rules.body_length
    if between > 0.0:
        width = rules.body_half_width + half_width_of(other, rules, riders)
        if wp.abs(riders.offset[other] - riders.offset[rider]) < width:
            return False
    closing = riders.along[rider] - riders.along[other]
    if ahead < 0.0:
        closing = -closing
    return between < BESIDE + time * wp.max(closing, 0.0)


@wp.func
def is_left(other: int, rider: int, riders: RoadRiders) -> bool:
    """Whether another is to the left; of two at the same offset, the one of lower index."""
    gap = riders.offset[other] - riders.offset[rider]
    return gap > 0.0 or (gap == 0.0 and other < rider)


@wp.func
def room_between_others(
    rider: int, clearance: float, room: wp.vec2, rules: RoadRules, seen: RidersSeen, riders: RoadRiders
) -> wp.vec2:
    """What those beside leave of the room (least, greatest offset) with so much clearance [m]."""
    low = room[0]
    high = room[1]
    for k in range(seen.found[rider]):
        other = seen.indices[rider, k]
        if is_beside(rider, other, seen.ahead[rider, k], BESIDE_TIME, rules, riders):
            least = rules.body_half_width + half_width_of(other, rules, riders) + clearance
            between = riders.offset[other] - riders.offset[rider]
            beside = planned_lane(other, riders)
            if is_left(other, rider, riders):
                high = wp.min(high, wp.min(beside - least, riders.lane[rider] + SHARED * (between - least)))
            else:
                low = wp.max(low, wp.max(beside + least, riders.lane[rider] + SHARED * (between + least)))
    return wp.vec2(low, high)
