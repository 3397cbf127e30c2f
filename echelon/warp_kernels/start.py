"""Start Warp without its greeting, so that Echelon says only what its user asked about."""

from __future__ import annotations

import os
import sys
import tempfile
from functools import lru_cache

import warp as wp

from echelon.errors import InputError

_EXPECTED = b"Could not find or load the NVIDIA CUDA driver"
"""What Warp's native library prints on every machine without a GPU, whatever its log level."""


@lru_cache(maxsize=1)
def start_warp() -> None:
    """Initialise Warp; warnings and errors other than that there is no GPU are passed on.

    A program that wants to hear what Warp loads sets ``warp.config.log_level`` afterwards.
    """
    if wp.config.log_level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_WARNING
    try:
        kept = os.dup(2)
    except OSError:  # standard error is closed: nothing can be said, and nothing need be kept back
        wp.init()
        return
    with tempfile.TemporaryFile() as said:
        if sys.stderr is not None:
            sys.stderr.flush()
        os.dup2(said.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            said.seek(0)
            os.write(2, b"".join(line for line in said if _EXPECTED not in line))


def checked_device(name: str) -> str:
    """The full name of a Warp device, "cpu" or "cuda:0" and so on, by that or a shorter one.

    Raises:
        InputError: There is none of this name.
    """
    start_warp()
    known = [device.alias for device in wp.get_devices()]
    found = next((alias for alias in known if alias == name or (name == "cuda" and alias.startswith("cuda"))), None)
    if found is None:
        raise InputError(f"device {name!r}: not on this machine; must be one of {', '.join(known)}")
    return found
