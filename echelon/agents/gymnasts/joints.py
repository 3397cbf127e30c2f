"""The gymnast's joints: what each axis does, how far it goes, how strong it is.

A gymnast's links and joints are those of *Simulation of Leaping, Tumbling, Landing, and Balancing Humans*, under plain
names (`LINKS`, `JOINTS`). Every axis points the same way on both sides (x forward, y left, z up in the reference pose,
which is a T: arms out to the sides, palms down), so what is a flexion on the left may be an extension on the right:

* about **y** both sides agree, and nothing is mirrored. A positive angle extends the hip, flexes the knee, points the
  foot (plantarflexion), curls the toes, bends the spine forward.
* about **x** and **z** the right side mirrors the left: the same movement has the opposite sign. On the left, a
  positive angle abducts the hip (x) and turns the leg outwards (z), raises the shoulder and the arm (x), extends the
  wrist (x), and swings arm and shoulder backwards or straightens the elbow (z).

`MOTIONS` lists every axis with both of its movements, for the left side or the middle; `AXIS_SIGN` turns a value for
the left into the right's. An arm hangs at an angle of -pi/2 about the left shoulder's x; from there the axis z, which
turns with the arm, swings it: forwards and up with a negative angle on the left, to -pi overhead.

Limits and strengths are data: no body obeys them unless it is asked to (`gymnast_body(..., limits=True)`), and torques
are clipped by whoever makes them.

**Limits** are ranges of movement of supple adults, as physiotherapy measures them, counted from the reference pose
(there the shank leans back by 4 degrees and the elbow is bent by 15). The spine's is spread over its four joints.

**Strengths** are greatest isometric torques of one side's joint, for a trained man of `REFERENCE_WEIGHT` and
`REFERENCE_HEIGHT`. Hip, knee and ankle are of the size that *Maximum voluntary joint torque as a function of joint
angle and angular velocity: model development and application to the lower limb* finds for young men; shoulder flexion
is that of *Dynamic shoulder flexion strength for use in occupational risk analysis and clinical assessment* (90 N m
for men, half of it for women); elbow, wrist, trunk and neck are of the usual size in dynamometry (elbow flexion 75,
trunk extension 300, trunk flexion 170 N m). Clavicles, and the passive parts of toes and wrists, are not measured so:
they are set to carry what the neighbouring joints bring. All is multiplied by `TRAINING`, what gymnasts have over
students. Torque falls with speed and off the best angle; that is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from echelon.errors import InputError
from echelon.warp_kernels.model import AXIS_COUNT, Joint, Model

Axis = Literal["x", "y", "z"]
Sex = Literal["male", "female"]
SIDES: tuple[str, ...] = ("left", "right")

LINKS: Mapping[str, str] = {
    "PELVIS": "pelvis",
    "CHEST3": "abdomen",
    "CHEST2": "lower_chest",
    "CHEST1": "upper_chest",
    "STERNUM": "sternum",
    "HEAD": "head",
    **{
        f"{thesis}{side[0].upper()}": f"{side}_{name}"
        for side in SIDES
        for thesis, name in (
            ("ULEG", "upper_leg"),
            ("LLEG", "lower_leg"),
            ("FOOT", "foot"),
            ("TOE", "toes"),
            ("CHEST", "shoulder_girdle"),
            ("UARM", "upper_arm"),
            ("LARM", "lower_arm"),
            ("HAND", "hand"),
        )
    },
}
"""The thesis's name of each link, and ours."""

JOINTS: Mapping[str, str] = {
    "ROOT": "root",
    "SPINEL3": "spine_l3",
    "SPINEL1": "spine_l1",
    "SPINET7": "spine_t7",
    "SPINET4": "spine_t4",
    "NECKC2": "neck",
    **{
        f"{thesis}{side[0].upper()}": f"{side}_{name}"
        for side in SIDES
        for thesis, name in (
            ("HIP", "hip"),
            ("KNEE", "knee"),
            ("ANKLE", "ankle"),
            ("MT", "toe"),
            ("CLAV", "clavicle"),
            ("SHLD", "shoulder"),
            ("ELB", "elbow"),
            ("WRST", "wrist"),
        )
    },
}
"""The thesis's name of each joint, and ours. The spine's name the vertebra above which it bends."""

SPINE: tuple[str, ...] = ("spine_l3", "spine_l1", "spine_t7", "spine_t4")
"""The spine's joints, from the pelvis up."""

AXIS_SIGN: Mapping[str, float] = {"x": -1.0, "y": 1.0, "z": -1.0}
"""The right side's angle or torque for the same movement, over the left's."""

