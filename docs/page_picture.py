"""Makes a picture of the page of `echelon play`: starts it, rides for a while, and takes a screenshot.

    python docs/page_picture.py border-collie --ride w:4,wa:0.5,w:3 --out docs/images/play-herd.png

Needs Playwright and a Chromium (`pip install 'echelon[test]'`, and Debian's `chromium`). The ride is keys that are
held, each for so many seconds of the world's time.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

SOFTWARE = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenario")
    parser.add_argument("--ride", default="w:5", help="keys and seconds, like w:4,wa:0.5")
    parser.add_argument("--view", default="saddle", choices=("saddle", "follow", "free"))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", default="1280x720")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    with tempfile.TemporaryDirectory() as takes:
        command = [sys.executable, "-m", "echelon", "play", options.scenario, "--no-open", "--port", "0"]
        with subprocess.Popen([*command, "--takes", takes], stderr=subprocess.PIPE, text=True) as server:
            try:
                take_picture(address_of(server), options.ride, options.view, (width, height), options.out)
            finally:
                server.terminate()
                server.communicate(timeout=60)


def address_of(server: subprocess.Popen[str]) -> str:
    """Where the page is, once it is."""
    assert server.stderr is not None
    for line in server.stderr:
        if "http://" in line:
            return line.split()[2]
    raise SystemExit("echelon play did not start")


def take_picture(url: str, ride: str, view: str, size: tuple[int, int], out: Path) -> None:
    chromium = shutil.which("chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=SOFTWARE)
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.goto(url)
        page.wait_for_selector("#echelon[data-connected=true][data-viewer]:not([data-viewer=''])", state="attached")
        page.wait_for_timeout(8_000)  # the world arrives
        page.keyboard.press("t")
        page.wait_for_selector("#echelon[data-riding=true]", state="attached")
        for part in ride.split(","):
            keys, _, seconds = part.partition(":")
            end = time_of(page) + float(seconds)
            for key in keys:
                page.keyboard.down(key)
            page.wait_for_function(f"+document.querySelector('#echelon').dataset.time >= {end}", timeout=120_000)
            for key in keys:
                page.keyboard.up(key)
        page.keyboard.press("p")
        while page.evaluate("document.querySelector('#echelon').dataset.view") != view:
            page.keyboard.press("v")
            page.wait_for_timeout(300)
        page.wait_for_timeout(3_000)
        page.add_style_tag(content="#echelon-paused, .mantine-Notification-root { display: none !important; }")
        page.screenshot(path=out)
        browser.close()
    # A palette is enough for a page, and a third of the size.
    Image.open(out).convert("RGB").quantize(255, dither=Image.Dither.FLOYDSTEINBERG).save(out, optimize=True)


def time_of(page: Page) -> float:
    return float(page.evaluate("document.querySelector('#echelon').dataset.time || 0"))


if __name__ == "__main__":
    main()
