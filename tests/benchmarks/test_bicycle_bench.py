"""The bicycle's benchmark: eigenvalues from simulated perturbations, and that it would notice wrong ones."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from echelon.agents.riders.bicycle import Bicycle, TyreParameters, benchmark_bicycle
from echelon.agents.riders.whipple import linear_bicycle
from echelon.benchmarks.bicycle import (
    critical_speeds,
    matched,
    print_table,
    relative_error,
    run_bicycle_benchmark,
    simulated_eigenvalues,
)


@cache
def rows() -> tuple[dict[str, Any], ...]:
    return tuple(run_bicycle_benchmark())


def test_balances_between_the_published_speeds() -> None:
    summary = rows()[-1]
    assert summary["weave_speed"] == pytest.approx(4.292, abs=0.05)
    assert summary["capsize_speed"] == pytest.approx(6.024, abs=0.1)
    assert summary["published_weave_speed"] == pytest.approx(4.29238253634111, abs=1e-4)
    assert summary["published_capsize_speed"] == pytest.approx(6.02426201538837, abs=1e-4)


def test_eigenvalues_are_the_published_ones_between_3_and_8_metres_a_second() -> None:
    speeds = [row["speed"] for row in rows()[:-1]]
    assert speeds[0] == 3.0
    assert speeds[-1] == 8.0
    for row in rows()[:-1]:
        published, measured = (np.array(row[key]) @ [1.0, 1.0j] for key in ("published", "measured"))
        assert published == pytest.approx(linear_bicycle(benchmark_bicycle()).eigenvalues(row["speed"]))
        error = np.abs(measured - published) / np.maximum(np.abs(published), 1.0)
        assert error.max() <= 0.03, row
        assert row["error"] == pytest.approx(error.max())


def test_would_notice_tyres_that_slip() -> None:
    """A tyre a third as stiff against slipping makes another bicycle, and the numbers say so."""
    parameters = benchmark_bicycle()
    soft = Bicycle(replace(parameters, tyre=TyreParameters(tangential_stiffness=1e5)))
    speeds = [7.0, 8.0]
    found = simulated_eigenvalues(soft, speeds)
    ideal = linear_bicycle(parameters)
    errors = [
        relative_error(matched(values, ideal.eigenvalues(speed)), ideal.eigenvalues(speed))
        for speed, values in zip(speeds, found, strict=True)
    ]
    assert min(errors) > 0.04


def test_critical_speeds_of_the_closed_form() -> None:
    ideal = linear_bicycle(benchmark_bicycle())

    def eigenvalues(speeds: np.ndarray) -> np.ndarray:
        return np.stack([ideal.eigenvalues(float(speed)) for speed in speeds])

    found = critical_speeds(eigenvalues, np.linspace(2.0, 9.0, 15))
    assert found.weave == pytest.approx(4.29238253634111, abs=1e-5)
    assert found.capsize == pytest.approx(6.02426201538837, abs=1e-5)
    with pytest.raises(ValueError, match=r"no weave speed between 5 and 8 m/s"):
        critical_speeds(eigenvalues, np.linspace(5.0, 8.0, 4))


def test_matching_follows_the_nearest() -> None:
    expected = np.array([0.1, -1.0 + 4.0j, -1.0 - 4.0j, -14.0])
    assert matched(np.array([-13.8, -1.1 - 4.1j, -1.1 + 4.1j, 0.12]), expected) == pytest.approx(
        [0.12, -1.1 + 4.1j, -1.1 - 4.1j, -13.8]
    )


def test_rows_are_json_and_a_table_that_fits_a_terminal() -> None:
    assert json.loads(json.dumps(rows())) == list(rows())
    console = Console(width=80, file=io.StringIO())
    print_table(rows(), console)
    text = console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue] (it is the StringIO)
    assert "…" not in text
    assert text.count("published") == len(rows()) - 1 + 2
    assert "-0.775 ± 4.465i" in text  # the published weave at 5 m/s
