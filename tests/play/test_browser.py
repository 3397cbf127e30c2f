"""`echelon play` as people meet it: its page in a real browser, keys pressed, buttons clicked, tabs closed.

One program and one browser for the whole file: a page takes seconds to load where it is drawn in software. So tests
share a tab, and each brings about what it needs.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("playwright", reason="drives the page: install echelon[test]")
pytest.importorskip("viser", reason="the page is viser's: install echelon[play]")

from playwright.sync_api import Browser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from echelon.flocking.person import CONTROLS
from echelon.recording import Recording
from tests.play.browsing import SOON, Play, Tab, browser, difference, frames_in, until

# Five robots that stay where they are until somebody comes: one before the mouth of the corral, two on either side.
# Whoever rides straight ahead drives the one in, and does not turn the herd round before it is inside.
SCENARIO = """
title = "Five robots before a corral"
seconds = 60.0

[crowd]
character = "hopper"
positions = [[18.0, 0.0], [17.0, 9.0], [17.0, -9.0], [15.0, 7.0], [15.0, -7.0]]

[herd]
wander = false
visibility = 4.0
flee_distance = 11.0

[world]
ground = "oval"

[world.corral]
center = [25.0, 0.0]
size = 10.0
opening = 8.0
facing = [-1.0, 0.0]

