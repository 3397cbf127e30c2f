"""The front in front of a viser (real, or one that does as it is told): who comes in, who rides, and who is dropped."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import os
import socket
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from typing import Any

import pytest

viser = pytest.importorskip("viser", reason="the page is viser's: install echelon[play]")
msgspec = pytest.importorskip("msgspec")

from websockets.asyncio.client import ClientConnection, connect  # noqa: E402
from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402
from websockets.typing import Origin  # noqa: E402

from echelon.errors import InputError  # noqa: E402
from echelon.play.web import front as front_module  # noqa: E402
from echelon.play.web import ride_socket, viser_pipe  # noqa: E402
from echelon.play.web.front import Front  # noqa: E402
from echelon.play.web.messages import ChangeView, Command, Gear, LetGo, Look, Pause, Ride, Seek  # noqa: E402

WELCOME = {"mode": "herd", "title": "Border collie", "agents": 105, "seed": 7, "frames": 0, "frame_rate": 30}
RIDE = {"kind": "ride", "pedal": 1, "brake": 0, "steer": 0.5, "lean": False}
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0, 0, 0.0],
    "position": [0.5, 1, 2],
    "image_height": 720,
    "image_width": 1280,
    "fov": 1.2,
    "near": 0.1,
    "far": 1000,
    "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
}


class ObedientViser:
    """A server in viser's place: shakes hands, keeps what it hears, and sends as much as it is told to."""

    def __init__(self, flood: bool = False) -> None:
        self.flood = flood
        self.heads: list[bytes] = []
        self.heard = bytearray()
        self.sent: list[int] = []
        self.connections = 0
        self.port = 0
        self._ready = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        self._ready.wait()

    def _run(self) -> None:
        async def begin() -> None:
            server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
            self.port = server.sockets[0].getsockname()[1]
            self._ready.set()

        self._loop.run_until_complete(begin())
        self._loop.run_forever()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.heads.append(await reader.readuntil(b"\r\n\r\n"))
        writer.write(b"HTTP/1.1 101 Switching Protocols\r\n\r\n")
        self.connections += 1
        mine = len(self.sent)
        self.sent.append(0)
        listening = asyncio.create_task(self._listen(reader))
        with contextlib.suppress(OSError):
            while self.flood and not writer.is_closing():
                writer.write(bytes(65_536))
                await writer.drain()
                self.sent[mine] += 65_536
                await asyncio.sleep(0)
        await listening
        self.connections -= 1
        writer.close()

    async def _listen(self, reader: asyncio.StreamReader) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65_536):
                self.heard += data

    def stop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(timeout=2)


@pytest.fixture
def picture() -> Iterator[ObedientViser]:
    server = ObedientViser()
    yield server
    server.stop()


@pytest.fixture
def front(picture: ObedientViser) -> Iterator[Front]:
    with Front(picture.port, WELCOME, port=0) as server:
        yield server


