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
class Blockers:
    """What stands in the way of a camera: upright cylinders.

    Attributes:
        positions: Of their feet [m],       [n, 3]
        radii: [m],                         [n]
        heights: [m],                       [n]
    """

    positions: np.ndarray
    radii: np.ndarray
    heights: np.ndarray

    def hidden(self, eye: np.ndarray, targets: np.ndarray) -> float:
        """Which part of some targets [m], shape [n, 3], cannot be seen from an eye [m], 0 to 1."""
        way = targets - eye
        gaps = self.positions[:, None] - eye
        # Where the line of sight passes nearest on the map.
        part = np.sum(gaps[..., :2] * way[:, :2], axis=2) / np.maximum(np.sum(way[:, :2] ** 2, axis=1), 1e-9)
        part = np.clip(part, 0.0, 1.0)
        aside = np.linalg.norm(gaps[..., :2] - part[..., None] * way[:, :2], axis=2)
        above = part * way[:, 2] - gaps[..., 2]
        return float(((aside < self.radii[:, None]) & (above < self.heights[:, None])).any(axis=0).mean())


@dataclass(frozen=True)
class DrawnRoad:
    """The ground, from the land up to the paint, and what stands on it."""

    ground: tuple[GroundPart, ...]
    things: tuple[DrawnThings, ...]

    @property
    def places(self) -> np.ndarray:
        """Where all things stand (x, y) [m], shape [n, 2]."""
        return np.concatenate([np.empty((0, 2)), *[thing.positions[:, :2] for thing in self.things]])

    def blockers(self) -> Blockers:
        """What is broad and high enough to hide a rider."""
        positions, radii, heights = [np.empty((0, 3))], [np.empty(0)], [np.empty(0)]
        for thing in self.things:
            corner = np.max([np.abs(part.mesh.extent).max(axis=0) for part in thing.parts], axis=0)
            scale = np.linalg.norm(thing.frames, axis=1)
            radius, height = (corner[:2] * scale[:, :2]).max(axis=1), corner[2] * scale[:, 2]
            broad = (height > 2.0) & (corner[:2].min() > 1.0)
            positions.append(thing.positions[broad])
            radii.append(radius[broad])
            heights.append(height[broad])
        return Blockers(np.concatenate(positions), np.concatenate(radii), np.concatenate(heights))


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
