"""What each one sees: the neighbours that count, fences, the pen, and how fast it may approach what it sees.

Seeing neighbours
    The k nearest within sight (`echelon.warp_kernels.neighbours`), where they will be, not where they are: a hopping
    robot takes up a new velocity only when it leaves the ground and has it by the next time it does, so both places
    are moved `lookahead` seconds along the present velocities before they are compared.

Seeing a way
    A neighbour behind the fence of the corral is looked for round the fence: `way_to` gives the first leg of the way,
    and its whole length stands for the distance. Without this those left outside press against the fence as near as
    they can come to their fellows within.

Approaching
    Nobody is pushed away from an obstacle by a force; rather the speed of approach is limited, in proportion to the
    room that is left. Motion along a fence or beside a neighbour stays free, and the limits of several obstacles are
    met together by going through them a few times, always in the same order.

All places and velocities are on the ground, world axes, in metres and seconds.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import math

import warp as wp

from echelon.scenario import WorldSettings
from echelon.terrain.walls import WallGrid, closest_on_wall, walls_of_cell

wp.set_module_options({"enable_backward": False})


@wp.struct
class Pen:
    """The corral as kernels see it.

    Attributes:
        present: 1 where there is a corral, else 0.
        center: Middle of the square [m].
        facing: Unit vector in which the opening looks.
        half_size: Half the length of a side [m].
        half_gap: Half the width of the opening [m].
    """

    present: wp.int32
    center: wp.vec2
    facing: wp.vec2
    half_size: wp.float32
    half_gap: wp.float32


def pen_of(world: WorldSettings) -> Pen:
    """The corral of a world, or one that is not present."""
    pen = Pen()
    pen.facing = wp.vec2(1.0, 0.0)
    if world.corral is not None:
        length = math.hypot(*world.corral.facing)
        pen.present = 1
        pen.center = wp.vec2(*world.corral.center)
        pen.facing = wp.vec2(world.corral.facing[0] / length, world.corral.facing[1] / length)
        pen.half_size = 0.5 * world.corral.size
        pen.half_gap = 0.5 * world.corral.opening
    return pen


# ---- the pen ---------------------------------------------------------------------------------------------------------
@wp.func
def in_pen_axes(place: wp.vec2, pen: Pen) -> wp.vec2:
    """A place as (ahead of the pen's middle in the direction it faces, left of that direction) [m]."""
    gap = place - pen.center
    return wp.vec2(
        wp.dot(gap, pen.facing),
        pen.facing[0] * gap[1] - pen.facing[1] * gap[0],
    )


@wp.func
def from_pen_axes(local: wp.vec2, pen: Pen) -> wp.vec2:
    """The inverse of `in_pen_axes`."""
    return pen.center + wp.vec2(
        local[0] * pen.facing[0] - local[1] * pen.facing[1],
        local[0] * pen.facing[1] + local[1] * pen.facing[0],
    )


@wp.func
def is_inside(place: wp.vec2, pen: Pen) -> bool:
    """Whether a place is inside the pen's square."""
    local = in_pen_axes(place, pen)
    inside = wp.abs(local[0]) < pen.half_size and wp.abs(local[1]) < pen.half_size
    return pen.present == 1 and inside


@wp.func
def crosses_fence(a: wp.vec2, b: wp.vec2, pen: Pen) -> bool:
    """Whether the straight line from a to b, both in the pen's axes, crosses its fence."""
    h = pen.half_size
    enter = wp.float32(0.0)
    leave = wp.float32(1.0)
    apart = wp.bool(False)
    enters_in_front = wp.bool(False)
    leaves_in_front = wp.bool(False)
    for axis in range(2):
        start = a[axis]
        run = b[axis] - a[axis]
        if wp.abs(run) < 1.0e-9:
            apart = apart or wp.abs(start) >= h
        else:
            first = (-h - start) / run
            last = (h - start) / run
            front_is_last = run > 0.0
            if first > last:
                swap = first
                first = last
                last = swap
            if first > enter:
                enter = first
                enters_in_front = axis == 0 and not front_is_last
            if last < leave:
                leave = last
                leaves_in_front = axis == 0 and front_is_last
    if apart or enter >= leave:
        return False
    crosses = wp.bool(False)
    if enter > 0.0:
        side = a[1] + enter * (b[1] - a[1])
        crosses = not (enters_in_front and wp.abs(side) < pen.half_gap)
    if leave < 1.0:
        side = a[1] + leave * (b[1] - a[1])
        crosses = crosses or not (leaves_in_front and wp.abs(side) < pen.half_gap)
    return crosses


@wp.func
def way_to(place: wp.vec2, target: wp.vec2, clearance: float, pen: Pen) -> wp.vec3:
    """Where to head for, and how far it is, to reach a target that may lie behind the pen's fence.

    Args:
        place: Where the way begins [m].
        target: Where it ends [m].
        clearance: Distance that the way keeps from corners and posts [m].
        pen: The corral.

    Returns:
        (x, y) of the end of the first straight leg, and the length of the whole way, taken as two legs [m].
    """
    straight = wp.length(target - place)
    result = wp.vec3(target[0], target[1], straight)
    if pen.present == 0:
        return result
    a = in_pen_axes(place, pen)
    b = in_pen_axes(target, pen)
    h = pen.half_size
    # Most lines pass well clear of the square: its bounding box decides.
    if (
        (a[0] >= h and b[0] >= h)
        or (a[0] <= -h and b[0] <= -h)
        or (a[1] >= h and b[1] >= h)
        or (a[1] <= -h and b[1] <= -h)
    ):
        return result
    if not crosses_fence(a, b, pen):
        return result

    outer = h + clearance
    free = wp.max(pen.half_gap - clearance, 0.0)
    leg = wp.vec2(outer, wp.clamp(b[1], -free, free))  # from inside: out through the opening
    if not (wp.abs(a[0]) < h and wp.abs(a[1]) < h):
        if not (wp.abs(b[0]) < h and wp.abs(b[1]) < h):
            leg = corner_to_pass(a, b, outer, clearance)
        elif a[0] >= h:
            leg = wp.vec2(h, wp.clamp(a[1], -free, free))  # in through the opening
        else:
            leg = wp.vec2(outer, 0.0)  # first to before the opening
            if crosses_fence(a, leg, pen):
                leg = corner_to_pass(a, leg, outer, clearance)
    corner = from_pen_axes(leg, pen)
    return wp.vec3(corner[0], corner[1], wp.length(leg - a) + wp.length(b - leg))


@wp.func
def corner_to_pass(a: wp.vec2, b: wp.vec2, outer: float, reached: float) -> wp.vec2:
    """The corner of a square about the origin to make for on the way round it from a to b.

    Seen from a, the corner farthest to the left of b and the one farthest to the right; of the two the one with the
    shorter way. A corner nearer than half of `reached` is behind us.
    """
    ahead = b - a
    leftmost = wp.float32(-4.0)
    rightmost = wp.float32(4.0)
    left = b
    right = b
    for index in range(4):
        corner = wp.vec2(
            wp.where(index == 0 or index == 3, outer, -outer),
            wp.where(index < 2, outer, -outer),
        )
        gap = corner - a
        if wp.length(gap) > 0.5 * reached:
            angle = wp.atan2(ahead[0] * gap[1] - ahead[1] * gap[0], wp.dot(ahead, gap))
            if angle > leftmost:
                leftmost = angle
                left = corner
            if angle < rightmost:
                rightmost = angle
                right = corner
    if wp.length(left - a) + wp.length(b - left) < wp.length(right - a) + wp.length(b - right):
        return left
    return right


# ---- approaching -----------------------------------------------------------------------------------------------------
@wp.func
def limit_approach(velocity: wp.vec2, toward: wp.vec2, fastest: float) -> wp.vec2:
    """Take from a velocity what exceeds `fastest` [m/s] along the unit vector `toward`; a negative limit backs away."""
    excess = wp.dot(velocity, toward) - fastest
    if excess > 0.0:
        return velocity - excess * toward
    return velocity


@wp.func
def limit_approach_to_walls(velocity: wp.vec2, place: wp.vec2, gain: float, standoff: float, grid: WallGrid) -> wp.vec2:
    """Limit the speed toward every wall within reach to `gain` [1/s] times the room left before `standoff` [m]."""
    limited = velocity
    places = walls_of_cell(place, grid)
    for index in range(places[0], places[1]):
        gap = closest_on_wall(place, grid.walls[grid.members[index]]) - place
        distance = wp.length(gap)
        if distance > 1.0e-6 and distance < grid.reach:
            limited = limit_approach(limited, gap / distance, gain * (distance - standoff))
    return limited
