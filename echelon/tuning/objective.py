"""What a maneuver should be like, as data: stages, and in each of them terms over measures at moments.

    title = "A vertical leap of half a metre, landed"
    script = "leap"                         # whose parameters are tuned, where nobody says otherwise

    [[success]]                             # what a performance must be to count as a success: all of these
    value = "fallen"                        # a formula of measures, see `expressions`
    at = "end"                              # the moment that it is asked at
    most = 0.5

    [[stage]]
    name = "take-off"
    tune = ["crouch", "hip_end"]            # these parameters, between least and most as the script says; or "all"
    seconds = 1.6                           # are simulated
    copies = 1                              # of each candidate; more than one are perturbed by the script's spreads
    share = 1.0                             # of the spreads
    generations = 60                        # at most
    sigma = 0.3                             # with what spread the search starts, as a share of least to most
    enough = 0.1                            # the stage ends when the best candidate's objective is so small, ...
    success_rate = 0.9                      # ... and so many of its copies succeed

    [[stage.term]]
    value = "com_height + vz * vz / (2 * gravity) - standing"
    at = "arrival"                          # when the row below is come to
    row = "flight"
    target = 0.5
    scale = 0.08                            # costs ((value - target) / scale)^2
    weight = 2.0                            # times this

A formula may ask about the measures of the script's rows (`gymnast.MEASURES`), what is kept of a whole run (`highest`,
`hardest`, `fallen`), the script's parameters, and the constants `mass` [kg], `gravity` [m/s^2], `gain` (mass times
height squared, against the thesis's man) and `standing` (the height of the centre of mass at the start [m]).

Moments: ``end``; ``arrival`` in a row and ``leaving`` it, both for the first time; ``time`` [s]; ``least``, ``most``
and ``mean`` over the run, or, with a row, over the time spent there. They are known to a frame: a value on arrival is
that at the end of the frame in which the row was come to. A moment that never came costs `missing`.

Shapes: with a `target`, ((value - target) / scale)^2; with `least` or `most` a penalty, the same of what lies outside;
otherwise the value itself over `scale`. Each term of each copy is bounded by its `limit`, smoothly: c becomes
c / (1 + c / limit), which keeps the order of bad ones and stops a single wild copy from deciding. What a copy costs is
the sum of its terms, and `failures` if it did not succeed; a stage's objective is the mean over the copies, and `worst`
times the cost of the worst of them. Terms with a `spread` also cost how much copies differ from one another: what
varies little under perturbation is robust.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from echelon.agents.gymnasts.formulas import Formula, formula
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.script import Script
from echelon.errors import InputError
from echelon.settings import SettingError, Within, adopt, read, shown, suggestion, text_of, toml_of

_SHIPPED = resources.files("echelon.tuning") / "objectives"

Moment = Literal["end", "arrival", "leaving", "time", "least", "most", "mean"]
CONSTANTS = ("mass", "gravity", "gain", "standing")
"""What formulas may ask about beside measures and parameters."""


@dataclass(frozen=True)
class Asked:
    """A formula at a moment: what terms and conditions have in common.

    Attributes:
        value: A formula, see `expressions`.
        at: The moment.
        row: Name of the row that "arrival" and "leaving" are about, and to which "least", "most" and "mean" may keep.
        time: Of the moment "time" [s].
        least, most: Bounds.
        about: What it is, for people.
    """

    value: str
    at: Moment = "end"
    row: str = ""
    time: Annotated[float | None, Within("s", above=0.0)] = None
    least: float | None = None
    most: float | None = None
    about: str = ""

    @property
    def formula(self) -> Formula:
        """The formula, parsed."""
        return formula("value", self.value)

    def check(self, key: str) -> None:
        """Whether moment, row and time fit one another; `key` names it in messages."""
        if self.at in ("arrival", "leaving") and not self.row:
            raise SettingError(f"{key}.row", f": is missing; at = {self.at!r} needs the name of a row")
        if self.row and self.at in ("end", "time"):
            raise SettingError(f"{key}.row", f" = {shown(self.row)}: is not for at = {self.at!r}")
        if (self.at == "time") != (self.time is not None):
            missing = ": is missing" if self.time is None else f" = {self.time:g}: is only for at = 'time'"
            raise SettingError(f"{key}.time", missing)
        if self.least is not None and self.most is not None and self.least > self.most:
            raise SettingError(f"{key}.least", f" = {self.least:g}: must be at most {self.most:g}, which `most` is")
        try:
            formula(f"{key}.value", self.value)
        except InputError as error:
            raise SettingError(f"{key}.value", str(error).removeprefix(f"{key}.value")) from None


@dataclass(frozen=True)
class Condition(Asked):
    """What holds of a success: the value lies between `least` and `most`."""

    def check(self, key: str) -> None:
        """As `Asked.check`; and there is a bound."""
        super().check(key)
        if self.least is None and self.most is None:
            raise SettingError(f"{key}.most", ": is missing; a condition needs `least` or `most` or both")


@dataclass(frozen=True)
class Term(Asked):
    """A part of an objective, the smaller the better.

    Attributes:
        target: Where the value should be.
        scale: What a deviation is measured by, in the value's unit.
        weight: How much it counts.
        limit: Of one copy's cost, before the weight, approached smoothly.
        missing: The cost if the moment never came, before the weight; None for the limit.
        spread: A standard deviation over the copies that costs 1 more, before the weight, and others by their square;
            None where it costs nothing.
    """

    target: float | None = None
    scale: Annotated[float, Within(above=0.0)] = 1.0
    weight: Annotated[float, Within(at_least=0.0)] = 1.0
    limit: Annotated[float, Within(above=0.0)] = 100.0
    missing: float | None = None
    spread: Annotated[float | None, Within(above=0.0)] = None

    def check(self, key: str) -> None:
        """As `Asked.check`; and the shape is one."""
        super().check(key)
        if self.target is not None and (self.least is not None or self.most is not None):
            raise SettingError(f"{key}.target", f" = {self.target:g}: a term has a target, or bounds, not both")


@dataclass(frozen=True)
class Stage:
    """A part of the search: some of the parameters, judged by some of the terms.

    Attributes:
        name, about: For people.
        tune: Names of parameters, or "all" that the script bounds.
        seconds: Simulated [s].
        term: What is summed.
        success: What a success is in this stage; the objective's own where it says nothing.
        failures: Cost of the share of copies that did not succeed.
        worst: How much of the worst copy's cost is added to the mean over copies.
        copies: Of each candidate. One is not perturbed; of more, all are.
        share: Of the script's spreads by which copies differ.
        population: Candidates a generation; 0 for what suits the number of parameters.
        generations: At most.
        sigma: Standard deviation at the start, as a share of each parameter's range.
        enough: The stage ends when the objective is at most this; one that never gets there has failed, and the search
            begins anew. None: it ends with its generations, and cannot fail by this.
        success_rate: The same for the share of copies that succeed.
    """

    name: str
    tune: tuple[str, ...] | None = None
    seconds: Annotated[float, Within("s", above=0.0, at_most=60.0)] = 3.0
    term: tuple[Term, ...] = ()
    success: tuple[Condition, ...] = ()
    failures: Annotated[float, Within(at_least=0.0)] = 0.0
    worst: Annotated[float, Within(at_least=0.0)] = 0.0
    copies: Annotated[int, Within(at_least=1, at_most=1024)] = 1
    share: Annotated[float, Within(at_least=0.0)] = 1.0
    population: Annotated[int, Within(at_least=0, at_most=4096)] = 0
    generations: Annotated[int, Within(at_least=1)] = 60
    sigma: Annotated[float, Within(above=0.0, at_most=1.0)] = 0.25
    enough: float | None = None
    success_rate: Annotated[float | None, Within(at_least=0.0, at_most=1.0)] = None
    about: str = ""

    @property
    def asked(self) -> tuple[Asked, ...]:
        """All its formulas and moments."""
        return (*self.term, *self.success)

    def tuned(self, script: Script) -> tuple[str, ...]:
        """The parameters of a script that it tunes."""
        if self.tune is not None:
            return self.tune
        return tuple(name for name, p in script.parameters.items() if p.least > -_INFINITY and p.most < _INFINITY)


_INFINITY = float("inf")


@dataclass(frozen=True)
class Objective:
    """An objective as its file gives it.

    Attributes:
        title, description: For people.
        script: Name of the maneuver that it is for, or the path of its file.
        success: What a performance must be to count as one.
        stage: In order.
        success_rate: So many of the final ensemble must succeed, or the search begins anew.
        proof: How many the final ensemble has, perturbed by the script's spreads.
        source: Where it came from, for messages.
    """

    title: str = ""
    description: str = ""
    script: str = ""
    success: tuple[Condition, ...] = ()
    stage: tuple[Stage, ...] = ()
    success_rate: Annotated[float, Within(at_least=0.0, at_most=1.0)] = 0.8
    proof: Annotated[int, Within(at_least=1, at_most=100_000)] = 256
    source: str = "objective"

    def __post_init__(self) -> None:
        adopt(self, "")
        if not self.stage:
            raise SettingError("stage", ": is missing; an objective needs at least one [[stage]]")
        _check_all("success", self.success)
        for number, stage in enumerate(self.stage):
            key = f"stage[{number}]"
            adopt(stage, key)
            _check_all(f"{key}.term", stage.term)
            _check_all(f"{key}.success", stage.success)
            if not stage.term and not stage.failures:
                raise SettingError(f"{key}.term", ": is missing; a stage needs terms, or a cost of `failures`")
            if (stage.failures or stage.success_rate) and not self.conditions(stage):
                raise SettingError(
                    f"{key}.success", ": is missing; `failures` and `success_rate` ask what a success is"
                )
            if stage.tune is not None and not stage.tune:
                raise SettingError(f"{key}.tune", ' = []: must name parameters, or be "all"')

    def conditions(self, stage: Stage) -> tuple[Condition, ...]:
        """What a success is in a stage."""
        return stage.success or self.success

    def names(self, stage: Stage) -> tuple[str, ...]:
        """Everything that a stage's formulas ask about."""
        asked = (*stage.term, *self.conditions(stage))
        return tuple(dict.fromkeys(name for one in asked for name in one.formula.names))

    def check(self, script: Script, character: Gymnast) -> None:
        """Whether it is about this script.

        Raises:
            InputError: A parameter, row or measure that is not there, or a parameter without bounds.
        """
        allowed = (*CONSTANTS, *script.parameters, *character.memory)
        for place, one in enumerate(self.success):
            self._check_asked(f"success[{place}]", one, script, allowed)
        for number, stage in enumerate(self.stage):
            key = f"stage[{number}]"
            for name in stage.tuned(script):
                if name not in script.parameters:
                    hint = suggestion(name, script.parameters)
                    raise InputError(f"{self.source}: {key}.tune: {script.source} has no parameter {name!r}{hint}")
                parameter = script.parameters[name]
                if not -_INFINITY < parameter.least < parameter.most < _INFINITY:
                    raise InputError(
                        f"{self.source}: {key}.tune: parameter {name!r} of {script.source} needs `least` and `most` "
                        "to be tuned"
                    )
            if not stage.tuned(script):
                raise InputError(f"{self.source}: {key}.tune: {script.source} has no parameter with least and most")
            for kind, many in (("term", stage.term), ("success", stage.success)):
                for place, one in enumerate(many):
                    self._check_asked(f"{key}.{kind}[{place}]", one, script, allowed)

    def _check_asked(self, key: str, one: Asked, script: Script, allowed: Sequence[str]) -> None:
        if one.row and one.row not in script.row_names:
            hint = suggestion(one.row, script.row_names)
            raise InputError(f"{self.source}: {key}.row = {one.row!r}: {script.source} has no such row{hint}")
        for name in one.formula.names:
            if name not in allowed:
                known = [known for known in allowed if "." not in known]
                raise InputError(
                    f"{self.source}: {key}.value = {one.value!r}: {name!r} is unknown" + _hint(name, known)
                )


