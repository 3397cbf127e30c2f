"""Scenario files: found by name or path, parsed, overridden key by key. What they mean is in `scenario`."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from echelon.errors import InputError
from echelon.settings import shown, suggestion


def scenario_names() -> tuple[str, ...]:
    """Names of the scenarios that ship with Echelon, in alphabetical order."""
    folder = resources.files("echelon") / "scenarios"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


def scenario_path(source: str | Path) -> Path:
    """Path of a scenario file, given as such, or of the scenario that ships under that name.

    Raises:
        InputError: It is neither the path of a .toml file nor a known name.
    """
    name = str(source)
    if name.endswith(".toml") or "/" in name or "\\" in name:
        return Path(source)
    names = scenario_names()
    if name not in names:
        raise InputError(f"scenario {shown(name)}: no such scenario and no .toml file{suggestion(name, names)}")
    with resources.as_file(resources.files("echelon") / "scenarios" / f"{name}.toml") as path:
        return path


def parse(path: Path) -> dict[str, Any]:
    """The data of a TOML file; raises InputError where there is none."""
    where = one_line(path)
    try:
        text = path.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise InputError(f"{where}: no such file; must be a scenario file (TOML)") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: not UTF-8 at byte {error.start}; must be a scenario file (TOML)") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{where}: cannot be read ({reason}); must be a scenario file (TOML)") from None
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else one_line(error)
        raise InputError(f"{where}: not valid TOML: {reason}") from None


def one_line(value: object) -> str:
    """A path, name or message as text without line breaks or control characters."""
    text = str(value)
    return text if text.isprintable() else shown(text)


def copied(value: Any) -> Any:
    """A deep copy of plain data, so that overrides never reach the caller's."""
    if isinstance(value, Mapping):
        return {key: copied(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [copied(inner) for inner in value]
    return value


def override(data: dict[str, Any], text: str) -> str:
    """Set one "dotted.key=value" in ``data``; returns the key."""
    key, equals, value = text.partition("=")
    key = key.strip()
    parts = key.split(".")
    if not equals or not all(parts):
        raise InputError(f"--set {one_line(text)}: must be key=value, the key dotted, as in herd.spacing=3")
    try:
        parsed = tomllib.loads(f"value = {value.strip()}")
        setting = parsed["value"] if set(parsed) == {"value"} else value.strip()
    except (tomllib.TOMLDecodeError, RecursionError, ValueError):
        setting = value.strip()
    table = data
    for index, part in enumerate(parts[:-1]):
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise InputError(f"--set {one_line(text)}: {'.'.join(parts[: index + 1])} is not a table")
    table[parts[-1]] = setting
    return key
