"""`echelon bench bicycle`: does the engine's bicycle balance as a bicycle does?

The benchmark bicycle of Meijaard et al. (2007), its rider rigid and hands off, rolls through the engine as scenarios
run it: float32 lanes, semi-implicit Euler, tyres that give. At each speed four of them start with a small lean, steer,
lean rate or steer rate. What follows is watched at even intervals, and the 4 x 4 matrix T that takes each look at
(lean, steer, and their rates) to the next is fitted to all four by least squares. If they move as x' = A x, then
T = exp(A t), so the eigenvalues of A are the logarithms of those of T over t. Nothing is taken from the model that is
tested, and the published eigenvalues come from its linearised equations in closed form (`agents.riders.whipple`).

At first the tyres ring; that dies out within a tenth of a second and is not looked at.

Between the *weave speed*, above which the oscillating mode decays, and the *capsize speed*, above which a slow fall
begins, the bicycle balances itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text
from scipy.optimize import linear_sum_assignment

from echelon.agents.riders.bicycle import Bicycle, BicycleParameters, benchmark_bicycle
from echelon.agents.riders.coasting import roll
from echelon.agents.riders.whipple import LinearBicycle, in_order, linear_bicycle

Progress = Callable[[int, int], None]

SPEEDS = tuple(3.0 + 0.5 * step for step in range(11))
"""Of the table [m/s]."""

REFINEMENTS = 2
"""How often the interval that holds a critical speed is divided anew."""
PASSES = 1 + 2 * REFINEMENTS

LOOKS_PER_SECOND = 60
SETTLING_LOOKS = 6  # that are not used, while the tyres ring
LOOKS = 60
INTERVAL = 2  # looks from one side of the fit to the other
AMPLITUDE = 0.003  # [rad]; larger and the sine is not its angle, smaller and it is lost in float32
PERTURBATIONS = np.diag([1.0, 1.0, 3.0, 10.0])  # lean, steer [rad], lean rate, steer rate [rad/s] of each of the four
OSCILLATION = 0.1  # an eigenvalue with a larger imaginary part oscillates [rad/s]

Row = dict[str, Any]


# ---- measuring -------------------------------------------------------------------------------------------------------
def simulated_eigenvalues(bicycle: Bicycle, speeds: Sequence[float] | np.ndarray) -> np.ndarray:
    """Eigenvalues of a bicycle's lateral motion, from simulated perturbations.

    Args:
        bicycle: Whose; its rider is rigid and hands off.
        speeds: At which forward speeds [m/s], where nothing grows by more than about e^2 in a second.

    Returns:
        Four complex eigenvalues a speed by falling real part [1/s], shape [speeds, 4].
    """
    seen = _watch(bicycle, np.asarray(speeds, dtype=float))
    return np.stack([in_order(_fitted(seen[:, index])) for index in range(seen.shape[1])])


def _watch(bicycle: Bicycle, speeds: np.ndarray) -> np.ndarray:
    """Lean, steer and their rates of each look and perturbation, shape [looks, speeds, 4 perturbations, 4]."""
    lean, steer, lean_rate, steer_rate = AMPLITUDE * PERTURBATIONS
    q, u = bicycle.rolling(speeds[:, None], lean=lean, steer=steer, lean_rate=lean_rate, steer_rate=steer_rate)
    count = q.shape[0] * q.shape[1]
    seen = roll(
        bicycle,
        q.reshape(count, -1),
        u.reshape(count, -1),
        LOOKS / LOOKS_PER_SECOND,
        looks_per_second=LOOKS_PER_SECOND,
    )
    states = np.stack([seen.lean, seen.steer, seen.lean_rate, seen.steer_rate], axis=-1)
    return states[1 + SETTLING_LOOKS :].reshape(-1, *q.shape[:2], 4)


def _fitted(seen: np.ndarray) -> np.ndarray:
    """Eigenvalues [1/s] of the motion that looks of shape [looks, perturbations, 4] show."""
    before, after = seen[:-INTERVAL].reshape(-1, 4), seen[INTERVAL:].reshape(-1, 4)
    transition = np.linalg.lstsq(before, after, rcond=None)[0].T
    return np.log(np.linalg.eigvals(transition).astype(complex)) * (LOOKS_PER_SECOND / INTERVAL)


@dataclass(frozen=True)
class CriticalSpeeds:
    """Where a bicycle begins and ceases to balance itself.

    Attributes:
        weave: Above it the weave decays [m/s].
        capsize: Above it the bicycle falls slowly to one side [m/s].
    """

    weave: float
    capsize: float


def critical_speeds(
    eigenvalues: Callable[[np.ndarray], np.ndarray], speeds: Sequence[float] | np.ndarray = SPEEDS
) -> CriticalSpeeds:
    """Weave and capsize speed: between which of some speeds growth turns to decay, or decay to growth.

    Args:
        eigenvalues: Gives four eigenvalues for each of some speeds, shapes [n] and [n, 4]; called `PASSES` times.
        speeds: To look between, rising [m/s].

    Raises:
        ValueError: If either speed is not among these.
    """
    coarse = np.asarray(speeds, dtype=float)
    found = eigenvalues(coarse)
    critical = []
    for name, growth in (("weave", _weave_growth), ("capsize", _capsize_growth)):
        at, rates = coarse, growth(found)
        for _ in range(REFINEMENTS):
            place = _crossing(name, at, rates)
            at = np.linspace(at[place], at[place + 1], len(coarse))
            rates = growth(eigenvalues(at))
        place = _crossing(name, at, rates)
        part = rates[place] / (rates[place] - rates[place + 1])
        critical.append(float(at[place] + part * (at[place + 1] - at[place])))
    return CriticalSpeeds(*critical)


def _weave_growth(eigenvalues: np.ndarray) -> np.ndarray:
    """Largest growth rate among modes that oscillate [1/s], nan where none does."""
    oscillating = np.abs(np.imag(eigenvalues)) > OSCILLATION
    return _largest(np.where(oscillating, np.real(eigenvalues), np.nan))


def _capsize_growth(eigenvalues: np.ndarray) -> np.ndarray:
    """Largest growth rate among modes that do not oscillate [1/s], nan where all do."""
    return _largest(np.where(np.abs(np.imag(eigenvalues)) > OSCILLATION, np.nan, np.real(eigenvalues)))


def _largest(values: np.ndarray) -> np.ndarray:
    return np.where(np.isnan(values).all(axis=-1), np.nan, np.fmax.reduce(values, axis=-1))


def _crossing(name: str, speeds: np.ndarray, rates: np.ndarray) -> int:
    """The first place after which a growth rate changes its sign."""
    changes = np.flatnonzero(rates[:-1] * rates[1:] < 0.0)
    if not len(changes):
        raise ValueError(f"no {name} speed between {speeds[0]:g} and {speeds[-1]:g} m/s")
    return int(changes[0])


def matched(eigenvalues: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Four eigenvalues in the order of those that they are nearest to, all in all."""
    rows, columns = linear_sum_assignment(np.abs(eigenvalues[:, None] - expected[None, :]))
    result = np.empty(4, dtype=complex)
    result[columns] = eigenvalues[rows]
    return result


