"""A road as the pictures see it, whether it comes from a recording or was read back from a stage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from echelon.export.drawn_parts import DrawnPart
from echelon.export.road_scene import GroundPart, RoadScene
from echelon.export.scenery_assets import VARIANTS, asset


@dataclass(frozen=True)
class DrawnThings:
    """Things that look alike but for place, size and colour.

    Attributes:
        name: What they are, such as "broadleaf".
        parts: In their own frame [m].
        positions: Of their origins in the world [m], float64,              [n, 3]
        frames: From their own axes to the world's, scale included,         [n, 3, 3]
        colors: Linear RGB of each, for parts without a colour,             [n, 3]
    """

    name: str
    parts: tuple[DrawnPart, ...]
    positions: np.ndarray
    frames: np.ndarray
    colors: np.ndarray


@dataclass(frozen=True)
class DrawnRoad:
    """The ground, from the land up to the paint, and what stands on it."""

    ground: tuple[GroundPart, ...]
    things: tuple[DrawnThings, ...]

    @property
    def places(self) -> np.ndarray:
        """Where all things stand (x, y) [m], shape [n, 2]."""
        return np.concatenate([np.empty((0, 2)), *[thing.positions[:, :2] for thing in self.things]])


def drawn_road(scene: RoadScene) -> DrawnRoad:
    """A scene as the pictures see it."""
    things: list[DrawnThings] = []
    for placed in scene.placed:
        turns = Rotation.from_euler("z", placed.yaws[:, None]).as_matrix()
        for number, name in enumerate(VARIANTS[placed.kind]):
            chosen = placed.variants == number
            if chosen.any():
                frames = turns[chosen] * placed.scales[chosen][:, None, :]
                things.append(DrawnThings(name, asset(name), placed.positions[chosen], frames, placed.colors[chosen]))
    for obstacle in scene.obstacles:
        frame = Rotation.from_quat(obstacle.pose[3:]).as_matrix()
        things.append(
            DrawnThings(obstacle.kind, obstacle.parts, obstacle.pose[None, :3], frame[None], np.full((1, 3), 0.5))
        )
    return DrawnRoad(scene.ground, tuple(things))
