"""The grain of ground: a picture that repeats itself, so that who is near the ground sees how fast it goes by."""

from __future__ import annotations

import io
from functools import cache

import numpy as np
from PIL import Image

SIZE = 6.0  # [m] of ground that the picture covers
PIXELS = 256
SEED = 20
MEAN = 0.5  # linear: colours at points are given this many times too bright
_OCTAVES = ((4, 0.05), (13, 0.12), (37, 0.22), (96, 0.20), (256, 0.18))  # (patches across, strength)


@cache
def grain() -> bytes:
    """Grey value noise whose linear mean is `MEAN`, PNG."""
    random = np.random.default_rng(SEED)
    tone = np.zeros((PIXELS, PIXELS))
    for patches, strength in _OCTAVES:
        tone += strength * _value_noise(random.random((patches, patches)) - 0.5)
    linear = MEAN * (1.0 + tone - tone.mean())
    encoded = 1.055 * np.clip(linear, 0.0031308, 1.0) ** (1.0 / 2.4) - 0.055
    pixels = np.round(255.0 * encoded).astype(np.uint8)
    target = io.BytesIO()
    Image.fromarray(pixels).convert("RGB").save(target, "PNG", optimize=True)
    return target.getvalue()


def _value_noise(lattice: np.ndarray) -> np.ndarray:
    """A lattice of random numbers, blown up to the picture's size, smooth in between, the same at opposite edges."""
    count = len(lattice)
    place = (np.arange(PIXELS) + 0.5) * count / PIXELS
    cell = np.floor(place).astype(int)
    part = place - cell
    part = part * part * (3.0 - 2.0 * part)
    after = (cell + 1) % count
    rows = lattice[cell] + part[:, None] * (lattice[after] - lattice[cell])
    return rows[:, cell] + part * (rows[:, after] - rows[:, cell])
