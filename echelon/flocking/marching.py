"""A group on the march: everybody is told one velocity, and keeps his distance from others and from what is in the way.

What the test problems of Brogan and Hodgins (*Group Behaviors for Systems with Significant Dynamics*, 1997) ask for.
In every frame each one looks at the nearest others in sight, and turns the group's velocity aside where a fence or a
column lies across it (`bent`). Then one of four laws says what velocity is wanted:

`brogan-hodgins`, as published
    Every neighbour has a place for me: `spacing` away from it on the line that joins us. My desired position is the
    mean of these places, the near ones weighing most (1 / d^2), and

        v = v_group + gain (desired position - place)

    That is all. Who is heavy, and slow to change, runs into others: what this costs is what the tests show.

`approach`
    The same, of places as they will be `lookahead` seconds later; then the speed toward each neighbour, fence and
    column is limited in proportion to the room that is left, and the change that is asked for to what a body can do in
    one stride. Enough for whoever can stop and step aside: point masses and hoppers.

`foresight`
    A bicycle can do neither. Its rider compares velocities: of each, where would I be over the next seconds, my
    velocity changing no faster than my body allows (`reckoned`), and where would the others be who carry out what they
    wanted a frame ago? The best is near the velocity of `brogan-hodgins` and that of the frame before, and keeps clear
    of all.

`alone`
    The group's velocity, turned aside for what is in the way, and blind to others: for planners that see them
    (`echelon.benchmarks.orca`), and to see what the other laws are good for.

The frame loop's rules hold: a thread looks at one agent, reads what others showed in the frame before, writes its own.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import numpy as np
import warp as wp

from echelon.flocking.herding import Seen, is_member, limit_approach_to_neighbours, on_ground, shortened
from echelon.flocking.perception import limit_approach_to_walls
from echelon.scenario import HerdSettings, WorldSettings
from echelon.terrain.walls import WallGrid, closest_on_wall, infield_walls, segments, walls_of_cell
from echelon.warp_kernels.neighbours import CellTable

wp.set_module_options({"enable_backward": False})

LAWS = ("brogan-hodgins", "approach", "foresight", "alone")
BROGAN_HODGINS = wp.constant(0)
APPROACH = wp.constant(1)
FORESIGHT = wp.constant(2)
ALONE = wp.constant(3)

BENDS = wp.constant(3)  # times that a way is turned aside, at most, for what is behind what
LIMIT_PASSES = wp.constant(3)  # times that all limits on the speed of approach are gone through
STEPS = wp.constant(14)  # into which the horizon is divided
DIRECTIONS = wp.constant(13)  # that are compared, ahead and to both sides
SPEEDS = wp.constant(6)  # that are compared in each direction
TOUCH_GAP = wp.constant(0.15)  # [m]; nearer than this to touching counts as a collision that is coming
TOUCH_COST = wp.constant(60.0)
CROWD_COST = wp.constant(4.0)
WALL_COST = wp.constant(60.0)
KEEPING = wp.constant(2.0)  # cost of changing one's mind, beside that of not having one's will
YIELDING = wp.constant(0.25)  # part of the way to what is wanted now that is tried for its own sake


@wp.struct
class MarchRules:
    """`HerdSettings` as these kernels see them, units as there.

    Attributes:
        law: Index into `LAWS`.
    """

    law: wp.int32
    spacing: wp.float32
    visibility: wp.float32
    gain: wp.float32
    max_speed: wp.float32
    max_change: wp.float32
    wall_distance: wp.float32
    wall_gain: wp.float32
    radius: wp.float32
    clearance: wp.float32
    clearance_gain: wp.float32
    lookahead: wp.float32
    sight: wp.float32
    horizon: wp.float32
    response: wp.float32
    acceleration: wp.float32
    slowest: wp.float32
    nose: wp.float32


@wp.struct
class March:
    """Where a group is told to go, and what stands in its way.

    Attributes:
        rules: What each one goes by.
        plan: Frame from which, and velocity (x, y) that, the group is told, by rising frames, shape [turns + 1].
        fences: Their straight pieces (x0, y0, x1, y1) [m], shape [pieces].
        columns: (x, y, radius) [m], shape [columns].
        walls: All of these together, to be asked what is near.
    """

    rules: MarchRules
    plan: wp.array[wp.vec3]
    fences: wp.array[wp.vec4]
    columns: wp.array[wp.vec3]
    walls: WallGrid


def march_of(
    settings: HerdSettings, world: WorldSettings, walls: WallGrid, frame_rate: int, device: wp.DeviceLike = None
) -> March:
    """A march as kernels see it.

    Args:
        settings: Of what each one wants.
        world: Where.
        walls: The world's, within the reach of limits on approach.
        frame_rate: Frames a second.
        device: Where the arrays live.
    """
    rules = MarchRules()
    for name in MarchRules.vars:
        setattr(rules, name, LAWS.index(settings.law) if name == "law" else getattr(settings, name))
    turns = [(round(t * frame_rate), x, y) for t, x, y in settings.turns]
    march = March()
    march.rules = rules
    march.plan = wp.array([(-(2.0**30), *settings.desired_velocity), *turns], dtype=wp.vec3, device=device)
    march.fences = wp.array(segments(infield_walls(world)), dtype=wp.vec4, device=device)
    march.columns = wp.array(world.all_columns().astype(np.float32), dtype=wp.vec3, device=device)
    march.walls = walls
    return march


@wp.func
def planned(frame: int, plan: wp.array[wp.vec3]) -> wp.vec2:
    """What the group is told in a frame [m/s]."""
    velocity = wp.vec2(plan[0][1], plan[0][2])
    for turn in range(1, plan.shape[0]):
        if float(frame) >= plan[turn][0]:
            velocity = wp.vec2(plan[turn][1], plan[turn][2])
    return velocity


# ---- what is across the way ------------------------------------------------------------------------------------------
@wp.func
def cross(a: wp.vec2, b: wp.vec2) -> float:
    """Sine of the angle from a to b, to the left, times both lengths."""
    return a[0] * b[1] - a[1] * b[0]


@wp.func
def bent(place: wp.vec2, velocity: wp.vec2, before: wp.vec2, march: March) -> wp.vec2:
    """A velocity, turned so that it passes whatever it meets first within sight: round the nearer end or side.

    The way keeps `wall_distance` from posts and columns. On which side of a column it leads is decided by `before`, the
    velocity that was wanted last: nobody wavers in front of one.
    """
    speed = wp.length(velocity)
    if speed < 1.0e-4:
        return velocity
    ahead = velocity / speed
    margin = march.rules.wall_distance
    passes = wp.int32(0)
    while passes < BENDS:
        first = march.rules.sight
        turned = ahead
        for index in range(march.fences.shape[0]):
            wall = march.fences[index]
            start = wp.vec2(wall[0], wall[1])
            along = wp.vec2(wall[2], wall[3]) - start
            length = wp.length(along)
            slope = cross(ahead, along)
            if length > 1.0e-6 and wp.abs(slope) > 1.0e-6 * length:
                away = cross(start - place, along) / slope
                part = cross(start - place, ahead) / slope * length  # from the start along the wall [m]
                if away > 0.0 and away < first and part > -margin and part < length + margin:
                    first = away
                    unit = along / length
                    post = start - margin * 1.05 * unit
                    if part > 0.5 * length:
                        post = start + (length + margin * 1.05) * unit
                    turned = wp.normalize(post - place)
        for index in range(march.columns.shape[0]):
            column = march.columns[index]
            gap = wp.vec2(column[0], column[1]) - place
            keep = column[2] + margin
            distance = wp.length(gap)
            on_the_way = wp.dot(gap, ahead)
            beside = cross(ahead, gap)
            if on_the_way > 0.0 and wp.abs(beside) < keep and on_the_way < first + keep:
                reach = on_the_way - wp.sqrt(wp.max(keep * keep - beside * beside, 0.0))
                if reach < first:
                    first = reach
                    # The tangent on the side that is nearer; from within the margin, straight past.
                    sine = wp.min(keep / wp.max(distance, 1.0e-6), 1.0)
                    cosine = wp.sqrt(wp.max(1.0 - sine * sine, 0.0))
                    leaning = cross(before, gap)
                    if wp.dot(before, ahead) <= 0.0:
                        leaning = beside
                    side = wp.where(leaning > 0.0, -1.0, 1.0)
                    toward = gap / wp.max(distance, 1.0e-6)
                    turned = cosine * toward + side * sine * wp.vec2(-toward[1], toward[0])
        passes = wp.where(turned == ahead, BENDS, passes + 1)
        ahead = turned
    return speed * ahead


# ---- the laws --------------------------------------------------------------------------------------------------------
@wp.func
def spaced(
    agent: int,
    found: int,
    ahead_by: float,
    velocities: wp.array[wp.vec3],
    fallen: wp.array[wp.int32],
    rules: MarchRules,
    table: CellTable,
    seen: Seen,
) -> wp.vec2:
    """Velocity toward the desired position: the mean of the places that neighbours have for one, by 1 / d^2 [m/s]."""
    place = table.places[agent]
    own = on_ground(velocities[agent])
    asked = wp.vec2(0.0, 0.0)
    weights = wp.float32(0.0)
    for k in range(found):
        other = seen.indices[agent, k]
        gap = table.places[other] - place + ahead_by * (on_ground(velocities[other]) - own)
        distance = wp.max(wp.length(gap), 1.0e-2)
        # The fallen keep nobody together.
        if fallen[other] == 0 or distance < rules.spacing:
            weight = 1.0 / (distance * distance)
            asked += weight * (1.0 - rules.spacing / distance) * gap
            weights += weight
    if weights == 0.0:
        return asked
    return shortened(asked * (rules.gain / weights), rules.max_speed)


@wp.func
def note_room(
    agent: int,
    found: int,
    velocities: wp.array[wp.vec3],
    known: wp.array[wp.vec2],
    rules: MarchRules,
    table: CellTable,
    seen: Seen,
):
    """The limits on the speed toward each neighbour, as `herding.regard_neighbours` sets them."""
    place = table.places[agent]
    own = on_ground(velocities[agent])
    keep = 2.0 * rules.radius + rules.clearance
    for k in range(found):
        other = seen.indices[agent, k]
        gap = table.places[other] - place
        distance = wp.max(seen.distances[agent, k], 1.0e-6)
        toward = gap * (1.0 / distance)
        drift = rules.lookahead * (on_ground(velocities[other]) - own)
        leaving = wp.dot(known[other], toward)
        room = distance + wp.dot(drift, toward) - keep
        seen.towards[agent, k] = toward
        seen.fastest[agent, k] = wp.where(leaving < 0.0, 0.5, 1.0) * leaving + rules.clearance_gain * room


@wp.func
def reckoned(velocity: wp.vec2, target: wp.vec2, time: float, rules: MarchRules) -> wp.vec2:
    """How far a body gets that goes on for `response` and then changes its velocity evenly to a target [m]."""
    change = target - velocity
    taken = wp.length(change) / rules.acceleration
    since = time - rules.response
    way = time * velocity
    if since > 0.0:
        if since < taken:
            way += (0.5 * since * since / taken) * change
        else:
            way += (since - 0.5 * taken) * change
    return way


@wp.func
def reckoned_heading(velocity: wp.vec2, target: wp.vec2, time: float, rules: MarchRules) -> wp.vec2:
    """The direction in which a body goes by then that does as in `reckoned`."""
    taken = wp.max(wp.length(target - velocity) / rules.acceleration, 1.0e-6)
    share = wp.clamp((time - rules.response) / taken, 0.0, 1.0)
    return wp.normalize(velocity + share * (target - velocity))


@wp.func
def turned_by(vector: wp.vec2, angle: float) -> wp.vec2:
    """A vector turned to the left [rad]."""
    c = wp.cos(angle)
    s = wp.sin(angle)
    return wp.vec2(c * vector[0] - s * vector[1], s * vector[0] + c * vector[1])


@wp.func
def side_angle(index: int) -> float:
    """The turns that are compared [rad]: 0, then ever larger ones to the left and to the right."""
    step = float((index + 1) / 2)
    size = 0.09 * step + 0.025 * step * step
    return wp.where(index % 2 == 1, size, -size)


@wp.func
def nearest_of_cell(point: wp.vec2, walls: WallGrid) -> float:
    """Distance from a point to the nearest wall, or the grid's reach where that is less [m]."""
    nearest = walls.reach
    cells = walls_of_cell(point, walls)
    for index in range(cells[0], cells[1]):
        wall = walls.walls[walls.members[index]]
        nearest = wp.min(nearest, wp.length(closest_on_wall(point, wall) - point))
    return nearest


