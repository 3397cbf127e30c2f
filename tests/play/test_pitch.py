"""A motion platform never leaves its limits, moves no faster than it may, and ends level."""

from __future__ import annotations

import asyncio
import math
import socket
import time
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from echelon.errors import InputError
from echelon.play.trainer.pitch import OUTPUT_RATE, PITCH_LIMIT, PITCH_RATE, DatagramPitch, PitchChannel
from tests.play.simulated_machine import Air, SimulatedMachine, trainer_in, wait_until

STEP = 1.0 / OUTPUT_RATE


def silent(_: str) -> None:
    raise AssertionError("nothing is wrong")


@given(targets=st.lists(st.floats(-1e30, 1e30), min_size=1, max_size=40))
def test_no_target_leads_beyond_the_limits(targets: list[float]) -> None:
    sent = [(0, 0.0)]  # the platform is level before the first step
    outputs: list[float] = []
    channel = PitchChannel(outputs.append, silent)
    for step, target in enumerate(targets, 1):
        channel.set(target)
        channel.step(STEP)
        if outputs:
            sent.append((step, outputs.pop()))
    assert max(abs(angle) for _, angle in sent) <= PITCH_LIMIT
    for (before, start), (after, end) in pairwise(sent):
        assert abs(end - start) <= PITCH_RATE * STEP * (after - before) * (1.0 + 1e-9)


def test_twelve_degrees_take_more_than_half_a_second() -> None:
    sent: list[float] = []
    channel = PitchChannel(sent.append, silent)
    channel.set(math.radians(40.0))
    for _ in range(60):
        channel.step(STEP)
    assert sent[-1] == PITCH_LIMIT
    assert sent.index(PITCH_LIMIT) == 17  # the eighteenth of 30 a second, at 20 degrees a second


def test_a_still_road_is_sent_once_a_second() -> None:
    sent: list[float] = []
    channel = PitchChannel(sent.append, silent)
    for _ in range(int(3 * OUTPUT_RATE)):
        channel.step(STEP)
    assert sent == [0.0, 0.0, 0.0]


def test_small_changes_are_not_sent_but_level_is() -> None:
    sent: list[float] = []
    channel = PitchChannel(sent.append, silent)
    channel.set(0.02)
    for _ in range(5):
        channel.step(STEP)
    count = len(sent)
    channel.set(0.02 + 1e-5)
    channel.step(STEP)
    assert len(sent) == count
    asyncio.run(channel.level())
    assert sent[-1] == 0.0


def test_a_broken_platform_is_told_about_and_tried_again() -> None:
    said: list[str] = []
    broken = True
    sent: list[float] = []

    def output(angle: float) -> None:
        if broken:
            raise OSError("no platform")
        sent.append(angle)

    channel = PitchChannel(output, said.append)
    channel.set(0.1)
    for _ in range(3):
        channel.step(STEP)
    assert said == ["the motion platform does not hear: no platform"]
    assert channel.failures == 3
    broken = False
    channel.step(STEP)
    assert len(sent) == 1
    broken = True
    channel.step(STEP)
    assert len(said) == 2


@pytest.fixture
def platform() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(5.0)
        yield listener


@pytest.mark.parametrize(
    ("degrees", "datagram"), [(0.0, b"0.00"), (-0.001, b"0.00"), (-3.25, b"-3.25"), (12.0, b"12.00"), (4.567, b"4.57")]
)
def test_a_datagram_is_a_number_of_degrees(platform: socket.socket, degrees: float, datagram: bytes) -> None:
    with DatagramPitch.at(f"127.0.0.1:{platform.getsockname()[1]}") as pitch:
        pitch(math.radians(degrees))
    assert platform.recv(64) == datagram


def test_a_port_alone_is_on_this_machine(platform: socket.socket) -> None:
    with DatagramPitch.at(str(platform.getsockname()[1])) as pitch:
        pitch(0.0)
    assert platform.recvfrom(64)[1][0] == "127.0.0.1"


def test_nobody_need_listen(platform: socket.socket) -> None:
    port = platform.getsockname()[1]
    platform.close()
    with DatagramPitch(port) as pitch:
        for _ in range(3):
            pitch(0.1)


@pytest.mark.parametrize(
    "text", ["", "nine", "localhost", "127.0.0.1:", "127.0.0.1:0", "70000", "-1", "a..b:9000", "٣"]
)
def test_where_no_platform_can_be(text: str) -> None:
    with pytest.raises(InputError, match="pitch") as caught:
        DatagramPitch.at(text)
    assert "\n" not in str(caught.value)


def test_the_platform_follows_the_ride_and_ends_level(platform: socket.socket) -> None:
    machine = SimulatedMachine()
    with DatagramPitch(platform.getsockname()[1]) as pitch, trainer_in(Air(machine), pitch=pitch) as trainer:
        trainer.set_pitch(math.radians(3.0))
        received: list[float] = []
        while not received or received[-1] != 3.0:
            received.append(float(platform.recv(64)))
        machine.lose(for_good=True)  # the platform needs no trainer
        wait_until(lambda: not trainer.connected)
        trainer.set_pitch(math.radians(-1.0))
        while received[-1] != -1.0:
            received.append(float(platform.recv(64)))
        begun = time.monotonic()
        trainer.stop()
        assert time.monotonic() - begun < 3.0
    while received[-1] != 0.0:
        received.append(float(platform.recv(64)))
    assert np.abs(np.diff(received, prepend=0.0)).max() <= 20.0 / OUTPUT_RATE + 0.011
