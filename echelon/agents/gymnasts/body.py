"""The gymnast: the thesis's man and woman, with what of them touches the ground.

Masses, inertias and joints are those of *Simulation of Leaping, Tumbling, Landing, and Balancing Humans* (22 links, 53
degrees of freedom), read from ``bodies/male.toml`` and ``bodies/female.toml`` and given plain names (`joints`
lists them, and what each axis does). A gymnast differs from those bodies in this:

* **Symmetry.** The published left and right differ by up to 5 % in mass, because their surfaces were digitised. A
  symmetric gymnast has the mean of both in either, and everything in the middle lies in the plane y = 0.
* **Size.** Lengths go with height, masses with mass, moments of inertia with mass times height squared, places in
  links with height: a person of the same build. What is not given stays the thesis's.
* **Backpack.** A box (`BACKPACK`, of uniform density) on the back of the upper chest; its mass and inertia join that
  link's.
* **Contact**: feet, toes and hands, and what a falling body lies on.

The feet
--------
The thesis says that heels and balls are at z = 0 of the reference pose: 83.6 mm under the man's ankle, 82 mm under the
woman's. A box of a foot's mass and moments (semi-axis along x: sqrt(1.5 (Iyy + Izz - Ixx) / m), and so on) ends there
too: the man's 1.4 mm above, his toes' 3 mm beneath, the woman's 1.0 and 3.8 mm beneath. It gives no outline; lengthwise
the same boxes give heel, ball and tip.

A foot has four corners (heel and ball, inner and outer) on the foot link and two tips on the toes, each of
`SOLE_STIFFNESS` with damping that is critical for the body on all twelve. They grow with the body's mass, so that every
body sinks in by the same 1.2 mm when it stands.

The hands
---------
The hand link's centre of mass lies on the line from the wrist to the knuckles; the palm, facing down in the reference
pose, is the plane beneath that line. Four points: the heel of the hand and the fingertips, on the thumb's side and on
the little finger's.

Falling
-------
Ellipsoids as large as the segments' own (of the same mass and moments): pelvis, chest, head, shoulders; and balls at
knees and elbows. Hands and these are rarely on the ground and cost nothing while nobody's are (`ContactSite.use`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from echelon.agents.bodies import load_body
from echelon.agents.gymnasts.joints import (
    JOINTS,
    LIMIT_DAMPING,
    LIMIT_STIFFNESS,
    LINKS,
    REFERENCE_HEIGHT,
    REFERENCE_WEIGHT,
    SIDES,
    Sex,
    split_side,
    stops,
)
from echelon.agents.gymnasts.segments import Segment, fitted_segments
from echelon.errors import InputError
from echelon.warp_kernels.model import ContactSite, Joint, Link, Matrix3, Vec3, Visual
from echelon.warp_kernels.reference import Body

HEIGHTS: dict[Sex, float] = {"male": 1.84, "female": 1.60}
"""Of the thesis's man and woman [m]."""

SMALLEST, LARGEST = 0.5, 1.5
"""How far from the thesis's a height may be, as a factor; for the mass, these cubed."""

LARGEST_BACKPACK = 40.0  # [kg]
BACKPACK: Vec3 = (0.06, 0.14, 0.20)
"""Semi-axes of the backpack's box [m]."""
BACKPACK_PLACE = "upper_chest"

SOLE_STIFFNESS, SOLE_DAMPING = 70_000.0, 1_500.0  # of a point, for the thesis's man [N/m], [N s/m]
SOLE_STICKING, SOLE_STICKING_DAMPING = 50_000.0, 1_000.0  # the thesis's spring and damper that stop slip
SOLE_FRICTION = 0.9
HAND_STIFFNESS, HAND_DAMPING = 50_000.0, 700.0
BODY_STIFFNESS, BODY_DAMPING = 25_000.0, 700.0
SKIN_FRICTION = 0.6

MAT = 4.0
"""How much softer than a floor a mat is: nine body weights on both soles press one of 4 cm flat."""

