"""Films, stills and strips: what is in them, where, and that the same run gives the same bytes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image

from echelon.errors import InputError
from echelon.export.camera import FIELD_OF_VIEW, View, fixed_view, following_views
from echelon.export.drawn_bodies import MovingScene
from echelon.export.light import SHADOW_COLOR, SUN, flattened
from echelon.export.mesh_parts import separate_parts
from echelon.export.picture_source import RecordedSource
from echelon.export.pictures import render_film, render_still, render_strip
from echelon.export.renderer import Renderer, RenderingUnavailable
from echelon.export.shapes import fence_mesh, joined, visual_mesh
from echelon.export.usd import write_stage
from echelon.warp_kernels.model import Visual

sys.path.append(str(Path(__file__).parent))  # test files are imported one by one, not as a package
from picture_scene import distinct_colors, record_scene, scene_recording

SIZE = (320, 180)
ABOVE = View(eye=(-4.0, -16.0, 9.0), target=(-4.0, -4.0, 0.0))


@pytest.fixture(scope="module")
def gl() -> None:
    """Skips a test where nothing can be drawn."""
    try:
        Renderer((16, 16), []).close()
    except RenderingUnavailable as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def run() -> Any:
    return scene_recording(agent_count=6, frame_count=40)


def pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def film_frames(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24").astype(int) for frame in container.decode(video=0)]


def projected(view: View, size: tuple[int, int], points: np.ndarray) -> np.ndarray:
    """Column and row of points [..., 3] in a picture, worked out from the view alone, shape [..., 2]."""
    back = np.subtract(view.eye, view.target) / np.linalg.norm(np.subtract(view.eye, view.target))
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    gap = points - np.asarray(view.eye)
    scale = 0.5 * size[1] / np.tan(0.5 * view.field_of_view) / (gap @ -back)
    return np.stack([0.5 * size[0] + scale * (gap @ right), 0.5 * size[1] - scale * (gap @ np.cross(back, right))], -1)


def at(picture: np.ndarray, place: np.ndarray) -> np.ndarray:
    """The pixel at (column, row)."""
    return picture[int(place[1]), int(place[0])]


# ---- what is in a picture ------------------------------------------------------------------------------------------
@pytest.mark.usefixtures("gl")
def test_every_robot_is_where_it_was_in_its_own_colour(run: Any, tmp_path: Path) -> None:
    picture = pixels(render_still(run, tmp_path / "still.png", time=1.0, size=SIZE, camera=ABOVE))
    places = projected(ABOVE, SIZE, run.link_poses[30, :, 0, :3])
    for place, color in zip(places, distinct_colors(6), strict=True):
        seen = at(picture, place) / 255.0
        # Light makes a colour lighter or darker; which of red, green and blue is most and least stays.
        assert np.argmax(seen) == np.argmax(color), f"at {place} {seen} should look like {color}"
        assert seen.max() - seen.min() > 0.25, f"at {place} {seen} is grey, should look like {color}"


@pytest.mark.usefixtures("gl")
def test_ground_is_green_mown_and_darker_in_shadow(run: Any, tmp_path: Path) -> None:
    picture = pixels(render_still(run, tmp_path / "still.png", time=1.0, size=SIZE, camera=ABOVE))
    bodies = run.link_poses[30, :, 0, :3]
    shadows = bodies - bodies[:, 2:] * SUN / SUN[2]
    beside = shadows + [0.0, -0.9, 0.0]
    for shadow, lit in zip(projected(ABOVE, SIZE, shadows), projected(ABOVE, SIZE, beside), strict=True):
        dark, bright = at(picture, shadow), at(picture, lit)
        assert bright[1] > bright[0] > bright[2]
        # Once, however many parts throw their shadow there: twice would leave less than a third.
        assert 0.45 < dark[1] / bright[1] < 0.75, f"shadow {dark} beside {bright}"
    tones = {tuple(color) for color in picture[-20:].reshape(-1, 3).tolist()}
    assert len(tones) > 4, f"the ground shows no pattern: {len(tones)} tones"


@pytest.mark.usefixtures("gl")
def test_overlapping_shadows_darken_once(run: Any) -> None:
    source = RecordedSource(run)
    solid, shadow = MovingScene(source.casts, []).surfaces(run.link_poses[30], np.empty((0, 7)))
    assert np.all(shadow.points[:, 2] > 0.0)
    assert np.all(shadow.points[:, 2] < 0.02)
    assert len(solid.points) == len(shadow.points)
    # On nothing but the black background of an empty scene, a second layer would be lighter.
    with Renderer(SIZE, []) as renderer:
        picture = renderer.draw(ABOVE, [shadow])
    assert picture.max() <= np.ceil(255.0 * (SHADOW_COLOR[:3] * SHADOW_COLOR[3])).max()
    assert picture.max() > 0


@pytest.mark.usefixtures("gl")
def test_overview_shows_all_of_the_field_and_corral_shows_the_corral(run: Any, tmp_path: Path) -> None:
    field = pixels(render_still(run, tmp_path / "field.png", size=SIZE, camera="overview"))
    corral = pixels(render_still(run, tmp_path / "corral.png", size=SIZE, camera="corral"))
    brown = (corral[..., 0] > corral[..., 1]) & (corral[..., 1] > corral[..., 2])
    assert brown.mean() > 0.15
    white = field.min(axis=2) > 150
    columns = np.flatnonzero(white.any(axis=0))
    assert columns[0] < 0.1 * SIZE[0]
    assert columns[-1] > 0.9 * SIZE[0]


@pytest.mark.usefixtures("gl")
def test_far_from_the_origin_looks_the_same(tmp_path: Path) -> None:
    near = scene_recording(4, 3, collie=False, plane=True, center=(0.0, 0.0))
    far = scene_recording(4, 3, collie=False, plane=True, center=(40_000.0, -70_000.0))
    pictures = [
        pixels(render_still(run, tmp_path / f"{index}.png", size=SIZE)) for index, run in enumerate((near, far))
    ]
    different = np.abs(pictures[0] - pictures[1]).max(axis=2) > 40
    assert different.mean() < 0.002


# ---- films ---------------------------------------------------------------------------------------------------------
@pytest.mark.usefixtures("gl")
def test_film_has_the_frames_rate_and_length_that_were_asked_for(run: Any, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    path = render_film(
        run, tmp_path / "run.mp4", size=SIZE, fps=15, start=0.2, seconds=0.8, progress=lambda *step: seen.append(step)
    )
    assert seen == [(done, 12) for done in range(1, 13)]
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height, stream.pix_fmt) == (*SIZE, "yuv420p")
        assert stream.average_rate == 15
        assert stream.duration is not None
        assert stream.time_base is not None
        assert stream.duration * stream.time_base == Fraction(12, 15)
    frames = film_frames(path)
    assert len(frames) == 12
    assert all(np.abs(a - b).max() > 30 for a, b in pairwise(frames)), "nothing moves"


@pytest.mark.usefixtures("gl")
def test_still_shows_what_the_film_shows(run: Any, tmp_path: Path) -> None:
    frames = film_frames(render_film(run, tmp_path / "run.mp4", size=SIZE, seconds=0.5))
    still = pixels(render_still(run, tmp_path / "still.png", time=0.3, size=SIZE))
    assert np.abs(frames[9] - still).mean() < 4.0
    assert np.abs(frames[9].mean(axis=(0, 1)) - still.mean(axis=(0, 1))).max() < 2.0  # BT.709 there and back


@pytest.mark.usefixtures("gl")
def test_whole_film_by_default_ends_with_the_run(run: Any, tmp_path: Path) -> None:
    assert len(film_frames(render_film(run, tmp_path / "run.mp4", size=(64, 36)))) == run.frame_count
    slow = render_film(run, tmp_path / "slow.mp4", size=(64, 36), fps=10, start=1.0, seconds=60.0)
    assert len(film_frames(slow)) == 4


@pytest.mark.usefixtures("gl")
def test_same_run_same_bytes(run: Any, tmp_path: Path) -> None:
    def twice(render: Callable[[Path], Path], suffix: str) -> None:
        first, second = (render(tmp_path / f"{name}{suffix}").read_bytes() for name in "ab")
        assert first == second

    twice(lambda path: render_film(run, path, size=SIZE, seconds=0.3), ".mp4")
    twice(lambda path: render_still(run, path, time=0.5, size=SIZE), ".png")
    twice(lambda path: render_strip(run, path, interval=0.2, count=3, size=SIZE), ".png")


# ---- strips --------------------------------------------------------------------------------------------------------
@pytest.mark.usefixtures("gl")
def test_strip_shows_snapshots_from_one_place(run: Any, tmp_path: Path) -> None:
    path = render_strip(run, tmp_path / "strip.png", interval=0.25, start=0.25, count=4, size=SIZE)
    strip = pixels(path)
    assert strip.shape == (SIZE[1], 4 * SIZE[0] + 3 * 4, 3)
    assert np.all(strip[:, SIZE[0] : SIZE[0] + 4] == 255)
    panels = [strip[:, index * (SIZE[0] + 4) :][:, : SIZE[0]] for index in range(4)]
    for panel in panels[1:]:
        # The same ground behind moving robots.
        assert np.mean(np.abs(panel - panels[0]).max(axis=2) < 8) > 0.8
        assert np.abs(panel - panels[0]).max() > 60
        # Labels differ: each has its own time.
        corner = np.s_[-SIZE[1] // 5 :, : SIZE[0] // 4]
        assert np.abs(panel[corner] - panels[0][corner]).max() > 100


@pytest.mark.usefixtures("gl")
def test_strip_of_many_has_rows_and_stops_at_the_end_of_the_run(run: Any, tmp_path: Path) -> None:
    many = pixels(render_strip(run, tmp_path / "many.png", interval=0.1, count=8, size=(64, 48)))
    assert many.shape == (2 * 48 + 4, 4 * 64 + 3 * 4, 3)
    rest = pixels(render_strip(run, tmp_path / "rest.png", interval=0.5, start=0.3, size=(64, 48)))
    assert rest.shape == (48, 3 * 64 + 2 * 4, 3)  # 0.3, 0.8 and 1.3 s, which is the last frame


# ---- the camera ----------------------------------------------------------------------------------------------------
def wandering(frame_count: int, agent_count: int) -> np.ndarray:
    """A herd that rushes about, one of them away from the rest; places [frames, agents, 2]."""
    rng = np.random.default_rng(3)
    step = rng.normal(size=(frame_count, agent_count, 2)) * 0.15
    drift = np.cumsum(rng.normal(size=(frame_count, 1, 2)) * 0.08, axis=0)
    places = rng.normal(size=(1, agent_count, 2)) * 4.0 + np.cumsum(step, axis=0) + np.cumsum(drift, axis=0) * 0.1
    places[frame_count // 2 :, 0, 0] += 0.15 * np.arange(frame_count - frame_count // 2)
    return places


@pytest.mark.parametrize("aspect", [16 / 9, 1.0, 0.5])
def test_following_never_cuts_a_robot_off(aspect: float) -> None:
    bodies = wandering(300, 12)
    actors = np.array([[[30.0, 10.0]]]) - np.linspace(0.0, 40.0, 300)[:, None, None]
    size = (int(360 * aspect), 360)
    views = following_views(bodies, actors, 30, aspect)
    tightest = np.inf
    for view, places in zip(views, bodies, strict=True):
        for height in (0.0, 1.6):
            spots = projected(view, size, np.column_stack([places, np.full(len(places), height)]))
            assert spots.min() > 0.0
            assert np.all(spots < size)
            tightest = min(tightest, spots[:, 0].min(), (size[0] - spots[:, 0]).min())
    assert tightest < 0.35 * size[0], "the camera stays needlessly far away"


def test_following_is_smooth_and_level() -> None:
    run = scene_recording(16, 240)  # turns a corner from one frame to the next
    views = following_views(run.link_poses[:, :, 0, :2], run.actor_poses[:, :, :2], 30, 16 / 9)
    eyes = np.array([view.eye for view in views])
    acceleration = np.linalg.norm(np.diff(eyes, 2, axis=0), axis=1).max() * 30.0**2
    assert acceleration < 6.0, f"{acceleration:.1f} m/s^2"
    directions = eyes - np.array([view.target for view in views])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.abs(directions - directions[0]).max() < 1e-9
    assert np.all(eyes[:, 2] > 1.0)


def test_view_of_a_frame_does_not_depend_on_what_is_far_away_in_time() -> None:
    bodies, nobody = wandering(300, 5), np.empty((300, 0, 2))
    whole = following_views(bodies, nobody, 30, 16 / 9)
    part = following_views(bodies[40:270], nobody[40:270], 30, 16 / 9)
    for frame in range(130, 180):
        np.testing.assert_allclose(whole[frame].eye, part[frame - 40].eye, rtol=0, atol=1e-9)


def test_actor_is_in_the_picture_while_near_and_let_go_when_far() -> None:
    bodies = np.tile(np.array([[0.0, 0.0], [2.0, 1.0]]), (60, 1, 1))

    def with_actor(x: float) -> tuple[np.ndarray, float]:
        actor = np.tile(np.array([[[x, 0.0]]]), (60, 1, 1))
        view = following_views(bodies, actor, 30, 16 / 9)[30]
        return projected(view, (160, 90), np.array([x, 0.0, 0.9])), float(np.linalg.norm(view.eye))

    near, distance_near = with_actor(10.0)
    assert np.all(near > 0.0)
    assert np.all(near < (160, 90))
    far, distance_far = with_actor(60.0)
    assert not np.all((far > 0.0) & (far < (160, 90)))
    assert distance_far < distance_near


def test_fixed_view_fills_the_picture() -> None:
    places = np.array([[-10.0, 0.0], [10.0, 3.0], [0.0, -6.0]])
    spots = projected(fixed_view(places, 16 / 9), (160, 90), np.column_stack([places, np.full(3, 0.9)]))
    assert spots[:, 0].min() < 25.0
    assert spots[:, 0].max() > 135.0
    assert pytest.approx(np.radians(30.0)) == FIELD_OF_VIEW


# ---- shadows and meshes --------------------------------------------------------------------------------------------
def test_shadow_points_lie_where_the_sun_throws_them() -> None:
    points = np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]])
    flat = flattened(points, np.array([0.01, 0.01]))
    np.testing.assert_allclose(flat[:, 2], 0.01)
    along = points[0] - np.append(flat[0, :2], 0.0)
    np.testing.assert_allclose(np.cross(along, SUN), 0.0, atol=1e-12)
    np.testing.assert_allclose(flat[1, :2], 0.0)


def test_meshes_fall_into_their_pieces() -> None:
    pair = joined([visual_mesh(Visual("box", (0.1, 0.1, 0.1), (x, 0.0, 0.0))) for x in (0.0, 1.0)])
    assert separate_parts(pair).tolist() == [0] * 24 + [1] * 24
    fence = fence_mesh([[0.0, 0.0], [4.0, 0.0]], False, 1.2)
    assert separate_parts(fence).max() + 1 == len(fence.points) // 24


# ---- recordings on disk and stages -----------------------------------------------------------------------------------
@pytest.mark.usefixtures("gl")
def test_recording_on_disk_gives_the_same_film(run: Any, tmp_path: Path) -> None:
    recording = record_scene(run, tmp_path / "run.recording")
    path = render_film(recording, tmp_path / "disk.mp4", size=SIZE, start=0.3, seconds=0.5)
    assert path == tmp_path / "disk.mp4"
    expected = film_frames(render_film(run, tmp_path / "memory.mp4", size=SIZE, start=0.3, seconds=0.5))
    for found, wanted in zip(film_frames(path), expected, strict=True):
        assert np.mean(np.abs(found - wanted).max(axis=2) > 16) < 0.002
    by_path = render_still(recording.path, tmp_path / "path.png", time=0.5, size=SIZE)
    opened = render_still(recording, tmp_path / "opened.png", time=0.5, size=SIZE)
    assert by_path.read_bytes() == opened.read_bytes()


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("representation", ["rig", "skel", "points"])
def test_stage_and_recording_give_the_same_picture(representation: Any, run: Any, tmp_path: Path) -> None:
    stage = write_stage(run, tmp_path / "run.usd", representation)
    recorded = pixels(render_still(run, tmp_path / "recorded.png", time=0.5, size=SIZE))
    staged = pixels(render_still(stage, tmp_path / "staged.png", time=0.5, size=SIZE))
    different = np.abs(staged - recorded).max(axis=2) > 16
    assert different.mean() < 0.002


@pytest.mark.parametrize(
    ("content", "reason"),
    [(None, "no such stage"), ("not a stage", "cannot be opened"), ("#usda 1.0\n", "not a stage that")],
)
def test_what_is_not_a_stage_is_refused(content: str | None, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "other.usda"
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=reason) as caught:
        render_still(path, tmp_path / "still.png")
    assert "\n" not in str(caught.value)
    assert "other.usda" in str(caught.value)


# ---- what is refused -----------------------------------------------------------------------------------------------
def refused(render: Callable[..., Path], name: str, words: str, **arguments: Any) -> Any:
    return pytest.param(render, name, words, arguments, id=f"{render.__name__}-{words.split()[0]}-{arguments}")


@pytest.mark.parametrize(
    ("render", "name", "words", "arguments"),
    [
        refused(render_film, "film.avi", "ends in '.avi', must end in .mp4"),
        refused(render_film, "film", "ends in '', must"),
        refused(render_film, "nowhere/film.mp4", "folder .* does not exist"),
        refused(render_still, "still.mp4", "must end in .png"),
        refused(render_film, "film.mp4", "even numbers", size=(321, 180)),
        refused(render_film, "film.mp4", "size is", size=(0, 0)),
        refused(render_film, "film.mp4", "size is", size=(64.0, 64)),
        refused(render_film, "film.mp4", "size is", size=(1_000_000, 64)),
        refused(render_film, "film.mp4", "size is", size="640x360"),
        refused(render_film, "film.mp4", "fps is", fps=0),
        refused(render_film, "film.mp4", "fps is", fps=float("nan")),
        refused(render_film, "film.mp4", "start is 9.*0 to 1.3", start=9.0),
        refused(render_film, "film.mp4", "start is", start=-1.0),
        refused(render_film, "film.mp4", "seconds is", seconds=0.0),
        refused(render_film, "film.mp4", "camera 'drone' is not one of", camera="drone"),
        refused(render_still, "still.png", "time is nan", time=float("nan")),
        refused(render_still, "still.png", "time is '1'", time="1"),
        refused(render_still, "still.png", "must be above 0", camera=View((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))),
        refused(render_strip, "strip.png", "interval is 0", interval=0.0),
        refused(render_strip, "strip.png", "count is 9, must be from 1 to 3", interval=0.5, count=9),
        refused(render_strip, "strip.png", "count is 0", interval=0.5, count=0),
        refused(render_strip, "strip.png", "count is True", interval=0.5, count=True),
    ],
)
def test_bad_input_is_one_clear_line(
    render: Callable[..., Path], name: str, words: str, arguments: dict[str, Any], run: Any, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=words) as caught:
        render(run, tmp_path / name, **arguments)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_corral_camera_needs_a_corral(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has none"):
        render_still(scene_recording(2, 2, corral=False), tmp_path / "still.png", camera="corral")


@pytest.mark.usefixtures("gl")
def test_failure_half_way_leaves_what_was_there(run: Any, tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    path.write_bytes(b"before")

    def stop(done: int, total: int) -> None:
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_film(run, path, size=SIZE, progress=stop)
    assert path.read_bytes() == b"before"
    assert [file.name for file in tmp_path.iterdir()] == ["film.mp4"]


def test_no_egl_is_one_clear_line_that_says_what_to_install(tmp_path: Path) -> None:
    """In a process of its own, whose libEGL is shown a machine without drivers."""
    code = (
        "import sys; sys.path.append(sys.argv[1])\n"
        "from picture_scene import scene_recording\n"
        "from echelon.export.pictures import render_film\n"
        "from echelon.export.renderer import RenderingUnavailable\n"
        "try:\n    render_film(scene_recording(1, 2), sys.argv[2] + '/film.mp4', size=(64, 64))\n"
        "except RenderingUnavailable as error:\n    print(error)\n"
    )
    without = {**os.environ, "PYOPENGL_PLATFORM": "egl", "__EGL_VENDOR_LIBRARY_FILENAMES": str(tmp_path / "none.json")}
    done = subprocess.run(
        [sys.executable, "-c", code, str(Path(__file__).parent), str(tmp_path)],
        env=without,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert done.stdout.count("\n") == 1, done.stdout + done.stderr
    assert "libegl1" in done.stdout
    assert "libgl1-mesa-dri" in done.stdout
    assert list(tmp_path.iterdir()) == []
