"""One page's websocket: short messages in, the newest state out, and an end to whoever misbehaves.

The protocol itself (handshake, masks, fragments, closing) is the websockets library's, used without its input and
output, because the same port also serves the page and viser's websocket.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable

from websockets.datastructures import Headers
from websockets.frames import CloseCode, Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol

from echelon.errors import InputError
from echelon.play.web.allowance import Allowance
from echelon.play.web.http_head import Head
from echelon.play.web.messages import LARGEST, Message, read_message

MESSAGES_A_SECOND = 120.0
PATIENCE = 20.0  # seconds that a page may take to read what it was sent
PING_EVERY = 5.0  # seconds
HELLO_WITHIN = 30.0  # seconds; the page waits for its picture first
CLOSE_WITHIN = 1.0  # seconds
MOST_HELD = 262_144  # bytes of answers that wait for a page

_QUIET = logging.getLogger("echelon.play.websocket")
_QUIET.addHandler(logging.NullHandler())
_QUIET.propagate = False  # what a broken page sends is no concern of whoever runs the program


class RideSocket:
    """The connection of one page that speaks our messages.

    Args:
        reader, writer: The connection, its request head already read.
        hear: Called with every message; raises InputError where the page may not say this, which closes it.
    """

    def __init__(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, hear: Callable[[Message], None]
    ) -> None:
        self._reader = reader
        self._writer = writer
        self._hear = hear
        self._protocol = ServerProtocol(state=State.OPEN, max_size=LARGEST, logger=_QUIET)
        self._welcome: str | None = None
        self._state: str | None = None
        self._news = asyncio.Event()
        self._opened = self._answered = time.monotonic()
        self._partial = b""
        self._turned_away: tuple[CloseCode, str] | None = None
        self.greeted = False

    async def serve(self, head: Head) -> None:
        """Shakes hands and listens until either side ends it.

        Raises:
            InputError: The request is no proper websocket handshake; nothing was sent.
        """
        handshake = ServerProtocol(logger=_QUIET)
        response = handshake.accept(Request(head.path, Headers(head.headers.items())))
        if response.status_code != 101:
            raise InputError("this is not a websocket handshake")
        # what is written waits in our own slots, not in the transport: drain() then means that all of it left
        self._writer.transport.set_write_buffer_limits(high=0)
        self._writer.write(response.serialize())
        if self._turned_away:
            self.close(*self._turned_away)
            return await self._finish()
        tasks = [asyncio.create_task(work) for work in (self._listen(), self._tell(), self._watch())]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        except (OSError, EOFError, TimeoutError):
            self._writer.transport.abort()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await self._finish()

    def turn_away(self, code: CloseCode, reason: str) -> None:
        """Before ``serve``: only shakes hands and says why there is no more; a page cannot read an HTTP refusal."""
        self._turned_away = (code, reason)

    # ---- out ---------------------------------------------------------------------------------------------------------
    def welcome(self, text: str) -> None:
        """Sends a welcome before any state that follows."""
        self._welcome, self._state = text, None
        self._news.set()

    def tell(self, text: str) -> None:
        """Sends a state as soon as the page has read the one before; a newer one takes its place until then."""
        self._state = text
        self._news.set()

    def answer(self, text: str) -> None:
        """Sends a short answer at once."""
        if self._protocol.state is State.OPEN:
            self._protocol.send_text(text.encode())
            self._flush()

    def close(self, code: CloseCode, reason: str) -> None:
        """Ends the conversation, with a reason of which the page sees about a hundred letters."""
        if self._protocol.state is State.OPEN:
            self._protocol.fail(code, reason.encode()[:120].decode("utf-8", "ignore"))
            self._flush()

    # ---- tasks -------------------------------------------------------------------------------------------------------
    async def _listen(self) -> None:
        """Reads frames until the page leaves or was closed."""
        allowance = Allowance(MESSAGES_A_SECOND, time.monotonic())
        while self._protocol.state is State.OPEN:
            data = await self._reader.read(LARGEST)
            if not data:
                return
            self._protocol.receive_data(data)
            self._flush()
            for event in self._protocol.events_received():
                if self._protocol.state is not State.OPEN:
                    return
                if allowance.wait_for(1, time.monotonic()) > 0:
                    return self.close(CloseCode.POLICY_VIOLATION, f"more than {MESSAGES_A_SECOND:g} messages a second")
                if isinstance(event, Frame):
                    self._take_frame(event)

    def _take_frame(self, frame: Frame) -> None:
        """Puts fragments together, and hands a whole message on."""
        if frame.opcode is Opcode.PONG:
            self._answered = time.monotonic()
        elif frame.opcode is Opcode.BINARY:
            self.close(CloseCode.UNSUPPORTED_DATA, "messages are text")
        elif frame.opcode in (Opcode.TEXT, Opcode.CONT):
            self._partial += bytes(frame.data)
            if not frame.fin:
                return
            whole, self._partial = self._partial, b""
            try:
                self._hear(read_message(whole.decode()))
            except UnicodeDecodeError:
                self.close(CloseCode.INVALID_DATA, "messages are UTF-8")
            except InputError as error:
                self.close(CloseCode.POLICY_VIOLATION, str(error))

    async def _tell(self) -> None:
        """Sends the newest of what there is to tell, at the pace at which the page reads."""
        while True:
            await self._news.wait()
            self._news.clear()
            texts, self._welcome, self._state = (self._welcome, self._state), None, None
            for text in texts:
                if text is not None and self._protocol.state is State.OPEN:
                    self._protocol.send_text(text.encode())
            self._flush()
            async with asyncio.timeout(PATIENCE):
                await self._writer.drain()

    async def _watch(self) -> None:
        """Returns once the page says no hello, or no longer reads: kernels hold more than a minute of our states."""
        while True:
            await asyncio.sleep(PING_EVERY)
            now = time.monotonic()
            if not self.greeted and now - self._opened > HELLO_WITHIN:
                return self.close(CloseCode.POLICY_VIOLATION, "no hello")
            if now - self._answered > PATIENCE:
                raise TimeoutError
            if self._protocol.state is State.OPEN:
                self._protocol.send_ping(b"")
                self._flush()

    # ---- bytes -------------------------------------------------------------------------------------------------------
    def _flush(self) -> None:
        """Writes what the protocol wants said."""
        pieces = self._protocol.data_to_send()
        if self._writer.is_closing():
            return
        for piece in pieces:
            if piece:
                self._writer.write(piece)
        if self._writer.transport.get_write_buffer_size() > MOST_HELD:
            self._writer.transport.abort()

    async def _finish(self) -> None:
        """Gives the closing handshake a moment, so that the page reads the reason before the connection ends."""
        if self._writer.is_closing():
            return
        with contextlib.suppress(OSError, TimeoutError):
            async with asyncio.timeout(CLOSE_WITHIN):
                await self._writer.drain()
                self._writer.write_eof()
                while await self._reader.read(LARGEST):
                    pass