@wp.func
def consequence(
    agent: int,
    found: int,
    candidate: wp.vec2,
    velocities: wp.array[wp.vec3],
    known: wp.array[wp.vec2],
    march: March,
    table: CellTable,
    seen: Seen,
) -> float:
    """What a velocity costs over the horizon: nearness to others, fences and columns."""
    rules = march.rules
    place = table.places[agent]
    own = on_ground(velocities[agent])
    cost = wp.float32(0.0)
    share = 1.0 / float(STEPS)
    last = place + rules.nose * reckoned_heading(own, candidate, 0.0, rules)
    for step in range(STEPS):
        time = rules.horizon * float(step + 1) * share
        soon = share * (1.25 - float(step) * share)
        there = place + reckoned(own, candidate, time, rules)
        for k in range(found):
            other = seen.indices[agent, k]
            gap = table.places[other] + reckoned(on_ground(velocities[other]), known[other], time, rules) - there
            room = wp.length(gap) - 2.0 * rules.radius
            near = wp.max(1.0 - room / rules.clearance, 0.0)
            touch = wp.max(1.0 - room / TOUCH_GAP, 0.0)
            cost += soon * (CROWD_COST * near * near + TOUCH_COST * wp.min(touch, 2.0))
        nose = there + rules.nose * reckoned_heading(own, candidate, time, rules)
        # Half way too: a thin wall must not fall between two looks.
        nearest = wp.min(nearest_of_cell(nose, march.walls), nearest_of_cell(0.5 * (nose + last), march.walls))
        last = nose
        tight = wp.max(1.0 - (nearest - rules.radius) / wp.max(rules.wall_distance - rules.radius, 1.0e-3), 0.0)
        into = wp.max(1.0 - (nearest - rules.radius) / TOUCH_GAP, 0.0)
        cost += soon * (CROWD_COST * tight * tight + WALL_COST * wp.min(into, 2.0))
    return cost