# ---- somebody who asks ---------------------------------------------------------------------------------------------
def ask(front: Front, request: str, seconds: float = 5.0) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and body of an answer to a raw request ('' where the connection just ends)."""
    with socket.create_connection(("127.0.0.1", front.port), timeout=seconds) as link:
        link.sendall(request.replace("\n", "\r\n").encode("latin-1"))
        answer = b""
        with contextlib.suppress(ConnectionResetError):
            while piece := link.recv(65_536):
                answer += piece
    if not answer:
        return 0, {}, b""
    head, _, body = answer.partition(b"\r\n\r\n")
    first, *lines = head.decode("latin-1").split("\r\n")
    return (
        int(first.split(" ")[1]),
        {name.lower(): value for name, _, value in (line.partition(": ") for line in lines)},
        body,
    )


def get(
    front: Front, path: str = "/", host: str = "", method: str = "GET", more: str = ""
) -> tuple[int, dict[str, str], bytes]:
    return ask(front, f"{method} {path} HTTP/1.1\nHost: {host or f'127.0.0.1:{front.port}'}\n{more}\n")


@contextlib.asynccontextmanager
async def page(front: Front, name: str = "Anna", viewer: int = 0) -> AsyncIterator[ClientConnection]:
    """A page that said hello and was welcomed."""
    async with connect(f"ws://127.0.0.1:{front.port}/ride", compression=None) as link:
        await say(link, {"kind": "hello", "viewer": viewer, "name": name})
        assert (await hear(link, "welcome"))["title"] == WELCOME["title"]
        yield link


async def say(link: ClientConnection, message: Any) -> None:
    await link.send(message if isinstance(message, str | bytes) else json.dumps(message))


async def hear(
    link: ClientConnection, kind: str, until: Callable[[dict[str, Any]], bool] = lambda _: True
) -> dict[str, Any]:
    """The next message of a kind for which something holds."""
    async with asyncio.timeout(5):
        while True:
            message = json.loads(await link.recv())
            if message["kind"] == kind and until(message):
                return message


async def closing(link: ClientConnection, seconds: float = 5.0) -> tuple[int, str]:
    """The code and reason with which a connection ends."""
    async with asyncio.timeout(seconds):
        try:
            while True:
                await link.recv()
        except ConnectionClosed as closed:
            return (closed.rcvd.code, closed.rcvd.reason) if closed.rcvd else (1006, "")


async def wanted(
    front: Front, enough: Callable[[list[tuple[int, Command]]], bool], seconds: float = 5.0
) -> list[tuple[int, Command]]:
    """Commands until there are enough."""
    found: list[tuple[int, Command]] = []
    async with asyncio.timeout(seconds):
        while not enough(found):
            found += front.commands()
            await asyncio.sleep(0.01)
    return found


def run(work: Awaitable[None]) -> None:
    async def bounded() -> None:
        async with asyncio.timeout(20):
            await work

    asyncio.run(bounded())


# ---- the page, and nothing else ------------------------------------------------------------------------------------
def test_serves_the_page_with_ours_inside(front: Front) -> None:
    status, headers, body = get(front)
    text = body.decode()
    assert status == 200
    assert int(headers["content-length"]) == len(body)
    assert text.index('<style id="echelon-style">') < text.index('<script id="echelon-script">') < text.index("</head>")
    assert text.count("</head>") == 1
    assert headers["x-content-type-options"] == "nosniff"
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert f"connect-src ws://127.0.0.1:{front.port} " in policy
    assert "http:" not in policy
    status, headers, empty = get(front, method="HEAD")
    assert (status, empty, int(headers["content-length"])) == (200, b"", len(body))
    assert get(front, "/?darkMode")[0] == 200
    assert front.url == f"http://127.0.0.1:{front.port}/"


@pytest.mark.parametrize(
    "path", ["/index.html", "/ride", "//", "/../pyproject.toml", "/%2e%2e/", "/favicon.ico", "/play.js"]
)
def test_serves_nothing_else(front: Front, path: str) -> None:
    status, headers, body = get(front, path)
    assert status == 404
    assert len(body) < 100
    assert headers["content-type"].startswith("text/plain")


@pytest.mark.parametrize(
    ("request_text", "status"),
    [
        ("POST / HTTP/1.1\nHost: localhost\n\n", 405),
        ("OPTIONS / HTTP/1.1\nHost: localhost\n\n", 405),
        ("GET / HTTP/1.0\nHost: localhost\n\n", 400),
        ("GET http://localhost/ HTTP/1.1\nHost: localhost\n\n", 400),
        ("GET / HTTP/1.1\n\n", 400),
        ("GET / HTTP/1.1\nHost: localhost\nHost: evil.example\n\n", 400),
        ("GET / HTTP/1.1\nHost: local host\n\n", 400),
        ("GET / HTTP/1.1\nHost : localhost\n\n", 400),
        ("GET / HTTP/1.1\nHost: localhost\nContent-Length: 5\n\nhello", 400),
        ("GET / HTTP/1.1\nHost: localhost\nTransfer-Encoding: chunked\n\n", 400),
        ("nonsense\n\n", 400),
        ("\n\n", 400),
        (f"GET / HTTP/1.1\nHost: localhost\nX: {'a' * 20_000}\n\n", 431),
        ("GET / HTTP/1.1\nHost: localhost\n" + "X: a\n" * 200 + "\n", 431),
        ("GET /ride HTTP/1.1\nHost: localhost\nUpgrade: websocket\n\n", 400),
    ],
)
def test_refuses_what_is_no_plain_request(front: Front, request_text: str, status: int) -> None:
    assert ask(front, request_text)[0] in (status, 0)  # 0: too large, and gone before it was read to its end
    assert get(front)[0] == 200


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("localhost:1234", 200),
        ("[::1]", 200),
        ("127.0.0.1", 200),
        ("127.8.8.8:80", 200),
        ("evil.example", 403),
        ("localhost.evil.example", 403),
        ("192.168.0.7:8080", 403),
        ("127.0.0.1.nip.io", 403),
    ],
)
def test_answers_to_its_own_names_only(front: Front, host: str, status: int) -> None:
    assert get(front, host=host)[0] == status


def test_open_to_the_network_answers_to_addresses_and_to_its_names(picture: ObedientViser) -> None:
    with Front(picture.port, WELCOME, host="0.0.0.0", port=0, names=["studio.example"]) as front:
        assert get(front, host="192.168.0.7:8080")[0] == 200
        assert get(front, host="Studio.Example:80")[0] == 200
        assert get(front, host=socket.gethostname())[0] == 200
        assert get(front, host="evil.example")[0] == 403


@pytest.mark.parametrize("path", ["/ride", "/"])
@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:1", "null", "http://localhost", "file://"])
def test_the_page_of_another_origin_does_not_ride(front: Front, picture: ObedientViser, path: str, origin: str) -> None:
    async def try_it() -> None:
        with pytest.raises(InvalidStatus) as caught:
            async with connect(f"ws://127.0.0.1:{front.port}{path}", origin=Origin(origin)):
                pass
        assert caught.value.response.status_code == 403

    run(try_it())
    assert picture.heads == []


def test_our_own_page_comes_in(front: Front) -> None:
    async def try_it() -> None:
        async with connect(
            f"ws://127.0.0.1:{front.port}/ride", origin=Origin(f"http://127.0.0.1:{front.port}")
        ) as link:
            await say(link, {"kind": "hello", "viewer": 0, "name": "Anna"})
            assert (await hear(link, "welcome"))["you"] == 1

    run(try_it())


def test_who_does_not_speak_is_dropped(front: Front, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(front_module, "HEAD_WITHIN", 0.2)
    begun = time.monotonic()
    assert ask(front, "GET / HTTP/1.1\nHost: local") == (0, {}, b"")
    assert time.monotonic() - begun < 3


def test_connections_are_counted(front: Front, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(front_module, "MOST_CONNECTIONS", 1)
    with socket.create_connection(("127.0.0.1", front.port)):
        assert eventually(lambda: get(front)[0] == 503)
    assert eventually(lambda: get(front)[0] == 200)


# ---- who rides -----------------------------------------------------------------------------------------------------
def test_hello_welcome_state(front: Front) -> None:
    async def try_it() -> None:
        front.tell({"frame": 12, "time": 0.4, "rider": {"speed": float("nan")}})
        async with page(front, "Anna", viewer=4) as anna:
            state = await hear(anna, "state")
            assert state["people"] == [{"id": 1, "name": "Anna", "riding": False}]
            assert (state["frame"], state["rider"]) == (12, {"speed": None})
            assert [(one.name, one.viewer) for one in front.people()] == [("Anna", 4)]
            await say(anna, {"kind": "ping", "at": 17.25})
            assert (await hear(anna, "pong"))["at"] == 17.25
            front.welcome = {**WELCOME, "seed": 8}
            assert (await hear(anna, "welcome"))["seed"] == 8

    run(try_it())


def test_one_holds_the_handlebars_and_passes_them_on(front: Front) -> None:
    async def try_it() -> None:
        front.tell({"frame": 0})
        async with page(front, "Anna", 1) as anna, page(front, "Ben", 2) as ben:
            await say(ben, RIDE)  # without the handlebars
            await say(anna, {"kind": "take"})
            await hear(ben, "state", lambda state: state["people"][0]["riding"])
            await say(ben, {"kind": "take"})
            await say(ben, {"kind": "pause", "paused": True})
            await say(ben, {"kind": "look", "yaw": 1, "pitch": 0})
            await say(anna, RIDE)
            await say(anna, {"kind": "gear", "step": 1})
            found = await wanted(front, lambda found: (1, Gear(1)) in found and (2, Look(1, 0)) in found)
            assert (1, Ride(1, 0, 0.5, False)) in found
            assert not any(isinstance(command, Pause) for _, command in found)
            assert not any(who == 2 and isinstance(command, Ride) for who, command in found)
            await say(anna, {"kind": "pass", "to": 2})
            await hear(anna, "state", lambda state: state["people"][-1]["riding"])
            await say(ben, {"kind": "pause", "paused": True})
            found = await wanted(front, lambda found: (2, Pause(True)) in found)
            assert (1, LetGo()) in found
            await say(ben, RIDE)
        await wanted(front, lambda found: (2, LetGo()) in found)
        assert front.people() == ()

    run(try_it())


def test_a_rider_who_falls_silent_lets_go_once_and_may_go_on(front: Front, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(front_module, "SILENCE", 0.2)

    async def try_it() -> None:
        async with page(front) as anna:
            await say(anna, {"kind": "take"})
            await say(anna, RIDE)
            await wanted(front, lambda found: any(isinstance(command, Ride) for _, command in found))
            found = await wanted(front, lambda found: (1, LetGo()) in found)
            await asyncio.sleep(0.5)
            assert front.commands() == []
            assert found[-1] == (1, LetGo())
            assert front.people()[0].riding
            await say(anna, RIDE)
            await wanted(front, lambda found: (1, Ride(1, 0, 0.5, False)) in found)

    run(try_it())


def test_a_replay_is_not_ridden_and_a_world_not_rewound(picture: ObedientViser) -> None:
    async def try_it(mode: str, expected: list[Command]) -> None:
        with Front(picture.port, {**WELCOME, "mode": mode}, port=0) as front:
            async with page(front) as anna:
                await say(anna, {"kind": "seek", "frame": 3})
                await say(anna, {"kind": "pause", "paused": True})
                await say(anna, {"kind": "view", "view": "free"})
                found = await wanted(front, lambda found: any(isinstance(command, ChangeView) for _, command in found))
                assert [command for _, command in found] == [*expected, ChangeView("free")]

    run(try_it("replay", [Seek(3)]))
    run(try_it("race", [Pause(True)]))
    run(try_it("watch", [Pause(True)]))


def test_where_there_is_no_bicycle_nobody_holds_the_handlebars(front: Front) -> None:
    async def try_it() -> None:
        async with page(front) as anna:
            await say(anna, {"kind": "take"})
            await wanted(front, lambda found: (1, LetGo()) in found)
            assert front.people()[0].riding
            front.welcome = {**WELCOME, "mode": "watch"}
            await hear(anna, "welcome")
            assert not front.people()[0].riding
            await say(anna, {"kind": "take"})
            await say(anna, {"kind": "view", "view": "free"})
            await wanted(front, lambda found: (1, ChangeView("free")) in found)
            assert not front.people()[0].riding

    run(try_it())


def test_the_newest_state_at_most_fifteen_times_a_second(front: Front) -> None:
    async def try_it() -> None:
        async with page(front) as anna:
            begun = time.monotonic()
            frames: list[int] = []

            async def count() -> None:
                while True:
                    frames.append((await hear(anna, "state"))["frame"])

            counting = asyncio.create_task(count())
            for frame in range(60):
                front.tell({"frame": frame})
                await asyncio.sleep(1 / 60)
            took = time.monotonic() - begun
            await asyncio.sleep(0.2)
            counting.cancel()
            assert frames == sorted(set(frames))
            assert frames[-1] == 59
            assert 3 <= len(frames) <= 15 * took + 3

    run(try_it())


# ---- who misbehaves ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("message", "code", "words"),
    [
        ("{", 1008, "must be JSON"),
        ({**RIDE, "pedal": 2}, 1008, "pedal = 2, allowed is a number from 0 to 1"),
        ({"kind": "hello", "viewer": 0, "name": "x" * 99}, 1008, "name ="),
        (b"\x00", 1003, "messages are text"),
        ("a" * 2049, 1009, ""),
    ],
)
def test_a_malformed_message_ends_its_sender_alone(front: Front, message: Any, code: int, words: str) -> None:
    async def try_it() -> None:
        async with page(front, "Anna", 1) as anna, page(front, "Ben", 2) as ben:
            await say(ben, message)
            ended, reason = await closing(ben)
            assert ended == code
            assert words in reason
            await say(anna, {"kind": "ping", "at": 1})
            await hear(anna, "pong")
            while len(front.people()) > 1:
                await asyncio.sleep(0.01)
            assert [one.name for one in front.people()] == ["Anna"]

    run(try_it())


def test_a_message_before_hello_ends_it(front: Front) -> None:
    async def try_it() -> None:
        async with connect(f"ws://127.0.0.1:{front.port}/ride") as link:
            await say(link, {"kind": "take"})
            assert await closing(link) == (1008, "message: hello comes first")

    run(try_it())


def test_a_second_page_cannot_be_the_same_viewer(front: Front) -> None:
    async def try_it() -> None:
        async with page(front, "Anna", 1) as anna, connect(f"ws://127.0.0.1:{front.port}/ride") as ben:
            await say(ben, {"kind": "hello", "viewer": 1, "name": "Ben"})
            code, reason = await closing(ben)
            assert (code, "somebody else" in reason) == (1008, True)
            await say(anna, {"kind": "ping", "at": 1})
            await hear(anna, "pong")

    run(try_it())


def test_a_flood_ends_its_sender_alone(front: Front) -> None:
    async def try_it() -> None:
        async with page(front, "Anna", 1) as anna, page(front, "Ben", 2) as ben:
            with contextlib.suppress(ConnectionClosed):
                for _ in range(2000):
                    await say(ben, {"kind": "ping", "at": 0})
            code, reason = await closing(ben)
            assert (code, reason) == (1008, "more than 120 messages a second")
            await say(anna, {"kind": "ping", "at": 1})
            await hear(anna, "pong")

    run(try_it())


def test_an_honest_rider_is_never_taken_for_a_flood(front: Front) -> None:
    async def try_it() -> None:
        async with page(front) as anna:
            for _ in range(90):
                await say(anna, RIDE)
                await asyncio.sleep(0.01)
            await say(anna, {"kind": "ping", "at": 1})
            await hear(anna, "pong")

    run(try_it())


def test_a_page_that_stops_reading_is_dropped_and_nobody_waits(front: Front, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ride_socket, "PATIENCE", 0.6)
    monkeypatch.setattr(ride_socket, "PING_EVERY", 0.1)

    async def try_it() -> None:
        async with page(front, "Anna", 1) as anna, page(front, "Ben", 2) as ben:
            ben.transport.pause_reading()  # a browser that is stuck answers no pings
            begun = time.monotonic()
            longest = 0.0
            while len(front.people()) > 1:
                assert time.monotonic() - begun < 5
                asked = time.monotonic()
                await say(anna, {"kind": "ping", "at": 1})
                await hear(anna, "pong")
                longest = max(longest, time.monotonic() - asked)
                await asyncio.sleep(0.05)
            assert longest < 0.5
            ben.transport.abort()

    run(try_it())


def test_there_is_room_for_so_many(front: Front, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(front_module, "MOST_PEOPLE", 1)

    async def try_it() -> None:
        async with page(front), connect(f"ws://127.0.0.1:{front.port}/ride") as late:
            assert await closing(late) == (1013, "there is room for 1 people")
        while front.people():
            await asyncio.sleep(0.01)
        async with page(front):
            pass

    run(try_it())


# ---- the way to viser ----------------------------------------------------------------------------------------------
def frame(payload: bytes, opcode: int = 2, masked: bool = True) -> bytes:
    """A websocket frame as a browser sends it."""
    size = len(payload)
    length = (
        bytes([size])
        if size < 126
        else b"\x7e" + size.to_bytes(2, "big")
        if size < 65_536
        else b"\x7f" + size.to_bytes(8, "big")
    )
    if not masked:
        return bytes([0x80 | opcode]) + length + payload
    mask = os.urandom(4)
    covered = bytes(byte ^ mask[index % 4] for index, byte in enumerate(payload))
    return bytes([0x80 | opcode, 0x80 | length[0]]) + length[1:] + mask + covered


def browser(front: Front) -> socket.socket:
    """A raw connection to viser's websocket, upgraded."""
    link = socket.create_connection(("127.0.0.1", front.port), timeout=5)
    link.sendall(
        f"GET / HTTP/1.1\r\nHost: localhost:{front.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\nCookie: secret=1\r\n"
        "Sec-WebSocket-Protocol: viser-v1\r\n\r\n".encode()
    )
    assert link.recv(12) == b"HTTP/1.1 101"
    return link


