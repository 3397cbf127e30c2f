"""GPS tracks made up for tests: known roads, written as GPX."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np

LATITUDE, LONGITUDE = 45.0, 7.0


def ellipse(count: int = 300, across: float = 400.0, high: float = 300.0) -> np.ndarray:
    """Points of a road round an ellipse with one hill, [count, 3] [m]; the last is one step from the first."""
    t = np.arange(count) * (2.0 * np.pi / count)
    return np.stack([across * np.cos(t), high * np.sin(t), 100.0 + 20.0 * np.sin(t)], axis=1)


def street_block(step: float = 10.0) -> np.ndarray:
    """A block of streets of 500 m by 400 m with sharp corners, level, [n, 3] [m]."""
    corners = np.array([[0.0, 0.0], [500.0, 0.0], [500.0, 400.0], [0.0, 400.0], [0.0, 0.0]])
    sides = [a + (b - a) * np.arange(0.0, 1.0, step / np.hypot(*(b - a)))[:, None] for a, b in pairwise(corners)]
    flat = np.vstack(sides)
    return np.column_stack([flat, np.full(len(flat), 100.0)])


def there_and_back(count: int = 100) -> np.ndarray:
    """1 km out along a winding road and back along it; the way back was measured 2 m higher, [2 count, 3] [m]."""
    x = np.linspace(0.0, 1000.0, count)
    out = np.stack([x, 30.0 * np.sin(x / 160.0), 100.0 + 0.03 * x], axis=1)
    return np.vstack([out, out[::-1] + np.array([0.0, 0.0, 2.0])])


_A, _E2, _SIN = 6378137.0, 0.00669437999014, math.sin(math.radians(LATITUDE))
MERIDIAN = _A * (1.0 - _E2) / (1.0 - _E2 * _SIN**2) ** 1.5 + 100.0
PARALLEL = (_A / math.sqrt(1.0 - _E2 * _SIN**2) + 100.0) * math.cos(math.radians(LATITUDE))
"""Radii of the ellipsoid there, along a meridian and of the circle of latitude, 100 m above it [m]."""


def degrees(track: np.ndarray) -> np.ndarray:
    """Latitude, longitude and height of places around an origin, shape [n, 3]; good to centimetres in a kilometre."""
    latitude, longitude = LATITUDE + np.degrees(track[:, 1] / MERIDIAN), LONGITUDE + np.degrees(track[:, 0] / PARALLEL)
    return np.stack([latitude, longitude, track[:, 2]], axis=1)


def place(latitude: float, longitude: float) -> np.ndarray:
    """The reverse, on the map [m], shape [2]."""
    return np.array([math.radians(longitude - LONGITUDE) * PARALLEL, math.radians(latitude - LATITUDE) * MERIDIAN])


def gpx(track: np.ndarray, name: str = "A ride") -> str:
    """A track as GPX text; heights that are not numbers are left out."""
    points = "".join(
        f'<trkpt lat="{latitude:.9f}" lon="{longitude:.9f}">'
        + (f"<ele>{height:.3f}</ele>" if math.isfinite(height) else "")
        + "</trkpt>"
        for latitude, longitude, height in degrees(track).tolist()
    )
    return document(f"<trk><name>{name}</name><trkseg>{points}</trkseg></trk>")


def document(body: str) -> str:
    """GPX text around tracks or routes."""
    head = '<?xml version="1.0" encoding="UTF-8"?><gpx version="1.1" creator="test"'
    return f'{head} xmlns="http://www.topografix.com/GPX/1/1">{body}</gpx>'


def written(folder: Path, track: np.ndarray) -> Path:
    """A track as a file."""
    path = folder / "ride.gpx"
    path.write_text(gpx(track), encoding="utf-8")
    return path
