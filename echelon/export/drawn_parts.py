"""Shapes with a colour: what links, actors and scenery are drawn of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from echelon.export.shapes import Mesh, visual_mesh
from echelon.warp_kernels.model import Vec3, Visual


@dataclass(frozen=True)
class DrawnPart:
    """Shapes of one colour on a link.

    Attributes:
        mesh: In the link's frame, of convex pieces [m].
        color: Linear RGB from 0 to 1, or None for the colour of the individual.
    """

    mesh: Mesh
    color: Vec3 | None


def parts_of(visuals: Sequence[Visual]) -> tuple[DrawnPart, ...]:
    """A part for each visual, in the frame of its link."""
    return tuple(DrawnPart(visual_mesh(visual), visual.color) for visual in visuals)
