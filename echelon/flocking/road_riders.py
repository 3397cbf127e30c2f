"""Riders on a road: what kernels know of each, where each is along the road, and whom each sees.

A rider's place is that of the rear wheel's contact. In the road's terms it is (s, offset): arc length along the
centreline, and distance from it, positive to the left; in those terms nearly everything that riders decide is decided.
The body reaches from behind the rear wheel to ahead of the front wheel, and half its width to either side.

A rider who plans to move across the road does not do so at once: a bicycle takes one or two seconds to follow. So
others go by the plan as well as by the place. `lane` is where the plan has a rider now, `target` where it ends; others
read those of the frame before, `known_...`, so that it does not matter who is computed first.

The *user*, if there is one, is the last of the riders. It sees and decides like the others; only the speed and offset
that it wants come from its script, and its bicycle is a simple one (`road_user`).
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

from echelon.terrain.spline_kernels import CentrelineData, centreline_closest, centreline_curvature, centreline_tangent
from echelon.warp_kernels.neighbours import CellTable, enter_agent, is_somewhere, nearest_neighbours

wp.set_module_options({"enable_backward": False})

ABSENT = wp.constant(0)  # the place is not finite
RIDING = wp.constant(1)
FALLEN = wp.constant(2)

UNFINISHED = wp.constant(-(2**31))  # the number of no frame: a run-up before frame 0 has negative numbers

HEADING_SPEED = wp.constant(0.5)  # [m/s]; slower than this, a velocity says nothing about a heading
FALLEN_HALF_WIDTH = wp.constant(0.9)  # [m]; who lies on the road takes up this much on either side
SHORTEST_PART = wp.constant(0.2)  # of the centreline's length, that of a rider's line inside of a bend, at least
SIDEWAYS_PART = wp.constant(0.1)  # of the speed and 1 m/s is the speed across the road, at most
ELSEWHERE = wp.constant(2.0)  # riders farther along the road than this many times the visibility are on another stretch


@wp.struct
class RoadRules:
    """`PelotonSettings` as kernels see them, units as there, and what follows from them on this road.

    Attributes:
        half_width: Of the road [m].
        edge: Greatest offset of a wheel that riders allow themselves [m].
        step: Duration of a frame [s].
        first_user: Index of the user, which is the number of the others.
        pursuit: 1 for the mode "pursuit", 0 for "lookahead".
        drafting: 1 where riders shelter others.
    """

    pursuit: wp.int32
    distance_gain: wp.float32
    velocity_gain: wp.float32
    grouping_limit: wp.float32
    gathering: wp.float32
    visibility: wp.float32
    sight: wp.float32
    pursuit_distance: wp.float32
    pursuit_time: wp.float32
    lookahead: wp.float32
    braking: wp.float32
    eagerness: wp.float32
    slowest: wp.float32
    side_clearance: wp.float32
    obstacle_clearance: wp.float32
    gap: wp.float32
    headway: wp.float32
    sideways_speed: wp.float32
    body_length: wp.float32
    body_behind: wp.float32
    body_half_width: wp.float32
    wheelbase: wp.float32
    drafting: wp.int32
    half_width: wp.float32
    edge: wp.float32
    step: wp.float32
    first_user: wp.int32


@wp.struct
class RoadRiders:
    """Every rider, the user last; arrays of shape [riders].

    Attributes:
        home: Offset that each keeps while nothing is in the way [m].
        training: Speed at which each rides alone [m/s].
        presence: ABSENT, RIDING or FALLEN.
        s: Along the road, from 0 to the length of a closed one [m].
        laps: How often each has passed the start of a closed road.
        offset: [m].
        along: Speed along the road [m/s].
        sideways: Speed to the left [m/s].
        speed: [m/s].
        heading: Unit vector of the bicycle's direction.
        wanted_speed: What training, group and tactics ask for [m/s].
        wanted_offset: Likewise [m].
        target: Offset that the plan leads to [m].
        keeping: 1 while the target is the wanted offset.
        chosen: Frame in which the target was chosen.
        lane: Offset of the plan now [m].
        lane_rate: How fast that changes [m/s].
        command_speed: Commanded in this frame [m/s].
        known_lane, known_target, known_speed: `lane`, `target`, `command_speed` of the frame before.
        shelter: Part of the air drag that others spare each.
    """

    home: wp.array[wp.float32]
    training: wp.array[wp.float32]
    presence: wp.array[wp.int32]
    s: wp.array[wp.float32]
    laps: wp.array[wp.int32]
    offset: wp.array[wp.float32]
    along: wp.array[wp.float32]
    sideways: wp.array[wp.float32]
    speed: wp.array[wp.float32]
    heading: wp.array[wp.vec2]
    wanted_speed: wp.array[wp.float32]
    wanted_offset: wp.array[wp.float32]
    target: wp.array[wp.float32]
    keeping: wp.array[wp.int32]
    chosen: wp.array[wp.int32]
    lane: wp.array[wp.float32]
    lane_rate: wp.array[wp.float32]
    command_speed: wp.array[wp.float32]
    known_lane: wp.array[wp.float32]
    known_target: wp.array[wp.float32]
    known_speed: wp.array[wp.float32]
    shelter: wp.array[wp.float32]


@wp.struct
class RidersSeen:
    """Whom each sees, nearest first; what lies beyond those found is stale.

    Attributes:
        found: How many, shape [riders].
        indices: Who they are, shape [riders, neighbours].
        distances: How far away [m], shape [riders, neighbours].
        ahead: How far ahead along the seer's own line, from rear wheel to rear wheel [m], shape [riders, neighbours].
    """

    found: wp.array[wp.int32]
    indices: wp.array2d[wp.int32]
    distances: wp.array2d[wp.float32]
    ahead: wp.array2d[wp.float32]


@wp.func
def on_map(vector: wp.vec3) -> wp.vec2:
    """The horizontal part of a vector."""
    return wp.vec2(vector[0], vector[1])


@wp.func
def left_of(along: wp.vec2) -> wp.vec2:
    """A vector turned to the left by a right angle."""
    return wp.vec2(-along[1], along[0])


@wp.func
def level_tangent(path: CentrelineData, s: float) -> wp.vec2:
    """Unit vector along the road on the map."""
    return wp.normalize(on_map(centreline_tangent(path, s)))


@wp.func
def road_gap(path: CentrelineData, s: float, other: float) -> float:
    """How far `other` is ahead of `s` along the centreline, the short way round where it is closed [m]."""
    gap = other - s
    if path.closed == 1:
        gap -= path.length * wp.round(gap / path.length)
    return gap


@wp.func
def line_gap(path: CentrelineData, s: float, offset: float, other: float) -> float:
    """The same along the line at an offset, which is shorter inside of a bend [m]."""
    gap = road_gap(path, s, other)
    return gap * wp.max(1.0 - centreline_curvature(path, s + 0.5 * gap) * offset, SHORTEST_PART)


# ---- where is everybody? ---------------------------------------------------------------------------------------------
@wp.kernel
def locate(
    first: int,
    # model
    rules: RoadRules,
    path: CentrelineData,
    # in
    positions_in: wp.array[wp.vec3],
    velocities_in: wp.array[wp.vec3],
    fallen_in: wp.array[wp.int32],
    user_in: wp.array[wp.vec4],
    # state in and out
    riders: RoadRiders,
    # out
    table: CellTable,
):
    """Place everybody along the road, from where each was a frame before, and enter them into the hash grid."""
    rider = first + wp.tid()
    place = wp.vec2(0.0, 0.0)
    velocity = wp.vec2(0.0, 0.0)
    presence = wp.int32(0)
    if rider == rules.first_user:
        place = wp.vec2(user_in[0][0], user_in[0][1])
        velocity = wp.vec2(user_in[0][2], user_in[0][3])
    else:
        place = on_map(positions_in[rider])
        velocity = on_map(velocities_in[rider])
        presence = fallen_in[rider]
    enter_agent(rider, place, table)
    riders.known_lane[rider] = riders.lane[rider]
    riders.known_target[rider] = riders.target[rider]
    riders.known_speed[rider] = riders.command_speed[rider]
    if not (is_somewhere(place) and is_somewhere(velocity)):
        riders.presence[rider] = ABSENT
        riders.along[rider] = 0.0
        riders.sideways[rider] = 0.0
        riders.speed[rider] = 0.0
        return

    riders.presence[rider] = wp.where(presence == 0, RIDING, FALLEN)
    before = riders.s[rider]
    closest = centreline_closest(path, place, before)
    s = closest[0]
    if path.closed == 1:
        if s - before < -0.5 * path.length:
            riders.laps[rider] = riders.laps[rider] + 1
        elif s - before > 0.5 * path.length:
            riders.laps[rider] = riders.laps[rider] - 1
    tangent = level_tangent(path, s)
    speed = wp.length(velocity)
    riders.s[rider] = s
    riders.offset[rider] = closest[1]
    riders.along[rider] = wp.dot(velocity, tangent)
    riders.sideways[rider] = wp.dot(velocity, left_of(tangent))
    riders.speed[rider] = speed
    if speed > HEADING_SPEED:
        riders.heading[rider] = velocity / speed


# ---- whom does each see? ---------------------------------------------------------------------------------------------
@wp.kernel
def see(
    first: int,
    # model
    rules: RoadRules,
    path: CentrelineData,
    # state in
    riders: RoadRiders,
    table: CellTable,
    # out
    seen: RidersSeen,
):
    """Find the nearest others on the same stretch of road, and how far ahead each is."""
    rider = first + wp.tid()
    seen.found[rider] = 0
    if riders.presence[rider] != RIDING:
        return
    found = nearest_neighbours(rider, rules.visibility, table, seen.indices, seen.distances)
    kept = wp.int32(0)
    for k in range(found):
        other = seen.indices[rider, k]
        along = road_gap(path, riders.s[rider], riders.s[other])
        # Where the road passes close by itself, those on the other stretch are near but not in the way.
        if riders.presence[other] != ABSENT and wp.abs(along) < ELSEWHERE * rules.visibility:
            seen.indices[rider, kept] = other
            seen.distances[rider, kept] = seen.distances[rider, k]
            seen.ahead[rider, kept] = line_gap(path, riders.s[rider], riders.offset[rider], riders.s[other])
            kept += 1
    seen.found[rider] = kept


@wp.func
def sideways_limit(rider: int, rules: RoadRules, riders: RoadRiders) -> float:
    """How fast a rider may move across the road at the present speed [m/s]."""
    return wp.min(rules.sideways_speed, SIDEWAYS_PART * (riders.speed[rider] + 1.0))


# ---- what takes up room on the road? ---------------------------------------------------------------------------------
@wp.func
def half_width_of(rider: int, rules: RoadRules, riders: RoadRiders) -> float:
    """How much of the road a rider takes up on either side [m]."""
    return wp.where(riders.presence[rider] == FALLEN, FALLEN_HALF_WIDTH, rules.body_half_width)


@wp.func
def planned_lane(other: int, riders: RoadRiders) -> float:
    """Where the plan of another has it now; who has fallen has none [m]."""
    return wp.where(riders.presence[other] == RIDING, riders.known_lane[other], riders.offset[other])


@wp.func
def planned_target(other: int, riders: RoadRiders) -> float:
    """Where the plan of another leads [m]."""
    return wp.where(riders.presence[other] == RIDING, riders.known_target[other], riders.offset[other])


@wp.func
def is_before(other: int, rider: int, ahead: float) -> bool:
    """Whether another comes before a rider where both want the same place: who is ahead, or has the lower index."""
    return ahead > 0.0 or (ahead == 0.0 and other < rider)