def eventually(holds: Callable[[], bool], seconds: float = 5.0) -> bool:
    end = time.monotonic() + seconds
    while not holds() and time.monotonic() < end:
        time.sleep(0.01)
    return holds()


def test_only_cameras_and_control_frames_reach_viser(front: Front, picture: ObedientViser) -> None:
    camera, ping = frame(msgspec.msgpack.encode(CAMERA)), frame(b"", opcode=9)
    wrong = [
        {"type": "ShareUrlRequest"},
        {**CAMERA, "type": "ShareUrlRequest"},
        {**CAMERA, "more": 1},
        {**CAMERA, "fov": float("nan")},
        {**CAMERA, "position": [0, 0]},
        {"type": "GuiUpdateMessage", "uuid": "x", "updates": {}},
        7,
    ]
    with browser(front) as link:
        for message in wrong:
            link.sendall(frame(msgspec.msgpack.encode(message)))
        link.sendall(frame(b"\xdd\xff\xff\xff\xff") + frame(b"\xc1" * 40) + frame(b"text", opcode=1))
        link.sendall(camera + ping)
        assert eventually(lambda: len(picture.heard) == len(camera) + len(ping))
        assert bytes(picture.heard) == camera + ping
    assert b"Cookie" not in picture.heads[0]
    assert b"Sec-WebSocket-Protocol".lower() + b": viser-v1" in picture.heads[0].lower()
    assert eventually(lambda: picture.connections == 0)


