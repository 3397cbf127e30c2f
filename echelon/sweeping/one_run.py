"""One run of a sweep, as a worker carries it out: plain data in, plain data out.

Imports nothing that takes long before a run begins, and nothing of the executor that called it.
"""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_ALONE = threading.Lock()
"""A worker of several threads runs one simulation at a time: simulations have threads of their own."""

_ARITHMETIC_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def run_once(
    scenario: Mapping[str, Any], threads: int, recording: str | None, scratch: str | None = None
) -> dict[str, Any]:
    """Simulate, and report.

    Args:
        scenario: All of it, plain data.
        threads: Of the simulation.
        recording: Folder to record into and keep; None records into a temporary one.
        scratch: Where temporary folders are made; None leaves it to the system.

    Returns:
        {"summary": ...} as the run reported it, or {"failed": one line that says why}.
    """
    for name in _ARITHMETIC_THREADS:
        os.environ.setdefault(name, str(threads))
    with _ALONE:
        try:
            return {"summary": _simulated(scenario, threads, recording, scratch)}
        except Exception as error:  # whatever it is, it is this run's and not the sweep's
            return {"failed": f"{type(error).__name__}: {' '.join(str(error).split()) or 'no message'}"}


def _simulated(scenario: Mapping[str, Any], threads: int, recording: str | None, scratch: str | None) -> dict[str, Any]:
    from echelon.scenario import Scenario
    from echelon.simulation import simulate

    plan = Scenario.from_dict(scenario, source=str(scenario["name"]))
    if recording is not None:
        return dict(simulate(plan, recording=Path(recording), threads=threads).summary)
    with tempfile.TemporaryDirectory(prefix="echelon-", dir=scratch) as folder:
        return dict(simulate(plan, recording=Path(folder) / "recording", threads=threads).summary)
