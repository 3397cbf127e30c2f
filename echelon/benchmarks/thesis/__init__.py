"""The fidelity report: every experiment of a thesis on human motion, its numbers beside ours.

"Simulation of Leaping, Tumbling, Landing, and Balancing Humans" tests four basis controllers, and maneuvers made of
them, in its chapters 4 to 8. `published` holds what it found, `rows` how ours is compared with it, `experiments` which
of them are measured, `report` what people and programs are shown. What is measured stands in one module a chapter,
named as in `published.GROUPS`.
"""

from echelon.benchmarks.thesis.experiments import FidelitySettings, offered_experiments, run_thesis_benchmark
from echelon.benchmarks.thesis.published import EXPERIMENTS, Experiment, published_rows
from echelon.benchmarks.thesis.report import print_tables, write_files
from echelon.benchmarks.thesis.rows import FidelityRow, Measured, Published

__all__ = [
    "EXPERIMENTS",
    "Experiment",
    "FidelityRow",
    "FidelitySettings",
    "Measured",
    "Published",
    "offered_experiments",
    "print_tables",
    "published_rows",
    "run_thesis_benchmark",
    "write_files",
]
