"""A GPS track as a course: what is smoothed, closed, eased and filled, within which bounds, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.terrain.course import Course
from echelon.terrain.map_projection import projected
from echelon.terrain.track_import import Imported, import_track
from echelon.terrain.track_road import LEAST_RADIUS, SMOOTH
from tests.terrain.gps_tracks import degrees, document, ellipse, gpx, place, street_block, there_and_back, written


def noisy(track: np.ndarray, spread: float, seed: int = 3) -> np.ndarray:
    return track + np.random.default_rng(seed).normal(0.0, spread, track.shape)


def distances(result: Imported, track: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From places of a track on the map of the test to the course, on the map and in height [m], shape [n] each."""
    line = result.course.centreline
    s, offset = line.closest(track[:, :2] - place(result.report.latitude, result.report.longitude))
    return np.abs(offset), np.abs(line.position(s)[:, 2] - track[:, 2])


def imported(folder: Path, points: np.ndarray, **options: Any) -> Imported:
    return import_track(written(folder, points), **options)


# ---- the map ---------------------------------------------------------------------------------------------------------
def test_projection_keeps_lengths_of_a_few_kilometres() -> None:
    rng = np.random.default_rng(1)
    track = np.column_stack([rng.uniform(-3000.0, 3000.0, (50, 2)), np.full(50, 100.0)])
    places = degrees(track)
    _, flat = projected(places[:, 0], places[:, 1], 100.0)
    gaps, known = (np.hypot(*(points[:-1] - points[1:]).T) for points in (flat, track[:, :2]))
    # The made-up tracks use one radius of each circle of latitude; that is good to a part in two thousand here.
    assert gaps == pytest.approx(known, rel=1e-3)


@pytest.mark.parametrize(
    ("a", "b", "length"),
    [  # along the geodesic on the ellipsoid
        ((0.0, 10.0), (0.0, 10.1), 11_131.949),  # an arc of the equator
        ((45.0, 7.0), (45.1, 7.0), 11_113.275),  # of a meridian
        ((60.0, 179.95), (60.0, -179.95), 5_580.000),  # across the date line
    ],
)
def test_projection_agrees_with_the_ellipsoid(a: tuple[float, float], b: tuple[float, float], length: float) -> None:
    (latitude, longitude), flat = projected(np.array([a[0], b[0]]), np.array([a[1], b[1]]), 0.0)
    assert np.hypot(*(flat[1] - flat[0])) == pytest.approx(length, rel=3e-6)
    assert flat[0] == pytest.approx(-flat[1], abs=1.0)
    assert latitude == pytest.approx(0.5 * (a[0] + b[0]), abs=0.01)
    assert abs(longitude) == pytest.approx(179.99, abs=0.02) or longitude == pytest.approx(0.5 * (a[1] + b[1]))


# ---- what is kept ----------------------------------------------------------------------------------------------------
def test_a_clean_track_is_kept_as_it_is(tmp_path: Path) -> None:
    result = imported(tmp_path, ellipse())
    on_map, in_height = distances(result, ellipse())
    assert result.course.closed
    assert on_map.max() < 0.1
    assert in_height.max() < 0.1
    assert result.course.title == "A ride"
    assert result.course.name == "ride"
    assert result.report.corners_eased == result.report.meetings == result.report.filled_heights == 0


def test_import_is_the_same_every_time(tmp_path: Path) -> None:
    first, second = (imported(tmp_path, noisy(ellipse(), 1.0)) for _ in range(2))
    assert first == second
    assert Course.load(tmp_path / "ride.gpx") == first.course


@pytest.mark.parametrize("bound", [2.0, SMOOTH])
@pytest.mark.parametrize("spread", [0.3, 1.0])
def test_no_point_moves_beyond_the_bound(bound: float, spread: float, tmp_path: Path) -> None:
    track = noisy(ellipse(), spread)
    result = imported(tmp_path, track, smooth=bound)
    assert result.report.bound == bound
    assert result.report.moved_plan <= 1.02 * bound
    assert result.report.moved_height <= 1.02 * bound
    if result.report.corners_eased == result.report.dropped == 0:
        on_map, in_height = distances(result, track)  # measured here anew, by the nearest place of all
        assert on_map.max() <= 1.02 * bound
        assert in_height.max() <= 1.02 * bound + abs(result.report.height_drift) + 0.1


