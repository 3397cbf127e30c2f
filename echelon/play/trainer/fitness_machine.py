"""A conversation with a bicycle trainer over one Bluetooth connection, by pycycling.

The Fitness Machine Service has three characteristics that matter here:

    Indoor Bike Data (0x2AD2)   the machine notifies: speed, cadence, power, as flags say which
    Feature (0x2ACC)            read once: can it simulate a road?
    Control Point (0x2AD9)      a request is written, its answer comes as an indication: 80, the request, a result

and a fourth, Status (0x2ADA), in which it says that it no longer obeys. The order is: subscribe to data, read the
features, subscribe to answers, request control, start; then the road as often as it changes. In the end the road is
made flat and the machine reset, so that nobody is left with the resistance of a climb.

pycycling reads and writes the bytes. It takes them as they come, so that half a notification would be read as zeros;
`Listening` stands between the connection and it, and lets no such notification through.

This file needs the extra `trainer`. Source of the bytes: Bluetooth SIG, "Fitness Machine Service", 1.0.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple, Protocol

from pycycling.fitness_machine_service import (
    FitnessMachineService,
    ftms_fitness_machine_control_point_characteristic_id,
    ftms_fitness_machine_status_characteristic_id,
    ftms_indoor_bike_data_characteristic_id,
)
from pycycling.ftms_parsers import (
    ControlPointResponse,
    FitnessMachineStatusMessage,
    FTMSControlPointOpCode,
    IndoorBikeData,
)
from pycycling.ftms_parsers import FTMSControlPointResponseResultCode as Result
from pycycling.ftms_parsers.fitness_machine_status import FitnessMachineStatus

from echelon.play.trainer.bluetooth import RadioError

BIKE_DATA = ftms_indoor_bike_data_characteristic_id
CONTROL_POINT = ftms_fitness_machine_control_point_characteristic_id
STATUS = ftms_fitness_machine_status_characteristic_id

FASTEST = 45.0  # that anybody rides [m/s]
QUICKEST = 250.0  # that anybody pedals [rpm]
STRONGEST = 3000.0  # that anybody is [W]

UNREADABLE_ENOUGH = 10  # notifications in a row, after which the person is told
UNANSWERED_ENOUGH = 3  # roads in a row, likewise

# Bytes of each field of Indoor Bike Data, from bit 1 of the flags on. Bit 0 set means that there is no speed.
FIELDS = (2, 2, 2, 3, 2, 2, 2, 5, 1, 1, 2, 2)
SPEED_BYTES = 2


class Measured(NamedTuple):
    """What one notification says; None is what it does not say, or what nobody could ride.

    Attributes:
        speed: Of the wheel [m/s].
        cadence: Of the cranks [rpm].
        power: Of the rider [W].
    """

    speed: float | None
    cadence: float | None
    power: float | None


class RoadSurface(NamedTuple):
    """What a trainer is told of the road beside its gradient.

    Attributes:
        rolling: Rolling resistance over weight.
        drag: Drag coefficient times frontal area times density of the air [kg/m].
    """

    rolling: float
    drag: float


class Connection(Protocol):
    """What is used of a `bleak.BleakClient`."""

    @property
    def services(self) -> Any: ...
    async def read_gatt_char(self, char_specifier: Any, /) -> bytearray: ...
    async def write_gatt_char(self, char_specifier: Any, data: Any, response: bool | None = None) -> None: ...
    async def start_notify(self, char_specifier: Any, callback: Callable[[Any, bytearray], None], /) -> None: ...


def bike_data_length(data: bytes | bytearray) -> int:
    """How many bytes a notification of Indoor Bike Data has at least, from its flags."""
    flags = int.from_bytes(data[:2], "little")
    speed = 0 if flags & 1 else SPEED_BYTES
    return 2 + speed + sum(size for bit, size in enumerate(FIELDS, 1) if flags >> bit & 1)


def is_complete(characteristic: str, data: bytes | bytearray) -> bool:
    """Whether a notification is as long as it says that it is."""
    if characteristic == BIKE_DATA:
        return len(data) >= max(2, bike_data_length(data))
    if characteristic == CONTROL_POINT:
        return len(data) >= 3 and data[0] == FTMSControlPointOpCode.RESPONSE_CODE.value
    return len(data) >= 1


def measured(data: IndoorBikeData) -> Measured:
    """What a notification says, in our units; speed is in km/h there."""
    speed, cadence, power = data.instant_speed, data.instant_cadence, data.instant_power
    return Measured(
        speed=None if speed is None or speed / 3.6 > FASTEST else speed / 3.6,
        cadence=None if cadence is None or cadence > QUICKEST else cadence,
        power=None if power is None or abs(power) > STRONGEST else max(0.0, float(power)),
    )


class Listening:
    """The connection as pycycling sees it: notifications that cannot be read do not come through.

    Attributes:
        unreadable: How many there were.
    """

    def __init__(self, connection: Connection, say: Callable[[str], None]) -> None:
        self.unreadable = 0
        self._connection = connection
        self._say = say
        self._in_a_row = 0

    async def read_gatt_char(self, characteristic: str) -> bytearray:
        """What a characteristic holds."""
        return await self._connection.read_gatt_char(characteristic)

    async def write_gatt_char(self, characteristic: str, data: bytes, response: bool) -> None:
        """Writes to a characteristic."""
        await self._connection.write_gatt_char(characteristic, data, response)

    async def start_notify(self, characteristic: str, handler: Callable[[Any, bytearray], None]) -> None:
        """Has what a characteristic notifies handled."""

        def check(sender: Any, data: bytearray) -> None:
            readable = is_complete(characteristic, data)
            if readable:
                try:
                    handler(sender, data)
                # pycycling's readers raise these on codes that the service does not have.
                except (ValueError, IndexError, TypeError):
                    readable = False
            self._in_a_row = 0 if readable else self._in_a_row + 1
            self.unreadable += not readable
            if self._in_a_row == UNREADABLE_ENOUGH:
                self._say("the trainer sends what cannot be read")

        await self._connection.start_notify(characteristic, check)


class FitnessMachine:
    """The machine at the other end of a connection.

    Attributes:
        controlled: Whether it obeys.
        listening: What stands between the connection and pycycling.
    """

    def __init__(
        self,
        connection: Connection,
        hear: Callable[[Measured], None],
        say: Callable[[str], None],
        surface: RoadSurface,
        patience: float,
        ask_again: float,
    ) -> None:
        """
        Args:
            connection: A `bleak.BleakClient`, connected.
            hear: Called with each notification of data.
            say: Called with one line when the machine begins or ceases to obey.
            surface: Of the road.
            patience: How long to wait for an answer [s].
            ask_again: How long after it has refused control to ask again [s].
        """
        self.controlled = False
        self.listening = Listening(connection, say)
        self._connection = connection
        self._service = FitnessMachineService(self.listening)
        self._service.set_indoor_bike_data_handler(lambda data: hear(measured(data)))
        self._service.set_control_point_response_handler(self._answered)
        self._service.set_fitness_machine_status_handler(self._status)
        self._say = say
        self._surface = surface
        self._patience = patience
        self._ask_again = ask_again
        self._simulates = True
        self._ask_at: float | None = None  # once control has been refused or lost
        self._unanswered = 0
        self._awaited: tuple[FTMSControlPointOpCode, asyncio.Future[Result]] | None = None

    async def begin(self) -> None:
        """Has it send data, and takes control of it if it lets us.

        Raises:
            RadioError: It is no bicycle.
            bleak.exc.BleakError: The connection fails.
        """
        if not self._has(BIKE_DATA):
            raise RadioError("it is no bicycle trainer: it has no Indoor Bike Data")
        await self._service.enable_indoor_bike_data_notify()
        if not self._has(CONTROL_POINT) or not await self._simulates_roads():
            self._simulates = False
            self._say("the trainer simulates no road; its resistance stays as it is")
            return
        await self._service.enable_control_point_indicate()
        if self._has(STATUS):
            await self._service.enable_fitness_machine_status_notify()
        await self._take_control()

    async def set_gradient(self, gradient: float) -> bool:
        """Has the trainer resist as a road with this gradient, rise over run; whether it does.

        Raises:
            bleak.exc.BleakError: The connection fails.
        """
        if not self._simulates:
            return False
        if not self.controlled and self._ask_at is not None and asyncio.get_running_loop().time() >= self._ask_at:
            await self._take_control()
        if not self.controlled:
            return False
        answer = await self._ask(
            FTMSControlPointOpCode.SET_INDOOR_BIKE_SIMULATION_PARAMETERS,
            lambda: self._service.set_simulation_parameters(
                0,  # wind [0.001 m/s]
                round(gradient * 1e4),  # [0.01 %]
                min(255, round(self._surface.rolling * 1e4)),
                min(255, round(self._surface.drag * 1e2)),
            ),
        )
        if answer is Result.SUCCESS:
            self._unanswered = 0
            return True
        if answer is Result.NOT_SUPPORTED:
            self._simulates = False
            self._say("the trainer simulates no road; its resistance stays as it is")
        elif answer is Result.CONTROL_NOT_PERMITTED:
            self._lose_control()
        else:
            self._unanswered += 1
            if self._unanswered == UNANSWERED_ENOUGH:
                self._say("the trainer does not take the road's gradient")
        return False

    async def end(self) -> None:
        """Leaves the trainer on a flat road, and lets go of it.

        Raises:
            bleak.exc.BleakError: The connection fails.
        """
        if self.controlled:
            await self.set_gradient(0.0)
            await self._ask(FTMSControlPointOpCode.RESET, self._service.reset)
            self.controlled = False

    def _has(self, characteristic: str) -> bool:
        return self._connection.services.get_characteristic(characteristic) is not None

    async def _simulates_roads(self) -> bool:
        try:
            return (await self._service.get_target_setting_feature()).indoor_bike_simulation_parameters_supported
        except IndexError:
            # Half a feature says nothing; what the machine answers to a road will.
            return True

    async def _take_control(self) -> None:
        """Asks for control, and starts the machine; some do not resist before."""
        if await self._ask(FTMSControlPointOpCode.REQUEST_CONTROL, self._service.request_control) is not Result.SUCCESS:
            self._lose_control()
            return
        self.controlled = True
        # The result says no more than whether it had been started before.
        await self._ask(FTMSControlPointOpCode.START_OR_RESUME, self._service.start_or_resume)
        if self._ask_at is not None and self.controlled:
            self._say("the trainer follows the road")

    def _lose_control(self) -> None:
        if self.controlled or self._ask_at is None:
            self._say("the trainer refuses control (does another program hold it?); its resistance stays as it is")
        self.controlled = False
        self._ask_at = asyncio.get_running_loop().time() + self._ask_again

    async def _ask(self, request: FTMSControlPointOpCode, write: Callable[[], Awaitable[None]]) -> Result | None:
        """The machine's answer to a request, or None if it has none."""
        answer: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
        self._awaited = (request, answer)
        try:
            async with asyncio.timeout(self._patience):
                await write()
                return await answer
        except TimeoutError:
            return None
        finally:
            self._awaited = None

    def _answered(self, response: ControlPointResponse) -> None:
        if self._awaited is None:
            return
        request, answer = self._awaited
        # The answer to a request that we no longer wait for may come late; it is not the one to this.
        if response.request_code_enum is request and not answer.done():
            answer.set_result(response.result_code_enum)

    def _status(self, message: FitnessMachineStatusMessage) -> None:
        if message.status is FitnessMachineStatus.CONTROL_PERMISSION_LOST and self.controlled:
            self._lose_control()