@wp.func
def foreseen(
    agent: int,
    found: int,
    wanted: wp.vec2,
    velocities: wp.array[wp.vec3],
    known: wp.array[wp.vec2],
    march: March,
    table: CellTable,
    seen: Seen,
) -> wp.vec2:
    """Of velocities about the wanted one, that whose consequences, and whose difference from it, cost least [m/s]."""
    rules = march.rules
    speed = wp.max(wp.length(wanted), 1.0e-3)
    ahead = wanted / speed
    usual = 1.0 / wp.max(speed * speed, 0.25)
    best = known[agent]
    least = wp.float32(1.0e30)
    # What was wanted last, a part of the way from there to what is wanted now, and then the fan.
    for index in range(DIRECTIONS * SPEEDS + 2):
        candidate = known[agent] + (YIELDING * float(index)) * (wanted - known[agent])
        if index > 1:
            pace = float((index - 2) % SPEEDS)
            size = wp.clamp(speed * (1.15 - 0.15 * pace), rules.slowest, rules.max_speed)
            candidate = size * turned_by(ahead, side_angle((index - 2) / SPEEDS))
        off = candidate - wanted
        other = candidate - known[agent]
        cost = usual * (wp.dot(off, off) + KEEPING * wp.dot(other, other))
        if cost < least:
            cost += consequence(agent, found, candidate, velocities, known, march, table, seen)
        if cost < least:
            least = cost
            best = candidate
    return best


