"""A client of viser that only listens: it decodes what a page would be sent, and counts its bytes."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

Message = dict[str, Any]

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [3.0, 3.0, 3.0],
    "image_height": 720,
    "image_width": 1280,
    "fov": 1.2,
    "near": 0.1,
    "far": 100.0,
    "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}


class ViserClient:
    """Connected to a server; a context manager.

    Attributes:
        bytes_received: So far.
    """

    def __init__(self, server: viser.ViserServer, *, announced: bool = False) -> None:
        """
        Args:
            server: To connect to.
            announced: Whether to say where the camera is, upon which the server takes it for a client.
        """
        self.bytes_received = 0
        self._connection: ClientConnection = connect(
            f"ws://127.0.0.1:{server.get_port()}",
            subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
            max_size=None,
            compression=None,
        )
        if announced:
            self._connection.send(msgspec.msgpack.encode(CAMERA))

    def __enter__(self) -> ViserClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._connection.close()

    def batches(self, seconds: float) -> list[list[Message]]:
        """What arrives until nothing has come for so long: messages that were sent together are together."""
        found = []
        while True:
            try:
                data = self._connection.recv(timeout=seconds)
            except TimeoutError:
                return found
            assert isinstance(data, bytes)
            self.bytes_received += len(data)
            found.append(_decoded(data))

    def messages(self, seconds: float = 0.4) -> list[Message]:
        """All of `batches`."""
        return [message for batch in self.batches(seconds) for message in batch]

    def wait_for(self, kind: str, limit: float = 5.0) -> Message:
        """The first message of a kind."""
        end = time.monotonic() + limit
        while time.monotonic() < end:
            for message in self.messages(0.05):
                if message["type"] == kind:
                    return message
        raise AssertionError(f"no {kind} within {limit} s")


def _decoded(data: bytes) -> list[Message]:
    size, compressed = (int.from_bytes(data[start : start + 8], "little") for start in (0, 8))
    inner = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(data[16 : 16 + compressed], size))
    place, buffers = 16 + compressed, []
    for length in inner["binaryBufferLengths"]:
        place += -place % 8
        buffers.append(data[place : place + length])
        place += length
    return [_filled(message, buffers) for message in inner["messages"]]


def _filled(value: Any, buffers: list[bytes]) -> Any:
    """A message with its arrays, flat, in the places that are kept for them."""
    if isinstance(value, dict):
        if "__binary_index" in value:
            return np.frombuffer(buffers[value["__binary_index"]], value["dtype"])
        return {key: _filled(part, buffers) for key, part in value.items()}
    return [_filled(part, buffers) for part in value] if isinstance(value, list) else value
