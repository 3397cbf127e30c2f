"""Where a scenario plays and what everybody in it wants: what the frame loop needs of it.

There are three kinds: a `field` with a herd on it, a `road` with riders, and a `gym` with gymnasts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import warp as wp

from echelon.recording import Actor
from echelon.warp_kernels.character import Character, Population
from echelon.warp_kernels.frame import Engine, Terrain
from echelon.warp_kernels.replay import Share


@dataclass
class SceneFrames:
    """What one chunk of frames leaves of a scene.

    Attributes:
        in_corral: How many are in, shape [frames], int32.
        actor_poses: World poses, shape [frames, actors, 7], float64.
        measures: What the scene measures of each agent, shape [frames, agents, measures], float32.
        controls: What the person did, shape [frames, controls], float32.
        events: (frame, substep, agent, index into `EVENT_NAMES`) of what happened between agents.
    """

    in_corral: np.ndarray
    actor_poses: np.ndarray
    measures: np.ndarray
    controls: np.ndarray
    events: list[tuple[int, int, int, int]]

    @classmethod
    def allocate(cls, frames: int, scene: Scene, agents: int) -> SceneFrames:
        """Room for a chunk."""
        return cls(
            np.zeros(frames, np.int32),
            np.zeros((frames, len(scene.actors), 7)),
            np.zeros((frames, agents, len(scene.measure_names)), np.float32),
            np.zeros((frames, len(scene.control_names)), np.float32),
            [],
        )


class Scene(Protocol):
    """A place and the wants of those in it.

    Attributes:
        terrain: What contacts meet.
        world: What there is to see, plain data, for the recording.
        actors: Who else is in the picture.
        measure_names: What it measures of each agent in each frame.
        control_names: What a person on the user's bicycle does in each frame; none where nobody is to ride.
        beyond: How many rows its rules have beyond those of the crowd: a user's.
        by_agent: Names of those arrays of `state` that have a row for each agent of the crowd.
    """

    terrain: Terrain
    world: Mapping[str, Any]
    actors: tuple[Actor, ...]
    measure_names: tuple[str, ...]
    control_names: tuple[str, ...]
    beyond: int
    by_agent: frozenset[str]

    def divide(self, share: Share) -> None:
        """Say whose wants are worked out here, and on which threads, before the first step."""
        ...

    def load(self) -> None:
        """Load the kernels, compiling those that nobody has compiled before."""
        ...

    def people(self, character: Character) -> tuple[Population, np.ndarray]:
        """Everybody as they start, and the world places of their floating origins [m], shape [agents, 3]."""
        ...

    def prepare(self, engines: Sequence[Engine]) -> None:
        """Give the engines, once everybody is where they start, what does not change while they run."""
        ...

    def public(self) -> dict[str, wp.array]:
        """What the rules go by of others, of the frame before, by name; the first rows are those of the crowd.

        `step` writes the rows of the engine's own agents. Where others are simulated by other processes, theirs are
        put here before the next `step`.
        """
        ...

    def step(self, frame: int, engine: Engine, between: Callable[[], None] | None = None) -> None:
        """See everybody in a frame, and tell the engine what they want until the next.

        Args:
            frame: Number of the frame.
            engine: Theirs.
            between: Called when everything is seen and nothing wanted yet: for a stopwatch.
        """
        ...

    def ride(self, controls: np.ndarray) -> None:
        """Say what the person does from this frame to the next, by `control_names`, before `step`."""
        ...

    def keep(self, frame: int, slot: int, frames: SceneFrames) -> None:
        """After `step`: leave what is to be recorded of this frame in a slot."""
        ...

    def keep_actors(self, slot: int, frames: SceneFrames) -> None:
        """Before `step`, which takes the actors to the next frame: leave where they are in this one."""
        ...

    def begin(self) -> None:
        """A preroll is over, or a state has been loaded: only what happens from now on is an event."""
        ...

    @property
    def finished(self) -> bool:
        """Whether what the scenario runs until has come about."""
        ...

    def summary(self, last_frame: int, means: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """What the run came to, as far as the scene knows; `tallies` have been put together before.

        Args:
            last_frame: Number of the last frame.
            means: Of each measure over the run, by name, shape [agents].
        """
        ...

    def tallies(self) -> dict[str, wp.array]:
        """What `summary` needs of each agent; like `public`, but at the end of a run."""
        ...

    def state(self) -> dict[str, np.ndarray]:
        """All that the next frame depends on, by name; copies.

        Where other ranks have some of the agents, their rows are not what they are there.
        """
        ...

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from what `state` gave."""
        ...
