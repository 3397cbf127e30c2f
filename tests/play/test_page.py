"""The overlay in a real browser, with a plain canvas in the place of viser's picture: quick, and all of it ours."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("viser", reason="the page is viser's: install echelon[play]")
playwright = pytest.importorskip("playwright.sync_api", reason="install echelon[test]")

from echelon.play.web import front as front_module  # noqa: E402
from echelon.play.web.front import Front  # noqa: E402
from echelon.play.web.front_page import with_ours  # noqa: E402
from echelon.play.web.messages import (  # noqa: E402
    ChangeView,
    Command,
    Gear,
    Look,
    Pause,
    Play,
    Rate,
    Restart,
    Ride,
    Seek,
    Slow,
)

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine")

CLIENT = """<!doctype html><html><head><title>Viser</title></head><body style="margin:0">
<div id="root"><canvas width="1280" height="720" style="display:block"></canvas></div>
<script>
  const there = document.createElement("div");
  there.id = "echelon-viewer";
  there.dataset.viewer = location.search.slice(1) || "0";
  document.body.append(there);
  window.leaked = [];
  document.addEventListener("keydown", (event) => leaked.push(event.code));
</script></body></html>"""

RIDER = {"speed": 6.5, "gear": 3, "gears": 7, "cadence": 82, "power": 145.0, "steering": 5.0, "gradient": -2.1}
STATE: dict[str, Any] = {
    "frame": 30,
    "time": 83.44,
    "paused": False,
    "rate": 1.0,
    "real_time": 1.0,
    "slow": False,
    "rider": RIDER,
    "herd": {"in_corral": 12, "agents": 105, "fallen": 0},
    "race": None,
    "note": "",
    "ended": False,
}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


class Player:
    """A front, and pages open in front of it, whose console must stay clean."""

    def __init__(self, browser: Any, mode: str) -> None:
        welcome = {"mode": mode, "title": "Border collie", "agents": 105, "seed": 7, "frames": 900, "frame_rate": 30}
        self.front = Front(9, welcome, port=0)
        self.front.start()
        self.complaints: list[str] = []
        self._browser = browser
        self._contexts: list[Any] = []
        self._commands: list[Command] = []
        self.tell()

    def tell(self, **changes: Any) -> None:
        self.front.tell(STATE | changes)

    def open(self, viewer: int = 0, **how: Any) -> Any:
        context = self._browser.new_context(**({"viewport": {"width": 1280, "height": 720}} | how))
        self._contexts.append(context)
        page = context.new_page()
        page.on("console", lambda line: self.complaints.append(line.text) if line.type == "error" else None)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.goto(f"{self.front.url}?{viewer}")
        page.wait_for_selector("#echelon[data-connected=true][data-frame]")
        return page

    def ride(self) -> Any:
        page = self.open()
        page.click("#echelon-take-big")
        page.wait_for_selector("#echelon[data-riding=true]")
        return page

    def hear(self, wanted: Callable[[Command], bool], seconds: float = 5.0) -> Command:
        """The next command of a kind; those before it are gone."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._commands += [command for _, command in self.front.commands()]
            while self._commands:
                command = self._commands.pop(0)
                if wanted(command):
                    return command
            time.sleep(0.01)
        raise AssertionError("the command did not come")

    def hear_ride(self, **parts: Any) -> Ride:
        found = self.hear(lambda it: isinstance(it, Ride) and all(getattr(it, key) == parts[key] for key in parts))
        assert isinstance(found, Ride)
        return found

    def close(self) -> None:
        for context in self._contexts:
            context.close()
        self.front.stop()


@pytest.fixture
def opened(browser: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Player]]:
    monkeypatch.setattr(front_module, "build_page", lambda: with_ours(CLIENT).encode())
    players: list[Player] = []

    def begin(mode: str) -> Player:
        players.append(Player(browser, mode))
        return players[-1]

    yield begin
    complaints = [complaint for player in players for complaint in player.complaints]
    for player in players:
        player.close()
    assert complaints == []


