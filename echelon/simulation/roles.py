"""Who performs what: the maneuver of each gymnast, with parameters of its own, and when it begins.

Everything here follows from the scenario, which holds the text of every maneuver once `with_scripts` has put it there:
a recording can be gone on with, or simulated again, whatever has become of the files.

An agent's numbers come from counters by its own number: they do not depend on how many others there are.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.measures import MEASURES
from echelon.agents.gymnasts.script import Script, parse_script, script_text
from echelon.errors import InputError
from echelon.scenario import PerformanceSettings, Scenario, ScriptSettings
from echelon.settings import suggestion
from echelon.simulation.casts import CastPart
from echelon.simulation.performance import padded
from echelon.warp_kernels.scripts import CLAUSE_SIZE, CLAUSES, TRANSITION_SIZE, TRANSITIONS

WAITING = "waiting"
"""Name of the row in which who begins later stands until then."""


@dataclass(frozen=True)
class Role:
    """What one gymnast does.

    Attributes:
        maneuver: Its name.
        script: The maneuver.
        values: Of its parameters, where they differ from the usual.
        delay: How long it stands before [s].
        waits: Whether its table has a row for that, before the script's own.
    """

    maneuver: str
    script: Script
    values: Mapping[str, float]
    delay: float
    waits: bool

    @property
    def row_names(self) -> tuple[str, ...]:
        """Of the rows of its table."""
        return (WAITING, *self.script.row_names) if self.waits else self.script.row_names

    def row(self, place: int) -> Mapping[str, Any]:
        """A row of its table as parsed; that in which it waits has nothing."""
        return self.script.rows[place - self.waits] if place >= self.waits else {}


@dataclass(frozen=True)
class Roles:
    """What everybody does.

    Attributes:
        casts: Who they are.
        each: By number of the agent.
        waiting: What those who wait do, in its first row.
    """

    casts: tuple[CastPart, ...]
    each: tuple[Role, ...]
    waiting: Script

    @cached_property
    def tables(self) -> tuple[np.ndarray, np.ndarray]:
        """Scripts for the engines, shape [scripts, rows, row size], and which of them each agent follows, [agents]."""
        found: dict[bytes, int] = {}
        tables: list[np.ndarray] = []
        which = np.zeros(len(self.each), np.int64)
        for cast in self.casts:
            made: dict[tuple[Any, ...], np.ndarray] = {}
            for agent in cast.agents:
                role = self.each[agent]
                key = (role.script.source, role.delay, *role.values.items())
                if key not in made:
                    made[key] = self._table(cast, role)
                table = made[key]
                place = found.setdefault(table.tobytes(), len(tables))
                if place == len(tables):
                    tables.append(table)
                which[agent] = place
        return padded(tables), which

    def _table(self, cast: CastPart, role: Role) -> np.ndarray:
        table = role.script.table(cast.character.body, role.values)
        return after_waiting(table, self.waiting.table(cast.character.body)[0], role.delay) if role.waits else table


def after_waiting(table: np.ndarray, waiting: np.ndarray, delay: float) -> np.ndarray:
    """A script with a row before its first that leads there after a delay [s]; tables as `Script.table` gives them."""
    layout = Gymnast.script
    first = waiting.copy()
    first[layout.transition_place : layout.capture_place] = 0.0
    moved = table.copy()
    for transition in range(TRANSITIONS):
        at = layout.transition_place + transition * TRANSITION_SIZE
        moved[:, at] = np.where(moved[:, at] >= 0.0, moved[:, at] + 1.0, moved[:, at])
        first[at] = 1.0 if transition == 0 else -1.0
        for clause in range(CLAUSES):
            first[at + 1 + clause * CLAUSE_SIZE] = -1.0
    at = layout.transition_place + 1
    first[at : at + CLAUSE_SIZE] = (MEASURES.index("row_age"), delay, np.inf)
    return np.concatenate([first[None], moved])


def with_scripts(scenario: Scenario) -> Scenario:
    """The scenario with the text of every maneuver that it names.

    Raises:
        InputError: There is no such maneuver, or it cannot be read.
    """
    performance = scenario.performance or PerformanceSettings()
    names = dict.fromkeys([*performance.maneuver, *(n for c in performance.casts for n in c.maneuver)])
    names |= {performance.waiting: None}
    known = {script.name: script for script in performance.scripts}
    for name in names:
        if name not in known:
            known[name] = ScriptSettings(name, script_text(name)[0])
    return replace(scenario, performance=replace(performance, scripts=tuple(known.values())))


def roles_of(scenario: Scenario, casts: Sequence[CastPart]) -> Roles:
    """What everybody does in a scenario that has its scripts (`with_scripts`).

    Raises:
        InputError: A maneuver is wrong, or none has a parameter of a name that the scenario gives.
    """
    performance = scenario.performance
    assert performance is not None
    texts = {script.name: script.text for script in performance.scripts}
    scripts = {name: parse_script(text, name) for name, text in texts.items()}
    seed, count = scenario.population_seed, scenario.crowd.count
    varied = {name: script.varied(count, seed, performance.variation) for name, script in scripts.items()}
    delays = performance.delay + performance.delay_spread * evenly(count, seed, "delay")
    waits = performance.delay + performance.delay_spread > 0.0
    chances = evenly(count, seed, "maneuver")
    roles: list[Role] = []
    for cast in casts:
        maneuvers = performance.maneuver
        parameters = dict(performance.parameters)
        if cast.settings is not None:
            maneuvers = cast.settings.maneuver or maneuvers
            parameters |= cast.settings.parameters
        _check_parameters(parameters, [scripts[name] for name in maneuvers], scenario.name)
        drawn = {name: _drawn(value, count, seed, name) for name, value in parameters.items()}
        for place, agent in enumerate(cast.agents):
            turn = place if performance.dealing == "in-turn" else int(chances[agent] * len(maneuvers))
            name = maneuvers[turn % len(maneuvers)]
            script = scripts[name]
            values = {key: float(each[agent]) for key, each in drawn.items() if key in script.parameters}
            if performance.variation > 0.0:
                for key, value in varied[name][agent].items():
                    usual = script.parameters[key].value
                    values[key] = values.get(key, usual) + (value - usual)
            roles.append(Role(script.name, script, values, round(float(delays[agent]), 6), waits))
    return Roles(tuple(casts), tuple(roles), scripts[performance.waiting])


def _check_parameters(parameters: Mapping[str, Any], scripts: Sequence[Script], source: str) -> None:
    known = {name for script in scripts for name in script.parameters}
    for name in parameters:
        if name not in known:
            of = ", ".join(script.name for script in scripts)
            hint = suggestion(name, known) if known else "; there are none"
            raise InputError(f"{source}: performance.parameters.{name}: no parameter of {of}{hint}")


def _drawn(value: Any, count: int, seed: int, name: str) -> np.ndarray:
    """A parameter of each agent: a number for all, or evenly between two."""
    if isinstance(value, list | tuple) and len(value) == 2:
        return value[0] + (value[1] - value[0]) * evenly(count, seed, f"parameter {name}")
    return np.full(count, value[0] if isinstance(value, list | tuple) else value, dtype=np.float64)


def evenly(count: int, seed: int, what: str) -> np.ndarray:
    """A number from 0 to 1 for each agent, evenly distributed; agent i's does not depend on the count."""
    key = np.array([seed, zlib.crc32(what.encode())], dtype=np.uint64)
    bits = np.random.Philox(key=key).random_raw(count)
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53
