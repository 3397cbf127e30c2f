"""How a person says which machine to ride: by address, or the nearest."""

from __future__ import annotations

import re

from echelon.errors import InputError

NEAREST = "nearest"
"""Instead of an address: the machine whose signal is strongest."""

# Six bytes; macOS tells programs a UUID instead.
_ADDRESS = re.compile(r"(?:[0-9A-F]{2}:){5}[0-9A-F]{2}|[0-9A-F]{8}(?:-[0-9A-F]{4}){3}-[0-9A-F]{12}", re.IGNORECASE)


def check_address(text: str) -> str:
    """The address, as it is.

    Raises:
        InputError: It is neither an address nor `NEAREST`.
    """
    if text != NEAREST and not _ADDRESS.fullmatch(text):
        raise InputError(f"--trainer {text!r}: must be {NEAREST} or a Bluetooth address like C0:FF:EE:01:23:45")
    return text
