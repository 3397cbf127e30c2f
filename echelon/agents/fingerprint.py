"""What a tuned script was tuned for: a fingerprint of body, contact, servos and step.

Numbers that a tuner finds are good for one body on one ground under one step. They are stored together with the
fingerprint of these, in the script's table ``[tuned]``, and one who follows such a script with something else is told
(`misfit`). What a body looks like, and what it is called, is no part of it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from echelon.agents.gymnasts.gymnast import GAINS, SPINE_GAINS, Gymnast
from echelon.agents.gymnasts.script import Script

DIGITS = 8
"""Significant digits that count: the last ones of a scaled body may differ between machines."""

_LETTERS = 12


@dataclass(frozen=True)
class Fingerprint:
    """What numbers of a script are good for.

    Attributes:
        body: Of masses, inertias and joints.
        contact: Of all contact sites.
        servos: Of the servos' gains.
        step: Length of a substep, substeps a control tick and integrator, in words.
    """

    body: str
    contact: str
    servos: str
    step: str

    def plain(self) -> dict[str, str]:
        """As it stands in a file."""
        return asdict(self)


def fingerprint(
    character: Gymnast, *, steps_per_second: int = 0, tick: int = 0, integrator: str = "semi-implicit"
) -> Fingerprint:
    """The fingerprint of a gymnast under a step.

    Args:
        character: Who.
        steps_per_second: Substeps a second, 0 for the gymnast's own.
        tick: Substeps a control tick, 0 for the gymnast's own.
        integrator: Its name.
    """
    data = character.body.to_dict()
    links = [{key: value for key, value in link.items() if key != "visuals"} for link in data["links"]]
    gains = [[list(pair) for pair in table.values()] for table in (GAINS, SPINE_GAINS)]
    steps = steps_per_second or character.steps_per_second
    return Fingerprint(
        body=_digest({"links": links, "springs": data["springs"], "gravity": data["gravity"]}),
        contact=_digest(data["contacts"]),
        servos=_digest([gains, character.gain]),
        step=f"1/{steps} s, tick of {tick or character.steps_per_tick}, {integrator}",
    )


def misfit(script: Script, here: Fingerprint) -> str:
    """One line that says in what a script's fingerprint differs from where it is followed; empty if in nothing.

    A script without a fingerprint fits everything: it was never tuned for anything.
    """
    there = script.tuned
    found = [
        f"{name} {there[name]}, not {value}"
        for name, value in here.plain().items()
        if name in there and there[name] != value
    ]
    if not found:
        return ""
    return f"{script.source}: was tuned for another {'; another '.join(found)}; `echelon tune` fits it to this one"


def _digest(data: Any) -> str:
    text = json.dumps(_rounded(data), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:_LETTERS]


def _rounded(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {key: _rounded(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_rounded(value) for value in data]
    if isinstance(data, float):
        # -0.0 and 0.0 are the same place.
        return float(f"{data:.{DIGITS}g}") + 0.0
    return data
