"""The gymnasts: the thesis's numbers, symmetry, size, backpack, soles, the standing pose, the tables of the joints."""

from __future__ import annotations

import math
from typing import Any, get_args

import numpy as np
import pytest

from echelon.agents.bodies import load_body
from echelon.agents.gymnasts.body import (
    BACKPACK,
    BACKPACK_PLACE,
    FALL_SITES,
    FOOT_SITES,
    HAND_SITES,
    HEIGHTS,
    TOE_SITES,
    gymnast_body,
    leg_geometry,
)
from echelon.agents.gymnasts.joints import (
    AXIS_SIGN,
    LINKS,
    MOTIONS,
    SIDES,
    Axis,
    Sex,
    axes_of,
    joint_limits,
    joint_strength,
    position_index,
    speed_index,
    split_side,
)
from echelon.agents.gymnasts.standing import site_points, sole_middle, standing_q
from echelon.errors import InputError
from echelon.warp_kernels.reference import Body

SEXES: tuple[Sex, ...] = get_args(Sex)
MIRROR = np.array([1.0, -1.0, 1.0])


def body_inertia(body: Body, q: np.ndarray) -> np.ndarray:
    """Of the whole body about its centre of mass, world axes: the angular momentum of turning as one."""
    result = np.empty((3, 3))
    for i in range(3):
        u = np.zeros(body.u_count)
        u[3 + i] = 1.0  # the root's axes are the world's in these poses
        result[:, i] = body.momentum(q, u)[3:]
    return result


# ---- mass ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("sex", SEXES)
@pytest.mark.parametrize("symmetric", [True, False])
def test_it_weighs_what_the_thesis_says(sex: Sex, symmetric: bool):
    body, thesis = gymnast_body(sex, symmetric=symmetric), load_body(sex)
    assert isinstance(body, Body)
    assert body.u_count == 53
    assert body.mass == pytest.approx(thesis.mass, rel=1e-12)
    assert body.link_names == tuple(LINKS[name] for name in thesis.link_names)
    np.testing.assert_allclose(
        body.center_of_mass(body.q_reference), thesis.center_of_mass(thesis.q_reference), rtol=0, atol=1.2e-3
    )
    np.testing.assert_allclose(
        body_inertia(body, body.q_reference), body_inertia(thesis, thesis.q_reference), rtol=0.02, atol=0.05
    )


@pytest.mark.parametrize("sex", SEXES)
def test_an_asymmetric_gymnast_is_the_published_body(sex: Sex):
    body, thesis = gymnast_body(sex, symmetric=False), load_body(sex)
    for ours, published in zip(body.links, thesis.links, strict=True):
        assert (ours.mass, ours.com, ours.inertia) == (published.mass, published.com, published.inertia)
        assert ours.joint.position == published.joint.position


@pytest.mark.parametrize("sex", SEXES)
@pytest.mark.parametrize("more", [{}, {"height": 1.7, "mass": 65.0}, {"backpack": 4.0}])
def test_a_symmetric_gymnast_mirrors_itself_exactly(sex: Sex, more: dict[str, Any]):
    body = gymnast_body(sex, **more)
    named = {link.name: link for link in body.links}
    for link in body.links:
        side, name = split_side(link.name)
        other = named[f"right_{name}"] if side == "left" else link
        if side == "right":
            continue
        assert other.mass == link.mass
        np.testing.assert_array_equal(other.com, MIRROR * link.com)
        np.testing.assert_array_equal(other.joint.position, MIRROR * link.joint.position)
        np.testing.assert_array_equal(other.inertia, np.outer(MIRROR, MIRROR) * link.inertia)
    places = {site.name: site for site in body.contacts}
    for name, site in places.items():
        side, rest = split_side(name)
        if side == "left":
            np.testing.assert_allclose(places[f"right_{rest}"].position, MIRROR * site.position, rtol=0, atol=1e-15)
            np.testing.assert_allclose(places[f"right_{rest}"].radii, site.radii)


