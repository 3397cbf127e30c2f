"""Processes that simulate one crowd together, through MPI.

Agents are dealt to *ranks* in index order: rank r of n has those from ``count * r // n`` to before
``count * (r + 1) // n``. Once a frame every rank tells all others what they see of its agents: one buffer, one
``Allgatherv``. Everything else that passes between them passes once a chunk of the recording, or once a run.

mpi4py, an optional dependency, is imported only where an MPI launcher has started this process.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from echelon.errors import InputError
from echelon.launcher import launched_ranks

BARRIER_LOOK = 1e-3
"""How often who waits for others looks whether they are there [s]."""


class Ranks:
    """The ranks that simulate together, seen from one of them.

    Attributes:
        rank: Number of this one.
        size: How many they are.
    """

    def __init__(self, communicator: Any = None) -> None:
        """
        Args:
            communicator: An mpi4py communicator; None for a process that is alone.
        """
        self._communicator = communicator
        self.rank: int = 0 if communicator is None else communicator.Get_rank()
        self.size: int = 1 if communicator is None else communicator.Get_size()

    @classmethod
    def launched(cls) -> Ranks:
        """Those that an MPI launcher has started this process with; alone where none has.

        Raises:
            InputError: There are several, but mpi4py is not installed.
        """
        count = launched_ranks()
        if count == 1:
            return cls()
        try:
            from mpi4py import MPI
        except ImportError as error:
            raise InputError(
                f"{count} ranks were launched, but mpi4py cannot be imported ({error}); install echelon[mpi]"
            ) from None
        return cls(MPI.COMM_WORLD)

    @property
    def is_first(self) -> bool:
        """Whether this one speaks for all."""
        return self.rank == 0

    def part(self, count: int, rank: int | None = None) -> tuple[int, int]:
        """(first, number) of the agents of a rank, of this one by default, among ``count``."""
        rank = self.rank if rank is None else rank
        first = count * rank // self.size
        return first, count * (rank + 1) // self.size - first

    def check(self, count: int) -> None:
        """
        Raises:
            InputError: There are more ranks than agents.
        """
        if self.size > count:
            raise InputError(f"crowd.count = {count}: must be at least the number of ranks, {self.size}")

    # ---- together --------------------------------------------------------------------------------------------------
    def barrier(self) -> None:
        """Wait for all, without keeping a core busy as MPI's own waiting does: what others do may take long."""
        if self._communicator is not None:
            request = self._communicator.Ibarrier()
            while not request.Test():
                time.sleep(BARRIER_LOOK)

    @contextmanager
    def first_before_others(self) -> Iterator[None]:
        """What is inside is done by the first rank, then by all others: what it leaves on disk they find."""
        if not self.is_first:
            self.barrier()
        yield
        if self.is_first:
            self.barrier()

    def sum(self, values: np.ndarray) -> np.ndarray:
        """The sums of whole numbers over ranks."""
        if self._communicator is None:
            return values
        total = np.zeros_like(values)
        self._communicator.Allreduce(np.ascontiguousarray(values), total)
        return total

    def broadcast(self, value: Any) -> Any:
        """The first rank's plain data."""
        return value if self._communicator is None else self._communicator.bcast(value)

    def gather(self, rows: np.ndarray) -> np.ndarray:
        """Rows of all ranks, in their order, on the first; elsewhere none."""
        if self._communicator is None:
            return rows
        parts = self._communicator.gather(np.ascontiguousarray(rows))
        return np.concatenate(parts) if parts is not None else rows[:0]

    def in_order(self, rows: np.ndarray) -> Iterator[np.ndarray]:
        """On the first rank, the rows of one rank after another, so that only one's are in memory; elsewhere none."""
        if self._communicator is None:
            yield rows
            return
        if self.is_first:
            yield rows
            for other in range(1, self.size):
                yield self._communicator.recv(source=other)
        else:
            self._communicator.send(np.ascontiguousarray(rows), dest=0)

    def abort(self, code: int) -> None:
        """End all ranks, now."""
        if self._communicator is not None:
            self._communicator.Abort(code)

    # ---- one to another --------------------------------------------------------------------------------------------
    def pass_on(self, message: np.ndarray | None, receiver: int, sizes: dict[int, int]) -> dict[int, np.ndarray]:
        """Send bytes to one rank and receive some from others; all who take part call it at once.

        Args:
            message: What is sent, uint8; None to send nothing.
            receiver: To whom.
            sizes: Bytes to receive, by sender.

        Returns:
            What was received, uint8, by sender.
        """
        if self._communicator is None:
            return {}
        received = {sender: np.empty(size, np.uint8) for sender, size in sizes.items()}
        waiting = [self._communicator.Irecv(buffer, source=sender) for sender, buffer in received.items()]
        if message is not None:
            self._communicator.Send(message, dest=receiver)
        for request in waiting:
            request.Wait()
        return received


class Exchange:
    """What every rank tells all others each frame: rows of arrays.

    Attributes:
        bytes_per_agent: What is told of one agent.
    """

    def __init__(self, ranks: Ranks, count: int, arrays: Sequence[np.ndarray]) -> None:
        """
        Args:
            ranks: Who takes part; all with arrays of the same types and shapes.
            count: How many agents there are.
            arrays: With a row for each agent, others beyond them left alone; contiguous.
        """
        self._ranks = ranks
        self._rows = [array[:count].reshape(count, -1).view(np.uint8) for array in arrays]
        widths = [rows.shape[1] for rows in self._rows]
        self.bytes_per_agent = sum(widths)
        parts = [ranks.part(count, rank) for rank in range(ranks.size)]
        sizes = [self.bytes_per_agent * number for _, number in parts]
        starts = np.concatenate([[0], np.cumsum(sizes)])
        self._counts, self._starts = sizes, starts[:-1].tolist()
        self._received = np.zeros(starts[-1], np.uint8)
        # For each rank, and for each array, the bytes in the buffer and those in the array.
        self._places: list[list[tuple[np.ndarray, np.ndarray]]] = []
        for (first, number), start in zip(parts, self._starts, strict=True):
            at = start
            pairs: list[tuple[np.ndarray, np.ndarray]] = []
            for rows, width in zip(self._rows, widths, strict=True):
                buffer = self._received[at : at + number * width].reshape(number, width)
                pairs.append((buffer, rows[first : first + number]))
                at += number * width
            self._places.append(pairs)
        self._sent = np.zeros(sizes[ranks.rank], np.uint8)
        at = 0
        self._own: list[tuple[np.ndarray, np.ndarray]] = []
        for _, rows in self._places[ranks.rank]:
            self._own.append((self._sent[at : at + rows.size].reshape(rows.shape), rows))
            at += rows.size

    def __call__(self) -> None:
        """Tell all others the rows of this rank's agents, take theirs."""
        communicator = self._ranks._communicator
        if communicator is None:
            return
        for buffer, rows in self._own:
            buffer[:] = rows
        communicator.Allgatherv(self._sent, [self._received, self._counts, self._starts, _byte()])
        for rank, pairs in enumerate(self._places):
            if rank != self._ranks.rank:
                for buffer, rows in pairs:
                    rows[:] = buffer


def _byte() -> Any:
    from mpi4py import MPI

    return MPI.BYTE
