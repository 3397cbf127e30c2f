"""What a gymnast's scripts move: channels, named alike for left and right, and the joint coordinates behind them.

The thesis's bodies turn about axes that are parallel to the world's in the reference pose, standing with the arms out
to the sides. A channel is the same angle with the sign that one would expect, mirrored between left and right, and
zero when one stands with the arms hanging:

    hip              negative bends (the thigh goes forward), hip_spread outwards, hip_turn toes outwards
    knee             positive bends
    ankle            positive points the toes, ankle_roll lifts the outer edge; toe positive presses the toe down
    clavicle_raise, clavicle_forward    of the shoulder
    shoulder         raises the arm forward, shoulder_spread out to the side (pi/2: the reference pose), shoulder_turn
                     rolls it about itself; in this order from the outside: about the body's lateral axis, its sagittal
                     axis, the arm
    elbow            positive bends, forearm_turn, wrist (positive: the back of the hand goes up), wrist_turn
    spine_bend       positive forward, spine_lean to the right, spine_twist to the left: shared by four joints
    neck_bend, neck_lean, neck_twist

In scripts `hip` stands for both sides, `left_hip` and `right_hip` for one. Right is the reference's: a positive
rotation of the right side's x and z axes is a negative one of the left's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from echelon.warp_kernels.trace import sincos

SIDES = ("left", "right")


@dataclass(frozen=True)
class JointAxis:
    """One axis of a joint that a channel turns.

    Attributes:
        joint: Name of the joint without its side.
        axis: Which of its axes.
        sign: Of the coordinate against the channel on the left; on the right it is this times `mirror`.
        mirror: -1 where left and right turn against each other.
        group: Which gains it takes.
    """

    joint: str
    axis: int
    sign: float
    mirror: float
    group: str


LIMBS: Mapping[str, JointAxis] = {
    "hip": JointAxis("hip", 0, 1.0, 1.0, "hip"),
    "hip_spread": JointAxis("hip", 1, 1.0, -1.0, "hip_side"),
    "hip_turn": JointAxis("hip", 2, 1.0, -1.0, "hip_turn"),
    "knee": JointAxis("knee", 0, 1.0, 1.0, "knee"),
    "ankle": JointAxis("ankle", 1, 1.0, 1.0, "ankle"),
    "ankle_roll": JointAxis("ankle", 0, 1.0, -1.0, "ankle_side"),
    "toe": JointAxis("toe", 0, 1.0, 1.0, "toe"),
    "clavicle_raise": JointAxis("clavicle", 0, 1.0, -1.0, "clavicle"),
    "clavicle_forward": JointAxis("clavicle", 1, -1.0, -1.0, "clavicle"),
    "elbow": JointAxis("elbow", 1, -1.0, -1.0, "elbow"),
    "forearm_turn": JointAxis("elbow", 0, 1.0, 1.0, "elbow"),
    "wrist": JointAxis("wrist", 0, 1.0, -1.0, "wrist"),
    "wrist_turn": JointAxis("wrist", 1, 1.0, 1.0, "wrist"),
}
"""Channels of one side that are one axis of a joint each."""

SHOULDER = ("shoulder", "shoulder_spread", "shoulder_turn")
"""Channels of one side that are a ball joint together."""

SPINE: Mapping[str, int] = {"spine_lean": 0, "spine_bend": 1, "spine_twist": 2}
SPINE_JOINTS = ("spine_l3", "spine_l1", "spine_t7", "spine_t4")
NECK: Mapping[str, int] = {"neck_lean": 0, "neck_bend": 1, "neck_twist": 2}
NECK_JOINT = "neck"

GROUPS = (
    "hip", "hip_side", "hip_turn", "knee", "ankle", "ankle_side", "toe", "spine", "neck", "clavicle", "shoulder",
    "elbow", "wrist",
)  # fmt: skip
"""Joints that share gains."""

SIDED = (*LIMBS, *SHOULDER)
MIDDLE = (*SPINE, *NECK)
CHANNELS: tuple[str, ...] = (*(f"{side}_{name}" for side in SIDES for name in SIDED), *MIDDLE)
"""All channels, as scripts lay them out."""


def channels_named(name: str) -> tuple[str, ...]:
    """The channels that a name in a script stands for: both sides' unless it names one; none if there is no such.

    Args:
        name: For example "knee", "left_knee" or "spine_bend".
    """
    if name in CHANNELS:
        return (name,)
    return tuple(f"{side}_{name}" for side in SIDES) if name in SIDED else ()


def shoulder_orientation(side: str, raised: Any, spread: Any, turn: Any) -> list[Any]:
    """Orientation of an upper arm in its shoulder girdle (x, y, z, w) for its channels [rad]; any scalars."""
    outwards = 1.0 if side == "left" else -1.0
    # The reference pose has the arm out to the side, which is a spread of pi/2.
    sy, cy = sincos(-0.5 * raised)
    sx, cx = sincos(0.5 * outwards * (spread - 0.5 * math.pi))
    # The arm lies along y, about which both sides turn alike.
    st, ct = sincos(0.5 * turn)
    # Ry(raised) Rx(spread) Ry(turn).
    x, y, z, w = cy * sx, sy * cx, -(sy * sx), cy * cx
    return [x * ct - z * st, y * ct + w * st, z * ct + x * st, w * ct - y * st]
