"""Tactics: rotating off the front, breaking away, closing a gap; what the papers' authors announced as their next step.

Each rider is doing one of four things:

    RIDE     along with the group
    ROTATE   after a turn at the front: to the side, a little slower than the others, until all have passed
    ATTACK   faster, on one's own
    CHASE    faster, until a gap ahead is closed

    RIDE -> ROTATE   after `pull_seconds` at the front, with others right behind
    RIDE -> ATTACK   at random, near the front, rested
    RIDE -> CHASE    the next rider ahead is in sight, but farther than `chase_gap`, and one is rested
    ROTATE -> RIDE   nobody is right behind any more
    ATTACK -> RIDE   after `attack_seconds`
    CHASE -> RIDE    the gap is no more than `closed_gap`, or there is nobody ahead, or it has taken too long

Nobody dithers: a choice is kept for `dwell_seconds` at least, what ends it is not the converse of what began it, and
attacks and chases have to be rested from.

Random numbers come from a counter, a stream for each rider and second: they depend on nobody else.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import numpy as np
import warp as wp

from echelon.flocking.road_riders import RIDING, RidersSeen, RoadRiders, RoadRules
from echelon.scenario.road import TacticsSettings

wp.set_module_options({"enable_backward": False})

TACTICS = ("ride", "rotate", "attack", "chase")
RIDE = wp.constant(0)
ROTATE = wp.constant(1)
ATTACK = wp.constant(2)
CHASE = wp.constant(3)

FRONT_REACH = wp.constant(10.0)  # [m]; who has nobody so near ahead is at the front
FOLLOWED_REACH = wp.constant(8.0)  # [m]; who has somebody so near behind is followed
NEAR_FRONT = wp.constant(3)  # who has no more riders than this ahead within sight is near the front
LONGEST_DRIFT = wp.constant(60.0)  # [s]; of rotating off, at most
LONGEST_CHASE = wp.constant(60.0)  # [s]
NOBODY_NEAR = wp.constant(1.0e6)  # [m]


@wp.struct
class TacticsRules:
    """`TacticsSettings` as kernels see them; units as there."""

    pull_seconds: wp.float32
    drop_speed: wp.float32
    attacks: wp.float32
    attack_speed: wp.float32
    attack_seconds: wp.float32
    chase_gap: wp.float32
    closed_gap: wp.float32
    chase_speed: wp.float32
    dwell_seconds: wp.float32
    rest_seconds: wp.float32


@wp.struct
class TacticsState:
    """What each rider is doing, and what it is still mindful of; arrays of shape [riders].

    Attributes:
        choice: RIDE, ROTATE, ATTACK or CHASE.
        age: For how long [frames].
        pulled: For how long the rider has been at the front without a break [frames].
        rest: How long it takes until the rider attacks or chases again [frames].
    """

    choice: wp.array[wp.int32]
    age: wp.array[wp.int32]
    pulled: wp.array[wp.int32]
    rest: wp.array[wp.int32]


def tactics_rules(settings: TacticsSettings) -> TacticsRules:
    """Settings as kernels see them."""
    rules = TacticsRules()
    for name in TacticsSettings.__dataclass_fields__:
        setattr(rules, name, getattr(settings, name))
    return rules


def tactics_state(count: int, device: wp.DeviceLike = None) -> TacticsState:
    """Everybody rides along, and has just begun to."""
    state = TacticsState()
    for name in ("choice", "age", "pulled", "rest"):
        setattr(state, name, wp.array(np.zeros(count), dtype=wp.int32, device=device))
    return state


@wp.func
def draw(seed: int, stream: int, rider: int) -> float:
    """A random number of [0, 1) that is a rider's own."""
    random = wp.rand_init(int(wp.rand_init(seed, stream)), rider)
    return wp.randf(random)


@wp.kernel
def decide(
    first: int,
    # model
    rules: RoadRules,
    tactics: TacticsRules,
    seed: int,
    second: int,
    # state in
    frame_in: wp.array[wp.int32],
    seen: RidersSeen,
    # state in and out
    state: TacticsState,
    riders: RoadRiders,
):
    """Choose anew or go on, and let that change the wanted speed and offset; the user has no tactics."""
    rider = first + wp.tid()
    if riders.presence[rider] != RIDING or rider == rules.first_user:
        return
    gap_ahead = float(NOBODY_NEAR)
    gap_behind = float(NOBODY_NEAR)
    riders_ahead = wp.int32(0)
    pace = wp.float32(0.0)
    near = wp.float32(0.0)
    for k in range(seen.found[rider]):
        other = seen.indices[rider, k]
        if riders.presence[other] == RIDING:
            ahead = seen.ahead[rider, k]
            gap = wp.abs(ahead) - rules.body_length
            if ahead > 0.0:
                gap_ahead = wp.min(gap_ahead, gap)
                riders_ahead += 1
            else:
                gap_behind = wp.min(gap_behind, gap)
            if gap < FRONT_REACH:
                pace += riders.along[other]
                near += 1.0

    frame = frame_in[0]
    age = riders_age(rider, state)
    seconds = rules.step * float(age)
    if gap_ahead > FRONT_REACH:
        state.pulled[rider] = state.pulled[rider] + 1
    else:
        state.pulled[rider] = 0
    state.rest[rider] = wp.max(state.rest[rider] - 1, 0)
    choice = state.choice[rider]
    then = choice
    if seconds >= tactics.dwell_seconds:
        if choice == RIDE:
            pull = tactics.pull_seconds * (1.0 + 0.5 * draw(seed, -1, rider))
            rested = state.rest[rider] == 0
            if gap_behind < FOLLOWED_REACH and rules.step * float(state.pulled[rider]) > pull:
                then = wp.int32(ROTATE)
            elif rested and gap_ahead > tactics.chase_gap and gap_ahead < NOBODY_NEAR:
                then = wp.int32(CHASE)
            elif rested and riders_ahead <= NEAR_FRONT and gap_behind < FOLLOWED_REACH and frame % second == 0:
                chance = tactics.attacks / 3600.0  # in a second
                if draw(seed, frame // second, rider) < chance:
                    then = wp.int32(ATTACK)
        elif choice == ROTATE:
            if gap_behind > FOLLOWED_REACH or seconds > LONGEST_DRIFT:
                then = wp.int32(RIDE)
        elif choice == ATTACK:
            if seconds >= tactics.attack_seconds:
                then = wp.int32(RIDE)
        elif gap_ahead <= tactics.closed_gap or gap_ahead == NOBODY_NEAR or seconds > LONGEST_CHASE:
            then = wp.int32(RIDE)
    if then != choice:
        if choice > ROTATE:  # it was an attack or a chase
            state.rest[rider] = int(tactics.rest_seconds / rules.step)
        if choice == ROTATE:
            state.pulled[rider] = 0
        state.choice[rider] = then
        state.age[rider] = 0

    if then == ROTATE:
        if near > 0.0:
            riders.wanted_speed[rider] = wp.max(pace / near - tactics.drop_speed, rules.slowest)
        side = wp.where(riders.home[rider] < 0.0, -rules.edge, rules.edge)
        riders.wanted_offset[rider] = side
    elif then == ATTACK:
        riders.wanted_speed[rider] = riders.training[rider] + tactics.attack_speed
    elif then == CHASE:
        riders.wanted_speed[rider] = riders.wanted_speed[rider] + tactics.chase_speed


@wp.func
def riders_age(rider: int, state: TacticsState) -> int:
    """For how long a rider has been doing the same, this frame included [frames]."""
    state.age[rider] = state.age[rider] + 1
    return state.age[rider]
