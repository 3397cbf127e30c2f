"""NURBS surfaces: rational B-splines in two parameters, after Piegl & Tiller, *The NURBS Book* (1997).

    S(u, v) = sum_ij N_i,p(u) N_j,q(v) w_ij P_ij / sum_ij N_i,p(u) N_j,q(v) w_ij        (equation 4.11)

The basis functions come of the recurrence of Cox and de Boor (equation 2.5), for many parameters at a time. Knots need
not be clamped: the surface is there where the basis is whole, from the knot number `degree` to that many before the
last, and one that closes on itself has periodic knots and its first control points again at the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import make_interp_spline


def spans(knots: np.ndarray, degree: int, t: np.ndarray) -> np.ndarray:
    """For each parameter the knot interval k with knots[k] <= t < knots[k + 1], or the nearest that is not empty."""
    found = np.searchsorted(knots, t, side="right") - 1
    last = np.searchsorted(knots, knots[len(knots) - degree - 1], side="left") - 1
    return np.clip(found, np.searchsorted(knots, knots[degree], side="right") - 1, last)


def basis(knots: np.ndarray, degree: int, t: np.ndarray, order: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The basis functions that are not zero, or their first derivatives.

    Args:
        knots: Ascending, shape [control points + degree + 1].
        degree: p.
        t: Parameters, shape [n].
        order: 0, or 1 for the derivative.

    Returns:
        (first, values): values[:, k] belong to control point first + k; shapes [n] and [n, degree + 1].
    """
    span = spans(knots, degree, t)
    values = np.zeros((len(t), degree + 1))
    values[:, 0] = 1.0
    for d in range(1, degree + 1 - order):
        values[:, : d + 1] = _raised(knots, span, values[:, :d], t, d)
    if order == 1:
        lower = values[:, :degree].copy()  # the basis of one degree less, on the same span
        values[:] = 0.0
        for k in range(degree):
            left = span - degree + 1 + k
            slope = degree * lower[:, k] / (knots[left + degree] - knots[left])
            values[:, k] -= slope
            values[:, k + 1] += slope
    return span - degree, values


def _raised(knots: np.ndarray, span: np.ndarray, lower: np.ndarray, t: np.ndarray, degree: int) -> np.ndarray:
    """The basis of a degree from that of one less (Cox and de Boor)."""
    values = np.zeros((len(t), degree + 1))
    for k in range(degree):
        low, high = knots[span - degree + 1 + k], knots[span + 1 + k]
        part = lower[:, k] / (high - low)
        values[:, k] += (high - t) * part
        values[:, k + 1] += (t - low) * part
    return values