REFERENCE_WEIGHT = 78.0 * 9.80665  # of whom the strengths are [N]
REFERENCE_HEIGHT = 1.78  # [m]
TRAINING = 1.3
FEMALE_LEGS, FEMALE_ELSEWHERE = 0.9, 0.7  # a woman's strength for her weight and height, over a man's
LEGS = frozenset({"hip", "knee", "ankle", "toe"})


@dataclass(frozen=True)
class Motion:
    """One axis of a joint, on the left side or in the middle.

    Attributes:
        joint: Name without its side.
        axis: About which it turns in the reference pose.
        negative, positive: The movement with a falling, and with a rising angle.
        limits: Least and greatest angle [rad].
        strength: Greatest torque towards smaller, and towards greater angles, both positive [N m].
    """

    joint: str
    axis: Axis
    negative: str
    positive: str
    limits: tuple[float, float]
    strength: tuple[float, float]


def _motion(
    joint: str, axis: Axis, low: tuple[str, float, float], high: tuple[str, float, float]
) -> tuple[tuple[str, str], Motion]:
    return (joint, axis), Motion(joint, axis, low[0], high[0], (low[1], high[1]), (low[2], high[2]))


# fmt: off
MOTIONS: Mapping[tuple[str, str], Motion] = dict(
    [
        # joint, axis, then for either direction the movement, how far [rad] and how strong [N m]
        _motion("hip", "y", ("flexion", -2.3, 150.0), ("extension", 0.6, 220.0)),
        _motion("hip", "x", ("adduction", -0.5, 160.0), ("abduction", 0.9, 120.0)),
        _motion("hip", "z", ("inward rotation", -0.7, 70.0), ("outward rotation", 0.8, 60.0)),
        _motion("knee", "y", ("extension", -0.1, 225.0), ("flexion", 2.6, 115.0)),
        _motion("ankle", "x", ("inversion", -0.6, 40.0), ("eversion", 0.5, 40.0)),
        _motion("ankle", "y", ("dorsiflexion", -0.8, 45.0), ("plantarflexion", 1.5, 150.0)),
        _motion("toe", "y", ("extension", -1.2, 15.0), ("flexion", 0.7, 30.0)),
        *(
            motion
            for joint in SPINE
            for motion in (
                _motion(joint, "x", ("bend to the left", -0.35, 170.0), ("bend to the right", 0.35, 170.0)),
                _motion(joint, "y", ("extension", -0.4, 300.0), ("flexion", 0.5, 170.0)),
                _motion(joint, "z", ("turn to the right", -0.35, 90.0), ("turn to the left", 0.35, 90.0)),
            )
        ),
        _motion("neck", "x", ("bend to the left", -0.7, 35.0), ("bend to the right", 0.7, 35.0)),
        _motion("neck", "y", ("extension", -1.1, 50.0), ("flexion", 0.9, 35.0)),
        _motion("neck", "z", ("turn to the right", -1.2, 15.0), ("turn to the left", 1.2, 15.0)),
        _motion("clavicle", "x", ("depression", -0.25, 110.0), ("elevation", 0.6, 120.0)),
        _motion("clavicle", "z", ("protraction", -0.5, 110.0), ("retraction", 0.5, 100.0)),
        _motion("shoulder", "x", ("adduction", -1.9, 100.0), ("abduction", 1.6, 75.0)),
        _motion("shoulder", "y", ("outward rotation", -1.4, 45.0), ("inward rotation", 1.4, 60.0)),
        _motion("shoulder", "z", ("flexion", -3.3, 90.0), ("extension", 1.1, 95.0)),
        _motion("elbow", "y", ("outward rotation", -1.2, 45.0), ("inward rotation", 1.2, 60.0)),
        _motion("elbow", "z", ("flexion", -2.4, 75.0), ("extension", 0.3, 60.0)),
        _motion("wrist", "x", ("flexion", -1.4, 18.0), ("extension", 1.5, 18.0)),
        _motion("wrist", "y", ("supination", -1.4, 14.0), ("pronation", 1.4, 12.0)),
    ]
)
# fmt: on
"""Every axis of every joint but the root, by joint (without its side) and axis."""

LIMIT_STIFFNESS, LIMIT_DAMPING = 400.0, 12.0
"""Of the soft stops of a body with limits, for `REFERENCE_WEIGHT` [N m/rad], [N m s/rad]."""


def axes_of(joint: Joint) -> tuple[Axis, ...]:
    """The axes of a gymnast's joint in the order of its speeds; a free joint's are none of the table's, so empty."""
    if joint.kind == "free":
        return ()
    if joint.kind == "ball":
        return ("x", "y", "z")
    names: tuple[Axis, ...] = ("x", "y", "z")
    return tuple(names[int(np.argmax(np.abs(axis)))] for axis in joint.axes)


