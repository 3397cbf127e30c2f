"""Everything that moves, posed, lit and merged into two surfaces: the bodies, and the shadows that they throw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from echelon.export.coarse_meshes import coarsened
from echelon.export.drawn_parts import DrawnPart
from echelon.export.light import LEVEL, MOVING_SHADOWS, SHADOW_COLOR, flattened, lit
from echelon.export.mesh_parts import separate_parts
from echelon.export.picture_source import DrawnCast
from echelon.export.renderer import Surface, joined

_UNKNOWN_COLOR = (0.5, 0.5, 0.5)  # of an actor's part without a colour of its own


@dataclass(frozen=True)
class _Link:
    """A link's parts as one mesh: points and normals, shape [n, 3], in the link's frame."""

    points: np.ndarray
    normals: np.ndarray


class DrawnBodies:
    """Bodies that share their shape: agents of a cast, or one actor."""

    def __init__(self, links: Sequence[Sequence[DrawnPart]], colors: np.ndarray) -> None:
        """
        Args:
            links: Parts of each link.
            colors: Linear RGB of each body, for parts without a colour, shape [bodies, 3].
        """
        self._links, self._colors = links, colors
        self._fine = _Shapes(links, colors)

    @cached_property
    def _coarse(self) -> _Shapes:
        links = [[DrawnPart(coarsened(part.mesh), part.color) for part in parts] for parts in self._links]
        return _Shapes(links, self._colors)

    def surfaces(
        self,
        poses: np.ndarray,
        ground: np.ndarray = LEVEL,
        close: np.ndarray | None = None,
        removed: np.ndarray | None = None,
    ) -> tuple[Surface, Surface]:
        """The bodies and their shadows.

        Args:
            poses: Of the links, shape [bodies, links, 7]; links beyond those that are drawn are ignored.
            ground: The plane beneath each body, n . x = d, broadcast to shape [bodies, 4].
            close: Which bodies are so close that they are drawn in every detail, shape [bodies]; None for all, and
                their shadows too.
            removed: Which bodies are not drawn, shape [bodies]; None for none.
        """
        ground = np.broadcast_to(ground, (len(poses), 4))
        removed = np.zeros(len(poses), bool) if removed is None else removed
        if close is None:
            return self._fine.bodies(poses, np.flatnonzero(~removed)), self._fine.shadows(poses, ground, removed)
        solid = [
            self._fine.bodies(poses, np.flatnonzero(close & ~removed)),
            self._coarse.bodies(poses, np.flatnonzero(~close & ~removed)),
        ]
        return joined(solid), self._coarse.shadows(poses, ground, removed)


class _Shapes:
    """Shapes of bodies in one degree of detail, ready to be posed."""

    def __init__(self, links: Sequence[Sequence[DrawnPart]], colors: np.ndarray) -> None:
        self._links = [_link(parts) for parts in links]
        parts = [part for link in links for part in link]
        first_point = np.cumsum([0] + [len(part.mesh.points) for part in parts])
        empty = np.empty((len(colors), 0, 3), np.float32)
        self._albedo = np.concatenate([empty, *[_albedo(part, colors) for part in parts]], axis=1)
        self._template = np.concatenate(
            [
                np.empty((0, 3), np.int64),
                *[part.mesh.triangles + first for part, first in zip(parts, first_point, strict=False)],
            ]
        )
        bodies = np.arange(len(colors))
        piece, piece_count = _pieces(parts)
        # Neighbours in the list get layers of their own; far down the list layers are used again.
        layer = piece[None] + piece_count * bodies[:, None]
        self._shadow_heights = MOVING_SHADOWS.heights(layer, piece_count).astype(np.float32)
        # Shadows are drawn from the top layer down: the depth test lets only the first one darken.
        triangles = self._of_all(len(bodies))
        height = self._shadow_heights.reshape(-1)[triangles[:, 0]]
        self._shadow_triangles = triangles[np.argsort(-height, kind="stable")]

    def bodies(self, poses: np.ndarray, chosen: np.ndarray) -> Surface:
        """Some of the bodies, lit; poses of all, shape [bodies, links, 7]."""
        points, normals = self._posed(poses[chosen])
        opaque = np.ones((*points.shape[:2], 1), dtype=np.float32)
        colors = np.concatenate([lit(self._albedo[chosen], normals), opaque], axis=2)
        return Surface(points.reshape(-1, 3), colors.reshape(-1, 4), self._of_all(len(chosen)))

    def shadows(self, poses: np.ndarray, ground: np.ndarray, removed: np.ndarray) -> Surface:
        """The shadows of all bodies on the planes beneath them, shapes [bodies, links, 7] and [bodies, 4].

        The triangles are those of all bodies, whoever has been removed: theirs shrink to a point.
        """
        points, _ = self._posed(poses)
        points[removed] = points[removed][:, :1]
        flat = flattened(points, self._shadow_heights, ground[:, None])
        dark = np.broadcast_to(SHADOW_COLOR, (flat.shape[0] * flat.shape[1], 4))
        return Surface(flat.reshape(-1, 3), dark, self._shadow_triangles)

    def _posed(self, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points [m] and normals in the world, float32, shape [bodies, points, 3] each."""
        rotations = rotation_matrices(poses[..., 3:]).astype(np.float32)
        places = poses[..., :3].astype(np.float32)
        points = [np.empty((len(poses), 0, 3), np.float32)]
        normals = [np.empty((len(poses), 0, 3), np.float32)]
        for index, link in enumerate(self._links):
            turn = rotations[:, index].transpose(0, 2, 1)
            points.append(link.points @ turn + places[:, index, None])
            normals.append(link.normals @ turn)
        return np.concatenate(points, axis=1), np.concatenate(normals, axis=1)

    def _of_all(self, count: int) -> np.ndarray:
        """Triangles of so many bodies, shape [n, 3]."""
        points = self._albedo.shape[1]
        return (self._template[None] + points * np.arange(count)[:, None, None]).reshape(-1, 3)


