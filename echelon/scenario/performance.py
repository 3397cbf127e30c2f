"""What gymnasts perform: which maneuvers, how individuals differ, when they begin, and whose bodies they have."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from echelon.settings import SettingError, Within, adopt, shown, suggestion

PERFORMERS: Mapping[str, str] = {
    "gymnast-male": "man of 22 segments who follows a script: balances, leaps, tumbles and lands",
    "gymnast-female": "woman of 22 segments who follows a script",
}
"""Characters that follow scripts, and a line about each."""


@dataclass(frozen=True)
class CastSettings:
    """Some of a troupe: whose body they have, and what they do.

    Attributes:
        character: Name of the character.
        name: What recordings and stages call them; empty for the character's name.
        share: How large a part of the crowd they are, against the shares of the others.
        height: Of the body; 0 leaves the character's own [m].
        mass: Of the body without the backpack; 0 leaves the character's own [kg].
        backpack: What is carried on the back [kg].
        maneuver: What they do; empty for what the whole troupe does.
        parameters: As those of the performance, which they go before.
    """

    character: str = "gymnast-male"
    name: str = ""
    share: Annotated[float, Within(above=0, at_most=1e6)] = 1.0
    height: Annotated[float, Within("m", at_least=0, at_most=3)] = 0.0
    mass: Annotated[float, Within("kg", at_least=0, at_most=500)] = 0.0
    backpack: Annotated[float, Within("kg", at_least=0, at_most=40)] = 0.0
    maneuver: tuple[str, ...] = ()
    parameters: dict = field(default_factory=dict)

    def __post_init__(self) -> None:
        _adopt_with_maneuvers(self, "performance.casts")
        if self.character not in PERFORMERS:
            hint = suggestion(self.character, PERFORMERS)
            raise SettingError("performance.casts.character", f" = {shown(self.character)}: no such performer{hint}")
        if self.name and not self.name.replace("-", "").replace("_", "").isalnum():
            raise SettingError(
                "performance.casts.name", f" = {shown(self.name)}: must be letters, digits, dashes and underscores"
            )


@dataclass(frozen=True)
class ScriptSettings:
    """A maneuver that is kept in the scenario itself.

    Attributes:
        name: As `maneuver` calls it.
        text: What its file holds.
    """

    name: str
    text: str

    def __post_init__(self) -> None:
        adopt(self, "performance.scripts")


@dataclass(frozen=True)
class PerformanceSettings:
    """What gymnasts perform.

    Attributes:
        maneuver: What they do: the name of a maneuver that ships or the path of a .toml file, or a list of such.
        dealing: Who does which of several: "in-turn", one after the other, or "at-random", by the population's seed.
        parameters: Parameters of the maneuvers by name: a number, or [least, most] for each to take its own.
        variation: By what share of the spread that a maneuver gives each of its parameters individuals differ.
        strength_variation: Relative spread of strength between individuals.
        delay: How long everybody waits before it begins [s].
        delay_spread: Each waits longer than that by up to this [s].
        waiting: The maneuver whose first row they do while they wait.
        heading: Which way they face, from x towards y [rad].
        lean: By how much their centre of mass starts ahead of the middle of their feet [m].
        drop: From how high above the ground their soles fall, in the posture of their maneuver's first row; 0 lets them
            stand [m].
        drop_spread: Each falls from higher than that by up to this [m].
        drop_speed: How fast they are on their way forward when they are let go [m/s].
        soft_mat: Whether the ground is a gymnastics mat underfoot, four times softer than a floor.
        joint_limits: Whether joints have soft stops where a human's end.
        strength_limits: Whether joints are no stronger than a trained human's.
        casts: Bodies that a troupe is made of; none for that of the crowd's character.
        scripts: Maneuvers that are kept here, not in files; a recording's scenario has all of them.
    """

    maneuver: tuple[str, ...] = ("stand",)
    dealing: Literal["in-turn", "at-random"] = "in-turn"
    parameters: dict = field(default_factory=dict)
    variation: Annotated[float, Within(at_least=0, at_most=100)] = 0.0
    strength_variation: Annotated[float, Within(at_least=0, at_most=0.2)] = 0.0
    delay: Annotated[float, Within("s", at_least=0, at_most=1e4)] = 0.0
    delay_spread: Annotated[float, Within("s", at_least=0, at_most=1e4)] = 0.0
    waiting: str = "stand"
    heading: Annotated[float, Within("rad", at_least=-100, at_most=100)] = 0.0
    lean: Annotated[float, Within("m", at_least=-0.2, at_most=0.2)] = 0.0
    drop: Annotated[float, Within("m", at_least=0, at_most=20)] = 0.0
    drop_spread: Annotated[float, Within("m", at_least=0, at_most=20)] = 0.0
    drop_speed: Annotated[float, Within("m/s", at_least=-10, at_most=10)] = 0.0
    soft_mat: bool = False
    joint_limits: bool = False
    strength_limits: bool = False
    casts: tuple[CastSettings, ...] = ()
    scripts: tuple[ScriptSettings, ...] = ()

    def __post_init__(self) -> None:
        _adopt_with_maneuvers(self, "performance")
        if not self.maneuver:
            raise SettingError("performance.maneuver", " = []: must name at least one maneuver")
        self._check_drop()
        names = [script.name for script in self.scripts]
        for name in names:
            if names.count(name) > 1:
                raise SettingError("performance.scripts.name", f" = {shown(name)}: stands twice; names must differ")

    def _check_drop(self) -> None:
        """Nobody waits in the air, and who stands is not on the way."""
        if self.falls:
            for key in ("delay", "delay_spread", "lean"):
                if getattr(self, key) != 0.0:
                    raise SettingError(f"performance.{key}", f" = {getattr(self, key):g}: must be 0 for who is dropped")
        elif self.drop_speed != 0.0:
            raise SettingError("performance.drop_speed", f" = {self.drop_speed:g}: needs performance.drop above 0")

    @property
    def falls(self) -> bool:
        """Whether they start in the air."""
        return self.drop + self.drop_spread > 0.0


def _adopt_with_maneuvers(record: Any, key: str) -> None:
    """`adopt`, with a maneuver alone taken for a list of one, and parameters that must be numbers or ranges."""
    if isinstance(record.maneuver, str):
        object.__setattr__(record, "maneuver", (record.maneuver,))
    adopt(record, key)
    for name, value in record.parameters.items():
        pair = value if isinstance(value, list | tuple) else [value]
        if len(pair) not in (1, 2) or not all(_is_finite(number) for number in pair):
            raise SettingError(f"{key}.parameters.{name}", f" = {shown(value)}: must be a number, or [least, most]")
        if len(pair) == 2 and pair[0] > pair[1]:
            raise SettingError(
                f"{key}.parameters.{name}", f" = {shown(value)}: the least must not be more than the most"
            )


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
