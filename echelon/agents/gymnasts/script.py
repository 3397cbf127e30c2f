"""Scripts of gymnasts: a TOML file becomes the table of numbers that the engine follows.

A maneuver is a file. It names *parameters* and *rows*; a row says what to move where, how stiffly, under which
feedback, and what leads on to which other row:

    name = "vertical-leap"
    body = "male"                                   # whom it was tuned for
    title = "A vertical leap of half a metre"

    [parameters]                                    # numbers with names, to be tuned and varied
    crouch = 0.60
    hip_end = { value = -0.1, spread = 0.01, least = -0.6, most = 0.4 }

    [[row]]
    name = "crouch"
    phase = "crouch"                                # one of the gymnast's phases
    duration = 0.5                                  # of all paths of this row [s]
    pose = "tuck"                                   # channels that have a name together, see poses.toml
    legs = { length = "crouch", pitch = 0.64 }      # hip, knee, ankle for a distance from hip to ankle, eq. 7.5, 7.6,
                                                    # and a pitch of the trunk, or else the hip's angle as `hip`;
                                                    # with com_x, ankles that put the centre of mass so far ahead of
                                                    # the middle of the feet; slope and tilt: how steeply the ground
                                                    # rises ahead and to the left [rad]
    channels = { shoulder = -0.6, elbow = 0.2 }     # see channels.py
    durations = { shoulder = 0.3 }
    gains = { hip = 0.77, ankle = [4.45, 1.0] }     # kp, or kp and kv, times the usual
    settings = { balance = 1, com_x = 0.02 }        # see gymnast.SETTINGS
    start = "measured"                              # paths start from what is measured, not from what was wanted
    capture = { vz = [-2.0, 2.0] }                  # what should hold on arrival
    next = [{ to = "push", when = { row_age = [0.6, inf], com_x = [0.0, 0.1] } }]

Rows stand in order; the first begins. Wherever a number stands in a row, a string may: a formula (see `formulas`) of
parameters and of ``leg``, which is how far the ankle is from the hip when the leg is straight [m].
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, get_args

import numpy as np

from echelon.agents.gymnasts.body import Sex, leg_geometry
from echelon.agents.gymnasts.channels import CHANNELS, GROUPS, SIDED, SIDES, channels_named
from echelon.agents.gymnasts.formulas import formula
from echelon.agents.gymnasts.gymnast import ARMS_SPREAD, SETTINGS, Gymnast
from echelon.agents.gymnasts.measures import MEASURES
from echelon.agents.gymnasts.poses import poses
from echelon.agents.gymnasts.posture import balanced_legs, leg_angles
from echelon.errors import InputError
from echelon.settings import shown, suggestion, text_of, toml_of
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.scripts import CAPTURES, CLAUSE_SIZE, CLAUSES, TRANSITION_SIZE, TRANSITIONS, ScriptLayout

_SHIPPED = resources.files("echelon.agents.gymnasts") / "maneuvers"
ROW_KEYS: Mapping[str, Any] = {
    "name": str,
    "phase": str,
    "duration": (int, float, str),
    "durations": dict,
    "pose": str,
    "legs": dict,
    "channels": dict,
    "gains": dict,
    "settings": dict,
    "start": str,
    "capture": dict,
    "next": list,
}
SHAPES: Mapping[Any, str] = {
    str: "text",
    (int, float, str): "a number or a formula of parameters",
    dict: "a table",
    list: "a list of tables",
}
FILE_KEYS = ("name", "title", "description", "body", "parameters", "row", "tuned")
PARAMETER_KEYS = ("value", "spread", "least", "most", "unit", "about")
STARTS = ("wanted", "measured")
LEG = ("hip", "knee", "ankle")
DEFAULT_DURATION = 0.3  # of a path where a row does not say [s]


@dataclass(frozen=True)
class Parameter:
    """A number of a script that can be tuned and varied.

    Attributes:
        value: Usual value.
        spread: By how much individuals differ from it, to either side, evenly.
        least, most: A tuner looks between these.
        about: What it is, for people.
    """

    value: float
    spread: float = 0.0
    least: float = -math.inf
    most: float = math.inf
    about: str = ""


@dataclass(frozen=True)
class Script:
    """A maneuver as its file gives it; `table` makes numbers of it.

    Attributes:
        name, title, description: For people.
        body: Whom it was tuned for.
        parameters: By name.
        rows: As parsed, in order.
        source: Where it came from, for messages.
        tuned: What its parameters were tuned for, as `echelon tune` writes it (see `fingerprint`); empty if they were
            not.
    """

    name: str
    title: str
    description: str
    body: str
    parameters: Mapping[str, Parameter]
    rows: tuple[Mapping[str, Any], ...]
    source: str
    tuned: Mapping[str, Any] = field(default_factory=dict)

    @property
    def row_names(self) -> tuple[str, ...]:
        return tuple(row["name"] for row in self.rows)

    def table(self, body: Body, values: Mapping[str, float] | None = None) -> np.ndarray:
        """The script as the engine follows it.

        Args:
            body: Whose legs `legs` is about.
            values: Parameters that differ from the script's own, by name.

        Returns:
            Shape [rows, row size], float32, laid out as `Gymnast.script` says.

        Raises:
            InputError: A parameter that the script does not have, or an expression without a value.
        """
        for name in values or {}:
            _known(self.source, "parameters", name, tuple(self.parameters))
        numbers = {name: parameter.value for name, parameter in self.parameters.items()} | dict(values or {})
        leg = leg_geometry(body)
        numbers["leg"] = leg.thigh + leg.shank
        writer = _TableWriter(self, Gymnast.script, body, numbers)
        return np.array([writer.row(place, row) for place, row in enumerate(self.rows)], dtype=np.float32)

    def varied(self, count: int, seed: int, share: float = 1.0) -> list[dict[str, float]]:
        """Values of parameters for individuals that differ by `share` of each parameter's spread, evenly.

        Individual i does not depend on the count.
        """
        names = [name for name, parameter in self.parameters.items() if parameter.spread > 0.0]
        width = max(len(names), 1)
        bits = np.random.Philox(key=seed).random_raw(count * width).reshape(count, width)
        uniform = (bits >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0
        values = np.array([self.parameters[name].value for name in names])
        spreads = np.array([self.parameters[name].spread for name in names])
        return [
            dict(zip(names, (values + share * spreads * row[: len(names)]).tolist(), strict=True)) for row in uniform
        ]

    def with_values(self, values: Mapping[str, float]) -> Script:
        """This script with other usual values of some parameters."""
        for name in values:
            _known(self.source, "parameters", name, tuple(self.parameters))
        parameters = {
            name: Parameter(values.get(name, p.value), p.spread, p.least, p.most, p.about)
            for name, p in self.parameters.items()
        }
        return Script(self.name, self.title, self.description, self.body, parameters, self.rows, self.source)


def maneuver_names() -> tuple[str, ...]:
    """Names of the maneuvers that ship, in alphabetical order."""
    return tuple(sorted(Path(e.name).stem for e in _SHIPPED.iterdir() if e.name.endswith(".toml")))


def load_script(name_or_path: str | Path) -> Script:
    """A maneuver that ships, by name, or a file's.

    Raises:
        InputError: One line naming the file, the key and what is allowed.
    """
    return parse_script(*script_text(name_or_path))


def script_text(name_or_path: str | Path) -> tuple[str, str]:
    """The text of a maneuver that ships, by name, or of a file, and what to call it in messages.

    Raises:
        InputError: One line naming the file and what is allowed.
    """
    if str(name_or_path) in maneuver_names():
        return (_SHIPPED / f"{name_or_path}.toml").read_text("utf-8"), f"{name_or_path}.toml"
    path = Path(name_or_path)
    if path.suffix != ".toml":
        hint = suggestion(str(name_or_path), maneuver_names())
        raise InputError(f"maneuver {str(name_or_path)!r}: no such maneuver and no .toml file{hint}")
    return text_of(path), str(path)


def parse_script(text: str, source: str) -> Script:
    """A script from the text of a TOML file; `source` names it in messages.

    Raises:
        InputError: One line naming the file, the key and what is allowed.
    """
    data = toml_of(text, source)
    for key in data:
        _known(source, "the file", key, FILE_KEYS)
    rows = data.get("row", [])
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{source}: needs rows, each a table that begins with [[row]]")
    for place, row in enumerate(rows):
        row.setdefault("name", f"row {place + 1}")
        for key, given in row.items():
            _known(source, f"row {place + 1}", key, tuple(ROW_KEYS))
            if not isinstance(given, ROW_KEYS[key]):
                raise InputError(f"{source}: row {place + 1}, {key} = {shown(given)}: must be {SHAPES[ROW_KEYS[key]]}")
    names = [row["name"] for row in rows]
    twice = [name for place, name in enumerate(names) if name in names[:place]]
    if twice:
        raise InputError(f"{source}: row name {twice[0]!r} stands twice; names must differ")
    given = data.get("parameters", {})
    if not isinstance(given, dict):
        raise InputError(f"{source}: parameters = {shown(given)}: must be a table")
    parameters = {name: _parameter(source, name, value) for name, value in given.items()}
    _known(source, "body", data.get("body", "male"), get_args(Sex))
    script = Script(
        name=str(data.get("name", Path(source).stem)),
        title=str(data.get("title", "")),
        description=str(data.get("description", "")),
        body=str(data.get("body", "male")),
        parameters=parameters,
        rows=tuple(rows),
        source=source,
        tuned=_tuned(source, data.get("tuned", {})),
    )
    _check(script)
    return script


# ---- from rows to numbers --------------------------------------------------------------------------------------------
class _TableWriter:
    """Makes numbers of a script's rows, for one body and one set of parameters."""

    def __init__(self, script: Script, layout: ScriptLayout, body: Body, numbers: Mapping[str, float]) -> None:
        self.script = script
        self.layout = layout
        self.body = body
        self.numbers = numbers
        # Where channels are by the rows so far: rows are written in order.
        self.posture: dict[str, float] = {f"{side}_shoulder_spread": ARMS_SPREAD for side in SIDES}
        self.setting_places = {name: layout.setting_place + i for i, name in enumerate(layout.settings)}

    def value(self, where: str, given: Any, bound: bool = False) -> float:
        return _number(self.script.source, where, given, self.numbers, bound)

    def row(self, place: int, row: Mapping[str, Any]) -> list[float]:
        where = f"row {row['name']!r}"
        layout = self.layout
        numbers = [math.nan] * layout.row_size
        targets = self._targets(where, row)
        usual = self.value(f"{where}, duration", row.get("duration", DEFAULT_DURATION))
        durations = {
            channel: self.value(f"{where}, durations.{name}", given)
            for name, given in row.get("durations", {}).items()
            for channel in _channels(self.script.source, f"{where}, durations", name)
        }
        self.posture |= targets
        for i, channel in enumerate(layout.channels):
            numbers[i] = targets.get(channel, math.nan)
            numbers[layout.duration_place + i] = max(durations.get(channel, usual), 1e-3)
        for name, value in self._settings(where, row).items():
            numbers[self.setting_places[name]] = value
        numbers[layout.start_place] = float(row.get("start", "wanted") == "measured")
        numbers[layout.phase_place] = float(Gymnast.phase_names.index(row.get("phase", "standing")))
        for i in range(TRANSITIONS):
            at = layout.transition_place + i * TRANSITION_SIZE
            given = row.get("next", [])
            numbers[at] = -1.0
            clauses: Mapping[str, Any] = {}
            if i < len(given):
                numbers[at] = float(self.script.row_names.index(given[i]["to"]))
                clauses = given[i].get("when", {})
            self._clauses(f"{where}, next", clauses, numbers, at + 1, CLAUSES)
        self._clauses(f"{where}, capture", row.get("capture", {}), numbers, layout.capture_place, CAPTURES)
        return numbers

    def _targets(self, where: str, row: Mapping[str, Any]) -> dict[str, float]:
        targets: dict[str, float] = dict(poses()[row["pose"]]) if "pose" in row else {}
        if "legs" in row:
            targets |= self._legs(where, row, targets)
        for name, given in row.get("channels", {}).items():
            for channel in _channels(self.script.source, f"{where}, channels", name):
                targets[channel] = self.value(f"{where}, channels.{name}", given)
        return targets

    def _legs(self, where: str, row: Mapping[str, Any], targets: Mapping[str, float]) -> dict[str, float]:
        """Channels of both legs for what the row asks of them."""
        legs = {name: self.value(f"{where}, legs.{name}", given) for name, given in row["legs"].items()}
        leg = leg_geometry(self.body)
        slope, tilt = legs.get("slope", 0.0), legs.get("tilt", 0.0)
        if "com_x" in legs:
            # Where this row leaves the rest of the body.
            elsewhere = {**self.posture, **targets}
            for name, given in row.get("channels", {}).items():
                for channel in _channels(self.script.source, f"{where}, channels", name):
                    elsewhere[channel] = self.value(f"{where}, channels.{name}", given)
            pitch, com_x = legs.get("pitch", 0.0), legs["com_x"]
            try:
                hip, knee, ankle = balanced_legs(self.body, leg, legs["length"], pitch, com_x, elsewhere)
            except InputError as error:
                raise InputError(f"{self.script.source}: {where}, legs: {error}") from None
            return {
                f"{side}_{name}": x for side in SIDES for name, x in zip(LEG, (hip, knee, ankle - slope), strict=True)
            }
        found: dict[str, float] = {}
        for side, uphill in (("left", 1.0), ("right", -1.0)):
            # On ground that rises to the left, the left leg is as much shorter as it stands higher.
            length = legs["length"] - max(uphill * math.tan(tilt), 0.0) * 2.0 * abs(leg.hip_offset)
            hip, knee, ankle = leg_angles(leg, length)
            hip = legs.get("hip", hip) - legs.get("pitch", 0.0)
            found |= {f"{side}_hip": hip, f"{side}_knee": knee, f"{side}_ankle": ankle - slope}
            if tilt != 0.0:
                found[f"{side}_ankle_roll"] = uphill * tilt
        return found

    def _settings(self, where: str, row: Mapping[str, Any]) -> dict[str, float]:
        settings = dict(self.layout.settings)
        for group, given in row.get("gains", {}).items():
            pair = given if isinstance(given, list) else [given, 1.0]
            for part, value in zip(("kp", "kv"), pair, strict=True):
                settings[f"{part}.{group}"] = self.value(f"{where}, gains.{group}", value)
        for name, given in row.get("settings", {}).items():
            settings[name] = self.value(f"{where}, settings.{name}", given)
        return settings

    def _clauses(self, where: str, clauses: Mapping[str, Any], numbers: list[float], at: int, count: int) -> None:
        filled = list(clauses.items())
        for i in range(count):
            measure, least, most = -1.0, 0.0, 0.0
            if i < len(filled):
                name, (low, high) = filled[i]
                measure = float(self.layout.measures.index(name))
                least, most = (self.value(f"{where}.{name}", bound, bound=True) for bound in (low, high))
            numbers[at + i * CLAUSE_SIZE : at + (i + 1) * CLAUSE_SIZE] = [measure, least, most]


