"""One scenario over many seeds and parameters: planned (`plan`), carried out (`running`), kept (`folder`)."""

from echelon.sweeping.executors import EXECUTORS, ExecutorName
from echelon.sweeping.plan import axis_of_text, seeds_of_text
from echelon.sweeping.running import SweepResult, sweep
from echelon.sweeping.statistics import Point, telling

__all__ = [
    "EXECUTORS",
    "ExecutorName",
    "Point",
    "SweepResult",
    "axis_of_text",
    "seeds_of_text",
    "sweep",
    "telling",
]
