"""Takes: runs in which a person rides, each a recording in a folder of its own that no other take replaces."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from echelon.errors import InputError
from echelon.recording import Recording, RecordingWriter, branch
from echelon.scenario import CollieSettings, Scenario
from echelon.scenario.road import UserSettings
from echelon.simulation import Simulation
from echelon.simulation.recorded import RecordedRun, recording_of

LONGEST = 3600.0
"""A take may last this long, or as long as the scenario where that is longer [s]."""


def ridable(scenario: Scenario) -> Scenario:
    """The scenario with a person on the bicycle of its collie or user; one is put there where there is none.

    Gymnasts have no bicycle among them: their scenario stays, to be watched.
    """
    seconds = max(scenario.seconds, LONGEST)
    if scenario.performs:
        return scenario
    if scenario.on_road:
        user = replace(scenario.user or UserSettings(), by="person")
        if user.ahead == UserSettings().ahead:
            # Whoever starts ahead of all others sees an empty road: a person starts behind the last row.
            grid = scenario.peloton
            user = replace(user, ahead=-grid.row_spacing * (scenario.crowd.count / grid.columns + 1.0))
        return replace(scenario, user=user, seconds=seconds)
    collie = replace(scenario.collie or CollieSettings(), driver="person", waypoints=())
    # Whoever comes onto the field sees the herd.
    x, y = np.mean(scenario.start_positions(), axis=0) - collie.start
    return replace(scenario, collie=replace(collie, heading=math.atan2(y, x)), seconds=seconds)


def free_folder(scenario_name: str, folder: Path) -> Path:
    """The first name of a take that is not there yet, in a folder: NAME-take-1.recording and so on."""
    number = 1
    while (path := folder / f"{scenario_name}-take-{number}.recording").exists():
        number += 1
    return path


class Take:
    """A take that is being made.

    Attributes:
        scenario: What is played.
        folder: Where it is recorded.
        run: Its frames.
        simulation: What runs.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        *,
        threads: int | None = None,
        device: str = "cpu",
        after: Recording | None = None,
        frame: int = 0,
    ) -> None:
        """
        Args:
            scenario: What is played (`ridable`).
            folder: Where to record; a recording that is there is replaced.
            threads, device: As for `Simulation`.
            after: A take to go on with; None to begin anew.
            frame: From which frame of that on somebody else rides.

        Raises:
            InputError: The scenario or the folder will not do, or the take has no such frame or nobody rode in it.
        """
        self.scenario, self.folder = scenario, folder
        self._past: np.ndarray | None = None
        if after is not None:
            self._past = _controls_before(after, frame)
            branch(after, folder, frame)
        self.simulation = Simulation(scenario, threads=threads, device=device, world=after.world if after else None)
        try:
            state = None
            if after is None:
                writer = recording_of(self.simulation, folder)
            else:
                writer, state = RecordingWriter.reopen(folder)
            self._writer = writer
            if state is None:
                self.simulation.preroll()
            else:
                self.simulation.load_state(state, writer.next_frame)
            self.run = RecordedRun(self.simulation, writer)
        except BaseException:
            self.simulation.close()
            raise
        self._ended = False

    @property
    def ridden(self) -> bool:
        """Whether a person can ride in it."""
        return bool(self.simulation.scene.control_names)

    @property
    def frame(self) -> int:
        """Number of the frame simulated last, -1 before the first."""
        return self.simulation.frame - 1

    @property
    def catching_up(self) -> bool:
        """Whether the frames before the one that is gone on from are still simulated again."""
        return self._past is not None and self.simulation.frame < len(self._past)

    @property
    def over(self) -> bool:
        """Whether it has come to its end, or was ended."""
        return self._ended or self.run.over

    @property
    def ended(self) -> bool:
        """Whether `end` has been called."""
        return self._ended

    def advance(self, controls: np.ndarray) -> None:
        """Simulate a frame with these controls; those before a frame that is gone on from are the take's own.

        Raises:
            RecordingFailed: Writing failed; what counts is safe.
        """
        if self._past is not None and self.catching_up:
            controls = self._past[self.simulation.frame]
        self.run.advance(controls if self.ridden else None)

    def end(self) -> None:
        """Finish the recording; nothing happens after that.

        Raises:
            RecordingFailed: Writing failed.
        """
        if self._ended:
            return
        self._ended = True
        try:
            self.run.finish()
        finally:
            self._writer.close()
            self.simulation.close()

    def discard(self) -> None:
        """Remove the recording of a take that has ended."""
        shutil.rmtree(self.folder, ignore_errors=True)


def _controls_before(take: Recording, frame: int) -> np.ndarray:
    """What the person did in the frames before one, shape [frames, controls]."""
    if not take.control_names and not Scenario.from_dict(take.scenario, source=str(take.path)).performs:
        raise InputError(f"{take.path}: nobody rode in it; only takes of echelon play are gone on with by a person")
    if not 0 <= frame <= take.frame_count:
        last = math.floor(take.frame_count / take.frame_rate * 100.0) / 100.0
        raise InputError(f"{take.path}: frame {frame}: must be from 0 to {take.frame_count}, which is {last:g} s")
    return take.controls[:frame]
