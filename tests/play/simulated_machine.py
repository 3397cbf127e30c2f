"""Bicycle trainers without Bluetooth: bleak's own client and scanner over a radio that is simulated.

`Air` is what is in reach. Its two backends stand where BlueZ, CoreBluetooth or WinRT would, so that all of bleak above
them and all of pycycling run as with a machine. A `SimulatedMachine` answers as the Fitness Machine Service asks for:
control must be requested before anything else is obeyed, an indication answers each request, a reset ends control.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.client import BaseBleakClient
from bleak.backends.descriptor import BleakGATTDescriptor
from bleak.backends.device import BLEDevice
from bleak.backends.scanner import AdvertisementData, BaseBleakScanner
from bleak.backends.service import BleakGATTService, BleakGATTServiceCollection
from bleak.exc import BleakError

from echelon.play.trainer.trainer import Timing, Trainer


def uuid_of(number: int) -> str:
    return f"0000{number:04x}-0000-1000-8000-00805f9b34fb"


SERVICE, FEATURE, BIKE_DATA, CONTROL_POINT, STATUS = (uuid_of(n) for n in (0x1826, 0x2ACC, 0x2AD2, 0x2AD9, 0x2ADA))

INDOOR_BIKE, TREADMILL = 1 << 5, 1 << 0  # types of machines
REQUEST, RESET, START, SIMULATE = 0x00, 0x01, 0x07, 0x11  # requests
SUCCESS, NOT_SUPPORTED, INCORRECT, FAILED, NOT_PERMITTED = 1, 2, 3, 4, 5  # their results

SIMULATES_ROADS = bytes([0x83, 0x40, 0, 0, 0x0C, 0xE0, 0, 0])  # among what a usual trainer can
SIMULATES_NO_ROADS = bytes([0x83, 0x40, 0, 0, 0x0C, 0x00, 0, 0])

NOT_ASKED = "Echelon neither pairs with a machine nor looks at descriptors"

QUICK = Timing(
    scan=0.05,
    connect=1.0,
    answer=0.15,
    gradient=0.01,
    stale=30.0,
    first_pause=0.02,
    longest_pause=0.16,
    ask_again=0.1,
)


@dataclass
class SimulatedMachine:
    """A machine.

    Attributes:
        answers: Results by request, instead of what it would answer; None to be silent.
        written: What has been written to its control point, and when [s].
        there: Whether it advertises itself and can be connected to.
        refusals: So many connections fail.
        deaf: Whether it takes no leave: disconnecting never returns.
    """

    address: str = "C0:FF:EE:00:00:01"
    name: str = "Hub"
    signal: int = -60
    kinds: int | None = INDOOR_BIKE
    features: bytes = SIMULATES_ROADS
    characteristics: tuple[str, ...] = (FEATURE, BIKE_DATA, CONTROL_POINT, STATUS)
    answers: dict[int, int | None] = field(default_factory=dict)
    written: list[tuple[float, bytes]] = field(default_factory=list)
    there: bool = True
    refusals: int = 0
    deaf: bool = False
    connections: int = 0
    controlled: bool = False
    client: SimulatedClient | None = None

    @property
    def connected(self) -> bool:
        return self.client is not None

    @property
    def requests(self) -> list[int]:
        return [data[0] for _, data in self.written]

    @property
    def grades(self) -> list[int]:
        """The gradients that it has been told [0.01 %]."""
        return [int.from_bytes(d[3:5], "little", signed=True) for _, d in self.written if d[0] == SIMULATE]

    def notify(self, text: str, characteristic: str = BIKE_DATA) -> None:
        """Sends a notification, in hexadecimal; from the test's thread."""
        client = self.client
        assert client is not None
        client.loop.call_soon_threadsafe(client.deliver, characteristic, bytearray.fromhex(text))

    def lose(self, for_good: bool = False) -> None:
        """The connection breaks."""
        self.there = not for_good
        client = self.client
        assert client is not None
        client.loop.call_soon_threadsafe(client.drop)

    def obey(self, data: bytes) -> bytearray | None:
        """Does what has been requested, and the answer to it."""
        self.written.append((time.monotonic(), data))
        request = data[0]
        result = self.answers.get(request, SUCCESS if self.controlled or request == REQUEST else NOT_PERMITTED)
        if result is None:
            return None
        if result == SUCCESS and request in (REQUEST, RESET):
            self.controlled = request == REQUEST
        return bytearray([0x80, request, result])


