"""A recording that people watch, with a timeline (`Showing`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from echelon.errors import InputError
from echelon.play.dashboard import crowd_words
from echelon.play.moments import Moment, between
from echelon.play.web.messages import Command, Play, Rate, Seek
from echelon.recording import Recording


class Replayed:
    """A recording; see `Showing`.

    Attributes:
        at: Where it is shown [frames].
    """

    def __init__(self, recording: Recording) -> None:
        """Raises InputError where there are no frames yet."""
        if recording.frame_count < 1:
            raise InputError(f"{recording.path}: has no frames yet, so there is nothing to show")
        self._recording = recording
        self.casts, self.actors, self.world = recording.casts, recording.actors, recording.world
        self.frame_rate = recording.frame_rate
        self.at = 0.0
        self._last = recording.frame_count - 1
        self._rate, self._playing = 1.0, True
        self._moments: dict[int, Moment] = {}

    def hear(self, command: Command) -> bool:
        if isinstance(command, Seek):
            self.at = float(min(command.frame, self._last))
        elif isinstance(command, Rate):
            self._rate = command.rate
        elif isinstance(command, Play):
            self._playing = command.playing
            # Playing on from the end is playing again.
            if self._playing and self._at_end:
                self.at = 0.0 if self._rate > 0.0 else float(self._last)
        return False

    @property
    def _at_end(self) -> bool:
        return self.at >= self._last if self._rate > 0.0 else self.at <= 0.0

    @property
    def standing_still(self) -> bool:
        return not self._playing

    def picture(self) -> Moment:
        if self._playing:
            self.at = float(np.clip(self.at + self._rate, 0.0, self._last))
            self._playing = not self._at_end
        first = int(self.at)
        return between(self._moment(first), self._moment(min(first + 1, self._last)), self.at - first)

    def _moment(self, frame: int) -> Moment:
        """A frame; the two that were asked for last are kept."""
        if frame not in self._moments:
            recording = self._recording
            if len(self._moments) > 1:
                del self._moments[next(iter(self._moments))]
            self._moments[frame] = Moment(
                recording.link_poses[frame],
                np.asarray(recording.actor_poses[frame], dtype=np.float64),
                recording.removed[frame],
                int(np.count_nonzero(recording.fallen[frame])),
            )
        return self._moments[frame]

    @property
    def welcome(self) -> dict[str, Any]:
        scenario = self._recording.scenario
        return {
            "mode": "replay",
            "title": f"{scenario.get('title') or scenario.get('name', '')} ({self._recording.path.name})",
            "agents": self._recording.agent_count,
            "crowd": crowd_words(str(scenario.get("crowd", {}).get("character", ""))),
            "seed": scenario.get("seed", 0),
            "frames": self._recording.frame_count,
            "frame_rate": self.frame_rate,
        }

    def state(self) -> dict[str, Any]:
        frame = round(self.at)
        recording = self._recording
        corral = None
        if recording.world.get("corral") is not None:
            fallen = int(np.count_nonzero(recording.fallen[frame]))
            corral = {
                "in_corral": int(recording.in_corral[frame]),
                "agents": recording.agent_count,
                "fallen": fallen,
            }
        return {
            "frame": frame,
            "time": self.at / self.frame_rate,
            "paused": not self._playing,
            "rate": self._rate,
            "note": "",
            "ended": self._at_end and not self._playing,
            "rider": None,
            "herd": corral,
            "race": None,
        }

    def close(self) -> None:
        """A recording stays as it is."""
