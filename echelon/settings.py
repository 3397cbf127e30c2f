"""Frozen dataclasses as a file format: plain data in, typed and checked values out, and back to TOML.

A *settings class* is a frozen dataclass whose annotations say what may stand in a file. ``adopt(self, key)``, called
from its ``__post_init__``, turns lists into tuples and whole numbers into floats where a float is meant, and refuses
everything else, so that an object built in Python is checked exactly like one that was read from a file.

The annotations understood: ``bool``, ``int``, ``float``, ``str``, ``Literal[...]``, ``tuple[float, float]``,
``tuple[tuple[float, float], ...]`` and the like, another settings class, ``dict`` (any table), and ``... | None``
(absent).
A number's unit and bounds stand beside it: ``Annotated[float, Within("m", above=0)]``.
"""

from __future__ import annotations

import difflib
import math
import tomllib
import types
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from echelon.errors import InputError


class SettingError(InputError):
    """A setting that cannot be; ``key`` is its dotted name, so that a reader can say where it came from."""

    def __init__(self, key: str, message: str) -> None:
        name = key if key.isprintable() and len(key) <= 120 else shown(key)
        super().__init__(f"{name}{message}" if key else f"the whole{message}")
        self.key = key


@dataclass(frozen=True)
class Within:
    """The unit of a setting and the numbers it may take; of a list, each of its numbers.

    Stands in an annotation: ``spacing: Annotated[float, Within("m", above=0)] = 2.5``.
    """

    unit: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None

    def allows(self, value: float) -> bool:
        """Whether ``value`` lies inside."""
        return (
            (self.above is None or value > self.above)
            and (self.at_least is None or value >= self.at_least)
            and (self.at_most is None or value <= self.at_most)
        )

    def __str__(self) -> str:
        limits = (("above", self.above), ("at least", self.at_least), ("at most", self.at_most))
        text = " and ".join(f"{word} {limit:.12g}" for word, limit in limits if limit is not None)
        return f"{text} {self.unit}".rstrip()


def shown(value: Any) -> str:
    """``value`` on one line of bounded length, for a message."""
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def suggestion(word: str, known: Iterable[str]) -> str:
    """'; did you mean X?' where one of ``known`` is near, and the whole list where none is."""
    names = sorted(known)
    near = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    return f"; did you mean {near[0]!r}?" if near else f"; known are {', '.join(names)}"


def adopt(record: Any, key: str) -> None:
    """Check and convert every field of a settings object, in place, from its ``__post_init__``.

    Args:
        record: The frozen dataclass instance.
        key: Dotted name of the table it stands for, empty for the top of the file.

    Raises:
        SettingError: A value of the wrong type, not finite, or out of bounds.
    """
    hints = get_type_hints(type(record), include_extras=True)
    for entry in fields(record):
        here = f"{key}.{entry.name}" if key else entry.name
        kind, given = hints[entry.name], getattr(record, entry.name)
        if get_origin(kind) is not Annotated:
            object.__setattr__(record, entry.name, _converted(kind, given, here))
            continue
        inner, within = get_args(kind)
        value = _converted(inner, given, here)
        for number in _numbers(value):
            if not within.allows(number):
                raise SettingError(here, f" = {shown(given)}: must be {within}")
        object.__setattr__(record, entry.name, value)


def read(kind: type, data: Any, key: str = "") -> Any:
    """Build a settings object from plain data; keys that it does not know are errors.

    Args:
        kind: The settings class.
        data: A mapping, as tomllib or json give it.
        key: Dotted name of the table, for messages.

    Raises:
        SettingError: ``data`` is no table, holds an unknown key, lacks a required one, or holds a bad value.
    """
    if not isinstance(data, Mapping):
        raise SettingError(key, f" = {shown(data)}: must be a table")
    known = {entry.name: entry for entry in fields(kind)}
    for name in data:
        if name not in known:
            here = f"{key}.{name}" if key else str(name)
            raise SettingError(here, f": unknown key{suggestion(str(name), known)}")
    for name, entry in known.items():
        if name not in data and entry.default is MISSING and entry.default_factory is MISSING:
            raise SettingError(f"{key}.{name}" if key else name, ": is missing")
    return kind(**data)


def plain(value: Any) -> Any:
    """Settings as dicts, lists, numbers and strings; what is None is left out."""
    if is_dataclass(value) and not isinstance(value, type):
        pairs = ((entry.name, getattr(value, entry.name)) for entry in fields(value))
        return {name: plain(inner) for name, inner in pairs if inner is not None}
    if isinstance(value, tuple):
        return [plain(inner) for inner in value]
    if isinstance(value, dict):
        return {name: plain(inner) for name, inner in value.items()}
    return value


