"""Everybody who moves, in the browser: for each link of a cast two batches of meshes, posed anew every frame.

What is sent decides what a frame costs. A link's parts that look alike on everybody are one mesh with colours at its
points; those in the individual's colour are another, with a colour for each copy, because viser's batches have either
the one or the other. A pose is 28 bytes, whatever the mesh; a batch that has not moved is not sent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import viser

from echelon.export.drawn_parts import DrawnPart
from echelon.export.picture_source import DrawnCast
from echelon.export.shapes import joined
from echelon.play.drawing.browser_light import shaded_albedo
from echelon.play.drawing.glb import glb
from echelon.play.drawing.painted_parts import painted, split

AWAY = np.array([0.0, 0.0, -1.0e4], dtype=np.float32)  # [m]: where those are who have been taken away
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32)  # quaternion (w, x, y, z)
DETAIL = ((14.0, 0.45), (35.0, 0.15))  # (so far away [m], so many of the triangles at least)
UNKNOWN_COLOR = (0.5, 0.5, 0.5)  # of an actor's part without a colour of its own

Batch = viser.BatchedMeshHandle | viser.BatchedGlbHandle


@dataclass(frozen=True)
class _Link:
    """A link of a cast: which one, and its batches."""

    index: int
    batches: tuple[Batch, ...]


class MovingBodies:
    """Casts and actors in a scene."""

    def __init__(
        self, server: viser.ViserServer, casts: Sequence[DrawnCast], actors: Sequence[Sequence[DrawnPart]]
    ) -> None:
        """Put them into the scene, out of sight until they are shown.

        Args:
            server: Whose scene it is.
            casts: Agents.
            actors: Parts of each actor.
        """
        self._scene = server.scene
        self._casts = [(_members(cast), self._cast(number, cast)) for number, cast in enumerate(casts)]
        self._actors = [self._actor(number, parts) for number, parts in enumerate(actors)]

    def show(self, link_poses: np.ndarray, actor_poses: np.ndarray, removed: np.ndarray | None) -> None:
        """Move them.

        Args:
            link_poses: In the world, x y z [m] and quaternion (x, y, z, w), shape [agents, links, 7].
            actor_poses: Likewise, shape [actors, 7].
            removed: Who is not there, shape [agents]; None where all are.
        """
        for members, links in self._casts:
            poses = np.asarray(link_poses[members], dtype=np.float32)
            positions, turns = poses[..., :3], poses[..., [6, 3, 4, 5]]
            if removed is not None and removed[members].any():
                positions = np.where(removed[members][:, None, None], AWAY, positions)
            for link in links:
                for batch in link.batches:
                    batch.batched_positions = positions[:, link.index]
                    batch.batched_wxyzs = turns[:, link.index]
        for actor, pose in zip(self._actors, actor_poses, strict=True):
            actor.position, actor.wxyz = pose[:3], pose[[6, 3, 4, 5]]

    def remove(self) -> None:
        """Take them out of the scene."""
        for _, links in self._casts:
            for link in links:
                for batch in link.batches:
                    batch.remove()
        for actor in self._actors:
            actor.remove()

    def _cast(self, number: int, cast: DrawnCast) -> list[_Link]:
        count = len(cast.colors)
        places = np.tile(AWAY, (count, 1))
        turns = np.tile(UPRIGHT, (count, 1))
        colors = np.round(255.0 * shaded_albedo(cast.colors)).astype(np.uint8)
        links = []
        for index, parts in enumerate(cast.links):
            name = f"/crowd/{number}/{index}"
            alike, own = split(parts)
            batches: list[Batch] = []
            if alike:
                model = glb([painted(alike, np.zeros(3))], shaded=True)
                batches.append(self._scene.add_batched_glb(f"{name}/alike", model, turns, places, lod=DETAIL))
            if own:
                mesh = joined([part.mesh for part in own])
                batches.append(
                    self._scene.add_batched_meshes_simple(
                        f"{name}/own", mesh.points, mesh.triangles, turns, places, batched_colors=colors, lod=DETAIL
                    )
                )
            links.append(_Link(index, tuple(batches)))
        return links

    def _actor(self, number: int, parts: Sequence[DrawnPart]) -> viser.GlbHandle:
        model = glb([painted(parts, np.array(UNKNOWN_COLOR))], shaded=True)
        x, y, z = AWAY.tolist()
        return self._scene.add_glb(actor_name(number), model, position=(x, y, z))


def actor_name(number: int) -> str:
    """The name of an actor in the scene."""
    return f"/actors/{number}"


def _members(cast: DrawnCast) -> slice:
    return slice(cast.first_agent, cast.first_agent + len(cast.colors))