# ---- what is allowed -------------------------------------------------------------------------------------------------
def _check(script: Script) -> None:
    """Every name that a script uses exists, and every expression has a value with the usual parameters."""
    source, names = script.source, script.row_names
    numbers = {name: parameter.value for name, parameter in script.parameters.items()} | {"leg": 1.0}
    for row in script.rows:
        where = f"row {row['name']!r}"
        if row.get("phase", "standing") not in Gymnast.phase_names:
            _known(source, f"{where}, phase", row["phase"], Gymnast.phase_names)
        if row.get("start", "wanted") not in STARTS:
            _known(source, f"{where}, start", row["start"], STARTS)
        if "pose" in row:
            _known(source, f"{where}, pose", row["pose"], tuple(poses()))
        if "duration" in row:
            _number(source, f"{where}, duration", row["duration"], numbers)
        for key in ("durations", "channels"):
            for name, given in row.get(key, {}).items():
                _channels(source, f"{where}, {key}", name)
                _number(source, f"{where}, {key}.{name}", given, numbers)
        for name, given in row.get("legs", {}).items():
            _known(source, f"{where}, legs", name, ("length", "hip", "pitch", "com_x", "slope", "tilt"))
            _number(source, f"{where}, legs.{name}", given, numbers)
        if "legs" in row and "length" not in row["legs"]:
            raise InputError(f"{source}: {where}, legs: needs a length [m]")
        for name, given in row.get("gains", {}).items():
            _known(source, f"{where}, gains", name, GROUPS)
            pair = given if isinstance(given, list) else [given, 1.0]
            if len(pair) != 2:
                raise InputError(f"{source}: {where}, gains.{name} = {given!r}: must be kp, or [kp, kv]")
            for value in pair:
                _number(source, f"{where}, gains.{name}", value, numbers)
        for name, given in row.get("settings", {}).items():
            _known(source, f"{where}, settings", name, tuple(SETTINGS))
            _number(source, f"{where}, settings.{name}", given, numbers)
        _check_clauses(source, f"{where}, capture", row.get("capture", {}), CAPTURES, numbers)
        transitions = row.get("next", [])
        if not isinstance(transitions, list) or len(transitions) > TRANSITIONS:
            raise InputError(f"{source}: {where}, next: must be a list of at most {TRANSITIONS} transitions")
        for transition in transitions:
            if not isinstance(transition, Mapping):
                raise InputError(
                    f"{source}: {where}, next: {shown(transition)} must be a table with the row it leads to"
                )
            for key in transition:
                _known(source, f"{where}, next", key, ("to", "when"))
            if "to" not in transition:
                raise InputError(f"{source}: {where}, next: a transition needs the row that it leads to")
            _known(source, f"{where}, next", transition["to"], names)
            _check_clauses(source, f"{where}, next", transition.get("when", {}), CLAUSES, numbers)


