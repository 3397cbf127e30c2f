"""Launches captured once and replayed each frame, in slices over a team of threads.

A frame's launches come in *phases*. The slices of one phase read nothing that another slice of it writes, so they may
run side by side, on the threads of a `Team`; the next phase begins when all are done. Phases of one slice that
follow one another are one graph: a small crowd, which is not worth a second thread, is one replay a frame.

Threads are not equally fast: a core has other things to do, the thread that writes a recording among them. So heavy
phases come in more slices than there are threads, which take them as they get done: large ones first, then ever
smaller ones, so that all end at about the same time. Who works on what cannot change a bit.

On a CPU a launch costs some 10 microseconds of Python, and replaying a captured graph of a dozen two or three.
"""

from __future__ import annotations

import itertools
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from types import ModuleType
from typing import Any

import warp as wp

GRAPH_LIMIT = 8
"""Sets of arrays that `Replay` keeps graphs for."""

LIGHT_SLICE = 4_000
"""Agents that are worth a thread of their own where there is little to do for each, such as entering a hash grid."""

LAST_SLICES = 32
"""The smallest slices of a phase that is dealt out are such a part of it, over the number of threads: replaying a slice
takes some five microseconds of Python, so they are not to be too small."""

Phase = Sequence[Callable[[], None]]
"""What launches each slice of a phase."""


