"""Tuning: a script's parameters fitted to a body and an objective, by thousands of performances a minute.

from echelon.tuning import tune

result = tune("standing-back-somersault", height=1.70, mass=65.0, from_nothing=True, out="mine.toml")
result.success                      # share of perturbed copies that land
"""

from echelon.tuning.objective import Objective, load_objective, objective_names, parse_objective
from echelon.tuning.tuning import TuningProgress, TuningResult, tune

__all__ = [
    "Objective",
    "TuningProgress",
    "TuningResult",
    "load_objective",
    "objective_names",
    "parse_objective",
    "tune",
]
