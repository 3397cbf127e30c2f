"""The quadtree: it agrees with the surface everywhere, has no steps, and knows ground wherever it is asked."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false, reportFunctionMemberAccess=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import warp as wp

from echelon.terrain.nurbs import NurbsSurface
from echelon.terrain.quadtree import LEAF_TRIANGLES, GroundTree, Quadtree, ground_plane
from echelon.terrain.triangulation import TriangleMesh, smooth_height, triangulate

TOLERANCE = 0.002  # [m]
FAR = np.array([40_000.0, -25_000.0, 1200.0])  # [m], of the map from the world's origin


@wp.kernel
def look_down(ground: GroundTree, points: wp.array[wp.vec3d], planes_out: wp.array[wp.vec4d]):
    i = wp.tid()
    planes_out[i] = ground_plane(ground, points[i])


def planes(tree: Quadtree, xy: np.ndarray) -> np.ndarray:
    """Planes (n, d) below places on the map, shape [n, 4]."""
    points = wp.array(np.c_[xy, np.zeros(len(xy))], dtype=wp.vec3d, device="cpu")
    found = wp.zeros(len(xy), dtype=wp.vec4d, device="cpu")
    wp.launch(look_down, len(xy), [tree.data("cpu"), points], [found], device="cpu")
    return found.numpy()


def heights(tree: Quadtree, xy: np.ndarray) -> np.ndarray:
    """Heights of the ground [m], shape [n]."""
    plane = planes(tree, xy)
    return (plane[:, 3] - np.sum(plane[:, :2] * xy, axis=1)) / plane[:, 2]


def hills(low: float, high: float, spacing: float, lift: float = 0.0) -> NurbsSurface:
    """A square of hilly land."""
    t = np.linspace(low, high, round((high - low) / spacing) + 1)
    x, y = np.meshgrid(t, t, indexing="ij")
    z = 4.0 * np.sin(x / 19.0) * np.cos(y / 23.0) + 0.02 * x + lift
    return NurbsSurface.through(np.stack([x + FAR[0], y + FAR[1], z + FAR[2]], axis=-1), t, t)


@pytest.fixture(scope="module")
def land() -> NurbsSurface:
    return hills(0.0, 400.0, 8.0)


@pytest.fixture(scope="module")
def mesh(land: NurbsSurface) -> TriangleMesh:
    return triangulate(land, TOLERANCE, smooth=True)


@pytest.fixture(scope="module")
def tree(mesh: TriangleMesh) -> Quadtree:
    return Quadtree.over([mesh])


def test_it_agrees_with_the_surface_everywhere(land: NurbsSurface, tree: Quadtree):
    t = np.random.default_rng(1).uniform(0.0, 400.0, (20_000, 2))
    t[:2000] = np.round(t[:2000] / 8.0) * 8.0  # on knots, where triangles meet
    t[2000:4000, 0] = np.round(t[2000:4000, 0] / 8.0) * 8.0
    found = planes(tree, t + FAR[:2])
    np.testing.assert_allclose(heights(tree, t + FAR[:2]), land.point(t[:, 0], t[:, 1])[:, 2], atol=TOLERANCE)
    np.testing.assert_allclose(found[:, :3], land.normal(t[:, 0], t[:, 1]), atol=0.005)
    np.testing.assert_allclose(np.linalg.norm(found[:, :3], axis=1), 1.0, atol=1e-14)


def test_kernel_and_host_interpolate_alike(mesh: TriangleMesh, tree: Quadtree):
    random = np.random.default_rng(2)
    assert mesh.bulges is not None
    triangle = random.integers(0, len(mesh.triangles), 3000)
    corners = mesh.triangles[triangle]
    weights = random.dirichlet((1.0, 1.0, 1.0), 3000)
    xy = np.einsum("nk,nkx->nx", weights, mesh.points[corners])[:, :2]
    z, slope = smooth_height(mesh.points[corners], mesh.gradients[corners], weights, mesh.bulges[triangle])
    np.testing.assert_allclose(heights(tree, xy), z, atol=2e-5)  # heights of corners are rounded to float32
    found = planes(tree, xy)
    np.testing.assert_allclose(-found[:, :2] / found[:, 2:3], slope, atol=1e-5)


def test_no_steps_and_no_kinks(tree: Quadtree):
    """Along a line over hundreds of facets: heights and normals change only as fast as the ground is steep and bent."""
    s = np.arange(0.0, 350.0, 0.001)
    xy = FAR[:2] + [20.0, 31.0] + s[:, None] * [0.8, 0.6]
    z = heights(tree, xy)
    slope = -np.sum(planes(tree, xy)[:, :2] * [0.8, 0.6], axis=1) / planes(tree, xy)[:, 2]
    climb = np.diff(z)
    assert np.abs(np.diff(slope)).max() < 5e-5  # the ground bends by 0.03 a metre, 3e-5 a millimetre
    # What it climbs in a millimetre is what the slope says, to a few microns.
    assert np.abs(climb - 0.001 * 0.5 * (slope[1:] + slope[:-1])).max() < 4e-6


def test_a_micron_is_felt_far_from_the_origin(tree: Quadtree):
    xy = FAR[:2] + [123.456, 98.765] + np.outer(np.arange(200), [1e-6, 0.0])
    gradient = -planes(tree, xy)[0, 0] / planes(tree, xy)[0, 2]
    rise = heights(tree, xy) - heights(tree, xy)[0]
    np.testing.assert_allclose(rise, gradient * (xy[:, 0] - xy[0, 0]), atol=2e-6)
    assert abs(gradient) > 0.05


def test_beyond_the_map_it_is_level(land: NurbsSurface, tree: Quadtree):
    inside = np.array([[0.0, 150.0], [400.0, 33.0], [77.0, 400.0], [0.0, 0.0]])
    outside = inside + [[-50.0, 0.0], [1e6, 0.0], [0.0, 3.0], [-4.0, -9.0]]
    expected = land.point(inside[:, 0], inside[:, 1])[:, 2]
    # Places are float32 relative to the middle of the map.
    np.testing.assert_allclose(heights(tree, outside + FAR[:2]), expected, atol=TOLERANCE)
    normals = planes(tree, outside + FAR[:2])[:, :3]
    np.testing.assert_allclose(normals[[0, 1], 0], 0.0)
    np.testing.assert_allclose(normals[2, 1], 0.0)
    np.testing.assert_allclose(normals[3], [0.0, 0.0, 1.0])


def test_holes_get_the_nearest_ground():
    def square(x: float, z: float) -> TriangleMesh:
        points = np.array([[x, 0.0, z], [x + 10.0, 0.0, z], [x + 10.0, 10.0, z], [x, 10.0, z]])
        up, uv = np.tile([0.0, 0.0, 1.0], (4, 1)), points[:, :2]
        return TriangleMesh("square", points, up, uv, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))

    tree = Quadtree.over([square(0.0, 1.0), square(190.0, 2.0)])
    xy = np.array([[5.0, 5.0], [40.0, 5.0], [195.0, 5.0], [150.0, 2.0], [np.nan, 5.0], [np.inf, 0.0]])
    found = planes(tree, xy[:4])
    np.testing.assert_allclose(found, [[0, 0, 1, 1], [0, 0, 1, 1], [0, 0, 1, 2], [0, 0, 1, 2]], atol=1e-12)
    assert planes(tree, xy[4:]).shape == (2, 4)  # no ground, but no crash either


def test_what_comes_first_has_the_right_of_way(mesh: TriangleMesh):
    top = triangulate(hills(100.0, 200.0, 8.0, lift=5.0), TOLERANCE, smooth=True)
    xy = FAR[:2] + np.array([[150.0, 120.0], [100.5, 199.5], [99.0, 150.0], [201.0, 201.0]])
    below = heights(Quadtree.over([mesh]), xy)
    np.testing.assert_allclose(heights(Quadtree.over([top, mesh]), xy) - below, [5.0, 5.0, 0.0, 0.0], atol=0.02)
    np.testing.assert_allclose(heights(Quadtree.over([mesh, top]), xy), below, atol=1e-6)


def test_no_edge_lets_a_point_through_to_what_lies_below(mesh: TriangleMesh):
    """On the edge of two triangles a point may be rounded out of both."""
    top = triangulate(hills(100.3, 199.1, 7.057, lift=5.0), TOLERANCE, smooth=True)
    random = np.random.default_rng(4)
    triangle = top.triangles[random.integers(0, len(top.triangles), 20_000)]
    part = random.uniform(0.0, 1.0, (20_000, 1))
    places = (part * top.points[triangle[:, 0]] + (1.0 - part) * top.points[triangle[:, 2]])[:, :2]
    inner = (np.abs(places - FAR[:2] - 150.0) < 48.0).all(axis=1)
    lifted = heights(Quadtree.over([top, mesh]), places[inner]) - heights(Quadtree.over([mesh]), places[inner])
    assert lifted.min() > 4.9


def test_every_triangle_is_listed_where_it_lies(tree: Quadtree, mesh: TriangleMesh):
    heads = -1 - np.concatenate([tree.roots, tree.nodes])
    heads = heads[heads >= 0]
    lists = [tree.lists[head + 1 : head + 1 + tree.lists[head]] for head in heads.tolist()]
    assert sum(len(members) + 1 for members in lists) == len(tree.lists)
    assert min(len(members) for members in lists) >= 1
    assert max(len(members) for members in lists) <= LEAF_TRIANGLES
    assert set(np.concatenate(lists).tolist()) == set(range(len(mesh.triangles)))
    for members in lists:  # what was given first comes first
        assert (np.diff(tree.given[members]) > 0).all()


def test_no_triangles_is_an_error():
    empty = TriangleMesh("none", np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 3), np.int32))
    with pytest.raises(ValueError, match="triangle"):
        Quadtree.over([empty])


@wp.kernel(module="unique", enable_backward=False)
def look_down_on_cuda(ground: GroundTree, points: wp.array[wp.vec3d], planes_out: wp.array[wp.vec4d]):
    i = wp.tid()
    planes_out[i] = ground_plane(ground, points[i])


@wp.kernel(module="unique", enable_backward=False)
def nothing_much(values: wp.array[wp.float32]):
    values[wp.tid()] = 1.0


def test_it_compiles_for_cuda(tmp_path: Path):
    """To PTX by NVRTC, which needs no GPU."""
    try:
        wp.compile_aot_module(nothing_much.module, arch=80, module_dir=tmp_path / "probe", use_ptx=True)
    except Exception as error:
        pytest.skip(f"this Warp has no NVRTC to compile CUDA with: {' '.join(str(error).split())}")
    if not list((tmp_path / "probe").glob("*.ptx")):
        pytest.skip("this Warp has no NVRTC to compile CUDA with: no PTX came of the simplest kernel")
    wp.compile_aot_module(look_down_on_cuda.module, arch=80, module_dir=tmp_path, use_ptx=True)
    (ptx,) = tmp_path.glob("*.ptx")
    assert ".visible .entry" in ptx.read_text()
