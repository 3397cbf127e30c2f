"""What a sweep runs: every combination of the parameters' values, each with every seed, in an order that never changes.

The parameters vary as the digits of a number do, the last the fastest; seeds are the fastest of all. A run's number in
that order is its name in the sweep's folder.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from echelon.errors import InputError
from echelon.scenario import Scenario
from echelon.scenario.files import one_line
from echelon.settings import shown, to_toml

RUN_LIMIT = 1_000_000
"""Runs of a sweep, at most: each leaves a file."""

_SEED_LIMIT = 2**31 - 1


@dataclass(frozen=True)
class Axis:
    """A key of the scenario and the values that it is to take.

    Attributes:
        key: Dotted, as in a scenario file.
        texts: The values as TOML writes them; a string needs no quotes.
        values: The same as plain data.
    """

    key: str
    texts: tuple[str, ...]
    values: tuple[Any, ...]


@dataclass(frozen=True)
class PlannedRun:
    """One run of a sweep.

    Attributes:
        number: In the sweep's order.
        parameters: Value of each axis, by key.
        seed: Of what happens at random.
        scenario: All of it, plain data.
    """

    number: int
    parameters: Mapping[str, Any]
    seed: int
    scenario: Mapping[str, Any]


@dataclass(frozen=True)
class Plan:
    """All of a sweep.

    Attributes:
        name: Of the scenario.
        axes: In the order in which they were given.
        seeds: In the order in which they were given.
        runs: In order.
    """

    name: str
    axes: tuple[Axis, ...]
    seeds: tuple[int, ...]
    runs: tuple[PlannedRun, ...]

    @property
    def keys(self) -> tuple[str, ...]:
        """The axes' keys."""
        return tuple(axis.key for axis in self.axes)


def plan_sweep(
    scenario: str | PathLike[str] | Scenario,
    axes: Sequence[Axis],
    seeds: Sequence[int] | None,
    settings: Sequence[str] = (),
) -> Plan:
    """Every run, each checked as a scenario before the first one starts.

    Args:
        scenario: Name of one that ships, path of a .toml file, or a `Scenario`.
        axes: What varies beside the seed.
        seeds: None takes the scenario's own.
        settings: "dotted.key=value" each, for all runs.

    Raises:
        InputError: There is nothing to vary, something is said twice, there are too many runs, or a combination is no
            valid scenario.
    """
    if not axes and seeds is None:
        raise InputError("a sweep needs something that varies: --over key=value,value or --seeds 1-10")
    _check_said_once(axes, seeds, settings)
    count = len(seeds or (0,))
    for axis in axes:
        count *= len(axis.texts)
    if count > RUN_LIMIT:
        raise InputError(f"the sweep has {count} runs; must be at most {RUN_LIMIT}")
    runs: list[PlannedRun] = []
    name, own_seeds = "", tuple(seeds or ())
    for texts in itertools.product(*(axis.texts for axis in axes)):
        overrides = [*settings, *(f"{axis.key}={text}" for axis, text in zip(axes, texts, strict=True))]
        point = _scenario(scenario, overrides)
        name, own_seeds = point.name, own_seeds or (point.seed,)
        data = point.to_dict()
        places = zip(axes, texts, strict=True)
        parameters = {axis.key: axis.values[axis.texts.index(text)] for axis, text in places}
        runs += [
            PlannedRun(len(runs) + index, parameters, seed, {**data, "seed": seed})
            for index, seed in enumerate(own_seeds)
        ]
    return Plan(name, tuple(axes), own_seeds, tuple(runs))


def _scenario(source: str | PathLike[str] | Scenario, overrides: Sequence[str]) -> Scenario:
    if isinstance(source, Scenario):
        return Scenario.from_dict(source.to_dict(), source=source.name, overrides=overrides)
    return Scenario.load(Path(source) if isinstance(source, PathLike) else source, overrides)


