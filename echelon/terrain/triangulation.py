"""Surfaces as triangles: where to cut a NURBS surface so that what is drawn, or felt, is within a tolerance of it.

A surface is cut along lines of constant u and of constant v, and each cell of that net in two. The lines start at the
knots; where a cell is off the surface by more than the tolerance, the strip of cells it lies in is halved, in the
direction in which the surface bends more. So there are no cracks, and a road that runs straight for a kilometre and
then turns has its lines where it turns.

What a triangle says about the height between its corners is one of two things:

* *flat*: the plane through the corners, for drawing;
* *smooth*: a cubic from the heights and the gradients at the corners and the height in the middle. Along an edge it is
  the cubic of that edge's two ends, so neighbours agree, and its error falls with the fourth power of the size: a
  metre-wide triangle is within a fraction of a millimetre of a road. Wheels feel this one. See `smooth_height`.

Surfaces are height fields here: each point of the map has one height, and triangles are counter-clockwise from above.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from echelon.terrain.nurbs import NurbsSurface

MOST_ROUNDS = 12  # of halving
SAFETY = 0.6  # of the tolerance is used up where errors are looked at; the greatest lie between


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles with what is needed to shade and to stand on them.

    Attributes:
        name: What it is of.
        points: [m], float64,                           shape [points, 3]
        normals: Unit vectors, upwards,                 shape [points, 3]
        uv: Parameters on the surface,                  shape [points, 2]
        triangles: Indices of points, counter-clockwise from above, int32, shape [triangles, 3]
        bulges: What smooth heights need to pass through the surface in the middle [m], shape [triangles]; or none
    """

    name: str
    points: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    triangles: np.ndarray
    bulges: np.ndarray | None = None

    @property
    def gradients(self) -> np.ndarray:
        """(dz/dx, dz/dy) at the points, shape [points, 2]."""
        return -self.normals[:, :2] / self.normals[:, 2:]


def triangulate(
    surface: NurbsSurface,
    tolerance: float,
    *,
    smooth: bool = False,
    outline: float = np.inf,
    name: str = "surface",
    u: np.ndarray | None = None,
    v: np.ndarray | None = None,
) -> TriangleMesh:
    """Cut a surface into triangles.

    Args:
        surface: A height field with u x v upwards.
        tolerance: Greatest error of the height [m]; of a flat triangulation, of the distance in space.
        smooth: Whether heights between corners are the smooth ones rather than those of flat triangles.
        outline: Greatest distance on the map between an edge and the line of the surface that it stands for [m].
        name: Of the mesh.
        u, v: Lines to begin with; the surface's knots where left out.

    Raises:
        ValueError: The tolerance is not positive.
    """
    if not tolerance > 0.0:
        raise ValueError(f"tolerance is {tolerance}; it must be greater than 0")
    lines_u = _knot_lines(surface.knots_u, surface.degree_u) if u is None else np.asarray(u, dtype=np.float64)
    lines_v = _knot_lines(surface.knots_v, surface.degree_v) if v is None else np.asarray(v, dtype=np.float64)
    for _ in range(MOST_ROUNDS):
        along_u, along_v = cell_errors(surface, lines_u, lines_v, smooth=smooth, share=tolerance / outline)
        halve_u = np.flatnonzero(along_u.max(axis=1) > SAFETY * tolerance)
        halve_v = np.flatnonzero(along_v.max(axis=0) > SAFETY * tolerance)
        if len(halve_u) + len(halve_v) == 0:
            break
        lines_u, lines_v = _halved(lines_u, halve_u), _halved(lines_v, halve_v)
    return mesh_of_lines(surface, lines_u, lines_v, name, smooth=smooth)


def mesh_of_lines(
    surface: NurbsSurface, u: np.ndarray, v: np.ndarray, name: str = "surface", *, smooth: bool = False
) -> TriangleMesh:
    """The triangles between given lines of constant u and v; point i * len(v) + j lies at (u[i], v[j]).

    Those of a cell follow each other: first the one towards the greater u, then the one towards the greater v. Bulges
    are found where `smooth` asks for them.
    """
    points, normals = surface.grid_normals(u, v)
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1)
    corner = np.arange(len(u) * len(v), dtype=np.int32).reshape(len(u), len(v))
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    triangles = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
    mesh = TriangleMesh(name, points.reshape(-1, 3), normals.reshape(-1, 3), uv.reshape(-1, 2), triangles)
    if not smooth:
        return mesh
    return with_bulges(mesh, surface)


def with_bulges(mesh: TriangleMesh, surface: NurbsSurface) -> TriangleMesh:
    """The mesh with bulges such that smooth heights pass through the surface in the middle of each triangle.

    Args:
        mesh: Of the surface, without bulges.
        surface: A height field.
    """
    corners = mesh.points[mesh.triangles]
    u, v = mesh.uv[mesh.triangles].mean(axis=1).T
    middles = surface.point(u, v)
    weights = barycentric_weights(corners[..., :2], middles[:, :2])
    # In a bend the middle of the parameters may lie near an edge on the map, and say little about the middle.
    astray = np.flatnonzero(weights.min(axis=1) < 0.25)
    if len(astray):
        middle = corners[astray, :, :2].mean(axis=1)
        middles[astray] = surface.point(*surface.parameters_at(middle, u[astray], v[astray], rounds=3))
        weights[astray] = barycentric_weights(corners[astray, :, :2], middles[astray, :2])
    heights, _ = smooth_height(corners, mesh.gradients[mesh.triangles], weights)
    inside = weights.min(axis=1) > 0.1  # not so at the rim, where the middle may be off the surface
    bulges = (middles[:, 2] - heights) / np.where(inside, 6.0 * weights.prod(axis=-1), 1.0)
    return replace(mesh, bulges=np.where(inside, bulges, 0.0))