@pytest.mark.parametrize(
    "data",
    [
        frame(b"abc", masked=False),
        frame(bytes(20_000)),
        frame(bytes(70_000)),
        b"\x02\x83" + bytes(7),  # a fragment
        b"\xc2\x83" + bytes(7),  # a reserved bit
        b"\x83\x83" + bytes(7),  # an opcode that there is not
        b"\x89\xfe" + bytes(200),  # a long ping
        b"\x82\xff" + b"\xff" * 8 + bytes(4),  # sixteen exabytes
    ],
)
def test_a_malformed_frame_ends_its_sender_alone(front: Front, picture: ObedientViser, data: bytes) -> None:
    with browser(front) as other, browser(front) as link:
        with contextlib.suppress(OSError):
            link.sendall(data)
        assert eventually(lambda: picture.connections == 1)
        assert picture.heard == b""
        other.sendall(frame(b"", opcode=9))
        assert eventually(lambda: len(picture.heard) == 6)


def test_a_browser_sends_so_much_a_second(front: Front, picture: ObedientViser) -> None:
    camera = frame(msgspec.msgpack.encode(CAMERA))
    with browser(front) as link:
        sending = threading.Thread(target=lambda: link.sendall(camera * (300_000 // len(camera))), daemon=True)
        begun = time.monotonic()
        sending.start()
        assert eventually(lambda: len(picture.heard) > 290_000)
        assert time.monotonic() - begun > 0.4  # the first 200 kB at once, the rest at 200 kB a second


def test_a_browser_that_stops_reading_costs_little_and_nobody_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viser_pipe, "PATIENCE", 1.0)
    picture = ObedientViser(flood=True)
    try:
        with Front(picture.port, WELCOME, port=0) as front, browser(front) as stuck, browser(front) as other:
            received, end = 0, time.monotonic() + 0.7
            while time.monotonic() < end:
                received += len(other.recv(65_536))
            held = picture.sent[0]
            assert held < 16e6  # what kernels hold for three sockets, and our quarter of a megabyte
            assert received > held
            stuck.settimeout(0.1)
            # dropped: viser's side of the stuck connection is gone while the other's goes on
            deadline = time.monotonic() + 5
            while picture.connections > 1 and time.monotonic() < deadline:
                other.recv(65_536)
            assert picture.connections == 1
            assert other.recv(1)
    finally:
        picture.stop()


def test_without_a_picture_it_says_so(picture: ObedientViser) -> None:
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        port = nobody.getsockname()[1]
    with Front(port, WELCOME, port=0) as front:
        assert get(front, more="Upgrade: websocket\nConnection: Upgrade\n")[0] == 502
        assert get(front)[0] == 200


def test_knows_the_camera_message_of_this_viser() -> None:
    theirs = {field.name for field in dataclasses.fields(viser._messages.ViewerCameraMessage)}
    assert theirs == set(viser_pipe.CameraMessage.__struct_fields__) - {"type"}


def test_a_real_viser_is_reached(capsys: pytest.CaptureFixture[str]) -> None:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    arrived = threading.Event()
    server.on_client_connect(lambda _: arrived.set())

    async def try_it(front: Front) -> None:
        protocol: Any = f"viser-v{viser.__version__}"
        origin = Origin(f"http://127.0.0.1:{front.port}")
        async with connect(
            f"ws://127.0.0.1:{front.port}/", subprotocols=[protocol], origin=origin, max_size=None
        ) as link:
            assert isinstance(await link.recv(), bytes)
            await link.send(msgspec.msgpack.encode({"type": "ShareUrlRequest"}))
            await link.send(msgspec.msgpack.encode(CAMERA))
            async with asyncio.timeout(5):
                while not arrived.is_set():
                    await asyncio.sleep(0.01)

    try:
        with Front(server.get_port(), WELCOME, port=0) as front:
            run(try_it(front))
        assert len(server.get_clients()) <= 1
    finally:
        server.stop()
    assert "share" not in capsys.readouterr().out.lower()


# ---- beginning and end ---------------------------------------------------------------------------------------------
def test_takes_the_next_free_port(front: Front, picture: ObedientViser) -> None:
    with Front(picture.port, WELCOME, port=front.port) as second:
        assert second.port > front.port
        assert get(second)[0] == 200


def test_an_address_that_is_not_ours_is_bad_input(picture: ObedientViser) -> None:
    with pytest.raises(InputError, match=r"--host 192\.0\.2\.1 --port 8080: cannot listen there"):
        Front(picture.port, WELCOME, host="192.0.2.1").start()


def test_stopping_says_goodbye(picture: ObedientViser) -> None:
    front = Front(picture.port, WELCOME, port=0)
    front.tell({"frame": 1})
    front.start()

    async def try_it() -> None:
        async with page(front) as anna:
            await hear(anna, "state", lambda state: state["frame"] == 1)
            await asyncio.to_thread(front.stop)
            assert await closing(anna) == (1001, "Echelon has stopped")

    run(try_it())
    front.stop()
    front.tell({"frame": 2})
    front.welcome = WELCOME
    assert front.people() == ()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", front.port), timeout=1)


def test_refuses_a_state_that_is_no_data(front: Front) -> None:
    with pytest.raises(TypeError, match="has no place in a state"):
        front.tell({"rider": object()})
