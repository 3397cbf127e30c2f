"""Meshes: closed, wound outward, with normals that belong to the shape."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.export import shapes
from echelon.warp_kernels.model import Visual

TURNED = (0.1, 0.2, 0.3, np.sqrt(1.0 - 0.14))


def signed_volume(mesh: shapes.Mesh) -> float:
    """Volume inside the mesh by the divergence theorem [m^3]; positive when faces wind outward."""
    a, b, c = (mesh.points[mesh.triangles[:, k]].astype(float) for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def open_edge_count(mesh: shapes.Mesh) -> int:
    """Edges without an opposite twin, points at the same place taken as one."""
    _, same = np.unique(np.round(mesh.points, 6), axis=0, return_inverse=True)
    same = same.reshape(-1)
    edges: dict[tuple[int, int], int] = {}
    for triangle in same[mesh.triangles]:
        for first, second in zip(triangle, np.roll(triangle, -1), strict=True):
            edges[(first, second)] = edges.get((first, second), 0) + 1
    return sum(1 for (first, second), count in edges.items() if edges.get((second, first), 0) != count)


SHAPES = [
    (Visual("ellipsoid", (0.4, 0.3, 0.2)), 4.0 / 3.0 * np.pi * 0.4 * 0.3 * 0.2, 196),
    (Visual("capsule", (0.1, 0.3, 0.0)), np.pi * 0.01 * 0.6 + 4.0 / 3.0 * np.pi * 0.001, 120),
    (Visual("cylinder", (0.1, 0.3, 0.0)), np.pi * 0.01 * 0.6, 60),
    (Visual("box", (0.1, 0.2, 0.3)), 0.048, 12),
    (Visual("torus", (0.3, 0.05, 0.0)), 2.0 * np.pi**2 * 0.3 * 0.05**2, 384),
]


@pytest.mark.parametrize(("visual", "volume", "triangle_count"), SHAPES, ids=[entry[0].shape for entry in SHAPES])
def test_shape_is_closed_outward_and_nearly_its_volume(visual: Visual, volume: float, triangle_count: int) -> None:
    mesh = shapes.visual_mesh(visual)
    assert len(mesh.triangles) == triangle_count
    assert open_edge_count(mesh) == 0
    assert 0.8 * volume < signed_volume(mesh) <= volume * (1.0 + 1e-6)
    assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-6)
    a, b, c = (mesh.points[mesh.triangles[:, k]].astype(float) for k in range(3))
    face_normals = np.cross(b - a, c - a)
    face_normals /= np.linalg.norm(face_normals, axis=1, keepdims=True)
    for k in range(3):
        # A facet of the coarsest shape here is seen at up to a quarter turn over three bands from its corner's normal.
        assert np.einsum("ij,ij->i", face_normals, mesh.normals[mesh.triangles[:, k]]).min() > 0.8


def test_ellipsoid_normals_are_the_gradient() -> None:
    mesh = shapes.visual_mesh(Visual("ellipsoid", (0.5, 0.2, 0.1)))
    gradient = mesh.points / np.array([0.25, 0.04, 0.01])
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    assert np.allclose(gradient, mesh.normals, atol=1e-5)
    assert np.allclose(mesh.extent[1, 2], 0.1)


def test_visual_is_placed_in_its_links_frame() -> None:
    plain = shapes.visual_mesh(Visual("box", (0.1, 0.2, 0.3)))
    placed = shapes.visual_mesh(Visual("box", (0.1, 0.2, 0.3), position=(1.0, 2.0, 3.0), orientation=TURNED))
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(TURNED)
    assert np.allclose(placed.points, turn.apply(plain.points) + [1.0, 2.0, 3.0], atol=1e-6)
    assert np.allclose(placed.normals, turn.apply(plain.normals), atol=1e-6)


def test_capsule_between_reaches_both_ends() -> None:
    for start, end in [((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)), ((1.0, 2.0, 3.0), (1.5, 1.0, 3.5))]:
        mesh = shapes.visual_mesh(shapes.capsule_between(start, end, 0.05))
        for point in (start, end):
            assert np.isclose(np.linalg.norm(mesh.points - np.array(point), axis=1).min(), 0.05, atol=1e-5)
    with pytest.raises(ValueError, match="two different points"):
        shapes.capsule_between((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), 0.1)


def test_oval_has_the_stadiums_area_and_extent() -> None:
    mesh = shapes.oval_mesh(45.0, 28.0)
    a, b, c = (mesh.points[mesh.triangles[:, k]].astype(float) for k in range(3))
    areas = 0.5 * np.cross(b - a, c - a)[:, 2]
    assert areas.min() > 0.0
    assert np.isclose(areas.sum(), np.pi * 28.0**2 + 4.0 * 17.0 * 28.0, rtol=2e-3)
    assert np.allclose(mesh.extent, [[-45.0, -28.0, 0.0], [45.0, 28.0, 0.0]], atol=1e-4)
    circle = shapes.oval_outline(10.0, 10.0)
    assert np.allclose(np.linalg.norm(circle, axis=1), 10.0)
    assert np.linalg.norm(circle - np.roll(circle, 1, axis=0), axis=1).min() > 1e-3


def test_plane_and_oval_grounds_grow_by_their_margin() -> None:
    oval = shapes.ground_mesh({"shape": "oval", "half_length": 45.0, "half_width": 28.0}, margin=2.0)
    plane = shapes.ground_mesh({"shape": "plane", "half_size": 30.0}, margin=2.0)
    assert np.allclose(oval.extent[1], [47.0, 30.0, 0.0], atol=1e-4)
    assert np.allclose(plane.extent[1], [32.0, 32.0, 0.0])
    with pytest.raises(ValueError, match="half_size"):
        shapes.ground_mesh({"shape": "plane"})


@pytest.mark.parametrize("closed", [True, False])
def test_fence_stands_on_its_line(closed: bool) -> None:
    corners = [[0.0, 0.0], [10.0, 0.0], [10.0, 6.0], [0.0, 6.0]]
    mesh = shapes.fence_mesh(corners, closed, 1.2)
    assert signed_volume(mesh) > 0.0
    assert np.isclose(mesh.extent[0, 2], 0.0)
    assert np.isclose(mesh.extent[1, 2], 1.2)
    on_the_open_side = (mesh.points[:, 0] < 0.1) & (np.abs(mesh.points[:, 1] - 3.0) < 1.9)
    assert on_the_open_side.any() == closed
    for corner in corners:
        assert np.linalg.norm(mesh.points[:, :2] - corner, axis=1).min() < 0.1


def test_fence_does_not_care_where_a_straight_is_divided() -> None:
    plain = [[0.0, 0.0], [10.0, 0.0], [10.0, 6.0], [0.0, 6.0]]
    divided = [[0.0, 0.0], [4.0, 0.0], [10.0, 0.0], [10.0, 0.0], [10.0, 6.0], [0.0, 6.0], [0.0, 2.0], [0.0, 0.0]]
    assert np.allclose(shapes.fence_mesh(plain, True, 1.2).points, shapes.fence_mesh(divided, True, 1.2).points)


def test_wall_is_solid_to_its_top() -> None:
    mesh = shapes.wall_mesh([[0.0, 0.0], [4.0, 3.0]], False, 1.5)
    assert np.isclose(signed_volume(mesh), 5.0 * 1.5 * 2.0 * shapes.RAIL_HALF_DEPTH, rtol=1e-5)
    assert np.allclose(mesh.extent[:, 2], [0.0, 1.5])


def test_fence_without_length_says_so() -> None:
    with pytest.raises(ValueError, match="two different points"):
        shapes.fence_mesh([[1.0, 1.0], [1.0, 1.0]], False, 1.0)


def test_bicycle_stands_on_the_ground_and_faces_forward() -> None:
    mesh = shapes.joined([shapes.visual_mesh(visual) for visual in shapes.bicycle_visuals()])
    assert np.isclose(mesh.extent[0, 2], 0.0, atol=1e-3)
    assert 1.6 < mesh.extent[1, 2] < 2.0
    assert np.isclose(mesh.extent[0, 1], -mesh.extent[1, 1], atol=1e-3)
    assert mesh.extent[1, 0] > 0.8
    assert all(visual.color is not None for visual in shapes.bicycle_visuals())


def test_joining_keeps_faces_apart() -> None:
    box = shapes.visual_mesh(Visual("box", (0.1, 0.1, 0.1)))
    both = shapes.joined([box, box])
    assert len(both.triangles) == 24
    assert both.face_vertex_indices.max() == 47
    with pytest.raises(ValueError, match="at least one"):
        shapes.joined([])
