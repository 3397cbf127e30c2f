"""Which fitness machine to ride: scanning, by bleak, for who advertises the Fitness Machine Service.

This file needs the extra `trainer`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

from bleak import BleakScanner
from bleak.backends.device import BLEDevice
from bleak.backends.scanner import AdvertisementData

from echelon.play.trainer.machine_address import NEAREST

FITNESS_MACHINE = "00001826-0000-1000-8000-00805f9b34fb"
"""The Fitness Machine Service."""

INDOOR_BIKE = 1 << 5
"""The bit of an indoor bike in the types that a machine advertises."""

GRACE = 10.0  # beyond a scan's own time, within which a Bluetooth service that is there has answered [s]


class RadioError(Exception):
    """No machine can be ridden; the message is the reason, in one line."""


def reason_of(error: BaseException) -> str:
    """Why, in one line."""
    return " ".join(str(error).split()) or type(error).__name__


async def find_machine(address: str, seconds: float, backend: Any = None) -> BLEDevice:
    """The machine at an address, or the nearest one.

    Args:
        address: Of a device, or `NEAREST`.
        seconds: For which to scan; a device at an address is found sooner.
        backend: bleak's scanner for another radio than this machine's own (a class); None for its own.

    Raises:
        RadioError: There is none, or Bluetooth cannot be used here.
    """
    options: dict[str, Any] = {} if backend is None else {"backend": backend}
    try:
        async with asyncio.timeout(seconds + GRACE):
            if address == NEAREST:
                seen = await BleakScanner.discover(seconds, return_adv=True, service_uuids=[FITNESS_MACHINE], **options)
                device = nearest(seen.values())
            else:
                device = await BleakScanner.find_device_by_address(address, seconds, **options)
    # bleak raises what the system's own Bluetooth raises: its errors, D-Bus's, those of sockets and files.
    except Exception as error:
        raise RadioError(
            f"Bluetooth cannot be used here ({reason_of(error)}); is there an adapter, switched on, "
            "and its service running?"
        ) from error
    if device is None:
        who = "no bicycle trainer advertises itself" if address == NEAREST else "the machine does not advertise itself"
        raise RadioError(
            f"{who} (listened for {seconds:g} s); wake it by pedalling, and end other programs that hold it"
        )
    return device


def nearest(seen: Iterable[tuple[BLEDevice, AdvertisementData]]) -> BLEDevice | None:
    """Of the bicycles among machines the one with the strongest signal, and of equals the first by address."""
    bicycles = [(-heard.rssi, device.address, device) for device, heard in seen if is_bicycle(heard)]
    return min(bicycles, key=lambda bicycle: bicycle[:2])[2] if bicycles else None


def is_bicycle(heard: AdvertisementData) -> bool:
    """Whether who advertises may be a bicycle: treadmills and rowing machines advertise the same service.

    Beside the service a machine advertises flags, one byte, and types, two bytes. Some leave that out.
    """
    if FITNESS_MACHINE not in heard.service_uuids:
        return False
    kinds = heard.service_data.get(FITNESS_MACHINE, b"")
    return len(kinds) < 3 or bool(int.from_bytes(kinds[1:3], "little") & INDOOR_BIKE)
