"""Joints as UsdPhysics knows them, and their coordinates.

A pin becomes a revolute joint, a slider a prismatic one, a ball a spherical one, each along or about the joint
frame's x axis. A universal joint or a gimbal becomes a D6 joint, a `UsdPhysics.Joint` whose degrees of freedom are
locked one by one by a limit whose low is above its high: its frame has x along the first axis, y along the second and
z across both, so that the angles about x, y and z are the joint's own, inboard to outboard. Where the third axis of a
gimbal points against z, its angle and its limits change sign.

Every rotation that is free carries a limit too, an endless one, because some importers take the degrees of freedom
of a D6 joint from the limits that they find.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from echelon.errors import InputError
from echelon.export.stage.motion import conjugate, product, rotated, rotation_vectors
from echelon.warp_kernels.model import Joint

Schema = Literal["revolute", "prismatic", "spherical", "d6"]
Freedom = Literal["angular", "linear", "rotX", "rotY", "rotZ"]

LINEAR_FREEDOMS = ("transX", "transY", "transZ")
ANGULAR_FREEDOMS: tuple[Freedom, ...] = ("rotX", "rotY", "rotZ")
RIGHT_ANGLE_TOLERANCE = 1e-6


@dataclass(frozen=True)
class PhysicsJoint:
    """How a joint is written.

    Attributes:
        schema: Which prim it becomes.
        frame: Quaternion (x, y, z, w) from the joint's frame to the link's, the same on both sides in the
            reference pose.
        freedoms: Degrees of freedom, inboard to outboard; none of a spherical joint.
        limits: (lower, upper) of each degree of freedom [rad or m], infinite where there is none.
        locked: Degrees of freedom of a D6 joint that are not free.
    """

    schema: Schema
    frame: np.ndarray
    freedoms: tuple[Freedom, ...]
    limits: tuple[tuple[float, float], ...]
    locked: tuple[str, ...]

    def coordinates(self, translations: np.ndarray, rotations: np.ndarray, joint: Joint) -> np.ndarray:
        """Coordinates of the degrees of freedom [rad or m], continuous along the frames, float64 [frames, freedoms].

        Args:
            translations: Of the link's origin in its parent's frame [m], shape [frames, 3].
            rotations: Of the link relative to its parent, quaternions [frames, 4].
            joint: The joint.
        """
        if self.schema == "prismatic":
            offset = translations - np.asarray(joint.position)
            return rotated(np.broadcast_to(conjugate(self.frame), rotations.shape), offset)[:, :1]
        turn = product(product(conjugate(self.frame), rotations), self.frame)
        if self.schema == "revolute":
            angles = rotation_vectors(turn)[:, :1]
        elif self.schema == "d6":
            angles = _angles_about_xyz(turn)[:, : len(self.freedoms)]
        else:
            angles = np.zeros((len(rotations), 0))
        return np.unwrap(angles, axis=0)

    def rates(self, coordinates: np.ndarray, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How coordinates that change move the link relative to its parent, in the parent's axes.

        Args:
            coordinates: Shape [n, freedoms] [rad or m].
            speeds: Their rates, same shape [rad/s or m/s].

        Returns:
            Angular velocities [rad/s] and velocities of the link's origin [m/s], each of shape [n, 3].
        """
        spin, slide = np.zeros((len(coordinates), 3)), np.zeros((len(coordinates), 3))
        if self.schema == "prismatic":
            slide[:, 0] = speeds[:, 0]
        elif self.schema == "revolute":
            spin[:, 0] = speeds[:, 0]
        elif self.schema == "d6":
            first, second = coordinates[:, 0], coordinates[:, 1]
            spin[:, 0] = speeds[:, 0]
            spin[:, 1] = speeds[:, 1] * np.cos(first)
            spin[:, 2] = speeds[:, 1] * np.sin(first)
            if len(self.freedoms) == 3:
                third = [np.sin(second), -np.sin(first) * np.cos(second), np.cos(first) * np.cos(second)]
                spin += speeds[:, 2:] * np.stack(third, axis=-1)
        frame = np.broadcast_to(self.frame, (len(coordinates), 4))
        return rotated(frame, spin), rotated(frame, slide)


