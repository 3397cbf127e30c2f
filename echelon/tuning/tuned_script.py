"""A script's file with other values: comments, order and everything else stay as they are."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Any

from echelon.errors import InputError
from echelon.settings import to_toml

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\]]+?)\s*\]\]?\s*(#.*)?$")
_NUMBER = r"[-+]?(?:\d[\d_]*\.?[\d_]*|\.\d+)(?:[eE][-+]?\d+)?"


def with_values(
    text: str, values: Mapping[str, float], body: str, tuned: Mapping[str, Any], source: str = "script"
) -> str:
    """A script's text with other values of parameters, another body, and what they were tuned for.

    Args:
        text: Of the script, TOML.
        values: By name of parameter.
        body: Whom it is for now.
        tuned: The table ``[tuned]``, in place of the one that there may be.
        source: For messages.

    Raises:
        InputError: The parameters stand in a way that nobody writes by hand (as one inline table, say).
    """
    lines: list[str] = []
    table, left_out = "", False
    for line in text.splitlines():
        header = _HEADER.match(line)
        if header:
            table = header[2].replace(" ", "")
            left_out = table == "tuned" or table.startswith("tuned.")
        if left_out:
            continue
        if not header and not table:
            line = re.sub(r'^(\s*body\s*=\s*)(["\']).*?\2', lambda found: f'{found[1]}"{body}"', line)
        elif not header and table == "parameters":
            line = _in_table(line, values)
        elif not header and table.startswith("parameters."):
            line = _in_own_table(line, values.get(table.removeprefix("parameters.")))
        lines.append(line)
    while lines and not lines[-1].strip():
        lines.pop()
    written = "\n".join(lines) + "\n\n" + to_toml({"tuned": dict(tuned)})
    _check(written, values, source)
    return written


def _in_table(line: str, values: Mapping[str, float]) -> str:
    """A line of [parameters]: `name = 1.0`, `name = { value = 1.0, ... }` or `name.value = 1.0`."""
    found = re.match(rf"^(\s*([A-Za-z_]\w*)(?:\.value)?\s*=\s*(?:\{{.*?\bvalue\s*=\s*)?)({_NUMBER})(.*)$", line)
    if found is None or found[2] not in values:
        return line
    return f"{found[1]}{values[found[2]]!r}{found[4]}"


def _in_own_table(line: str, value: float | None) -> str:
    found = re.match(rf"^(\s*value\s*=\s*)({_NUMBER})(.*)$", line)
    return line if found is None or value is None else f"{found[1]}{value!r}{found[3]}"


def _check(written: str, values: Mapping[str, float], source: str) -> None:
    parameters = tomllib.loads(written).get("parameters", {})
    for name, value in values.items():
        given = parameters.get(name)
        there = given.get("value") if isinstance(given, Mapping) else given
        if there != value:
            raise InputError(
                f"{source}: parameters.{name} stands where its value cannot be replaced; write it on a line of its own "
                f"under [parameters], as {name} = {{ value = {value!r}, ... }}"
            )