def test_noise_goes_and_the_road_stays(tmp_path: Path) -> None:
    road = ellipse()
    result = imported(tmp_path, noisy(road, 1.5))
    on_map, in_height = distances(result, road)
    assert np.sqrt((on_map**2).mean()) < 1.0
    assert np.sqrt((in_height**2).mean()) < 1.0
    s = np.arange(0.0, result.course.length, 0.5)
    assert np.abs(result.course.centreline.curvature(s)).max() < 1.0 / 30.0
    assert np.abs(np.diff(result.course.centreline.grade(s))).max() / 0.5 < 1.0 / 60.0
    assert np.abs(result.course.centreline.grade(s)).max() < 0.11  # the road's own: 0.067


def test_street_corners_are_rounded_within_the_bound(tmp_path: Path) -> None:
    result = imported(tmp_path, street_block(), smooth=3.0)
    on_map, _ = distances(result, street_block())
    assert on_map.max() < 3.1
    s = np.arange(0.0, result.course.length, 0.25)
    assert 1.0 / np.abs(result.course.centreline.curvature(s)).max() > LEAST_RADIUS
    straight = on_map[10:35]  # far from corners nothing moves
    assert straight.max() < 0.05


def test_stops_and_repeats_are_dropped(tmp_path: Path) -> None:
    road = ellipse()
    rng = np.random.default_rng(5)
    stop = road[100] + np.column_stack([rng.normal(0.0, 1.0, (60, 2)), np.zeros(60)])
    track = np.vstack([road[:50], road[49:51], road[51:100], stop, road[100:]])
    result = imported(tmp_path, track)
    assert 58 <= result.report.dropped <= 64
    on_map, _ = distances(result, road)
    assert on_map.max() < 1.5


# ---- closing ---------------------------------------------------------------------------------------------------------
def test_a_loop_is_closed_and_its_drift_spread(tmp_path: Path) -> None:
    road = ellipse()
    road[:, 2] += np.linspace(0.0, 6.0, len(road))
    result = imported(tmp_path, road)
    assert result.course.closed
    assert result.report.closing_gap == pytest.approx(6.3, abs=0.5)
    assert result.report.height_drift == pytest.approx(6.0, abs=1.5)
    s = np.arange(0.0, result.course.length, 0.5)
    assert np.abs(result.course.centreline.grade(s)).max() < 0.09


def test_what_goes_past_the_start_is_cut(tmp_path: Path) -> None:
    road = street_block()
    result = imported(tmp_path, np.vstack([road, road[:9] + np.array([0.0, 1.5, 0.0])]))
    assert result.report.cut == 9
    assert result.course.length == pytest.approx(imported(tmp_path, road).course.length, abs=5.0)


def test_an_open_track_stays_open(tmp_path: Path) -> None:
    half = ellipse()[:150]
    result = imported(tmp_path, half)
    assert not result.course.closed
    line = result.course.centreline
    assert np.hypot(*(line.position(line.length) - line.position(0.0))[:2]) == pytest.approx(800.0, abs=10.0)
    assert not imported(tmp_path, ellipse(), close=0.0).course.closed


# ---- heights ---------------------------------------------------------------------------------------------------------
def test_few_missing_heights_are_interpolated(tmp_path: Path) -> None:
    road = ellipse()
    road[50:60, 2] = math.nan
    result = imported(tmp_path, road)
    assert result.report.filled_heights == 10
    _, in_height = distances(result, ellipse())
    assert in_height.max() < 0.5


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        (slice(50, 150), "points 51 to 150 are missing, along 7.. m"),
        (slice(None), "none of its 300 points has a height"),
        (slice(None, None, 3), "100 of 300 points are missing, the first of point 1;"),
        (slice(0, 60), "points 1 to 60"),
        (slice(240, 300), "points 241 to 300"),
    ],
)
def test_many_missing_heights_are_named(missing: slice, words: str, tmp_path: Path) -> None:
    road = ellipse()
    road[missing, 2] = math.nan
    with pytest.raises(InputError, match=words):
        imported(tmp_path, road)


def test_steep_roads_are_reported(tmp_path: Path) -> None:
    road = ellipse()
    road[:, 2] = 100.0 + 60.0 * np.sin(np.arange(300) * (2.0 * np.pi / 300))
    lines = "\n".join(imported(tmp_path, road).report.lines())
    assert "steeper than 15 %" in lines


