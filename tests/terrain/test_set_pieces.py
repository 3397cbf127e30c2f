"""Walls, gaps and columns as a world's data: where they stand, what room they leave, what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.scenario import ColumnFieldSettings, GapSettings, Scenario, WallSettings, WorldSettings
from echelon.terrain.walls import COLUMN_SIDES, column_segments, infield_walls, wall_segments, world_dict


def test_a_column_is_a_polygon_just_outside_its_circle() -> None:
    world = WorldSettings(ground="plane", columns=((3.0, -1.0, 0.5),))
    pieces = column_segments(world)
    assert pieces.shape == (COLUMN_SIDES, 4)
    middles = 0.5 * (pieces[:, :2] + pieces[:, 2:]) - (3.0, -1.0)
    corners = pieces[:, :2] - (3.0, -1.0)
    assert np.linalg.norm(middles, axis=1) == pytest.approx(0.5, abs=1e-5)
    assert np.linalg.norm(corners, axis=1).max() < 0.5 * 1.03
    assert np.array_equal(pieces[:, 2:], np.roll(pieces[:, :2], -1, axis=0)), "it is closed"


def test_a_gap_is_two_walls_with_an_opening_between() -> None:
    world = WorldSettings(
        ground="plane", gap=GapSettings(center=(10.0, 1.0), facing=(0.0, 1.0), opening=4.0, width=20.0)
    )
    left, right = infield_walls(world)
    assert (left.name, right.name) == ("gap_left", "gap_right")
    assert sorted(x for x, _ in (*left.points, *right.points)) == pytest.approx([0.0, 8.0, 12.0, 20.0])
    assert [y for _, y in (*left.points, *right.points)] == pytest.approx([1.0] * 4)


def test_room_is_measured_to_whatever_is_nearest() -> None:
    world = WorldSettings(
        ground="plane",
        gap=GapSettings(center=(10.0, 0.0), opening=6.0),
        walls=(WallSettings(points=((0.0, 5.0), (4.0, 5.0), (4.0, 9.0)), closed=True),),
        columns=((-5.0, 0.0, 1.0),),
    )
    points = np.array([[10.0, 0.0], [2.0, 4.0], [1.0, 7.0], [-5.0, 2.5], [-5.0, 0.2]])
    assert world.clearance(points) == pytest.approx([3.0, 1.0, np.sqrt(0.5), 1.5, -0.8], abs=0.3)
    assert len(wall_segments(world)) == 2 + 3 + COLUMN_SIDES


def test_a_field_of_columns_keeps_its_spacing_and_changes_with_its_seed() -> None:
    field = ColumnFieldSettings(center=(20.0, 0.0), length=12.0, width=24.0, spacing=6.0, jitter=0.5, seed=1)
    columns = field.columns()
    assert len(columns) > 10
    assert np.abs(columns[:, 0] - 20.0).max() <= 6.5
    assert np.abs(columns[:, 1]).max() <= 12.5
    gaps = np.linalg.norm(columns[:, None, :2] - columns[None, :, :2], axis=-1) + 99.0 * np.eye(len(columns))
    assert gaps.min() > 6.0 - 2.0 * np.sqrt(2.0) * 0.5 - 1e-9
    other = ColumnFieldSettings(center=(20.0, 0.0), length=12.0, width=24.0, spacing=6.0, jitter=0.5, seed=2)
    assert not np.array_equal(columns, other.columns())


def test_what_stands_there_is_in_the_recorded_world() -> None:
    world = world_dict(WorldSettings(ground="plane", gap=GapSettings(), columns=((1.0, 2.0, 0.5),)))
    assert [wall["name"] for wall in world["walls"]] == ["gap_left", "gap_right"]
    assert world["columns"] == [{"center": [1.0, 2.0], "radius": 0.5, "height": 2.5}]
    assert "columns" not in world_dict(WorldSettings(ground="plane"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[world]\ncolumns = [[1, 2, 0]]", "world.columns[0] = [1.0, 2.0, 0.0]: its radius must be above 0 m"),
        ("[world.gap]\nopening = 9\nwidth = 8", "world.gap.opening = 9: must be less than the width, 8 m"),
        ("[world.gap]\nfacing = [1, 1]", "world.gap.facing = [1.0, 1.0]: must be a direction of length 1"),
        ("[[world.walls]]\npoints = [[0, 0]]", "must hold at least two posts"),
        ("[world.column_field]\nspacing = 2.0", "world.column_field.spacing = 2: must be more than"),
        ("[world.column_field]\nlength = 9000\nwidth = 9000", "must leave at most 10000 columns"),
        ("[world]\ncolumns = [[0.1, 0, 0.3]]", "across a fence"),
        ('[crowd]\ncharacter = "cyclist"\n[world]\nground = "plane"', "crowd.start_velocity"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(text: str, expected: str, tmp_path: Path) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    with pytest.raises(InputError) as error:
        Scenario.load(file)
    assert expected in str(error.value)
    assert "\n" not in str(error.value)