FOOT_SITES: dict[str, tuple[str, ...]] = {
    side: tuple(f"{side}_{place}_{edge}" for place in ("heel", "ball") for edge in ("inner", "outer")) for side in SIDES
}
TOE_SITES: dict[str, tuple[str, ...]] = {side: (f"{side}_tip_inner", f"{side}_tip_outer") for side in SIDES}
HAND_SITES: dict[str, tuple[str, ...]] = {
    side: tuple(f"{side}_{place}" for place in ("palm_thumb", "palm_little", "finger_thumb", "finger_little"))
    for side in SIDES
}
FALL_SITES: tuple[str, ...] = (
    "pelvis",
    "chest",
    "head",
    *(f"{side}_{place}" for side in SIDES for place in ("knee", "ankle", "shoulder", "elbow")),
)
"""Names of the sites, in the order of the body's contacts: left and right foot, toes, hands, then what falls."""


@dataclass(frozen=True)
class LegGeometry:
    """The leg in the side view, which the two-link formulas of the thesis (7.5 and 7.6) ask for.

    Attributes:
        thigh, shank: Hip to knee, knee to ankle [m].
        thigh_lean, shank_lean: By how much each leans from the vertical in the reference pose, its lower end forwards
            positive [rad]. With an upright pelvis the thigh leans by thigh_lean - q_hip and the shank by
            shank_lean - q_hip - q_knee, the angles q being those about y; a flat foot has q_hip + q_knee + q_ankle = 0.
        ankle_height: Over a flat sole [m].
        heel, ball, tip: Of the sole, forward from the ankle [m].
        hip_offset: Of a hip from the middle [m].
    """

    thigh: float
    shank: float
    thigh_lean: float
    shank_lean: float
    ankle_height: float
    heel: float
    ball: float
    tip: float
    hip_offset: float


def gymnast_body(
    sex: Sex,
    *,
    symmetric: bool = True,
    backpack: float = 0.0,
    height: float | None = None,
    mass: float | None = None,
    shoulders: Literal["ball", "gimbal"] = "ball",
    limits: bool = False,
    mat: bool = False,
) -> Body:
    """A gymnast's body.

    Args:
        sex: The thesis's man or woman.
        symmetric: Whether left and right are the mean of both, or as published.
        backpack: What is carried on the back [kg].
        height, mass: Of the gymnast [m], of the gymnast without the backpack [kg]; None for the thesis's.
        shoulders: The thesis's ball joints, whose positions are quaternions; or three angles in the order x (raise),
            y (twist), z (swing), which stay apart while the twist is less than a right angle.
        limits: Whether joints have soft stops at the limits of `joints`. A character makes them act by
            `JointForces.limits`; balls have none.
        mat: Whether soles and hands meet a gymnastics mat, which gives way by `MAT` times more than a floor, rather
            than a floor: *Animating Human Athletics* models mats of 4 cm by a softer ground.

    Returns:
        The body, standing in the reference pose with its soles on z = 0. Masses in kg, lengths in m.

    Raises:
        InputError: An unknown sex, or a size or backpack beyond what is allowed.
    """
    if sex not in get_args(Sex):
        raise InputError(f"gymnast: sex is {sex!r}, must be male or female")
    if shoulders not in ("ball", "gimbal"):
        raise InputError(f"gymnast: shoulders is {shoulders!r}, must be ball or gimbal")
    thesis = load_body(sex)
    tallness = _factor("height", height, HEIGHTS[sex], SMALLEST, LARGEST, "m")
    heaviness = _factor("mass", mass, thesis.mass, SMALLEST**3, LARGEST**3, "kg")
    if not 0.0 <= backpack <= LARGEST_BACKPACK:
        raise InputError(f"gymnast: backpack is {backpack} kg, must lie between 0 and {LARGEST_BACKPACK:g} kg")
    links = [_scaled(link, tallness, heaviness) for link in _thesis_links(sex, symmetric)]
    contacts = _sites(thesis, links, tallness, heaviness, symmetric)
    if mat:
        contacts = tuple(_on_a_mat(site) if site.name not in FALL_SITES else site for site in contacts)
    if backpack > 0.0:
        links = [_carrying(link, backpack) if link.name == BACKPACK_PLACE else link for link in links]
    if shoulders == "gimbal":
        links = [_with_angles(link) if link.joint.kind == "ball" else link for link in links]
    if limits:
        size = heaviness * thesis.mass * 9.80665 * tallness * HEIGHTS[sex] / (REFERENCE_WEIGHT * REFERENCE_HEIGHT)
        links = [_with_stops(link, size) for link in links]
    return Body(name=f"gymnast-{sex}", links=tuple(links), contacts=contacts, gravity=thesis.gravity)


