"""How deep characters are inside one another: a measure of contact that contact itself has no part in.

It is made of poses, of a recording for instance:

    deepest_crossing(character.capsules, recording.link_poses[:, :, 0])
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from echelon.warp_kernels.character import Capsule

BATCH = 200_000
"""Pairs of capsules that are looked at together."""


def deepest_crossing(capsules: Sequence[Capsule], poses: np.ndarray) -> np.ndarray:
    """By how much the two who overlap most do so, frame by frame.

    Args:
        capsules: Of each, in the first link's axes.
        poses: Of the first links in the world, x y z [m] and quaternion x y z w, shape [frames, agents, 7]. Who is
            somewhere that is not finite overlaps nobody.

    Returns:
        [m], shape [frames]; 0 where nobody overlaps anybody.
    """
    poses = np.asarray(poses, dtype=float)
    deepest = np.zeros(len(poses))
    if not capsules or poses.shape[1] < 2:
        return deepest
    radii = np.array([capsule.radius for capsule in capsules])
    reach = max(float(np.linalg.norm(end)) + c.radius for c in capsules for end in (c.start, c.end))
    starts, ends = (_in_world(np.array([getattr(c, end) for c in capsules]), poses) for end in ("start", "end"))
    first, second = np.triu_indices(poses.shape[1], 1)
    frames = max(1, BATCH // max(len(first) * len(capsules) ** 2, 1))
    for begin in range(0, len(poses), frames):
        part = slice(begin, begin + frames)
        away = poses[part, first, :3] - poses[part, second, :3]
        frame, pair = np.nonzero(np.linalg.norm(away, axis=-1) < 2.0 * reach)
        a, b, at = first[pair], second[pair], frame + begin
        for i in range(len(capsules)):
            for j in range(len(capsules)):
                apart = segment_distances(starts[at, a, i], ends[at, a, i], starts[at, b, j], ends[at, b, j])
                np.maximum.at(deepest, at, radii[i] + radii[j] - apart)
    return deepest


def segment_distances(start: np.ndarray, end: np.ndarray, other_start: np.ndarray, other_end: np.ndarray) -> np.ndarray:
    """Distances between line segments, from one's ends to its other's ends; shapes [..., 3] to [...]."""
    # The least over both segments is at an end of one of them, or where both are crossed at right angles.
    along, other_along, gap = end - start, other_end - other_start, start - other_start
    aa, bb, ab = _dot(along, along), _dot(other_along, other_along), _dot(along, other_along)
    ag, bg = _dot(along, gap), _dot(other_along, gap)
    crossed = aa * bb - ab * ab
    s = np.where(crossed > 1e-12, (ab * bg - bb * ag) / np.where(crossed > 1e-12, crossed, 1.0), 0.0)
    t = np.where(crossed > 1e-12, (aa * bg - ab * ag) / np.where(crossed > 1e-12, crossed, 1.0), 0.0)
    inside = (crossed > 1e-12) & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    crossing = np.linalg.norm(gap + s[..., None] * along - t[..., None] * other_along, axis=-1)
    least = np.where(inside, crossing, np.inf)
    for point, base, way in (
        (start, other_start, other_along),
        (end, other_start, other_along),
        (other_start, start, along),
        (other_end, start, along),
    ):
        part = np.clip(_dot(point - base, way) / np.maximum(_dot(way, way), 1e-12), 0.0, 1.0)
        least = np.minimum(least, np.linalg.norm(point - base - part[..., None] * way, axis=-1))
    return least


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b, axis=-1)


def _in_world(points: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Points of a link under each pose, shapes [points, 3] and [..., 7] to [..., points, 3]."""
    vector, scalar = poses[..., None, 3:6], poses[..., None, 6:7]
    twice = 2.0 * np.cross(vector, points)
    return poses[..., None, :3] + points + scalar * twice + np.cross(vector, twice)