def relative_error(eigenvalues: np.ndarray, expected: np.ndarray) -> float:
    """Largest |error| / max(|lambda|, 1/s) of four matched eigenvalues."""
    return float(np.max(np.abs(eigenvalues - expected) / np.maximum(np.abs(expected), 1.0)))


# ---- the study -------------------------------------------------------------------------------------------------------
def run_bicycle_benchmark(
    parameters: BicycleParameters | None = None,
    *,
    speeds: Sequence[float] = SPEEDS,
    progress: Progress | None = None,
) -> list[Row]:
    """Measure a bicycle's eigenvalues and compare them with those of the linearised Whipple model.

    Args:
        parameters: Of the bicycle; the benchmark's if not given.
        speeds: Rising, such that both critical speeds lie among them [m/s].
        progress: Called with (measurements done, of how many).

    Returns:
        Plain data, ready for JSON. A row a speed: `speed` [m/s], `published` and `measured` eigenvalues as
        [real, imaginary] [1/s], by falling real part of the published ones, and `error`, the largest
        |error| / max(|lambda|, 1/s). Then one row with `weave_speed`, `published_weave_speed`, `capsize_speed` and
        `published_capsize_speed` [m/s], and the conditions: `step_seconds`, `precision`.
    """
    bicycle = Bicycle(benchmark_bicycle() if parameters is None else parameters)
    ideal = linear_bicycle(bicycle.bicycle)
    done = 0

    def measured(at: np.ndarray) -> np.ndarray:
        nonlocal done
        found = simulated_eigenvalues(bicycle, at)
        done += 1
        if progress is not None:
            progress(done, 1 + PASSES)
        return found

    if progress is not None:
        progress(0, 1 + PASSES)
    rows = [_row(ideal, speed, found) for speed, found in zip(speeds, measured(np.array(speeds)), strict=True)]
    ours = critical_speeds(measured, speeds)
    published = critical_speeds(lambda at: np.stack([ideal.eigenvalues(float(v)) for v in at]), speeds)
    summary = {
        "weave_speed": ours.weave,
        "published_weave_speed": published.weave,
        "capsize_speed": ours.capsize,
        "published_capsize_speed": published.capsize,
        "step_seconds": 1.0 / bicycle.steps_per_second,
        "precision": "float32",
    }
    return [*rows, summary]


