"""Which neighbours an agent meets in a frame, and where they are when it begins.

A neighbour becomes a ghost (see `meeting`) if the two might touch before the frame is over: if the gap between their
capsules is less than what they can cover at the speed at which they pass each other. Of these the nearest `GHOSTS`
are taken, sorted by (gap, index), so that neither the order of agents nor that of threads matters.

    enter    everybody who can be touched goes into a hash grid, by centre of mass
    choose   each of one's own agents finds its ghosts, as numbers that the frame kernel's substeps read

Places of others are subtracted in float64; what an agent computes with is relative to its own floating origin.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import numpy as np
import warp as wp

from echelon.warp_kernels.meeting import GHOST_MOTION, PAIR_MEMORY, SIDE_BY_SIDE, UNDECIDED, Bumper
from echelon.warp_kernels.neighbours import (
    NOBODY,
    CellTable,
    cell_entry,
    cell_table,
    enter_agent,
    insert_neighbour,
    is_somewhere,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

UNTOUCHABLE = wp.constant(0)
"""Bearing of who is not there for others: lost or removed."""
CARRIED = wp.constant(1)
"""Bearing of who stands, rides or hops on the ground."""
FALLING = wp.constant(2)
"""Bearing of who is in the air."""
LYING = wp.constant(3)
"""Bearing of who has fallen, and is not pushed into the ground."""

FREE = wp.constant(-1.0e9)
"""Floor of a ghost that may fall [m/s]."""

MARGIN = wp.constant(0.08)
"""Added to the gap that two might close within a frame [m]: forces act in the meantime."""

WHOLE = wp.constant(1048576.0)
"""Impulses that are due are added up in so many parts of a newton second."""

TRAVEL = wp.constant(1.0)
"""Two who come closer by more than this in a frame may miss each other [m]."""

_MOTION = wp.constant(GHOST_MOTION)
_PAIR = wp.constant(PAIR_MEMORY)
_UNDECIDED = wp.constant(UNDECIDED)
_PULL = wp.constant(SIDE_BY_SIDE)
_FAR = wp.constant(1.0e4)


@wp.struct
class PublicMotion:
    """How everybody moves, as others see it; shape [crowd] each.

    Attributes:
        places: Of the first link in the world [m].
        attitudes: Of the first link, x y z w.
        velocities: Of its origin [m/s].
        spins: Its angular velocity, world axes [rad/s].
        bearings: What carries it, or `UNTOUCHABLE`.
        partners: Whom each met in the frame before, or -1, shape [crowd, GHOSTS].
        given: Impulse that each then gave them [N s], shape [crowd, GHOSTS].
    """

    places: wp.array[wp.vec3d]
    attitudes: wp.array[wp.quat]
    velocities: wp.array[wp.vec3]
    spins: wp.array[wp.vec3]
    bearings: wp.array[wp.int32]
    partners: wp.array2d[wp.int32]
    given: wp.array2d[wp.vec3]


@wp.struct
class BumperData:
    """A `Bumper` for kernels.

    Attributes:
        center: Centre of mass in the first link's axes [m].
        starts, ends: Of the capsules' axes, from the centre [m], shape [capsules].
        radii: [m], shape [capsules].
        reach: Farthest that any capsule comes from the centre [m].
        gravity: [m/s^2].
    """

    center: wp.vec3
    starts: wp.array[wp.vec3]
    ends: wp.array[wp.vec3]
    radii: wp.array[wp.float32]
    reach: wp.float32
    gravity: wp.float32


def bumper_data(bumper: Bumper, gravity: float, device: wp.DeviceLike = None) -> BumperData:
    """A bumper on a device."""
    center = np.array(bumper.center)
    data = BumperData()
    data.center = wp.vec3(*bumper.center)
    data.starts = wp.array([np.array(c.start) - center for c in bumper.capsules], dtype=wp.vec3, device=device)
    data.ends = wp.array([np.array(c.end) - center for c in bumper.capsules], dtype=wp.vec3, device=device)
    data.radii = wp.array([c.radius for c in bumper.capsules], dtype=wp.float32, device=device)
    data.reach = bumper.reach
    data.gravity = gravity
    return data


def ghost_table(bumper: Bumper, crowd_count: int, device: wp.DeviceLike = None) -> CellTable:
    """An empty hash grid for the searches of `choose_ghosts`."""
    reach = 2.0 * bumper.reach + TRAVEL
    return cell_table(crowd_count, reach, reach, device)


# ---- geometry --------------------------------------------------------------------------------------------------------
@wp.func
def segment_distance(start: wp.vec3, along: wp.vec3, other_start: wp.vec3, other_along: wp.vec3) -> float:
    """Distance of two line segments, by `meeting.closest_points`."""
    gap = start - other_start + 0.5 * (along - other_along)
    aa = wp.max(wp.dot(along, along), 1.0e-8) * (1.0 + _PULL)
    bb = wp.max(wp.dot(other_along, other_along), 1.0e-8) * (1.0 + _PULL)
    ab = wp.dot(along, other_along)
    ag = wp.dot(along, gap)
    bg = wp.dot(other_along, gap)
    s = wp.clamp((ab * bg - bb * ag) / (aa * bb - ab * ab), -0.5, 0.5)
    t = wp.clamp((ab * s + bg) / bb, -0.5, 0.5)
    s = wp.clamp((ab * t - ag) / aa, -0.5, 0.5)
    apart = gap + s * along - t * other_along
    pull = _PULL / (1.0 + _PULL)
    return wp.sqrt(wp.dot(apart, apart) + pull * (aa * s * s + bb * t * t))


@wp.func
def capsule_gap(relative: wp.vec3, turn: wp.quat, other_turn: wp.quat, bumper: BumperData) -> float:
    """Least gap between the capsules of two, negative where they overlap [m].

    Args:
        relative: From the centre of mass of the one to that of the other [m].
        turn, other_turn: Attitudes.
        bumper: Of both.
    """
    least = wp.float32(1.0e9)
    for a in range(bumper.radii.shape[0]):
        start = wp.quat_rotate(turn, bumper.starts[a])
        along = wp.quat_rotate(turn, bumper.ends[a]) - start
        for b in range(bumper.radii.shape[0]):
            other_start = relative + wp.quat_rotate(other_turn, bumper.starts[b])
            other_along = relative + wp.quat_rotate(other_turn, bumper.ends[b]) - other_start
            distance = segment_distance(start, along, other_start, other_along)
            least = wp.min(least, distance - bumper.radii[a] - bumper.radii[b])
    return least


@wp.func
def origin_to_be(agent: int, lanes: int, state: wp.array3d[wp.float32], origins: wp.array2d[wp.float64]) -> wp.vec3d:
    """The floating origin of an agent as it will be when the frame begins: where its first link is [m]."""
    block = agent // lanes
    lane = agent - block * lanes
    return wp.vec3d(
        origins[agent, 0] + wp.float64(state[block, 0, lane]),
        origins[agent, 1] + wp.float64(state[block, 1, lane]),
        origins[agent, 2] + wp.float64(state[block, 2, lane]),
    )


@wp.func
def gap_between(
    agent: int,
    lanes: int,
    other: int,
    crowd: PublicMotion,
    bumper: BumperData,
    state: wp.array3d[wp.float32],
    origins: wp.array2d[wp.float64],
) -> float:
    """Least gap between the capsules of one of the engine's agents and another's [m]."""
    block = agent // lanes
    lane = agent - block * lanes
    turn = wp.quat(state[block, 3, lane], state[block, 4, lane], state[block, 5, lane], state[block, 6, lane])
    away = crowd.places[other] - origin_to_be(agent, lanes, state, origins)
    other_turn = crowd.attitudes[other]
    relative = wp.vec3(wp.float32(away[0]), wp.float32(away[1]), wp.float32(away[2]))
    relative = relative + wp.quat_rotate(other_turn, bumper.center) - wp.quat_rotate(turn, bumper.center)
    return capsule_gap(relative, turn, other_turn, bumper)


@wp.func
def account_of(one: int, other: int, crowd: PublicMotion) -> int:
    """Where one has written down what it gave the other in the frame before, or -1."""
    place = wp.int32(-1)
    for k in range(crowd.partners.shape[1]):
        if crowd.partners[one, k] == other:
            place = k
    return place


@wp.func
def unsettled(own: int, other: int, crowd: PublicMotion) -> wp.vec3:
    """Half of what own and other differ in about what they gave each other in the frame before [N s]."""
    # Both lists are filled from their beginnings.
    difference = wp.vec3(0.0, 0.0, 0.0)
    if crowd.partners[own, 0] == NOBODY and crowd.partners[other, 0] == NOBODY:
        return difference
    mine = account_of(own, other, crowd)
    theirs = account_of(other, own, crowd)
    if mine >= 0:
        difference = difference + crowd.given[own, mine]
    if theirs >= 0 and crowd.bearings[other] != UNTOUCHABLE:
        difference = difference + crowd.given[other, theirs]
    if not (wp.isfinite(difference[0]) and wp.isfinite(difference[1]) and wp.isfinite(difference[2])):
        difference = wp.vec3(0.0, 0.0, 0.0)
    return 0.5 * difference


# ---- kernels ---------------------------------------------------------------------------------------------------------
@wp.kernel
def enter_bodies(first: int, crowd: PublicMotion, bumper: BumperData, table: CellTable):
    """Enter everybody into an empty table; one thread for each of a slice of the crowd."""
    agent = first + wp.tid()
    arm = wp.quat_rotate(crowd.attitudes[agent], bumper.center)
    place = crowd.places[agent]
    on_ground = wp.vec2(wp.float32(place[0]) + arm[0], wp.float32(place[1]) + arm[1])
    if crowd.bearings[agent] == UNTOUCHABLE:
        on_ground = wp.vec2(wp.inf, wp.inf)
    enter_agent(agent, on_ground, table)


@wp.kernel
def choose_ghosts(
    first: int,
    # model
    first_agent: int,
    lanes: int,
    frame: float,
    bumper: BumperData,
    table: CellTable,
    # state in
    crowd: PublicMotion,
    state_in: wp.array3d[wp.float32],
    origins_in: wp.array2d[wp.float64],
    pressed_in: wp.array2d[wp.float32],
    # out
    indices_out: wp.array2d[wp.int32],
    gaps_out: wp.array2d[wp.float32],
    counts_out: wp.array[wp.int32],
    crossings_out: wp.array[wp.float32],
    ghosts_out: wp.array3d[wp.float32],
):
    """Find the ghosts of one's own agents; one thread for each of a slice of them.

    Args:
        first: Index of the slice's first agent among one's own.
        first_agent: Number in the crowd of one's own first agent.
        lanes: Agents a block.
        frame: Length of a frame [s].
        bumper: Of everybody.
        table: The hash grid.
        crowd: How everybody moves.
        state_in, origins_in: The engine's; the first link's coordinates are the first of the state.
        pressed_in: How far springs were pressed when the last frame ended, in the order of `crowd.partners`.
        indices_out, gaps_out: Rows of the agents to sort in, shape [agents, GHOSTS].
        counts_out: How many ghosts each has, shape [agents].
        crossings_out: How deep each overlaps another, 0 where it does not [m], shape [agents].
        ghosts_out: What they are due, and the ghosts' numbers, shape [blocks, DUE_SIZE + GHOSTS * ghost_size, lanes].
    """
    agent = first + wp.tid()
    own = first_agent + agent
    counts_out[agent] = 0
    crossings_out[agent] = 0.0
    block = agent // lanes
    lane = agent - block * lanes
    for axis in range(3):
        ghosts_out[block, axis, lane] = 0.0
    if crowd.bearings[own] == UNTOUCHABLE or not is_somewhere(table.places[own]):
        return
    velocity = crowd.velocities[own]
    spin = wp.length(crowd.spins[own])
    place = table.places[own]
    column = int(wp.floor(place[0] / table.cell_size))
    row = int(wp.floor(place[1] / table.cell_size))
    most = 2.0 * bumper.reach + TRAVEL
    found = wp.int32(0)
    due_x = wp.int64(0)
    due_y = wp.int64(0)
    due_z = wp.int64(0)
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            other = table.heads[cell_entry(column + dx, row + dy, table)]
            while other != NOBODY:
                if other != own:
                    # What is cheap to know first: most of those who are looked at are too far away.
                    beside = wp.length(table.places[other] - place)
                    if beside < most:
                        difference = unsettled(own, other, crowd)
                        # Whole numbers are added up: lists of the grid are in no order.
                        due_x = due_x + wp.int64(difference[0] * WHOLE)
                        due_y = due_y + wp.int64(difference[1] * WHOLE)
                        due_z = due_z + wp.int64(difference[2] * WHOLE)
                        closing = wp.length(crowd.velocities[other] - velocity)
                        closing = closing + bumper.reach * (spin + wp.length(crowd.spins[other]))
                        within = closing * frame + MARGIN
                        if beside < 2.0 * bumper.reach + within:
                            gap = gap_between(agent, lanes, other, crowd, bumper, state_in, origins_in)
                            if gap < within:
                                found = insert_neighbour(
                                    agent, other, gap, found, indices_out.shape[1], indices_out, gaps_out
                                )
                other = table.nexts[other]
    size = (ghosts_out.shape[1] - 3) // indices_out.shape[1]
    pairs = (size - _MOTION) // _PAIR
    due = wp.vec3(wp.float32(due_x) / WHOLE, wp.float32(due_y) / WHOLE, wp.float32(due_z) / WHOLE)
    if wp.dot(due, due) > 0.0:
        for axis in range(3):
            ghosts_out[block, axis, lane] = due[axis]
        if found == 0:
            # Nobody is near any more: one who is far away is met, so that what is due is settled.
            found = found + 1
            indices_out[agent, 0] = own
            gaps_out[agent, 0] = 0.0
    counts_out[agent] = found
    if found == 0:
        return
    crossings_out[agent] = wp.max(-gaps_out[agent, 0], 0.0)
    origin = origin_to_be(agent, lanes, state_in, origins_in)
    for k in range(found):
        other = indices_out[agent, k]
        other_turn = crowd.attitudes[other]
        spinning = crowd.spins[other]
        away = crowd.places[other] - origin
        center = wp.quat_rotate(other_turn, bumper.center)
        moving = crowd.velocities[other] + wp.cross(spinning, center)
        own_spin = wp.quat_rotate_inv(other_turn, spinning)
        at = 3 + k * size
        for axis in range(3):
            ghosts_out[block, at + axis, lane] = wp.float32(away[axis]) + center[axis]
            ghosts_out[block, at + 7 + axis, lane] = moving[axis]
            ghosts_out[block, at + 10 + axis, lane] = own_spin[axis]
        for part in range(4):
            ghosts_out[block, at + 3 + part, lane] = other_turn[part]
        bearing = crowd.bearings[other]
        ghosts_out[block, at + 13, lane] = wp.where(bearing == FALLING, -bumper.gravity, 0.0)
        ghosts_out[block, at + 14, lane] = wp.where(bearing == LYING, wp.min(moving[2], 0.0), FREE)
        if other == own:
            ghosts_out[block, at + 2, lane] = _FAR
        for axis in range(3):
            ghosts_out[block, at + 15 + axis, lane] = 0.0
        before = account_of(own, other, crowd)
        for pair in range(pairs):
            memory = at + _MOTION + _PAIR * pair
            ghosts_out[block, memory, lane] = _UNDECIDED
            ghosts_out[block, memory + 1, lane] = 0.0
            ghosts_out[block, memory + 2, lane] = 0.0
            if before >= 0:
                ghosts_out[block, memory + 2, lane] = pressed_in[agent, before * pairs + pair]
