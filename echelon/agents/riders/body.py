"""The rider: segments, joints and grips of the people who ride.

Two riders share one pelvis, trunk, legs and arms:

* that of *Dynamically Simulated Characters in Virtual Environments* (1998): 12 segments and 17 controlled degrees of
  freedom (waist 3, and of each side shoulder 3, elbow, hip, knee and ankle 1), with the masses and moments of inertia
  of its Table 1;
* that of *Animating Human Athletics* (1995): 15 segments and 22 degrees of freedom. Head and hands are segments of
  their own; what comes in is a neck of 1 and two wrists of 2.

The pelvis turns on the saddle about one pin that no servo drives. Springs of no length tie hands to bars and feet to
pedals; the cranks are a link of the bicycle on a pin of their own.

Angles are zero when a rider stands upright with hanging arms. Flexion is positive at every joint that flexes: waist,
hips, knees, ankles (toes up), shoulders (arms forward), elbows, neck (chin down). Joints have limits as data and no
springs at them: riding stays far within, and the limp body's are `cyclist`'s business.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from echelon.agents.riders import looks as looks
from echelon.agents.riders.bicycle import FORK, FRAME, BicycleParameters, bicycle_links, wheel_sites
from echelon.agents.riders.bicycle_looks import crank_visuals
from echelon.errors import InputError
from echelon.warp_kernels.character import Capsule
from echelon.warp_kernels.model import ContactSite, Joint, Link, Matrix3, Model, Spring, Vec3, Visual

SIDES = (("left", 1.0), ("right", -1.0))
FORWARD: Vec3 = (0.0, -1.0, 0.0)  # turning about it brings what hangs forward
BACKWARD: Vec3 = (0.0, 1.0, 0.0)
ALONG: Vec3 = (1.0, 0.0, 0.0)
UP: Vec3 = (0.0, 0.0, 1.0)

CRANK, PELVIS, TRUNK, HEAD = "crank", "pelvis", "upper_body", "head"
CRANK_MASS, CRANK_INERTIA = 0.9, (0.008, 0.016, 0.020)  # both arms, pedals and chain ring [kg], [kg m^2]

HAND_STIFFNESS, HAND_DAMPING = 60_000.0, 60.0  # [N/m], [N s/m]
FOOT_STIFFNESS, FOOT_DAMPING = 70_000.0, 100.0
LIGHT_HAND_STIFFNESS, LIGHT_HAND_DAMPING = 40_000.0, 30.0  # of hands that are segments of their own


@dataclass(frozen=True)
class Segment:
    """A rigid segment in its own axes: x forward, y left, z up, standing.

    Attributes:
        mass: [kg].
        inertia: Principal moments about its centre of mass [kg m^2].
        com: Centre of mass from the segment's inboard joint [m].
    """

    mass: float
    inertia: Vec3
    com: Vec3

    def scaled(self, length: float, mass: float) -> Segment:
        """A segment of the same shape, `length` times as long and `mass` times as heavy."""
        x, y, z = (mass * length * length * moment for moment in self.inertia)
        return Segment(mass * self.mass, (x, y, z), _times(length, self.com))


@dataclass(frozen=True)
class RiderParameters:
    """How large and heavy a rider is; lengths in metres, those of pairs on the left side.

    Attributes:
        upper_body, pelvis, upper_leg, lower_leg, foot, upper_arm, lower_arm: Segments; masses and moments are Table 1
            of the 1998 paper. Head and hands belong to upper body and lower arm.
        head, hand: What a head and a hand are where they are segments of their own; they are taken out of upper body
            and lower arm, so that a rider weighs the same.
        waist: Joint between pelvis and upper body, from the saddle [m].
        hip, shoulder: Joints in the pelvis and in the upper body [m].
        neck: Joint in the upper body [m].
        upper_leg_length, lower_leg_length, upper_arm_length: Between joints [m].
        lower_arm_length: Elbow to grip [m].
        wrist: Elbow to wrist [m].
        sole: Ankle to the pedal's axle [m].
        pelvis_pitch, waist_flexion, neck_flexion: Posture on the bicycle [rad].
        elbows_out: By how much each arm is turned about itself so that its elbow points outwards [rad].
    """

    upper_body: Segment = Segment(34.24, (1.390, 1.298, 0.337), (0.0, 0.0, 0.25))
    pelvis: Segment = Segment(16.61, (0.23, 0.18, 0.16), (0.0, 0.0, 0.11))
    upper_leg: Segment = Segment(8.35, (0.15, 0.16, 0.025), (0.0, 0.0, -0.19))
    lower_leg: Segment = Segment(4.16, (0.055, 0.056, 0.007), (0.0, 0.0, -0.19))
    foot: Segment = Segment(1.34, (0.002, 0.008, 0.007), (0.05, 0.0, -0.05))
    upper_arm: Segment = Segment(2.79, (0.025, 0.025, 0.0050), (0.0, 0.0, -0.13))
    lower_arm: Segment = Segment(1.78, (0.0218, 0.0230, 0.0023), (0.0, 0.0, -0.16))
    head: Segment = Segment(4.6, (0.024, 0.027, 0.018), (0.02, 0.0, 0.13))
    hand: Segment = Segment(0.52, (0.0012, 0.0011, 0.0006), (0.0, 0.0, -0.06))
    waist: Vec3 = (-0.01, 0.0, 0.19)
    hip: Vec3 = (0.0, 0.11, 0.09)
    shoulder: Vec3 = (0.0, 0.19, 0.39)
    neck: Vec3 = (0.015, 0.0, 0.455)
    upper_leg_length: float = 0.44
    lower_leg_length: float = 0.44
    upper_arm_length: float = 0.30
    lower_arm_length: float = 0.33
    wrist: float = 0.26
    sole: Vec3 = (0.11, 0.0, -0.10)
    pelvis_pitch: float = math.radians(35.0)
    waist_flexion: float = math.radians(10.0)
    neck_flexion: float = math.radians(-12.0)
    elbows_out: float = math.radians(24.0)

    @property
    def mass(self) -> float:
        """Of the whole rider [kg]."""
        pairs = (self.upper_leg, self.lower_leg, self.foot, self.upper_arm, self.lower_arm)
        return self.upper_body.mass + self.pelvis.mass + 2.0 * sum(part.mass for part in pairs)

    def scaled(self, stature: float = 1.0, mass: float = 1.0) -> RiderParameters:
        """A rider of the same build.

        Args:
            stature: Every length times this.
            mass: Every mass times this; moments of inertia follow both.

        Raises:
            InputError: A factor outside 0.5 to 1.5.
        """
        for name, factor in (("stature", stature), ("mass", mass)):
            if not 0.5 <= factor <= 1.5:
                raise InputError(f"rider: {name} is {factor} times the usual, must lie between 0.5 and 1.5")
        values = {}
        for name, value in vars(self).items():
            if isinstance(value, Segment):
                values[name] = value.scaled(stature, mass)
            elif isinstance(value, tuple):
                values[name] = _times(stature, value)
            elif name.endswith("length") or name == "wrist":
                values[name] = stature * value
        return replace(self, **values)


def fitted_bicycle(bicycle: BicycleParameters, stature: float) -> BicycleParameters:
    """A bicycle set up for a rider `stature` times as tall: saddle and grips move away from the bottom bracket."""
    x, y, z = bicycle.bottom_bracket

    def moved(place: Vec3) -> Vec3:
        return (x + stature * (place[0] - x), y + stature * (place[1] - y), z + stature * (place[2] - z))

    return replace(bicycle, saddle=moved(bicycle.saddle), grip=moved(bicycle.grip))


# ---- links -----------------------------------------------------------------------------------------------------------
def crank_link(bicycle: BicycleParameters) -> Link:
    """Both cranks on their axle; at angle zero the left one points forward, a positive rate drives forward."""
    return Link(
        CRANK,
        FRAME,
        Joint(CRANK, "pin", bicycle.bottom_bracket, (BACKWARD,), continuous=True),
        CRANK_MASS,
        inertia=_diagonal(*CRANK_INERTIA),
        visuals=looks.without_pedals(crank_visuals(bicycle.crank_length, bicycle.pedal_offset)),
    )


def rider_links(
    rider: RiderParameters, bicycle: BicycleParameters, *, head_and_hands: bool = False
) -> tuple[Link, ...]:
    """The rider's links, hanging on the frame at the saddle.

    Args:
        rider: How large.
        bicycle: What carries the rider.
        head_and_hands: Segments of their own for these, as in the 1995 paper.
    """
    trunk, lower_arm = rider.upper_body, rider.lower_arm
    if head_and_hands:
        trunk = _without(trunk, rider.head, rider.neck)
        lower_arm = _without(lower_arm, rider.hand, (0.0, 0.0, -rider.wrist))
    head_looks = looks.head_visuals(rider.neck, 0.0 if head_and_hands else rider.neck_flexion)
    trunk_looks = looks.trunk_visuals(rider.shoulder, rider.neck)
    links = [
        _link(PELVIS, FRAME, rider.pelvis, _pin("seat", bicycle.saddle, BACKWARD), looks.pelvis_visuals(rider.hip)),
        _link(
            TRUNK,
            PELVIS,
            trunk,
            _gimbal("waist", rider.waist, (BACKWARD, ALONG, UP), ((-0.5, 0.9), (-0.5, 0.5), (-0.6, 0.6))),
            trunk_looks if head_and_hands else trunk_looks + head_looks,
        ),
    ]
    if head_and_hands:
        joint = _pin("neck", rider.neck, BACKWARD, (-0.9, 0.9))
        links.append(_link(HEAD, TRUNK, rider.head, joint, looks.moved(head_looks, _times(-1.0, rider.neck))))
    for side, sign in SIDES:
        thigh, shank, foot = f"{side}_upper_leg", f"{side}_lower_leg", f"{side}_foot"
        links += [
            _link(
                thigh,
                PELVIS,
                rider.upper_leg,
                _pin(f"{side}_hip", _mirrored(rider.hip, sign), FORWARD, (-0.5, 2.3)),
                looks.upper_leg_visuals(rider.upper_leg_length),
            ),
            _link(
                shank,
                thigh,
                rider.lower_leg,
                _pin(f"{side}_knee", (0.0, 0.0, -rider.upper_leg_length), BACKWARD, (0.0, 2.6)),
                looks.lower_leg_visuals(rider.lower_leg_length),
            ),
            _link(
                foot,
                shank,
                rider.foot,
                _pin(f"{side}_ankle", (0.0, 0.0, -rider.lower_leg_length), FORWARD, (-0.7, 0.6)),
                looks.foot_visuals(rider.sole),
            ),
        ]
    for side, sign in SIDES:
        upper, lower, hand = f"{side}_upper_arm", f"{side}_lower_arm", f"{side}_hand"
        abduction = (-0.6, 2.0) if sign > 0.0 else (-2.0, 0.6)
        wrist = (0.0, 0.0, -rider.wrist)
        links += [
            _link(
                upper,
                TRUNK,
                rider.upper_arm,
                _gimbal(
                    f"{side}_shoulder",
                    _mirrored(rider.shoulder, sign),
                    (FORWARD, ALONG, UP),
                    ((-0.9, 2.8), abduction, (-1.6, 1.6)),
                ),
                looks.upper_arm_visuals(rider.upper_arm_length),
            ),
            _link(
                lower,
                upper,
                lower_arm,
                _pin(f"{side}_elbow", (0.0, 0.0, -rider.upper_arm_length), FORWARD, (0.0, 2.6)),
                looks.lower_arm_visuals(rider.wrist)
                + (() if head_and_hands else looks.hand_visuals(rider.lower_arm_length, rider.wrist)),
            ),
        ]
        if head_and_hands:
            joint = Joint(f"{side}_wrist", "universal", wrist, (FORWARD, ALONG), ((-1.2, 1.2), (-0.6, 0.6)))
            hand_looks = looks.moved(looks.hand_visuals(rider.lower_arm_length, rider.wrist), _times(-1.0, wrist))
            links.append(_link(hand, lower, rider.hand, joint, hand_looks))
    return tuple(links)


def rider_springs(rider: RiderParameters, bicycle: BicycleParameters, *, head_and_hands: bool) -> tuple[Spring, ...]:
    """Hands to bars and feet to pedals: `left_grip`, `right_grip`, `left_pedal`, `right_pedal`."""
    stem = bicycle.on_steer_axis(bicycle.front_wheel.radius)
    springs = []
    for side, sign in SIDES:
        grip = _mirrored(bicycle.grip, sign)
        springs.append(
            Spring(
                f"{side}_grip",
                f"{side}_hand" if head_and_hands else f"{side}_lower_arm",
                (0.0, 0.0, -rider.lower_arm_length + (rider.wrist if head_and_hands else 0.0)),
                FORK,
                (grip[0] - stem[0], grip[1] - stem[1], grip[2] - stem[2]),
                LIGHT_HAND_STIFFNESS if head_and_hands else HAND_STIFFNESS,
                LIGHT_HAND_DAMPING if head_and_hands else HAND_DAMPING,
            )
        )
    for side, sign in SIDES:
        springs.append(
            Spring(
                f"{side}_pedal",
                f"{side}_foot",
                (rider.sole[0], sign * (bicycle.pedal_offset - rider.hip[1]), rider.sole[2]),
                CRANK,
                (sign * bicycle.crank_length, sign * bicycle.pedal_offset, 0.0),
                FOOT_STIFFNESS,
                FOOT_DAMPING,
            )
        )
    return tuple(springs)


def rider_sites(rider: RiderParameters, bicycle: BicycleParameters, *, head_and_hands: bool) -> tuple[ContactSite, ...]:
    """What of bicycle and rider meets the ground after a fall, and the `bumper` that obstacles stop."""
    stem = bicycle.on_steer_axis(bicycle.front_wheel.radius)
    stature = rider.upper_leg_length / 0.44
    places: list[tuple[str, str, Vec3, Vec3, float]] = [
        ("seat", PELVIS, (0.0, 0.0, 0.09), (0.11, 0.17, 0.12), 1.0),
        ("chest", TRUNK, (0.0, 0.0, 0.28), (0.12, 0.20, 0.20), 1.0),
        ("helmet", HEAD, (0.035, 0.0, 0.145), (0.12, 0.12, 0.12), 1.0)
        if head_and_hands
        else ("helmet", TRUNK, (0.05, 0.0, 0.60), (0.12, 0.12, 0.12), 1.0),
    ]
    # One flat ellipsoid for the bars, from end to end.
    bars = (bicycle.grip[0] - stem[0] - 0.03, 0.0, bicycle.grip[2] - stem[2] - 0.03)
    places.append(("bars", FORK, bars, (0.06, bicycle.grip[1] + 0.04, 0.05), 0.3))
    for side, _ in SIDES:
        # Long ellipsoids: from knee to ankle, from elbow to hand.
        shin, arm = 0.5 * rider.lower_leg_length / stature, 0.5 * rider.lower_arm_length / stature
        places.append((f"{side}_shin", f"{side}_lower_leg", (0.0, 0.0, -shin), (0.06, 0.06, shin + 0.08), 0.5))
        places.append((f"{side}_forearm", f"{side}_lower_arm", (0.0, 0.0, -arm), (0.045, 0.045, arm + 0.03), 0.15))
    grounded = [
        ContactSite(
            name,
            link,
            position if link == FORK else _times(stature, position),
            radii=radii if link == FORK else _times(stature, radii),
            stiffness=30_000.0 * weight,
            damping=900.0 * weight,
            tangential_stiffness=15_000.0 * weight,
            tangential_damping=400.0 * weight,
            friction=0.55,
            patch_radius=0.05 if weight == 1.0 else 0.0,
            rolling_resistance=0.04 if weight == 1.0 else 0.0,
            integration="explicit",
            use="rare",
        )
        for name, link, position, radii, weight in places
    ]
    middle = 0.5 * bicycle.wheelbase
    bumper = ContactSite(
        "bumper",
        FRAME,
        (middle, 0.0, 0.6),
        radii=(middle + bicycle.front_wheel.radius, 0.30, 0.6),
        surface="wall",
        stiffness=8_000.0,
        damping=100.0,
        tangential_stiffness=0.0,
        friction=0.2,
        integration="explicit",
        use="rare",
    )
    return (*grounded, bumper)


def rider_capsules(rider: RiderParameters, bicycle: BicycleParameters) -> tuple[Capsule, ...]:
    """What other riders touch, in the frame's axes: trunk and arms, and the bicycle with feet on its pedals.

    The upper one reaches from the hips to where head and bars are, and is as wide as shoulders and bars; the lower one
    from wheel to wheel.
    """
    stature = rider.upper_leg_length / 0.44
    x, _, z = bicycle.saddle
    hips, ahead = (x + 0.05 * stature, 0.0, z + 0.10 * stature), (bicycle.grip[0] - 0.19, 0.0, z + 0.25 * stature)
    thick = 0.14
    rear, front = bicycle.rear_wheel.radius, bicycle.front_wheel.radius
    return (
        Capsule(hips, ahead, 0.25 * stature),
        Capsule((thick - rear, 0.0, rear), (bicycle.wheelbase + front - thick, 0.0, front), thick),
    )


def cyclist_model(rider: RiderParameters, bicycle: BicycleParameters, *, fifteen_segments: bool) -> Model:
    """Bicycle and rider as one body, called as its character is."""
    frame, *others = bicycle_links(bicycle)
    return Model(
        name="cyclist-1995" if fifteen_segments else "cyclist",
        links=(frame, *others, crank_link(bicycle), *rider_links(rider, bicycle, head_and_hands=fifteen_segments)),
        springs=rider_springs(rider, bicycle, head_and_hands=fifteen_segments),
        contacts=(*wheel_sites(bicycle), *rider_sites(rider, bicycle, head_and_hands=fifteen_segments)),
        gravity=bicycle.gravity,
    )


def _link(name: str, parent: str, segment: Segment, joint: Joint, visuals: tuple[Visual, ...]) -> Link:
    return Link(name, parent, joint, segment.mass, segment.com, _diagonal(*segment.inertia), visuals)


def _pin(name: str, place: Vec3, axis: Vec3, limit: tuple[float, float] | None = None) -> Joint:
    if limit is None:
        return Joint(name, "pin", place, (axis,))
    return Joint(name, "pin", place, (axis,), (limit,))


def _gimbal(name: str, place: Vec3, axes: tuple[Vec3, ...], limits: tuple[tuple[float, float], ...]) -> Joint:
    return Joint(name, "gimbal", place, axes, limits)


def _without(whole: Segment, part: Segment, at: Vec3) -> Segment:
    """What is left of a segment without a part whose own origin lies at `at`; products of inertia are left out."""
    mass = whole.mass - part.mass
    place = [a + c for a, c in zip(at, part.com, strict=True)]
    com = [(whole.mass * w - part.mass * p) / mass for w, p in zip(whole.com, place, strict=True)]
    # Moments about the whole's centre: the part's go away, and so does what shifting to the new centre adds.
    r = [p - w for p, w in zip(place, whole.com, strict=True)]
    s = [c - w for c, w in zip(com, whole.com, strict=True)]
    moments = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        taken = part.inertia[i] + part.mass * (r[j] ** 2 + r[k] ** 2) + mass * (s[j] ** 2 + s[k] ** 2)
        moments.append(whole.inertia[i] - taken)
    return Segment(mass, (moments[0], moments[1], moments[2]), (com[0], com[1], com[2]))


def _diagonal(x: float, y: float, z: float) -> Matrix3:
    return ((x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z))


def _times(factor: float, vector: Vec3) -> Vec3:
    return (factor * vector[0], factor * vector[1], factor * vector[2])


def _mirrored(place: Vec3, sign: float) -> Vec3:
    return (place[0], sign * place[1], place[2])