def leg_geometry(body: Body) -> LegGeometry:
    """Lengths and angles of a gymnast's left leg in the side view."""
    knee, ankle = (body.links[body.link_index(f"left_{name}")].joint.position for name in ("lower_leg", "foot"))
    sites = {site.name: site for site in body.contacts}
    toe = body.links[body.link_index("left_toes")].joint.position
    return LegGeometry(
        thigh=math.hypot(knee[0], knee[2]),
        shank=math.hypot(ankle[0], ankle[2]),
        thigh_lean=math.atan2(knee[0], -knee[2]),
        shank_lean=math.atan2(ankle[0], -ankle[2]),
        ankle_height=-sites["left_heel_inner"].position[2],
        heel=sites["left_heel_inner"].position[0],
        ball=sites["left_ball_inner"].position[0],
        tip=toe[0] + sites["left_tip_inner"].position[0],
        hip_offset=body.links[body.link_index("left_upper_leg")].joint.position[1],
    )


# ---- the links -------------------------------------------------------------------------------------------------------
def _factor(key: str, wanted: float | None, usual: float, least: float, most: float, unit: str) -> float:
    if wanted is None:
        return 1.0
    if not least * usual <= wanted <= most * usual:
        raise InputError(
            f"gymnast: {key} is {wanted} {unit}, must lie between {least * usual:.3g} and {most * usual:.3g} {unit}"
        )
    return wanted / usual


@lru_cache(maxsize=2 * len(HEIGHTS))
def _thesis_links(sex: Sex, symmetric: bool) -> tuple[Link, ...]:
    """Links of the thesis's size, drawn as what they weigh."""
    thesis = load_body(sex)
    links = [_renamed(link) for link in thesis.links]
    if symmetric:
        links = _symmetrized(links)
    soles = {site.name: site.position for site in _soles(thesis, 1.0, 1.0, symmetric)}
    segments = fitted_segments(links, soles, female=sex == "female")
    return tuple(replace(link, visuals=segments[link.name].visuals) for link in links)


def segments_of(sex: Sex, symmetric: bool = True) -> dict[str, Segment]:
    """The polyhedra of a gymnast of the thesis's size, by link: what is weighed and what is drawn (see `segments`)."""
    thesis = load_body(sex)
    soles = {site.name: site.position for site in _soles(thesis, 1.0, 1.0, symmetric)}
    return fitted_segments(_thesis_links(sex, symmetric), soles, female=sex == "female")


def _renamed(link: Link) -> Link:
    parent = None if link.parent is None else LINKS[link.parent]
    return replace(link, name=LINKS[link.name], parent=parent, joint=replace(link.joint, name=JOINTS[link.joint.name]))


def _symmetrized(links: Sequence[Link]) -> list[Link]:
    """The mean of each link and its mirror image, which for a link in the middle is its own."""
    named = {link.name: link for link in links}
    result = []
    for link in links:
        side, name = split_side(link.name)
        other = named[f"{'left' if side == 'right' else 'right'}_{name}"] if side else link
        # Means of left and right are taken in one order, so that both sides come out alike to the last digit.
        first, second = (other, link) if side == "right" else (link, other)
        inertia = 0.5 * (np.array(first.inertia) + _mirrored_tensor(second.inertia))
        com = 0.5 * (np.array(first.com) + _mirror(second.com))
        place = 0.5 * (np.array(first.joint.position) + _mirror(second.joint.position))
        if side == "right":
            inertia, com, place = _mirrored_tensor(inertia), _mirror(com), _mirror(place)
        result.append(
            replace(
                link,
                joint=replace(link.joint, position=_vec(place)),
                mass=0.5 * (first.mass + second.mass),
                com=_vec(com),
                inertia=_matrix(inertia),
            )
        )
    return result


