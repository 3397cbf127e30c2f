"""Echelon from Python: run a scenario, open what was recorded, make a stage, a film or a plot of it."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from echelon.errors import InputError
from echelon.recording import Recording
from echelon.scenario import Scenario

if TYPE_CHECKING:
    from echelon.simulation import RunCost

Progress = Callable[[int, int], None]


class Run(Recording):
    """A recording that knows how to leave: as a USD stage, a film, a still, a filmstrip, or a plot.

    Everything else about it is `Recording`'s: ``times``, ``link_poses``, ``events``, ``scenario``, ``summary``, ...

    Attributes:
        cost: What simulating it took here (threads, memory, time by phase); None where it was opened.
    """

    cost: RunCost | None = None

    def export(
        self,
        path: str | PathLike[str],
        representation: Literal["auto", "rig", "skel", "points"] = "auto",
        *,
        progress: Progress | None = None,
    ) -> Path:
        """Write an OpenUSD stage.

        Args:
            path: A .usd, .usdc or .usda file.
            representation: "rig" animates a transform a link, "skel" is UsdSkel, "points" a PointInstancer a link;
                "auto" is "rig" for up to 150 agents, "points" for more.
            progress: Called with (parts done, parts in all).

        Raises:
            InputError: The file cannot be written.
        """
        from echelon.export.usd import write_stage

        return write_stage(self, path, representation, progress)

    def render(self, path: str | PathLike[str], *, strip: float | None = None, **options: Any) -> Path:
        """Make a film (.mp4), a still or, with ``strip``, a filmstrip (.png).

        Args:
            path: Ends in .mp4 or .png.
            strip: Time between the snapshots of a filmstrip [s].
            options: As `echelon.export.pictures.render_film`, `render_still` and `render_strip` take them.

        Raises:
            InputError: The file cannot be written, or an option is out of range.
            RenderingUnavailable: This machine has no EGL.
        """
        from echelon.export.pictures import render_film, render_still, render_strip

        target = Path(path)
        if strip is not None:
            return render_strip(self, target, interval=strip, **options)
        if target.suffix.lower() == ".mp4":
            return render_film(self, target, **options)
        return render_still(self, target, **options)

    def plot(self, path: str | PathLike[str]) -> Path:
        """One page of the run: paths from above, speeds, hop phases, distances.

        Raises:
            InputError: The file cannot be written.
        """
        from echelon.export.plots import plot_run

        return plot_run(self, Path(path))


def simulate(
    scenario: str | PathLike[str] | Scenario,
    *,
    agents: int | None = None,
    seconds: float | None = None,
    seed: int | None = None,
    settings: Mapping[str, Any] | None = None,
    recording: str | PathLike[str] | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
) -> Run:
    """Run a scenario.

    Args:
        scenario: Name of one that ships, path of a .toml file, or a `Scenario`.
        agents: How many characters, instead of the scenario's.
        seconds: How long at most, instead of the scenario's [s].
        seed: Of what happens at random, instead of the scenario's.
        settings: Any other keys of the scenario, dotted: ``{"herd.spacing": 3.0}``.
        recording: Folder to record into; one that is there is replaced. None records into a temporary folder, which
            goes when the result is no longer used.
        threads: On a CPU; 0 decides by the work there is; None leaves it to the scenario.
        progress: Called with (frames done, frames at most).
        device: A Warp device, "cpu" or "cuda:0".

    Returns:
        What happened.

    Raises:
        InputError: One line that says what is wrong with the scenario, a setting, or the folder.
        RecordingFailed: The disk is full or gone; what was written can be resumed.
    """
    from echelon import simulation

    changes = dict(settings or {})
    for key, value in (("crowd.count", agents), ("seconds", seconds), ("seed", seed)):
        if value is not None:
            changes[key] = value
    overrides = [f"{key}={_toml(key, value)}" for key, value in changes.items()]
    if isinstance(scenario, Scenario):
        plan = Scenario.from_dict(scenario.to_dict(), source=scenario.name, overrides=overrides)
    else:
        plan = Scenario.load(Path(scenario) if isinstance(scenario, PathLike) else scenario, overrides)
    temporary: tempfile.TemporaryDirectory[str] | None = None
    if recording is None:
        temporary = tempfile.TemporaryDirectory(prefix="echelon-")
        recording = Path(temporary.name) / f"{plan.name}.recording"
    folder = Path(recording)
    cost = simulation.RunCost()
    simulation.simulate(plan, recording=folder, threads=threads, progress=progress, device=device, cost=cost)
    run = Run(folder)
    run.cost = cost
    if temporary is not None:
        weakref.finalize(run, temporary.cleanup)
    return run


def resume(
    recording: str | PathLike[str],
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
) -> Run:
    """Go on with a run that was interrupted, to the bytes that it would have had; arguments as for `simulate`.

    Raises:
        InputError: It is no recording, or is finished.
        RecordingFailed: Writing failed, or this machine computes something else than the first did.
    """
    from echelon import simulation

    cost = simulation.RunCost()
    simulation.resume(Path(recording), threads=threads, progress=progress, device=device, cost=cost)
    run = Run(Path(recording))
    run.cost = cost
    return run


def open_recording(path: str | PathLike[str]) -> Run:
    """Open a recording; what is large in it is read when it is asked for.

    Raises:
        InputError: It is not a recording, is damaged or truncated, or is of an unknown version.
    """
    return Run(Path(path))


def _toml(key: str, value: Any) -> str:
    """A setting as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(key, entry) for entry in value) + "]"
    raise InputError(f"{key} = {value!r}: must be a number, a string, true or false, or a list of them")
