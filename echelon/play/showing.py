"""What a session shows, live or recorded: the same to the loop that draws it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from echelon.play.moments import Moment
from echelon.play.web.messages import Command
from echelon.recording import Actor, Cast


class Showing(Protocol):
    """A world that goes on by a picture at a time."""

    @property
    def casts(self) -> Sequence[Cast]:
        """Who, as a recording has them."""
        ...

    @property
    def actors(self) -> Sequence[Actor]:
        """Who else."""
        ...

    @property
    def world(self) -> Mapping[str, Any]:
        """Where, as a recording has it."""
        ...

    @property
    def frame_rate(self) -> int:
        """Pictures a second."""
        ...

    @property
    def welcome(self) -> Mapping[str, Any]:
        """What a page is told first."""
        ...

    @property
    def standing_still(self) -> bool:
        """Whether nothing goes on by itself at present, so that no time is lost either."""
        ...

    def hear(self, command: Command) -> bool:
        """Take a person's command; whether other casts or actors are there from now on."""
        ...

    def picture(self) -> Moment:
        """What is to be seen a picture later."""
        ...

    def state(self) -> dict[str, Any]:
        """What pages are told with a picture."""
        ...

    def close(self) -> None:
        """Nobody watches any more."""
        ...
