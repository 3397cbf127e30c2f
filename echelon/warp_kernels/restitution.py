"""From a coefficient of restitution to the damping that gives it.

A spring k and damper c that never pull return the part e of the speed with which a mass mu ran into them:

* without damping e would be 1, but a spring that is looked at once a substep may return a little more or less than it
  took, depending on where within a step the touch began, so no more than `MOST_RETURNED` is aimed at;
* for zeta = c / (2 sqrt(k mu)) of a few e is nearly 0; more damping changes nothing.

In between e falls with zeta. There is a formula for the continuous spring (Schwager and Poschel, *Coefficient of
restitution and linear-dashpot model revisited*, 2007). Here the very steps that a substep takes are run instead, for
touches that begin anywhere within a step, and zeta is found by bisection.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

MOST_RETURNED = 0.97
"""Restitution that is aimed at where more is asked for: energy then never rises."""

MOST_DAMPING = 3.0
"""Largest damping ratio; about a hundredth of the speed is returned."""

_ONSETS = (np.arange(16) + 0.5) / 16.0


@lru_cache(maxsize=64)
def restitution_damping(restitution: float, phase: float) -> float:
    """The damping ratio zeta that gives a restitution.

    Args:
        restitution: Speed after over speed before, 0 to 1.
        phase: omega h, angular frequency of the contact times the substep [rad].
    """
    wanted = min(restitution, MOST_RETURNED)
    lower, upper = 0.0, MOST_DAMPING
    for _ in range(40):
        middle = 0.5 * (lower + upper)
        lower, upper = (middle, upper) if returned_speed(middle, phase) > wanted else (lower, middle)
    return 0.5 * (lower + upper)


def returned_speed(damping_ratio: float, phase: float) -> float:
    """Restitution of a damping ratio, on average over where within a substep the touch begins; phase as above."""
    # Units in which the mass and omega are one; a step is then as long as its phase.
    h, c = phase, 2.0 * damping_ratio
    depth, speed = h * _ONSETS, np.ones_like(_ONSETS)  # into the spring
    gone = np.zeros(len(_ONSETS), dtype=bool)
    for _ in range(1 + int(40.0 / h)):
        entered = c * np.clip(depth / np.maximum(h * np.abs(speed), 1e-9), 0.0, 1.0)
        push = np.where(depth > 0.0, np.maximum((depth + entered * speed) / (1.0 + h * entered), 0.0), 0.0)
        gone |= depth <= 0.0
        if gone.all():
            break
        speed = speed - h * np.where(gone, 0.0, push)
        depth = np.where(gone, depth, depth + h * speed)
    return float(np.mean(np.maximum(-speed, 0.0)))