class SimulatedClient(BaseBleakClient):
    """bleak's side of a connection to one of the machines in `air`."""

    air: Air

    def __init__(self, address_or_ble_device: BLEDevice | str, **settings: Any) -> None:
        super().__init__(
            address_or_ble_device,
            disconnected_callback=settings["disconnected_callback"],
            timeout=settings["timeout"],
        )
        self.machine = next(machine for machine in self.air.machines if machine.address == self.address)
        self.handlers: dict[str, Callable[[bytearray], None]] = {}
        self.loop = asyncio.get_running_loop()

    @property
    def name(self) -> str:
        return self.machine.name

    @property
    def mtu_size(self) -> int:
        return 23

    @property
    def is_connected(self) -> bool:
        return self.machine.client is self

    async def connect(self, pair: bool, **settings: Any) -> None:
        if not self.machine.there:
            raise BleakError("device is not there")
        if self.machine.refusals:
            self.machine.refusals -= 1
            raise BleakError("le-connection-abort-by-local")
        self.services = BleakGATTServiceCollection()
        service = BleakGATTService(None, 1, SERVICE)
        self.services.add_service(service)
        for handle, uuid in enumerate(self.machine.characteristics, 2):
            self.services.add_characteristic(BleakGATTCharacteristic(None, handle, uuid, [], lambda: 20, service))
        self.machine.client = self
        self.machine.controlled = False
        self.machine.connections += 1

    async def disconnect(self) -> None:
        if self.machine.deaf:
            await asyncio.Event().wait()
        self.drop()

    def drop(self) -> None:
        if self.is_connected:
            self.machine.client = None
            if self._disconnected_callback is not None:
                self._disconnected_callback()

    def deliver(self, uuid: str, data: bytearray) -> None:
        if self.is_connected and uuid in self.handlers:
            self.handlers[uuid](data)

    async def pair(self, *args: Any, **settings: Any) -> None:
        raise AssertionError(NOT_ASKED)

    async def unpair(self) -> None:
        raise AssertionError(NOT_ASKED)

    async def read_gatt_char(self, characteristic: BleakGATTCharacteristic, **settings: Any) -> bytearray:
        assert characteristic.uuid == FEATURE
        return bytearray(self.machine.features)

    async def read_gatt_descriptor(self, descriptor: BleakGATTDescriptor, **settings: Any) -> bytearray:
        raise AssertionError(NOT_ASKED)

    async def write_gatt_char(self, characteristic: BleakGATTCharacteristic, data: Any, response: bool) -> None:
        if not self.is_connected:
            raise BleakError("Not connected")
        assert characteristic.uuid == CONTROL_POINT
        assert response, "the control point takes writes with response only"
        assert CONTROL_POINT in self.handlers, "the control point must be subscribed to before it is written to"
        answer = self.machine.obey(bytes(data))
        if answer is not None:
            self.loop.call_soon(self.deliver, CONTROL_POINT, answer)

    async def write_gatt_descriptor(self, descriptor: BleakGATTDescriptor, data: Any) -> None:
        raise AssertionError(NOT_ASKED)

    async def start_notify(
        self, characteristic: BleakGATTCharacteristic, callback: Callable[[bytearray], None], **settings: Any
    ) -> None:
        self.handlers[characteristic.uuid] = callback

    async def stop_notify(self, characteristic: BleakGATTCharacteristic) -> None:
        del self.handlers[characteristic.uuid]


class SimulatedScanner(BaseBleakScanner):
    """bleak's side of a scan of `air`."""

    air: Air

    def __init__(self, detection_callback: Any, service_uuids: list[str] | None, *_: Any, **settings: Any) -> None:
        super().__init__(detection_callback, service_uuids)

    async def start(self) -> None:
        self.air.scans.append(time.monotonic())
        if self.air.broken is not None:
            raise self.air.broken
        for machine in self.air.machines:
            kinds = {} if machine.kinds is None else {SERVICE: b"\x01" + machine.kinds.to_bytes(2, "little")}
            heard = AdvertisementData(machine.name, {}, kinds, [SERVICE], None, machine.signal, ())
            if machine.there and not machine.connected and self.is_allowed_uuid(heard.service_uuids):
                device = self.create_or_update_device(machine.address, machine.address, machine.name, None, heard)
                # A scan has begun before anybody is heard.
                asyncio.get_running_loop().call_soon(self.call_detection_callbacks, device, heard)

    async def stop(self) -> None:
        pass


class Air:
    """What is in reach of the radio.

    Attributes:
        broken: What every scan raises, where there is no radio.
        scans: When scans began [s].
    """

    def __init__(self, *machines: SimulatedMachine, broken: BaseException | None = None) -> None:
        self.machines = machines
        self.broken = broken
        self.scans: list[float] = []
        self.scanner_backend = type("Scanner", (SimulatedScanner,), {"air": self})
        self.client_backend = type("Client", (SimulatedClient,), {"air": self})


def trainer_in(air: Air, **arguments: Any) -> Trainer:
    arguments = {"timing": QUICK, **arguments}
    return Trainer(scanner_backend=air.scanner_backend, client_backend=air.client_backend, **arguments)


def wait_until(condition: Callable[[], object], seconds: float = 5.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came to that"
        time.sleep(0.002)