def _check_clauses(source: str, where: str, clauses: Any, count: int, numbers: Mapping[str, float]) -> None:
    if not isinstance(clauses, Mapping) or len(clauses) > count:
        raise InputError(f"{source}: {where}: must be at most {count} measures with their ranges")
    for name, given in clauses.items():
        _known(source, where, name, MEASURES)
        if not isinstance(given, list) or len(given) != 2:
            raise InputError(f"{source}: {where}.{name} = {given!r}: must be [least, most]")
        for value in given:
            _number(source, f"{where}.{name}", value, numbers, bound=True)


def _parameter(source: str, name: str, given: Any) -> Parameter:
    if not name.isidentifier() or name in ("leg", "pi"):
        raise InputError(
            f"{source}: parameters: {name!r} must be a word of letters, digits and underscores, not leg or pi"
        )
    if isinstance(given, int | float) and not isinstance(given, bool):
        return Parameter(_number(source, f"parameters.{name}", given, {}))
    if not isinstance(given, Mapping) or "value" not in given:
        raise InputError(f"{source}: parameters.{name} = {given!r}: must be a number, or a table with a value")
    for key in given:
        _known(source, f"parameters.{name}", key, PARAMETER_KEYS)
    numbers = {
        key: _number(source, f"parameters.{name}.{key}", given.get(key, usual), {}, bound=key in ("least", "most"))
        for key, usual in (("value", 0.0), ("spread", 0.0), ("least", -math.inf), ("most", math.inf))
    }
    if numbers["spread"] < 0.0 or not numbers["least"] <= numbers["value"] <= numbers["most"]:
        raise InputError(f"{source}: parameters.{name}: spread must not be negative, nor value beyond least and most")
    return Parameter(**numbers, about=str(given.get("about", "")))


