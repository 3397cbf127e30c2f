"""A world that is simulated while people watch, one of them from the saddle (`Showing`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from echelon.errors import InputError
from echelon.play.controls import Controls
from echelon.play.dashboard import crowd_words, dashboard, gradient, pitch
from echelon.play.moments import Moment, between
from echelon.play.pace import frames_between
from echelon.play.takes import Take, free_folder
from echelon.play.trainer.trainer import Trainer
from echelon.play.web.messages import Command, Pause, Restart, Ride, Save, Slow
from echelon.recording import REMOVED_PHASE, Actor, Cast, RecordingFailed
from echelon.scenario import Scenario
from echelon.simulation.recorded import recorded_casts

FORGOTTEN = 1.0
"""A take that was given up before it lasted this long is not kept [s]."""


class Live:
    """The world as it is simulated; see `Showing`.

    Attributes:
        take: That is being made.
        kept: Folders of takes that have ended, and how long each is [s].
    """

    def __init__(
        self,
        begin: Callable[[Scenario, Path], Take],
        scenario: Scenario,
        folder: Path,
        *,
        trainer: Trainer | None = None,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        """
        Args:
            begin: Begins a take of a scenario in a folder.
            scenario: What is played (`ridable`).
            folder: Where takes go.
            trainer: A bicycle whose power drives the avatar.
            say: Called with what is worth knowing outside of the page.

        Raises:
            InputError: The scenario or the folder will not do.
        """
        self._begin, self._folder, self._trainer, self._say = begin, folder, trainer, say
        self.kept: list[tuple[Path, float]] = []
        self.frame_rate = scenario.frame_rate
        self._note = ""
        self._paused, self._rate = False, 1.0
        self._start(scenario)

    def _start(self, scenario: Scenario) -> None:
        self.take = self._begin(scenario, free_folder(scenario.name, self._folder))
        self.casts: Sequence[Cast] = recorded_casts(self.take.simulation)
        self.actors: Sequence[Actor] = self.take.simulation.scene.actors
        self.world: Mapping[str, Any] = self.take.simulation.scene.world
        self._controls = Controls()
        self._row = self._controls.row()
        self._part = 0.0
        names = self.take.simulation.fallen.phase_names
        self._removed_phase = names.index(REMOVED_PHASE) if REMOVED_PHASE in names else -1
        while self.take.catching_up:
            self.take.advance(self._row)
        self._advance()
        self._before = self._now
        # The race does not start without its rider.
        self._waiting = self.take.ridden
        self._note = "take the handlebars to begin" if self._waiting else f"recording {self.take.folder.name}"

    # ---- what people do --------------------------------------------------------------------------------------------
    def hear(self, command: Command) -> bool:
        if self._waiting and (isinstance(command, Ride) or command == Pause(False)):
            self._waiting, self._note = False, f"recording {self.take.folder.name}"
        if isinstance(command, Pause):
            self._paused = command.paused
        elif isinstance(command, Slow):
            self._rate = command.rate
        elif isinstance(command, Save):
            self._note = f"recorded so far: {self.take.folder.name}, {self._seconds:.1f} s"
        elif isinstance(command, Restart):
            return self._restart(command)
        else:
            self._controls.hear(command)
        return False

    def _restart(self, command: Restart) -> bool:
        scenario = self.take.scenario
        changes = [] if command.seed is None else [f"seed={command.seed}", f"population_seed={command.seed}"]
        try:
            if command.agents is not None and command.agents != len(scenario.crowd.positions):
                # Places that were given one by one are those of another crowd.
                scenario = replace(scenario, crowd=replace(scenario.crowd, positions=(), count=command.agents))
            scenario = Scenario.from_dict(scenario.to_dict(), source=scenario.name, overrides=changes)
        except InputError as error:
            self._note = str(error)
            return False
        self._end()
        self._paused = False
        self._start(scenario)
        return True

    # ---- frame by frame --------------------------------------------------------------------------------------------
    @property
    def standing_still(self) -> bool:
        return self._paused or self._waiting or self.take.over

    @property
    def _seconds(self) -> float:
        return max(self.take.frame, 0) / self.frame_rate

    def picture(self) -> Moment:
        if not self.standing_still:
            count, self._part = frames_between(self._part, self._rate)
            for _ in range(count):
                self._advance()
        # At full pace the newest frame is shown, so that hands are felt at once; slowed down, what is between two.
        return self._now if self._rate == 1.0 else between(self._before, self._now, self._part)

    def _advance(self) -> None:
        take, power = self.take, None
        if take.over:
            return
        if self._trainer is not None and self._trainer.connected:
            power = self._trainer.reading().power
        self._row = self._controls.row(power)
        try:
            take.advance(self._row)
        except RecordingFailed as error:
            self._note = str(error)
            self._say(str(error))
            self._end()
            return
        run = take.run
        removed = run.phases == self._removed_phase
        now = Moment(run.link_poses, np.array(run.actor_poses), removed, int(np.count_nonzero(run.fallen)))
        self._before, self._now = getattr(self, "_now", now), now
        if self._trainer is not None and now.rider is not None:
            self._trainer.set_gradient(gradient(take.simulation))
            self._trainer.set_pitch(pitch(now.rider))
        if take.over:
            self._end()

    def _end(self) -> None:
        """The take is over: keep it, unless there is next to nothing in it."""
        take, seconds = self.take, self._seconds
        if take.ended:
            return
        reached = take.run.over
        try:
            take.end()
        except RecordingFailed as error:
            self._say(str(error))
            return
        if seconds < FORGOTTEN and not reached:
            take.discard()
            return
        self.kept.append((take.folder, seconds))
        self._note = f"the end, after {seconds:.1f} s; kept as {take.folder.name}"
        self._say(f"{take.folder}: a take of {seconds:.1f} s")

    # ---- what pages are told ---------------------------------------------------------------------------------------
    @property
    def welcome(self) -> Mapping[str, Any]:
        scenario = self.take.scenario
        mode = "race" if scenario.on_road else "herd"
        return {
            "mode": mode if self.take.ridden else "watch",
            "title": scenario.title or scenario.name,
            "agents": scenario.crowd.count,
            "crowd": crowd_words(scenario.crowd.character),
            "seed": scenario.seed,
            "frames": 0,
            "frame_rate": self.frame_rate,
        }

    def state(self) -> dict[str, Any]:
        note = self._note
        if self._trainer is not None and self._trainer.note:
            note = self._trainer.note
        return {
            "frame": self.take.frame,
            "time": self._seconds,
            "paused": self._paused or self._waiting,
            "waiting": self._waiting,
            "rate": self._rate,
            "note": note,
            "ended": self.take.over,
            **dashboard(self.take.simulation, self._row, self._now.fallen),
        }

    def close(self) -> None:
        self._end()
