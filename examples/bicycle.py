"""A bicycle that balances itself, from its parameters alone: push it at several speeds, and see why it stays up.

What it shows:

1. a bicycle made of the parameters that papers give (`BicycleParameters`);
2. bicycles whose riders sit rigid and hands off, pushed to one side and left to roll (`roll`);
3. eigenvalues from simulated perturbations, beside those of the linear theory;
4. how the speeds of self-stability change with one parameter.

How to run it, in an environment where Echelon is installed:

    python examples/bicycle.py                              the benchmark bicycle
    python examples/bicycle.py --trail 0.05 --out short.png     one with less trail
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from echelon.agents.riders.bicycle import Bicycle, benchmark_bicycle
from echelon.agents.riders.coasting import Coast, roll
from echelon.agents.riders.whipple import LinearBicycle, linear_bicycle
from echelon.benchmarks.bicycle import critical_speeds, simulated_eigenvalues

PUSHED_AT = np.array([3.0, 5.0, 8.0])  # [m/s]
PUSH = 0.4  # rate of lean that the push leaves [rad/s]


def main(trail: float | None = None, out: Path = Path("bicycle.png")) -> dict[str, float]:
    """Run the example.

    Args:
        trail: Of the bicycle [m]; the benchmark's 0.08 if not given.
        out: The picture to write.

    Returns:
        What was printed, by name.
    """
    # 1. The bicycle. Every parameter is a plain number; whatever a paper gives can be put in its place.
    parameters = benchmark_bicycle()
    if trail is not None:
        parameters = replace(parameters, trail=trail)
    bicycle = Bicycle(parameters)

    # 2. Pushed to the right and left alone. All three roll at once.
    q, u = bicycle.rolling(PUSHED_AT, lean_rate=PUSH)
    coast = roll(bicycle, q, u, seconds=8.0)
    for speed, lean, fallen in zip(PUSHED_AT, coast.lean[-1], coast.fallen[-1], strict=True):
        end = "has fallen" if fallen else f"leans by {np.degrees(lean):.1f} degrees"
        print(f"pushed at {speed} m/s, after 8 s it {end}")

    # 3. Eigenvalues: simulated, and of the linear equations.
    speeds = np.linspace(3.0, 8.0, 11)
    simulated = simulated_eigenvalues(bicycle, speeds)
    theory = linear_bicycle(parameters)
    found = {"greatest difference from theory [1/s]": difference(theory, speeds, simulated)}

    # 4. Where it balances itself, if anywhere between 3 and 8 m/s.
    try:
        critical = critical_speeds(lambda at: simulated_eigenvalues(bicycle, at), speeds)
        found |= {"balances itself from [m/s]": critical.weave, "up to [m/s]": critical.capsize}
    except ValueError as error:
        print(error)
    for name, value in found.items():
        print(f"  {name:<40} {value:.3f}")
    draw(coast, theory, speeds, simulated, out)
    print(f"wrote {out}")
    return found


def difference(theory: LinearBicycle, speeds: np.ndarray, simulated: np.ndarray) -> float:
    """Greatest difference of the growth rate of the least stable mode [1/s]."""
    expected = np.array([np.real(theory.eigenvalues(float(speed))[0]) for speed in speeds])
    return float(np.abs(np.real(simulated[:, 0]) - expected).max())


def draw(coast: Coast, theory: LinearBicycle, speeds: np.ndarray, simulated: np.ndarray, path: Path) -> None:
    """Eigenvalues over speed, and lean over time, side by side."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    draw_eigenvalues(left, theory, speeds, simulated)
    for index, speed in enumerate(PUSHED_AT):
        standing = ~coast.fallen[:, index]
        right.plot(coast.times[standing], np.degrees(coast.lean[standing, index]), label=f"{speed} m/s")
    right.set(xlabel="time after the push [s]", ylabel="lean to the right [degrees]", ylim=(-15.0, 15.0))
    right.set_title("Pushed, hands off")
    right.legend(frameon=False)
    FigureCanvasAgg(figure).print_png(path, metadata={"Software": None})


def draw_eigenvalues(axes: Axes, theory: LinearBicycle, speeds: np.ndarray, simulated: np.ndarray) -> None:
    """Lines are theory, dots are the simulation; where all growth rates are negative the bicycle balances itself."""
    fine = np.linspace(0.0, 10.0, 401)
    expected = np.stack([theory.eigenvalues(float(speed)) for speed in fine])
    stable = np.real(expected).max(axis=1) < 0.0
    axes.fill_between(fine, -10.0, 10.0, where=stable.tolist(), color="#d8ead3", linewidth=0.0)
    axes.axhline(0.0, color="#9aa4ad", linewidth=0.8)
    for values, at, size in ((expected, fine, 0.6), (simulated, speeds, 26.0)):
        each = np.repeat(at, 4)
        axes.scatter(each, np.real(values).ravel(), s=size, color="#2f6f9f", linewidths=0.0)
        frequency = np.abs(np.imag(values)).ravel()
        swings = frequency > 0.1
        axes.scatter(each[swings], frequency[swings], s=size, color="#c0182b", linewidths=0.0, alpha=0.5)
    axes.text(9.9, 0.8, "growth [1/s]", color="#2f6f9f", ha="right")
    axes.text(6.6, 8.6, "frequency [rad/s]", color="#c0182b", ha="right")
    axes.set(xlabel="speed [m/s]", xlim=(0.0, 10.0), ylim=(-10.0, 10.0))
    axes.set_title("Eigenvalues: lines theory, dots simulation")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="A bicycle that balances itself.")
    parser.add_argument("--trail", type=float, help="of the bicycle [m]; by default the benchmark's, 0.08")
    parser.add_argument("--out", type=Path, default=Path("bicycle.png"), help="the picture to write")
    arguments = parser.parse_args()
    main(arguments.trail, arguments.out)
