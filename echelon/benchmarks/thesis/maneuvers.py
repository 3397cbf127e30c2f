"""Chapter 8: maneuvers made of the basis controllers.

Leaps and jumps that are landed are measured here; each other kind has a module of its own.
"""

from __future__ import annotations

from collections.abc import Mapping

from echelon.benchmarks.thesis import dives, handspring, somersaults
from echelon.benchmarks.thesis.experiments import FidelitySettings, Measure
from echelon.benchmarks.thesis.leap import gymnast_of, leap, script_of
from echelon.benchmarks.thesis.published import published_rows
from echelon.benchmarks.thesis.rows import Measured


def vertical_leap(settings: FidelitySettings) -> list[Measured]:
    """Figures 8.1 and 8.2: vertical leaps of the woman, landed."""
    return _commanded("vertical-leap", "female", "height", settings)


def broad_jump(settings: FidelitySettings) -> list[Measured]:
    """Figures 8.3 and 8.4: broad jumps of the man, landed."""
    return _commanded("broad-jump", "male", "distance", settings)


def _commanded(experiment: str, sex: str, parameter: str, settings: FidelitySettings) -> list[Measured]:
    rows = published_rows(experiment)
    asked = sorted({row.number("commanded [m]") for row in rows})
    leaps = leap(gymnast_of(sex), script_of(experiment, sex), [{parameter: x} for x in asked], settings)
    reached = leaps.rise if parameter == "height" else leaps.distance
    return [
        Measured(row, float((leaps.balanced if row.quantity == "ends balanced" else reached)[place]))
        for row in rows
        for place in [asked.index(row.number("commanded [m]"))]
    ]


MEASURES: Mapping[str, Measure] = {
    "vertical-leap": vertical_leap,
    "broad-jump": broad_jump,
    **somersaults.MEASURES,
    **handspring.MEASURES,
    **dives.MEASURES,
}
"""Measuring functions by experiment."""