@dataclass(frozen=True)
class NurbsSurface:
    """A rational B-spline surface.

    Attributes:
        control: Control points [m], shape [rows, columns, 3]; rows go with u, columns with v.
        knots_u, knots_v: Ascending, shapes [rows + degree_u + 1] and [columns + degree_v + 1].
        degree_u, degree_v: Of the basis.
        weights: Shape [rows, columns]; all one where left out.
    """

    control: np.ndarray
    knots_u: np.ndarray
    knots_v: np.ndarray
    degree_u: int = 3
    degree_v: int = 3
    weights: np.ndarray | None = None

    def __post_init__(self) -> None:
        rows, columns = self.control.shape[:2]
        expected = (rows + self.degree_u + 1, columns + self.degree_v + 1)
        if (len(self.knots_u), len(self.knots_v)) != expected:
            given = (len(self.knots_u), len(self.knots_v))
            raise ValueError(f"{rows} x {columns} control points need {expected} knots, not {given}")
        if self.weights is not None and self.weights.shape != (rows, columns):
            raise ValueError(f"weights of shape {self.weights.shape} for {rows} x {columns} control points")

    @classmethod
    def through(cls, points: np.ndarray, u: np.ndarray, v: np.ndarray, *, closed_v: bool = False) -> NurbsSurface:
        """The bicubic surface through a grid of points.

        Args:
            points: [m], shape [rows, columns, 3]; where v is closed, without the first column again at the end.
            u: Parameter of each row, ascending, shape [rows].
            v: Parameter of each column, ascending, shape [columns]; where v is closed, with that of the end as well.
            closed_v: Whether the surface comes back to its first column.
        """
        across = make_interp_spline(u, points, k=3, axis=0, bc_type="natural")
        rows = np.moveaxis(across.c, 0, 1)  # [columns, rows, 3]
        if closed_v:
            rows = np.concatenate([rows, rows[:1]])
        along = make_interp_spline(v, rows, k=3, axis=0, bc_type="periodic" if closed_v else "natural")
        return cls(np.ascontiguousarray(np.moveaxis(along.c, 0, 1)), across.t, along.t)

    @property
    def range_u(self) -> tuple[float, float]:
        """The least and the greatest u."""
        return float(self.knots_u[self.degree_u]), float(self.knots_u[-self.degree_u - 1])

    @property
    def range_v(self) -> tuple[float, float]:
        """The least and the greatest v."""
        return float(self.knots_v[self.degree_v]), float(self.knots_v[-self.degree_v - 1])

    @cached_property
    def _homogeneous(self) -> np.ndarray:
        """(w x, w y, w z, w), or (x, y, z) where all weights are one."""
        if self.weights is None:
            return self.control
        return np.concatenate([self.control * self.weights[..., None], self.weights[..., None]], axis=-1)

    # ---- at points -------------------------------------------------------------------------------------------------
    def point(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Points of the surface [m], shape [..., 3], for parameters of shape [...]."""
        return self._projected(*self._sums(u, v, (0, 0)))

    def derivatives(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(S, dS/du, dS/dv), each of shape [..., 3]."""
        return self._quotients(*self._sums(u, v, (0, 0), (1, 0), (0, 1)))

    def normal(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Unit vectors dS/du x dS/dv, shape [..., 3]."""
        _, along_u, along_v = self.derivatives(u, v)
        return unit(np.cross(along_u, along_v))

    def parameters_at(
        self, xy: np.ndarray, u: np.ndarray, v: np.ndarray, *, rounds: int = 6
    ) -> tuple[np.ndarray, np.ndarray]:
        """Parameters at which the surface, seen from above, is at places on the map; Newton from a guess nearby.

        Args:
            xy: [m], shape [n, 2].
            u, v: Guesses, shape [n].
            rounds: Of Newton's iteration; each doubles the digits.

        Returns:
            (u, v), kept within the surface.
        """
        for _ in range(rounds):
            place, along_u, along_v = self.derivatives(u, v)
            gap = xy - place[:, :2]
            determinant = along_u[:, 0] * along_v[:, 1] - along_u[:, 1] * along_v[:, 0]
            u = np.clip(u + (gap[:, 0] * along_v[:, 1] - gap[:, 1] * along_v[:, 0]) / determinant, *self.range_u)
            v = np.clip(v + (along_u[:, 0] * gap[:, 1] - along_u[:, 1] * gap[:, 0]) / determinant, *self.range_v)
        return u, v

    def _sums(self, u: np.ndarray, v: np.ndarray, *orders: tuple[int, int]) -> list[np.ndarray]:
        """The homogeneous sum, or its first derivatives, for each order of derivatives by u and by v."""
        shape = np.broadcast_shapes(np.shape(u), np.shape(v))
        flat_u, flat_v = (np.broadcast_to(np.asarray(t, dtype=np.float64), shape).ravel() for t in (u, v))
        bases_u = {order: basis(self.knots_u, self.degree_u, flat_u, order) for order in {o for o, _ in orders}}
        bases_v = {order: basis(self.knots_v, self.degree_v, flat_v, order) for order in {o for _, o in orders}}
        columns = self.control.shape[1]
        source = self._homogeneous.reshape(self.control.shape[0] * columns, -1)
        first = bases_u[orders[0][0]][0] * columns + bases_v[orders[0][1]][0]
        totals = [np.zeros((len(flat_u), source.shape[1])) for _ in orders]
        for i in range(self.degree_u + 1):
            for j in range(self.degree_v + 1):
                points = source[first + (i * columns + j)]
                for (order_u, order_v), total in zip(orders, totals, strict=True):
                    total += (bases_u[order_u][1][:, i] * bases_v[order_v][1][:, j])[:, None] * points
        return [total.reshape(*shape, source.shape[1]) for total in totals]

    # ---- on grids --------------------------------------------------------------------------------------------------
    def grid(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Points at every pair of parameters [m], shape [len(u), len(v), 3]."""
        return self._projected(self._grid_sum(u, v, 0, 0))

    def grid_normals(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(points [m], unit normals) at every pair of parameters, each of shape [len(u), len(v), 3]."""
        sums = (self._grid_sum(u, v, *orders) for orders in ((0, 0), (1, 0), (0, 1)))
        points, along_u, along_v = self._quotients(*sums)
        return points, unit(np.cross(along_u, along_v))

    def _grid_sum(self, u: np.ndarray, v: np.ndarray, order_u: int, order_v: int) -> np.ndarray:
        source = self._homogeneous
        first_u, basis_u = basis(self.knots_u, self.degree_u, np.asarray(u, dtype=np.float64), order_u)
        first_v, basis_v = basis(self.knots_v, self.degree_v, np.asarray(v, dtype=np.float64), order_v)
        rows = sum(
            (basis_u[:, i, None, None] * source[first_u + i] for i in range(self.degree_u + 1)), start=np.zeros(1)
        )
        return sum((basis_v[:, j, None] * rows[:, first_v + j] for j in range(self.degree_v + 1)), start=np.zeros(1))

    # ---- from homogeneous coordinates ------------------------------------------------------------------------------
    def _projected(self, total: np.ndarray) -> np.ndarray:
        return total if self.weights is None else total[..., :3] / total[..., 3:]

    def _quotients(
        self, total: np.ndarray, total_u: np.ndarray, total_v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Equation 4.20: (A' - w' S) / w."""
        if self.weights is None:
            return total, total_u, total_v
        point, w = total[..., :3] / total[..., 3:], total[..., 3:]
        return (
            point,
            (total_u[..., :3] - total_u[..., 3:] * point) / w,
            (total_v[..., :3] - total_v[..., 3:] * point) / w,
        )


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of the same direction and length one, shape [..., 3]."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