[collie]
start = [4.0, 0.0]
"""
TOLD_EVERY = 2  # frames between two states that a page is told


@dataclass
class Ride:
    """A ride that is over: its take, and what the page showed meanwhile."""

    take: Path
    shown: list[tuple[int, int]]  # (frame, robots in the corral)


class Stage:
    """A browser, a program and a tab, each from when it is first asked for, or asked for after it has ended."""

    def __init__(self, factory: pytest.TempPathFactory) -> None:
        self._factory, self._open = factory, contextlib.ExitStack()
        self._play: Play | None = None
        self._tab: Tab | None = None

    def clear(self) -> None:
        """End it all; what is asked for next is new."""
        for name in ("takes", "browser", "drive"):
            self.__dict__.pop(name, None)
        self._play = self._tab = None
        self._open.close()

    @cached_property
    def takes(self) -> Path:
        return self._factory.mktemp("takes")

    @cached_property
    def browser(self) -> Browser:
        return self._open.enter_context(browser())

    @property
    def play(self) -> Play:
        if self._play is None or self._play.process.poll() is not None:
            _ = self.browser  # without one there is nothing to be tried
            scenario = self.takes / "pen.toml"
            scenario.write_text(SCENARIO, encoding="utf-8")
            self._play = Play(scenario, "--takes", self.takes)
            self._open.callback(self._play.stop)
        return self._play

    @property
    def tab(self) -> Tab:
        if self._tab is None or self._tab.page.is_closed():
            self._tab = Tab(self.browser, self.play.url, "Ada")
        return self._tab

    @cached_property
    def drive(self) -> Ride:
        """A robot is driven in, straight ahead."""
        self.tab.take_handlebars()
        take, shown = self.takes / self.tab.restart(), []
        end = time.monotonic() + SOON
        with self.tab.holding("w"):
            while not (shown and shown[-1][1]) and time.monotonic() < end:
                frame, count = self.tab.numbers("frame", "inCorral")
                shown.append((int(frame), int(count)))
                time.sleep(0.1)
        self.tab.restart()
        return Ride(take, shown)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    stage = Stage(tmp_path_factory)
    yield stage
    stage.clear()


@pytest.fixture
def stage(request: pytest.FixtureRequest, shared: Stage) -> Stage:
    """That of the test before, but a new one for a test that is tried again."""
    if getattr(request.node, "execution_count", 1) > 1:
        shared.clear()
    return shared


@pytest.fixture
def chromium(stage: Stage) -> Browser:
    return stage.browser


@pytest.fixture
def play(stage: Stage) -> Play:
    return stage.play


@pytest.fixture
def takes(stage: Stage) -> Path:
    return stage.takes


@pytest.fixture
def only_tab(stage: Stage) -> Tab:
    return stage.tab


@pytest.fixture
def drive(stage: Stage) -> Ride:
    return stage.drive


@pytest.fixture
def rider(only_tab: Tab) -> Iterator[Tab]:
    """Who holds the handlebars, and rides on in the world as the test before left it.

    Whoever is to get up to speed restarts: meanwhile they may have come up against a fence.
    """
    only_tab.take_handlebars()
    only_tab.go_on()
    yield only_tab
    assert only_tab.complaints == []


# ---- the page --------------------------------------------------------------------------------------------------------
def test_the_page_loads_and_shows_the_world(only_tab: Tab) -> None:
    assert only_tab.page.title() == "Five robots before a corral · Echelon"
    assert only_tab.text("crowd") == "5 robots · seed 1"
    assert only_tab.data("mode") == "herd"
    assert only_tab.page.locator("#echelon-people-list li").all_inner_texts() == ["Ada (you)\nwatches"]
    picture = only_tab.picture()
    sky, grass = picture[: len(picture) // 4].mean(axis=(0, 1)), picture[-len(picture) // 4 :].mean(axis=(0, 1))
    assert sky[2] > sky[1] > sky[0]
    assert grass[1] > max(grass[0], grass[2])
    assert only_tab.complaints == []


def test_nothing_goes_on_before_somebody_rides(only_tab: Tab) -> None:
    if only_tab.data("riding") == "true":
        only_tab.press("t")
        only_tab.wait("data.rider === ''")
        only_tab.press("r")
        only_tab.click("restart-yes")
    only_tab.wait("data.frame === '0' && data.paused === 'true'")
    time.sleep(0.5)
    assert only_tab.data("frame") == "0"
    only_tab.click("take-big")
    only_tab.wait("data.riding === 'true' && Number(data.frame) > 5")


# ---- riding ----------------------------------------------------------------------------------------------------------
def test_keys_move_the_avatar(rider: Tab, takes: Path) -> None:
    take = takes / rider.restart()
    steering = "document.getElementById('echelon-steering').ariaLabel"
    with rider.holding("w"):
        assert "pressed" in (rider.page.get_attribute("#echelon-pad-pedal", "class") or "")
        rider.wait("Number(data.speed) > 1.5")
        with rider.holding("a"):
            rider.wait(f"{steering}.endsWith('left')")
            rider.wait_frames(20)
        with rider.holding("d"):
            rider.wait(f"{steering}.endsWith('right')")
            rider.wait_frames(60)
    rider.wait("data.pedal === '0' && data.steer === '0'")
    coasting = takes / rider.restart()
    with rider.holding("w"):
        rider.wait("Number(data.speed) > 1.5")
    rider.wait("data.pedal === '0'")
    rider.wait_frames(25)
    with rider.holding("s"):
        rider.wait("Number(data.speed) === 0")
    rider.restart()
    way = np.asarray(Recording(take).actor_poses[:, 0], dtype=np.float64)
    heading = np.unwrap(2.0 * np.arctan2(way[:, 5], way[:, 6]))
    assert heading.max() > heading[0] + 0.1, "A turns to the left"
    assert heading[-1] < heading.max() - 0.1, "D turns to the right"
    assert np.linalg.norm(way[-1, :2] - way[0, :2]) > 3.0
    ridden = Recording(coasting)
    released = np.flatnonzero(ridden.controls[:][:, CONTROLS.index("effort")])[-1]
    steps = np.diff(np.asarray(ridden.actor_poses[:, 0, :2], dtype=np.float64), axis=0)
    speed = np.linalg.norm(steps[released + 2 : released + 20], axis=1) * ridden.frame_rate
    assert np.all(np.diff(speed) < 0.0), "who stops pedalling slows"
    assert speed[-1] > 0.5 * speed[0], "and does not stop at once"


def test_pads_move_it_too_and_gears_shift(rider: Tab) -> None:
    rider.restart()
    rider.stop_riding()
    gear = int(rider.number("gear"))
    rider.click("pad-gear-up")
    rider.wait(f"data.gear === '{gear + 1}'")
    rider.press("q")
    rider.wait(f"data.gear === '{gear}'")
    pedal = rider.page.locator("#echelon-pad-pedal").bounding_box()
    assert pedal is not None
    rider.page.mouse.move(pedal["x"] + pedal["width"] / 2, pedal["y"] + pedal["height"] / 2)
    rider.page.mouse.down()
    rider.wait("Number(data.speed) > 0.5")
    rider.page.mouse.up()
    rider.wait("data.pedal === '0'")


def test_who_drags_the_picture_looks_elsewhere(rider: Tab) -> None:
    rider.press("p")
    rider.wait("data.paused === 'true'")
    ahead = rider.picture_at_rest()
    place = rider.page.locator("#echelon-paused").bounding_box()
    assert place is not None
    x, y = place["x"] + 5.0, place["y"] + 5.0  # what only tells something is not in the way
    rider.page.mouse.move(x, y)
    rider.page.mouse.down()
    rider.page.mouse.move(x + 150.0, y, steps=4)
    rider.page.mouse.up()
    until(lambda: difference(rider.picture(), ahead) > 3.0, "another picture to look at")
    rider.press("c")
    until(lambda: difference(rider.picture(), ahead) < 2.0, "the same as before")
    rider.press("p")
    rider.wait("data.paused === 'false'")


def test_keys_are_felt_soon(rider: Tab) -> None:
    """A loose bound for machines that are busy with other tests; alone it is less than a tenth of a second."""
    rider.restart()
    watch = """() => {
        const overlay = document.getElementById("echelon");
        let pressed = null; // the message about a key leaves while the key is handled
        window.felt = new Promise((resolve, reject) => {
            const observer = new MutationObserver(() => {
                if (pressed === null && overlay.dataset.pedal === "1") pressed = performance.now();
                if (pressed === null || Number(overlay.dataset.speed) === 0) return;
                observer.disconnect();
                resolve(performance.now() - pressed);
            });
            observer.observe(overlay, { attributeFilter: ["data-pedal", "data-speed"] });
            setTimeout(() => reject(new Error("the key was not felt")), 20000);
        });
    }"""

    def felt() -> float:
        rider.stop_riding()
        rider.page.evaluate(watch)
        with rider.holding("w"):
            return rider.page.evaluate("window.felt")

    until(lambda: statistics.median(felt() for _ in range(5)) < 400.0, "a key is felt", within=3.0 * SOON)


# ---- the herd --------------------------------------------------------------------------------------------------------
def test_a_robot_is_driven_into_the_corral(drive: Ride) -> None:
    assert drive.shown[0][1] == 0
    assert drive.shown[-1][1] == 1


def test_the_herd_flees(drive: Ride) -> None:
    recording = Recording(drive.take)
    places = np.asarray(recording.link_poses[:, :, 0, :2], dtype=np.float64)
    rider = np.asarray(recording.actor_poses[:, 0, :2], dtype=np.float64)
    gap = np.linalg.norm(places.mean(axis=1) - rider, axis=1)
    near = int(np.argmax(gap < 11.0))
    assert near > 0, "nobody fled from the start"
    assert np.linalg.norm(places[near, 0] - places[0, 0]) < 0.3, "who saw nobody stayed"
    moved = places[-1] - places[near]
    together, strays = [0, 3, 4], [1, 2]
    assert np.all(moved[together, 0] > 1.5), "they run away from whoever comes from behind"
    assert np.all(np.abs(places[-1, strays, 1]) < np.abs(places[near, strays, 1]) - 1.0), "strays join them first"
    assert np.all(moved[:, 0] > -0.1), "nobody comes back"


def test_what_the_page_showed_is_what_was_recorded(drive: Ride) -> None:
    recording = Recording(drive.take)
    for frame, count in drive.shown:
        assert recording.in_corral[frame] == count


def test_a_take_is_simulated_again_to_the_same_bytes(drive: Ride, tmp_path: Path) -> None:
    again = tmp_path / "again.recording"
    command = [sys.executable, "-m", "echelon", "simulate", str(drive.take), "--recording", str(again), "--quiet"]
    subprocess.run(command, check=True, timeout=SOON)
    assert _files(again) == _files(drive.take)


def _files(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


# ---- directing -------------------------------------------------------------------------------------------------------
def test_pause_pauses(rider: Tab) -> None:
    rider.press("p")
    rider.wait("data.paused === 'true'")
    assert rider.page.is_visible("#echelon-paused")
    frame = rider.data("frame")
    with rider.holding("w"):
        time.sleep(0.7)
    assert rider.data("frame") == frame
    rider.click("pause")
    rider.wait("data.paused === 'false'")
    rider.wait_frames(10)


def test_slow_motion_is_slow(rider: Tab) -> None:
    rider.click("director-open")
    rider.click("slow-10")
    rider.wait("data.rate === '0.1'")
    slow = frames_in(rider, 3.0)
    rider.click("slow-1")
    rider.wait("data.rate === '1'")
    rider.click("director-open")
    assert 0.0 < slow < 4.5, "3 frames a second, and what is told between two looks"
    until(lambda: frames_in(rider, 1.5) > 2.0 * slow, "as fast as before")


def test_restart_with_another_seed_and_number(rider: Tab) -> None:
    rider.wait_frames(40)
    rider.restart(seed=77, number=7)
    rider.wait("document.getElementById('echelon-crowd').textContent === '7 robots · seed 77'")
    rider.wait_frames(5)
    assert rider.text("agents") == "7"
    rider.restart(seed=1, number=5)


# ---- several people --------------------------------------------------------------------------------------------------
def test_two_people_see_the_same_and_one_rides(rider: Tab, chromium: Browser, play: Play) -> None:
    rider.restart()
    other = Tab(chromium, play.url, "Bob")
    try:
        assert other.data("people") == "2"
        assert other.data("rider") == rider.data("you")

        # The same frame at the same time: as near as two looks one after the other, and two tellings, can be.
        def apart() -> float:
            before = rider.number("frame")
            seen = other.number("frame")
            after = rider.number("frame")
            return max(before - seen, seen - after, 0.0)

        until(lambda: statistics.median(apart() for _ in range(5)) <= 3 * TOLD_EVERY, "the same frame")
        for tab in (rider, other):
            tab.page.evaluate("document.getElementById('echelon-view-follow').click()")
            tab.wait("data.view === 'follow'")
        with rider.holding("w", "a"):
            rider.wait("Number(data.speed) > 1")
        rider.press("p")
        for tab in (rider, other):
            tab.wait("data.paused === 'true'")
        assert other.data("frame") == rider.data("frame")
        until(lambda: difference(rider.picture(), other.picture()) < 2.0, "the same picture")
        rider.press("p")
        rider.wait("data.paused === 'false'")
        # Who does not hold the handlebars neither rides nor directs.
        rider.stop_riding()
        with other.holding("w"):
            time.sleep(0.7)
        assert other.page.is_disabled("#echelon-pause")
        assert rider.number("speed") == 0.0
        # They are passed on.
        rider.page.select_option("#echelon-pass-to", other.data("you"))
        rider.click("pass")
        other.wait("data.riding === 'true'")
        rider.wait("data.riding === 'false'")
        other.page.bring_to_front()
        with other.holding("w"):
            rider.wait("Number(data.speed) > 1")
            # A tab that is closed lets go.
            people = other.complaints
            other.close()
        rider.wait("data.people === '1' && data.rider === ''")
        fastest = rider.number("speed")
        rider.wait_frames(30)
        assert rider.number("speed") < fastest + 0.2, "nobody pedals on"
        assert people == []
    finally:
        other.close()
        rider.page.evaluate("document.getElementById('echelon-view-saddle').click()")


def test_who_reloads_their_tab_lets_go_and_comes_back(rider: Tab) -> None:
    rider.restart()
    before = rider.data("you")
    with rider.holding("w"):
        rider.wait("Number(data.speed) > 1")
        rider.reload()
    rider.wait(f"data.people === '1' && data.rider === '' && data.you !== '{before}'")
    fastest = rider.number("speed")
    rider.wait_frames(30)
    assert rider.number("speed") < fastest + 0.2, "nobody pedals on"
    rider.take_handlebars()
    with rider.holding("w"):
        rider.wait(f"Number(data.speed) > {rider.number('speed')}")


def test_people_who_come_and_go_leave_the_server_well(rider: Tab, play: Play) -> None:
    def visit(number: int) -> None:
        with _page_of(play) as link, _picture_of(play) as picture:
            picture.sendall(_HANDSHAKE % b"/")
            _greet(link, 1000 + number)
            assert picture.recv(4096).startswith(b"HTTP/1.1 101")

    for number in range(3):
        visit(number)
    rider.wait("data.people === '1'")
    threads, memory = play.status("Threads"), play.status("VmRSS")
    for number in range(20):
        visit(number)
    rider.wait("data.people === '1'")
    until(lambda: play.status("Threads") <= threads, "threads of people who are gone end")
    assert play.status("VmRSS") < memory + 50_000
    rider.wait_frames(10)


# ---- people who mean ill ---------------------------------------------------------------------------------------------
_HANDSHAKE = (
    b"GET %s HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
    b"Sec-WebSocket-Protocol: viser-v1.1.1\r\n\r\n"
)


@contextlib.contextmanager
def _page_of(play: Play) -> Iterator[Connection]:
    """What a page says and hears, without the page."""
    host, port = play.address
    with connect(f"ws://{host}:{port}/ride", close_timeout=1.0) as link:
        yield link


@contextlib.contextmanager
def _picture_of(play: Play) -> Iterator[socket.socket]:
    """A connection on which nothing is read but what the test reads."""
    with socket.socket() as link:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link.settimeout(SOON)
        link.connect(play.address)
        yield link


def _greet(link: Connection, viewer: int) -> None:
    link.send(json.dumps({"kind": "hello", "viewer": viewer, "name": "Mallory"}))
    assert json.loads(link.recv(timeout=SOON))["kind"] == "welcome"


def _ended(link: Connection) -> int:
    """The code with which the server ended it."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            link.recv(timeout=SOON)
    assert link.close_code is not None
    return link.close_code


