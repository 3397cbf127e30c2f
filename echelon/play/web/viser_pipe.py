"""The way between a browser and viser: bytes one way, camera messages the other.

viser's server is written for people who trust one another. Any of its clients may ask it to open a tunnel to the
public internet, to change another's panel, or to send fifty megabytes. Ours need one thing of it: to hear where a
camera is, which is also how viser learns that a client is there. So what comes from viser goes through byte by byte,
and what comes from a browser is read frame by frame, and only what has exactly the form of a camera message goes on.

Neither direction holds more than a few hundred kilobytes. A browser that stops reading fills its socket, then ours,
then viser's, which holds the newest state of each thing and no history; after a while it is dropped. Nobody else waits.
"""

from __future__ import annotations

import asyncio
import math
import time
from typing import Literal

import msgspec

from echelon.play.web.allowance import Allowance
from echelon.play.web.http_head import Head

PIECE = 65_536  # bytes carried to a browser at once
HELD = 262_144  # bytes of ours that wait for a browser
PATIENCE = 20.0  # seconds for which a browser may read nothing while something waits for it
LARGEST_FRAME = 16_384  # bytes from a browser
BYTES_A_SECOND = 200_000.0  # from a browser

_CONTINUED_HEADERS = ("sec-websocket-key", "sec-websocket-version", "sec-websocket-protocol")


class Unwelcome(Exception):
    """A browser sent what no browser with our page sends."""


EXPECTED_ENDS = (OSError, EOFError, Unwelcome, asyncio.CancelledError)


class CameraMessage(msgspec.Struct, forbid_unknown_fields=True):
    """viser's ViewerCameraMessage, as a browser sends it."""

    type: Literal["ViewerCameraMessage"]
    wxyz: tuple[float, float, float, float]
    position: tuple[float, float, float]
    image_height: int
    image_width: int
    fov: float
    near: float
    far: float
    look_at: tuple[float, float, float]
    up_direction: tuple[float, float, float]

    def is_finite(self) -> bool:
        """Whether every number is one."""
        numbers = (*self.wxyz, *self.position, *self.look_at, *self.up_direction, self.fov, self.near, self.far)
        return all(math.isfinite(number) for number in numbers)


_CAMERA = msgspec.msgpack.Decoder(CameraMessage)


async def connect_through(
    head: Head, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, viser_port: int
) -> None:
    """Carries a websocket between a browser and viser until either leaves; both connections are closed after.

    Args:
        head: The browser's request to upgrade, already let in.
        reader, writer: The browser's connection.
        viser_port: Where viser listens on the loopback address.

    Raises:
        OSError: viser is not there.
    """
    async with asyncio.timeout(5):
        viser_reader, viser_writer = await asyncio.open_connection("127.0.0.1", viser_port, limit=PIECE)
    try:
        lines = ["GET / HTTP/1.1", f"Host: 127.0.0.1:{viser_port}", "Upgrade: websocket", "Connection: Upgrade"]
        lines += [f"{name}: {head.headers[name]}" for name in _CONTINUED_HEADERS if name in head.headers]
        viser_writer.write(("\r\n".join(lines) + "\r\n\r\n").encode("latin-1"))
        ways = [
            asyncio.create_task(_to_browser(viser_reader, writer)),
            asyncio.create_task(_to_viser(reader, viser_writer)),
        ]
        to_browser = ways[0]
        try:
            done, _ = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            outcomes = await asyncio.gather(*ways, return_exceptions=True)
    finally:
        viser_writer.transport.abort()
    if to_browser not in done or outcomes[0] is not None:
        writer.transport.abort()  # not viser ended it, so nothing that is still on its way matters
    for outcome in outcomes:
        if isinstance(outcome, BaseException) and not isinstance(outcome, EXPECTED_ENDS):
            raise outcome


async def _to_browser(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Bytes from viser, as they come; waits for a slow browser, but not for ever."""
    writer.transport.set_write_buffer_limits(high=HELD)
    while piece := await reader.read(PIECE):
        writer.write(piece)
        async with asyncio.timeout(PATIENCE):
            await writer.drain()
    async with asyncio.timeout(PATIENCE):
        await writer.drain()


async def _to_viser(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Frames from a browser: control frames and camera messages go on, others are left out."""
    allowance = Allowance(BYTES_A_SECOND, time.monotonic())
    while True:
        start = await reader.readexactly(2)
        opcode, size = start[0] & 0x0F, start[1] & 0x7F
        is_control = opcode >= 8
        # browsers mask, do not use reserved bits, and send short messages whole
        if (
            start[0] & 0xF0 != 0x80
            or not start[1] & 0x80
            or opcode not in (1, 2, 8, 9, 10)
            or (is_control and size > 125)
        ):
            raise Unwelcome("a malformed frame")
        longer = await reader.readexactly({126: 2, 127: 8}.get(size, 0))
        size = int.from_bytes(longer, "big") if longer else size
        if size > LARGEST_FRAME:
            raise Unwelcome(f"a frame of {size} bytes")
        if wait := allowance.wait_for(len(start) + len(longer) + 4 + size, time.monotonic()):
            await asyncio.sleep(wait)
        body = await reader.readexactly(4 + size)
        if is_control or (opcode == 2 and is_camera_message(_unmasked(body))):
            writer.write(start + longer + body)
            async with asyncio.timeout(PATIENCE):
                await writer.drain()


def is_camera_message(payload: bytes) -> bool:
    """Whether a browser's message to viser is one that says where its camera is."""
    try:
        return _CAMERA.decode(payload).is_finite()
    except (msgspec.MsgspecError, RecursionError):
        return False


def _unmasked(body: bytes) -> bytes:
    """A frame's payload, from its four bytes of mask and what they cover (RFC 6455, section 5.3)."""
    mask, covered = body[:4], body[4:]
    size = len(covered)
    stretched = (mask * (size // 4 + 1))[:size]
    return (int.from_bytes(covered, "big") ^ int.from_bytes(stretched, "big")).to_bytes(size, "big")
