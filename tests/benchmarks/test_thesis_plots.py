"""The fidelity report's pictures: what is compared in one panel has one unit, and lines are told apart."""

from __future__ import annotations

from pathlib import Path

from echelon.benchmarks.thesis.plots import panels_of, write_pages
from echelon.benchmarks.thesis.published import published_rows
from echelon.benchmarks.thesis.rows import FidelityRow, Measured


def measured(name: str) -> list[FidelityRow]:
    """Every published row of an experiment, each measured as its place in the list."""
    return [FidelityRow.of(Measured(row, float(place))) for place, row in enumerate(published_rows(name))]


def test_a_panel_has_one_unit_and_the_numbers_of_its_own_rows() -> None:
    rows = published_rows("leap-force")
    for panel in panels_of("leap-force", "force", measured("leap-force")):
        for points in panel.series.values():
            assert len({row.unit for row, _ in points}) == 1
            assert all(ours == rows.index(row) for row, ours in points)


def test_what_takes_few_values_tells_lines_apart() -> None:
    (panel,) = panels_of("land-backpack", "backpack", measured("land-backpack"))
    assert panel.given == "speed [m/s]"
    assert list(panel.series) == ["female, backpack 2 kg", "female, backpack 4 kg"]
    assert all(len(points) == 5 for points in panel.series.values())


def test_pages_are_written(tmp_path: Path) -> None:
    rows = [row for name in ("balance-push", "leap-command") for row in measured(name)]
    pages = write_pages(rows, tmp_path)
    assert [page.name for page in pages] == ["thesis-leap.png", "thesis-balance.png"]
    assert all(page.stat().st_size > 5000 for page in pages)
