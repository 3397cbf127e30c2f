"""The table of events as it grows: rows in order, in chunks of its own that do not follow those of the frames.

A chunk of events is written again each time that rows join it, until it is full. So the log keeps the rows of the one
that is not, and a run that goes on takes them up where it does.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from echelon.recording.layout import EVENT_DTYPE, ArrayLayout, event_array, read_chunk


class EventLog:
    """What is known of the events of a recording while it is written.

    Attributes:
        layout: Of the stored table.
        count: How many events there are.
    """

    def __init__(self, rows: int) -> None:
        self.layout: ArrayLayout = event_array(rows)
        self.count = 0
        self._tail = np.zeros((0, 4), np.int32)  # rows of the chunk that is not yet full

    @property
    def chunks(self) -> int:
        """How many chunks the events fill or have begun."""
        return -(-self.count // self._size)

    @property
    def _size(self) -> int:
        return self.layout.chunk[0]

    def changed_chunks(self, table: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """Number and rows of each chunk that holds some of these events once they are added.

        Args:
            table: As `event_table` gives it.
        """
        first = self.count // self._size
        rows = np.concatenate([self._tail, table])
        for start in range(0, len(rows) if len(table) else 0, self._size):
            yield first + start // self._size, rows[start : start + self._size]

    def add(self, table: np.ndarray) -> None:
        """Count events as written."""
        rows = np.concatenate([self._tail, table])
        self.count += len(table)
        self._tail = rows[len(rows) // self._size * self._size :]

    def stands_in(self, folder: Path, table: np.ndarray, stored: int) -> bool:
        """Whether a recording with so many events has these next, and no others."""
        first = self.count // self._size
        rows = np.concatenate([self._tail, table])
        same = self.count + len(table) == stored
        for start in range(0, len(rows) if same else 0, self._size):
            part = rows[start : start + self._size]
            found = read_chunk(folder, self.layout, first + start // self._size)
            same = same and np.array_equal(found[: len(part)], part)
        return same

    def take_up(self, folder: Path, stored: int, next_frame: int) -> None:
        """Go on with a recording of so many events at a frame: those before it are known.

        Args:
            folder: Of the recording.
            stored: How many events it has.
            next_frame: The first frame that is simulated again.
        """
        tail = np.zeros((0, 4), np.int32)
        for index in range(-(-stored // self._size) - 1, -1, -1):
            rows = read_chunk(folder, self.layout, index)[: stored - index * self._size]
            before = int(np.searchsorted(rows[:, 0], next_frame))
            if before or index == 0:
                tail, self.count = rows[:before], index * self._size + before
                break
        # A full chunk of events is complete: what comes next opens another.
        self._tail = tail[len(tail) // self._size * self._size :].astype(np.int32)


def event_table(events: np.ndarray | None, first: int, end: int) -> np.ndarray:
    """Events as rows of frame, substep, agent, kind, sorted, int32, shape [events, 4].

    Args:
        events: `EVENT_DTYPE`, in any order, or None for none.
        first, end: They must be of the frames from `first` to before `end`.

    Raises:
        ValueError: They are not.
    """
    if events is None or not len(events):
        return np.zeros((0, 4), np.int32)
    if events.dtype != EVENT_DTYPE:
        raise ValueError(f"events: {events.dtype} is not {EVENT_DTYPE}")
    if events["frame"].min() < first or events["frame"].max() >= end:
        raise ValueError(f"events: of frames outside of this chunk, {first} to {end - 1}")
    return sorted_events(np.stack([events[name].astype(np.int32) for name in EVENT_DTYPE.names or ()], axis=1))


def sorted_events(table: np.ndarray) -> np.ndarray:
    """Rows of events by frame, substep, agent, kind."""
    key = np.zeros(len(table), np.int64)  # one number to sort by is three times as fast as four
    for column in table.T if len(table) else ():
        key = key * (int(np.ptp(column)) + 1) + (column - column.min())
    return table[np.argsort(key, kind="stable")]
