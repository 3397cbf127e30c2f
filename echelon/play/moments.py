"""What there is to see at a moment, between frames too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Moment:
    """Where everybody is.

    Attributes:
        links: Poses of the agents' links in the world, x y z [m] and quaternion (x, y, z, w), [agents, links, 7]
        actors: Of the actors, likewise,                                                       [actors, 7]
        removed: Who has been taken away,                                                      bool [agents]
        fallen: How many have fallen.
    """

    links: np.ndarray
    actors: np.ndarray
    removed: np.ndarray
    fallen: int

    @property
    def rider(self) -> np.ndarray | None:
        """Pose of the first actor, who is or may be ridden, shape [7]; None where there is none."""
        return self.actors[0] if len(self.actors) else None

    @property
    def places(self) -> np.ndarray:
        """Of the agents who are there [m], shape [n, 3]."""
        return self.links[~self.removed, 0, :3]


def between(before: Moment, after: Moment, part: float) -> Moment:
    """A moment a part of the way from one to the next: straight between places, evenly between attitudes."""
    if part <= 0.0:
        return before
    if part >= 1.0:
        return after
    links, actors = (_blend(*poses, part) for poses in ((before.links, after.links), (before.actors, after.actors)))
    return Moment(links, actors, after.removed, after.fallen)


def _blend(before: np.ndarray, after: np.ndarray, part: float) -> np.ndarray:
    """Poses, shape [..., 7]. Frames are so close that a normalised mean of quaternions turns evenly enough."""
    # q and -q are the same attitude; the way between them must be the short one.
    same = np.where(np.sum(before[..., 3:] * after[..., 3:], axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    mixed = np.empty_like(before)
    mixed[..., :3] = before[..., :3] + part * (after[..., :3] - before[..., :3])
    turned = (1.0 - part) * before[..., 3:] + part * same * after[..., 3:]
    mixed[..., 3:] = turned / np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), 1e-12)
    return mixed