def physics_joint(joint: Joint, where: str) -> PhysicsJoint:
    """How a joint that is not free is written.

    Args:
        joint: The joint.
        where: What messages call it.

    Raises:
        InputError: The axes of a universal joint are not at right angles; no D6 joint turns about such.
    """
    axes = [np.asarray(axis, dtype=float) for axis in joint.axes]
    limits = tuple(limit or (-np.inf, np.inf) for limit in (joint.limits or (None,) * len(axes)))
    identity = np.array([0.0, 0.0, 0.0, 1.0])
    if joint.kind == "pin":
        return PhysicsJoint("revolute", _frame(axes[0], None), ("angular",), limits, ())
    if joint.kind == "slider":
        return PhysicsJoint("prismatic", _frame(axes[0], None), ("linear",), limits, ())
    if joint.kind == "ball":
        return PhysicsJoint("spherical", identity, (), (), ())
    if abs(axes[0] @ axes[1]) > RIGHT_ANGLE_TOLERANCE:
        if joint.kind == "gimbal" and not any(joint.limits):
            return PhysicsJoint("spherical", identity, (), (), ())
        raise InputError(f"{where}: axes of a {joint.kind} joint must be at right angles to be written as physics")
    frame = _frame(axes[0], axes[1])
    if joint.kind == "universal":
        return PhysicsJoint("d6", frame, ANGULAR_FREEDOMS[:2], limits, (*LINEAR_FREEDOMS, "rotZ"))
    sign = float(np.cross(axes[0], axes[1]) @ axes[2])
    if abs(abs(sign) - 1.0) > RIGHT_ANGLE_TOLERANCE:
        if not any(joint.limits):
            return PhysicsJoint("spherical", identity, (), (), ())
        raise InputError(f"{where}: axes of a gimbal joint must be at right angles to be written as physics")
    if sign < 0.0:
        limits = (*limits[:2], (-limits[2][1], -limits[2][0]))
    return PhysicsJoint("d6", frame, ANGULAR_FREEDOMS, limits, LINEAR_FREEDOMS)


def _frame(x: np.ndarray, y: np.ndarray | None) -> np.ndarray:
    """Quaternion of the frame whose x axis is a unit vector and whose y axis is another, or any."""
    second = _across(x) if y is None else y
    return _quaternion(np.stack([x, second, np.cross(x, second)], axis=1))


def _across(x: np.ndarray) -> np.ndarray:
    """A unit vector at right angles to a unit vector."""
    across = np.eye(3)[np.argmin(np.abs(x))]
    across -= (across @ x) * x
    return across / np.linalg.norm(across)


def _quaternion(matrix: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(matrix).as_quat()


def _angles_about_xyz(q: np.ndarray) -> np.ndarray:
    """Angles [rad] about x, then the turned y, then the twice turned z, of quaternions [n, 4]; shape [n, 3]."""
    x, y, z, w = np.moveaxis(q, -1, 0)
    first = np.arctan2(2.0 * (x * w - y * z), 1.0 - 2.0 * (x * x + y * y))
    second = np.arcsin(np.clip(2.0 * (x * z + y * w), -1.0, 1.0))
    third = np.arctan2(2.0 * (z * w - x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.stack([first, second, third], axis=-1)


def principal_inertia(inertia: Sequence[Sequence[float]]) -> tuple[np.ndarray, np.ndarray]:
    """Principal moments [kg m^2], ascending, shape [3], and the quaternion from their axes to the link's frame."""
    moments, axes = np.linalg.eigh(np.asarray(inertia, dtype=float))
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return moments, _quaternion(axes)