# ---- meeting itself --------------------------------------------------------------------------------------------------
def test_out_and_back_is_one_road_with_room_to_turn(tmp_path: Path) -> None:
    result = imported(tmp_path, there_and_back())
    line = result.course.centreline
    assert result.course.closed
    assert result.report.corners_eased == 2
    assert result.report.moved_corner < 10.0
    assert result.report.meetings >= 1
    assert 0.5 < result.report.moved_meeting < 2.5
    s = np.arange(0.0, line.length, 0.25)
    assert 1.0 / np.abs(line.curvature(s)).max() > 0.9 * LEAST_RADIUS
    # The same height on the way out and on the way back.
    out = line.position(0.25 * line.length)
    nearest, offset = line.closest(out[:2], near=0.75 * line.length)
    assert abs(float(offset)) < 0.3
    assert float(line.position(nearest)[2]) == pytest.approx(out[2], abs=0.05)


def test_a_bridge_becomes_a_crossing(tmp_path: Path) -> None:
    t = (np.arange(300) + 0.5) * (2.0 * np.pi / 300)
    eight = np.stack([400 * np.sin(t), 300 * np.sin(t) * np.cos(t), 100 + 3 * np.cos(t)], axis=1)
    result = imported(tmp_path, eight)
    assert result.report.meetings >= 1
    assert result.report.moved_meeting == pytest.approx(3.0, abs=0.5)
    assert result.course.land_height(np.zeros(2)) == pytest.approx(100.0, abs=0.3)


# ---- what is refused -------------------------------------------------------------------------------------------------
def test_gaps_are_named(tmp_path: Path) -> None:
    road = np.delete(ellipse(), range(50, 120), axis=0)
    with pytest.raises(InputError, match=r"ride.gpx: gap of 5.. m from point 50 to point 51; must be at most 300 m"):
        imported(tmp_path, road)
    assert imported(tmp_path, road, gap=600.0).course.closed


def test_a_circuit_that_ends_far_above_its_start_is_refused(tmp_path: Path) -> None:
    road = ellipse()
    road[:, 2] += np.linspace(0.0, 60.0, len(road))
    with pytest.raises(InputError, match="from its start but"):
        imported(tmp_path, road)
    assert not imported(tmp_path, road, close=0.0).course.closed


POINT = '<trkpt lat="45" lon="7"><ele>100</ele></trkpt>'


def track_of(*points: str) -> str:
    return document(f"<trk><trkseg>{''.join(points)}</trkseg></trk>")


def with_point(point: str) -> str:
    """A good track whose tenth point is another."""
    good = gpx(ellipse(60))
    places = good.split("<trkpt")
    places[10] = point.removeprefix("<trkpt")
    return "<trkpt".join(places)


MALFORMED: list[tuple[str | bytes, str]] = [
    ("", "not valid XML"),
    ("no xml", "not valid XML"),
    ("<gpx>", "not valid XML"),
    ("<gpx/>", "has no points"),
    ("<kml/>", "its root is 'kml'"),
    ("<html><gpx/></html>", "its root is 'html'"),
    (b"\x00\x01\x02", "not valid XML"),
    (b"\xff\xfe\x00", "not valid XML"),
    (b"PK\x03\x04", "not valid XML"),
    (b'<?xml version="1.0" encoding="nonsense"?><gpx/>', "not valid XML"),
    ('<!DOCTYPE gpx [<!ENTITY a "b">]><gpx>&a;</gpx>', "entities"),
    (gpx(ellipse())[:-40], "not valid XML"),
    (document(""), "has no points"),
    (document("<trk/>"), "has no points"),
    (document("<trk><trkseg/></trk>"), "has no points"),
    (document("<rte/>"), "has no points"),
    (document('<wpt lat="1" lon="2"/>'), "has no points"),
    (track_of(POINT), "0 m long with 1 different points"),
    (track_of(POINT, POINT), "0 m long"),
    (track_of(*[POINT] * 500), "0 m long"),
    (gpx(ellipse(8, 10.0, 10.0)), "must be at least 100 m"),
    (with_point('<trkpt lon="7"><ele>1</ele></trkpt>'), "point 10: lat is missing"),
    (with_point('<trkpt lat="45"><ele>1</ele></trkpt>'), "point 10: lon is missing"),
    (with_point('<trkpt lat="" lon="7"/>'), "point 10: lat = ''"),
    (with_point('<trkpt lat="north" lon="7"/>'), "point 10: lat = 'north'"),
    (with_point('<trkpt lat="91" lon="7"/>'), "lat = '91': must be from -90 to 90"),
    (with_point('<trkpt lat="-90.1" lon="7"/>'), "lat = '-90.1'"),
    (with_point('<trkpt lat="45" lon="181"/>'), "lon = '181': must be from -180 to 180"),
    (with_point('<trkpt lat="nan" lon="7"/>'), "lat = 'nan'"),
    (with_point('<trkpt lat="inf" lon="7"/>'), "lat = 'inf'"),
    (with_point('<trkpt lat="45" lon="1e999"/>'), "lon = '1e999'"),
    (with_point('<trkpt lat="4&#10;5" lon="7"/>'), "lat = "),
    (with_point('<trkpt lat="45" lon="7"><ele>high</ele></trkpt>'), "ele = 'high'"),
    (with_point('<trkpt lat="45" lon="7"><ele>nan</ele></trkpt>'), "ele = 'nan'"),
    (with_point('<trkpt lat="45" lon="7"><ele>9001</ele></trkpt>'), "must be from -500 to 9000 m"),
    (with_point('<trkpt lat="45" lon="7"><ele>-501</ele></trkpt>'), "ele = '-501'"),
    (with_point(f'<trkpt lat="45" lon="7"><ele>{"9" * 400}</ele></trkpt>'), "ele = '999"),
    (with_point('<trkpt lat="0" lon="0"><ele>1</ele></trkpt>'), "point 10 is more than 100 km from point 1"),
    (with_point('<trkpt lat="45.02" lon="7"><ele>1</ele></trkpt>'), "gap of "),
    (gpx(ellipse()).replace("<ele>", "<height>").replace("</ele>", "</height>"), "none of its 300 points"),
    (document(f"<trk><name>a</name><trkseg>{POINT}</trkseg></trk>" * 3), "has 3 tracks"),
    (document("".join(f"<trk><name>{'x' * 300}</name><trkseg>{POINT}</trkseg></trk>" for _ in range(99))), "99 tracks"),
]