def _check_all(key: str, many: Sequence[Asked]) -> None:
    for place, one in enumerate(many):
        adopt(one, f"{key}[{place}]")
        one.check(f"{key}[{place}]")


def _hint(name: str, known: Sequence[str]) -> str:
    """Only a near name: the whole list is a page long."""
    near = suggestion(name, known)
    return near if near.startswith("; did you mean") else "; measures, parameters of the script and constants may stand"


def objective_names() -> tuple[str, ...]:
    """Names of the objectives that ship, in alphabetical order."""
    return tuple(sorted(Path(e.name).stem for e in _SHIPPED.iterdir() if e.name.endswith(".toml")))


def load_objective(name_or_path: str | Path) -> Objective:
    """An objective that ships, by name, or a file's.

    Raises:
        InputError: One line naming the file, the key and what is allowed.
    """
    if str(name_or_path) in objective_names():
        return parse_objective((_SHIPPED / f"{name_or_path}.toml").read_text("utf-8"), f"{name_or_path}.toml")
    path = Path(name_or_path)
    if path.suffix != ".toml":
        known = ", ".join(objective_names()) or "none"
        raise InputError(f"objective {str(name_or_path)!r}: must be the path of a .toml file, or one of {known}")
    return parse_objective(text_of(path), str(path))


def parse_objective(text: str, source: str) -> Objective:
    """An objective from the text of a TOML file; `source` names it in messages.

    Raises:
        InputError: One line naming the file, the key and what is allowed.
    """
    data = toml_of(text, source)
    try:
        if "source" in data:
            raise SettingError("source", ": unknown key")
        return read(Objective, {**_prepared(data), "source": source})
    except SettingError as error:
        raise InputError(f"{source}: {error}") from None


def _prepared(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """`tune = "all"` says the same as nothing."""
    stages = data.get("stage")
    if not isinstance(stages, list):
        return data
    return {**data, "stage": [_without_all(stage) if isinstance(stage, Mapping) else stage for stage in stages]}


def _without_all(stage: Mapping[str, Any]) -> Mapping[str, Any]:
    return {key: value for key, value in stage.items() if (key, value) != ("tune", "all")}
