"""The pitch of a motion platform: an angle that somebody else's hardware follows.

A person may sit on the platform. So the angle that goes out never leaves `PITCH_LIMIT`, never changes faster than
`PITCH_RATE` whatever is asked for, starts level and is led back to level when the ride ends. It goes out whenever it
has changed, at most `OUTPUT_RATE` times a second, and once a second if it has not, so that a platform can tell a
still road from a sender that is gone.

An output is anything that is called with the angle [rad], positive where the front wheel is higher. One ships:
`DatagramPitch` sends it over UDP, a decimal number of degrees in ASCII a datagram.
"""

from __future__ import annotations

import asyncio
import math
import socket
from collections.abc import Callable
from types import TracebackType
from typing import Self

from echelon.errors import InputError
from echelon.play.trainer.following import Follower, finite

PITCH_LIMIT = math.radians(12.0)
"""Greatest pitch of the platform, up and down [rad]; that of the papers' platform."""

PITCH_RATE = math.radians(20.0)
"""How fast it may change [rad/s]."""

OUTPUT_RATE = 30.0
"""How often it may go out [1/s]."""

RESOLUTION = math.radians(0.01)  # smaller changes do not go out [rad]
HEARTBEAT = 1.0  # after so long the same angle goes out again [s]
LOOPBACK = "127.0.0.1"

PitchOutput = Callable[[float], None]
"""What drives a platform: called with its pitch [rad], from the trainer's thread, and returns at once."""


class DatagramPitch:
    """A platform that listens on a UDP port: each datagram is the pitch [deg] in ASCII, like ``-3.25``.

    Nobody answers, and a datagram may be lost; the next one says everything again.
    """

    def __init__(self, port: int, host: str = LOOPBACK) -> None:
        """
        Args:
            port: Where it listens.
            host: On which machine, by name or address; this one unless told otherwise.

        Raises:
            InputError: There is no such host or port.
        """
        if not 1 <= port <= 65535:
            raise InputError(f"pitch {host}:{port}: the port must be from 1 to 65535")
        try:
            family, kind, _, _, self._address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except (OSError, UnicodeError) as error:
            raise InputError(f"pitch {host}:{port}: no such host ({error})") from None
        self._socket = socket.socket(family, kind)
        self._socket.setblocking(False)

    @classmethod
    def at(cls, text: str) -> DatagramPitch:
        """The platform at a place as a command line has it: ``PORT``, ``HOST:PORT`` or ``[IPV6]:PORT``.

        Raises:
            InputError: It is no such place.
        """
        host, _, port = text.rpartition(":")
        if not (port.isascii() and port.isdecimal()):
            raise InputError(f"pitch {text!r}: must be PORT or HOST:PORT, like 9000 or 127.0.0.1:9000")
        return cls(int(port), host.removeprefix("[").removesuffix("]") or LOOPBACK)

    def __call__(self, angle: float) -> None:
        """Sends a pitch [rad].

        Raises:
            OSError: The network cannot be reached.
        """
        # The sum with zero makes a level platform's "-0.00" a "0.00".
        self._socket.sendto(f"{round(math.degrees(angle), 2) + 0.0:.2f}".encode("ascii"), self._address)

    def close(self) -> None:
        """Sends no more."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


class PitchChannel:
    """Leads an output to where it should be, in an event loop.

    Attributes:
        failures: How often the output has raised.
    """

    def __init__(self, output: PitchOutput, say: Callable[[str], None]) -> None:
        """
        Args:
            output: What drives the platform.
            say: Called with one line when the output fails, the first time of each series.
        """
        self.failures = 0
        self._output = output
        self._say = say
        self._target = 0.0
        self._follower = Follower(PITCH_LIMIT, PITCH_RATE)
        self._sent: float | None = None
        self._silence = 0.0  # since the output was last called [s]
        self._failing = False

    def set(self, angle: float) -> None:
        """Where the platform should be [rad]; from any thread, as often as one likes.

        Raises:
            ValueError: The angle is not finite.
        """
        self._target = finite("pitch", angle)

    async def run(self) -> None:
        """Follows the target until it is cancelled."""
        while True:
            self.step(1.0 / OUTPUT_RATE)
            await asyncio.sleep(1.0 / OUTPUT_RATE)

    async def level(self) -> None:
        """Leads the platform back to level, no faster than ever."""
        self._target = 0.0
        while self._follower.value != 0.0:
            self.step(1.0 / OUTPUT_RATE)
            await asyncio.sleep(1.0 / OUTPUT_RATE)

    def step(self, duration: float) -> None:
        """One step so long [s] toward the target, and out with it if it is news."""
        angle = self._follower.step(self._target, duration)
        self._silence += duration
        levelled = angle == 0.0 and self._sent != 0.0
        if (
            self._sent is None
            or levelled
            or abs(angle - self._sent) >= RESOLUTION
            or self._silence >= HEARTBEAT - 0.5 * duration
        ):
            self._send(angle)

    def _send(self, angle: float) -> None:
        self._sent, self._silence = angle, 0.0
        try:
            self._output(angle)
        # Whoever built the platform wrote the output: whatever it raises, the ride goes on.
        except Exception as error:
            self.failures += 1
            if not self._failing:
                self._failing = True
                self._say(f"the motion platform does not hear: {error or type(error).__name__}")
        else:
            self._failing = False
