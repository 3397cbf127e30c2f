"""Who is there, and who holds the handlebars. Plain logic without sockets or clocks.

At most one person holds the handlebars. They are taken when free, passed on by the holder, let go of, and free again
when the holder is gone. Whoever holds them also directs (pauses, restarts, slow motion); while nobody does, everybody
may.
"""

from __future__ import annotations

from dataclasses import dataclass

from echelon.errors import InputError


@dataclass(frozen=True)
class Person:
    """Somebody with the page open.

    id: Number given by the front, never used twice.
    viewer: The number under which viser knows the same page.
    riding: Whether this person holds the handlebars.
    """

    id: int
    name: str
    viewer: int
    riding: bool


class People:
    """Everybody who said hello, in the order in which they came."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[str, int]] = {}
        self._rider: int | None = None

    @property
    def rider(self) -> int | None:
        """The number of whoever holds the handlebars."""
        return self._rider

    def __contains__(self, person: object) -> bool:
        return person in self._known

    def everybody(self) -> tuple[Person, ...]:
        """All people, as they are now."""
        return tuple(
            Person(number, name, viewer, number == self._rider) for number, (name, viewer) in self._known.items()
        )

    def greet(self, person: int, name: str, viewer: int) -> None:
        """Takes somebody in, or learns a new name or viewer of somebody known.

        Raises:
            InputError: Another person has this viewer; nobody may move another's camera.
        """
        for other, (_, taken) in self._known.items():
            if taken == viewer and other != person:
                raise InputError(f"message hello: viewer = {viewer}, but that is the page of somebody else")
        self._known[person] = (name, viewer)

    def farewell(self, person: int) -> bool:
        """Somebody is gone. Whether the handlebars became free by it."""
        self._known.pop(person, None)
        return self.let_go(person)

    def take(self, person: int) -> bool:
        """Gives the handlebars to somebody if they are free. Whether the holder changed."""
        if self._rider is not None or person not in self._known:
            return False
        self._rider = person
        return True

    def pass_on(self, person: int, to: int) -> bool:
        """The holder hands the handlebars to somebody else who is there. Whether the holder changed."""
        if self._rider != person or to == person or to not in self._known:
            return False
        self._rider = to
        return True

    def let_go(self, person: int) -> bool:
        """The holder lets go. Whether the holder changed."""
        if self._rider != person:
            return False
        self._rider = None
        return True

    def may_direct(self, person: int) -> bool:
        """Whether somebody may pause, restart and the like."""
        return person in self._known and self._rider in (None, person)
