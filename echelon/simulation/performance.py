"""Many gymnasts perform at once, each a script of its own: for those who measure, tune and compare maneuvers.

Nothing is recorded: what is asked for is kept frame by frame. A crowd that is to be seen goes through `simulate`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.scenario import WorldSettings
from echelon.terrain.flat import FlatTerrain
from echelon.warp_kernels.character import Population
from echelon.warp_kernels.frame import ChunkArrays, Engine, Terrain

Progress = Callable[[int, int], None]


class Performance:
    """Gymnasts of one body from their start to the last frame that anybody asked for.

    Args:
        character: Who.
        tables: Scripts, each as `Script.table` gives it, shape [rows, row size]; shorter ones are padded.
        which: Which of them each gymnast follows, shape [agents]; None for one gymnast a script.
        people: How they start; None for standing.
        terrain: Where; None for level ground at z = 0.
        places: World places of their floating origins [m], shape [agents, 3]; None for the origin.
        frame_rate, substeps, tick: Frames a second, substeps a frame, and substeps a control tick; as many substeps as
            the character needs if 0.
        threads: At most, 0 for one a core.

    Attributes:
        engine: Them, as they are now.
        frames: How many have passed.
    """

    def __init__(
        self,
        character: Gymnast,
        tables: Sequence[np.ndarray],
        which: np.ndarray | None = None,
        *,
        people: Population | None = None,
        terrain: Terrain | None = None,
        places: np.ndarray | None = None,
        frame_rate: int = 30,
        substeps: int = 0,
        tick: int = 0,
        threads: int = 0,
    ) -> None:
        following = np.arange(len(tables)) if which is None else np.asarray(which)
        self.character = character
        self.frame_rate = frame_rate
        self.frames = 0
        self._shape: tuple[int, ...] = ()
        self.engine = Engine(
            character,
            len(following),
            FlatTerrain.of(WorldSettings(ground="plane"), "cpu") if terrain is None else terrain,
            frame_rate=frame_rate,
            substeps=substeps or -(-character.steps_per_second // frame_rate),
            tick=tick or character.steps_per_tick,
            threads=threads,
        )
        people = character.population(len(following), 0, 0.0, True) if people is None else people
        self.engine.set_q(people.q)
        self.engine.set_u(people.u)
        for name, values in people.parameters.items():
            self.engine.set_parameter(name, values)
        for name, values in people.memory.items():
            self.engine.set_memory(name, values)
        if places is not None:
            self.engine.set_origins(places)
        self._start = self.engine.full_state()
        self._chunk = ChunkArrays.allocate(1, len(following), character)
        self._follow(padded(tables), following)

    def restart(self, tables: Sequence[np.ndarray], which: np.ndarray | None = None) -> None:
        """Everybody back to their start, to follow other scripts: a new performance at a fraction of the cost.

        Args:
            tables, which: As many gymnasts as before, otherwise as for a new one.
        """
        following = np.arange(len(tables)) if which is None else np.asarray(which)
        if len(following) != self.engine.agent_count:
            raise ValueError(f"{len(following)} scripts to follow for {self.engine.agent_count} gymnasts")
        self.frames = 0
        self.engine.load_full_state(self._start)
        self._follow(padded(tables), following)

    def _follow(self, scripts: np.ndarray, following: np.ndarray) -> None:
        self.engine.set_scripts(scripts, following)
        if scripts.shape != self._shape:
            self.engine.bind(self._chunk)
            self._shape = scripts.shape

    def run(
        self, seconds: float, watch: Sequence[str] = (), progress: Progress | None = None
    ) -> Mapping[str, np.ndarray]:
        """Carry on, and watch.

        Args:
            seconds: For how long [s], a whole number of frames.
            watch: Names of memory variables, or "q", "u", "row" (counted from the script's first).
            progress: Called with frames done and to do.

        Returns:
            By name what was watched after each frame, shape [frames, agents] ("q" and "u" have a third axis).
        """
        frames = round(seconds * self.frame_rate)
        kept: dict[str, list[np.ndarray]] = {name: [] for name in watch}
        for frame in range(frames):
            self.engine.advance(0)
            self.frames += 1
            for name in watch:
                kept[name].append(self.now(name))
            if progress is not None:
                progress(frame + 1, frames)
        return {name: np.array(values) for name, values in kept.items()}

    def now(self, name: str) -> np.ndarray:
        """A memory variable as it is, shape [agents]; see `run` for other names."""
        if name in ("q", "u"):
            # A free root's place is relative to the floating origin.
            values = self.engine.q if name == "q" else self.engine.u
            if name == "q":
                values = values.astype(np.float64)
                values[:, :3] += self.engine.origins.numpy()[: self.engine.agent_count]
            return values
        if name == "row":
            return self.engine.memory("row") - self.engine.memory("first_row")
        return self.engine.memory(name)

    def close(self) -> None:
        """Let the threads go."""
        self.engine.close()


def padded(tables: Sequence[np.ndarray]) -> np.ndarray:
    """Tables of scripts as one array, shape [scripts, rows of the longest, row size]; nothing leads to added rows."""
    longest = max(len(table) for table in tables)
    return np.array([np.pad(table, ((0, longest - len(table)), (0, 0)), mode="edge") for table in tables])
