"""Crowds that obey physics, as finished OpenUSD.

    import echelon

    run = echelon.simulate("border-collie", agents=16, seconds=20)
    run.export("herd.usd")

The names below are what Echelon promises; everything else may move.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from echelon.agents.bodies import body_names, load_body
    from echelon.errors import InputError
    from echelon.recording import Recording
    from echelon.runs import Run, open_recording, resume, simulate
    from echelon.scenario import Scenario
    from echelon.sweeping import SweepResult, sweep
    from echelon.warp_kernels.reference import Body

__version__ = "0.1.0"

__all__ = [
    "Body",
    "InputError",
    "Recording",
    "Run",
    "Scenario",
    "SweepResult",
    "__version__",
    "body_names",
    "load_body",
    "open_recording",
    "resume",
    "simulate",
    "sweep",
]

_HOME = {
    "Body": "echelon.warp_kernels.reference",
    "InputError": "echelon.errors",
    "Recording": "echelon.recording",
    "Scenario": "echelon.scenario",
    "SweepResult": "echelon.sweeping",
    "body_names": "echelon.agents.bodies",
    "load_body": "echelon.agents.bodies",
    "Run": "echelon.runs",
    "open_recording": "echelon.runs",
    "resume": "echelon.runs",
    "simulate": "echelon.runs",
    "sweep": "echelon.sweeping",
}


def __getattr__(name: str) -> Any:
    # Names are fetched when they are first used: `echelon --help` must not wait for Warp and USD.
    if name not in _HOME:
        raise AttributeError(f"module 'echelon' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
