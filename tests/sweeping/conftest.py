"""A stand-in for simulations: real processes run it, and it kills its own when its seed says so."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

DEADLY = """
import os, signal, time
from pathlib import Path

def run_once(scenario, threads, recording, scratch):
    seed, place = scenario["seed"], Path(__file__).parent
    with open(place / f"begun-{seed}", "a") as begun:
        begun.write("x")
    if seed == 13 or (seed == 7 and (place / "begun-7").stat().st_size == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    if seed == 11:
        return {"failed": "ValueError: eleven"}
    time.sleep(0.02 if seed < 100 else 30.0)
    return {"summary": {"falls": seed, "threads": threads, "truth": seed > 2, "riders": [seed], "nothing": None}}
"""


@pytest.fixture
def deadly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """A stand-in for simulations, under a name that workers can import."""
    (tmp_path / "deadly.py").write_text(DEADLY)
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module("deadly")
    monkeypatch.setattr("echelon.sweeping.running.run_once", module.run_once)
    yield module
    del sys.modules["deadly"]
