"""Pictures of rides: the road under the riders, the sky above them, and cameras that go where they go."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import av
import numpy as np
import pytest
from PIL import Image

from echelon.errors import InputError
from echelon.export.camera import View
from echelon.export.coarse_meshes import coarsened
from echelon.export.drawn_road import Blockers, drawn_road
from echelon.export.light import SUN, flattened
from echelon.export.pictures import render_film, render_still, render_strip
from echelon.export.renderer import Renderer, RenderingUnavailable
from echelon.export.road_cameras import ROAD_CAMERAS, camera_way
from echelon.export.road_scene import road_scene
from echelon.export.road_scenery import RoadScenery, bisected
from echelon.export.shapes import visual_mesh
from echelon.export.usd import Representation, write_stage
from echelon.warp_kernels.model import Visual
from tests.export.road_ride import distinct_colors, ride_recording, small_course

SIZE = (320, 180)


@pytest.fixture(scope="module")
def gl() -> None:
    """Skips a test where nothing can be drawn."""
    try:
        Renderer((16, 16), []).close()
    except RenderingUnavailable as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def ride() -> Any:
    obstacles = ({"kind": "car", "distance": 75.0, "offset": 3.0},)
    return ride_recording(3, 40, obstacles=obstacles, start=45.0)


@pytest.fixture(scope="module")
def scenery(ride: Any) -> RoadScenery:
    return RoadScenery(drawn_road(road_scene(ride.world)))


def pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def projected(view: View, size: tuple[int, int], points: np.ndarray) -> np.ndarray:
    """Column and row of points [..., 3] in a picture, worked out from the view alone, shape [..., 2]."""
    back = np.subtract(view.eye, view.target) / np.linalg.norm(np.subtract(view.eye, view.target))
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    gap = points - np.asarray(view.eye)
    scale = 0.5 * size[1] / np.tan(0.5 * view.field_of_view) / (gap @ -back)
    return np.stack([0.5 * size[0] + scale * (gap @ right), 0.5 * size[1] - scale * (gap @ np.cross(back, right))], -1)


def above(place: np.ndarray, height: float = 14.0) -> View:
    """From above and aside on a place."""
    x, y, z = place.tolist()
    return View((x + 4.0, y - 5.0, z + height), (x, y, z))


# ---- what is in a picture ------------------------------------------------------------------------------------------
@pytest.mark.usefixtures("gl")
def test_riders_in_their_colours_on_grey_asphalt_with_white_lines(ride: Any, tmp_path: Path) -> None:
    frame = 15
    course = small_course()
    view = above(ride.link_poses[frame, :, 0, :3].mean(axis=0))
    picture = pixels(render_still(ride, tmp_path / "still.png", time=0.5, size=SIZE, camera=view))
    trunk = [link.name for link in ride.casts[0].body.links].index("upper_body")
    for rider, color in enumerate(distinct_colors(3)):
        column, row = projected(view, SIZE, ride.link_poses[frame, rider, trunk, :3]).round().astype(int)
        near = picture[row - 3 : row + 4, column - 3 : column + 4].reshape(-1, 3)
        # Somewhere there the jersey shows: the same of red, green and blue is most and least.
        assert any(
            np.argmax(seen) == np.argmax(color) and np.argmin(seen) == np.argmin(color) and np.ptp(seen) > 50
            for seen in near
        ), (rider, color)
    s, _ = course.centreline.closest(ride.link_poses[frame, :, 0, :2].mean(axis=0))
    line = course.centreline

    def on_road(offset: float) -> np.ndarray:
        place = np.append(line.position(s)[:2] + offset * line.left(s), 0.0)
        place[2] = course.surfaces.height(place[:2])
        column, row = projected(view, SIZE, place).round().astype(int)
        return picture[row, column]

    inner = course.half_width - 0.25
    asphalt, paint, grass = on_road(2.9), on_road(inner), on_road(course.half_width + 4.0)
    assert np.ptp(asphalt) < 18
    assert 40 < asphalt.mean() < 130
    assert paint.min() > asphalt.max() + 40
    assert grass[1] > grass[0] > grass[2]


@pytest.mark.usefixtures("gl")
def test_sky_is_above_and_blue(ride: Any, tmp_path: Path) -> None:
    picture = pixels(render_still(ride, tmp_path / "still.png", time=0.5, size=SIZE))
    top = picture[2].mean(axis=0)
    assert top[2] > top[1] > top[0]
    assert top.mean() > 140


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("representation", get_args(Representation))
def test_stage_and_recording_give_the_same_picture(representation: Any, ride: Any, tmp_path: Path) -> None:
    stage = write_stage(ride, tmp_path / "ride.usd", representation, clip_frames=16)
    for camera in ("follow", "helicopter") if representation == "rig" else ("roadside",):
        recorded = pixels(render_still(ride, tmp_path / "recorded.png", time=0.7, size=SIZE, camera=camera))
        staged = pixels(render_still(stage, tmp_path / "staged.png", time=0.7, size=SIZE, camera=camera))
        different = np.abs(staged - recorded).max(axis=2) > 16
        assert different.mean() < 0.004, camera


@pytest.mark.usefixtures("gl")
def test_film_moves_and_is_the_same_every_time(ride: Any, tmp_path: Path) -> None:
    first, second = (render_film(ride, tmp_path / f"{name}.mp4", size=SIZE, fps=6) for name in "ab")
    assert first.read_bytes() == second.read_bytes()
    with av.open(str(first)) as container:
        frames = [frame.to_ndarray(format="rgb24").astype(int) for frame in container.decode(video=0)]
    assert len(frames) == 8
    still = pixels(render_still(ride, tmp_path / "still.png", time=0.5, size=SIZE))
    assert np.abs(frames[3] - still).mean() < 5.0
    assert np.abs(frames[3] - frames[4]).max() > 30


@pytest.mark.usefixtures("gl")
def test_strip_from_one_place_shows_everybody(ride: Any, tmp_path: Path) -> None:
    strip = pixels(render_strip(ride, tmp_path / "strip.png", interval=0.6, count=3, size=SIZE))
    panels = [strip[:, index * (SIZE[0] + 4) :][:, : SIZE[0]] for index in range(3)]
    for panel in panels[1:]:
        assert np.mean(np.abs(panel - panels[0]).max(axis=2) < 10) > 0.85
        assert np.abs(panel - panels[0]).max() > 60


@pytest.mark.usefixtures("gl")
def test_strip_of_a_way_too_long_for_one_place_follows(ride: Any, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("echelon.export.shot_views.COMMON_REACH", 2.0)
    strip = pixels(render_strip(ride, tmp_path / "strip.png", interval=0.6, count=3, size=SIZE))
    for index in range(3):
        still = pixels(render_still(ride, tmp_path / "still.png", time=0.6 * index, size=SIZE))
        panel = strip[:, index * (SIZE[0] + 4) :][:, : SIZE[0]]
        assert np.mean(np.abs(panel - still).max(axis=2) < 10) > 0.9  # but for the label


def test_cameras_of_fields_are_refused_on_roads(ride: Any, tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match="camera 'corral' is not one of follow, overview, roadside, helicopter"
    ) as error:
        render_still(ride, tmp_path / "still.png", camera="corral")
    assert "\n" not in str(error.value)


# ---- cameras -------------------------------------------------------------------------------------------------------
def riding(seconds: float, riders: int = 6, speed: float = 9.0) -> np.ndarray:
    """Places of a group round a curve of 60 m radius that climbs; [frames, riders, 3]."""
    angle = (speed * np.arange(int(seconds * 30))[:, None] / 30.0 - 2.5 * np.arange(riders)) / 60.0
    return np.stack([60.0 * np.cos(angle), 60.0 * np.sin(angle), 3.0 * angle], axis=2)


@pytest.mark.parametrize("camera", ROAD_CAMERAS)
def test_group_is_in_the_picture_and_the_camera_level(camera: Any) -> None:
    places = riding(8.0)
    way = camera_way(camera, places, 30, 16 / 9)
    for frame in range(0, 240, 20):
        view = View(tuple(way.eyes[frame]), tuple(way.targets[frame]), float(way.fields[frame]))
        spots = projected(view, (320, 180), places[frame] + [0.0, 0.0, 0.9])
        inside = ((spots > 0.0) & (spots < (320, 180))).all(axis=1)
        assert inside.mean() > (0.6 if camera == "roadside" else 0.95), (camera, frame)
        ground = places if camera == "roadside" else places[frame]
        assert way.eyes[frame, 2] > ground[..., 2].min() + 1.0


def test_follow_is_behind_smooth_and_looks_along_the_road() -> None:
    places = riding(10.0)
    way = camera_way("follow", places, 30, 16 / 9)
    middle = places.mean(axis=1)
    heading = np.gradient(middle, axis=0)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    behind = ((middle - way.eyes) * heading).sum(axis=1)
    assert (behind > 6.0).all()
    assert (((way.targets - middle) * heading).sum(axis=1) > 3.0).all()
    acceleration = np.linalg.norm(np.diff(way.eyes, 2, axis=0), axis=1) * 900.0
    assert acceleration.max() < 3.0


def test_who_breaks_away_does_not_take_the_camera_along() -> None:
    places = riding(6.0)
    alone = places.copy()
    alone[:, 0, 0] += 150.0
    group, split = (camera_way("helicopter", p, 30, 16 / 9) for p in (places[:, 1:], alone))
    assert np.abs(group.targets - split.targets).max() < 0.5


def test_camera_stays_with_one_of_two_groups_and_is_cut_to_the_larger() -> None:
    places = riding(20.0)
    behind = riding(20.0)
    behind[..., 1] += 150.0
    # Six and six; after ten seconds four of the first ride away.
    both = np.concatenate([places, behind], axis=1)
    both[300:, :4, 0] -= np.linspace(0.0, 200.0, 300)[:, None]
    for camera in ROAD_CAMERAS:
        way = camera_way(camera, both, 30, 16 / 9)
        gaps = np.linalg.norm(both - way.targets[:, None], axis=2)
        assert gaps.min(axis=1).max() < 14.0, "it looks where nobody is"
        first = np.linalg.norm(way.targets[:200] - places[:200].mean(axis=1), axis=1)
        assert first.max() < 14.0, "of two groups of one size it is the first one's"
        last = np.linalg.norm(way.targets[500:] - behind[500:].mean(axis=1), axis=1)
        assert last.max() < 14.0
        assert (np.linalg.norm(np.diff(way.targets, axis=0), axis=1) > 20.0).sum() == 1


def test_roadside_stands_still_for_a_short_shot_and_moves_on_in_a_long_one() -> None:
    short = camera_way("roadside", riding(6.0), 30, 16 / 9)
    assert np.ptp(short.eyes, axis=0).max() < 1e-9
    assert np.ptp(short.targets, axis=0).max() > 20.0
    long = camera_way("roadside", riding(30.0), 30, 16 / 9)
    stations = np.unique(long.eyes.round(6), axis=0)
    assert len(stations) == 3
    distance = np.linalg.norm(long.eyes - riding(30.0).mean(axis=1), axis=1)
    assert distance.min() < 12.0
    assert distance.max() < 75.0
    assert (long.fields[distance > 40.0] < long.fields[distance < 15.0].min()).all(), "it does not zoom in"


def test_roadside_keeps_clear_of_what_stands_there() -> None:
    places = riding(6.0)
    free = camera_way("roadside", places, 30, 16 / 9).eyes[0]
    moved = camera_way("roadside", places, 30, 16 / 9, free[None, :2]).eyes[0]
    assert np.linalg.norm(moved - free) > 3.0


def test_still_shows_what_the_film_shows_however_long_the_run() -> None:
    places = riding(60.0)
    for camera in ("follow", "helicopter"):
        whole = camera_way(camera, places, 30, 16 / 9)
        part = camera_way(camera, places[300:1501], 30, 16 / 9)
        assert np.abs(whole.eyes[850:950] - part.eyes[550:650]).max() < 1e-6


@pytest.mark.parametrize("camera", ROAD_CAMERAS)
def test_one_frame_and_a_group_that_stands_still(camera: Any) -> None:
    for frames in (1, 40):
        way = camera_way(camera, np.tile(np.array([[[3.0, 4.0, 5.0]]]), (frames, 1, 1)), 30, 16 / 9)
        assert np.isfinite(way.eyes).all()
        assert (np.linalg.norm(way.eyes - way.targets, axis=1) > 1.0).all()


def test_trees_in_the_line_of_sight_are_noticed() -> None:
    tree = Blockers(np.array([[10.0, 0.0, 0.0]]), np.array([2.0]), np.array([7.0]))
    eye = np.array([30.0, 0.0, 10.0])
    assert tree.hidden(eye, np.array([[0.0, 0.0, 1.0], [0.0, 30.0, 1.0]])) == 0.5
    assert tree.hidden(np.array([30.0, 0.0, 60.0]), np.array([[0.0, 0.0, 1.0]])) == 0.0
    assert tree.hidden(eye, np.array([[20.0, 0.0, 1.0]])) == 0.0


# ---- ground and shadows --------------------------------------------------------------------------------------------
def test_shadows_lie_on_slopes() -> None:
    normal = np.array([0.1, -0.08, 1.0]) / np.linalg.norm([0.1, -0.08, 1.0])
    plane = np.append(normal, normal @ [4.0, 5.0, 6.0])
    points = np.array([[4.0, 5.0, 9.0], [3.0, 5.5, 7.0]])
    flat = flattened(points, np.full(2, 0.01), plane)
    assert np.allclose(flat @ normal - plane[3], 0.01)
    along = points - (flat - 0.01 * normal)
    assert np.allclose(np.cross(along, SUN), 0.0, atol=1e-12)


def test_shadow_planes_are_those_of_the_road(ride: Any, scenery: RoadScenery) -> None:
    places = ride.link_poses[20, :, 0, :3]
    planes = scenery.shadow_planes(places)
    above_plane = (planes[:, :3] * places).sum(axis=1) - planes[:, 3]
    assert np.abs(above_plane).max() < 0.06
    normals = small_course().surfaces.normal(places[:, :2])
    assert np.abs(planes[:, :3] - normals).max() < 0.02


def test_window_depends_on_the_cell_alone_and_ends_out_of_reach(scenery: RoadScenery) -> None:
    cell = scenery.cell((100.0, 10.0, 26.0))
    first, second = scenery.window(cell), scenery.window(cell)
    for one, other in zip(first.surfaces, second.surfaces, strict=True):
        assert np.array_equal(one.points, other.points)
        assert np.array_equal(one.colors, other.colors)
    assert first.surfaces[0].is_opaque
    assert not first.surfaces[1].is_opaque
    assert len(first.surfaces[0].triangles) < 200_000
    assert np.isfinite(first.surfaces[0].points).all()
    assert np.linalg.norm(first.surfaces[0].points, axis=1).max() < 3000.0


def test_bisected_triangles_cover_the_same_ground() -> None:
    rows = np.array([[[0.0, 0.0, 0.0, 1.0], [12.0, 0.0, 1.0, 2.0], [3.0, 5.0, 2.0, 3.0]]])
    small = bisected(rows, 1.0)
    sides = np.linalg.norm(small[:, [1, 2, 0], :3] - small[..., :3], axis=2)
    assert sides.max() <= 1.0

    def area(triangles: np.ndarray) -> float:
        edges = np.diff(triangles[..., :3], axis=1)
        return float(0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum())

    assert area(small) == pytest.approx(area(rows))
    # What is carried along is linear in the place.
    flat = small.reshape(-1, 4)
    weights = np.linalg.solve(np.column_stack([rows[0, :, :2], np.ones(3)]), rows[0, :, 3])
    assert np.allclose(np.column_stack([flat[:, :2], np.ones(len(flat))]) @ weights, flat[:, 3])


@pytest.mark.parametrize(("shape", "size"), [("ellipsoid", (0.1, 0.2, 0.3)), ("capsule", (0.1, 0.3, 0.0))])
def test_coarse_shapes_are_like_the_fine_ones(shape: Any, size: Any) -> None:
    fine = visual_mesh(Visual(shape, size))
    coarse = coarsened(fine)
    assert len(coarse.triangles) < 0.3 * len(fine.triangles)
    assert (coarse.extent[1] > 0.8 * fine.extent[1]).all()
    assert (coarse.extent[1] <= fine.extent[1]).all()


def test_tyres_stay_round_in_every_degree_of_detail() -> None:
    tyre = visual_mesh(Visual("torus", (0.33, 0.015, 0.0)))
    assert len(coarsened(tyre).triangles) == len(tyre.triangles)