def split_side(name: str) -> tuple[str, str]:
    """A name's side (``left``, ``right`` or empty for the middle) and the rest: ``left_hip`` is left, hip."""
    side, _, rest = name.partition("_")
    return (side, rest) if side in SIDES else ("", name)


def speed_index(model: Model, joint: str, axis: Axis) -> int:
    """Where a joint's axis stands among the generalised speeds ``u``.

    Args:
        model: A gymnast's body.
        joint: Name with its side, as ``left_hip`` or ``spine_l3``.
        axis: ``x``, ``y`` or ``z``; of a ball joint, a component of its angular velocity.

    Raises:
        InputError: No such joint, or it does not turn about that axis.
    """
    index, place = _place(model, joint, axis)
    return model.u_start(index) + place


def position_index(model: Model, joint: str, axis: Axis) -> int:
    """Where a joint's angle stands among the generalised positions ``q``; see `speed_index`.

    Raises:
        InputError: No such joint or axis, or a ball joint, whose quaternion (x, y, z, w) has no angle to its axis.
    """
    index, place = _place(model, joint, axis)
    if model.links[index].joint.kind == "ball":
        raise InputError(f"body {model.name!r}: joint {joint!r} is a ball, its position is a quaternion, not an angle")
    return model.q_start(index) + place


def joint_limits(model: Model) -> np.ndarray:
    """Least and greatest angle of each speed's axis [rad], shape [u_count, 2].

    The root's six are -inf and inf. A ball joint has no angles: its rows say how far each axis goes alone.
    """
    result = np.tile([-np.inf, np.inf], (model.u_count, 1))
    for row, side, motion in _rows(model):
        low, high = motion.limits
        result[row] = mirrored(motion.axis, side, low, high)
    return result


def joint_strength(model: Model, sex: Sex, height: float, mass: float) -> np.ndarray:
    """Greatest torque of each speed's axis towards smaller, and towards greater angles [N m], shape [u_count, 2].

    The first column is not positive, the second not negative, so that a torque is clipped between them. They grow with
    body weight times height. The root's rows are 0: nothing drives it.

    Args:
        model: A gymnast's body.
        sex: A woman is weaker for her size than a man (`FEMALE_LEGS`, `FEMALE_ELSEWHERE`).
        height, mass: Of the gymnast, without a backpack [m], [kg].
    """
    size = TRAINING * mass * 9.80665 * height / (REFERENCE_WEIGHT * REFERENCE_HEIGHT)
    result = np.zeros((model.u_count, 2))
    for row, side, motion in _rows(model):
        factor = size
        if sex == "female":
            factor *= FEMALE_LEGS if motion.joint in LEGS else FEMALE_ELSEWHERE
        low, high = motion.strength
        result[row] = mirrored(motion.axis, side, -factor * low, factor * high)
    return result


def mirrored(axis: Axis, side: str, low: float, high: float) -> tuple[float, float]:
    """A range given for the left, for a side: about x and z the right's is turned round."""
    return (-high, -low) if side == "right" and AXIS_SIGN[axis] < 0.0 else (low, high)


def _place(model: Model, joint: str, axis: str) -> tuple[int, int]:
    """Index of the link that a joint carries, and which of the joint's axes is meant."""
    for index, link in enumerate(model.links):
        if link.joint.name == joint:
            axes = axes_of(link.joint)
            if axis not in axes:
                allowed = ", ".join(axes) or "none"
                raise InputError(f"body {model.name!r}: joint {joint!r} does not turn about {axis!r}; axes: {allowed}")
            return index, axes.index(axis)
    names = ", ".join(link.joint.name for link in model.links)
    raise InputError(f"body {model.name!r}: no joint {joint!r}; joints are {names}")


def _rows(model: Model) -> list[tuple[int, str, Motion]]:
    """Speed, side and motion of every axis but the root's."""
    found: list[tuple[int, str, Motion]] = []
    for index, link in enumerate(model.links):
        side, joint = split_side(link.joint.name)
        for place, axis in enumerate(axes_of(link.joint)):
            found.append((model.u_start(index) + place, side, MOTIONS[joint, axis]))
    return found


def stops(joint: Joint) -> tuple[tuple[float, float] | None, ...]:
    """Limits of a joint's axes for `Joint.limits`; empty for the root and for balls, which have no angles."""
    if AXIS_COUNT[joint.kind] == 0:
        return ()
    side, name = split_side(joint.name)
    return tuple(mirrored(axis, side, *MOTIONS[name, axis].limits) for axis in axes_of(joint))