class MovingScene:
    """All casts and actors."""

    def __init__(self, casts: Sequence[DrawnCast], actors: Sequence[Sequence[DrawnPart]]) -> None:
        self._casts = [(cast.first_agent, DrawnBodies(cast.links, cast.colors)) for cast in casts]
        self._agent_counts = [len(cast.colors) for cast in casts]
        self._actors = [DrawnBodies([parts], np.array([_UNKNOWN_COLOR])) for parts in actors]

    def surfaces(
        self,
        link_poses: np.ndarray,
        actor_poses: np.ndarray,
        ground: np.ndarray | None = None,
        close: np.ndarray | None = None,
        removed: np.ndarray | None = None,
    ) -> list[Surface]:
        """Bodies, then shadows.

        Args:
            link_poses: Of the agents, shape [agents, links, 7].
            actor_poses: Of the actors, shape [actors, 7].
            ground: The plane beneath each agent, then beneath each actor, n . x = d, shape [agents + actors, 4]; None
                where it is level, at z = 0.
            close: Likewise, which of them are drawn in every detail; None for all.
            removed: Which agents are not drawn, shape [agents]; None for none.
        """
        if ground is None:
            ground = np.broadcast_to(LEVEL, (len(link_poses) + len(actor_poses), 4))
        found = []
        for (first, bodies), count in zip(self._casts, self._agent_counts, strict=True):
            those = slice(first, first + count)
            near, gone = (None if some is None else some[those] for some in (close, removed))
            found.append(bodies.surfaces(link_poses[those], ground[those], near, gone))
        for index, bodies in enumerate(self._actors):
            those = slice(len(link_poses) + index, len(link_poses) + index + 1)
            poses = actor_poses[index : index + 1, None]
            found.append(bodies.surfaces(poses, ground[those], None if close is None else close[those]))
        return [joined([solid for solid, _ in found]), joined([shadow for _, shadow in found])]


def rotation_matrices(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices of unit quaternions (x, y, z, w), shapes [..., 4] and [..., 3, 3]."""
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    rows = [
        np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=-1),
        np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=-1),
        np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=-1),
    ]
    return np.stack(rows, axis=-2)


def _link(parts: Sequence[DrawnPart]) -> _Link:
    empty = np.empty((0, 3), np.float32)
    return _Link(
        points=np.concatenate([empty, *[part.mesh.points for part in parts]]),
        normals=np.concatenate([empty, *[part.mesh.normals for part in parts]]),
    )


def _pieces(parts: Sequence[DrawnPart]) -> tuple[np.ndarray, int]:
    """Which convex piece each point of all parts belongs to, and how many pieces there are."""
    found = [np.empty(0, np.int64)]
    count = 0
    for part in parts:
        found.append(separate_parts(part.mesh) + count)
        count = int(found[-1].max(initial=count - 1)) + 1
    return np.concatenate(found), count


def _albedo(part: DrawnPart, colors: np.ndarray) -> np.ndarray:
    """Linear RGB of a part's points on every body, float32, shape [bodies, points, 3]."""
    own = colors if part.color is None else np.broadcast_to(np.asarray(part.color), (len(colors), 3))
    return np.repeat(own[:, None].astype(np.float32), len(part.mesh.points), axis=1)
