"""Mass properties from shape: closed polyhedra of uniform density.

The integrals of 1, r and r r^T over a solid are sums over its faces. With the origin anywhere, a triangle (a, b, c),
counter-clockwise seen from outside, spans with it a tetrahedron of signed volume

    v = a . (b x c) / 6,

positive where the face looks away from the origin. Over a closed surface all that lies outside cancels, so the solid
may have hollows and holes through it, and with s = a + b + c

    V = sum v,   V center = sum v s / 4,   integral of r r^T = sum v (s s^T + a a^T + b b^T + c c^T) / 20

are exact: an integral of a quadratic over a tetrahedron is one of its corners' products. This is the method of *A
Symbolic Method for Calculating the Integral Properties of Arbitrary Nonconvex Polyhedra*, with the sum over the corners
written out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from echelon.errors import InputError


@dataclass(frozen=True)
class MassProperties:
    """What a rigid solid weighs and how it turns.

    Attributes:
        volume: [m^3].
        mass: [kg].
        center: Centre of mass [m], shape [3].
        inertia: Tensor about the centre of mass, along the given axes [kg m^2], shape [3, 3].
    """

    volume: float
    mass: float
    center: np.ndarray
    inertia: np.ndarray


@dataclass(frozen=True)
class Polyhedron:
    """A closed surface of triangles.

    Attributes:
        points: Corners [m], float64, shape [n, 3].
        triangles: Corners of each triangle, counter-clockwise seen from outside, shape [m, 3].
        name: What messages call it.

    Raises:
        InputError: A number that is not finite, a corner that does not exist, a surface with holes or one whose
            neighbouring triangles wind differently, or one that is inside out.
    """

    points: np.ndarray
    triangles: np.ndarray
    name: str = "polyhedron"

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", np.asarray(self.points, dtype=float).reshape(-1, 3))
        object.__setattr__(self, "triangles", np.asarray(self.triangles, dtype=np.int64).reshape(-1, 3))
        _check(self)

    def mass_properties(self, density: float) -> MassProperties:
        """Of the solid filled with one density.

        Args:
            density: [kg/m^3].

        Raises:
            InputError: The density is not positive.
        """
        if not 0.0 < density < np.inf:
            raise InputError(f"{self.name}: density is {density} kg/m^3, must be positive")
        volume, center, second = moments(self.points, self.triangles)
        mass = density * float(volume)
        inertia = density * (np.trace(second) * np.eye(3) - second)
        return MassProperties(float(volume), mass, center, inertia)


def moments(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Volume, centre, and second moments about it, of closed surfaces with the same triangles.

    Args:
        points: Corners [m], shape [..., n, 3].
        triangles: Shape [m, 3].

    Returns:
        Volume [m^3], shape [...]; centre [m], shape [..., 3]; integral of (r - centre)(r - centre)^T [m^5], shape
        [..., 3, 3]. A surface without volume has no centre: it comes back as not a number.
    """
    # About a point amid the corners, so that nothing large cancels.
    middle = points.mean(axis=-2, keepdims=True)
    corners = (points - middle)[..., triangles, :]
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    v = np.einsum("...i,...i->...", a, np.cross(b, c)) / 6.0
    s = a + b + c
    volume = v.sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        center = np.einsum("...m,...mi->...i", v, s) / (4.0 * volume[..., None])
    second = sum(np.swapaxes(v[..., None] * r, -1, -2) @ r for r in (s, a, b, c)) / 20.0
    second = second - volume[..., None, None] * center[..., :, None] * center[..., None, :]
    return volume, center + middle[..., 0, :], second


def convex_hull(points: np.ndarray, name: str = "polyhedron") -> Polyhedron:
    """The convex hull of points [m], shape [n, 3], with only its own corners.

    Raises:
        InputError: Fewer than four points, points in one plane, or numbers that are not finite.
    """
    # Loading it takes as long as loading Warp, and most programs that load this file need no hull.
    from scipy.spatial import ConvexHull, QhullError

    cloud = np.asarray(points, dtype=float).reshape(-1, 3)
    if not np.all(np.isfinite(cloud)):
        raise InputError(f"{name}: points hold a number that is not finite")
    try:
        hull = ConvexHull(cloud)
    except (QhullError, ValueError):
        raise InputError(f"{name}: {len(cloud)} points span no volume, so they have no hull") from None
    triangles = np.array(hull.simplices, dtype=np.int64)
    a, b, c = (cloud[triangles[:, k]] for k in range(3))
    # Qhull tells the outward normal, but not which way its triangles wind.
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    used, corners = np.unique(triangles, return_inverse=True)
    return Polyhedron(cloud[used], corners.reshape(-1, 3), name)


def _check(solid: Polyhedron) -> None:
    points, triangles, name = solid.points, solid.triangles, solid.name
    if not np.all(np.isfinite(points)):
        raise InputError(f"{name}: points hold a number that is not finite")
    if len(triangles) < 4:
        raise InputError(f"{name}: {len(triangles)} triangles enclose nothing, needs at least 4")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InputError(f"{name}: a triangle has corner {triangles.max()}, there are {len(points)} points")
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    count = len(points)
    forward, backward = (np.sort(edges[:, i] * count + edges[:, 1 - i]) for i in (0, 1))
    if not np.array_equal(forward, backward):
        lonely = int(np.count_nonzero(~np.isin(forward, backward)))
        raise InputError(f"{name}: is not closed, {lonely} edges of its triangles have no opposite neighbour")
    volume = moments(points, triangles)[0]
    if not volume > 0.0:
        raise InputError(f"{name}: volume is {volume:.6g} m^3, its triangles must wind counter-clockwise from outside")