def cell_errors(
    surface: NurbsSurface, u: np.ndarray, v: np.ndarray, *, smooth: bool, share: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """How far the triangles between lines are off the surface, by direction.

    Looked at are the middles of the cells' edges, and the middles of the cells, whose error is laid to the direction
    with the greater one. `share` of the distance on the map between an edge and its line counts as an error, too.

    Returns:
        (along u, along v) [m], each of shape [len(u) - 1, len(v) - 1].
    """
    fine_u, fine_v = _halved(u, np.arange(len(u) - 1)), _halved(v, np.arange(len(v) - 1))
    if smooth:
        points, normals = surface.grid_normals(fine_u, fine_v)
        gradients = -normals[..., :2] / normals[..., 2:]
    else:
        points, gradients = surface.grid(fine_u, fine_v), None

    def error(start: tuple[slice, slice], middle: tuple[slice, slice], end: tuple[slice, slice]) -> np.ndarray:
        a, m, b = points[start], points[middle], points[end]
        if gradients is None:
            return np.linalg.norm(m - 0.5 * (a + b), axis=-1)
        height = np.abs(_edge_height(a, b, gradients[start], gradients[end], m) - m[..., 2])
        return np.maximum(height, share * np.linalg.norm((m - 0.5 * (a + b))[..., :2], axis=-1))

    even, odd = slice(None, None, 2), slice(1, None, 2)
    low, high = slice(None, -1, 2), slice(2, None, 2)
    edges_u = error((low, even), (odd, even), (high, even))
    edges_v = error((even, low), (even, odd), (even, high))
    along_u = np.maximum(edges_u[:, :-1], edges_u[:, 1:])
    along_v = np.maximum(edges_v[:-1], edges_v[1:])
    inside = error((low, low), (odd, odd), (high, high))
    return np.where(along_u >= along_v, np.maximum(along_u, inside), along_u), np.where(
        along_u < along_v, np.maximum(along_v, inside), along_v
    )


def _edge_height(a: np.ndarray, b: np.ndarray, slope_a: np.ndarray, slope_b: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Height of the cubic along an edge a b, carried over to a place beside its middle."""
    run = (b - a)[..., :2]
    middle = 0.5 * (a + b)[..., :2]
    height = 0.5 * (a + b)[..., 2] + 0.125 * np.sum((slope_a - slope_b) * run, axis=-1)
    return height + np.sum(0.5 * (slope_a + slope_b) * (at[..., :2] - middle), axis=-1)


def _knot_lines(knots: np.ndarray, degree: int) -> np.ndarray:
    return np.unique(knots[degree : len(knots) - degree])


def _halved(lines: np.ndarray, which: np.ndarray) -> np.ndarray:
    middles = 0.5 * (lines[:-1] + lines[1:])
    return np.sort(np.concatenate([lines, middles[which]]))


# ---- heights between corners -----------------------------------------------------------------------------------------
def barycentric_weights(corners: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Weights of the corners of triangles at places on the map, shape [n, 3].

    Args:
        corners: [m], shape [n, 3 corners, 2].
        places: [m], shape [n, 2].
    """
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    gap = places - corners[:, 0]
    determinant = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    second = (gap[:, 0] * ac[:, 1] - gap[:, 1] * ac[:, 0]) / determinant
    third = (ab[:, 0] * gap[:, 1] - ab[:, 1] * gap[:, 0]) / determinant
    return np.stack([1.0 - second - third, second, third], axis=1)


def smooth_height(
    corners: np.ndarray, gradients: np.ndarray, weights: np.ndarray, bulges: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Height and gradient within triangles, from heights and gradients at their corners.

    The height is a Bezier triangle of degree three: its edges are the cubics of their ends, its middle coefficient is
    the one that makes it exact for every quadratic height field, plus the bulge. The gradient is interpolated linearly
    between the corners, which makes the field of normals continuous across edges; it differs from the derivative of
    the height by the square of the triangle's size.

    Args:
        corners: [m], shape [n, 3 corners, 3].
        gradients: (dz/dx, dz/dy) there, shape [n, 3 corners, 2].
        weights: Barycentric, shape [n, 3].
        bulges: [m], shape [n]; none where left out.

    Returns:
        (height [m], gradient), shapes [n] and [n, 2].
    """
    flat, z = corners[..., :2], corners[..., 2]
    total = np.zeros(len(z))
    edges = np.zeros(len(z))
    for i in range(3):
        total += weights[:, i] ** 3 * z[:, i]
        for j in range(3):
            if i != j:
                rise = np.sum(gradients[:, i] * (flat[:, j] - flat[:, i]), axis=-1)
                coefficient = z[:, i] + rise / 3.0
                edges += coefficient
                total += 3.0 * weights[:, i] ** 2 * weights[:, j] * coefficient
    middle = 0.25 * edges - z.sum(axis=-1) / 6.0 + (0.0 if bulges is None else bulges)
    total += 6.0 * weights.prod(axis=-1) * middle
    return total, np.sum(weights[..., None] * gradients, axis=-2)
