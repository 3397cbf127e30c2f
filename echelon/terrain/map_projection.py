"""From latitude and longitude to metres east and north, in the plane that touches the Earth in a track's middle.

Points are taken to space on the ellipsoid (WGS 84) raised to the track's mean height, and from there straight down to
the plane. Lengths are too short by (d / R)^2 / 2 at a distance d from the middle: a part in thirty thousand at 50 km.
"""

from __future__ import annotations

import math

import numpy as np

EXTENT = 100_000.0
"""Farther from the middle the plane is no map [m]."""

_EQUATOR, _FLATTENING = 6378137.0, 1.0 / 298.257223563  # WGS 84: radius [m]


def projected(latitude: np.ndarray, longitude: np.ndarray, height: float) -> tuple[tuple[float, float], np.ndarray]:
    """Lay a track on the map.

    Args:
        latitude, longitude: [degrees], shape [n].
        height: Mean height above the ellipsoid [m].

    Returns:
        Latitude and longitude of the origin, the middle of the track's box [degrees]; places east and north of it [m],
        shape [n, 2]. Places farther than `EXTENT` from the first come out as nan.
    """
    places = _in_space(latitude, longitude, height)
    first = places[0]
    far = np.linalg.norm(places - first, axis=1) > EXTENT
    middle_latitude, middle_longitude = float(latitude[0]), float(longitude[0])
    for _ in range(3):  # the middle of the box is known only once there is a map
        flat = (places - first) @ _axes(middle_latitude, middle_longitude).T
        middle = 0.5 * (flat[~far].min(axis=0) + flat[~far].max(axis=0))
        middle_latitude, middle_longitude = _moved_by(middle_latitude, middle_longitude, middle, height)
        first = _in_space(np.array([middle_latitude]), np.array([middle_longitude]), height)[0]
    flat = (places - first) @ _axes(middle_latitude, middle_longitude).T
    flat[far] = np.nan
    return (middle_latitude, middle_longitude), flat


def _in_space(latitude: np.ndarray, longitude: np.ndarray, height: float) -> np.ndarray:
    """Places relative to the middle of the Earth [m], shape [n, 3]."""
    phi, lam = np.radians(latitude), np.radians(longitude)
    squeeze = _FLATTENING * (2.0 - _FLATTENING)
    across = _EQUATOR / np.sqrt(1.0 - squeeze * np.sin(phi) ** 2)
    ring = (across + height) * np.cos(phi)
    return np.stack([ring * np.cos(lam), ring * np.sin(lam), ((1.0 - squeeze) * across + height) * np.sin(phi)], axis=1)


def _axes(latitude: float, longitude: float) -> np.ndarray:
    """East and north, shape [2, 3]."""
    phi, lam = math.radians(latitude), math.radians(longitude)
    east = [-math.sin(lam), math.cos(lam), 0.0]
    north = [-math.sin(phi) * math.cos(lam), -math.sin(phi) * math.sin(lam), math.cos(phi)]
    return np.array([east, north])


def _moved_by(latitude: float, longitude: float, flat: np.ndarray, height: float) -> tuple[float, float]:
    """Latitude and longitude [degrees] a few kilometres away, on a sphere: good enough for an origin."""
    radius = _EQUATOR + height
    north = latitude + math.degrees(flat[1] / radius)
    east = longitude + math.degrees(flat[0] / (radius * max(math.cos(math.radians(latitude)), 1e-3)))
    return min(max(north, -90.0), 90.0), (east + 180.0) % 360.0 - 180.0
