"""Columns and gaps are in what leaves: stage, physics layer, pictures."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdPhysics

from echelon.export.physics import write_physics
from echelon.export.picture_source import RecordedSource
from echelon.export.stage_world import read_world
from echelon.export.usd import write_stage
from echelon.recording import Recording
from echelon.scenario import Scenario
from echelon.simulation import simulate


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    data = {
        "name": "stones",
        "seconds": 0.2,
        "crowd": {"character": "point-mass", "count": 3},
        "herd": {"mode": "constant"},
        "world": {"ground": "plane", "columns": [[9.0, 1.0, 0.5], [9.0, -4.0, 0.75]], "gap": {"center": [15.0, 0.0]}},
    }
    return simulate(Scenario.from_dict(data), recording=tmp_path_factory.mktemp("stones") / "stones.recording")


def test_the_stage_has_columns_and_gap_where_they_stand(recording: Recording, tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(write_stage(recording, tmp_path / "stones.usd")))
    world = stage.GetDefaultPrim().GetChild("World")
    stones = UsdGeom.Mesh(world.GetPrimAtPath("columns/stone"))
    low, high = np.array(stones.GetExtentAttr().Get())
    assert low == pytest.approx([8.25, -4.75, 0.0], abs=0.05)
    assert high == pytest.approx([9.75, 1.5, 2.5], abs=0.05)
    assert world.GetChild("gap_left")
    assert world.GetChild("gap_right")
    drawn = read_world(world)
    assert drawn.oval is None, "open ground stays open ground"
    assert {fence.name for fence in drawn.fences} == {"gap_left", "gap_right", "columns"}


def test_pictures_of_the_recording_show_them(recording: Recording) -> None:
    assert {fence.name for fence in RecordedSource(recording).world.fences} == {"gap_left", "gap_right", "columns"}


def test_the_physics_layer_lets_other_engines_bump_into_them(recording: Recording, tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(write_physics(recording, tmp_path / "stones.usda")))
    found = [prim for prim in stage.Traverse() if prim.GetName() == "columns"]
    assert len(found) == 1
    assert found[0].HasAPI(UsdPhysics.CollisionAPI)