def test_who_sends_nonsense_is_dropped_and_disturbs_nobody(rider: Tab, play: Play) -> None:
    pace = frames_in(rider, 1.5)
    first, start = rider.number("frame"), time.monotonic()
    take = json.dumps({"kind": "take"})
    bad = (
        "no JSON",
        '{"kind":',
        '{"kind": "ride", "pedal": 1e999, "brake": 0, "steer": 0, "lean": false}',
        '{"kind": "seek"}',
        '{"kind": "restart", "seed": -1, "agents": 1e9}',
        "[" * 1500,
        json.dumps({"kind": "hello", "viewer": 2000, "name": "x" * 3000}),
    )
    for number, text in enumerate(bad):
        with _page_of(play) as link:
            _greet(link, 2000 + number)
            link.send(text)
            assert _ended(link) in (1008, 1009), text[:40]
    with _page_of(play) as link:
        _greet(link, 3000)
        link.send(b"\x00\x01")
        assert _ended(link) == 1003
    with _page_of(play) as link:
        _greet(link, 3001)
        with contextlib.suppress(ConnectionClosed):
            for _ in range(5000):
                link.send(take)
        assert _ended(link) == 1008
    passed = (rider.number("frame") - first) / (time.monotonic() - start)
    assert rider.data("riding") == "true"
    assert passed > 0.2 * pace
    until(lambda: frames_in(rider, 1.5) > 0.5 * pace, "as fast as before")
    rider.wait("data.people === '1'")