@pytest.mark.parametrize(("content", "words"), MALFORMED, ids=[f"{i}-{w[:24]}" for i, (_, w) in enumerate(MALFORMED)])
def test_what_is_wrong_with_a_file_is_one_line(content: str | bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "ride.gpx"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        import_track(path)
    message = str(caught.value)
    assert words in message
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert len(message) < 1200


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"smooth": 0.1}, "smooth = 0.1: must be from 0.5 to 100 m"),
        ({"smooth": math.nan}, "smooth = nan"),
        ({"gap": 0.0}, "gap = 0"),
        ({"close": -1.0}, "close = -1"),
        ({"width": 1.0}, "width = 1"),
        ({"name": "a b"}, "name = 'a b'"),
        ({"track": 4}, "has no track 4; must be from 1 to 1"),
        ({"track": -1}, "has no track -1"),
    ],
)
def test_options_that_cannot_be_are_one_line(options: dict[str, Any], words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        imported(tmp_path, ellipse(), **options)
    assert words in str(caught.value)


def test_no_file(tmp_path: Path) -> None:
    for path in (tmp_path / "none.gpx", tmp_path):
        with pytest.raises(InputError, match="must be a GPX file"):
            import_track(path)


# ---- what else may stand in a file -----------------------------------------------------------------------------------
def test_one_of_several_tracks_is_chosen(tmp_path: Path) -> None:
    texts = [gpx(track, name).partition("<trk>")[2].rpartition("</gpx>")[0] for track, name in
             ((ellipse(), "long"), (street_block(), "block"))]  # fmt: skip
    path = tmp_path / "rides.gpx"
    path.write_text(document("".join(f"<trk>{text}" for text in texts)))
    with pytest.raises(InputError, match=r"has 2 tracks \(1 'long', 2 'block'\)"):
        import_track(path)
    assert import_track(path, track=2).course.title == "block"


def test_routes_segments_old_versions_and_foreign_elements_are_read(tmp_path: Path) -> None:
    good = gpx(ellipse())
    plain = imported(tmp_path, ellipse()).course
    path = tmp_path / "ride.gpx"
    middle = "</trkpt>".join(good.split("</trkpt>")[:150]) + "</trkpt>"
    for text in (
        good.replace("trkseg>", "x>")
        .replace("<x>", "")
        .replace("</x>", "")
        .replace("trkpt", "rtept")
        .replace("trk>", "rte>"),
        middle + "</trkseg><trkseg>" + good[len(middle) :],
        good.replace("/GPX/1/1", "/GPX/1/0").replace('version="1.1"', 'version="1.0"'),
        good.replace("</ele>", "</ele><time>yesterday</time><extensions><a:hr xmlns:a='b'>1</a:hr></extensions>"),
        good.replace('<?xml version="1.0" encoding="UTF-8"?>', ""),
        good.replace(' xmlns="http://www.topografix.com/GPX/1/1"', ""),
    ):
        path.write_text(text, encoding="utf-8")
        assert import_track(path).course == plain
