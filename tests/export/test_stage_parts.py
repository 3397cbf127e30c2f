"""The arithmetic beneath a stage: motion, keys in time, welded meshes, the camera's move."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from echelon.export import shapes
from echelon.export.stage import camera, meshes, motion, time_samples
from echelon.warp_kernels.model import Visual
from tests.export.synthetic import joints_model, synthetic_recording

RNG = np.random.default_rng(11)


def test_quaternions_agree_with_scipy() -> None:
    a, b = (Rotation.from_rotvec(RNG.uniform(-2.0, 2.0, size=(40, 3))) for _ in range(2))
    vectors = RNG.normal(size=(40, 3))
    product = Rotation.from_quat(motion.product(a.as_quat(), b.as_quat()))
    assert ((a * b) * product.inv()).magnitude().max() < 1e-12
    assert np.allclose(motion.rotated(a.as_quat(), vectors), a.apply(vectors))
    assert np.allclose(motion.rotation_vectors(-a.as_quat()), a.as_rotvec())
    assert np.allclose(motion.rotation_vectors(np.array([[0.0, 0.0, 0.0, -1.0]])), 0.0)


def test_signs_stay_along_the_frames() -> None:
    smooth = Rotation.from_rotvec(np.linspace(0.0, 9.0, 60)[:, None] * [0.0, 0.6, 0.8]).as_quat()
    flipped = smooth * RNG.choice([-1.0, 1.0], size=(60, 1))
    found = motion.continuous(flipped)
    assert (np.sum(found[1:] * found[:-1], axis=1) > 0.0).all()
    assert np.allclose(np.abs(np.sum(found * flipped, axis=1)), 1.0)


def test_angular_velocity_of_a_steady_turn() -> None:
    spin = np.array([0.4, -1.2, 2.0])
    turns = Rotation.from_rotvec(np.arange(9)[:, None] / 30.0 * spin) * Rotation.from_rotvec([0.3, 0.2, 0.1])
    assert np.allclose(motion.angular_velocities(turns.as_quat(), 30), spin)
    assert np.allclose(motion.angular_velocities(turns.as_quat()[:1], 30), 0.0)


def test_local_transforms_rebuild_the_world_and_hold_joints_still() -> None:
    recording = synthetic_recording(agent_count=3, frame_count=9, model=joints_model())
    found = motion.read_motion(recording)[0]
    translations, rotations = motion.local_transforms(found)
    for index, parent in enumerate(found.body.parents):
        place, turn = translations[:, :, index], rotations[:, :, index]
        if parent >= 0:
            outer = found.orientations[:, :, parent]
            place = found.positions[:, :, parent] + motion.rotated(outer, place)
            turn = motion.product(outer, turn)
        assert np.allclose(place, found.positions[:, :, index], atol=1e-9)
        assert np.allclose(np.abs(np.sum(turn * found.orientations[:, :, index], axis=-1)), 1.0)
        joint = found.body.links[index].joint
        if joint.kind not in ("free", "slider"):
            assert (translations[:, :, index] == np.asarray(joint.position)).all()
        if joint.kind == "slider":
            assert (rotations[:, :, index] == [0.0, 0.0, 0.0, 1.0]).all()


def test_names_that_prims_can_carry() -> None:
    assert motion.prim_names(["upper leg", "upper-leg", "2nd", "2nd"]) == ("upper_leg", "upper_leg_2", "_2nd", "_2nd_2")


def test_held_values_are_sampled_where_they_change() -> None:
    assert time_samples.changes(np.array([4, 4, 5, 5, 5, 4])).tolist() == [0, 2, 5]
    assert time_samples.changes(np.array([[1, 2], [1, 2], [1, 3]])).tolist() == [0, 2]
    assert time_samples.changes(np.array([7])).tolist() == [0]


def test_interpolated_values_lose_nothing() -> None:
    assert time_samples.bends(np.array([1.0, 1.0, 1.0, 2.0, 3.0, 3.0, 3.0])).tolist() == [0, 2, 3, 4]
    assert time_samples.bends(np.array([2.0, 2.0, 2.0])).tolist() == [0]
    for _ in range(20):
        values = RNG.integers(0, 2, size=25).astype(float)
        frames = time_samples.bends(values)
        assert np.array_equal(np.interp(np.arange(25), frames, values[frames]), values)


@pytest.mark.parametrize("shape", ["box", "cylinder", "capsule", "ellipsoid"])
def test_welding_shares_points_and_keeps_every_corner(shape: str) -> None:
    mesh = shapes.visual_mesh(Visual(shape, (0.2, 0.3, 0.4)))  # pyright: ignore[reportArgumentType]
    surface = meshes.welded([mesh, mesh])
    assert len(np.unique(mesh.points, axis=0)) * 2 == len(surface.points)
    corners = np.tile(mesh.face_vertex_indices, 2)
    assert np.array_equal(surface.points[surface.face_vertex_indices], mesh.points[corners])
    assert np.array_equal(surface.normals[surface.normal_indices], mesh.normals[corners])
    assert len(np.unique(surface.normals, axis=0)) == len(surface.normals)


def test_camera_keeps_everybody_in_the_picture_and_moves_smoothly() -> None:
    frames, rate = 240, 30
    time = np.arange(frames)[:, None] / rate
    herd = np.zeros((frames, 12, 3))
    start = RNG.uniform(-6.0, 6.0, size=(12, 2))
    herd[..., 0] = start[:, 0] + 2.0 * time * np.sin(0.7 * time + start[:, 0])
    herd[..., 1] = start[:, 1] + np.cos(time + start[:, 1])
    herd[..., 2] = 0.8 + 0.4 * np.abs(np.sin(5.0 * time + start[:, 0]))
    dog = np.zeros((frames, 1, 3))
    dog[:, 0, 0] = np.linspace(60.0, 4.0, frames)
    move = camera.framed(herd, dog, rate)
    axes = Rotation.from_quat(move.orientations[0]).as_matrix().T
    assert move.orientations.shape == (1, 4)
    seen = np.concatenate(
        [herd, np.where(np.abs(dog[:, :, :1] - herd.mean(axis=1)[:, None, :1]) < 12.0, dog, herd[:, :1])], 1
    )
    across = (seen - move.positions[:, None]) @ axes.T
    depth = -across[..., 2]
    assert depth.min() > 0.0
    for axis, aperture in enumerate(camera.APERTURE):
        assert (np.abs(across[..., axis]) / depth).max() < 0.5 * aperture / camera.FOCAL_LENGTH
    acceleration = np.diff(move.positions, 2, axis=0) * rate**2
    assert np.linalg.norm(acceleration, axis=1).max() < 15.0
    assert (move.positions[:, 2] > 0.5).all()


def test_camera_of_one_still_agent() -> None:
    move = camera.framed(np.full((1, 1, 3), 0.5), np.zeros((1, 0, 3)), 30)
    assert np.isfinite(move.positions).all()
    assert 3.0 < np.linalg.norm(move.positions[0] - 0.5) < 20.0