def test_size_scales_lengths_masses_and_moments():
    usual, small = gymnast_body("male"), gymnast_body("male", height=1.61, mass=65.0)
    length, mass = 1.61 / HEIGHTS["male"], 65.0 / usual.mass
    assert small.mass == pytest.approx(65.0, rel=1e-12)
    q, other = usual.q_reference, small.q_reference
    np.testing.assert_allclose(small.link_poses(other)[:, :3], length * usual.link_poses(q)[:, :3], atol=1e-12)
    np.testing.assert_allclose(small.center_of_mass(other), length * usual.center_of_mass(q), atol=1e-12)
    np.testing.assert_allclose(body_inertia(small, other), mass * length**2 * body_inertia(usual, q), atol=1e-9)
    # It stands, its soles sink in as far, and they damp it as well.
    for one, two in zip(small.contacts, usual.contacts, strict=True):
        np.testing.assert_allclose(one.position, length * np.array(two.position), atol=1e-12)
        np.testing.assert_allclose(one.radii, length * np.array(two.radii), atol=1e-12)
        assert one.stiffness / small.mass == pytest.approx(two.stiffness / usual.mass)
        assert one.damping / small.mass == pytest.approx(two.damping / usual.mass)


def test_a_backpack_is_a_box_on_the_back():
    bare, laden = gymnast_body("female"), gymnast_body("female", backpack=4.0)
    q = bare.q_reference
    assert laden.mass == pytest.approx(bare.mass + 4.0)
    # Where the added mass is follows from both centres of mass.
    place = (laden.mass * laden.center_of_mass(q) - bare.mass * bare.center_of_mass(q)) / 4.0
    chest = bare.link_poses(q)[bare.link_index(BACKPACK_PLACE), :3] + bare.links[bare.link_index(BACKPACK_PLACE)].com
    assert place[0] < chest[0] - BACKPACK[0] - 0.05
    np.testing.assert_allclose(place[1:], chest[1:], atol=1e-9)
    # Both inertias about the common centre: the body's and the box's.
    center = laden.center_of_mass(q)
    total = body_inertia(bare, q) + np.diag(
        [4.0 / 3.0 * (BACKPACK[(i + 1) % 3] ** 2 + BACKPACK[(i + 2) % 3] ** 2) for i in range(3)]
    )
    for mass, at in ((bare.mass, bare.center_of_mass(q)), (4.0, place)):
        r = at - center
        total += mass * (r @ r * np.eye(3) - np.outer(r, r))
    np.testing.assert_allclose(body_inertia(laden, q), total, atol=1e-9)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"sex": "robot"}, "gymnast: sex is 'robot', must be male or female"),
        ({"height": 0.6}, "gymnast: height is 0.6 m, must lie between 0.92 and 2.76 m"),
        ({"height": math.nan}, "gymnast: height is nan m"),
        ({"mass": 5.0}, "gymnast: mass is 5.0 kg, must lie between 12.2 and 330 kg"),
        ({"backpack": -1.0}, "gymnast: backpack is -1.0 kg, must lie between 0 and 40 kg"),
        ({"shoulders": "welded"}, "gymnast: shoulders is 'welded', must be ball or gimbal"),
    ],
)
def test_bad_sizes_are_one_line(values: dict[str, Any], message: str):
    with pytest.raises(InputError, match=message) as caught:
        gymnast_body(**{"sex": "male", **values})
    assert len(str(caught.value).splitlines()) == 1


# ---- contact ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("sex", SEXES)
def test_the_sites_are_those_of_the_tables(sex: Sex):
    body = gymnast_body(sex)
    listed = [name for sites in (FOOT_SITES, TOE_SITES, HAND_SITES) for side in SIDES for name in sites[side]]
    assert [site.name for site in body.contacts] == [*listed, *FALL_SITES]
    for side in SIDES:
        links = {site.name: site.link for site in body.contacts}
        assert {links[name] for name in FOOT_SITES[side]} == {f"{side}_foot"}
        assert {links[name] for name in TOE_SITES[side]} == {f"{side}_toes"}
        assert {links[name] for name in HAND_SITES[side]} == {f"{side}_hand"}


