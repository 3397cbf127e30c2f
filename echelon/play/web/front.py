"""The front: the only server that a browser reaches, and the handlebars' keeper.

    browser ── GET / ──────────► the page (viser's client with our overlay inside)
    browser ── websocket /ride ► our messages: who rides, hands and feet, what the director wants; the state back
    browser ── websocket / ────► viser, which listens on the loopback address only (viser_pipe.py)

viser's own keys know no release and its panel no overlay, hence a page of our own around its picture. The front runs on
a thread and an event loop of its own. Between it and the loop that steps the world there are a box of commands (in) and
the newest state (out), so that neither ever waits for the other.
"""

from __future__ import annotations

import asyncio
import errno
import itertools
import json
import logging
import math
import numbers
import socket
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from http import HTTPStatus
from typing import Any

import numpy as np
from websockets.frames import CloseCode

from echelon.errors import InputError
from echelon.play.web.front_page import build_page, page_headers
from echelon.play.web.http_head import LARGEST_HEAD, Doorkeeper, Head, Refused, answer, read_head, refusal
from echelon.play.web.inbox import Inbox
from echelon.play.web.messages import (
    LIVE_ONLY,
    REPLAY_ONLY,
    RIDING_ONLY,
    ChangeView,
    Command,
    Gear,
    Hello,
    Leave,
    LetGo,
    Look,
    Message,
    Pass,
    Ping,
    Ride,
    Take,
)
from echelon.play.web.people import People, Person
from echelon.play.web.ride_socket import RideSocket
from echelon.play.web.viser_pipe import connect_through

MOST_PEOPLE = 32
MOST_CONNECTIONS = 3 * MOST_PEOPLE  # a page has two, and needs a third for a moment while it loads
PORTS_TRIED = 100
HEAD_WITHIN = 5.0  # seconds
READ_WITHIN = 20.0  # seconds for each piece of the page
CLOSE_WITHIN = 1.0  # seconds
STATES_A_SECOND = 15.0
SILENCE = 1.0  # seconds without a ride message after which nobody pedals
NOT_IN = {"replay": LIVE_ONLY, "watch": (*RIDING_ONLY, *REPLAY_ONLY)}  # elsewhere, what is of a replay
_PIECE = 65_536  # bytes

_log = logging.getLogger("echelon.play")


