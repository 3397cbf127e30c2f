"""Who is in a scenario: the casts, each a character with its part of the crowd.

Agents of one cast share a body, and an engine computes one body (its numbers are constants of the compiled program), so
a crowd of several casts has an engine for each. Nothing else is special about it: the agents are numbered through, cast
after cast, every engine knows the number of its first, and what they see of one another is in arrays that the engines
share. In one frame each engine carries its own across; the recording has them in one table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from echelon.agents.characters import character_named
from echelon.agents.gymnasts.body import Sex
from echelon.agents.gymnasts.gymnast import Gymnast, gymnast
from echelon.scenario import CastSettings, Scenario
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.frame import Engine


@dataclass(frozen=True)
class CastPart:
    """The agents of a crowd who share a character.

    Attributes:
        name: What the recording calls them.
        character: Who.
        first: Number of the first of them in the crowd.
        count: How many.
        settings: Those of the scenario; None where the crowd is of one kind.
    """

    name: str
    character: Character
    first: int
    count: int
    settings: CastSettings | None = None

    @property
    def agents(self) -> range:
        """Their numbers in the crowd."""
        return range(self.first, self.first + self.count)


def casts_of(scenario: Scenario) -> tuple[CastPart, ...]:
    """Who is in a scenario, in the order of their numbers; casts without an agent are left out.

    Raises:
        InputError: There is no such character, or no such body.
    """
    performance = scenario.performance
    casts = performance.casts if performance is not None else ()
    limits = (False, False, False)
    if performance is not None:
        limits = (performance.soft_mat, performance.joint_limits, performance.strength_limits)
    count = scenario.crowd.count
    if not casts:
        character = _character(scenario.crowd.character, 0.0, 0.0, 0.0, *limits)
        return (CastPart(character.name, character, 0, count),)
    parts: list[CastPart] = []
    first = 0
    for cast, size in zip(casts, _sizes([cast.share for cast in casts], count), strict=True):
        if size:
            character = _character(cast.character, cast.height, cast.mass, cast.backpack, *limits)
            name = _unused(cast.name or cast.character, [part.name for part in parts])
            parts.append(CastPart(name, character, first, size, cast))
            first += size
    return tuple(parts)


@lru_cache(maxsize=32)
def _character(
    name: str, height: float, mass: float, backpack: float, mat: bool, joint_limits: bool, strength_limits: bool
) -> Gymnast | Character:
    """A character of a size; made once, so that what was traced and compiled for it is found again."""
    if not (height or mass or backpack or mat or joint_limits or strength_limits):
        return character_named(name)
    sex: Sex = "female" if name.endswith("-female") else "male"
    return gymnast(
        sex,
        backpack=backpack,
        height=height or None,
        mass=mass or None,
        name=name,
        mat=mat,
        joint_limits=joint_limits,
        strength_limits=strength_limits,
    )


def _sizes(shares: Sequence[float], count: int) -> list[int]:
    """How many of so many each share gets: all together as many, those with the largest remainders one more."""
    parts = np.array(shares) / sum(shares) * count
    sizes = np.floor(parts + 1e-9).astype(int)
    for index in np.argsort(-(parts - sizes), kind="stable")[: count - int(sizes.sum())].tolist():
        sizes[index] += 1
    return sizes.tolist()


def _unused(name: str, taken: Sequence[str]) -> str:
    """The name, with a number where it is taken."""
    found, number = name, 1
    while found in taken:
        number += 1
        found = f"{name}-{number}"
    return found


def share_public(engines: Sequence[Engine]) -> None:
    """Let engines of one crowd write into the same arrays what agents see of one another, before they are bound."""
    for engine in engines[1:]:
        engine.public = engines[0].public
        engine.command = engines[0].command


def joined_states(engines: Sequence[Engine]) -> dict[str, np.ndarray]:
    """The full states of engines by name, with a row for each agent of all of them.

    Raises:
        ValueError: Their states are not laid out alike.
    """
    states = [engine.full_state() for engine in engines]
    if len(states) == 1:
        return states[0]
    if any(engine.layout != engines[0].layout for engine in engines):
        raise ValueError("the casts of a crowd need characters whose states are laid out alike")
    return {name: np.concatenate([state[name] for state in states]) for name in states[0]}
