"""Soft dark patches beneath those who move: where the sun would throw their shadow, about as large.

The browser's own shadow maps draw everything several times, which a computer without a graphics card cannot afford. A
patch is an ellipse on the ground: the body's outline on the map, drawn out along the sun's rays by its height. As
matrices, an outline with half axes a along the heading and b across is C = R diag(a^2, b^2) R^T; a body of height h,
whose shadow the sun throws over s = h (s_x, s_y), adds the outer product of s / 2 with itself; and the axes of what
comes out are the patch's. A round body's patch is the same whichever way it looks: on level ground it only moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from echelon.export.drawn_bodies import rotation_matrices
from echelon.export.drawn_parts import DrawnPart
from echelon.export.light import SHADOW_COLOR, SUN
from echelon.play.drawing.browser_light import shown_as_is
from echelon.play.drawing.glb import ColoredMesh, glb
from echelon.play.drawing.moving import AWAY, UPRIGHT

LIFT = 0.032  # [m] above the ground
ROUND = 0.25  # outlines whose axes differ by less than this part are taken for circles
_RINGS = ((0.0, 1.0), (0.45, 0.96), (0.7, 0.72), (0.88, 0.28), (1.0, 0.0))  # (radius, darkness)
_SEGMENTS = 20
FADE = 1.2  # times as large as the shadow: the outermost part is hardly dark
_THROW = -SUN[:2] / SUN[2]  # [m] that a shadow lies aside for a metre of height


@dataclass(frozen=True)
class Outline:
    """A body from above and from the side.

    Attributes:
        half_axes: Along its heading and across [m].
        middle: Of the outline, in the heading's frame, from the root link's place [m], shape [2].
        rise: From the root link's place up to the body's middle [m].
        height: [m].
    """

    half_axes: tuple[float, float]
    middle: np.ndarray
    rise: float
    height: float

    @property
    def is_round(self) -> bool:
        return self.half_axes[0] == self.half_axes[1]


def outline(links: tuple[tuple[DrawnPart, ...], ...], poses: np.ndarray) -> Outline:
    """The outline of a body.

    Args:
        links: Parts of each link, at least one in all.
        poses: Of the links, shape [links, 7].
    """
    heading = _headings(poses[:1])[0]
    turns = rotation_matrices(poses[:, 3:])
    points = np.concatenate(
        [
            part.mesh.points.astype(np.float64) @ turn.T + pose[:3]
            for parts, turn, pose in zip(links, turns, poses, strict=False)
            for part in parts
        ]
    )
    points -= poses[0, :3]
    ahead = np.array([np.cos(heading), np.sin(heading)])
    flat = np.column_stack([points[:, :2] @ ahead, points[:, :2] @ [-ahead[1], ahead[0]]])
    low, high = flat.min(axis=0), flat.max(axis=0)
    a, b = (0.5 * (high - low)).tolist()
    middle = 0.5 * (low + high)
    if abs(a - b) < ROUND * max(a, b):
        a = b = 0.5 * (a + b)
        middle = np.zeros(2)
    bottom, top = float(points[:, 2].min()), float(points[:, 2].max())
    return Outline((a, b), middle, 0.5 * (bottom + top), top - bottom)


class Shadows:
    """The patches of bodies that share their outline."""

    def __init__(self, server: viser.ViserServer, name: str, body: Outline, count: int) -> None:
        """Put them into the scene; they are seen once they have been moved."""
        self._body = body
        self._batch = server.scene.add_batched_glb(
            name,
            patch(),
            np.tile(UPRIGHT, (count, 1)),
            np.tile(AWAY, (count, 1)),
            batched_scales=np.ones((count, 3), np.float32),
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )
        self._round = _ellipses(body, np.zeros(1)) if body.is_round else None
        self._lies_on: np.ndarray | None = None  # normals of the ground for which round patches have been turned

    def show(self, roots: np.ndarray, planes: np.ndarray, removed: np.ndarray) -> None:
        """Move them.

        Args:
            roots: Poses of the root links, shape [bodies, 7].
            planes: The ground beneath each, n . x = d, shape [bodies, 4].
            removed: Who has no shadow, shape [bodies].
        """
        points = shadow_places(self._body, roots, planes)
        points[removed] = AWAY
        self._batch.batched_positions = points.astype(np.float32)
        normals = planes[:, :3]
        if self._round is None:
            axes, half = _ellipses(self._body, _headings(roots))
        elif self._lies_on is not None and np.array_equal(normals, self._lies_on):
            return
        else:
            axes, half = (np.broadcast_to(part, (len(roots), *part.shape[1:])) for part in self._round)
            self._lies_on = np.array(normals)
        self._batch.batched_wxyzs = _lying(axes, normals).astype(np.float32)
        self._batch.batched_scales = half.astype(np.float32)

    def remove(self) -> None:
        """Take them out of the scene."""
        self._batch.remove()


class ActorShadow:
    """The patch of an actor, who is moved as a whole and not in a batch.

    A page applies poses of whole things at once and those of batches a little later, so that a shadow in a batch would
    lag behind. Its size is that of one heading and stays.
    """

    def __init__(self, server: viser.ViserServer, name: str, body: Outline) -> None:
        """Put it into the scene; it is seen once it has been moved."""
        self._body = body
        _, half = _ellipses(body, np.array([np.arctan2(_THROW[1], _THROW[0]) + 0.25 * np.pi]))
        x, y, z = half[0].tolist()
        self._node = server.scene.add_glb(
            name, patch(), scale=(x, y, z), position=AWAY, cast_shadow=False, receive_shadow=False
        )

    def show(self, pose: np.ndarray, plane: np.ndarray) -> None:
        """Move it to where an actor's pose [7] throws it on the ground, n . x = d, shape [4]."""
        axes, _ = _ellipses(self._body, _headings(pose[None]))
        self._node.position = shadow_places(self._body, pose[None], plane[None])[0]
        self._node.wxyz = _lying(axes, plane[None, :3])[0]

    def remove(self) -> None:
        """Take it out of the scene."""
        self._node.remove()