def _check_said_once(axes: Sequence[Axis], seeds: Sequence[int] | None, settings: Sequence[str]) -> None:
    keys = [axis.key for axis in axes]
    for key in keys:
        if keys.count(key) > 1:
            raise InputError(f"--over {key}: is given twice")
        if key == "seed":
            raise InputError("--over seed: seeds are given by --seeds, as in --seeds 1-10")
    for text in settings:
        key = text.partition("=")[0].strip()
        if key in keys or (key == "seed" and seeds is not None):
            raise InputError(f"--set {one_line(text)}: the sweep varies {key}")


# ---- what people write -----------------------------------------------------------------------------------------------
def axis_of_text(text: str) -> Axis:
    """An axis from "dotted.key=value,value"; commas inside of brackets and quotes belong to a value.

    Raises:
        InputError: It is not of that form, or holds a value twice.
    """
    key, equals, values = text.partition("=")
    if not equals or not all(key.strip().split(".")) or not values.strip():
        raise InputError(f"--over {one_line(text)}: must be key=value,value, as in herd.spacing=2,2.5,3")
    return _axis(key.strip(), _split(values))


def axis_of_values(key: str, values: Iterable[Any]) -> Axis:
    """An axis from plain data.

    Raises:
        InputError: A value cannot stand in a scenario file, there is none, or one is given twice.
    """
    texts = []
    for value in values:
        if not isinstance(value, bool | int | float | str | list | tuple):
            raise InputError(f"{key} = {shown(value)}: must be a number, a string, true or false, or a list of them")
        texts.append(to_toml({"value": value}).partition("=")[2].strip())
    if not texts:
        raise InputError(f"{key}: must have at least one value to sweep over")
    return _axis(key, texts)


def seeds_of_text(text: str) -> tuple[int, ...]:
    """Seeds from "1-10" or "1,2,5-9".

    Raises:
        InputError: It is not of that form, or holds a seed twice.
    """
    found: list[int] = []
    for part in text.split(","):
        first, dash, last = (piece.strip() for piece in part.partition("-"))
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise InputError(f"--seeds {one_line(text)}: must be seeds or ranges of seeds, as in 1-10 or 1,2,5-9")
        low, high = int(first), int(last) if dash else int(first)
        if high < low:
            raise InputError(f"--seeds {one_line(text)}: {low}-{high} runs backwards")
        if high - low >= RUN_LIMIT:
            raise InputError(f"--seeds {one_line(text)}: must be at most {RUN_LIMIT} seeds")
        found += range(low, high + 1)
    return checked_seeds(found)


def checked_seeds(seeds: Iterable[int]) -> tuple[int, ...]:
    """Seeds as they may be: whole numbers, each once.

    Raises:
        InputError: They are not.
    """
    found = tuple(seeds)
    for seed in found:
        if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed <= _SEED_LIMIT:
            raise InputError(f"seed {shown(seed)}: must be a whole number from 0 to {_SEED_LIMIT}")
    if not found or len(set(found)) < len(found):
        raise InputError("--seeds: " + ("a seed is given twice" if found else "must be at least one"))
    return found


def _axis(key: str, texts: Sequence[str]) -> Axis:
    values = tuple(_value(text) for text in texts)
    for index, value in enumerate(values):
        if any(type(value) is type(other) and value == other for other in values[:index]):
            raise InputError(f"--over {one_line(key)}: the value {shown(value)} is given twice")
        if isinstance(value, dict):
            raise InputError(f"--over {one_line(key)}: {shown(value)}: must be a number, a string, a truth or a list")
    return Axis(key, tuple(texts), values)


def _value(text: str) -> Any:
    """What a scenario would read, as `echelon.scenario.files.override` does."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError, ValueError):
        return text
    return parsed["value"] if set(parsed) == {"value"} else text


def _split(text: str) -> list[str]:
    """The values between the commas that stand outside of brackets and quotes."""
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter in "[{":
            depth += 1
        elif letter in "]}":
            depth -= 1
        elif letter == "," and depth == 0:
            parts.append("")
            continue
        parts[-1] += letter
    parts = [part.strip() for part in parts]
    if not all(parts):
        raise InputError(f"--over ...={one_line(text)}: a value is empty")
    return parts
