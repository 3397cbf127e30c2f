"""The files of a toy."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.tuning.toy import OBJECTIVE, SCRIPT


@pytest.fixture
def script_file(tmp_path: Path) -> Path:
    """A script's file."""
    path = tmp_path / "bend.toml"
    path.write_text(SCRIPT)
    return path


@pytest.fixture
def objective_file(tmp_path: Path) -> Path:
    """Its objective's."""
    path = tmp_path / "knees.toml"
    path.write_text(OBJECTIVE)
    return path
