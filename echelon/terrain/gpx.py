"""GPS tracks from GPX files, 1.0 and 1.1: titles and points, and nothing else of what may stand in them."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from echelon.errors import InputError
from echelon.settings import shown

SIZE_LIMIT = 200_000_000
"""Bytes of a file, at most."""


@dataclass(frozen=True)
class GpsTrack:
    """A track as it was recorded.

    Attributes:
        title: Its name in the file, on one line; may be empty.
        latitude, longitude: [degrees], shape [n]
        heights: Above the sea [m], nan where the file has none, shape [n]
    """

    title: str
    latitude: np.ndarray
    longitude: np.ndarray
    heights: np.ndarray

    def __len__(self) -> int:
        return len(self.heights)


def read_gpx(path: Path, where: str, track: int = 0) -> GpsTrack:
    """Read a track; of a file without tracks, a route.

    Args:
        path: Of the file.
        where: Its name in messages.
        track: Which of its tracks, counted from 1; 0 takes the only one. Its segments are joined.

    Raises:
        InputError: One line that names the file, what is wrong, where in it, and what is allowed.
    """
    wanted = "must be a GPX file"
    try:
        if path.stat().st_size > SIZE_LIMIT:
            raise InputError(f"{where}: has {path.stat().st_size} bytes; must be at most {SIZE_LIMIT}")
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{where}: no such file; {wanted}") from None
    except OSError as error:
        raise InputError(f"{where}: cannot be read ({error.strerror or error}); {wanted}") from None
    if b"<!ENTITY" in data:
        raise InputError(f"{where}: declares XML entities; {wanted} without")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{where}: not valid XML: {shown(str(error))}; {wanted}") from None
    if _tag(root) != "gpx":
        raise InputError(f"{where}: its root is {shown(_tag(root))}; {wanted}, whose root is 'gpx'")
    tracks = [(found, list(_points(found, "trkpt"))) for found in root if _tag(found) == "trk"]
    tracks = [(found, points) for found, points in tracks if points]
    if not tracks:  # a planned route is as good
        tracks = [(found, list(_points(found, "rtept"))) for found in root if _tag(found) == "rte"]
        tracks = [(found, points) for found, points in tracks if points]
    if not tracks:
        raise InputError(f"{where}: has no points; must have a track (trk) or a route (rte)")
    if not 0 <= track <= len(tracks):
        raise InputError(f"{where}: has no track {track}; must be from 1 to {len(tracks)}")
    if track == 0 and len(tracks) > 1:
        names = ", ".join(f"{number} {shown(_title(found))}" for number, (found, _) in enumerate(tracks[:8], 1))
        raise InputError(f"{where}: has {len(tracks)} tracks ({names}); one must be chosen, with --track or track=")
    chosen, points = tracks[max(track - 1, 0)]
    rows = [_point(point, number, where) for number, point in enumerate(points, 1)]
    latitude, longitude, heights = np.array(rows, dtype=np.float64).T
    return GpsTrack(_title(chosen), latitude, longitude, heights)


def _tag(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _points(track: ElementTree.Element, tag: str) -> list[ElementTree.Element]:
    return [found for found in track.iter() if _tag(found) == tag]


def _title(track: ElementTree.Element) -> str:
    text = next((found.text or "" for found in track if _tag(found) == "name"), "")
    return "".join(c for c in " ".join(text.split()) if c.isprintable())[:100]


def _point(point: ElementTree.Element, number: int, where: str) -> tuple[float, float, float]:
    place = []
    for key, limit in (("lat", 90.0), ("lon", 180.0)):
        value = _number(point.get(key))
        if value is None or abs(value) > limit:
            text = "is missing" if point.get(key) is None else f"= {shown(point.get(key))}"
            raise InputError(f"{where}: point {number}: {key} {text}: must be from -{limit:g} to {limit:g} degrees")
        place.append(value)
    text = next((found.text for found in point if _tag(found) == "ele"), None)
    if text is None or not text.strip():
        return place[0], place[1], math.nan
    height = _number(text)
    if height is None or not -500.0 <= height <= 9000.0:
        raise InputError(f"{where}: point {number}: ele = {shown(text)}: must be from -500 to 9000 m")
    return place[0], place[1], height


def _number(text: str | None) -> float | None:
    try:
        value = float(text) if text is not None else math.nan
    except ValueError:
        return None
    return value if math.isfinite(value) else None