def slices(count: int, parts: int, *, first: int = 0, multiple: int = 1) -> list[tuple[int, int]]:
    """(first, count) of each part of a range, as even as whole multiples allow; fewer parts where there are fewer."""
    blocks = -(-count // multiple)
    parts = max(1, min(parts, blocks))
    bounds = [min(blocks * i // parts * multiple, count) for i in range(parts + 1)]
    return [(first + a, b - a) for a, b in itertools.pairwise(bounds)]


def dealt(count: int, threads: int, *, first: int = 0, least: int = 1) -> list[tuple[int, int]]:
    """(first, count) of the slices that so many threads take in turn: each half a thread's share of what is left.

    Args:
        count: Of the range.
        threads: Who take them; one takes all at once.
        first: Number of the first.
        least: A slice has so many at least, but for the last.
    """
    least = max(least, -(-count // (LAST_SLICES * threads)))
    found, begun = [], 0
    while begun < count:
        left = count - begun
        size = left if threads == 1 else min(left, max(left // (2 * threads), least))
        found.append((first + begun, size))
        begun += size
    return found or [(first, 0)]


class Team:
    """Threads that work side by side; whoever calls `run` is one of them.

    Waking a thread and waiting for it takes a lock each, which is several times faster than an executor's queue. Who
    has not woken up by the time when all is done sleeps on.

    Attributes:
        size: How many they are, the caller included.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._workers = [_Worker() for _ in range(size - 1)]

    def run(self, works: Sequence[Callable[[], None]]) -> None:
        """Do all pieces of work; each thread takes the next when it is done with one. Raises what one of them raised.

        Args:
            works: In the order in which they are begun.
        """
        workers = self._workers[: len(works) - 1]
        left = deque(works)
        for worker in workers:
            worker.begin(left)
        try:
            do_all(left)
        finally:
            for worker in workers:
                worker.wait()
        for worker in workers:
            worker.check()

    def close(self) -> None:
        """Let the threads go; can be called twice."""
        for worker in self._workers:
            worker.end()
        self._workers = []
        self.size = 1


@dataclass(frozen=True)
class Share:
    """Which agents of a crowd a process works on, and on which threads.

    What concerns each agent alone is done for its own agents only; what all have to know, such as the hash grid, for
    everybody.

    Attributes:
        crowd: How many agents there are.
        first: Number of the first of its own.
        count: How many are its own.
        team: The threads.
        beyond: How many rows there are beyond the crowd's, of users; every process works on these.
    """

    crowd: int
    first: int
    count: int
    team: Team
    beyond: int = 0

    @classmethod
    def whole(cls, crowd: int, beyond: int = 0) -> Share:
        """Everybody, on one thread."""
        return cls(crowd, 0, crowd, Team(1), beyond)

    def own(self, launch: Callable[[int, int], None]) -> list[Callable[[], None]]:
        """What launches (first, count) of each slice of its own agents, and of those beyond the crowd, as `dealt`."""
        last = self.first + self.count == self.crowd
        parts = dealt(self.count + self.beyond * last, self.team.size, first=self.first)
        works: list[Callable[[], None]] = [partial(launch, *part) for part in parts]
        if self.beyond and not last:
            works[0] = partial(launch_all, [works[0], partial(launch, self.crowd, self.beyond)])
        return works

    def everybody(
        self, launch: Callable[[int, int], None], multiple: int = 1, least: int = LIGHT_SLICE
    ) -> list[Callable[[], None]]:
        """What launches (first, count) of each slice of everybody.

        Args:
            launch: Launches one.
            multiple: Each slice but the last is a multiple of this number.
            least: A slice has so many agents at least, if there are several: waking a thread takes time, too.
        """
        count = self.crowd + self.beyond
        parts = slices(count, min(self.team.size, count // least), multiple=multiple)
        return [partial(launch, *part) for part in parts]

    def owns(self, agent: int) -> bool:
        """Whether an agent is one of its own."""
        return self.first <= agent < self.first + self.count


def side_by_side(*phases: Phase) -> Phase:
    """One phase of several, the first slices of all together, the second slices of all, and so on."""
    longest = max(len(phase) for phase in phases)
    return [partial(launch_all, [p[i] for p in phases if i < len(p)]) for i in range(longest)]


def launch_all(launches: Sequence[Callable[[], None]]) -> None:
    """One after the other."""
    for launch in launches:
        launch()


def do_all(left: deque[Callable[[], None]]) -> None:
    """Take what is left, one after the other, until others and this thread have begun all."""
    while True:
        try:
            work = left.popleft()
        except IndexError:
            return
        work()


class _Worker:
    """One thread of a team, which sleeps until there is something to do."""

    def __init__(self) -> None:
        self._left: deque[Callable[[], None]] | None = None
        self._error: BaseException | None = None
        self._go, self._done = threading.Lock(), threading.Lock()
        self._go.acquire()
        self._done.acquire()
        self._thread = threading.Thread(target=self._serve, name="echelon", daemon=True)
        self._thread.start()

    def begin(self, left: deque[Callable[[], None]]) -> None:
        """Wake up and help with what is left."""
        self._left = left
        self._go.release()

    def wait(self) -> None:
        """Until it is done, unless it has not even woken up: then it is not called any more."""
        if not self._go.acquire(blocking=False):
            self._done.acquire()

    def check(self) -> None:
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    def end(self) -> None:
        self._left = None
        self._go.release()
        self._thread.join()

    def _serve(self) -> None:
        while True:
            self._go.acquire()
            if self._left is None:
                return
            try:
                do_all(self._left)
            except BaseException as error:  # raised anew by the thread that asked for the work
                self._error = error
            self._done.release()


class Graphs:
    """The phases of a frame, captured."""

    def __init__(self, phases: Sequence[Phase], device: wp.DeviceLike = None) -> None:
        """Capture what the phases launch; the modules of their kernels must be loaded.

        Args:
            phases: In order.
            device: Where they launch.
        """
        steps: list[list[list[Callable[[], None]]]] = []  # graphs of each step, launches of each graph
        for phase in phases:
            if len(phase) == 1 and steps and len(steps[-1]) == 1:
                steps[-1][0].append(phase[0])
            else:
                steps.append([[launch] for launch in phase])
        self._steps = [[_captured(launches, device) for launches in graphs] for graphs in steps]

    def replay(self, team: Team) -> None:
        """Launch everything once more, phases of several slices on all threads of a team."""
        for graphs in self._steps:
            if len(graphs) == 1:
                graphs[0]()
            else:
                team.run(graphs)


def _captured(launches: Sequence[Callable[[], None]], device: wp.DeviceLike) -> Callable[[], None]:
    with wp.ScopedCapture(device=device) as capture:
        for launch in launches:
            launch()
    graph = capture.graph
    assert graph is not None, "a capture that ended without an error has a graph"
    return lambda: wp.capture_launch(graph)


class Replay:
    """Captures what a frame launches on a set of arrays when it meets them first, and replays it from then on."""

    def __init__(self, modules: Sequence[ModuleType], device: wp.DeviceLike = None) -> None:
        """Begin with nothing captured.

        Args:
            modules: Those of all kernels that will be launched.
            device: Where.
        """
        self._modules, self._device = modules, device
        self._kept: dict[tuple[Any, ...], tuple[list[Graphs], tuple[wp.array, ...]]] = {}

    def __call__(
        self,
        arrays: tuple[wp.array, ...],
        stages: Callable[[], Sequence[Sequence[Phase]]],
        team: Team,
        between: Callable[[], None] | None = None,
    ) -> None:
        """Launch one frame.

        Args:
            arrays: What its launches take that may be another the next time.
            stages: Gives the phases of each stage; called only where these arrays are new.
            team: Who carries them out.
            between: Called after each stage but the last.
        """
        key = tuple(array.ptr for array in arrays)
        if key not in self._kept:
            if len(self._kept) >= GRAPH_LIMIT:
                self._kept.clear()
            self.load()
            # The arrays are kept: their addresses stay theirs.
            self._kept[key] = ([Graphs(phases, self._device) for phases in stages()], arrays)
        first, *rest = self._kept[key][0]
        first.replay(team)
        for graphs in rest:
            if between is not None:
                between()
            graphs.replay(team)

    def load(self) -> None:
        """Load the modules, compiling those that nobody has compiled before."""
        for module in self._modules:
            wp.load_module(module, device=self._device)
