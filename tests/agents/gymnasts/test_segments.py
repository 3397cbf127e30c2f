"""The segments' polyhedra: they weigh what the thesis says, and are what is drawn."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from echelon.agents.gymnasts.body import gymnast_body, segments_of
from echelon.agents.gymnasts.joints import Sex
from echelon.agents.gymnasts.segments import DENSITIES
from echelon.agents.polyhedron import Polyhedron
from echelon.export.shapes import joined, visual_mesh

SEXES: tuple[Sex, ...] = get_args(Sex)
CASES = [(sex, symmetric) for sex in SEXES for symmetric in (True, False)]
MIRROR = np.array([1.0, -1.0, 1.0])


@pytest.mark.parametrize(("sex", "symmetric"), CASES)
def test_every_segment_weighs_and_turns_as_the_thesis_says(sex: Sex, symmetric: bool):
    segments = segments_of(sex, symmetric)
    for link in gymnast_body(sex, symmetric=symmetric).links:
        found = segments[link.name].mass_properties
        assert found.mass == pytest.approx(link.mass, rel=0.05), link.name
        # The thesis gives moments and no products; what a shape across the axes has of these is its own.
        np.testing.assert_allclose(np.diag(found.inertia), np.diag(link.inertia), rtol=0.05, err_msg=link.name)
        np.testing.assert_allclose(found.center, link.com, atol=0.003, err_msg=link.name)


def test_densities_are_cadavers():
    assert {segment.density for segment in segments_of("male").values()} <= set(DENSITIES.values())
    assert min(DENSITIES.values()) > 1_000.0
    assert max(DENSITIES.values()) == DENSITIES["head"] == 1_171.0


@pytest.mark.parametrize("sex", SEXES)
def test_what_is_drawn_is_the_polyhedron(sex: Sex):
    segments = segments_of(sex)
    for link in gymnast_body(sex).links:
        patches = [visual for visual in link.visuals if visual.shape == "mesh"]
        solid = segments[link.name].solid
        assert sum(len(patch.triangles) for patch in patches) == len(solid.triangles)
        corners, triangles = [], []
        for patch in patches:
            triangles.append(np.array(patch.triangles) + sum(map(len, corners)))
            corners.append(np.array(patch.points))
        points, same = np.unique(np.concatenate(corners), axis=0, return_inverse=True)
        sewn = Polyhedron(points, same.reshape(-1)[np.concatenate(triangles)], link.name)
        found, expected = sewn.mass_properties(1.0), solid.mass_properties(1.0)
        assert found.mass == pytest.approx(expected.mass, rel=1e-12)
        np.testing.assert_allclose(found.inertia, expected.inertia, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("sex", SEXES)
def test_segments_are_round_enough_and_not_wasteful(sex: Sex):
    for name, segment in segments_of(sex).items():
        assert 100 <= len(segment.solid.triangles) <= 320, name


@pytest.mark.parametrize("sex", SEXES)
def test_left_and_right_are_mirror_images(sex: Sex):
    segments = segments_of(sex)
    for name, segment in segments.items():
        if name.startswith("left_"):
            other = segments["right_" + name.removeprefix("left_")]
            np.testing.assert_array_equal(other.solid.points, MIRROR * segment.solid.points)


@pytest.mark.parametrize(("sex", "height"), [("male", 1.84), ("female", 1.60)])
def test_a_person_is_as_tall_as_said_and_stands_on_the_floor(sex: Sex, height: float):
    body = gymnast_body(sex)
    origins = body.link_poses(body.q_reference)[:, :3]
    points = np.concatenate(
        [
            joined([visual_mesh(visual) for visual in link.visuals]).points + origin
            for link, origin in zip(body.links, origins, strict=True)
        ]
    )
    assert points[:, 2].max() == pytest.approx(height, abs=0.04)
    assert points[:, 2].min() == pytest.approx(0.0, abs=0.012)


def test_shapes_grow_with_the_body():
    usual, small = gymnast_body("female"), gymnast_body("female", height=1.44)
    for one, other in zip(usual.links, small.links, strict=True):
        for visual, smaller in zip(one.visuals, other.visuals, strict=True):
            np.testing.assert_allclose(
                visual_mesh(smaller).extent, 0.9 * visual_mesh(visual).extent, rtol=1e-5, atol=1e-6
            )
