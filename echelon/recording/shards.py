"""Which rank writes which agents of a recording, and how it comes by the rows that other ranks have.

A recording is stored in shards of agents, the same for any number of ranks (`layout`). A shard is written by the rank
that has its first agent. Ranks have agents in index order, so a rank gives away its first agents at most, to one other,
and is given those that follow its last: once a chunk, one message from rank to rank.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from echelon.ranks import Ranks

Pieces = list[tuple[int, np.ndarray]]
"""Rows of an array that follow one another: number of the first agent, and the rows, shape [frames, agents, ...]."""


class Shards:
    """The shards of a crowd, seen from one rank.

    Attributes:
        first, count: The agents that this rank simulates.
        owned: The shards that it writes.
    """

    def __init__(self, ranks: Ranks, agent_count: int, size: int) -> None:
        """
        Args:
            ranks: Who simulates.
            agent_count: Agents in all.
            size: Agents in every shard but the last.
        """
        self._ranks, self._agent_count, self._size = ranks, agent_count, size
        self.first, self.count = ranks.part(agent_count)
        end = self.first + self.count
        self.owned = range(-(-self.first // size), -(-end // size))

    def bounds(self, shard: int) -> tuple[int, int]:
        """(first agent, one past the last) of a shard."""
        return shard * self._size, min((shard + 1) * self._size, self._agent_count)

    def collect(self, arrays: Mapping[str, np.ndarray]) -> dict[str, Pieces]:
        """Pass rows on to those who write them; all ranks call it at once.

        Args:
            arrays: By name, this rank's rows, shape [frames, agents, ...].

        Returns:
            Those of the shards that it writes; they may be views of what was given.
        """
        start = self.owned.start * self._size if self.owned else self.first + self.count
        given_away = max(start - self.first, 0)
        message = None
        if given_away:
            heads = (np.ascontiguousarray(array[:, :given_away]) for array in arrays.values())
            message = np.concatenate([head.reshape(-1).view(np.uint8) for head in heads])
        senders = self._senders()
        widths = {name: array[:, :1].nbytes for name, array in arrays.items()}
        sizes = {sender: rows * sum(widths.values()) for sender, rows in senders.items()}
        received = self._ranks.pass_on(message, self._owner(self.first // self._size), sizes)
        pieces: dict[str, Pieces] = {name: [(start, array[:, given_away:])] for name, array in arrays.items()}
        first = self.first + self.count
        for sender, rows in senders.items():
            at = 0
            for name, array in arrays.items():
                data = received[sender][at : at + rows * widths[name]]
                at += len(data)
                pieces[name].append((first, data.view(array.dtype).reshape(len(array), rows, *array.shape[2:])))
            first += rows
        return pieces

    def rows(self, pieces: Pieces, shard: int) -> np.ndarray:
        """The rows of a shard that this rank writes, shape [frames, agents, ...]."""
        begin, end = self.bounds(shard)
        found = [
            piece[:, max(begin - first, 0) : end - first]
            for first, piece in pieces
            if first < end and first + piece.shape[1] > begin
        ]
        return found[0] if len(found) == 1 else np.concatenate(found, axis=1)

    def _owner(self, shard: int) -> int:
        """The rank that has the first agent of a shard."""
        for rank in range(self._ranks.rank, -1, -1):
            if self._ranks.part(self._agent_count, rank)[0] <= shard * self._size:
                return rank
        return 0

    def _senders(self) -> dict[int, int]:
        """How many rows other ranks have of the shards that this one writes, by rank."""
        if not self.owned:
            return {}
        end = self.bounds(self.owned[-1])[1]
        found: dict[int, int] = {}
        for rank in range(self._ranks.rank + 1, self._ranks.size):
            first, count = self._ranks.part(self._agent_count, rank)
            if first >= end:
                break
            found[rank] = min(end, first + count) - first
        return found
