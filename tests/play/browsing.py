"""`echelon play` as a program of its own, and its page in a headless Chromium, for tests that do what people do."""

from __future__ import annotations

import contextlib
import io
import json
import queue
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, ConsoleMessage, Error, Page, Request, ViewportSize, sync_playwright

# A software renderer: machines that run tests have no display and seldom a GPU.
FLAGS = [
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
SIZE = (640, 360)
COARSE = 0.5  # pixels drawn for a pixel of the page, along either side: a software renderer draws them
START_WITHIN = 300.0  # [s]; whoever comes first compiles the kernels
LOAD_WITHIN = 120.0  # [s]
SOON = 30.0  # [s] for whatever takes a person a moment, on a machine that is busy with other tests


class Play:
    """A running `echelon play`.

    Attributes:
        url: Of its page.
        said: What it has said so far, a line each.
    """

    def __init__(self, *arguments: str | Path) -> None:
        command = [sys.executable, "-m", "echelon", "play", *map(str, arguments), "--no-open", "--port", "0"]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        self.said: list[str] = []
        urls: queue.Queue[str] = queue.Queue()
        self._listening = threading.Thread(target=self._listen, args=(urls,), daemon=True)
        self._listening.start()
        try:
            self.url = urls.get(timeout=START_WITHIN)
        except queue.Empty:
            self.process.kill()
            raise AssertionError(f"echelon play did not start: {self.said}") from None
        assert self.url, f"echelon play ended: {self.said}"

    def _listen(self, urls: queue.Queue[str]) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.said.append(line.strip())
            if found := re.search(r"ride at (http\S+)", line):
                urls.put(found[1])
        urls.put("")

    @property
    def address(self) -> tuple[str, int]:
        """Host and port."""
        parts = urlsplit(self.url)
        assert parts.hostname is not None
        assert parts.port is not None
        return parts.hostname, parts.port

    def status(self, key: str) -> int:
        """A number of /proc/PID/status: "Threads", or "VmRSS" [kB]."""
        text = Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        found = re.search(rf"^{key}:\s+(\d+)", text, re.MULTILINE)
        assert found is not None
        return int(found[1])

    def stop(self) -> int:
        """Ctrl-C; the exit status."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(timeout=SOON)
        finally:
            self.process.kill()
            self._listening.join(timeout=5.0)


class Tab:
    """A page of `echelon play`, as a person has it before them.

    Attributes:
        complaints: Errors on its console, exceptions, and requests that left for another host.
    """

    def __init__(self, browser: Browser, url: str, name: str) -> None:
        self.complaints: list[str] = []
        self._url, self._browser = url, browser
        size: ViewportSize = {"width": SIZE[0], "height": SIZE[1]}
        self._context = browser.new_context(viewport=size, device_scale_factor=COARSE, reduced_motion="reduce")
        self._context.add_init_script(f"localStorage.setItem('echelon-name', '{name}')")
        self.page: Page = self._context.new_page()
        self.page.set_default_timeout(SOON * 1000.0)
        self.page.on("console", self._hear)
        self.page.on("pageerror", lambda error: self.complaints.append(f"exception: {error}"))
        self.page.on("request", self._see_request)
        self.page.goto(url, timeout=LOAD_WITHIN * 1000.0)
        self.arrive()

    def arrive(self) -> None:
        """Until the page is connected and shows a frame."""
        self.wait("data.connected === 'true' && Number(data.frame) >= 0", within=LOAD_WITHIN)

    def reload(self) -> None:
        self.page.reload(timeout=LOAD_WITHIN * 1000.0)
        self.arrive()

    def close(self) -> None:
        self._context.close()

    def _hear(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.complaints.append(f"console: {message.text}")

    def _see_request(self, request: Request) -> None:
        own = (self._url, f"blob:{self._url}", "data:")
        if not request.url.startswith(own):
            self.complaints.append(f"request: {request.url}")

    # ---- what is to be seen ------------------------------------------------------------------------------------------
    def data(self, key: str) -> str:
        """What the overlay mirrors in its data-* attributes, by its name in camel case."""
        return self.page.evaluate(f"document.getElementById('echelon').dataset.{key}")

    def number(self, key: str) -> float:
        return float(self.data(key))

    def numbers(self, *keys: str) -> tuple[float, ...]:
        """Several of them, of one state."""
        data = "const data = document.getElementById('echelon').dataset"
        return tuple(self.page.evaluate(f"() => {{ {data}; return {list(keys)}.map((key) => Number(data[key])); }}"))

    def text(self, name: str) -> str:
        """What is written in an element of the overlay, by the end of its id."""
        return self.page.locator(f"#echelon-{name}").inner_text()

    def wait(self, condition: str, within: float = SOON) -> None:
        """Until something in JavaScript holds, of `data`, the overlay's mirrored state."""
        script = f"() => {{ const data = document.getElementById('echelon')?.dataset ?? {{}}; return {condition}; }}"
        try:
            self.page.wait_for_function(script, timeout=within * 1000.0, polling=30)
        except Error as error:
            seen = self.page.evaluate("({...document.getElementById('echelon')?.dataset})")
            raise AssertionError(f"not within {within:g} s: {condition}; {seen}; {self.complaints}") from error

    def wait_frames(self, frames: int) -> None:
        """Until the world has gone on for so many frames."""
        self.wait(f"Number(data.frame) >= {self.number('frame') + frames}")

    def picture(self) -> np.ndarray:
        """The picture without the overlay, from 0 to 255, shape [height, width, 3]."""
        self.page.evaluate("document.getElementById('echelon').style.visibility = 'hidden'")
        try:
            shot = self.page.screenshot()
        finally:
            self.page.evaluate("document.getElementById('echelon').style.visibility = ''")
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), dtype=np.float64)

    def picture_at_rest(self) -> np.ndarray:
        """The picture of a world that stands still: cameras come to rest, and browsers draw, a moment after."""
        time.sleep(1.0)
        self.page.evaluate("async () => { for (let i = 0; i < 5; i++) await new Promise(requestAnimationFrame); }")
        return self.picture()

    # ---- what is to be done ------------------------------------------------------------------------------------------
    @contextlib.contextmanager
    def holding(self, *keys: str) -> Iterator[None]:
        """With keys held down."""
        for key in keys:
            self.page.keyboard.down(key)
        try:
            yield
        finally:
            for key in keys:
                with contextlib.suppress(Error):  # the page was closed meanwhile
                    self.page.keyboard.up(key)

    def press(self, key: str) -> None:
        self.page.keyboard.press(key)

    def click(self, name: str) -> None:
        """An element of the overlay, by the end of its id."""
        self.page.click(f"#echelon-{name}")

    def take_handlebars(self) -> None:
        if self.data("riding") != "true":
            self.press("t")
            self.wait("data.riding === 'true'")

    def go_on(self) -> None:
        """End a pause, if there is one; a world that waits for its rider goes on by itself."""
        end = time.monotonic() + SOON
        while True:
            with contextlib.suppress(AssertionError):
                self.wait("data.paused === 'false'", within=2.0)
                return
            assert time.monotonic() < end, "it does not go on"
            self.click("pause")

    def stop_riding(self) -> None:
        """Brake until the bicycle stands."""
        with self.holding("s"):
            self.wait("Number(data.speed) === 0")

    def restart(self, seed: int | None = None, number: int | None = None) -> str:
        """Begin anew, through the dialog; the name of the new take."""
        if self.number("frame") < 10:  # a frame that is there in the new world too tells nothing
            self.wait("Number(data.frame) >= 10")
        note = "document.getElementById('echelon-note').textContent"
        before, told = self.number("frame"), json.dumps(self.page.evaluate(note))
        self.press("r")
        if seed is not None:
            self.page.fill("#echelon-seed", str(seed))
        if number is not None:
            self.page.fill("#echelon-number", str(number))
        self.click("restart-yes")
        self.wait(f"{note}.startsWith('recording ') && ({note} !== {told} || Number(data.frame) < {before})")
        return self.text("note").removeprefix("recording ")


