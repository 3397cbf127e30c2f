"""A trainer is read, feels the road, is lost and found again, and is let go of; all of it without Bluetooth."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from echelon.play.trainer import trainer as trainer_file
from echelon.play.trainer.fitness_machine import (
    FASTEST,
    QUICKEST,
    STRONGEST,
    FitnessMachine,
    Measured,
    RoadSurface,
    bike_data_length,
)
from echelon.play.trainer.trainer import GRADIENT_LIMIT, Trainer
from tests.play.simulated_machine import (
    BIKE_DATA,
    CONTROL_POINT,
    FEATURE,
    INCORRECT,
    NOT_PERMITTED,
    NOT_SUPPORTED,
    QUICK,
    REQUEST,
    RESET,
    SIMULATE,
    SIMULATES_NO_ROADS,
    START,
    STATUS,
    Air,
    SimulatedMachine,
    trainer_in,
    wait_until,
)

# What real trainers have sent, as their owners have written it down in public bug reports.
ALL_FIELDS = "FE 02 71 07 17 07 7A 00 7A 00 05 00 00 14 00 61 00 61 00 00"  # 19.05 km/h, 61 rpm, 97 W
AT_REST = "54 08 00 00 00 00 00 00 00 00 00 31 00"
SPEED_ONLY = "00 00 10 0E"  # 36 km/h
POWER_ONLY = "41 00 FA 00"  # "more data": no speed; 250 W


@pytest.fixture
def machine() -> SimulatedMachine:
    return SimulatedMachine()


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def trainer(machine: SimulatedMachine, said: list[str], monkeypatch: pytest.MonkeyPatch) -> Iterator[Trainer]:
    """Rides the machine; the gradient changes quickly, so that tests need not wait for it."""
    monkeypatch.setattr(trainer_file, "GRADIENT_RATE", 20.0)
    with trainer_in(Air(machine), say=said.append) as ridden:
        yield ridden
    assert all(thread.name != "trainer" for thread in threading.enumerate())


# What it says


def test_nothing_has_been_heard_at_first(trainer: Trainer) -> None:
    assert trainer.reading() == (None, None, None, math.inf)
    assert trainer.connected
    assert trainer.name == "Hub"
    assert trainer.address == "C0:FF:EE:00:00:01"


def test_what_a_real_trainer_sends_is_read(trainer: Trainer, machine: SimulatedMachine) -> None:
    machine.notify(ALL_FIELDS)
    wait_until(lambda: trainer.reading().power is not None)
    reading = trainer.reading()
    assert reading.speed == pytest.approx(19.05 / 3.6)
    assert (reading.cadence, reading.power) == (61.0, 97.0)
    assert 0.0 <= reading.age < 2.0

    machine.notify(AT_REST)
    wait_until(lambda: trainer.reading().power == 0.0)
    assert trainer.reading()[:3] == (0.0, 0.0, 0.0)


def test_what_is_spread_over_two_notifications_is_put_together(trainer: Trainer, machine: SimulatedMachine) -> None:
    machine.notify(SPEED_ONLY)
    machine.notify(POWER_ONLY)
    wait_until(lambda: trainer.reading().power is not None)
    assert trainer.reading()[:3] == (pytest.approx(10.0), None, 250.0)


def test_what_is_not_said_again_is_no_longer_so(machine: SimulatedMachine) -> None:
    with trainer_in(Air(machine), timing=replace(QUICK, stale=0.05)) as trainer:
        machine.notify(ALL_FIELDS)
        wait_until(lambda: trainer.reading().age < math.inf)
        wait_until(lambda: trainer.reading()[:3] == (None, None, None))
        assert trainer.reading().age > 0.05
        assert trainer.connected


@pytest.mark.parametrize(
    "text",
    [
        "",
        "FE",
        "FE 02",
        ALL_FIELDS[:-3],  # a byte is missing
        "44 00 10 0E 7A 00 FA",  # half of the power
        "FF FF",
    ],
)
def test_half_a_notification_is_not_read(trainer: Trainer, machine: SimulatedMachine, text: str) -> None:
    machine.notify(SPEED_ONLY)
    machine.notify(text)
    machine.notify(POWER_ONLY)
    wait_until(lambda: trainer.reading().power == 250.0)
    assert trainer.reading()[:3] == (pytest.approx(10.0), None, 250.0)


def test_what_nobody_could_ride_is_not_believed(trainer: Trainer, machine: SimulatedMachine) -> None:
    machine.notify("44 00 FF FF FF FF FF 7F")  # 655 km/h, 32767 rpm, 32767 W
    wait_until(lambda: trainer.reading().age < math.inf)
    assert trainer.reading()[:3] == (None, None, None)
    machine.notify("44 00 00 00 00 00 FD FF")  # -3 W: somebody lets the flywheel turn
    wait_until(lambda: trainer.reading().power is not None)
    assert trainer.reading().power == 0.0


def test_a_trainer_that_sends_nonsense_is_told_about_once(
    trainer: Trainer, machine: SimulatedMachine, said: list[str]
) -> None:
    for _ in range(25):
        machine.notify("FE 02 71")
    machine.notify(POWER_ONLY)
    wait_until(lambda: trainer.reading().power == 250.0)
    assert said.count("the trainer sends what cannot be read") == 1


@settings(deadline=None, max_examples=300)
@given(characteristic=st.sampled_from((BIKE_DATA, CONTROL_POINT, STATUS)), data=st.binary(max_size=24))
def test_no_bytes_disturb(characteristic: str, data: bytes) -> None:
    heard: list[Measured] = []

    class Connection:
        services: Any = None

        def __init__(self) -> None:
            self.handlers: dict[str, Any] = {}

        async def read_gatt_char(self, char_specifier: Any, /) -> bytearray:
            return bytearray()

        async def write_gatt_char(self, char_specifier: Any, data: Any, response: bool | None = None) -> None:
            raise AssertionError

        async def start_notify(self, char_specifier: Any, callback: Any, /) -> None:
            self.handlers[char_specifier] = callback

    async def subscribe(machine: FitnessMachine) -> None:
        service = machine._service
        await service.enable_indoor_bike_data_notify()
        await service.enable_control_point_indicate()
        await service.enable_fitness_machine_status_notify()

    connection = Connection()
    machine = FitnessMachine(connection, heard.append, lambda _: None, RoadSurface(0.005, 0.3), 1.0, 1.0)
    asyncio.run(subscribe(machine))
    connection.handlers[characteristic](None, bytearray(data))
    if characteristic == BIKE_DATA and len(data) >= 2 and len(data) >= bike_data_length(data):
        assert len(heard) == 1
    for speed, cadence, power in heard:
        assert speed is None or 0.0 <= speed <= FASTEST
        assert cadence is None or 0.0 <= cadence <= QUICKEST
        assert power is None or 0.0 <= power <= STRONGEST


# What it feels like


def test_the_road_is_sent_as_the_service_has_it(trainer: Trainer, machine: SimulatedMachine) -> None:
    trainer.set_gradient(0.05)
    wait_until(lambda: machine.grades and machine.grades[-1] == 500)
    assert machine.requests[:3] == [REQUEST, START, SIMULATE]
    # No wind, 5.00 %, 0.0050 rolling, 0.35 kg/m: 16 bits each, the last two 8.
    assert machine.written[-1][1] == bytes.fromhex("11 0000 F401 32 23")
    trainer.set_gradient(-0.025)
    wait_until(lambda: machine.grades[-1] == -250)
    assert machine.written[-1][1] == bytes.fromhex("11 0000 06FF 32 23")


def test_the_road_is_sent_only_when_it_changes(trainer: Trainer, machine: SimulatedMachine) -> None:
    trainer.set_gradient(0.05)
    wait_until(lambda: machine.grades and machine.grades[-1] == 500)
    count = len(machine.written)
    for _ in range(20):
        trainer.set_gradient(0.05 + 1e-6)
        time.sleep(0.005)
    assert len(machine.written) == count


def test_no_road_is_steeper_than_the_limit(trainer: Trainer, machine: SimulatedMachine) -> None:
    trainer.set_gradient(3.0)
    wait_until(lambda: machine.grades and machine.grades[-1] == round(GRADIENT_LIMIT * 1e4))
    trainer.set_gradient(-3.0)
    wait_until(lambda: machine.grades[-1] == -round(GRADIENT_LIMIT * 1e4))
    assert max(map(abs, machine.grades)) == round(GRADIENT_LIMIT * 1e4)


def test_resistance_begins_flat_and_changes_slowly(machine: SimulatedMachine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trainer_file, "GRADIENT_RATE", 0.5)
    with trainer_in(Air(machine), timing=replace(QUICK, gradient=0.02)) as trainer:
        trainer.set_gradient(0.1)
        wait_until(lambda: machine.grades and machine.grades[-1] == 1000)
    rising = machine.grades[: machine.grades.index(1000) + 1]
    assert rising[0] <= 100  # a hundredth in each period
    assert all(0 < after - before <= 100 for before, after in pairwise(rising))
    times = [at for at, data in machine.written if data[0] == SIMULATE][: len(rising)]
    assert all(after - before >= 0.019 for before, after in pairwise(times))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_road_that_is_no_number_is_refused(value: float) -> None:
    trainer = Trainer()
    with pytest.raises(ValueError, match="must be finite"):
        trainer.set_gradient(value)
    with pytest.raises(ValueError, match="must be finite"):
        trainer.set_pitch(value)


def test_who_may_not_control_it_still_reads_it(machine: SimulatedMachine, said: list[str]) -> None:
    machine.answers[REQUEST] = NOT_PERMITTED
    with trainer_in(Air(machine), say=said.append) as trainer:
        trainer.set_gradient(0.05)
        machine.notify(ALL_FIELDS)
        wait_until(lambda: trainer.reading().power == 97.0)
        assert "refuses control" in trainer.note
        wait_until(lambda: machine.requests.count(REQUEST) >= 3)
        assert machine.grades == []
        assert sum("refuses control" in note for note in said) == 1

        del machine.answers[REQUEST]
        wait_until(lambda: machine.grades)
        assert trainer.note == "the trainer follows the road"


@pytest.mark.parametrize("how", ["status", "answer"])
def test_control_that_is_lost_is_asked_for_again(
    trainer: Trainer, machine: SimulatedMachine, said: list[str], how: str
) -> None:
    trainer.set_gradient(0.05)
    wait_until(lambda: machine.grades and machine.grades[-1] == 500)
    machine.controlled = False
    machine.written.clear()
    if how == "status":
        machine.notify("FF", STATUS)
    else:
        trainer.set_gradient(0.06)
    wait_until(lambda: any("refuses control" in note for note in said))
    wait_until(lambda: trainer.note == "the trainer follows the road")
    wait_until(lambda: machine.grades and machine.grades[-1] == (500 if how == "status" else 600))
    assert machine.requests.count(REQUEST) == 1


@pytest.mark.parametrize("lacking", ["feature", "control point", "answer"])
def test_a_trainer_that_simulates_no_road_is_ridden_all_the_same(
    machine: SimulatedMachine, said: list[str], lacking: str
) -> None:
    if lacking == "feature":
        machine.features = SIMULATES_NO_ROADS
    elif lacking == "control point":
        machine.characteristics = (FEATURE, BIKE_DATA)
    else:
        machine.answers[SIMULATE] = NOT_SUPPORTED
    with trainer_in(Air(machine), say=said.append) as trainer:
        for gradient in (0.01, 0.02, 0.03):
            trainer.set_gradient(gradient)
            time.sleep(0.02)
        machine.notify(ALL_FIELDS)
        wait_until(lambda: trainer.reading().power == 97.0)
        wait_until(lambda: "the trainer simulates no road; its resistance stays as it is" in said)
    assert len(machine.grades) <= 1
    assert (REQUEST in machine.requests) == (lacking == "answer")


@pytest.mark.parametrize("features", [b"", b"\x83\x40", b"\x83\x40\0\0\x0c"])
def test_half_a_feature_does_not_decide(machine: SimulatedMachine, features: bytes) -> None:
    machine.features = features
    with trainer_in(Air(machine)):
        wait_until(lambda: machine.grades)


@pytest.mark.parametrize("answer", [None, INCORRECT])
def test_a_road_that_is_not_taken_is_sent_again(
    trainer: Trainer, machine: SimulatedMachine, said: list[str], answer: int | None
) -> None:
    wait_until(lambda: machine.grades)
    machine.answers[SIMULATE] = answer
    trainer.set_gradient(0.05)
    wait_until(lambda: "the trainer does not take the road's gradient" in said)
    del machine.answers[SIMULATE]
    count = len(machine.grades)
    wait_until(lambda: len(machine.grades) > count)
    assert machine.grades[-1] == 500


@pytest.mark.parametrize("answer", ["80 07 01", "01 11 01", "80 11"])
def test_an_answer_to_something_else_is_none(
    trainer: Trainer, machine: SimulatedMachine, said: list[str], answer: str
) -> None:
    wait_until(lambda: machine.grades)
    machine.answers[SIMULATE] = None
    machine.written.clear()
    trainer.set_gradient(0.05)
    for count in (1, 2, 3):
        wait_until(lambda count=count: len(machine.grades) >= count)
        machine.notify(answer, CONTROL_POINT)
    wait_until(lambda: "the trainer does not take the road's gradient" in said)


# Lost and found


def test_a_lost_trainer_is_found_again(trainer: Trainer, machine: SimulatedMachine, said: list[str]) -> None:
    trainer.set_gradient(0.05)
    machine.notify(ALL_FIELDS)
    wait_until(lambda: trainer.reading().power == 97.0 and machine.grades and machine.grades[-1] == 500)
    machine.written.clear()
    machine.lose()
    wait_until(lambda: machine.connections == 2 and trainer.connected)
    assert any("the connection is lost; ride on by keys" in note for note in said)
    assert trainer.reading()[:3] == (None, None, None)
    machine.notify(POWER_ONLY)
    wait_until(lambda: trainer.reading().power == 250.0)
    wait_until(lambda: machine.grades and machine.grades[-1] == 500)
    assert machine.requests[:3] == [REQUEST, START, SIMULATE]


def test_readings_end_with_the_connection(trainer: Trainer, machine: SimulatedMachine) -> None:
    machine.notify(ALL_FIELDS)
    wait_until(lambda: trainer.reading().power == 97.0)
    machine.lose(for_good=True)
    wait_until(lambda: not trainer.connected)
    assert trainer.reading()[:3] == (None, None, None)
    assert trainer.reading().age < math.inf


def test_readings_end_though_an_answer_is_awaited(machine: SimulatedMachine) -> None:
    with trainer_in(Air(machine), timing=replace(QUICK, answer=2.0)) as trainer:
        wait_until(lambda: machine.grades)
        machine.answers[SIMULATE] = None
        machine.written.clear()
        machine.notify(ALL_FIELDS)
        trainer.set_gradient(0.05)
        wait_until(lambda: machine.grades and trainer.reading().power == 97.0)
        machine.lose(for_good=True)
        wait_until(lambda: trainer.reading().power is None, seconds=1.0)
        assert not trainer.connected


def test_pauses_grow_while_it_is_away(machine: SimulatedMachine, said: list[str]) -> None:
    air = Air(machine)
    with trainer_in(air, say=said.append) as trainer:
        air.scans.clear()
        machine.lose(for_good=True)
        wait_until(lambda: len(air.scans) >= 7)
        pauses = [float(note.split()[-2]) for note in said if "looked for again" in note]
        assert pauses[:6] == [0.02, 0.04, 0.08, 0.16, 0.16, 0.16]
        gaps = [after - before for before, after in pairwise(air.scans)]
        # A scan for an address takes all its time when nobody is there, and then comes the pause.
        assert all(gap >= QUICK.scan + pause for gap, pause in zip(gaps, pauses[1:], strict=False))

        machine.there = True
        wait_until(lambda: trainer.connected)
        machine.notify(ALL_FIELDS)
        wait_until(lambda: trainer.reading().power == 97.0)
        said.clear()
        machine.lose()
        wait_until(lambda: any("looked for again in 0.02 s" in note for note in said))


def test_a_radio_that_breaks_in_the_ride_does_not_end_it(machine: SimulatedMachine, said: list[str]) -> None:
    air = Air(machine)
    with trainer_in(air, say=said.append) as trainer:
        air.broken = OSError("the dongle was pulled out")
        machine.lose()
        wait_until(lambda: any("the dongle was pulled out" in note for note in said))
        air.broken = None
        wait_until(lambda: trainer.connected)


def test_the_same_machine_is_found_again_where_another_is_nearer(machine: SimulatedMachine) -> None:
    other = SimulatedMachine(address="C0:FF:EE:00:00:02", signal=-90)
    with trainer_in(Air(machine, other)) as trainer:
        other.signal = -30
        machine.lose()
        wait_until(lambda: machine.connections == 2)
        assert other.connections == 0
        assert trainer.address == machine.address


def test_a_first_connection_may_fail_and_the_next_succeed(machine: SimulatedMachine) -> None:
    machine.refusals = 2
    with trainer_in(Air(machine)) as trainer:
        assert trainer.connected


# Let go of


def test_a_trainer_is_left_on_a_flat_road(machine: SimulatedMachine) -> None:
    with trainer_in(Air(machine)) as trainer:
        trainer.set_gradient(-0.1)
        wait_until(lambda: machine.grades and machine.grades[-1] < 0)
    assert machine.grades[-1] == 0
    assert machine.requests[-2:] == [SIMULATE, RESET]
    assert not machine.connected
    assert not trainer.connected
    trainer.stop()  # once more


def test_the_thread_ends_though_the_machine_does_not_answer(machine: SimulatedMachine) -> None:
    trainer = trainer_in(Air(machine))
    trainer.start()
    machine.deaf = True
    machine.answers = {SIMULATE: None, RESET: None}
    begun = time.monotonic()
    trainer.stop()
    assert time.monotonic() - begun < 4.0
    assert all(thread.name != "trainer" for thread in threading.enumerate())


def test_the_thread_ends_in_the_middle_of_a_scan() -> None:
    air = Air()
    trainer = trainer_in(air, timing=replace(QUICK, scan=60.0))
    failures: list[BaseException] = []

    def start() -> None:
        try:
            trainer.start()
        except RuntimeError as error:
            failures.append(error)

    starter = threading.Thread(target=start)
    starter.start()
    wait_until(lambda: air.scans)
    trainer.stop()
    starter.join(5.0)
    assert [str(error) for error in failures] == ["the trainer was stopped before it was there"]
    assert all(thread.name != "trainer" for thread in threading.enumerate())


def test_a_trainer_is_started_once(trainer: Trainer) -> None:
    with pytest.raises(RuntimeError, match="make another"):
        trainer.start()


def test_what_never_started_can_be_stopped() -> None:
    Trainer().stop()


def test_a_listener_that_fails_leaves_a_note(machine: SimulatedMachine) -> None:
    def say(note: str) -> None:
        if "lost" in note:
            raise OSError("the terminal is gone")

    with trainer_in(Air(machine), say=say) as trainer:
        machine.lose()
        wait_until(lambda: "the terminal is gone" in trainer.note)
        assert trainer.reading()[:3] == (None, None, None)
