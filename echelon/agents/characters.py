"""The characters that a crowd can be made of, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial

from echelon.agents.gymnasts.gymnast import gymnast
from echelon.agents.hopper import Hopper
from echelon.agents.point_mass import PointMass
from echelon.agents.riders.cyclist import Cyclist
from echelon.errors import InputError
from echelon.warp_kernels.character import Character

CHARACTERS: Mapping[str, Callable[[], Character]] = {
    "hopper": Hopper,
    "cyclist": Cyclist,
    "cyclist-1995": partial(Cyclist, fifteen_segments=True),
    "point-mass": PointMass,
    "gymnast-male": partial(gymnast, "male"),
    "gymnast-female": partial(gymnast, "female"),
}


@cache
def character_named(name: str) -> Character:
    """The character of a name; made once, so that what was traced and compiled for it is found again.

    Raises:
        InputError: There is no such character.
    """
    if name not in CHARACTERS:
        raise InputError(f"character {name!r}: must be one of {', '.join(CHARACTERS)}")
    return CHARACTERS[name]()
