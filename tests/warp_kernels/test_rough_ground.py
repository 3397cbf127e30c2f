"""Ground that is not a plane: every site that stands on it has a plane of its own, every tick."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false, reportIndexIssue=false
# (Warp's types mean other things to it than to Python.)

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import warp as wp
from engine_scenes import diagonal, free_link

from echelon.agents.servo import ServoedBody
from echelon.warp_kernels.frame import ChunkArrays, Engine
from echelon.warp_kernels.model import ContactSite
from echelon.warp_kernels.reference import Body

HALF = 0.5  # between the middle of the sled and its feet [m]


@wp.struct
class Bowl:
    curvature: wp.float64


@wp.func
def look_up_bowl(surface: int, point: wp.vec3d, bowl: Bowl) -> wp.vec4d:
    """The tangent plane of z = curvature (x^2 + y^2) / 2 above or below a point."""
    slope_x, slope_y = bowl.curvature * point[0], bowl.curvature * point[1]
    height = wp.float64(0.5) * bowl.curvature * (point[0] * point[0] + point[1] * point[1])
    normal = wp.normalize(wp.vec3d(-slope_x, -slope_y, wp.float64(1.0)))
    return wp.vec4d(normal[0], normal[1], normal[2], wp.dot(normal, wp.vec3d(point[0], point[1], height)))


@dataclass(frozen=True)
class BowlTerrain:
    data: Any
    look_up: Any = look_up_bowl
    level: bool = False
    rough: bool = True

    @classmethod
    def of(cls, curvature: float) -> BowlTerrain:
        bowl = Bowl()
        bowl.curvature = curvature
        return cls(bowl)


def sled(friction: float, use: str = "usual") -> Body:
    """A plank on four feet."""
    feet = [
        ContactSite(f"foot {i}", "link", (x, y, -0.1), friction=friction, tangential_damping=100.0, use=use)  # type: ignore[arg-type]
        for i, (x, y) in enumerate(((HALF, 0.2), (HALF, -0.2), (-HALF, 0.2), (-HALF, -0.2)))
    ]
    return free_link(20.0, diagonal(0.5, 2.0, 2.0), feet, height=0.1, name="sled")


def placed(body: Body, curvature: float, places: np.ndarray) -> tuple[Engine, ChunkArrays]:
    """Sleds over the bowl at (x, y), level, a little above the ground."""
    engine = Engine(ServoedBody(body, 0.0, 0.0), len(places), BowlTerrain.of(curvature), substeps=40, tick=5)
    chunk = ChunkArrays.allocate(1, len(places), engine.character)
    engine.bind(chunk)
    q = np.tile(body.q_reference, (len(places), 1))
    q[:, 2] = 0.0
    engine.set_q(q)
    radius = np.hypot(places[:, 0], places[:, 1]) + 0.7
    engine.set_origins(np.column_stack([places, 0.5 * curvature * radius**2 + 0.1]))
    return engine, chunk


def test_each_foot_stands_on_the_ground_beneath_it():
    curvature = 0.2
    places = np.array([[0.0, 0.0], [1.0, 0.0], [-0.5, 0.4]])
    body = sled(friction=0.9)
    engine, chunk = placed(body, curvature, places)
    for _ in range(90):
        engine.advance(0)
    pose = chunk.poses.numpy()[0, :, 0].astype(float)
    pose[:, :3] += chunk.origins.numpy()[0]
    for x, y, z, *quaternion in pose:
        turn = rotation(np.array(quaternion))
        feet = np.array([[x, y, z] + turn @ np.array(site.position) for site in body.contacts])
        depth = 0.5 * curvature * (feet[:, 0] ** 2 + feet[:, 1] ** 2) - feet[:, 2]
        # 20 kg on springs of 5e4 N/m sink by a millimetre; one plane for all four would be off by 25.
        assert np.max(np.abs(depth - 0.001)) < 0.0015


def test_a_sled_slides_in_a_bowl_with_the_bowl_s_period():
    """Without friction a small thing in a bowl of curvature c swings like a pendulum of length 1 / c."""
    curvature, gravity = 0.1, 9.80665
    engine, _ = placed(sled(friction=0.0), curvature, np.array([[0.8, 0.0]]))
    track = []
    for _ in range(400):
        engine.advance(0)
        track.append(engine.positions.numpy()[0, 0])
    track = np.array(track[40:])
    rising = np.flatnonzero((track[:-1] < 0.0) & (track[1:] >= 0.0))
    assert len(rising) >= 2
    period = np.diff(rising).mean() / 30.0
    # Its inertia in pitch turns with it, and its middle hangs above the ground: as a compound pendulum.
    length, radius = 1.0 / curvature - 0.1, np.sqrt(2.0 / 20.0)
    expected = 2.0 * np.pi * np.sqrt((length**2 + radius**2) / (gravity * length))
    assert period == pytest.approx(expected, rel=0.02)
    # Gliding over planes that are looked up anew must not brake it: as high on the other side.
    assert np.max(track) == pytest.approx(-np.min(track), rel=0.03)


def test_what_touches_rarely_takes_the_ground_under_the_root():
    engine, _ = placed(sled(friction=0.9, use="rare"), 0.2, np.array([[1.0, 0.0]]))
    assert engine.program.located_sites == ()
    for _ in range(60):
        engine.advance(0)
    planes = engine._planes.numpy()[0, :, 0].reshape(4, 4)
    np.testing.assert_array_equal(planes, planes[[0, 0, 0, 0]])
    assert abs(engine.positions.numpy()[0, 2] - 0.1 - 0.1) < 0.05


def rotation(q: np.ndarray) -> np.ndarray:
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
