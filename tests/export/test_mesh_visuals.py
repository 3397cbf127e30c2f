"""Meshes of a body's own: as data, checked, drawn smooth, and on a stage."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from echelon.export.shapes import visual_mesh
from echelon.export.stage.meshes import surfaces_by_color, welded
from echelon.warp_kernels.model import Joint, Link, Model, ModelError, Visual

CUBE = Visual(
    "mesh",
    (1.0, 1.0, 1.0),
    color=(0.5, 0.2, 0.1),
    points=tuple((x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)),
    triangles=(
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ),
)  # fmt: skip


def ball(rings: int = 8, around: int = 14) -> Visual:
    """A unit ball of triangles."""
    polar = np.pi * np.arange(1, rings) / rings
    angle = 2.0 * np.pi * np.arange(around) / around
    points = [(0.0, 0.0, 1.0)]
    points += [(np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)) for p in polar for a in angle]
    points.append((0.0, 0.0, -1.0))
    last, triangles = len(points) - 1, []
    for k in range(around):
        after = (k + 1) % around
        triangles.append((0, 1 + k, 1 + after))
        triangles.append((last, last - around + after, last - around + k))
        for ring in range(rings - 2):
            low = 1 + ring * around
            triangles.append((low + k, low + around + k, low + around + after))
            triangles.append((low + k, low + around + after, low + after))
    return Visual("mesh", (1.0, 1.0, 1.0), points=tuple(points), triangles=tuple(triangles))


def model(visual: Visual) -> Model:
    return Model("thing", (Link("thing", None, Joint("root", "free"), 1.0, visuals=(visual,)),))


def test_a_ball_is_smooth():
    mesh = visual_mesh(ball())
    assert len(mesh.points) == len(ball().points)
    np.testing.assert_allclose(mesh.normals, mesh.points, atol=0.06)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-6)


def test_a_cube_keeps_its_edges():
    mesh = visual_mesh(CUBE)
    assert len(mesh.points) == 24
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    faces = np.cross(b - a, c - a)
    for k in range(3):
        np.testing.assert_allclose(mesh.normals[mesh.triangles[:, k]], faces, atol=1e-6)


def test_it_is_placed_and_sized():
    moved = replace(CUBE, size=(2.0, 3.0, 4.0), position=(1.0, 0.0, 0.0), orientation=(0.0, 0.0, 1.0, 0.0))
    np.testing.assert_allclose(visual_mesh(moved).extent, [[-1.0, -3.0, 0.0], [1.0, 0.0, 4.0]], atol=1e-6)


def test_a_stage_gets_shared_points_and_the_colour():
    ((color, meshes),) = surfaces_by_color([CUBE]).items()
    assert color == CUBE.color
    surface = welded(meshes)
    assert len(surface.points) == 8
    assert len(surface.normals) == 6


def test_meshes_survive_plain_data_and_others_do_not_carry_empty_lists():
    body = model(CUBE)
    assert Model.from_dict(body.to_dict()) == body
    plain = model(Visual("box", (1.0, 1.0, 1.0))).to_dict()
    assert set(plain["links"][0]["visuals"][0]) == {"shape", "size", "position", "orientation"}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"points": ()}, "visual 0: a mesh needs points and triangles, found 0 points"),
        ({"triangles": ()}, "visual 0: a mesh needs points and triangles"),
        ({"triangles": ((0, 1, 8),)}, "visual 0: triangles name point 8, there are 8"),
        ({"points": ((np.nan, 0.0, 0.0),) * 8}, "visual 0: points hold a number that is not finite"),
        ({"points": ((0.0, 0.0),) * 8}, "points are lists of 3 numbers"),
        ({"shape": "box"}, "only a mesh has points and triangles, shape is 'box'"),
    ],
)
def test_what_is_no_mesh_is_one_line(values: dict[str, Any], message: str):
    with pytest.raises(ModelError, match=message) as caught:
        model(replace(CUBE, **values))
    assert len(str(caught.value).splitlines()) == 1


def test_a_corner_that_is_no_whole_number_is_refused():
    data = model(CUBE).to_dict()
    data["links"][0]["visuals"][0]["triangles"][0] = [0, 1, 2.5]
    with pytest.raises(ModelError, match="triangles name points by whole numbers"):
        Model.from_dict(data)
