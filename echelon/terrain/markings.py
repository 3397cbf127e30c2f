"""Paint on a road: what lets riders, and those who watch them, see how fast the road goes by."""

from __future__ import annotations

import numpy as np

LINE = 0.12  # [m], width of a painted line
EDGE = 0.25  # [m], from the road's edge to the middle of its line
DASH, GAP = 3.0, 6.0  # [m], of the centre line
BAR = 0.4  # [m], length of the line at the start along the road


def road_markings(length: float, half_width: float, closed: bool) -> dict[str, np.ndarray]:
    """Painted strips of a road.

    Args:
        length: Of the road [m].
        half_width: From its centreline to an edge [m].
        closed: Whether its end is its start.

    Returns:
        Rows (s0, s1, offset0, offset1) for "edge", "centre" and "start", and for the "finish" of a road that is not
        closed: along the centreline from s0 to s1, across it from offset0 to offset1, left positive [m];
        shape [strips, 4]. Dashes are of one length and fill the road evenly.
    """
    inner = half_width - EDGE - 0.5 * LINE
    dashes = max(1, round(length / (DASH + GAP)))
    starts = (np.arange(dashes) + 0.5) * (length / dashes)
    across = np.tile([-0.5 * LINE, 0.5 * LINE], (dashes, 1))
    markings = {
        "edge": np.array([[0.0, length, inner, inner + LINE], [0.0, length, -inner - LINE, -inner]]),
        "centre": np.column_stack([starts, starts + min(DASH, 0.4 * length / dashes), across]),
        "start": np.array([[0.0, BAR, -half_width, half_width]]),
    }
    if not closed:
        markings["finish"] = np.array([[length - BAR, length, -half_width, half_width]])
    return markings
