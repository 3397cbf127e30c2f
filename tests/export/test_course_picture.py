"""The page about a course."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from echelon.errors import InputError
from echelon.export.course_picture import plot_course
from echelon.terrain.course import Course


def hilly(closed: bool) -> Course:
    t = np.linspace(0.0, 2.0 * np.pi if closed else 4.0, 60, endpoint=False)
    points = np.stack([300.0 * np.cos(t), 200.0 * np.sin(t), 10.0 * np.sin(2.0 * t)], axis=1)
    return Course.from_dict(
        {"name": "hilly", "title": "Over <hills> & far", "closed": closed, "points": points.tolist()}
    )


@pytest.mark.parametrize(("suffix", "closed"), [(".png", True), (".svg", True), (".svg", False)])
def test_page_is_written_and_the_same_every_time(suffix: str, closed: bool, tmp_path: Path) -> None:
    first = plot_course(hilly(closed), tmp_path / f"a{suffix}").read_bytes()
    assert first == plot_course(hilly(closed), tmp_path / f"b{suffix}").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"a{suffix}", f"b{suffix}"]
    if suffix == ".svg":
        text = first.decode()
        assert ("counter-clockwise circuit" in text) == closed
        assert ("finish" in text.replace("start and finish", "")) != closed


def test_page_shows_climbs_red_and_descents_blue(tmp_path: Path) -> None:
    picture = np.asarray(Image.open(plot_course(hilly(True), tmp_path / "a.png")).convert("RGB"), dtype=int)
    red, green, blue = picture.transpose(2, 0, 1)
    assert ((red > green + 60) & (red > blue + 60)).sum() > 1000
    assert ((blue > red + 60) & (blue > green)).sum() > 1000


def test_a_level_course_can_be_drawn(tmp_path: Path) -> None:
    flat = Course.from_dict(
        {"name": "flat", "points": [[0, 0, 0], [400, 0, 0], [400, 300, 0], [0, 300, 0]], "width": 6}
    )
    assert plot_course(flat, tmp_path / "flat.png").is_file()


def test_wrong_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must end in"):
        plot_course(hilly(True), tmp_path / "a.bmp")
