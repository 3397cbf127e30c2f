"""A recording as a page that is sent to somebody: it is whole, it is small, and it moves without a server."""

from __future__ import annotations

import io
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("viser", reason="the page is viser's: install echelon[play]")

from echelon.errors import InputError
from echelon.play.drawing.saved_page import save_page
from echelon.recording import Recording
from tests.export.road_ride import ride_recording
from tests.export.synthetic import on_disk, synthetic_recording


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return on_disk(synthetic_recording(agent_count=6, frame_count=30), tmp_path_factory.mktemp("herd") / "stored")


def test_a_page_of_a_recording(recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = []
    path = save_page(recording, tmp_path / "herd.html", progress=lambda *numbers: done.append(numbers))
    assert done == [(number, 15) for number in range(1, 16)]  # 30 frames at 30 a second, thinned to 15
    assert [entry.name for entry in tmp_path.iterdir()] == ["herd.html"]
    text = path.read_text(encoding="utf-8")
    assert "__VISER_EMBED_DATA__" in text
    assert path.stat().st_size < 2.0e6
    assert capsys.readouterr().out == ""


def test_a_range_of_frames_at_a_rate(recording: Recording, tmp_path: Path) -> None:
    done = []
    save_page(
        recording, tmp_path / "part.html", first=10, last=20, frames_per_second=30, progress=lambda *n: done.append(n)
    )
    assert done[-1] == (10, 10)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("page.txt", {}, r"page\.txt: ends in '\.txt', must end in \.html"),
        ("page.html", {"first": 40}, r"frames 40 to 30: must lie from 0 to 30"),
        ("page.html", {"last": 31}, r"frames 0 to 31: must lie from 0 to 30"),
        ("page.html", {"frames_per_second": 0}, r"frames_per_second = 0: must be at least 1"),
        ("missing/page.html", {}, "does not exist"),
    ],
)
def test_what_cannot_be_saved_is_said_in_a_line(
    recording: Recording, tmp_path: Path, name: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        save_page(recording, tmp_path / name, **options)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_recording_without_frames_is_nothing_to_show(tmp_path: Path) -> None:
    empty = replace(cast("Any", synthetic_recording()), frame_count=0)
    with pytest.raises(InputError, match="has no frames yet, so there is nothing to show"):
        save_page(empty, tmp_path / "page.html")


def test_the_page_opens_from_a_file_and_moves(tmp_path: Path) -> None:
    pytest.importorskip("playwright", reason="drives the page: install echelon[test]")
    from tests.play.browsing import browser  # asks for playwright, which the tests above do without

    # A minute: at its end a page begins anew, and makes all that it draws once more, which takes software seconds.
    made = cast("Any", ride_recording(riders=3, frame_count=1800))
    object.__setattr__(made, "removed", np.zeros((made.frame_count, 3), bool))
    path = save_page(made, tmp_path / "page.html", frames_per_second=5)
    errors: list[str] = []
    requests: list[str] = []
    with browser() as chromium:
        page = chromium.new_page(viewport={"width": 320, "height": 240}, device_scale_factor=0.5)
        page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_selector("canvas", timeout=60_000)
        pictures = [_picture_of(page)]
        end = time.monotonic() + 120.0  # on a machine that is busy with other tests
        while not (_shows_a_meadow(pictures[-1]) and _moved(pictures)) and time.monotonic() < end:
            page.wait_for_timeout(500)
            pictures.append(_picture_of(page))
    assert errors == []
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []
    assert _shows_a_meadow(pictures[-1])
    assert _moved(pictures), "nothing moves"


def _picture_of(page: Any) -> np.ndarray:
    """Without the notice about slow drawing above and the bar with the time below, shape [height, width, 3]."""
    shot = Image.open(io.BytesIO(page.screenshot(timeout=60_000))).convert("RGB")
    picture = np.asarray(shot, dtype=float)
    return picture[round(0.375 * len(picture)) : round(0.79 * len(picture))]


def _shows_a_meadow(picture: np.ndarray) -> bool:
    red, green, _ = picture.mean(axis=(0, 1))
    return bool(np.ptp(picture) > 60.0 and green > red)


def _moved(pictures: list[np.ndarray]) -> bool:
    return len(pictures) > 1 and float(np.abs(pictures[-1] - pictures[-2]).mean()) > 0.02
