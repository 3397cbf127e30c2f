"""What a picture is made of, whether it was recorded or read back from a stage: bodies, actors, a world, poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from echelon.errors import InputError
from echelon.export.shapes import Mesh, bicycle_visuals, fence_mesh, visual_mesh
from echelon.recording import Recording
from echelon.warp_kernels.model import Vec3, Visual

PEN_NAME = "corral"  # the fence that has a floor of its own


@dataclass(frozen=True)
class DrawnPart:
    """Shapes of one colour on a link.

    Attributes:
        mesh: In the link's frame, of convex pieces [m].
        color: Linear RGB from 0 to 1, or None for the colour of the individual.
    """

    mesh: Mesh
    color: Vec3 | None


@dataclass(frozen=True)
class DrawnCast:
    """Agents that look alike but for their colour.

    Attributes:
        first_agent: Index of the first.
        links: Parts of each link.
        colors: Linear RGB from 0 to 1, shape [agents, 3].
    """

    first_agent: int
    links: tuple[tuple[DrawnPart, ...], ...]
    colors: np.ndarray


@dataclass(frozen=True)
class DrawnFence:
    """A fence in the world [m]."""

    name: str
    mesh: Mesh


@dataclass(frozen=True)
class DrawnPen:
    """The square that the corral encloses: its middle (x, y) and the length of a side [m]."""

    center: tuple[float, float]
    size: float


@dataclass(frozen=True)
class DrawnWorld:
    """What stands still.

    Attributes:
        oval: Half length and half width of the infield, half circles included [m]; None for open ground.
        fences: All of them.
        pen: The corral, if there is one.
    """

    oval: tuple[float, float] | None
    fences: tuple[DrawnFence, ...]
    pen: DrawnPen | None


class PictureSource(Protocol):
    """What the pictures read. Ranges of frames go from first to last, the last one left out.

    Attributes:
        frame_rate: Frames a second.
        frame_count: How many frames there are.
        casts: The agents.
        actors: Parts of each actor, in the actor's frame.
        world: What stands still.
    """

    frame_rate: int
    frame_count: int
    casts: tuple[DrawnCast, ...]
    actors: tuple[tuple[DrawnPart, ...], ...]
    world: DrawnWorld

    def link_poses(self, first: int, last: int) -> np.ndarray:
        """Poses of links in the world, shape [frames, agents, links, 7]."""
        ...

    def actor_poses(self, first: int, last: int) -> np.ndarray:
        """Poses of actors in the world, shape [frames, actors, 7]."""
        ...

    def body_places(self, first: int, last: int) -> np.ndarray:
        """Where the agents are on the ground [m], shape [frames, agents, 2]."""
        ...


class RecordedSource:
    """A recording as the pictures see it; see `PictureSource`."""

    def __init__(self, recording: Recording) -> None:
        """Raises InputError where there are no frames yet."""
        if recording.frame_count < 1:
            raise InputError(f"{recording.path}: has no frames yet, so there is nothing to draw")
        self._recording = recording
        self.frame_rate = int(recording.frame_rate)
        self.frame_count = int(recording.frame_count)
        self.casts = tuple(
            DrawnCast(
                first_agent=cast.first_agent,
                links=tuple(_parts(link.visuals) for link in cast.body.links),
                colors=np.asarray(cast.colors, dtype=np.float32).reshape(-1, 3),
            )
            for cast in recording.casts
        )
        self.actors = tuple(_parts(bicycle_visuals()) for _ in recording.actors)
        self.world = _drawn_world(recording.world)

    def link_poses(self, first: int, last: int) -> np.ndarray:
        return np.asarray(self._recording.link_poses[first:last], dtype=np.float64)

    def actor_poses(self, first: int, last: int) -> np.ndarray:
        return np.asarray(self._recording.actor_poses[first:last], dtype=np.float64)

    def body_places(self, first: int, last: int) -> np.ndarray:
        return np.asarray(self._recording.link_poses[first:last, :, 0, :2], dtype=np.float64)


def _drawn_world(world: Mapping[str, Any]) -> DrawnWorld:
    ground, corral = world["ground"], world.get("corral")
    return DrawnWorld(
        oval=(float(ground["half_length"]), float(ground["half_width"])) if ground["shape"] == "oval" else None,
        fences=tuple(
            DrawnFence(str(wall["name"]), fence_mesh(wall["points"], bool(wall["closed"]), float(wall["height"])))
            for wall in world.get("walls", ())
        ),
        pen=None
        if corral is None
        else DrawnPen((float(corral["center"][0]), float(corral["center"][1])), float(corral["size"])),
    )


def _parts(visuals: Sequence[Visual]) -> tuple[DrawnPart, ...]:
    return tuple(DrawnPart(visual_mesh(visual), visual.color) for visual in visuals)
