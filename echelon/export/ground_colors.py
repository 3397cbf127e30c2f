"""Colours of ground: tones that differ from place to place, so that one sees how fast it goes by.

They are functions of the place in the world alone, the same in every picture: value noise, a random number at each
point of a lattice and smooth in between.
"""

from __future__ import annotations

import numpy as np

from echelon.export.road_scene import GRASS

DRY = np.array([0.215, 0.205, 0.075])  # grass where it is dry
MOWN = 3.0  # [m] of the verge along the road, mown to and fro
# Sizes [m] of patches and how much darker or lighter they are.
GRASS_GRAIN = ((0.5, 0.30), (1.3, 0.26), (4.5, 0.22), (21.0, 0.22))
VERGE_GRAIN = ((0.45, 0.34), (1.2, 0.24), (5.0, 0.12))
ASPHALT_GRAIN = ((0.5, 0.26), (1.4, 0.16), (7.0, 0.20))
WHEEL_TRACKS = 0.05  # how much darker asphalt is where cars roll


def ground_albedo(
    name: str, base: np.ndarray, places: np.ndarray, uv: np.ndarray | None, spacing: np.ndarray
) -> np.ndarray:
    """Linear RGB of ground, shape [n, 3].

    Args:
        name: Of the part of the ground, see `GroundPart`.
        base: Its own colour, linear RGB.
        places: In the world [m], float64, shape [n, 2].
        uv: How far across, and along [m], see `GroundPart`, shape [n, 2]; None of land.
        spacing: From point to point of the mesh [m], shape [n]: finer tones are left out.
    """
    if name == "land":
        return _grass(base, places, spacing)
    if name == "verge" and uv is not None:
        stripe = np.where(np.floor(uv[:, 1] / MOWN) % 2 == 0, 0.08, -0.08) * _fade(spacing, 2.0 * MOWN)
        tone = _grain(places, spacing, VERGE_GRAIN) + stripe
        mown = base * (1.0 + tone[:, None])
        # Away from the road the verge becomes the land.
        inner = np.abs(uv[:, 0]) - np.abs(uv[:, 0]).min(initial=np.inf)
        away = np.clip((inner - 2.0) / 3.5, 0.0, 1.0)[:, None]
        return mown + away * (_grass(np.array(GRASS), places, spacing) - mown)
    if name == "paint":
        return base * (1.0 + 0.10 * _shade(places, 0.6, spacing)[:, None])
    tone = _grain(places, spacing, ASPHALT_GRAIN)
    if name == "asphalt" and uv is not None:
        tone += WHEEL_TRACKS * np.cos(8.0 * np.pi * (uv[:, 0] - 0.5))
    return base * (1.0 + tone[:, None])


def _grain(places: np.ndarray, spacing: np.ndarray, grain: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Tones of several sizes [m] and strengths together, shape [n]."""
    return np.sum([strength * _shade(places, size, spacing) for size, strength in grain], axis=0)


def _grass(base: np.ndarray, places: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    tone = _grain(places, spacing, GRASS_GRAIN)
    dry = np.clip(1.5 * _noise(places, 70.0) - 0.5, 0.0, 0.7)[:, None]
    return (base + dry * (DRY - base)) * (1.0 + tone[:, None])


def _shade(places: np.ndarray, size: float, spacing: np.ndarray) -> np.ndarray:
    """Noise about zero, -0.5 to 0.5, of patches of a size [m]; none where the mesh is coarser than that."""
    return (_noise(places, size) - 0.5) * _fade(spacing, size)


def _fade(spacing: np.ndarray, size: float) -> np.ndarray:
    return np.clip(2.0 - spacing / size, 0.0, 1.0)


def _noise(places: np.ndarray, size: float) -> np.ndarray:
    """Value noise, 0 to 1, of patches of a size [m], at places [n, 2]."""
    scaled = places / size
    cell = np.floor(scaled).astype(np.int64)
    part = scaled - cell
    part = part * part * (3.0 - 2.0 * part)
    x, y = part.T
    corners = [_random(cell + step) for step in ((0, 0), (1, 0), (0, 1), (1, 1))]
    low = corners[0] + x * (corners[1] - corners[0])
    high = corners[2] + x * (corners[3] - corners[2])
    return low + y * (high - low)


def _random(cell: np.ndarray) -> np.ndarray:
    """A number from 0 to 1 for each lattice point [n, 2]."""
    mixed = (cell[:, 0] * 73856093) ^ (cell[:, 1] * 19349663)
    mixed = ((mixed >> 13) ^ mixed) * 2654435761 % 4294967296
    return ((mixed >> 7) ^ mixed) % 65536 / 65535.0
