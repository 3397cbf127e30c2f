"""The centreline of a road: a Catmull-Rom spline through given points, by arc length, and what is closest to a point.

**The curve.** Catmull-Rom with *centripetal* knots: between points i and i+1 the parameter grows by the square root of
the chord. Where points are evenly spaced that is the familiar

    p(t) = 0.5 [2 p1 + (-p0 + p2) t + (2 p0 - 5 p1 + 4 p2 - p3) t^2 + (-p0 + 3 p1 - 3 p2 + p3) t^3]

and where they are not (sparse along the straights, dense in the corners, as people set them) it has neither the loops
nor the overshoot of the uniform parameter (Yuksel, Schaefer & Keyser 2011). An open centreline starts and ends with
mirrored points, and goes on straight beyond its ends.

**Arc length.** The curve is sampled once at even steps of its arc length s in space, `STEP` at most. Everything else,
on the host in float64 and in kernels in float32, reads that table: position is the cubic through two samples and their
tangents, which is off the Catmull-Rom curve by less than a tenth of a millimetre and has |dp/ds| = 1 as closely; the
curvature, which jumps at the given points, is interpolated between samples.

What kernels ask of it is in `spline_kernels`.
"""

# pyright: reportGeneralTypeIssues=false
# A Warp struct is a type to Warp, not to Python's checkers.

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from echelon.errors import InputError
from echelon.terrain.spline_kernels import CentrelineData

if TYPE_CHECKING:
    from scipy.spatial import KDTree

STEP = 0.25  # [m], of arc length between samples, at most
FEWEST_SAMPLES = 256  # of a short centreline

_PIECE = 0.5  # [m], lengths are integrated over pieces of about this size, with five Gauss points each
_PIECES_AT_LEAST = 8  # between two given points
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(5)