def test_the_mans_foot_has_the_measured_outline():
    body = gymnast_body("male")
    points = site_points(body, body.q_reference)
    foot = np.mean([points[f"left_heel_{edge}"] for edge in ("inner", "outer")], axis=0)
    for place, x, width in (("heel", -0.089, 0.030), ("ball", 0.049, 0.040), ("tip", 0.150, 0.025)):
        inner, outer = points[f"left_{place}_inner"], points[f"left_{place}_outer"]
        assert inner[0] == pytest.approx(x, abs=6e-4)
        assert outer[1] - inner[1] == pytest.approx(2.0 * width, abs=1e-9)
        assert inner[2] == pytest.approx(0.0, abs=1e-5)
        assert abs(0.5 * (inner[1] + outer[1]) - foot[1]) < 0.01


@pytest.mark.parametrize("sex", SEXES)
def test_soles_lie_where_boxes_of_equal_inertia_end(sex: Sex):
    body = load_body(sex)
    poses = body.link_poses(body.q_reference)
    for name in ("FOOTL", "TOEL"):
        index = body.link_index(name)
        link = body.links[index]
        x, y, z = (link.inertia[i][i] for i in range(3))
        half = math.sqrt(1.5 * (x + y - z) / link.mass)
        assert poses[index, 2] + link.com[2] - half == pytest.approx(0.0, abs=0.004)


@pytest.mark.parametrize("sex", SEXES)
def test_standing_sinks_in_little_and_is_critically_damped(sex: Sex):
    body = gymnast_body(sex)
    soles = [site for site in body.contacts if site.link.endswith(("foot", "toes"))]
    assert len(soles) == 12
    stiffness, damping = sum(site.stiffness for site in soles), sum(site.damping for site in soles)
    assert body.mass * body.gravity / stiffness == pytest.approx(0.00114, abs=0.00004)
    assert damping / (2.0 * math.sqrt(stiffness * body.mass)) == pytest.approx(1.0, abs=0.02)
    assert {site.friction for site in soles} == {0.9}


@pytest.mark.parametrize("sex", SEXES)
def test_palms_face_down_in_the_reference_pose_with_the_thumb_in_front(sex: Sex):
    body = gymnast_body(sex)
    points, poses = site_points(body, body.q_reference), body.link_poses(body.q_reference)
    for side, outwards in (("left", 1.0), ("right", -1.0)):
        hand = body.links[body.link_index(f"{side}_hand")]
        wrist, center = poses[body.link_index(f"{side}_hand"), :3], np.array(hand.com)
        palm_thumb, palm_little, finger_thumb, finger_little = (points[name] - wrist for name in HAND_SITES[side])
        normal = np.cross(finger_little - palm_thumb, finger_thumb - palm_little)
        normal *= math.copysign(1.0, normal[2]) / np.linalg.norm(normal)
        assert normal[2] > 0.8
        assert np.all(np.array([p @ normal for p in (palm_thumb, finger_thumb)]) < center @ normal)
        assert palm_thumb[0] > palm_little[0]
        assert outwards * (finger_thumb - palm_thumb)[1] > 0.08
        assert 0.1 < np.linalg.norm(finger_thumb) < 0.22


@pytest.mark.parametrize("sex", SEXES)
def test_a_body_on_its_back_or_its_front_lies_on_its_sites(sex: Sex):
    body = gymnast_body(sex)
    for turn in (-1.0, 1.0):
        q = body.q_reference
        q[3:7] = (0.0, math.sin(turn * math.pi / 4), 0.0, math.cos(math.pi / 4))
        poses, points = body.link_poses(q), site_points(body, q)
        touching = {name: points[name][2] for name in ("pelvis", "chest", "head")}
        radius = {site.name: site.radii[0] for site in body.contacts}
        ground = min(touching[name] - radius[name] for name in touching)
        centers = poses[:, 2] + [
            float(2.0 * (q[3] * c[2] * 0.0 + turn * -0.5 * c[0])) for c in (link.com for link in body.links)
        ]
        assert np.all(centers > ground)


