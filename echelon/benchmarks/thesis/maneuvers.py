"""Chapter 8: maneuvers made of the basis controllers.

Leaps and jumps that are landed are measured here; each other kind has a module of its own.
"""

from __future__ import annotations

from collections.abc import Mapping

from echelon.benchmarks.thesis import dives, handspring, somersaults
from echelon.benchmarks.thesis.experiments import FidelitySettings, Measure
from echelon.benchmarks.thesis.leap import commanded
from echelon.benchmarks.thesis.rows import Measured


def vertical_leap(settings: FidelitySettings) -> list[Measured]:
    """Figures 8.1 and 8.2: vertical leaps of the woman, landed."""
    return commanded("vertical-leap", "vertical-leap", "height", settings)


def broad_jump(settings: FidelitySettings) -> list[Measured]:
    """Figures 8.3 and 8.4: broad jumps of the man, landed."""
    return commanded("broad-jump", "broad-jump", "distance", settings)


MEASURES: Mapping[str, Measure] = {
    "vertical-leap": vertical_leap,
    "broad-jump": broad_jump,
    **somersaults.MEASURES,
    **handspring.MEASURES,
    **dives.MEASURES,
}
"""Measuring functions by experiment."""