def _scaled(link: Link, length: float, mass: float) -> Link:
    return replace(
        link,
        joint=replace(link.joint, position=_times(length, link.joint.position)),
        mass=mass * link.mass,
        com=_times(length, link.com),
        inertia=_matrix(mass * length * length * np.array(link.inertia)),
        visuals=tuple(
            replace(visual, size=_times(length, visual.size), position=_times(length, visual.position))
            for visual in link.visuals
        ),
    )


def _carrying(link: Link, backpack: float) -> Link:
    """A link with the backpack as part of it: its box touches the back of the link's own ellipsoid."""
    place = np.array(link.com) - [_semi_axes(link)[0] + BACKPACK[0], 0.0, 0.0]
    mass = link.mass + backpack
    com = (link.mass * np.array(link.com) + backpack * place) / mass
    a, b, c = (semi_axis * semi_axis for semi_axis in BACKPACK)
    box = backpack / 3.0 * np.diag([b + c, a + c, a + b])
    inertia = (
        np.array(link.inertia) + link.mass * _offset(np.array(link.com) - com) + box + backpack * _offset(place - com)
    )
    drawn = Visual("box", BACKPACK, _vec(place), color=(0.35, 0.05, 0.04))
    return replace(link, mass=mass, com=_vec(com), inertia=_matrix(inertia), visuals=(*link.visuals, drawn))