def to_toml(data: Mapping[str, Any]) -> str:
    """Plain data as TOML text that tomllib reads back to the same data.

    Args:
        data: Dicts with string keys, lists, strings, booleans, integers and finite floats.
    """
    return "\n".join(_toml_table(data, "")).strip() + "\n"


# ---- from plain data -----------------------------------------------------------------------------------------------
def _converted(kind: Any, value: Any, key: str) -> Any:
    """``value`` as the type ``kind``; raises SettingError where it is something else."""
    origin = get_origin(kind)
    if origin in (Union, types.UnionType):
        inner = [option for option in get_args(kind) if option is not type(None)]
        return None if value is None else _converted(inner[0], value, key)
    if origin is Literal:
        return _choice(get_args(kind), value, key)
    if origin is tuple:
        return _tuple(get_args(kind), value, key)
    if is_dataclass(kind):
        return value if isinstance(value, kind) else read(kind, value, key)  # type: ignore[arg-type]
    if kind is float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise SettingError(key, f" = {shown(value)}: must be a number")
        return _finite(value, key)
    name = {bool: "true or false", int: "a whole number", str: "a string", dict: "a table"}[kind]
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise SettingError(key, f" = {shown(value)}: must be {name}")
    if kind is str and not value.isascii():
        try:
            value.encode()
        except UnicodeEncodeError:
            raise SettingError(key, f" = {shown(value)}: must be valid Unicode") from None
    return value


def _finite(value: float, key: str) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise SettingError(key, f" = {shown(value)}: must be a finite number")
    return number


def _choice(options: tuple[Any, ...], value: Any, key: str) -> Any:
    for option in options:
        if type(option) is type(value) and option == value:
            return option
    allowed = ", ".join(shown(option) for option in options)
    near = difflib.get_close_matches(value, [str(option) for option in options], n=1) if isinstance(value, str) else []
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise SettingError(key, f" = {shown(value)}: must be one of {allowed}{hint}")


def _tuple(items: tuple[Any, ...], value: Any, key: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise SettingError(key, f" = {shown(value)}: must be a list")
    if len(items) == 2 and items[1] is Ellipsis:
        return tuple(_converted(items[0], inner, f"{key}[{index}]") for index, inner in enumerate(value))
    if len(value) != len(items):
        raise SettingError(key, f" = {shown(value)}: must be a list of {len(items)}")
    return tuple(
        _converted(item, inner, f"{key}[{index}]") for index, (item, inner) in enumerate(zip(items, value, strict=True))
    )


def _numbers(value: Any) -> Iterable[float]:
    """Every number in a value, however deep."""
    if isinstance(value, tuple):
        for inner in value:
            yield from _numbers(inner)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield value


# ---- to TOML -------------------------------------------------------------------------------------------------------
def _toml_table(data: Mapping[str, Any], path: str) -> list[str]:
    """Lines of one table: its own values first, as TOML asks, then its tables and lists of tables."""
    lines: list[str] = []
    for key, value in data.items():
        if not isinstance(value, Mapping) and not _are_tables(value):
            lines.append(f"{_toml_key(key)} = {_toml_value(value)}")
    for key, value in data.items():
        inner = f"{path}.{_toml_key(key)}" if path else _toml_key(key)
        if isinstance(value, Mapping):
            lines += ["", f"[{inner}]", *_toml_table(value, inner)]
        elif _are_tables(value):
            for entry in value:
                lines += ["", f"[[{inner}]]", *_toml_table(entry, inner)]
    return lines


def _are_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(entry, Mapping) for entry in value)


def _toml_key(key: str) -> str:
    bare = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if bare else _toml_string(key)


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _toml_string(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml_value(inner) for inner in value) + "]"
    return repr(value)


def _toml_string(text: str) -> str:
    escapes = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r"}
    letters = (
        escapes.get(c, c if c.isprintable() or c == " " else f"\\u{ord(c):04x}" if ord(c) < 0x10000 else c)
        for c in text
    )
    return '"' + "".join(letters) + '"'


# ---- files -----------------------------------------------------------------------------------------------------------
def text_of(path: Path) -> str:
    """The text of a file.

    Raises:
        InputError: One line that says why it cannot be read.
    """
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8: {error.reason}") from None
    except (OSError, ValueError) as error:
        name = str(path) if str(path).isprintable() else repr(str(path))
        raise InputError(f"{name}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


def toml_of(text: str, source: str) -> dict[str, Any]:
    """The data of a TOML text; `source` names it in messages.

    Raises:
        InputError: One line that says what is wrong with it.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{source}: is not TOML: nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{source}: is not TOML: {' '.join(str(error).split())}") from None
