"""What each member of a herd wants: to keep its distance, to go where the herd goes, and to run into nothing.

The rules are those of the Border collie environment of Brogan, Metoyer and Hodgins (1998), in every frame from the
positions of that frame:

    v_herd   away from near neighbours, toward far ones (the k nearest in sight)
    v_goal   from the centroid of the herd to a random goal; a new goal once the centroid is near the old one
    v_user   along the ray from the user to the centroid, while the user is within `flee_distance` of the centroid,
             in proportion to how near each one is to the user
    v        0.5 (v_herd + v_user) while fleeing, else 0.5 (v_herd + v_goal)

Then what v asks for is made possible: approach to neighbours, the user and fences is limited (see `perception`), and
so is the difference from the present velocity, for a robot that is asked to change too much within a hop falls.

How fast one may come nearer to a neighbour depends on what the neighbour is about to do, that is, on what it wanted a
frame ago, not on how it moves: who follows sets off with who leads, a frame later instead of a hop later, and who is
held up by a fence holds up those behind, before they have run into it.

Every agent enters the hash grid, one thread makes up the herd's mind, every agent looks round and wants. Sums over
agents are made in blocks of `BLOCK` in index order, then over the blocks in order, so that nothing depends on how
agents are dealt to threads. Those who have fallen, and those whose position is not finite, are no part of the herd: it
does not wait for them, and sees in them nothing but obstacles.

Three additions to the paper's rules, each because without it somebody is left behind:

* v_goal and v_user are bent round the fence of the corral where they would lead into it;
* who is outside while the centroid is in the corral makes for the opening;
* who is too far from the centroid to be of the herd makes for it.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

from echelon.flocking.perception import Pen, is_inside, limit_approach, limit_approach_to_walls, way_to
from echelon.terrain.walls import WallGrid
from echelon.warp_kernels.neighbours import CellTable, enter_agent, is_somewhere, nearest_neighbours

wp.set_module_options({"enable_backward": False})

BLOCK = 256
GOAL_TRIES = wp.constant(16)
LIMIT_PASSES = wp.constant(3)  # times that all limits on the speed of approach are gone through
FLEE_MARGIN = wp.constant(1.0)  # [m]; "just beyond": the herd flees to this much more than the flee distance
LOOK_AHEAD = wp.constant(6.0)  # [m]; fences of the corral across the way are seen from this far
USER_ROOM = wp.constant(2.0)  # [m]; nobody wants to be nearer to the middle of the user's bicycle


@wp.struct
class HerdRules:
    """`HerdSettings` as kernels see them, units as there, and what follows from them for a herd of this size.

    Attributes:
        stray_distance: Who is farther than this from the centroid is no longer of the herd [m].
        goal_half_length: Goals lie within an oval about the origin, half this long...
        goal_radius: ... and half this wide [m].
        goal_clearance: Distance that the way to a goal keeps from the corral [m].
    """

    spacing: wp.float32
    visibility: wp.float32
    gain: wp.float32
    max_speed: wp.float32
    max_change: wp.float32
    flee_distance: wp.float32
    flee_gain: wp.float32
    wander: wp.int32
    wander_gain: wp.float32
    wander_arrive: wp.float32
    wall_distance: wp.float32
    wall_gain: wp.float32
    radius: wp.float32
    clearance: wp.float32
    clearance_gain: wp.float32
    lookahead: wp.float32
    stray_distance: wp.float32
    goal_half_length: wp.float32
    goal_radius: wp.float32
    goal_clearance: wp.float32


@wp.struct
class HerdMind:
    """What the herd as a whole knows and wants; arrays of one.

    Attributes:
        centroid: Of all its members [m].
        member_count: How many they are.
        fleeing: 1 while it flees, else 0.
        goal: Where it wanders [m].
        goal_count: How many goals it has had; the counter of the random numbers.
        velocity: v_goal [m/s]; zero while it flees.
    """

    centroid: wp.array[wp.vec2]
    member_count: wp.array[wp.int32]
    fleeing: wp.array[wp.int32]
    goal: wp.array[wp.vec2]
    goal_count: wp.array[wp.int32]
    velocity: wp.array[wp.vec2]


@wp.struct
class Seen:
    """The neighbours of each, sorted by (distance, index); what lies beyond those found is stale.

    Attributes:
        found: How many they are, shape [agents]; none where an agent does not take part.
        indices: Who they are, shape [agents, neighbours].
        distances: How far away [m], shape [agents, neighbours].
        towards: Unit vectors toward them, shape [agents, neighbours].
        fastest: Greatest speed toward them [m/s], shape [agents, neighbours].
    """

    found: wp.array[wp.int32]
    indices: wp.array2d[wp.int32]
    distances: wp.array2d[wp.float32]
    towards: wp.array2d[wp.vec2]
    fastest: wp.array2d[wp.float32]


# ---- see -------------------------------------------------------------------------------------------------------------
@wp.func
def on_ground(vector: wp.vec3) -> wp.vec2:
    """The horizontal part of a vector."""
    return wp.vec2(vector[0], vector[1])


@wp.func
def is_member(agent: int, place: wp.vec2, fallen: wp.array[wp.int32]) -> bool:
    """Whether an agent takes part in the herd."""
    return fallen[agent] == 0 and is_somewhere(place)


@wp.kernel
def enter_herd(
    first: int,
    # state in
    positions_in: wp.array[wp.vec3],
    fallen_in: wp.array[wp.int32],
    intended_in: wp.array[wp.vec2],
    # out
    table: CellTable,
    known_out: wp.array[wp.vec2],
    sums_out: wp.array[wp.vec3],
):
    """Enter every agent into the hash grid; the first of each block adds up the block's places and members."""
    agent = first + wp.tid()
    known_out[agent] = intended_in[agent]
    enter_agent(agent, on_ground(positions_in[agent]), table)
    if agent % BLOCK == 0:
        total = wp.vec3(0.0, 0.0, 0.0)
        for member in range(agent, wp.min(agent + BLOCK, positions_in.shape[0])):
            place = on_ground(positions_in[member])
            if is_member(member, place, fallen_in):
                total += wp.vec3(place[0], place[1], 1.0)
        sums_out[agent // BLOCK] = total


@wp.kernel
def look_round(
    first: int,
    # model
    visibility: float,
    # state in
    fallen_in: wp.array[wp.int32],
    table: CellTable,
    # out
    seen: Seen,
):
    """Find the nearest neighbours of each, up to a distance [m]."""
    agent = first + wp.tid()
    seen.found[agent] = 0
    if is_member(agent, table.places[agent], fallen_in):
        seen.found[agent] = nearest_neighbours(agent, visibility, table, seen.indices, seen.distances)


# ---- make up the herd's mind -----------------------------------------------------------------------------------------
@wp.func
def random_goal(centroid: wp.vec2, count: int, seed: int, rules: HerdRules, pen: Pen) -> wp.vec2:
    """A place on the field whose straight way from the centroid is clear of the corral, if a few tries find one [m]."""
    random = wp.rand_init(seed, count)
    goal = wp.vec2(0.0, 0.0)
    for _ in range(GOAL_TRIES):
        candidate = wp.vec2(
            wp.randf(random, -rules.goal_half_length, rules.goal_half_length),
            wp.randf(random, -rules.goal_radius, rules.goal_radius),
        )
        beyond = wp.max(wp.abs(candidate[0]) - (rules.goal_half_length - rules.goal_radius), 0.0)
        if wp.length(wp.vec2(beyond, candidate[1])) <= rules.goal_radius:
            goal = candidate
            if pen.present == 0:
                return goal
            way = goal - centroid
            along = wp.clamp(wp.dot(pen.center - centroid, way) / wp.max(wp.dot(way, way), 1.0e-6), 0.0, 1.0)
            passing = wp.length(centroid + along * way - pen.center)
            # A herd that is at the corral already only has to leave it.
            least = wp.min(1.4142 * pen.half_size + rules.goal_clearance, wp.length(pen.center - centroid))
            if passing >= least:
                return goal
    return goal


@wp.kernel
def make_up_mind(
    # model
    rules: HerdRules,
    pen: Pen,
    seed: int,
    # state in
    sums_in: wp.array[wp.vec3],
    user_in: wp.array[wp.vec4],
    # state in and out
    mind: HerdMind,
):
    """Centroid, whether to flee, and where to wander."""
    total = wp.vec3(0.0, 0.0, 0.0)
    for block in range(sums_in.shape[0]):
        total += sums_in[block]
    if total[2] > 0.0:
        mind.centroid[0] = wp.vec2(total[0] / total[2], total[1] / total[2])
    mind.member_count[0] = int(total[2])
    centroid = mind.centroid[0]

    user = wp.vec2(user_in[0][0], user_in[0][1])
    fleeing = wp.length(centroid - user) < rules.flee_distance
    mind.fleeing[0] = wp.where(fleeing, 1, 0)
    mind.velocity[0] = wp.vec2(0.0, 0.0)
    if rules.wander == 1 and not fleeing:
        if mind.goal_count[0] == 0 or wp.length(mind.goal[0] - centroid) < rules.wander_arrive:
            mind.goal_count[0] = mind.goal_count[0] + 1
            mind.goal[0] = random_goal(centroid, mind.goal_count[0], seed, rules, pen)
        way = way_to(centroid, mind.goal[0], rules.goal_clearance, pen)
        speed = wp.min(rules.wander_gain * way[2], rules.max_speed)
        mind.velocity[0] = speed * wp.normalize(on_ground(way) - centroid)


# ---- want ------------------------------------------------------------------------------------------------------------
@wp.func
def regard_neighbours(
    agent: int,
    found: int,
    velocities: wp.array[wp.vec3],
    known: wp.array[wp.vec2],
    fallen: wp.array[wp.int32],
    rules: HerdRules,
    pen: Pen,
    table: CellTable,
    seen: Seen,
) -> wp.vec2:
    """v_herd: the mean of what each neighbour asks for, `spacing` between the two, weighted by 1 / distance.

    The limits on the speed toward each go to `seen`: the speed at which it means to leave, and what the room between
    the two bodies allows. Of a neighbour that means to come nearer half the speed is left to it to take away, or two
    who meet would both turn back.
    """
    place = table.places[agent]
    own = on_ground(velocities[agent])
    keep = 2.0 * rules.radius + rules.clearance
    near_pen = pen.present == 1 and wp.length(place - pen.center) < rules.visibility + 2.0 * pen.half_size
    asked = wp.vec2(0.0, 0.0)
    weights = wp.float32(0.0)
    for k in range(found):
        other = seen.indices[agent, k]
        gap = table.places[other] - place
        distance = wp.max(seen.distances[agent, k], 1.0e-6)
        drift = rules.lookahead * (on_ground(velocities[other]) - own)

        toward = gap * (1.0 / distance)
        leaving = wp.dot(known[other], toward)
        room = distance + wp.dot(drift, toward) - keep
        seen.towards[agent, k] = toward
        seen.fastest[agent, k] = wp.where(leaving < 0.0, 0.5, 1.0) * leaving + rules.clearance_gain * room

        leg = gap + drift
        weight = 1.0 / wp.max(wp.length(leg), 1.0e-3)  # 1 / distance
        unit = weight * leg
        if near_pen:
            way = way_to(place, place + leg, rules.wall_distance, pen)
            unit = wp.normalize(on_ground(way) - place)
            weight = 1.0 / wp.max(way[2], 1.0e-3)
        if fallen[other] == 0 or weight * rules.spacing > 1.0:
            asked += (1.0 - weight * rules.spacing) * unit  # weight (distance - spacing), along the way
            weights += weight
    if weights == 0.0:
        return asked
    return shortened(asked * (rules.gain / weights), rules.max_speed)


@wp.func
def shared_velocity(place: wp.vec2, user: wp.vec2, rules: HerdRules, pen: Pen, mind: HerdMind) -> wp.vec2:
    """v_user while the herd flees, else v_goal, bent round the corral's fence; strays rejoin the herd first."""
    centroid = mind.centroid[0]
    velocity = mind.velocity[0]
    if mind.fleeing[0] == 1:
        nearness = rules.flee_distance + FLEE_MARGIN - wp.length(place - user)
        velocity = wp.clamp(rules.flee_gain * nearness, 0.0, 2.0 * rules.max_speed) * wp.normalize(centroid - user)
    speed = wp.length(velocity)
    target = place + (LOOK_AHEAD / wp.max(speed, 1.0e-6)) * velocity
    if wp.length(centroid - place) > rules.stray_distance:
        speed = rules.max_speed
        target = centroid
    elif is_inside(centroid, pen) and not is_inside(place, pen):
        target = centroid
    if speed < 1.0e-3:
        return wp.vec2(0.0, 0.0)
    return speed * wp.normalize(on_ground(way_to(place, target, rules.wall_distance, pen)) - place)


@wp.func
def limit_approach_to_user(velocity: wp.vec2, place: wp.vec2, user: wp.vec4, rules: HerdRules) -> wp.vec2:
    """Keep out of the way of the user's bicycle, whatever the rest wants."""
    gap = wp.vec2(user[0], user[1]) - place
    distance = wp.length(gap)
    if distance < 1.0e-6 or distance > 4.0 * USER_ROOM:
        return velocity
    toward = gap / distance
    return limit_approach(velocity, toward, wp.dot(wp.vec2(user[2], user[3]), toward) + distance - USER_ROOM)


@wp.func
def limit_approach_to_neighbours(velocity: wp.vec2, agent: int, found: int, seen: Seen) -> wp.vec2:
    """Limit the speed toward each neighbour; the nearest last: where limits contradict, its is kept."""
    limited = velocity
    for rank in range(found):
        k = found - 1 - rank
        limited = limit_approach(limited, seen.towards[agent, k], seen.fastest[agent, k])
    return limited


@wp.func
def shortened(vector: wp.vec2, longest: float) -> wp.vec2:
    """A vector, no longer than `longest`."""
    return vector * wp.min(1.0, longest / wp.max(wp.length(vector), 1.0e-6))


@wp.kernel
def find_farthest(
    first_block: int,
    # state in
    fallen_in: wp.array[wp.int32],
    table: CellTable,
    mind: HerdMind,
    # out
    farthest_out: wp.array[wp.vec3],
):
    """Who of each block is farthest from the centroid."""
    block = first_block + wp.tid()
    farthest = wp.vec3(mind.centroid[0][0], mind.centroid[0][1], 0.0)
    for member in range(block * BLOCK, wp.min((block + 1) * BLOCK, fallen_in.shape[0])):
        candidate = table.places[member]
        distance = wp.length(candidate - mind.centroid[0])
        if is_member(member, candidate, fallen_in) and distance > farthest[2]:
            farthest = wp.vec3(candidate[0], candidate[1], distance)
    farthest_out[block] = farthest


@wp.kernel
def want(
    first: int,
    # model
    rules: HerdRules,
    pen: Pen,
    walls: WallGrid,
    # state in
    velocities_in: wp.array[wp.vec3],
    known_in: wp.array[wp.vec2],
    fallen_in: wp.array[wp.int32],
    user_in: wp.array[wp.vec4],
    table: CellTable,
    mind: HerdMind,
    # out
    seen: Seen,
    intended_out: wp.array[wp.vec2],
    desired_out: wp.array[wp.vec2],
):
    """Decide on a desired velocity, in view of the neighbours that were seen."""
    agent = first + wp.tid()
    place = table.places[agent]
    if not is_member(agent, place, fallen_in):
        desired_out[agent] = wp.vec2(0.0, 0.0)
        intended_out[agent] = wp.vec2(0.0, 0.0)
        return
    user = wp.vec2(user_in[0][0], user_in[0][1])
    found = seen.found[agent]
    herding = regard_neighbours(agent, found, velocities_in, known_in, fallen_in, rules, pen, table, seen)
    wanted = shortened(0.5 * (herding + shared_velocity(place, user, rules, pen, mind)), rules.max_speed)

    passes = wp.int32(0)
    while passes < LIMIT_PASSES:
        before = wanted
        wanted = limit_approach_to_user(wanted, place, user_in[0], rules)
        wanted = limit_approach_to_neighbours(wanted, agent, found, seen)
        wanted = limit_approach_to_walls(wanted, place, rules.wall_gain, rules.wall_distance, walls)
        passes = wp.where(wanted == before, LIMIT_PASSES, passes + 1)

    own = on_ground(velocities_in[agent])
    wanted = shortened(own + shortened(wanted - own, rules.max_change), rules.max_speed)
    desired_out[agent] = wanted
    intended_out[agent] = wanted
