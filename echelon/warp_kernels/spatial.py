"""Vectors and 3x3 matrices of scalars, as plain lists.

Entries are traced scalars, NumPy arrays or floats (see `trace`); a float 0.0 or 1.0 is a structural zero or one and
costs nothing once traced. A spatial vector is a pair (angular, linear) of 3-vectors, after Featherstone, *Rigid Body
Dynamics Algorithms* (2008), chapter 2.
"""

from __future__ import annotations

from typing import Any

from echelon.warp_kernels.trace import sqrt

Vector = list[Any]
Matrix = list[list[Any]]

ZERO: Vector = [0.0, 0.0, 0.0]


def is_zero(value: Any) -> bool:
    """Whether a scalar is the structural zero."""
    return isinstance(value, float | int) and value == 0


def add(a: Vector, b: Vector) -> Vector:
    return [x + y for x, y in zip(a, b, strict=True)]


def subtract(a: Vector, b: Vector) -> Vector:
    return [x - y for x, y in zip(a, b, strict=True)]


def scale(s: Any, a: Vector) -> Vector:
    return [s * x for x in a]


def negate(a: Vector) -> Vector:
    return [-x for x in a]


def dot(a: Vector, b: Vector) -> Any:
    total: Any = 0.0
    for x, y in zip(a, b, strict=True):
        if not (is_zero(x) or is_zero(y)):
            total = total + x * y
    return total


def cross(a: Vector, b: Vector) -> Vector:
    return [
        _difference(a[1], b[2], a[2], b[1]),
        _difference(a[2], b[0], a[0], b[2]),
        _difference(a[0], b[1], a[1], b[0]),
    ]


def dot_onto(start: Any, a: Vector, b: Vector) -> Any:
    """start + a . b, one multiply-add a term."""
    for x, y in zip(a, b, strict=True):
        if not (is_zero(x) or is_zero(y)):
            start = start + x * y
    return start


def cross_onto(start: Vector, a: Vector, b: Vector) -> Vector:
    """start + a x b, one multiply-add a term."""
    result: Vector = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        total = start[i]
        if not (is_zero(a[j]) or is_zero(b[k])):
            total = total + a[j] * b[k]
        if not (is_zero(a[k]) or is_zero(b[j])):
            total = total - a[k] * b[j]
        result.append(total)
    return result


def apply_onto(start: Vector, m: Matrix, a: Vector) -> Vector:
    """start + m a."""
    return [dot_onto(x, row, a) for x, row in zip(start, m, strict=True)]


def apply_transposed_onto(start: Vector, m: Matrix, a: Vector) -> Vector:
    """start + m^T a."""
    return [dot_onto(start[j], [m[0][j], m[1][j], m[2][j]], a) for j in range(3)]


def _difference(a: Any, b: Any, c: Any, d: Any) -> Any:
    """a b - c d without structural zeros."""
    first = 0.0 if is_zero(a) or is_zero(b) else a * b
    second = 0.0 if is_zero(c) or is_zero(d) else c * d
    return first - second


def norm(a: Vector) -> Any:
    """Length; zero for the zero vector (no division, so no guard is needed)."""
    return sqrt(dot(a, a))


def apply(m: Matrix, a: Vector) -> Vector:
    """m a."""
    return [dot(row, a) for row in m]


def apply_transposed(m: Matrix, a: Vector) -> Vector:
    """m^T a."""
    return [dot([m[0][j], m[1][j], m[2][j]], a) for j in range(3)]


def multiply(a: Matrix, b: Matrix) -> Matrix:
    """a b."""
    columns = transpose(b)
    return [[dot(row, column) for column in columns] for row in a]


def transpose(m: Matrix) -> Matrix:
    return [[m[j][i] for j in range(3)] for i in range(3)]


def identity() -> Matrix:
    return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def skew(a: Vector) -> Matrix:
    """The matrix of the cross product: skew(a) b = a x b."""
    return [[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]]


# ---- quaternions (x, y, z, w) ------------------------------------------------------------------------------------
def quaternion_matrix(q: Vector) -> Matrix:
    """Rotation matrix of a unit quaternion: takes vectors of the turned frame to the outer one."""
    x, y, z, w = q
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    return [
        [1.0 - (yy + zz), xy - wz, xz + wy],
        [xy + wz, 1.0 - (xx + zz), yz - wx],
        [xz - wy, yz + wx, 1.0 - (xx + yy)],
    ]


def quaternion_product(a: Vector, b: Vector) -> Vector:
    """a b: first b, then a, in the outer frame."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]


def quaternion_rate(q: Vector, omega: Vector) -> Vector:
    """Rate of a quaternion for an angular velocity in the turned (inner) frame [1/s]."""
    half = [0.5 * w for w in omega]
    return quaternion_product(q, [*half, 0.0])


def quaternion_normalized(q: Vector) -> Vector:
    """Scaled to unit length."""
    factor = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return [factor * c for c in q]