def test_shows_how_it_goes(opened: Callable[[str], Player]) -> None:
    player = opened("herd")
    page = player.open()
    assert page.title() == "Border collie · Echelon"
    assert page.inner_text("#echelon-in-corral") == "12"
    assert page.inner_text("#echelon-time") == "1:23.4"
    assert page.inner_text("#echelon-speed") == "23.4"
    assert page.inner_text("#echelon-pace-text") == "Keeping up"
    player.tell(slow=True, real_time=0.62, frame=31, rider=None)
    page.wait_for_selector("#echelon[data-frame='31'][data-slow=true]")
    assert page.inner_text("#echelon-pace-text") == "Slowed to 62 %"
    assert page.is_hidden("#echelon-dash")
    race = {"place": 3, "of": 17, "gap": None, "distance": 3210.0, "length": 13000.0, "lap": 1, "laps": 1}
    player.tell(race=race, herd=None, paused=True)
    page.wait_for_selector("#echelon[data-place='3'][data-paused=true]")
    assert page.inner_text("#echelon-race").split("\n")[0].replace(" ", "") == "3/17"
    assert page.inner_text("#echelon-gap") == "–"
    assert page.is_visible("#echelon-paused")


def test_keys_ride_and_two_are_held_at_once(opened: Callable[[str], Player]) -> None:
    player = opened("herd")
    page = player.ride()
    page.keyboard.down("w")
    player.hear_ride(pedal=1, steer=0)
    page.keyboard.down("ArrowLeft")
    player.hear_ride(pedal=1, steer=1)
    assert "pressed" in page.get_attribute("#echelon-pad-left", "class")
    page.keyboard.up("w")
    player.hear_ride(pedal=0, steer=1)
    page.keyboard.down("Space")
    player.hear_ride(brake=1)
    page.keyboard.up("ArrowLeft")
    page.keyboard.up("Space")
    player.hear_ride(pedal=0, brake=0, steer=0)
    page.keyboard.press("e")
    assert player.hear(lambda it: isinstance(it, Gear)) == Gear(1)
    page.keyboard.press("l")
    player.hear_ride(lean=True)
    assert page.evaluate("leaked") == []  # nothing reaches viser, whose camera would move


def test_keys_are_released_when_the_window_is_left(opened: Callable[[str], Player]) -> None:
    player = opened("herd")
    page = player.ride()
    page.keyboard.down("w")
    page.keyboard.down("d")
    player.hear_ride(pedal=1, steer=-1)
    page.evaluate("window.dispatchEvent(new Event('blur'))")
    player.hear_ride(pedal=0, steer=0)


def test_what_is_typed_is_not_ridden(opened: Callable[[str], Player]) -> None:
    player = opened("herd")
    page = player.ride()
    page.click("#echelon-director-open")
    page.fill("#echelon-name", "")
    page.type("#echelon-name", "Wade Q. East")
    page.keyboard.press("Enter")
    page.wait_for_selector("#echelon-people-list li.riding:has-text('Wade Q. East (you)')")
    assert player.front.people()[0].name == "Wade Q. East"
    assert not any(
        isinstance(one, Gear | Pause) or (isinstance(one, Ride) and one.pedal) for _, one in player.front.commands()
    )
    page.keyboard.down("w")
    player.hear_ride(pedal=1)


def test_who_watches_does_not_ride_but_flies(opened: Callable[[str], Player]) -> None:
    player = opened("herd")
    page = player.open()
    page.keyboard.press("w")
    assert page.evaluate("leaked") == []
    page.keyboard.press("v")
    page.keyboard.press("v")
    page.wait_for_selector("#echelon[data-view=free]")
    page.keyboard.press("w")
    assert page.evaluate("leaked") == ["KeyW"]
    time.sleep(0.3)
    assert not any(isinstance(one, Ride) for _, one in player.front.commands())


def test_fingers_ride_with_two_at_once(opened: Callable[[str], Player]) -> None:
    player = opened("herd")
    page = player.open(has_touch=True, viewport={"width": 1024, "height": 768})
    page.tap("#echelon-take-big")
    page.wait_for_selector("#echelon[data-riding=true]")
    touch = page.context.new_cdp_session(page)

    def put(*ids: str) -> None:
        boxes = [page.locator(f"#echelon-pad-{name}").bounding_box() for name in ids]
        points = [
            {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2, "id": number}
            for number, box in enumerate(boxes)
        ]
        touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": points})

    put("pedal")
    player.hear_ride(pedal=1)
    put("pedal", "right")
    player.hear_ride(pedal=1, steer=-1)
    assert "pressed" in page.get_attribute("#echelon-pad-pedal", "class")
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    player.hear_ride(pedal=0, steer=0)