class Front:
    """Serves the page and its websockets.

    Args:
        viser_port: Where viser listens on 127.0.0.1.
        welcome: What a page is told first: mode ("herd", "race", "watch" where there is no bicycle to ride, or
            "replay"), title, agents, seed, frames, frame_rate. Can be replaced at any time; everybody is told anew.
        host: The address to listen on.
        port: The port to listen on, or the next free one; 0 for any.
        names: Further host names under which the server may be addressed (behind a proxy, say).
    """

    def __init__(
        self,
        viser_port: int,
        welcome: Mapping[str, Any],
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        names: Sequence[str] = (),
    ) -> None:
        self._viser_port = viser_port
        self._host, self._port = host, port
        self._doorkeeper = Doorkeeper(host, names)
        self._page = build_page()
        self._inbox = Inbox()
        self._thread: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopping: asyncio.Event | None = None
        # shared with the caller's thread: replaced whole, never changed
        self._welcome = _plain(welcome)
        self._state: dict[str, Any] | None = None
        self._everybody: tuple[Person, ...] = ()
        self._handing_over = threading.Lock()
        self._state_is_due = False
        # of the front's own thread
        self._people = People()
        self._sockets: dict[int, RideSocket] = {}
        self._numbers = itertools.count(1)
        self._connections = 0
        self._pipes = 0
        self._next_telling = 0.0
        self._telling: asyncio.TimerHandle | None = None
        self._heard_rider = 0.0
        self._rider_is_silent = True

    # ---- for the loop that steps the world ------------------------------------------------------------------------
    def start(self) -> None:
        """Opens the port and serves, on a thread of its own.

        Raises:
            InputError: The address cannot be listened on, or no port near the wanted one is free.
        """
        if self._thread is not None:
            raise RuntimeError("the front was started before")
        listening = self._listen()
        self._port = listening.getsockname()[1]
        ready = threading.Event()
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve(listening, ready)), name="echelon-front", daemon=True
        )
        self._thread.start()
        if not ready.wait(timeout=10):
            raise RuntimeError("the front did not start")

    def stop(self) -> None:
        """Says goodbye to everybody and closes the port."""
        loop, stopping = self._loop, self._stopping
        if self._thread is None or loop is None or stopping is None:
            return
        with suppress(RuntimeError):  # its loop has ended already
            loop.call_soon_threadsafe(stopping.set)
        self._thread.join(timeout=5)

    def __enter__(self) -> Front:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return self._port

    @property
    def url(self) -> str:
        """Where a browser finds the page."""
        host = socket.gethostname() if self._host in ("0.0.0.0", "::", "") else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self._port}/"

    @property
    def welcome(self) -> Mapping[str, Any]:
        """What a page is told first."""
        return self._welcome

    @welcome.setter
    def welcome(self, welcome: Mapping[str, Any]) -> None:
        with self._handing_over:
            self._welcome = _plain(welcome)
            self._state = None  # of the world before
        self._call(self._welcome_everybody)

    def commands(self) -> list[tuple[int, Command]]:
        """What people sent since the last call, in order of arrival, each with the person's number."""
        return self._inbox.take()

    def tell(self, state: Mapping[str, Any]) -> None:
        """Shows everybody a state, without ``kind`` and ``people``; the newest wins.

        Numbers that are not finite go as null.

        Raises:
            TypeError: Something in it has no place in JSON.
        """
        plain = _plain(state)
        with self._handing_over:
            self._state = plain
            if self._state_is_due:
                return
            self._state_is_due = True
        self._call(self._tell_soon)

    def people(self) -> tuple[Person, ...]:
        """Who is there, in the order in which they came."""
        return self._everybody

    # ---- serving --------------------------------------------------------------------------------------------------
    def _listen(self) -> socket.socket:
        """A listening socket on the wanted port or the next free one."""
        last = min(self._port + PORTS_TRIED, 65_536) if self._port else 1
        for port in range(self._port, last):
            try:
                family = socket.getaddrinfo(self._host, port, type=socket.SOCK_STREAM)[0][0]
                return socket.create_server((self._host, port), family=family, backlog=64)
            except (OSError, OverflowError) as error:
                if not isinstance(error, OSError) or error.errno != errno.EADDRINUSE:
                    raise InputError(f"--host {self._host} --port {port}: cannot listen there ({error})") from None
        raise InputError(f"--port {self._port}: this port and the {last - self._port - 1} after it are taken")

    async def _serve(self, listening: socket.socket, ready: threading.Event) -> None:
        """The front thread's whole life."""
        self._loop = asyncio.get_running_loop()
        self._stopping = asyncio.Event()
        visits: set[asyncio.Task[None]] = set()

        def visit(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            task = asyncio.create_task(self._visit(reader, writer))
            visits.add(task)
            task.add_done_callback(visits.discard)

        server = await asyncio.start_server(visit, sock=listening, limit=LARGEST_HEAD)
        silence = asyncio.create_task(self._mind_silence())
        self._tell_everybody()  # what was told before there was a thread to tell it
        ready.set()
        await self._stopping.wait()
        server.close()
        silence.cancel()
        for ride in self._sockets.values():
            ride.close(CloseCode.GOING_AWAY, "Echelon has stopped")
        if visits:
            await asyncio.wait(visits, timeout=0.5)
        for task in visits:
            task.cancel()
        await asyncio.gather(silence, *visits, return_exceptions=True)

    async def _visit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection from its first byte to its last."""
        self._connections += 1
        try:
            if self._connections > MOST_CONNECTIONS:
                raise Refused(HTTPStatus.SERVICE_UNAVAILABLE, "too many connections")
            async with asyncio.timeout(HEAD_WITHIN):
                head = await read_head(reader)
            self._doorkeeper.check(head)
            await self._route(head, reader, writer)
        except Refused as refused:
            await self._respond(writer, refusal(refused))
        except (OSError, EOFError, TimeoutError):
            writer.transport.abort()  # they left, or would neither speak nor listen
        except Exception:
            _log.exception("a connection ended by an error of ours")
            writer.transport.abort()
        finally:
            writer.close()
            try:
                async with asyncio.timeout(CLOSE_WITHIN):
                    await writer.wait_closed()
            except (OSError, TimeoutError):
                writer.transport.abort()
            self._connections -= 1

    async def _route(self, head: Head, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answers one request.

        Raises:
            Refused: There is nothing under this path, or no room.
        """
        if head.method not in ("GET", "HEAD"):
            raise Refused(HTTPStatus.METHOD_NOT_ALLOWED, "only GET and HEAD are understood")
        if head.wants_websocket and head.method == "GET" and head.path == "/ride":
            await self._ride(head, reader, writer)
        elif head.path != "/":
            raise Refused(HTTPStatus.NOT_FOUND, "there is nothing here but the page at /")
        elif head.wants_websocket:
            if self._pipes >= MOST_PEOPLE:
                raise Refused(HTTPStatus.SERVICE_UNAVAILABLE, f"there is room for {MOST_PEOPLE} people")
            self._pipes += 1
            try:
                await connect_through(head, reader, writer, self._viser_port)
            except OSError:
                raise Refused(HTTPStatus.BAD_GATEWAY, "the picture is not there") from None
            finally:
                self._pipes -= 1
        else:
            headers = page_headers(head.host)
            await self._respond(writer, answer(HTTPStatus.OK, headers, self._page, with_body=head.method == "GET"))

    async def _respond(self, writer: asyncio.StreamWriter, response: bytes) -> None:
        """Sends a response piece by piece, so that a slow reader costs one piece of memory."""
        writer.transport.set_write_buffer_limits(high=0)
        with suppress(OSError, TimeoutError):
            for start in range(0, len(response), _PIECE):
                writer.write(response[start : start + _PIECE])
                async with asyncio.timeout(READ_WITHIN):
                    await writer.drain()
            writer.write_eof()

    async def _ride(self, head: Head, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One page's conversation."""
        person = next(self._numbers)
        ride = RideSocket(reader, writer, lambda message: self._hear(person, message))
        if len(self._sockets) >= MOST_PEOPLE:
            ride.turn_away(CloseCode.TRY_AGAIN_LATER, f"there is room for {MOST_PEOPLE} people")
        else:
            self._sockets[person] = ride
        try:
            await ride.serve(head)
        except InputError as error:
            raise Refused(HTTPStatus.BAD_REQUEST, str(error)) from None
        finally:
            self._sockets.pop(person, None)
            was_known = person in self._people
            self._inbox.forget(person)
            if self._people.farewell(person):
                self._nobody_pedals(person)
            if was_known:
                self._people_changed()

    # ---- what pages say -------------------------------------------------------------------------------------------
    def _hear(self, person: int, message: Message) -> None:
        """Settles one message.

        Raises:
            InputError: Nobody with our page says this now.
        """
        ride = self._sockets[person]
        if isinstance(message, Hello):
            self._people.greet(person, message.name, message.viewer)
            if not ride.greeted:
                ride.greeted = True
                ride.welcome(self._welcome_for(person))
            self._people_changed()
        elif not ride.greeted:
            raise InputError("message: hello comes first")
        elif isinstance(message, Ping):
            ride.answer(json.dumps({"kind": "pong", "at": message.at}))
        elif isinstance(message, NOT_IN.get(str(self._welcome.get("mode")), REPLAY_ONLY)):
            return  # of a page that has not yet heard that the mode changed
        elif isinstance(message, Take | Pass | Leave):
            self._move_handlebars(person, message)
        elif isinstance(message, Ride | Gear):
            if self._people.rider == person:
                self._heard_rider = asyncio.get_running_loop().time()
                self._rider_is_silent = False
                self._inbox.put(person, message)
        elif isinstance(message, ChangeView | Look) or self._people.may_direct(person):
            self._inbox.put(person, message)

    def _move_handlebars(self, person: int, message: Take | Pass | Leave) -> None:
        """Takes, passes on or lets go, as far as it is theirs to do."""
        if isinstance(message, Take):
            moved = self._people.take(person)
        elif isinstance(message, Pass):
            moved = self._people.pass_on(person, message.to)
        else:
            moved = self._people.let_go(person)
        if moved:
            self._nobody_pedals(person)
            self._people_changed()

    def _nobody_pedals(self, person: int) -> None:
        self._rider_is_silent = True
        self._inbox.put(person, LetGo())

    async def _mind_silence(self) -> None:
        """Lets go for a rider whose page has fallen silent: a laptop that went to sleep does not pedal on."""
        while True:
            await asyncio.sleep(SILENCE / 10)
            rider = self._people.rider
            late = asyncio.get_running_loop().time() - self._heard_rider > SILENCE
            if rider is not None and late and not self._rider_is_silent:
                self._nobody_pedals(rider)

    # ---- what pages are told --------------------------------------------------------------------------------------
    def _call(self, work: Any) -> None:
        """Has the front's thread do something, if there is one."""
        if self._loop is not None:
            with suppress(RuntimeError):  # it has stopped
                self._loop.call_soon_threadsafe(work)

    def _people_changed(self) -> None:
        self._everybody = self._people.everybody()
        self._tell_everybody()

    def _welcome_for(self, person: int) -> str:
        return json.dumps({**self._welcome, "kind": "welcome", "you": person})

    def _welcome_everybody(self) -> None:
        rider = self._people.rider
        if rider is not None and self._welcome.get("mode") in NOT_IN and self._people.let_go(rider):
            self._nobody_pedals(rider)  # there is nothing left to hold
            self._everybody = self._people.everybody()
        for person, ride in self._sockets.items():
            if ride.greeted:
                ride.welcome(self._welcome_for(person))
        self._tell_everybody()

    def _tell_soon(self) -> None:
        """Tells the newest state now, or when the next is due."""
        assert self._loop is not None
        if self._telling is None:
            self._telling = self._loop.call_at(max(self._next_telling, self._loop.time()), self._tell_everybody)

    def _tell_everybody(self) -> None:
        """Tells everybody the newest state and who is there."""
        assert self._loop is not None
        if self._telling is not None:
            self._telling.cancel()
            self._telling = None
        self._next_telling = self._loop.time() + 1.0 / STATES_A_SECOND
        with self._handing_over:
            self._state_is_due = False
            state = self._state
        if state is None:
            return
        people = [{"id": one.id, "name": one.name, "riding": one.riding} for one in self._everybody]
        text = json.dumps({**state, "kind": "state", "people": people}, allow_nan=False)
        for ride in self._sockets.values():
            if ride.greeted:
                ride.tell(text)


def _plain(value: Any) -> Any:
    """Plain data for JSON: NumPy's numbers as Python's, numbers that are none as null."""
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, numbers.Real):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.bool_):
        return bool(value)
    raise TypeError(f"{value!r} has no place in a state")