def _tuned(source: str, given: Any) -> Mapping[str, Any]:
    if not isinstance(given, Mapping):
        raise InputError(f"{source}: tuned = {given!r}: must be a table, as `echelon tune` writes it")
    return given


def _channels(source: str, where: str, name: str) -> tuple[str, ...]:
    channels = channels_named(name)
    if not channels:
        _known(source, where, name, (*SIDED, *CHANNELS))
    return channels


def _known(source: str, where: str, name: Any, allowed: Sequence[str]) -> None:
    if name not in allowed:
        raise InputError(f"{source}: {where}: {shown(name)} is not known{suggestion(str(name), allowed)}")


def _number(source: str, where: str, given: Any, numbers: Mapping[str, float], bound: bool = False) -> float:
    """A number, or the value of a formula of parameters; a bound may be infinite."""
    if isinstance(given, str):
        found = formula(f"{source}: {where}", given)
        for name in found.names:
            _known(source, f"{where} = {given!r}", name, tuple(numbers))
        value = float(found.value(numbers))
    elif isinstance(given, int | float) and not isinstance(given, bool):
        value = float(given)
    else:
        raise InputError(f"{source}: {where} = {shown(given)}: must be a number or a formula of parameters")
    if math.isnan(value) or (math.isinf(value) and not bound):
        raise InputError(f"{source}: {where} = {given!r}: is {value}, must be a finite number")
    return value