def shadow_places(body: Outline, roots: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Middles of patches [m], shape [bodies, 3]; arguments as for `Shadows.show`."""
    if body.is_round:
        middle = roots[:, :2]
    else:
        headings = _headings(roots)
        along = np.column_stack([np.cos(headings), np.sin(headings)])
        across = np.column_stack([-along[:, 1], along[:, 0]])
        middle = roots[:, :2] + body.middle[0] * along + body.middle[1] * across
    normals = planes[:, :3]
    foot = (planes[:, 3] - (normals[:, :2] * middle).sum(axis=1)) / normals[:, 2]
    place = middle + np.maximum(roots[:, 2] + body.rise - foot, 0.0)[:, None] * _THROW
    height = (planes[:, 3] - (normals[:, :2] * place).sum(axis=1)) / normals[:, 2]
    return np.column_stack([place, height + LIFT])


def _ellipses(body: Outline, headings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Long axes on the map, shape [n, 2], and half axes with a 1 for the height [m], shape [n, 3], of patches."""
    along = np.column_stack([np.cos(headings), np.sin(headings)])
    across = np.column_stack([-along[:, 1], along[:, 0]])
    a, b = body.half_axes
    outlines = a * a * along[:, :, None] * along[:, None] + b * b * across[:, :, None] * across[:, None]
    thrown = 0.5 * body.height * _THROW
    squares, axes = np.linalg.eigh(outlines + np.outer(thrown, thrown))
    half = FADE * np.sqrt(np.maximum(squares, 1e-6))
    return axes[:, :, 1], np.column_stack([half[:, 1], half[:, 0], np.ones(len(half))])


def _headings(poses: np.ndarray) -> np.ndarray:
    """Which way the x axes of poses [n, 7] look on the map, from x towards y [rad]."""
    x, y, z, w = np.moveaxis(poses[:, 3:], -1, 0)
    return np.arctan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z))


def _lying(long_axes: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Quaternions (w, x, y, z) that lay x along axes on the map [n, 2] on to planes with normals [n, 3]."""
    rise = -(normals[:, :2] * long_axes).sum(axis=1) / normals[:, 2]
    x = np.column_stack([long_axes, rise])
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    frames = np.stack([x, np.cross(normals, x), normals], axis=2)
    return Rotation.from_matrix(frames).as_quat(canonical=True, scalar_first=True)


def patch() -> bytes:
    """A disc of radius 1 that fades out towards its edge, binary glTF."""
    angle = 2.0 * np.pi * np.arange(_SEGMENTS) / _SEGMENTS
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_SEGMENTS)])
    points = np.concatenate([radius * circle for radius, _ in _RINGS])
    dark = np.repeat([darkness for _, darkness in _RINGS], _SEGMENTS) * SHADOW_COLOR[3]
    colors = np.column_stack([np.tile(shown_as_is(SHADOW_COLOR[:3]), (len(points), 1)), dark])
    here, after = np.arange(_SEGMENTS), (np.arange(_SEGMENTS) + 1) % _SEGMENTS
    triangles = []
    for ring in range(len(_RINGS) - 1):
        inner, outer = ring * _SEGMENTS, (ring + 1) * _SEGMENTS
        if ring:
            triangles.append(np.stack([inner + here, outer + after, inner + after], axis=1))
        triangles.append(np.stack([inner + here, outer + here, outer + after], axis=1))
    return glb([ColoredMesh(points, np.concatenate(triangles), colors)], shaded=False, see_through=True)
