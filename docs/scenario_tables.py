"""Writes the tables of keys in docs/scenarios.md from the dataclasses that read a scenario file.

    python docs/scenario_tables.py          write them anew
    python docs/scenario_tables.py --check  only say whether they are up to date

Each table stands between ``<!-- table: NAME -->`` and ``<!-- end -->``; what a key means, its unit, default and bounds
come from the class of that table (`echelon.scenario`), so that they are said once. A test checks that the page is up to
date.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from echelon.scenario import (
    CHARACTERS,
    PERFORMERS,
    CastSettings,
    CollieSettings,
    ColumnFieldSettings,
    CorralSettings,
    CrowdSettings,
    EngineSettings,
    GapSettings,
    HerdSettings,
    ObstacleSettings,
    PelotonSettings,
    PerformanceSettings,
    PlatformSettings,
    Scenario,
    ScriptSettings,
    ShotSettings,
    TacticsSettings,
    UserSettings,
    WallSettings,
    WorldSettings,
)
from echelon.settings import Within, to_toml

PAGE = Path(__file__).parent / "scenarios.md"

TABLES: Mapping[str, type] = {
    "scenario": Scenario,
    "crowd": CrowdSettings,
    "herd": HerdSettings,
    "world": WorldSettings,
    "world.corral": CorralSettings,
    "world.platform": PlatformSettings,
    "world.gap": GapSettings,
    "world.column_field": ColumnFieldSettings,
    "world.walls": WallSettings,
    "collie": CollieSettings,
    "performance": PerformanceSettings,
    "performance.casts": CastSettings,
    "performance.scripts": ScriptSettings,
    "peloton": PelotonSettings,
    "peloton.tactics": TacticsSettings,
    "user": UserSettings,
    "obstacles": ObstacleSettings,
    "engine": EngineSettings,
    "shot": ShotSettings,
}

_FROM_NAME = "the file's name"


def page_with_tables(page: str) -> str:
    """The text of the page with every table written anew.

    Raises:
        ValueError: A table has no place on the page, or a place has no table.
    """
    found = re.findall(r"<!-- table: (\S+) -->", page)
    if sorted(found) != sorted(TABLES):
        raise ValueError(f"the page has places for {', '.join(found)}; the tables are {', '.join(TABLES)}")
    for name, kind in TABLES.items():
        start, end = f"<!-- table: {name} -->\n", "<!-- end -->"
        before, _, rest = page.partition(start)
        page = before + start + table(kind) + end + rest.partition(end)[2]
    return page


def table(kind: type) -> str:
    """A Markdown table of the keys of one settings class; keys that are tables of their own are left out."""
    hints, meanings = get_type_hints(kind, include_extras=True), _meanings(kind)
    rows = ["| key | default | unit | allowed | meaning |", "|---|---|---|---|---|"]
    for entry in fields(kind):
        hint = hints[entry.name]
        if any(part in TABLES.values() for part in (hint, *get_args(hint))):
            continue
        unit, allowed = _unit_and_allowed(hint, entry.name, kind)
        cells = (f"`{entry.name}`", _default(entry, kind), unit, allowed, _meaning(meanings[entry.name], entry.name))
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def _meanings(kind: type) -> dict[str, str]:
    """What the Attributes section of a class's docstring says about each key."""
    section = (inspect.getdoc(kind) or "").partition("Attributes:\n")[2]
    text = re.sub(r"\n {8,}", " ", section)  # continued lines
    pairs = re.findall(r"^ {4}([\w, ]+): (.*)$", text, flags=re.M)
    return {name.strip(): meaning for names, meaning in pairs for name in names.split(",")}


def _meaning(text: str, name: str) -> str:
    """The text without its unit, which has a column of its own; of a text that is only a unit, the name in words."""
    words = re.sub(r"\s*\[[^\]]*\](?=[.;:]|$)", "", text)
    words = re.sub(r"; see `\w+`", "", words).strip(" .")
    words = words or name.replace("_", " ")
    return words[0].upper() + words[1:]


def _default(entry: Field[Any], kind: type) -> str:
    if entry.default is MISSING:
        return _FROM_NAME if entry.name == "name" and kind is Scenario else ""
    return f"`{to_toml({'x': entry.default}).strip().removeprefix('x = ')}`"


def _unit_and_allowed(hint: Any, name: str, kind: type) -> tuple[str, str]:
    inner, within = hint, None
    if get_origin(hint) is Annotated:
        inner, within = get_args(hint)
    if get_origin(inner) is Literal:
        return "", ", ".join(f"`{to_toml({'x': option}).strip().removeprefix('x = ')}`" for option in get_args(inner))
    if name == "character":
        return "", ", ".join(f'`"{character}"`' for character in (PERFORMERS if kind is CastSettings else CHARACTERS))
    parts = (_kind_of(inner), _bounds(within) if isinstance(within, Within) else "")
    return within.unit if within else "", ", ".join(part for part in parts if part)


def _bounds(within: Within) -> str:
    """The numbers that are allowed: '0 to 100', 'above 0, at most 100'."""
    if within.at_least is not None and within.at_most is not None:
        return f"{within.at_least:.12g} to {within.at_most:.12g}"
    named = (("above", within.above), ("at least", within.at_least), ("at most", within.at_most))
    return ", ".join(f"{word} {limit:.12g}" for word, limit in named if limit is not None)


def _kind_of(hint: Any) -> str:
    """What kind of value a type stands for; nothing where the bounds say it all."""
    if get_origin(hint) is tuple:
        items = get_args(hint)
        if items == (str, ...):
            return "text, list of text"
        if items[1:] == (Ellipsis,):
            return f"list of [{', '.join('number' for _ in get_args(items[0]))}]"
        return f"[{', '.join('whole number' if item is int else 'number' for item in items)}]"
    return {bool: "`true`, `false`", int: "whole number", str: "text", dict: "table"}.get(hint, "")


def main(arguments: list[str]) -> int:
    """Write the page, or check it; returns the exit code."""
    before = PAGE.read_text(encoding="utf-8")
    after = page_with_tables(before)
    if "--check" in arguments:
        if before != after:
            print(f"{PAGE}: its tables are out of date; run python docs/scenario_tables.py", file=sys.stderr)
        return int(before != after)
    PAGE.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
