"""Lofts: closed polyhedra stretched over rings along a line, and how they bend to a wanted mass.

A loft is a row of rings about a straight line. Ring k lies at a part t_k of the line's length; it is a superellipse
with semi-axes a_k and b_k and a centre beside the line. The first and the last are points, so that the surface is
closed. One loft is one segment of a body, whose mass properties are integrals over its triangles (`polyhedron`).

`fitted` changes a loft as little as it must for volume, centre and moments to come out as wanted. What may change is
theta: the logarithms of the semi-axes, the centres, and where the line begins and ends. Little is measured by a
Gaussian prior with covariance W, in which neighbouring rings go together, so that the shape stays smooth. With r the
differences from what is wanted, in units of what is tolerated, and J their derivatives, the step of Gauss and Newton is

    theta = -W J^T (J W J^T + 1)^-1 (r - J theta).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from echelon.agents.polyhedron import moments

AROUND = 14  # points of a ring
ROUNDNESS = 2.3  # exponent of the superellipse: 2 is an ellipse, more is boxier

WIDTH_SPREAD = 0.16  # of a ring's semi-axes, as a part of them, in the prior
CENTER_SPREAD = 0.14  # of a ring's centre, as a part of the semi-axes
END_SPREAD = 0.03  # of the line's ends, as a part of its length
KINSHIP = 0.40  # distance, as a part of the length, over which rings go together
TOLERANCE = 0.004  # of mass and moments, as a part of them; of the centre, of the segment's radius of gyration
STEPS = 10


@dataclass(frozen=True)
class Loft:
    """Rings along a line.

    Attributes:
        start: Where t is 0 [m], shape [3].
        line: From there to where t is 1 [m], shape [3].
        u, v: Unit axes of the rings, square to the line, shape [3] each.
        t: Of each ring, rising, shape [rings].
        a, b: Semi-axes of each along u and v [m], 0 for the first and the last.
        du, dv: Centre of each beside the line [m].
        free: How freely each may change, 1 for fully.
        bumps: What is added along u to the points of each ring [m], shape [rings, AROUND].
        middle: Whether it lies in a plane of symmetry, so that no centre moves along v.
    """

    start: np.ndarray
    line: np.ndarray
    u: np.ndarray
    v: np.ndarray
    t: np.ndarray
    a: np.ndarray
    b: np.ndarray
    du: np.ndarray
    dv: np.ndarray
    free: np.ndarray
    bumps: np.ndarray
    middle: bool

    @property
    def triangles(self) -> np.ndarray:
        """Corners of the triangles, counter-clockwise seen from outside, shape [m, 3]."""
        rings = len(self.t) - 2
        here, after = np.arange(AROUND), (np.arange(AROUND) + 1) % AROUND
        last = 1 + rings * AROUND
        found = [np.column_stack([np.zeros(AROUND, int), 1 + after, 1 + here])]
        for ring in range(rings - 1):
            low, high = 1 + ring * AROUND, 1 + (ring + 1) * AROUND
            # Diagonals that meet at the middle's plane, so that both halves are alike.
            first = here < AROUND // 2
            found.append(
                np.where(
                    first[:, None],
                    np.column_stack([low + here, low + after, high + here]),
                    np.column_stack([low + here, low + after, high + after]),
                )
            )
            found.append(
                np.where(
                    first[:, None],
                    np.column_stack([low + after, high + after, high + here]),
                    np.column_stack([low + here, high + after, high + here]),
                )
            )
        final = 1 + (rings - 1) * AROUND
        found.append(np.column_stack([final + here, final + after, np.full(AROUND, last)]))
        return np.concatenate(found)

    @property
    def places(self) -> np.ndarray:
        """Middle of the patch between two rings that each triangle is of: t, and cosine of the direction to u; [m, 2].

        Both triangles of a patch say the same, so that a colour that depends on them ends along rings.
        """
        cosine = np.cos(2.0 * np.pi * (np.arange(AROUND) + 0.5) / AROUND)
        bands = 0.5 * (self.t[1:] + self.t[:-1])
        repeats = [1 if band in (0, len(bands) - 1) else 2 for band in range(len(bands))]
        return np.concatenate(
            [
                np.tile(np.column_stack([np.full(AROUND, t), cosine]), (n, 1))
                for t, n in zip(bands, repeats, strict=True)
            ]
        )

    def points(self, theta: np.ndarray | None = None) -> np.ndarray:
        """Corners [m], shape [..., n, 3], of the loft changed by theta, shape [..., 4 rings + 2]."""
        count = len(self.t)
        if theta is None:
            theta = np.zeros(4 * count + 2)
        la, lb, cu, cv = (theta[..., k * count : (k + 1) * count] for k in range(4))
        a, b = self.a * np.exp(la), self.b * np.exp(lb)
        size_u, size_v = self.a.max(), self.b.max()
        begin, end = theta[..., 4 * count, None], theta[..., 4 * count + 1, None]
        t = self.t + begin * (1.0 - self.t) + end * self.t
        centers = (
            self.start
            + t[..., None] * self.line
            + (self.du + size_u * cu)[..., None] * self.u
            + (self.dv + size_v * cv)[..., None] * self.v
        )
        angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
        cosine, sine = (np.sign(x) * np.abs(x) ** (2.0 / ROUNDNESS) for x in (np.cos(angle), np.sin(angle)))
        across = a[..., None] * cosine + self.bumps
        rings = centers[..., None, :] + across[..., None] * self.u + (b[..., None] * sine)[..., None] * self.v
        inner = rings[..., 1:-1, :, :]
        inner = inner.reshape(*inner.shape[:-3], -1, 3)
        return np.concatenate([centers[..., :1, :], inner, centers[..., -1:, :]], axis=-2)

    def changed(self, theta: np.ndarray) -> Loft:
        """The loft with theta worked in."""
        count = len(self.t)
        begin, end = float(theta[4 * count]), float(theta[4 * count + 1])
        return replace(
            self,
            start=self.start + begin * self.line,
            line=(1.0 + end - begin) * self.line,
            a=self.a * np.exp(theta[:count]),
            b=self.b * np.exp(theta[count : 2 * count]),
            du=self.du + self.a.max() * theta[2 * count : 3 * count],
            dv=self.dv + self.b.max() * theta[3 * count : 4 * count],
        )


def fitted(loft: Loft, volume: float, center: np.ndarray, spread: np.ndarray) -> Loft:
    """The nearest loft with a wanted volume, centre and moments.

    Args:
        loft: Where to begin.
        volume: [m^3].
        center: Of the solid [m], shape [3].
        spread: Mean of x^2, y^2 and z^2 about the centre in the solid [m^2], shape [3].

    Returns:
        A loft that comes as near as its prior allows: within a percent or so, where that is possible at all.
    """
    count, triangles = len(loft.t), loft.triangles
    prior = _prior(loft)
    radius = float(np.sqrt(spread.sum()))
    rows = [1] if loft.middle else []

    def differences(theta: np.ndarray) -> np.ndarray:
        v, c, s = moments(loft.points(theta), triangles)
        found = np.concatenate(
            [
                np.log(np.maximum(v, 1e-9) / volume)[..., None],
                (c - center) / radius,
                # Moments of inertia are sums of two of these; their ratio to the wanted ones is what counts.
                _inertias(np.diagonal(s, axis1=-2, axis2=-1)) / (volume * _inertias(spread)) - 1.0,
                # In the plane of symmetry the thesis's axes are principal ones.
                s[..., 0, 2, None] / (volume * np.sqrt(spread[0] * spread[2])) * (0.2 if loft.middle else 0.0),
            ],
            axis=-1,
        )
        return np.delete(found, [1 + row for row in rows], axis=-1) / TOLERANCE

    theta = np.zeros(4 * count + 2)
    small = 1e-5
    for step in range(STEPS):
        at = differences(theta)
        slopes = (differences(theta + small * np.eye(len(theta))) - at) / small  # [parameters, differences]
        carried = prior @ slopes
        wanted = -carried @ np.linalg.solve(slopes.T @ carried + np.eye(len(at)), at - slopes.T @ theta)
        theta = theta + (0.5 if step < 4 else 1.0) * (wanted - theta)
    return loft.changed(theta)


def _inertias(spread: np.ndarray) -> np.ndarray:
    """Moments about x, y and z from the means of squares along them."""
    return spread.sum(axis=-1, keepdims=True) - spread


def _prior(loft: Loft) -> np.ndarray:
    """Covariance of theta, shape [4 rings + 2, 4 rings + 2]."""
    count = len(loft.t)
    near = np.exp(-(((loft.t[:, None] - loft.t[None]) / KINSHIP) ** 2)) * np.outer(loft.free, loft.free)
    near = near + 0.004 * np.diag(loft.free**2)
    result = np.zeros((4 * count + 2, 4 * count + 2))
    for block, size in enumerate((WIDTH_SPREAD, WIDTH_SPREAD, CENTER_SPREAD, 0.0 if loft.middle else CENTER_SPREAD)):
        rows = slice(block * count, (block + 1) * count)
        result[rows, rows] = size**2 * near
    # Both semi-axes of a ring grow together more than apart.
    both = 0.6 * WIDTH_SPREAD**2 * near
    result[:count, count : 2 * count] = result[count : 2 * count, :count] = both
    result[-2:, -2:] = END_SPREAD**2 * np.diag([loft.free[0], loft.free[-1]])
    return result