def chromium() -> Path:
    """Debian's, or whatever else is installed under such a name; skips the test where there is none."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if (found := shutil.which(name)) is not None:
            return Path(found)
    pytest.skip("no Chromium: install the package chromium to try the page in a browser")


@contextlib.contextmanager
def browser() -> Iterator[Browser]:
    """A headless browser; skips the test where it does not start."""
    program = chromium()
    with sync_playwright() as playwright:
        try:
            launched = playwright.chromium.launch(executable_path=program, args=FLAGS)
        except Error as error:
            pytest.skip(f"{program} does not start: {str(error).splitlines()[0]}")
        yield launched  # ends with the driver: closed by name, one that hangs would be waited for


def frames_in(tab: Tab, seconds: float) -> float:
    """Frames a second by which a tab's world goes on, over so long."""
    first, start = tab.number("frame"), time.monotonic()
    time.sleep(seconds)
    return (tab.number("frame") - first) / (time.monotonic() - start)


def difference(one: np.ndarray, other: np.ndarray) -> float:
    """Between two pictures, on average over all places and colours, from 0 to 255.

    Seen from afar: where drawing is slow, viser draws fewer pixels, and the same picture is less sharp.
    """
    small = (SIZE[0] // 16, SIZE[1] // 16)
    pictures = (Image.fromarray(each.astype(np.uint8)).resize(small, Image.Resampling.BOX) for each in (one, other))
    first, second = (np.asarray(each, dtype=np.float64) for each in pictures)
    return float(np.abs(first - second).mean())


def until(condition: Callable[[], Any], what: str, within: float = SOON) -> None:
    """Wait for something outside of the page."""
    end = time.monotonic() + within
    while not condition():
        assert time.monotonic() < end, f"not within {within:g} s: {what}"
        time.sleep(0.05)