# ---- the standing pose -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("sex", SEXES)
@pytest.mark.parametrize(
    ("more", "knees", "lean"),
    [
        ({}, 0.0, 0.0),
        ({}, 1.2, 0.02),
        ({"backpack": 4.0}, 0.3, 0.0),
        ({"height": 1.7, "shoulders": "gimbal"}, 0.1, 0.0),
    ],
)
def test_it_stands_on_flat_soles_under_its_weight(sex: Sex, more: dict[str, Any], knees: float, lean: float):
    body = gymnast_body(sex, **more)
    q = standing_q(body, knee_flexion=knees, lean=lean)
    points = site_points(body, q)
    soles = np.array([points[name] for side in SIDES for name in FOOT_SITES[side] + TOE_SITES[side]])
    np.testing.assert_allclose(soles[:, 2], 0.0, atol=1.2e-5)
    center, middle = body.center_of_mass(q), sole_middle(body, q)
    assert center[0] - middle[0] == pytest.approx(lean, abs=1e-6)
    assert center[1] == pytest.approx(middle[1], abs=1e-9)
    assert q[0] == pytest.approx(0.0, abs=1e-12)
    assert q[position_index(body, "left_knee", "y")] == knees
    hands = body.link_poses(q)[body.link_index("left_hand"), 2]
    assert hands < 0.7 * body.link_poses(q)[body.link_index("left_upper_arm"), 2]
    head = body.link_poses(q)[body.link_index("head"), 3:]
    np.testing.assert_allclose(head, (0.0, 0.0, 0.0, 1.0), atol=1e-12)


def test_an_impossible_stand_is_refused():
    with pytest.raises(InputError, match=r"cannot stand with knees at 0\.0 rad and the weight 2\.0 m forward"):
        standing_q(gymnast_body("male"), lean=2.0)


@pytest.mark.parametrize(("sex", "length"), [("male", 0.855), ("female", 0.755)])
def test_the_leg_is_as_long_as_the_thesis_says(sex: Sex, length: float):
    body = gymnast_body(sex)
    leg = leg_geometry(body)
    assert leg.thigh + leg.shank == pytest.approx(length, abs=1.5e-3)
    # The formulas with its angles give where the ankle is.
    q = body.q_reference
    hip, knee = -0.7, 1.1
    q[position_index(body, "left_hip", "y")], q[position_index(body, "left_knee", "y")] = hip, knee
    poses = body.link_poses(q)
    thigh, shank = leg.thigh_lean - hip, leg.shank_lean - hip - knee
    expected = (
        leg.thigh * math.sin(thigh) + leg.shank * math.sin(shank),
        -leg.thigh * math.cos(thigh) - leg.shank * math.cos(shank),
    )
    found = poses[body.link_index("left_foot"), :3] - poses[body.link_index("left_upper_leg"), :3]
    np.testing.assert_allclose(found[[0, 2]], expected, atol=1e-12)


# ---- the joints' tables ----------------------------------------------------------------------------------------------
def test_every_axis_has_its_motion_and_its_index():
    body = gymnast_body("male", shoulders="gimbal")
    seen: set[int] = set()
    for link in body.links[1:]:
        for axis in axes_of(link.joint):
            assert (split_side(link.joint.name)[1], axis) in MOTIONS
            place = speed_index(body, link.joint.name, axis)
            assert body.speed_names[place].startswith(link.joint.name)
            assert body.coordinate_names[position_index(body, link.joint.name, axis)] == body.speed_names[place]
            seen.add(place)
    assert seen == set(range(6, 53))


def moved(joint: str, axis: Axis, angle: float, seen: str) -> np.ndarray:
    """By how much a link's centre of mass moves when a joint turns by a small angle."""
    body = gymnast_body("male", shoulders="gimbal")
    index = body.link_index(seen)

    def place(q: np.ndarray) -> np.ndarray:
        pose = body.link_poses(q)[index]
        x, y, z, w = pose[3:]
        c = np.array(body.links[index].com)
        across = 2.0 * np.cross([x, y, z], c)
        return pose[:3] + c + w * across + np.cross([x, y, z], across)

    q = body.q_reference
    before = place(q)
    q[position_index(body, joint, axis)] += angle
    return place(q) - before


