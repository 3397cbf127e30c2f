"""Positions of a gymnast with names: what scripts call a tuck, a pike or a layout.

The thesis's chapter 5 has three, of "predetermined angles" that it does not print; ``poses.toml`` has angles that give
the moments of inertia that it does print, and a few more that maneuvers share.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources

import numpy as np

from echelon.agents.gymnasts.channels import channels_named
from echelon.warp_kernels.reference import Body


@cache
def poses() -> Mapping[str, Mapping[str, float]]:
    """All positions by name, each with its channels of both sides [rad]."""
    text = (resources.files("echelon.agents.gymnasts") / "poses.toml").read_text("utf-8")
    return {
        name: {channel: float(angle) for word, angle in given.items() for channel in channels_named(word)}
        for name, given in tomllib.loads(text).items()
    }


def inertia_tensor(body: Body, q: np.ndarray) -> np.ndarray:
    """Moments of inertia of a body held still in a position, about its centre of mass.

    Args:
        body: Whose root is free.
        q: Generalised positions, shape [q_count].

    Returns:
        [kg m^2], world axes, shape [3, 3]; entry (1, 1) is about the somersault axis of an upright body.
    """
    still = np.array(q, dtype=float)
    x, y, z, w = still[3:7] / math.sqrt(float(still[3:7] @ still[3:7]))
    # Turning about each axis of the world at 1 rad/s in turn: the root's speeds are along its own axes.
    to_root = np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)],
            [2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * w)],
            [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
    turning = np.zeros((3, body.u_count))
    turning[:, 3:6] = to_root.T
    return body.momentum(np.tile(still, (3, 1)), turning)[:, 3:6].T