def _with_angles(link: Link) -> Link:
    axes: tuple[Vec3, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return replace(link, joint=replace(link.joint, kind="gimbal", axes=axes))


def _with_stops(link: Link, size: float) -> Link:
    limits = stops(link.joint)
    if not limits:
        return link
    stiffness, damping = size * LIMIT_STIFFNESS, size * LIMIT_DAMPING
    joint: Joint = replace(link.joint, limits=limits, limit_stiffness=stiffness, limit_damping=damping)
    return replace(link, joint=joint)


# ---- the sites -------------------------------------------------------------------------------------------------------
def _sites(
    thesis: Body, links: Sequence[Link], tallness: float, heaviness: float, symmetric: bool
) -> tuple[ContactSite, ...]:
    named = {link.name: link for link in links}
    soles = _soles(thesis, tallness, heaviness, symmetric)
    weight = heaviness * thesis.mass / load_body("male").mass
    hands = [site for side in SIDES for site in _hand(named[f"{side}_hand"], side, tallness, weight)]
    return (*soles, *hands, *_falling(named, weight))


def _soles(thesis: Body, tallness: float, heaviness: float, symmetric: bool) -> list[ContactSite]:
    """The sites of the measured body, renamed: HEEL_OUTER_R becomes right_heel_outer."""
    found: dict[str, ContactSite] = {}
    for site in thesis.contacts:
        place, edge, side = site.name.lower().split("_")
        name = f"{'left' if side == 'l' else 'right'}_{place}_{edge}"
        found[name] = replace(site, name=name, link=LINKS[site.link])
    names = [name for sites in (FOOT_SITES, TOE_SITES) for side in SIDES for name in sites[side]]
    result = []
    for name in names:
        site = found[name]
        position = np.array(site.position)
        if symmetric:
            side, rest = split_side(name)
            left, right = np.array(found[f"left_{rest}"].position), np.array(found[f"right_{rest}"].position)
            mean = 0.5 * (left + _mirror(right))
            position = mean if side == "left" else _mirror(mean)
        result.append(
            replace(
                site,
                position=_vec(tallness * position),
                stiffness=heaviness * site.stiffness,
                damping=heaviness * site.damping,
                tangential_stiffness=heaviness * site.tangential_stiffness,
                tangential_damping=heaviness * site.tangential_damping,
                friction=SOLE_FRICTION,
            )
        )
    return result


def _on_a_mat(site: ContactSite) -> ContactSite:
    """A site whose ground is as much softer as a mat, and damped as near to critical as before."""
    return replace(site, stiffness=site.stiffness / MAT, damping=site.damping / math.sqrt(MAT))


def _hand(link: Link, side: str, tallness: float, weight: float) -> list[ContactSite]:
    """Points of the palm: near the wrist and at the fingertips, either side of the hand's line."""
    line = np.array(link.com) / np.linalg.norm(link.com)
    down = np.array([0.0, 0.0, -1.0])
    palm = down - (down @ line) * line
    palm /= np.linalg.norm(palm)
    across = np.cross(line, palm) if side == "right" else np.cross(palm, line)  # towards the thumb
    # Lengths as parts of the distance from wrist to centre of mass, which is the knuckles'.
    knuckles = float(np.linalg.norm(link.com))
    thickness = 0.20 * knuckles
    result = []
    for name, along, aside in zip(HAND_SITES[side], (0.15, 0.15, 2.1, 2.0), (0.35, -0.35, 0.35, -0.35), strict=True):
        position = along * knuckles * line + aside * knuckles * across + thickness * palm
        result.append(_site(name, link.name, position, (0.0, 0.0, 0.0), HAND_STIFFNESS, HAND_DAMPING, weight))
    return [replace(site, friction=SOLE_FRICTION, integration="implicit") for site in result]


def _falling(named: dict[str, Link], weight: float) -> list[ContactSite]:
    result = []
    for name in FALL_SITES:
        side, place = split_side(name)
        if place in ("knee", "elbow"):
            link = named[f"{side}_{'lower_leg' if place == 'knee' else 'lower_arm'}"]
            radius = 1.1 * _limb_radius(link)
            center, radii = np.zeros(3), (radius, radius, radius)
        elif place == "ankle":
            # At the shank's end, so that a foot that lies on its back does not sink in; clear of a standing sole.
            link, foot = named[f"{side}_lower_leg"], named[f"{side}_foot"]
            radius = 0.6 * _limb_radius(link)
            center, radii = np.array(foot.joint.position), (radius, radius, radius)
        else:
            link = named[
                {"pelvis": "pelvis", "chest": "upper_chest", "head": "head", "shoulder": f"{side}_shoulder_girdle"}[
                    place
                ]
            ]
            center, radii = np.array(link.com), _semi_axes(link)
        result.append(_site(name, link.name, center, radii, BODY_STIFFNESS, BODY_DAMPING, weight))
    return result


def _site(
    name: str, link: str, position: np.ndarray, radii: Vec3, stiffness: float, damping: float, weight: float
) -> ContactSite:
    return ContactSite(
        name,
        link,
        _vec(position),
        radii=radii,
        stiffness=weight * stiffness,
        damping=weight * damping,
        tangential_stiffness=weight * 0.5 * stiffness,
        tangential_damping=weight * 0.5 * damping,
        friction=SKIN_FRICTION,
        patch_radius=0.0,
        rolling_resistance=0.02 if radii[0] > 0.0 else 0.0,
        use="rare",
    )


def _semi_axes(link: Link) -> Vec3:
    """Of the solid ellipsoid with a link's mass and moments [m]: sqrt(2.5 (Iyy + Izz - Ixx) / m), and so on."""
    x, y, z = (link.inertia[i][i] for i in range(3))
    return _vec(np.sqrt(2.5 / link.mass * np.array([y + z - x, x + z - y, x + y - z])))


def _limb_radius(link: Link) -> float:
    """Of the cylinder with a limb's mass and its moment about its own, longest axis [m]: sqrt(2 I / m)."""
    return math.sqrt(2.0 * min(link.inertia[i][i] for i in range(3)) / link.mass)


# ---- numbers ---------------------------------------------------------------------------------------------------------
_FLIP = np.array([1.0, -1.0, 1.0])


def _mirror(vector: Sequence[float] | np.ndarray) -> np.ndarray:
    """Mirrored in the plane y = 0."""
    return _FLIP * np.asarray(vector, dtype=float)


def _mirrored_tensor(tensor: Sequence[Sequence[float]] | np.ndarray) -> np.ndarray:
    return np.outer(_FLIP, _FLIP) * np.asarray(tensor, dtype=float)


def _offset(vector: np.ndarray) -> np.ndarray:
    """What a unit mass at a place adds to the inertia tensor about the origin."""
    return float(vector @ vector) * np.eye(3) - np.outer(vector, vector)


def _times(factor: float, vector: Vec3) -> Vec3:
    return (factor * vector[0], factor * vector[1], factor * vector[2])


def _vec(vector: np.ndarray) -> Vec3:
    return (float(vector[0]), float(vector[1]), float(vector[2]))


def _matrix(tensor: np.ndarray) -> Matrix3:
    rows = [_vec(row) for row in tensor]
    return (rows[0], rows[1], rows[2])
