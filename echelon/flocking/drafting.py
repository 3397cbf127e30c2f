"""Drafting: the part of the air drag that a rider is spared by those ahead and beside.

Behind each rider is a wake. On its axis it spares `DEEPEST` of the drag right behind the rear wheel, and less with the
gap; it widens as it fades:

    w(gap, side) = DEEPEST exp(-gap / FADES) exp(-(side / width)^2 / 2),   width = NARROWEST + WIDENS gap

45 % at a gap of half a metre, a quarter at two metres, nothing to speak of at ten. Someone beside, who is not wholly
ahead, gives a part of it. Wakes of several lie in one another, so that each spares a part of what the others have left:

    shelter = 1 - product(1 - w),   at most DEEPEST_OF_MANY

Measured on cyclists (McCole et al. 1990): 27 % less energy behind one rider at 40 km/h, 39 % in the back of a group of
eight. With a fifth of the power going into rolling, that is 34 % and 49 % less drag. In the middle of a group of 16 at
the same speed these wakes spare 30 to 40 % of the power, as the papers quote.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

from echelon.flocking.road_riders import RIDING, RidersSeen, RoadRiders, RoadRules

wp.set_module_options({"enable_backward": False})

DEEPEST = wp.constant(0.53)
FADES = wp.constant(3.0)  # [m]
NARROWEST = wp.constant(0.45)  # [m]
WIDENS = wp.constant(0.08)
DEEPEST_OF_MANY = wp.constant(0.5)
REACH = wp.constant(15.0)  # [m]; wakes longer than this are not reckoned with


@wp.func
def wake(gap: float, side: float, body_length: float) -> float:
    """Part of the drag spared to who rides in a wake.

    Args:
        gap: From the rear wheel ahead to one's own front wheel, negative where they overlap [m].
        side: How far beside the wake's axis [m].
        body_length: [m].
    """
    if gap < -body_length or gap > REACH:
        return 0.0
    behind = wp.max(gap, 0.0)
    width = NARROWEST + WIDENS * behind
    overlapping = wp.clamp(1.0 + gap / body_length, 0.0, 1.0)
    side_part = side / width
    return DEEPEST * overlapping * overlapping * wp.exp(-behind / FADES - 0.5 * side_part * side_part)


@wp.kernel
def draft(
    first: int,
    # model
    rules: RoadRules,
    # state in
    seen: RidersSeen,
    # state in and out
    riders: RoadRiders,
):
    """Everybody's shelter, 0 where drafting is off."""
    rider = first + wp.tid()
    left = wp.float32(1.0)
    if rules.drafting == 1 and riders.presence[rider] == RIDING:
        for k in range(seen.found[rider]):
            other = seen.indices[rider, k]
            if riders.presence[other] == RIDING:
                side = riders.offset[other] - riders.offset[rider]
                left *= 1.0 - wake(seen.ahead[rider, k] - rules.body_length, side, rules.body_length)
    riders.shelter[rider] = wp.min(1.0 - left, DEEPEST_OF_MANY)
