"""What a picture is made of, whether it was recorded or read back from a stage: bodies, actors, a world, poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from echelon.errors import InputError
from echelon.export.actor_looks import actor_visuals
from echelon.export.drawn_parts import DrawnPart, parts_of
from echelon.export.drawn_road import DrawnRoad, drawn_road
from echelon.export.removed import places_to_frame, removed_agents
from echelon.export.road_scene import is_road, road_scene
from echelon.export.shapes import Mesh, columns_mesh, fence_mesh, platform_mesh
from echelon.recording import Cast, Recording

COLUMNS_NAME = "columns"  # what stands among the fences and is of stone
PEN_NAME = "corral"  # the fence that has a floor of its own


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
class DrawnPlatform:
    """A platform above water.

    Attributes:
        height: Of its surface [m].
        edge: Middle of its edge (x, y) [m].
        heading: From the edge inwards, from x towards y [rad].
        mesh: What it looks like [m].
    """

    height: float
    edge: tuple[float, float]
    heading: float
    mesh: Mesh

    def planes(self, places: np.ndarray) -> np.ndarray:
        """The plane n . x = d beneath each place [m], shapes [n, 3] and [n, 4]: the platform's or the water's."""
        inward = (places[:, :2] - self.edge) @ [np.cos(self.heading), np.sin(self.heading)]
        level = np.where((inward >= 0.0) & (places[:, 2] > 0.5 * self.height), self.height, 0.0)
        return np.column_stack([np.zeros((len(places), 2)), np.ones(len(places)), level])


@dataclass(frozen=True)
class DrawnWorld:
    """What stands still.

    Attributes:
        oval: Half length and half width of the infield, half circles included [m]; None for open ground.
        fences: All of them.
        pen: The corral, if there is one.
        road: The road and what is around it, if it is one; there is nothing else then.
        heading: Which way those face who perform, from x towards y [rad].
        mat: Half length and half width of the mat on open ground [m]; None where there is none.
        platform: That above the water, if all around is water.
    """

    oval: tuple[float, float] | None
    fences: tuple[DrawnFence, ...]
    pen: DrawnPen | None
    road: DrawnRoad | None = None
    heading: float = 0.0
    mat: tuple[float, float] | None = None
    platform: DrawnPlatform | None = None


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
        """Where cameras take the agents' root links to be [m], shape [frames, agents, 3] (`places_to_frame`)."""
        ...

    def removed(self, first: int, last: int) -> np.ndarray:
        """Which agents have been taken away and are not drawn, bool, shape [frames, agents]."""
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
        self.casts = tuple(drawn_cast(cast) for cast in recording.casts)
        self.actors = tuple(parts_of(actor_visuals(actor)) for actor in recording.actors)
        self.world = drawn_world(recording.world)

    def link_poses(self, first: int, last: int) -> np.ndarray:
        return np.asarray(self._recording.link_poses[first:last], dtype=np.float64)

    def actor_poses(self, first: int, last: int) -> np.ndarray:
        return np.asarray(self._recording.actor_poses[first:last], dtype=np.float64)

    def body_places(self, first: int, last: int) -> np.ndarray:
        places = np.asarray(self._recording.link_poses[first:last, :, 0, :3], dtype=np.float64)
        return places_to_frame(places, self.removed(first, last))

    def removed(self, first: int, last: int) -> np.ndarray:
        return removed_agents(self._recording, slice(first, last))


def drawn_cast(cast: Cast) -> DrawnCast:
    """The agents of a cast as the pictures see them."""
    return DrawnCast(
        first_agent=cast.first_agent,
        links=tuple(parts_of(link.visuals) for link in cast.body.links),
        colors=np.asarray(cast.colors, dtype=np.float32).reshape(-1, 3),
    )


def drawn_platform(platform: Mapping[str, Any]) -> DrawnPlatform:
    """A platform as a recording or a stage has it."""
    x, y = platform["edge"]
    return DrawnPlatform(
        float(platform["height"]), (float(x), float(y)), float(platform["heading"]), platform_mesh(platform)
    )


def drawn_world(world: Mapping[str, Any]) -> DrawnWorld:
    """The world of a recording as the pictures see it."""
    if is_road(world):
        return DrawnWorld(None, (), None, drawn_road(road_scene(world)))
    ground, corral = world["ground"], world.get("corral")
    return DrawnWorld(
        oval=(float(ground["half_length"]), float(ground["half_width"])) if ground["shape"] == "oval" else None,
        fences=(
            *(
                DrawnFence(str(wall["name"]), fence_mesh(wall["points"], bool(wall["closed"]), float(wall["height"])))
                for wall in world.get("walls", ())
            ),
            *([DrawnFence(COLUMNS_NAME, columns_mesh(world["columns"]))] if world.get("columns") else []),
        ),
        pen=None
        if corral is None
        else DrawnPen((float(corral["center"][0]), float(corral["center"][1])), float(corral["size"])),
        heading=float(world.get("heading", 0.0)),
        platform=drawn_platform(world["platform"]) if "platform" in world else None,
        mat=(float(ground["half_length"]), float(ground["half_width"])) if ground["shape"] == "mat" else None,
    )