def test_dragging_the_picture_looks_around_from_the_saddle(opened: Callable[[str], Player]) -> None:
    player = opened("herd")
    page = player.open()
    page.mouse.move(600, 300)
    page.mouse.down()
    page.mouse.move(700, 340, steps=4)
    page.mouse.up()
    found = player.hear(lambda it: isinstance(it, Look) and it.yaw > 0.44)
    assert isinstance(found, Look)
    assert (found.yaw, found.pitch) == (pytest.approx(0.45), pytest.approx(0.18))
    page.mouse.dblclick(600, 300)
    player.hear(lambda it: it == Look(0, 0))
    page.keyboard.press("v")
    player.hear(lambda it: it == ChangeView("follow"))
    page.mouse.down()
    page.mouse.move(500, 300)
    page.mouse.up()
    time.sleep(0.2)
    assert not any(isinstance(one, Look) for _, one in player.front.commands())


def test_directs(opened: Callable[[str], Player]) -> None:
    player = opened("herd")
    page = player.open()
    page.keyboard.press("p")
    player.hear(lambda it: it == Pause(True))
    page.click("#echelon-director-open")
    page.click("#echelon-slow-4")
    player.hear(lambda it: it == Slow(0.25))
    page.keyboard.press("r")
    page.fill("#echelon-seed", "12")
    page.fill("#echelon-number", "40")
    page.click("#echelon-restart-yes")
    player.hear(lambda it: it == Restart(12, 40))
    page.keyboard.press("h")
    assert page.is_visible("#echelon-help")
    page.keyboard.press("Escape")
    assert page.is_hidden("#echelon-help")


def test_the_handlebars_are_seen_and_passed_on(opened: Callable[[str], Player]) -> None:
    player = opened("herd")
    anna = player.ride()
    ben = player.open(viewer=1)
    assert ben.is_hidden("#echelon-take")
    assert ben.is_disabled("#echelon-pause")
    assert ben.inner_text("#echelon-people-list li.riding").startswith("Guest 1")
    anna.wait_for_selector("#echelon-pass-row:visible")
    anna.click("#echelon-pass")
    ben.wait_for_selector("#echelon[data-riding=true]")
    anna.wait_for_selector("#echelon[data-riding=false]")
    ben.context.close()
    anna.wait_for_selector("#echelon-take-big:visible")
    assert anna.get_attribute("#echelon", "data-people") == "1"


def test_a_world_without_a_bicycle_is_watched(opened: Callable[[str], Player]) -> None:
    player = opened("watch")
    player.tell(rider=None, frame=31)
    page = player.open()
    assert page.is_hidden("#echelon-take-big")
    assert page.is_hidden("#echelon-handlebars")
    assert page.get_attribute("#echelon", "data-view") == "follow"
    page.keyboard.press("p")
    player.hear(lambda it: it == Pause(True))


def test_a_replay_has_a_timeline(opened: Callable[[str], Player]) -> None:
    player = opened("replay")
    player.tell(paused=True, frame=300)
    page = player.open()
    assert page.is_hidden("#echelon-take-big")
    assert page.inner_text("#echelon-frames") == "899"
    page.keyboard.press("Space")
    player.hear(lambda it: it == Play(True))
    page.keyboard.press("ArrowRight")
    player.hear(lambda it: it == Seek(301))
    page.keyboard.press("Shift+ArrowLeft")
    player.hear(lambda it: it == Seek(271))
    page.keyboard.press("End")
    player.hear(lambda it: it == Seek(899))
    box = page.locator("#echelon-seek").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    player.hear(lambda it: isinstance(it, Seek) and 440 <= it.frame <= 460)
    page.select_option("#echelon-rate", "-2")
    player.hear(lambda it: it == Rate(-2))


def test_says_that_echelon_has_stopped(opened: Callable[[str], Player]) -> None:
    player = opened("herd")
    page = player.ride()
    player.front.stop()
    page.wait_for_selector("#echelon-notice:has-text('Echelon has stopped')")
    assert page.get_attribute("#echelon", "data-connected") == "false"
    page.close()
    assert all("ERR_CONNECTION_REFUSED" in complaint for complaint in player.complaints)  # the browser's own words
    player.complaints.clear()
