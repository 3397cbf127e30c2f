"""Chapter 8: maneuvers made of the basis controllers. Each kind has a module of its own; here they come together."""

from __future__ import annotations

from collections.abc import Mapping

from echelon.benchmarks.thesis import dives, handspring, somersaults
from echelon.benchmarks.thesis.experiments import Measure

MEASURES: Mapping[str, Measure] = {**somersaults.MEASURES, **handspring.MEASURES, **dives.MEASURES}
"""Measuring functions by experiment."""
