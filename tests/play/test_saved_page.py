"""A recording as a page that is sent to somebody: it is whole, it is small, and it moves without a server."""

from __future__ import annotations

import shutil
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

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
SOFTWARE = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


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


@pytest.mark.skipif(BROWSER is None, reason="no chromium on this computer: on Debian and Ubuntu install chromium")
def test_the_page_opens_from_a_file_and_moves(tmp_path: Path) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="install echelon[test]")
    made = cast("Any", ride_recording(riders=3, frame_count=30))
    object.__setattr__(made, "removed", np.zeros((made.frame_count, 3), bool))
    path = save_page(made, tmp_path / "page.html")
    errors: list[str] = []
    requests: list[str] = []
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=BROWSER, args=SOFTWARE)
        page = browser.new_page(viewport={"width": 320, "height": 240})
        page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_selector("canvas", timeout=60_000)
        pictures = []
        for number in range(12):
            page.wait_for_timeout(1100)
            shot = tmp_path / f"{number}.png"
            page.screenshot(path=shot, timeout=60_000)
            # Below the notice about slow drawing, above the bar with the time.
            picture = np.asarray(Image.open(shot).convert("RGB"), dtype=float)[90:190]
            pictures.append(picture)
            if np.ptp(picture) > 60.0 and number and np.abs(picture - pictures[-2]).mean() > 0.02:
                break
        browser.close()
    assert errors == []
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []
    green = pictures[-1].mean(axis=(0, 1))
    assert green[1] > green[0], "there is no meadow"
    assert np.abs(pictures[-1] - pictures[-2]).mean() > 0.02, "nothing moves"
