"""Commands on their way from the front's thread to the loop's: in order, and never more than a loop can catch up with.

Of commands that say how things *are* (hands and feet, where somebody looks, which frame to show) only the newest of
each person is kept. The others (a gear up, a pause) are kept in order; a loop that has stood still for so long that
they fill the box finds the oldest of them, and the newest are lost: nobody wants a minute of gear changes at once.
"""

from __future__ import annotations

import threading

from echelon.play.web.messages import ChangeView, Command, LetGo, Look, Pause, Rate, Ride, Seek, Slow

NEWEST_ONLY = (Ride, LetGo, Look, ChangeView, Seek, Rate, Slow, Pause)
CAPACITY = 256  # commands of the other kinds


class Inbox:
    """A bounded queue of (person, command) for any number of threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # keyed so that a newer state takes the place of an older one; dicts keep the order of insertion
        self._waiting: dict[tuple[int, object], tuple[int, Command]] = {}
        self._others = 0

    def put(self, person: int, command: Command) -> bool:
        """Adds a command; False where the box is full and the command was lost."""
        with self._lock:
            if isinstance(command, NEWEST_ONLY):
                # letting go and riding are states of the same hands
                kind = Ride if isinstance(command, LetGo) else type(command)
                self._waiting.pop((person, kind), None)
                self._waiting[(person, kind)] = (person, command)
                return True
            if self._others >= CAPACITY:
                return False
            self._others += 1
            self._waiting[(person, object())] = (person, command)
            return True

    def forget(self, person: int) -> None:
        """Throws away where a person wanted to look and how they rode: that person is gone."""
        with self._lock:
            for key in [key for key in self._waiting if key[0] == person and isinstance(key[1], type)]:
                del self._waiting[key]

    def take(self) -> list[tuple[int, Command]]:
        """Everything that waits, in order of arrival; the box is empty then."""
        with self._lock:
            waiting, self._waiting = self._waiting, {}
            self._others = 0
        return list(waiting.values())