def test_who_stops_reading_holds_up_nobody(rider: Tab, play: Play) -> None:
    rider.restart()
    pace, memory = frames_in(rider, 1.5), play.status("VmRSS")
    with contextlib.ExitStack() as stack:
        for number in range(4):
            ride, picture = stack.enter_context(_picture_of(play)), stack.enter_context(_picture_of(play))
            ride.sendall(_HANDSHAKE % b"/ride")
            ride.sendall(_masked(json.dumps({"kind": "hello", "viewer": 4000 + number, "name": "Mallory"})))
            picture.sendall(_HANDSHAKE % b"/")
        rider.wait("data.people === '5'")
        until(lambda: frames_in(rider, 3.0) > 0.5 * pace, "as fast as before")
        with rider.holding("w"):
            rider.wait("Number(data.speed) > 0.5")
        assert play.status("VmRSS") < memory + 100_000
    rider.wait("data.people === '1'")


def _masked(text: str) -> bytes:
    """A frame as a browser sends it (RFC 6455, section 5.2), with a mask of zeros; at most 125 bytes."""
    data = text.encode()
    assert len(data) <= 125
    return bytes([0x81, 0x80 | len(data), 0, 0, 0, 0]) + data


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/etc/passwd", 404),
        ("GET", "/../../etc/passwd", 404),
        ("GET", "/%2e%2e/%2e%2e/etc/passwd", 404),
        ("GET", "/assets/index.js", 404),
        ("GET", "/index.html", 404),
        ("GET", "/ride", 404),
        ("POST", "/", 405),
        ("PUT", "/ride", 405),
        ("HEAD", "/", 200),
    ],
)
def test_nothing_is_served_but_the_page(play: Play, method: str, path: str, status: int) -> None:
    link = http.client.HTTPConnection(*play.address, timeout=SOON)
    link.putrequest(method, path, skip_accept_encoding=True)
    link.endheaders()
    answer = link.getresponse()
    assert answer.status == status
    assert len(answer.read()) < 200
    link.close()