def _row(ideal: LinearBicycle, speed: float, found: np.ndarray) -> Row:
    published = ideal.eigenvalues(speed)
    measured = matched(found, published)
    return {
        "speed": float(speed),
        "published": _pairs(published),
        "measured": _pairs(measured),
        "error": relative_error(measured, published),
    }


def _pairs(values: np.ndarray) -> list[list[float]]:
    return [[float(np.real(value)), float(np.imag(value))] for value in values]


# ---- for people ------------------------------------------------------------------------------------------------------
MODES = ("weave", "capsize", "castering")


def print_table(rows: Sequence[Row], console: Console | None = None) -> None:
    """Print what `run_bicycle_benchmark` returned: for each mode and speed both eigenvalues [1/s]."""
    console = console or Console()
    *speeds, summary = rows
    table = Table(title="Eigenvalues [1/s]", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), title_justify="left")
    table.add_column(Text("speed [m/s]"), justify="right")
    table.add_column("")
    for heading in (*MODES, "error"):
        table.add_column(heading, justify="right")
    for row in speeds:
        published, measured = _cells(row)
        table.add_row(f"{row['speed']:.2f}", "published", *published, "")
        table.add_row("", "measured", *measured, f"{row['error']:.3f}")
    console.print(table)
    for line in (
        f"Weave speed {summary['weave_speed']:.3f} m/s (published {summary['published_weave_speed']:.3f}), "
        f"capsize speed {summary['capsize_speed']:.3f} m/s (published {summary['published_capsize_speed']:.3f}).",
        f"Error: the largest |error| / max(|eigenvalue|, 1/s). {summary['precision']}, substeps of "
        f"{1e3 * summary['step_seconds']:.3f} ms, tyres that give.",
    ):
        console.print(line, markup=False, highlight=False)


def _cells(row: Row) -> tuple[list[str], list[str]]:
    """Published and measured eigenvalue of each mode; dashes where the four are not a pair and two real ones."""
    published = [complex(*value) for value in row["published"]]
    measured = [complex(*value) for value in row["measured"]]
    pair = [place for place, value in enumerate(published) if value.imag > OSCILLATION]
    real = [place for place, value in enumerate(published) if abs(value.imag) <= OSCILLATION]
    if len(pair) != 1 or len(real) != 2:
        return ["–"] * len(MODES), ["–"] * len(MODES)
    places = (*pair, *real)
    return [_text(published[place]) for place in places], [_text(measured[place]) for place in places]


def _text(value: complex) -> str:
    return f"{value.real:.3f} ± {value.imag:.3f}i" if value.imag > OSCILLATION else f"{value.real:.3f}"