@pytest.mark.parametrize(
    ("joint", "axis", "seen", "along", "sign"),
    [
        # With a positive angle of the left: extension of the hip takes the thigh back, and so on.
        ("hip", "y", "upper_leg", 0, -1.0),
        ("hip", "x", "upper_leg", 1, 1.0),
        ("hip", "z", "toes", 1, 1.0),
        ("knee", "y", "lower_leg", 0, -1.0),
        ("ankle", "y", "toes", 2, -1.0),
        ("toe", "y", "toes", 2, -1.0),
        ("clavicle", "x", "upper_arm", 2, 1.0),
        ("clavicle", "z", "upper_arm", 0, -1.0),
        ("shoulder", "x", "lower_arm", 2, 1.0),
        ("shoulder", "z", "lower_arm", 0, -1.0),
        ("elbow", "z", "lower_arm", 0, -1.0),
        ("wrist", "x", "hand", 2, 1.0),
    ],
)
def test_positive_angles_move_as_documented(joint: str, axis: Axis, seen: str, along: int, sign: float):
    left = moved(f"left_{joint}", axis, 0.1, f"left_{seen}")
    right = moved(f"right_{joint}", axis, 0.1 * AXIS_SIGN[axis], f"right_{seen}")
    assert sign * left[along] > 0.0
    np.testing.assert_allclose(right, MIRROR * left, atol=1e-12)


@pytest.mark.parametrize(
    ("joint", "axis", "along", "sign"),
    [("spine_l3", "y", 0, 1.0), ("spine_t4", "x", 1, -1.0), ("neck", "y", 0, 1.0)],
)
def test_the_trunk_bends_as_documented(joint: str, axis: Axis, along: int, sign: float):
    assert sign * moved(joint, axis, 0.1, "head")[along] > 0.0


def test_limits_and_strengths_mirror_and_scale():
    body = gymnast_body("male")
    limits, strength = joint_limits(body), joint_strength(body, "male", 1.84, body.mass)
    hip = [speed_index(body, f"{side}_hip", "x") for side in SIDES]
    np.testing.assert_allclose(limits[hip[1]], -limits[hip[0]][::-1])
    np.testing.assert_allclose(strength[hip[1]], -strength[hip[0]][::-1])
    assert np.all(limits[:, 0] < limits[:, 1])
    assert np.all(np.isinf(limits[:6]))
    assert np.all(strength[:6] == 0.0)
    assert np.all(strength[6:, 0] < 0.0)
    assert np.all(strength[6:, 1] > 0.0)
    # A man of the reference's size has the table's strength, trained; a woman of that size less.
    hips = speed_index(body, "left_hip", "y")
    usual = joint_strength(body, "male", 1.78, 78.0)[hips]
    np.testing.assert_allclose(usual, np.array([-150.0, 220.0]) * 1.3, rtol=1e-9)
    np.testing.assert_allclose(joint_strength(body, "female", 1.78, 78.0)[hips], 0.9 * usual)
    np.testing.assert_allclose(joint_strength(body, "male", 1.78, 39.0), 0.5 * joint_strength(body, "male", 1.78, 78.0))


@pytest.mark.parametrize("sex", SEXES)
def test_soft_stops_are_the_limits_and_standing_is_within(sex: Sex):
    body = gymnast_body(sex, shoulders="gimbal", limits=True)
    limits, q = joint_limits(body), standing_q(body, knee_flexion=0.4)
    for index, link in enumerate(body.links[1:], 1):
        assert link.joint.limit_stiffness > 0.0
        for place, limit in enumerate(link.joint.limits):
            assert limit is not None
            assert limit == tuple(limits[body.u_start(index) + place])
            assert limit[0] < q[body.q_start(index) + place] < limit[1]
    assert all(not link.joint.limits for link in gymnast_body(sex).links)


@pytest.mark.parametrize(
    ("joint", "axis", "message"),
    [
        ("left_hip", "w", "joint 'left_hip' does not turn about 'w'; axes: y, x, z"),
        ("root", "x", "does not turn about 'x'; axes: none"),
        ("hip", "y", "no joint 'hip'; joints are root"),
        ("left_shoulder", "x", "joint 'left_shoulder' is a ball"),
    ],
)
def test_a_wrong_joint_is_one_line(joint: str, axis: Any, message: str):
    with pytest.raises(InputError, match=message):
        position_index(gymnast_body("male"), joint, axis)
