"""A row of the fidelity report: what was published, what we measured, and whether that is as asked.

A published number comes with a rule that says what ours must be. Most rules compare with the number itself; where the
thesis only has a curve, or the scatter of its unpublished gains would be compared, the rule says what is asked
instead, or that nothing is (`REPORTED`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

Range = tuple[float, float]
"""Lowest and highest value of several subjects."""


# ---- what is asked ---------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Within:
    """Ours may differ so much from the thesis's number, or from another one; the wider tolerance of the two counts.

    Attributes:
        absolute: In the row's unit.
        relative: A fraction of that number.
        of: The other number, in the row's unit.
    """

    absolute: float = 0.0
    relative: float = 0.0
    of: float | None = None

    def met(self, ours: float, thesis: float | None) -> bool:
        """Whether a number is near enough."""
        asked = _asked(self.of, thesis)
        return abs(ours - asked) <= max(self.absolute, self.relative * abs(asked))

    def text(self, thesis: float | None) -> str:
        """In a few characters."""
        by = f"{100.0 * self.relative:g} %" if self.relative else f"{self.absolute:g}"
        return f"{_asked(self.of, thesis):g} ± {by}"


@dataclass(frozen=True)
class AtLeast:
    """Ours must reach the thesis's number, or another bound in the row's unit."""

    bound: float | None = None

    def met(self, ours: float, thesis: float | None) -> bool:
        """Whether a number is large enough."""
        return ours >= _asked(self.bound, thesis)

    def text(self, thesis: float | None) -> str:
        """In a few characters."""
        return f">= {_asked(self.bound, thesis):g}"


@dataclass(frozen=True)
class AtMost:
    """Ours must not pass the thesis's number, or another bound in the row's unit."""

    bound: float | None = None

    def met(self, ours: float, thesis: float | None) -> bool:
        """Whether a number is small enough."""
        return ours <= _asked(self.bound, thesis)

    def text(self, thesis: float | None) -> str:
        """In a few characters."""
        return f"<= {_asked(self.bound, thesis):g}"


@dataclass(frozen=True)
class Between:
    """Ours must lie between two bounds in the row's unit, both allowed."""

    low: float
    high: float

    def met(self, ours: float, thesis: float | None) -> bool:
        """Whether a number lies between the bounds, whatever the thesis's is."""
        return self.low <= ours <= self.high

    def text(self, thesis: float | None) -> str:
        """In a few characters."""
        return f"{self.low:g} to {self.high:g}"


Rule = Within | AtLeast | AtMost | Between | None
REPORTED: Rule = None
"""No rule: shown beside the thesis's number, without a verdict."""


def _asked(own: float | None, thesis: float | None) -> float:
    asked = thesis if own is None else own
    assert asked is not None, "Published refuses a rule that has nothing to compare with"
    return asked


# ---- rows ------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Published:
    """A number of the thesis, or a place for ours where it only has a curve.

    Attributes:
        experiment: Name of the `Experiment`.
        body: Which body, by name.
        given: What was set. A number's key ends with its unit in brackets, as in ``{"l_hip [m]": 0.85}``; a word stands
            for itself.
        quantity: What was measured.
        unit: Its unit; "1" for a pure number, such as a share of trials.
        thesis: The thesis's value; None where it gives none.
        human: What people do, or a range of several.
        rule: What ours must be.
    """

    experiment: str
    body: str
    given: Mapping[str, float | str] = field(compare=False, hash=False)
    quantity: str
    unit: str
    thesis: float | None = None
    human: float | Range | None = None
    rule: Rule = REPORTED
    condition: str = field(init=False)
    """What was set, in words; made of ``given``."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "condition", condition_text(self.given))
        own = {Within: "of", AtLeast: "bound", AtMost: "bound"}.get(type(self.rule))
        if own is not None and self.thesis is None and getattr(self.rule, own) is None:
            raise ValueError(f"{self.experiment}, {self.quantity}: {self.rule} has nothing to compare with")

    def number(self, name: str) -> float:
        """A number that was set, by its key in ``given``; raises ValueError where it is a word."""
        value = self.given[name]
        if isinstance(value, str):
            raise ValueError(f"{self.experiment}: {name} is {value!r}, not a number")
        return value


@dataclass(frozen=True)
class Measured:
    """What we found for a published row.

    Attributes:
        row: Which.
        ours: Our value in the row's unit; None where there is none, as after a fall, which meets no rule.
        note: Why ours differs, or why there is none; one line.
    """

    row: Published
    ours: float | None
    note: str = ""

    def __post_init__(self) -> None:
        if self.ours is None and not self.note:
            raise ValueError(f"{self.row.experiment}, {self.row.quantity}: no value, and no note that says why")
        if self.ours is not None and not math.isfinite(self.ours):
            raise ValueError(f"{self.row.experiment}, {self.row.quantity}: {self.ours} is no finite number")


@dataclass(frozen=True)
class FidelityRow:
    """A row of the report.

    Attributes:
        experiment: Name of the experiment.
        body: Which body.
        condition: What was set.
        quantity: What was measured.
        unit: Its unit.
        thesis: The thesis's value; None where it gives none.
        human: What people do, or a range.
        ours: Our value; None where there is none.
        met: Whether ours is as asked; None where nothing is.
        asked: What ours is asked to be; empty where nothing is.
        note: Why ours differs.
    """

    experiment: str
    body: str
    condition: str
    quantity: str
    unit: str
    thesis: float | None
    human: float | Range | None
    ours: float | None
    met: bool | None
    asked: str
    note: str

    @classmethod
    def of(cls, measured: Measured) -> FidelityRow:
        """The row that a measurement makes of a published one."""
        row, ours, rule = measured.row, measured.ours, measured.row.rule
        return cls(
            experiment=row.experiment,
            body=row.body,
            condition=row.condition,
            quantity=row.quantity,
            unit=row.unit,
            thesis=row.thesis,
            human=row.human,
            ours=ours,
            met=None if rule is None else ours is not None and rule.met(ours, row.thesis),
            asked="" if rule is None else rule.text(row.thesis),
            note=measured.note,
        )

    def plain(self) -> dict[str, Any]:
        """As plain data for JSON: keys in the order of the attributes, a range as a list of two numbers."""
        data = asdict(self)
        data["human"] = list(self.human) if isinstance(self.human, tuple) else self.human
        return data


def condition_text(given: Mapping[str, float | str]) -> str:
    """What was set in words: ``{"l_hip [m]": 0.85, "position": "tuck"}`` is "l_hip 0.85 m, tuck"."""
    parts = []
    for key, value in given.items():
        if isinstance(value, str):
            parts.append(value)
            continue
        name, _, unit = key.removesuffix("]").partition(" [")
        parts.append(f"{name} {value:g} {unit}".rstrip())
    return ", ".join(parts)
