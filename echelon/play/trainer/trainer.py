"""A real bicycle: a smart trainer that a person rides, felt as a road and heard as speed, cadence and power.

    who plays, any thread                         the trainer's thread: bleak's event loop
    reading()          <-- newest, behind a lock --  notifications         <==\\
    set_gradient(g)    --> where to be           --> limited, twice a second ==> Bluetooth ==> trainer
    set_pitch(a)       --> where to be           --> limited, 30 a second    ==> `PitchOutput` ==> motion platform

Nothing here ever blocks who plays but `start`, which scans, and `stop`. If the connection is lost, readings become
None, so that the person rides on by keys, and it is looked for again after pauses that grow; `note` says how it is.

A person sits on what this drives. The gradient that is sent stays within `GRADIENT_LIMIT`, begins flat with each
connection, and changes by at most `GRADIENT_RATE`, whatever the world does, a restart on a climb included; for pitch
see `echelon.play.trainer.pitch`. `stop` leaves the trainer on a flat road and the platform level.

The packages beneath, bleak and pycycling, are the extra `trainer`; this file can be imported without them.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from echelon.errors import InputError
from echelon.play.trainer.following import Follower, finite
from echelon.play.trainer.machine_address import NEAREST, check_address
from echelon.play.trainer.pitch import PitchChannel, PitchOutput

if TYPE_CHECKING:
    from bleak.backends.device import BLEDevice

    from echelon.play.trainer.fitness_machine import FitnessMachine, Measured

GRADIENT_LIMIT = 0.20
"""Greatest gradient, up and down, that a trainer is told, rise over run."""

GRADIENT_RATE = 0.05
"""How fast it may change [1/s]."""

ROLLING = 0.005
"""Rolling resistance over weight that a trainer is told."""

DRAG = 0.35
"""Drag coefficient times frontal area times density of the air that a trainer is told [kg/m]."""

PACKAGES = ("bleak", "pycycling")
FIRST_TRIES = 3  # connections often fail once, and the next succeeds


def check_packages() -> None:
    """Looks for the packages of the extra `trainer`.

    Raises:
        InputError: One is not installed.
    """
    for package in PACKAGES:
        try:
            importlib.import_module(package)
        except ModuleNotFoundError:
            raise InputError(
                f"--trainer: the package {package} is not installed; `pip install 'echelon[trainer]'` adds it"
            ) from None


class Reading(NamedTuple):
    """What the trainer has said last. None is what it does not measure, or has not said for `Timing.stale`.

    Attributes:
        speed: Of the wheel [m/s].
        cadence: Of the cranks [rpm].
        power: Of the rider [W].
        age: Since it last said anything [s]; infinite if it never has.
    """

    speed: float | None
    cadence: float | None
    power: float | None
    age: float


@dataclass(frozen=True)
class Timing:
    """How long things may take [s].

    Attributes:
        scan: To listen for machines.
        connect: To connect to one.
        answer: Until the machine answers a request.
        gradient: From one gradient that is sent to the next, at least.
        stale: After which what has not been said again is no longer so.
        first_pause: Before a lost machine is looked for again; each further pause is twice as long...
        longest_pause: ... up to this.
        ask_again: After a machine has refused control.
    """

    scan: float = 5.0
    connect: float = 20.0
    answer: float = 3.0
    gradient: float = 0.5
    stale: float = 3.0
    first_pause: float = 1.0
    longest_pause: float = 30.0
    ask_again: float = 10.0


class Trainer:
    """A smart trainer, and a motion platform beside it. Start it, or use it in a ``with`` statement.

    All but `start` and `stop` return at once and may be called from any thread.

    Attributes:
        address: Of the machine; `NEAREST` until one has been found.
    """

    def __init__(
        self,
        address: str = NEAREST,
        *,
        pitch: PitchOutput | None = None,
        say: Callable[[str], None] | None = None,
        rolling: float = ROLLING,
        drag: float = DRAG,
        timing: Timing = Timing(),
        scanner_backend: Any = None,
        client_backend: Any = None,
    ) -> None:
        """
        Args:
            address: Of the machine, or `NEAREST`.
            pitch: What drives a motion platform, if there is one.
            say: Called with each new `note`, from the trainer's thread.
            rolling: Rolling resistance over weight that the trainer simulates.
            drag: Drag coefficient times frontal area times density of the air that it simulates [kg/m].
            timing: How long things may take.
            scanner_backend: bleak's scanner for a radio other than this machine's own (a class).
            client_backend: bleak's client for it (a class).
        """
        self.address = address
        self._asked_for = address
        self._say = say
        self._rolling, self._drag = rolling, drag
        self._timing = timing
        self._scanner_backend, self._client_backend = scanner_backend, client_backend
        self._gradient = 0.0
        self._pitch = None if pitch is None else PitchChannel(pitch, self._tell)
        self._lock = threading.Lock()
        # What is behind the lock.
        self._note = ""
        self._name = ""
        self._connected = False
        self._heard = -math.inf  # when the machine last said anything
        self._newest: dict[str, tuple[float, float]] = {}  # by field: its value, and when it came
        # What belongs to the thread.
        self._thread: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopping = asyncio.Event()
        self._begun: Future[None] = Future()
        self._pause = timing.first_pause

    # For who plays

    def start(self) -> None:
        """Finds the machine and connects to it; returns when it is there, after seconds.

        Raises:
            InputError: The packages are not installed, the address is none, Bluetooth cannot be used, no machine is
                found, it is no bicycle, or it cannot be connected to.
            RuntimeError: It has been started before, or is stopped meanwhile.
        """
        if self._thread is not None:
            raise RuntimeError("a trainer is started once; make another")
        check_address(self.address)
        check_packages()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._work, args=(self._loop,), name="trainer", daemon=True)
        self._thread.start()
        try:
            self._begun.result()
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        """Leaves the trainer on a flat road and the platform level, and disconnects. Returns when that is done.

        It takes a second, and ten where the machine does not answer; what has stopped, or never started, stays so.
        """
        if self._thread is None or self._loop is None:
            return
        # The loop is closed once the thread has ended by itself.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._stopping.set)
        self._thread.join(4.0 * self._timing.answer + 5.0)
        if self._thread.is_alive():
            self._tell("the trainer's connection does not close; it ends with this program")

    def reading(self) -> Reading:
        """What the trainer has said last."""
        now = time.monotonic()
        with self._lock:
            fresh = {name: value for name, (value, at) in self._newest.items() if now - at <= self._timing.stale}
            age = now - self._heard
        return Reading(fresh.get("speed"), fresh.get("cadence"), fresh.get("power"), age)

    def set_gradient(self, gradient: float) -> None:
        """What the trainer should feel like: the road's rise over run, positive uphill.

        Raises:
            ValueError: It is not finite.
        """
        self._gradient = finite("gradient", gradient)

    def set_pitch(self, angle: float) -> None:
        """Where the motion platform should be [rad], positive where the front wheel is higher; without one, nothing.

        Raises:
            ValueError: It is not finite.
        """
        angle = finite("pitch", angle)
        if self._pitch is not None:
            self._pitch.set(angle)

    @property
    def connected(self) -> bool:
        """Whether the machine is there."""
        with self._lock:
            return self._connected

    @property
    def name(self) -> str:
        """Of the machine, as it calls itself; empty until one has been found."""
        with self._lock:
            return self._name

    @property
    def note(self) -> str:
        """How things are, in one line for the person."""
        with self._lock:
            return self._note

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()

    # In the trainer's thread

    def _work(self, loop: asyncio.AbstractEventLoop) -> None:
        with asyncio.Runner(loop_factory=lambda: loop) as runner:
            runner.run(self._main())

    async def _main(self) -> None:
        """Rides until it should stop, or cannot begin; the platform is moved beside it, and levelled after it."""
        riding = asyncio.create_task(self._ride())
        stopping = asyncio.create_task(self._stopping.wait())
        moving = None if self._pitch is None else asyncio.create_task(self._pitch.run())
        await asyncio.wait((riding, stopping), return_when=asyncio.FIRST_COMPLETED)
        for task in (riding, stopping):
            task.cancel()
        ended, _ = await asyncio.gather(riding, stopping, return_exceptions=True)
        if not self._begun.done():
            self._begun.set_exception(RuntimeError("the trainer was stopped before it was there"))
        elif isinstance(ended, Exception):
            # Only what the program was given to say things with can have raised this.
            with self._lock:
                self._note = f"trainer: no longer heard ({ended!r}); ride on by keys"
        if self._pitch is not None and moving is not None:
            moving.cancel()
            await asyncio.gather(moving, return_exceptions=True)
            await self._pitch.level()

    async def _ride(self) -> None:
        """One connection after another; ends only if there never is a first."""
        from echelon.play.trainer.bluetooth import RadioError, find_machine, reason_of

        failures = 0
        while True:
            try:
                device = await find_machine(self.address, self._timing.scan, self._scanner_backend)
                await self._connection(device)
                why = "the connection is lost"
            # Systems raise what they like. Before the ride it is told and ends; during it, it must not end the ride.
            except Exception as error:
                why = reason_of(error)
                failures += 1
                final = isinstance(error, RadioError) or failures >= FIRST_TRIES
                if not self._begun.done() and final:
                    self._begun.set_exception(InputError(f"--trainer {self._asked_for}: {why}"))
                    return
            if self._begun.done():
                self._tell(f"trainer: {why}; ride on by keys, it is looked for again in {self._pause:g} s")
            await asyncio.sleep(self._pause)
            self._pause = min(2.0 * self._pause, self._timing.longest_pause)

    async def _connection(self, device: BLEDevice) -> None:
        """Connects, and talks until the connection is lost."""
        from bleak import BleakClient

        from echelon.play.trainer.bluetooth import reason_of
        from echelon.play.trainer.fitness_machine import FitnessMachine, RoadSurface

        lost = asyncio.Event()

        def disconnected(_: BleakClient) -> None:
            self._forget()
            lost.set()

        options = {} if self._client_backend is None else {"backend": self._client_backend}
        client = BleakClient(device, disconnected, timeout=self._timing.connect, **options)
        surface = RoadSurface(self._rolling, self._drag)
        machine = FitnessMachine(client, self._hear, self._tell, surface, self._timing.answer, self._timing.ask_again)
        try:
            async with asyncio.timeout(self._timing.connect):
                await client.connect()
        except Exception as error:
            raise ConnectionError(f"the machine is there, but a connection to it fails ({reason_of(error)})") from error
        try:
            with self._lock:
                self._name = device.name or device.address
                self._connected = True
            self.address = device.address
            self._tell(f"trainer: connected to {self.name} ({self.address})")
            await machine.begin()
            if not self._begun.done():
                self._begun.set_result(None)
            await self._follow_road(machine, lost)
        finally:
            self._forget()
            await self._let_go(client, machine, lost)

    async def _follow_road(self, machine: FitnessMachine, lost: asyncio.Event) -> None:
        """Sends the road's gradient whenever it has changed, until the connection is lost."""
        follower = Follower(GRADIENT_LIMIT, GRADIENT_RATE)
        sent: float | None = None
        while not lost.is_set():
            gradient = round(follower.step(self._gradient, self._timing.gradient), 4)  # as fine as the service has it
            if gradient != sent:
                sent = gradient if await machine.set_gradient(gradient) else None
            if not machine.controlled:
                # What it resists with now, others decide; once it is ours again, the road begins flat again.
                follower.value, sent = 0.0, None
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(lost.wait(), self._timing.gradient)

    async def _let_go(self, client: Any, machine: FitnessMachine, lost: asyncio.Event) -> None:
        """Takes leave of a machine that may not hear it any more."""
        # It is over in any case; a failure would only hide why.
        with contextlib.suppress(Exception):
            if not lost.is_set():
                async with asyncio.timeout(2.0 * self._timing.answer):
                    await machine.end()
        with contextlib.suppress(Exception):
            async with asyncio.timeout(2.0 * self._timing.answer):
                await client.disconnect()

    def _hear(self, measured: Measured) -> None:
        """Keeps what a notification says; a machine may spread what it has over several."""
        now = time.monotonic()
        with self._lock:
            self._heard = now
            for name, value in measured._asdict().items():
                if value is not None:
                    self._newest[name] = (value, now)
        # Only a machine that sends data has come back for good: to one that comes and goes, pauses go on growing.
        self._pause = self._timing.first_pause

    def _forget(self) -> None:
        """What a machine said that is gone."""
        with self._lock:
            self._connected = False
            self._newest.clear()

    def _tell(self, note: str) -> None:
        with self._lock:
            self._note = note
        if self._say is not None:
            self._say(note)
