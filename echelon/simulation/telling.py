"""What ranks tell each other of their agents: rows of Warp arrays, wherever these live."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import warp as wp

from echelon.ranks import Exchange, Ranks


class Telling:
    """Rows of this rank's agents to all others, and theirs here; does nothing where this process is alone.

    Attributes:
        bytes_per_agent: What is told of one agent, each frame.
    """

    def __init__(self, ranks: Ranks, agent_count: int, arrays: Mapping[str, wp.array]) -> None:
        """
        Args:
            ranks: Who tell each other.
            agent_count: How many agents there are.
            arrays: By name; the first rows are those of the agents. Those of this rank are told, the others taken.
        """
        self._arrays = [arrays[name] for name in sorted(arrays)]
        # On a CPU the very memory of the arrays; of a GPU's, a copy.
        self._copies = [None if wp.get_device(array.device).is_cpu else array.numpy() for array in self._arrays]
        rows = [array.numpy() if copy is None else copy for array, copy in zip(self._arrays, self._copies, strict=True)]
        self._exchange = Exchange(ranks, agent_count, rows)
        self._alone = ranks.size == 1
        self.bytes_per_agent = self._exchange.bytes_per_agent

    def __call__(self) -> None:
        """Once a frame."""
        if self._alone:
            return
        for array, copy in zip(self._arrays, self._copies, strict=True):
            if copy is not None:
                np.copyto(copy, array.numpy())
        self._exchange()
        for array, copy in zip(self._arrays, self._copies, strict=True):
            if copy is not None:
                array.assign(copy)
