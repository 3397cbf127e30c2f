"""Who drives the collie: a herding dog of its own, or the waypoints of a scenario. Drivers give commands to `bicycle`.

The dog
-------
Robots flee along the ray from the collie to the centroid of the herd. So whoever stands behind the herd, seen from
where it is to go, drives it there: the rule of thumb of shepherds and of shepherding algorithms (Strombom et al.
2014: drive the herd while it is together, else go round to who is farthest away). In every frame, from places alone:

1. *Where to?* Who has strayed: back to the others. Otherwise the herd: on to the axis of the corral's opening some
   way ahead of the mouth, and then in.
2. *Behind* is the point opposite of that, seen from the centroid. Far off its bearing the dog *flanks*: it rides
   round the herd, outside of the distance at which the herd flees. Near its bearing it *drives*: it closes in along
   the line, the slower the nearer.
3. Before the mouth it *waits*, some metres short, and keeps the herd in by being there.

Waypoints
---------
The rider makes for the place where it is to be `WAYPOINT_AHEAD` later, at the speed that takes it there in that time.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

from echelon.flocking.bicycle import Bicycle, BicycleLimits, angle_from, direction, steering_toward
from echelon.flocking.herding import HerdMind
from echelon.flocking.perception import Pen, from_pen_axes, in_pen_axes, is_inside, way_to

wp.set_module_options({"enable_backward": False})

# Where the herd is to go, along the axis of the opening, measured from the mouth [m].
ENTER_FROM = wp.constant(10.0)  # nearer than this, and this near to the axis, it is sent in
ENTER_WIDTH = wp.constant(2.5)
GIVE_UP_WIDTH = wp.constant(7.0)  # farther off the axis than this before the mouth, it is brought round again
APPROACH = wp.constant(5.0)  # it is led to the axis at half its distance, but no nearer than this
BACK_OUT = wp.constant(14.0)  # from beside the mouth it is driven out to here first

# How the dog goes about it.
STRAYED = wp.constant(5.0)  # [m]; who is this much farther from the centroid than a herd reaches has strayed...
GATHERED = wp.constant(3.0)  # [m]; ... until no one is farther than this
FLANK_ANGLE = wp.constant(0.7)  # [rad]; farther off the bearing of behind the dog flanks...
DRIVE_ANGLE = wp.constant(0.4)  # [rad]; ... until it is nearer than this
TURN_BACK_ANGLE = wp.constant(2.5)  # [rad]; it goes round by the shorter side, unless both are nearly as long
FLANK_ROOM = wp.constant(1.5)  # [m]; it rides round the herd by so much outside of the flee distance
FLANK_SPEED = wp.constant(5.0)  # [m/s]
FLANK_AHEAD = wp.constant(0.5)  # [rad]; it looks so far ahead round the circle
DRIVE_DISTANCE = wp.constant(8.0)  # [m]; it closes in on the centroid to this...
DRIVE_ROOM = wp.constant(3.0)  # [m]; ... or to this from the farthest member...
PRESSURE = wp.constant(2.0)  # [m]; ... but always so far within the flee distance
PATIENCE = wp.constant(2.0)  # [m]; it stays so much farther away when the herd is at the mouth
CLOSING_GAIN = wp.constant(0.8)  # [1/s]
LINE_AHEAD = wp.constant(0.6)  # part of its distance from the centroid at which it aims for the line through behind
WAIT_DISTANCE = wp.constant(7.0)  # [m] from the mouth
FENCE_ROOM = wp.constant(2.5)  # [m]; it aims for nothing nearer to a fence
CORNER_SPEED = wp.constant(2.5)  # [m/s]; slow enough for its tightest turn

WAYPOINT_AHEAD = wp.constant(1.0)  # [s]


@wp.struct
class DogRules:
    """What the dog goes by.

    Attributes:
        flee_distance: At which the herd flees [m].
        herd_radius: About the radius that the herd needs [m].
        field_straight: Half the length of the field's straight sides [m].
        field_radius: Half the field's width [m]; 0 for an open plane.
    """

    flee_distance: wp.float32
    herd_radius: wp.float32
    field_straight: wp.float32
    field_radius: wp.float32


@wp.struct
class DogMind:
    """What the dog has made up its mind about; arrays of one.

    Attributes:
        entering: 1 once it sends the herd in.
        gathering: 1 while it brings back who has strayed.
        flank: 1 or -1 while it rides round the herd, to the left or to the right; else 0.
    """

    entering: wp.array[wp.int32]
    gathering: wp.array[wp.int32]
    flank: wp.array[wp.int32]


@wp.func
def on_field(point: wp.vec2, rules: DogRules) -> wp.vec2:
    """The nearest point of the field that is `FENCE_ROOM` within its fence [m]."""
    if rules.field_radius <= 0.0:
        return point
    axis = wp.vec2(wp.clamp(point[0], -rules.field_straight, rules.field_straight), 0.0)
    gap = point - axis
    return axis + gap * wp.min(1.0, wp.max(rules.field_radius - FENCE_ROOM, 0.0) / wp.max(wp.length(gap), 1.0e-6))


@wp.func
def herd_direction(centroid: wp.vec2, pen: Pen, dog: DogMind) -> wp.vec2:
    """The direction in which the herd is to go: toward the corral, or the middle of the field where there is none."""
    if pen.present == 0:
        return wp.normalize(-centroid)
    local = in_pen_axes(centroid, pen)
    ahead = local[0] - pen.half_size
    if dog.entering[0] == 0 and ahead < ENTER_FROM and wp.abs(local[1]) < ENTER_WIDTH:
        dog.entering[0] = 1
    if dog.entering[0] == 1 and ahead > 0.0 and wp.abs(local[1]) > GIVE_UP_WIDTH:
        dog.entering[0] = 0
    target = -2.0 * pen.half_size  # beyond the back fence: the direction stays the same all the way in
    if dog.entering[0] == 0:
        target = wp.where(ahead < ENTER_FROM, BACK_OUT, wp.max(0.5 * ahead, APPROACH))
    return wp.normalize(from_pen_axes(wp.vec2(pen.half_size + target, 0.0), pen) - centroid)


@wp.kernel
def drive_as_dog(
    # model
    limits: BicycleLimits,
    rules: DogRules,
    pen: Pen,
    # state in
    mind: HerdMind,
    farthest_in: wp.array[wp.vec3],
    bicycle: Bicycle,
    # state in and out
    dog: DogMind,
    # out
    command_out: wp.array[wp.vec2],
):
    """Decide on speed and steering; one thread."""
    place = bicycle.place[0]
    centroid = mind.centroid[0]
    stray = wp.vec3(0.0, 0.0, 0.0)
    for block in range(farthest_in.shape[0]):
        if farthest_in[block][2] > stray[2]:
            stray = farthest_in[block]

    # Where to?
    toward = herd_direction(centroid, pen, dog)
    limit = rules.herd_radius + wp.where(dog.gathering[0] == 1, GATHERED, STRAYED)
    gathering = stray[2] > limit and not is_inside(centroid, pen)
    dog.gathering[0] = wp.where(gathering, 1, 0)
    if gathering:
        toward = wp.normalize(centroid - wp.vec2(stray[0], stray[1]))

    # Behind.
    out = place - centroid
    distance = wp.length(out)
    off = angle_from(out, -toward)
    aim = centroid - (LINE_AHEAD * distance) * toward
    near_mouth = pen.present == 1 and in_pen_axes(centroid, pen)[0] - pen.half_size < ENTER_FROM
    stand = wp.max(DRIVE_DISTANCE, stray[2] + DRIVE_ROOM) + wp.where(near_mouth, PATIENCE, 0.0)
    speed = CLOSING_GAIN * (distance - wp.min(stand, rules.flee_distance - PRESSURE))
    if wp.abs(off) > wp.where(dog.flank[0] == 0, FLANK_ANGLE, DRIVE_ANGLE):
        if dog.flank[0] == 0 or wp.abs(off) < TURN_BACK_ANGLE:
            dog.flank[0] = wp.where(off < 0.0, -1, 1)
        bearing = wp.atan2(out[1], out[0]) + wp.min(FLANK_AHEAD, wp.abs(off)) * float(dog.flank[0])
        aim = centroid + wp.max(rules.flee_distance, stray[2]) * direction(bearing) + FLANK_ROOM * direction(bearing)
        speed = FLANK_SPEED
    else:
        dog.flank[0] = 0

    # The way there, and no faster than it allows.
    way = way_to(place, on_field(aim, rules), FENCE_ROOM, pen)
    leg = wp.vec2(way[0], way[1])
    forward = direction(bicycle.heading[0])
    speed = wp.min(speed, wp.max(limits.max_speed * (1.0 - wp.abs(angle_from(forward, leg - place))), CORNER_SPEED))
    mine = in_pen_axes(place, pen)
    waiting = dog.flank[0] == 0 and wp.dot(forward, pen.facing) < 0.0
    if pen.present == 1 and waiting and wp.abs(mine[1]) < pen.half_size + FENCE_ROOM:
        room = wp.max(mine[0] - pen.half_size - WAIT_DISTANCE, 0.0)
        speed = wp.min(speed, wp.sqrt(2.0 * limits.max_acceleration * room))
    command_out[0] = wp.vec2(wp.clamp(speed, 0.0, limits.max_speed), steering_toward(leg, bicycle, limits))


@wp.func
def place_at(time: float, waypoints: wp.array[wp.vec3]) -> wp.vec2:
    """Where the waypoints (time [s], x [m], y [m]) want the rider to be at a time, straight from one to the next."""
    first = waypoints[0]
    place = wp.vec2(first[1], first[2])
    for index in range(1, waypoints.shape[0]):
        start = waypoints[index - 1]
        end = waypoints[index]
        if time > start[0]:
            part = wp.min((time - start[0]) / (end[0] - start[0]), 1.0)
            place = wp.vec2(start[1] + part * (end[1] - start[1]), start[2] + part * (end[2] - start[2]))
    return place


@wp.kernel
def drive_by_waypoints(
    # model
    limits: BicycleLimits,
    waypoints: wp.array[wp.vec3],
    # state in
    frame_in: wp.array[wp.int32],
    bicycle: Bicycle,
    # out
    command_out: wp.array[wp.vec2],
):
    """Decide on speed and steering; one thread."""
    time = float(frame_in[0]) * limits.step
    aim = place_at(time + WAYPOINT_AHEAD, waypoints)
    gap = aim - bicycle.place[0]
    # To the first there may be more time than that.
    speed = wp.length(gap) / wp.max(WAYPOINT_AHEAD, waypoints[0][0] - time)
    # A place just passed is not worth a full turn.
    behind = wp.dot(gap, direction(bicycle.heading[0])) < 0.0
    if behind and wp.length(gap) < 2.0:
        speed = 0.0
    command_out[0] = wp.vec2(wp.min(speed, limits.max_speed), steering_toward(aim, bicycle, limits))