# ---- the end ---------------------------------------------------------------------------------------------------------
def test_the_end_is_told_and_the_take_kept(only_tab: Tab, play: Play, takes: Path) -> None:
    only_tab.take_handlebars()
    take = takes / only_tab.restart()
    only_tab.wait_frames(45)
    assert play.stop() == 0
    assert any(line.startswith(f"take {take}") for line in play.said), play.said
    assert Recording(take).frame_count > 45
    only_tab.page.get_by_text("Echelon has stopped").wait_for()
    only_tab.close()


# ---- replays ---------------------------------------------------------------------------------------------------------
def test_a_replay_goes_where_its_timeline_is_dragged(drive: Ride, chromium: Browser) -> None:
    recording = Recording(drive.take)
    last = recording.frame_count - 1
    play = Play("--replay", drive.take)
    tab = None
    try:
        tab = Tab(chromium, play.url, "Ada")
        assert tab.data("mode") == "replay"
        assert tab.text("frames") == str(last)
        assert not tab.page.is_visible("#echelon-take-big")
        if tab.data("paused") == "false":
            tab.click("play")
            tab.wait("data.paused === 'true'")
        # Scrubbing shows the frame that is asked for.
        _seek(tab, recording, 0)
        start = tab.picture_at_rest()
        _seek(tab, recording, last)
        until(lambda: difference(tab.picture(), start) > 3.0, "another picture at the end")
        _seek(tab, recording, 0)
        until(lambda: difference(tab.picture(), start) < 2.0, "the same picture as before")
        tab.press("ArrowRight")
        tab.wait("data.frame === '1'")
        # It plays, slowly and fast, and stops.
        tab.page.select_option("#echelon-rate", "0.25")
        tab.wait("data.rate === '0.25'")
        tab.press("Space")
        tab.wait(f"data.paused === 'false' && Number(data.frame) > 5 && Number(data.frame) < {last}")
        tab.press("Space")
        tab.wait("data.paused === 'true'")
        frame = tab.data("frame")
        time.sleep(0.5)
        assert tab.data("frame") == frame
        tab.page.select_option("#echelon-rate", "8")
        tab.wait("data.rate === '8'")
        tab.press("Space")
        tab.wait(f"data.ended === 'true' && data.frame === '{last}'")
        assert tab.complaints == []
    finally:
        if tab is not None:
            tab.close()
        assert play.stop() == 0


def _seek(tab: Tab, recording: Recording, frame: int) -> None:
    """Drag the timeline."""
    slide = """([name, frame]) => {
        const slider = document.getElementById(name);
        slider.value = frame;
        slider.dispatchEvent(new Event("input", { bubbles: true }));
    }"""
    tab.page.evaluate(slide, ["echelon-seek", frame])
    tab.wait(f"data.frame === '{frame}'")
    assert tab.number("inCorral") == recording.in_corral[frame]
