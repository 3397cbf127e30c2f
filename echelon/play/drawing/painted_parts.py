"""Parts of bodies and things as meshes for the browser, in which light falls on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from echelon.export.drawn_parts import DrawnPart
from echelon.export.shapes import joined
from echelon.play.drawing.browser_light import shaded_albedo
from echelon.play.drawing.glb import ColoredMesh


def painted(parts: Sequence[DrawnPart], individual: np.ndarray) -> ColoredMesh:
    """Parts in their colours; those without one in that of the individual, linear RGB, shape [3]."""
    mesh = joined([part.mesh for part in parts])
    own = [np.asarray(individual if part.color is None else part.color, dtype=np.float64) for part in parts]
    sizes = [len(part.mesh.points) for part in parts]
    colors = np.repeat(shaded_albedo(np.array(own)), sizes, axis=0)
    return ColoredMesh(mesh.points, mesh.triangles, np.column_stack([colors, np.ones(len(colors))]))


def split(parts: Sequence[DrawnPart]) -> tuple[list[DrawnPart], list[DrawnPart]]:
    """Parts with a colour of their own, and those in the colour of the individual."""
    return [part for part in parts if part.color is not None], [part for part in parts if part.color is None]
