"""The machine that was meant is found, and where none can be ridden one line says why."""

from __future__ import annotations

import sys
import threading

import pytest
from bleak.exc import BleakBluetoothNotAvailableError, BleakBluetoothNotAvailableReason

from echelon.errors import InputError
from echelon.play.trainer.trainer import Trainer
from tests.play.simulated_machine import FEATURE, TREADMILL, Air, SimulatedMachine, trainer_in


def test_the_nearest_bicycle_is_ridden() -> None:
    machines = [
        SimulatedMachine(address="C0:FF:EE:00:00:01", signal=-80),
        SimulatedMachine(address="C0:FF:EE:00:00:02", signal=-55, kinds=None),  # does not say what it is
        SimulatedMachine(address="C0:FF:EE:00:00:03", signal=-55),
        SimulatedMachine(address="C0:FF:EE:00:00:04", signal=-40, kinds=TREADMILL),
    ]
    with trainer_in(Air(*machines)) as trainer:
        assert trainer.address == "C0:FF:EE:00:00:02"


def test_the_given_machine_is_ridden() -> None:
    machines = [SimulatedMachine(), SimulatedMachine(address="C0:FF:EE:00:00:02", signal=-90)]
    with trainer_in(Air(*machines), address="c0:ff:ee:00:00:02") as trainer:
        assert trainer.address == "C0:FF:EE:00:00:02"


NO_ADAPTER = BleakBluetoothNotAvailableError(
    "No Bluetooth adapters found.", BleakBluetoothNotAvailableReason.NO_BLUETOOTH
)


@pytest.mark.parametrize(
    ("address", "air", "message"),
    [
        ("nearest", Air(broken=NO_ADAPTER), "--trainer nearest: Bluetooth cannot be used here"),
        ("nearest", Air(broken=FileNotFoundError(2, "No such file")), "Bluetooth cannot be used here .*No such file"),
        ("nearest", Air(), "--trainer nearest: no bicycle trainer advertises itself"),
        ("nearest", Air(SimulatedMachine(kinds=TREADMILL)), "no bicycle trainer advertises itself"),
        ("C0:FF:EE:00:00:09", Air(SimulatedMachine()), "--trainer C0:FF:EE:00:00:09: the machine does not advertise"),
        ("C0:FF:EE:00:00:01", Air(SimulatedMachine(characteristics=(FEATURE,))), "it is no bicycle trainer"),
        ("nearest", Air(SimulatedMachine(refusals=99)), "a connection to it fails .*abort-by-local"),
        ("C0:FF:EE", Air(), "--trainer 'C0:FF:EE': must be nearest or a Bluetooth address"),
        ("", Air(), "--trainer '': must be nearest or"),
    ],
)
def test_no_trainer_is_told_in_one_line(address: str, air: Air, message: str) -> None:
    trainer = trainer_in(air, address=address)
    with pytest.raises(InputError, match=message) as caught:
        trainer.start()
    assert "\n" not in str(caught.value)
    assert all(thread.name != "trainer" for thread in threading.enumerate())


@pytest.mark.parametrize("package", ["bleak", "pycycling"])
def test_a_missing_package_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=rf"{package} is not installed; `pip install 'echelon\[trainer\]'` adds it"):
        Trainer().start()
