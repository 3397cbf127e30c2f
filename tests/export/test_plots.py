"""The page about a run: that it is there, whole, and shows what happened."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from PIL import Image

from echelon.errors import InputError
from echelon.export.plots import plot_run

sys.path.append(str(Path(__file__).parent))  # test files are imported one by one, not as a package
from picture_scene import EVENT_DTYPE, record_scene, scene_recording


def texts(path: Path) -> str:
    """The words of an .svg whose letters are drawn as glyphs: matplotlib leaves them as comments."""
    return path.read_text()


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_page_is_written_and_the_same_every_time(suffix: str, tmp_path: Path) -> None:
    run = scene_recording(5, 40)
    first = plot_run(run, tmp_path / f"a{suffix}").read_bytes()
    second = plot_run(run, tmp_path / f"b{suffix}").read_bytes()
    assert first == second
    assert len(first) > 10_000
    assert sorted(file.name for file in tmp_path.iterdir()) == [f"a{suffix}", f"b{suffix}"]


def test_page_is_in_the_colours_of_the_agents(tmp_path: Path) -> None:
    run = scene_recording(3, 60)
    page = np.asarray(Image.open(plot_run(run, tmp_path / "page.png")).convert("RGB")).astype(int)
    assert page.shape[1] > page.shape[0] > 1000
    assert np.mean(page.min(axis=2) > 240) > 0.5, "the page is not mostly white"
    for channel in range(3):
        others = np.delete(page, channel, axis=2).max(axis=2)
        found = int(np.sum(page[..., channel] - others > 40))
        assert (found > 100) == (channel in {int(np.argmax(color)) for color in run.casts[0].colors}), found


def test_page_names_its_panels_and_numbers(tmp_path: Path) -> None:
    run = scene_recording(4, 30)
    page = texts(plot_run(run, tmp_path / "page.svg"))
    for words in ("paths from above", "speed", "touchdowns", "nearest neighbour", "in the corral", "collie"):
        assert words in page
    assert "Round the corner" in page
    assert "4 agents" in page
    assert "0 falls" in page
    assert "<!-- fall -->" not in page
    ElementTree.fromstring(page)


def test_recording_on_disk_gives_the_same_page(tmp_path: Path) -> None:
    run = scene_recording(4, 50)
    disk = plot_run(record_scene(run, tmp_path / "run.recording"), tmp_path / "disk.png")
    memory = plot_run(run, tmp_path / "memory.png")
    different = np.abs(_pixels(disk) - _pixels(memory))
    assert np.mean(different.max(axis=2) > 8) < 0.001


def test_open_ground_without_actors_has_a_page_too(tmp_path: Path) -> None:
    page = texts(plot_run(scene_recording(3, 30, plane=True, collie=False), tmp_path / "page.svg"))
    assert "middle of the herd" in page
    assert "in the corral" not in page


def test_falls_are_marked(tmp_path: Path) -> None:
    run = scene_recording(3, 60)
    fall = np.array([(30, 0, 1, run.event_names.index("fall"))], dtype=EVENT_DTYPE)
    page = texts(plot_run(replace(run, events=np.concatenate([run.events, fall])), tmp_path / "page.svg"))
    assert "<!-- fall -->" in page


@pytest.mark.parametrize(("agent_count", "frame_count"), [(1, 1), (40, 10)])
def test_small_runs_have_a_page(agent_count: int, frame_count: int, tmp_path: Path) -> None:
    assert plot_run(scene_recording(agent_count, frame_count), tmp_path / "page.png").stat().st_size > 10_000


def test_nothing_of_matplotlib_changes_for_others(tmp_path: Path) -> None:
    settings, backend_set = dict(matplotlib.rcParams), "matplotlib.pyplot" in sys.modules
    plot_run(scene_recording(2, 5), tmp_path / "page.svg")
    assert dict(matplotlib.rcParams) == settings
    assert ("matplotlib.pyplot" in sys.modules) == backend_set


@pytest.mark.parametrize(
    ("name", "words"), [("page.txt", "must end in .png or .pdf or .svg"), ("nowhere/page.png", "does not exist")]
)
def test_bad_paths_are_one_clear_line(name: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words) as caught:
        plot_run(scene_recording(2, 2), tmp_path / name)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def _pixels(picture: Path) -> np.ndarray:
    """Colours of a picture, shape [rows, columns, 3]."""
    return np.asarray(Image.open(picture).convert("RGB")).astype(int)
