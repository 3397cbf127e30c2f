"""The shapes of a person's segments: what is weighed is what is drawn.

Each segment is a closed polyhedron of Dempster's density (`DENSITIES`, as *Simulation of Leaping, Tumbling, Landing,
and Balancing Humans* lists them), a loft whose proportions are drawn by hand (`segment_templates`) and then bent until
its mass, centre of mass and moments of inertia are the thesis's (`segment_lofts`).

The thesis gives three moments of each segment and no products. Where a segment lies across the axes, as forearm and
hand do in the reference pose, a real solid has products too; the polyhedron has them, the dynamics keep the thesis's
diagonal tensor.

A polyhedron is cut into patches of one colour each: skin, hair, leotard (the individual's colour) and shorts. Together
the patches are the whole surface.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.agents.gymnasts.segment_lofts import Loft, fitted
from echelon.agents.gymnasts.segment_templates import Paint, template
from echelon.agents.polyhedron import MassProperties, Polyhedron
from echelon.warp_kernels.model import Link, Vec3, Visual

DENSITIES: Mapping[str, float] = {
    "head": 1_171.0,
    "sternum": 1_009.0,
    "upper_chest": 1_009.0,
    "lower_chest": 1_009.0,
    "abdomen": 1_029.0,
    "pelvis": 1_029.0,
    "shoulder_girdle": 1_009.0,
    "upper_arm": 1_068.0,
    "lower_arm": 1_102.0,
    "hand": 1_070.0,
    "upper_leg": 1_040.0,
    "lower_leg": 1_079.0,
    "foot": 1_066.0,
    "toes": 1_066.0,
}
"""Of each segment [kg/m^3]."""

DIGITS = 4  # to which points are rounded [m]: what is weighed is what is written


@dataclass(frozen=True)
class Segment:
    """A segment of a person.

    Attributes:
        solid: Its surface in the frame of its link [m].
        density: [kg/m^3].
        visuals: Patches of the surface by colour, and small things on it.
    """

    solid: Polyhedron
    density: float
    visuals: tuple[Visual, ...]

    @property
    def mass_properties(self) -> MassProperties:
        """Mass, centre of mass and inertia tensor in the frame of its link."""
        return self.solid.mass_properties(self.density)


def fitted_segments(links: Sequence[Link], soles: Mapping[str, Vec3], female: bool) -> dict[str, Segment]:
    """Shapes for all links of a gymnast, by the links' names.

    Args:
        links: Of a gymnast, in the reference pose a T (see `joints`).
        soles: Positions of the contact sites of the left foot in the frames of their links, by name [m].
        female: A woman's proportions and clothes, or a man's.
    """
    named = {link.name: link for link in links}
    found: dict[str, Segment] = {}
    shapes: dict[tuple[object, ...], Loft] = {}  # alike on both sides of a symmetric body, and fitted once
    for link in links:
        side, _, rest = link.name.partition("_")
        mirrored = side == "right"
        name = rest if side in ("left", "right") else link.name
        loft, paint = template(name, named, soles, female, side if mirrored else "left")
        density = DENSITIES[name]
        center = np.array([1.0, -1.0 if mirrored else 1.0, 1.0]) * link.com
        moments = np.diag(np.array(link.inertia))
        key = (name, link.mass, *center.tolist(), *moments.tolist(), *loft.line.tolist())
        if key not in shapes:
            spread = (0.5 * moments.sum() - moments) / link.mass
            shapes[key] = fitted(loft, link.mass / density, center, spread)
        found[link.name] = _segment(link.name, shapes[key], density, paint, mirrored)
    return found


def _segment(name: str, loft: Loft, density: float, paint: Paint, mirrored: bool) -> Segment:
    points, triangles = np.round(loft.points(), DIGITS), loft.triangles
    colors = [paint.color(float(t), float(ahead)) for t, ahead in loft.places]
    if mirrored:
        points, triangles = points * [1.0, -1.0, 1.0], triangles[:, ::-1]
    solid = Polyhedron(points, triangles, name)
    visuals = [_patch(points, triangles[[c == color for c in colors]], color) for color in dict.fromkeys(colors)]
    return Segment(solid, density, (*visuals, *paint.details(loft)))


def _patch(points: np.ndarray, triangles: np.ndarray, color: Vec3 | None) -> Visual:
    used, corners = np.unique(triangles, return_inverse=True)
    return Visual(
        "mesh",
        (1.0, 1.0, 1.0),
        color=color,
        points=tuple((float(x), float(y), float(z)) for x, y, z in points[used] + 0.0),
        triangles=tuple((int(a), int(b), int(c)) for a, b, c in corners.reshape(-1, 3)),
    )