@wp.kernel
def follow_march(
    # model
    first: int,
    march: March,
    # state in
    frame_in: wp.array[wp.int32],
    velocities_in: wp.array[wp.vec3],
    known_in: wp.array[wp.vec2],
    fallen_in: wp.array[wp.int32],
    table: CellTable,
    # out
    seen: Seen,
    intended_out: wp.array[wp.vec2],
    desired_out: wp.array[wp.vec2],
):
    """Decide on a desired velocity, in view of the neighbours that were seen."""
    agent = first + wp.tid()
    rules = march.rules
    place = table.places[agent]
    if not is_member(agent, place, fallen_in):
        desired_out[agent] = wp.vec2(0.0, 0.0)
        intended_out[agent] = wp.vec2(0.0, 0.0)
        return
    found = seen.found[agent]
    ahead_by = wp.where(rules.law == BROGAN_HODGINS, 0.0, rules.lookahead)
    wanted = bent(place, planned(frame_in[0], march.plan), known_in[agent], march)
    if rules.law != ALONE:
        wanted += spaced(agent, found, ahead_by, velocities_in, fallen_in, rules, table, seen)
    wanted = shortened(wanted, rules.max_speed)
    if rules.law == APPROACH:
        note_room(agent, found, velocities_in, known_in, rules, table, seen)
        passes = wp.int32(0)
        while passes < LIMIT_PASSES:
            before = wanted
            wanted = limit_approach_to_neighbours(wanted, agent, found, seen)
            wanted = limit_approach_to_walls(wanted, place, rules.wall_gain, rules.radius, march.walls)
            passes = wp.where(wanted == before, LIMIT_PASSES, passes + 1)
        own = on_ground(velocities_in[agent])
        wanted = shortened(own + shortened(wanted - own, rules.max_change), rules.max_speed)
    elif rules.law == FORESIGHT:
        wanted = foreseen(agent, found, wanted, velocities_in, known_in, march, table, seen)
    desired_out[agent] = wanted
    intended_out[agent] = wanted