class Centreline:
    """A smooth line through points, asked by arc length `s` in space [m].

    Of a closed one any `s` is taken modulo its length; an open one goes on straight beyond 0 and `length`.

    Attributes:
        points: What it goes through [m], float64, shape [n, 3].
        closed: Whether it comes back to its first point.
        length: [m].
        point_s: Where it goes through each of the points [m], shape [n].
        step: Arc length between samples [m].
        samples: Positions at even steps [m], shape [steps + 1, 3].
    """

    def __init__(self, points: np.ndarray, closed: bool):
        """Lay a line through points.

        Args:
            points: [m], shape [n, 3]; at least two, three of a closed one, without repeating the first at the end.
            closed: Whether it comes back to its first point.

        Raises:
            InputError: Too few points, points that are not finite, or two in a row above one another.
        """
        self.points = _checked(points, closed)
        self.closed = closed
        cubics = _hermite_cubics(self.points, closed)
        u, segment, s = _even_steps(cubics)
        self.length = float(s[-1])
        self.step = self.length / (len(s) - 1)
        self.point_s = _starts(cubics)[: len(self.points)]
        self.samples = _evaluate(cubics, segment, u, 0)
        first, second = _evaluate(cubics, segment, u, 1), _evaluate(cubics, segment, u, 2)
        self._tangents = first / np.linalg.norm(first, axis=1, keepdims=True)
        plan_speed = np.hypot(first[:, 0], first[:, 1])
        self._curvatures = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / plan_speed**3
        if closed:
            for samples in (self.samples, self._tangents, self._curvatures):
                samples[-1] = samples[0]

    # ---- by arc length ---------------------------------------------------------------------------------------------
    def position(self, s: np.ndarray | float) -> np.ndarray:
        """Where it is at arc length s [m], shape [..., 3]."""
        index, u, beyond = self._place(s)
        return self._cubic(index, u, 0) + beyond[..., None] * self._end_tangents(index, beyond)

    def tangent(self, s: np.ndarray | float) -> np.ndarray:
        """Unit vector along it in space, shape [..., 3]."""
        index, u, _ = self._place(s)
        along = self._cubic(index, u, 1)
        return along / np.linalg.norm(along, axis=-1, keepdims=True)

    def curvature(self, s: np.ndarray | float) -> np.ndarray:
        """Curvature of its plan, positive where it bends left [1/m], shape [...]."""
        index, u, beyond = self._place(s)
        return np.where(beyond == 0.0, (1.0 - u) * self._curvatures[index] + u * self._curvatures[index + 1], 0.0)

    def grade(self, s: np.ndarray | float) -> np.ndarray:
        """Rise over run, dz / d(length of the plan), shape [...]."""
        along = self.tangent(s)
        return along[..., 2] / np.hypot(along[..., 0], along[..., 1])

    def left(self, s: np.ndarray | float) -> np.ndarray:
        """Level unit vector to its left, shape [..., 2]."""
        along = self.tangent(s)
        return np.stack([-along[..., 1], along[..., 0]], axis=-1) / np.hypot(along[..., 0], along[..., 1])[..., None]

    def difference(self, s: np.ndarray | float, other: np.ndarray | float) -> np.ndarray:
        """From `other` to `s` along it, the short way round where it is closed [m]."""
        gap = np.asarray(s, dtype=np.float64) - other
        return gap - self.length * np.round(gap / self.length) if self.closed else gap

    # ---- closest point ---------------------------------------------------------------------------------------------
    def closest(self, xy: np.ndarray, near: np.ndarray | float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Arc length of the point that is closest in plan, and the offset from it.

        Args:
            xy: Places on the map [m], shape [..., 2].
            near: Arc length to walk from [m], shape [...]; without it, the closest of the whole line.

        Returns:
            (s, offset), both [m] and of shape [...]; the offset is positive to the left.
        """
        places = np.asarray(xy, dtype=np.float64)
        flat = places.reshape(-1, 2)
        if near is None:
            vertex = np.asarray(self._tree.query(flat)[1], dtype=np.int64)
        else:
            start, u, _ = self._place(np.broadcast_to(np.asarray(near, dtype=np.float64), places.shape[:-1]).ravel())
            vertex = self._walk(flat, start + (u > 0.5))
        s, offset = self._refine(flat, vertex)
        return s.reshape(places.shape[:-1]), offset.reshape(places.shape[:-1])

    @cached_property
    def _tree(self) -> KDTree:
        # Loading it takes as long as loading Warp, and a herd's person imports this file without a road.
        from scipy.spatial import KDTree

        return KDTree(self.samples[: self._vertex_count, :2])

    @property
    def _vertex_count(self) -> int:
        return len(self.samples) - 1 if self.closed else len(self.samples)

    def _walk(self, places: np.ndarray, start: np.ndarray) -> np.ndarray:
        """The sample that is nearer than both beside it, downhill from each start."""
        count = self._vertex_count

        def neighbour(vertex: np.ndarray, way: int) -> np.ndarray:
            return (vertex + way) % count if self.closed else np.clip(vertex + way, 0, count - 1)

        def distance(vertex: np.ndarray, of: np.ndarray) -> np.ndarray:
            return np.sum((self.samples[vertex, :2] - places[of]) ** 2, axis=1)

        vertex = neighbour(start, 0)
        for way in (1, -1):
            moving = np.arange(len(places))
            while len(moving):
                ahead = neighbour(vertex[moving], way)
                nearer = distance(ahead, moving) < distance(vertex[moving], moving)
                moving = moving[nearer]
                vertex[moving] = ahead[nearer]
        return vertex

    def _refine(self, places: np.ndarray, vertex: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From the nearest sample to the nearest point of the cubic before or after it."""
        steps = len(self.samples) - 1
        behind = np.sum((places - self.samples[vertex, :2]) * self._tangents[vertex, :2], axis=1) < 0.0
        index = vertex - behind
        index = index % steps if self.closed else np.clip(index, 0, steps - 1)
        chord = (self.samples[index + 1] - self.samples[index])[:, :2]
        u = np.clip(np.sum((places - self.samples[index, :2]) * chord, axis=1) / np.sum(chord**2, axis=1), 0.0, 1.0)
        for _ in range(5):
            gap = self._cubic(index, u, 0)[:, :2] - places
            first, second = (self._cubic(index, u, order)[:, :2] * self.step**order for order in (1, 2))
            square = np.sum(first**2, axis=1)
            # Newton, but no more than twice the step that a straight line would need: inside a bend the slope vanishes.
            slope = np.maximum(square + np.sum(gap * second, axis=1), 0.5 * square)
            u = np.clip(u - np.sum(gap * first, axis=1) / slope, 0.0, 1.0)
        gap = places - self._cubic(index, u, 0)[:, :2]
        along = self._cubic(index, u, 1)[:, :2]
        square = np.sum(along**2, axis=1)
        offset = (along[:, 0] * gap[:, 1] - along[:, 1] * gap[:, 0]) / np.sqrt(square)
        s = (index + u) * self.step
        if self.closed:
            return np.where(s >= self.length, s - self.length, s), offset
        at_end = ((index == 0) & (u == 0.0)) | ((index == steps - 1) & (u == 1.0))
        return s + np.where(at_end, np.sum(gap * along, axis=1) / square, 0.0), offset

    # ---- the table -------------------------------------------------------------------------------------------------
    def _place(self, s: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(step, part of it 0..1, how far beyond an open end [m])."""
        asked = np.asarray(s, dtype=np.float64)
        inside = np.mod(asked, self.length) if self.closed else np.clip(asked, 0.0, self.length)
        index = np.clip((inside / self.step).astype(np.int64), 0, len(self.samples) - 2)
        return index, inside / self.step - index, np.zeros_like(asked) if self.closed else asked - inside

    def _cubic(self, index: np.ndarray, u: np.ndarray, order: int) -> np.ndarray:
        """The cubic of a step, or a derivative with respect to s."""
        _, b, c, d = (part[..., None] for part in _hermite_basis(u, order))
        run = self.samples[index + 1] - self.samples[index]
        local = b * run + self.step * (c * self._tangents[index] + d * self._tangents[index + 1])
        return local / self.step**order + (self.samples[index] if order == 0 else 0.0)

    def _end_tangents(self, index: np.ndarray, beyond: np.ndarray) -> np.ndarray:
        return self._tangents[np.where(beyond > 0.0, index + 1, index)]

    def data(self, device: wp.DeviceLike = None) -> CentrelineData:
        """The centreline on a device, for the functions of `spline_kernels`."""
        data = CentrelineData()
        data.positions = wp.array(self.samples.astype(np.float32), dtype=wp.vec3, device=device)
        data.tangents = wp.array(self._tangents.astype(np.float32), dtype=wp.vec3, device=device)
        data.curvatures = wp.array(self._curvatures.astype(np.float32), dtype=wp.float32, device=device)
        data.count = len(self.samples) - 1
        data.step = self.step
        data.length = self.length
        data.closed = int(self.closed)
        return data


# ---- making the table ------------------------------------------------------------------------------------------------
def _checked(points: np.ndarray, closed: bool) -> np.ndarray:
    points = np.array(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"centreline: points of shape {points.shape} are not rows of x, y, z")
    fewest = 3 if closed else 2
    if len(points) < fewest:
        kind = "a closed" if closed else "an open"
        raise InputError(f"centreline: {len(points)} points are too few; {kind} one needs at least {fewest}")
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise InputError(f"centreline: point {row} is {points[row].tolist()}; its numbers must be finite")
    gaps = np.linalg.norm(np.diff(points[:, :2], axis=0, append=points[:1, :2]), axis=1)
    same = np.flatnonzero((gaps if closed else gaps[:-1]) < 1.0e-6)
    if len(same):
        row = int(same[0])
        where = f"({points[row, 0]:g}, {points[row, 1]:g})"
        raise InputError(
            f"centreline: points {row} and {(row + 1) % len(points)} are the same place {where}; leave one"
        )
    return points


def _hermite_cubics(points: np.ndarray, closed: bool) -> np.ndarray:
    """End positions and end derivatives (for a parameter 0..1) of every segment, shape [segments, 4, 3]."""
    if closed:
        all_points = np.vstack([points[-1:], points, points[:2]])
    else:
        all_points = np.vstack([2 * points[0] - points[1], points, 2 * points[-1] - points[-2]])
    knots = np.sqrt(np.linalg.norm(np.diff(all_points, axis=0), axis=1))[:, None]  # parameter from point to point
    before, here, after = all_points[:-2], all_points[1:-1], all_points[2:]
    slopes = (
        (here - before) / knots[:-1] - (after - before) / (knots[:-1] + knots[1:]) + (after - here) / knots[1:]
    )  # Barry & Goldman 1988, at every inner point
    spans = knots[1:-1]
    return np.stack([here[:-1], here[1:], spans * slopes[:-1], spans * slopes[1:]], axis=1)


def _hermite_basis(u: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Weights of start, end, start derivative and end derivative; or of their first or second derivative."""
    u = np.asarray(u)
    if order == 0:
        end = u * u * (3.0 - 2.0 * u)
        return 1.0 - end, end, u * (1.0 - u) ** 2, -u * u * (1.0 - u)
    if order == 1:
        end = 6.0 * u * (1.0 - u)
        return -end, end, (1.0 - u) * (1.0 - 3.0 * u), u * (3.0 * u - 2.0)
    end = 6.0 - 12.0 * u
    return -end, end, 6.0 * u - 4.0, 6.0 * u - 2.0


def _evaluate(cubics: np.ndarray, segment: np.ndarray, u: np.ndarray, order: int) -> np.ndarray:
    return sum(
        (weight[..., None] * cubics[segment, part] for part, weight in enumerate(_hermite_basis(u, order))),
        start=np.zeros(3),
    )


def _integrated(cubics: np.ndarray, segment: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Arc length of segments between two parameters [m]."""
    half = 0.5 * (end - start)
    total = np.zeros_like(half)
    for node, weight in zip(_GAUSS_NODES, _GAUSS_WEIGHTS, strict=True):
        speed = np.linalg.norm(_evaluate(cubics, segment, start + half * (1.0 + node), 1), axis=1)
        total += weight * speed
    return half * total


def _pieces(cubics: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Segments cut into short pieces: (segment, start parameter, end parameter)."""
    chords = np.linalg.norm(cubics[:, 1] - cubics[:, 0], axis=1)
    counts = np.maximum(_PIECES_AT_LEAST, np.ceil(chords / _PIECE).astype(np.int64))
    segment = np.repeat(np.arange(len(cubics)), counts)
    within = np.arange(len(segment)) - np.repeat(np.cumsum(counts) - counts, counts)
    return segment, within / counts[segment], (within + 1) / counts[segment]


def _starts(cubics: np.ndarray) -> np.ndarray:
    """Arc length at which every segment starts, and the whole length, shape [segments + 1]."""
    segment, start, end = _pieces(cubics)
    return np.concatenate([[0.0], np.cumsum(np.bincount(segment, weights=_integrated(cubics, segment, start, end)))])


def _even_steps(cubics: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(parameter, segment, arc length) of samples at even steps of arc length."""
    piece_segment, start, end = _pieces(cubics)
    ends = np.cumsum(_integrated(cubics, piece_segment, start, end))
    starts = np.concatenate([[0.0], ends[:-1]])
    length = float(ends[-1])
    s = np.linspace(0.0, length, max(FEWEST_SAMPLES, int(np.ceil(length / STEP))) + 1)
    piece = np.minimum(np.searchsorted(ends, s, side="left"), len(ends) - 1)
    segment, low, high = piece_segment[piece], start[piece], end[piece]
    u = low + (high - low) * (s - starts[piece]) / (ends - starts)[piece]
    for _ in range(3):
        speed = np.linalg.norm(_evaluate(cubics, segment, u, 1), axis=1)
        u = np.clip(u - (_integrated(cubics, segment, low, u) - (s - starts[piece])) / speed, low, high)
    return u, segment, s
