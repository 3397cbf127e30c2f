"""The proportions of a person's segments before they are fitted, and how they are painted.

A segment's rings are written as parts: t of its line from joint to joint, the semi-axes as parts of those of the
elliptic cylinder with the segment's mass and moments, and where the centre lies, in the same parts. Only proportions
matter, since `segment_lofts.fitted` makes the mass right.

The rings' axes u and v are square to the line. For what stands or hangs u points forward; v points to the left in the
trunk, and on the left side inward in the leg and down in the arm. Foot and toes lie along x: there u points up,
v inward, and the line runs along the sole.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from echelon.agents.gymnasts.segment_lofts import AROUND, Loft
from echelon.warp_kernels.model import Link, Vec3, Visual

SKIN: Vec3 = (0.52, 0.29, 0.19)
DARK_HAIR: Vec3 = (0.035, 0.022, 0.015)
BROWN_HAIR: Vec3 = (0.11, 0.045, 0.016)
SHORTS: Vec3 = (0.03, 0.04, 0.09)
EYES: Vec3 = (0.02, 0.015, 0.012)
LIPS: Vec3 = (0.36, 0.12, 0.10)
OWN: Vec3 | None = None  # the colour of the individual

Ring = tuple[float, float, float, float]  # t, a, b, du

# fmt: off
RINGS: Mapping[str, tuple[Ring, ...]] = {
    # t, then parts of the cylinder's semi-axes: depth a, width b, centre ahead du. The ends are points.
    "pelvis": ((-0.06, 0, 0, 0.0), (-0.04, 0.66, 0.78, -0.03), (0.04, 0.92, 0.96, -0.05), (0.2, 1.02, 1.02, -0.06),
               (0.45, 1.04, 1.04, -0.04), (0.75, 1.0, 1.0, -0.01), (1.0, 0.95, 0.97, 0.0), (1.01, 0, 0, 0.0)),
    "trunk": ((-0.01, 0, 0, 0.0), (0.0, 1.0, 1.0, 0.0), (0.25, 1.0, 1.0, 0.0), (0.5, 1.0, 1.0, 0.0),
              (0.75, 1.0, 1.0, 0.0), (1.0, 1.0, 1.0, 0.0), (1.01, 0, 0, 0.0)),
    "upper_chest": ((-0.01, 0, 0, 0.0), (0.0, 1.0, 1.0, 0.0), (0.25, 1.02, 1.02, 0.0), (0.5, 1.03, 1.03, 0.0),
                    (0.75, 1.02, 1.02, 0.0), (1.0, 0.97, 0.96, 0.0), (1.01, 0, 0, 0.0)),
    "sternum": ((-0.06, 0, 0, 0.0), (0.0, 1.1, 0.95, 0.0), (0.25, 1.1, 0.98, 0.0), (0.43, 1.0, 1.0, -0.04),
                (0.57, 0.76, 1.2, -0.10), (0.72, 0.54, 1.35, -0.10), (0.88, 0.46, 1.3, -0.02), (1.0, 0.44, 1.2, 0.0),
                (1.04, 0, 0, 0.0)),
    "shoulder_girdle": ((-0.05, 0, 0, 0.0), (0.0, 1.0, 0.96, 0.0), (0.22, 1.06, 1.02, 0.0), (0.45, 1.02, 0.98, 0.0),
                        (0.66, 0.86, 0.86, 0.0), (0.84, 0.66, 0.70, 0.0), (0.95, 0.42, 0.46, 0.0), (1.0, 0, 0, 0.0)),
    "upper_arm": ((-0.20, 0, 0, 0.0), (-0.16, 0.48, 0.48, 0.0), (-0.05, 0.94, 0.94, 0.0), (0.12, 1.1, 1.1, 0.0),
                  (0.32, 1.08, 1.08, 0.05), (0.55, 1.0, 1.0, 0.05), (0.78, 0.76, 0.8, 0.0), (0.95, 0.6, 0.66, 0.0),
                  (1.06, 0.44, 0.48, 0.0), (1.10, 0, 0, 0.0)),
    "lower_arm": ((-0.12, 0, 0, 0.0), (-0.08, 0.66, 0.66, 0.0), (0.04, 1.18, 1.12, 0.0), (0.2, 1.32, 1.25, 0.0),
                  (0.4, 1.2, 1.12, 0.0), (0.62, 0.98, 0.9, 0.0), (0.84, 0.8, 0.68, 0.0), (0.98, 0.74, 0.56, 0.0),
                  (1.05, 0.5, 0.4, 0.0), (1.07, 0, 0, 0.0)),
    "hand": ((-0.06, 0, 0, 0.0), (-0.03, 0.4, 0.8, 0.0), (0.1, 0.74, 1.12, 0.02), (0.26, 1.02, 1.16, 0.08),
             (0.42, 1.08, 1.02, 0.06), (0.58, 0.98, 0.86, 0.0), (0.78, 0.84, 0.66, 0.0), (0.92, 0.62, 0.5, 0.0),
             (0.99, 0.3, 0.26, 0.0), (1.0, 0, 0, 0.0)),
    "upper_leg": ((-0.15, 0, 0, 0.0), (-0.12, 0.52, 0.5, 0.0), (-0.03, 0.98, 0.96, -0.04), (0.12, 1.14, 1.1, -0.02),
                  (0.3, 1.12, 1.12, 0.04), (0.5, 1.0, 1.02, 0.08), (0.7, 0.82, 0.86, 0.06), (0.88, 0.66, 0.72, 0.02),
                  (1.0, 0.6, 0.66, 0.02), (1.07, 0.42, 0.46, 0.0), (1.10, 0, 0, 0.0)),
    "lower_leg": ((-0.10, 0, 0, 0.0), (-0.07, 0.6, 0.6, 0.0), (0.03, 1.08, 1.04, 0.0), (0.16, 1.2, 1.12, -0.2),
                  (0.3, 1.26, 1.18, -0.28), (0.46, 1.08, 1.04, -0.2), (0.66, 0.8, 0.8, -0.06), (0.86, 0.64, 0.62, 0.0),
                  (1.0, 0.62, 0.62, 0.0), (1.05, 0.4, 0.42, 0.0), (1.07, 0, 0, 0.0)),
    "foot": ((-0.05, 0, 0, 0.6), (0.0, 0.5, 0.5, 0.62), (0.12, 0.86, 0.74, 0.88), (0.28, 1.16, 0.8, 1.16),
             (0.44, 1.08, 0.84, 1.08), (0.62, 0.84, 0.92, 0.84), (0.82, 0.62, 0.98, 0.62), (1.0, 0.5, 1.0, 0.5),
             (1.06, 0.36, 0.8, 0.5), (1.08, 0, 0, 0.5)),
    "toes": ((-0.08, 0, 0, 0.85), (-0.04, 0.6, 0.75, 0.82), (0.1, 0.88, 1.0, 0.86), (0.35, 0.84, 1.06, 0.84),
             (0.6, 0.66, 1.0, 0.66), (0.82, 0.5, 0.86, 0.5), (0.96, 0.34, 0.6, 0.38), (1.0, 0, 0, 0.36)),
    "head": ((0.0, 0, 0, -0.04), (0.02, 0.40, 0.56, -0.04), (0.13, 0.44, 0.62, -0.05), (0.21, 0.56, 0.60, 0.10),
             (0.245, 0.70, 0.62, 0.30), (0.32, 0.90, 0.80, 0.24), (0.43, 0.98, 0.93, 0.14), (0.53, 1.04, 1.0, 0.07),
             (0.66, 1.14, 1.07, 0.0), (0.79, 1.14, 1.05, -0.03), (0.89, 0.96, 0.9, -0.05), (0.965, 0.6, 0.58, -0.06),
             (1.0, 0, 0, -0.06)),
}
# fmt: on
SEAM = 0.6  # how freely the ends of the trunk's segments change: they meet those of their neighbours
NOSE: Mapping[int, float] = {4: 0.04, 5: 0.02, 6: 0.24, 7: 0.10}  # ring of the head, part of its depth
STACK = ("pelvis", "abdomen", "lower_chest", "upper_chest")


@dataclass(frozen=True)
class Paint:
    """How a segment is coloured.

    Attributes:
        color: Colour at a part t of the line, where the cosine of the direction to u is given.
        details: Small things on the fitted segment.
    """

    color: Callable[[float, float], Vec3 | None]
    details: Callable[[Loft], tuple[Visual, ...]] = lambda loft: ()


def template(
    name: str, named: Mapping[str, Link], soles: Mapping[str, Vec3], female: bool, side: str
) -> tuple[Loft, Paint]:
    """A segment's loft before it is fitted, as one of the left side, and its paint.

    Args:
        name: Of the segment, without a side.
        named: All links of the body by name.
        soles: Positions of the left foot's contact sites by name, in the frames of their links [m].
        female: A woman's clothes, or a man's.
        side: Whose measures a limb takes; the loft is the left's all the same.
    """
    link = named[name] if name in named else named[f"{side}_{name}"]
    flip = np.array([1.0, -1.0 if side == "right" else 1.0, 1.0])
    com = flip * np.array(link.com)
    moments = np.diag(np.array(link.inertia))
    semi = 2.0 * np.sqrt((0.5 * moments.sum() - moments) / link.mass)  # of the elliptic cylinder, along x, y, z

    def joint(of: str) -> np.ndarray:
        carried = named[of] if of in named else named[f"{side}_{of}"]
        return flip * np.array(carried.joint.position)

    start, end = _line(name, com, semi, joint, soles)
    line = end - start
    along = line / np.linalg.norm(line)
    first = np.array([0.0, 0.0, 1.0]) if name in ("foot", "toes") else np.array([1.0, 0.0, 0.0])
    u = first - (first @ along) * along
    u /= np.linalg.norm(u)
    v = np.cross(along, u)
    rings = np.array(RINGS.get(name, RINGS["trunk"]), dtype=float)
    a, b = _size(name, semi, u, v, float(np.linalg.norm(line)))
    free = np.ones(len(rings))
    du = a * rings[:, 3]
    depth, width = a * rings[:, 1], b * rings[:, 2]
    if name in STACK[1:]:
        depth, width, du = _outline(name, named, rings, start, line)
        free[[0, 1, -2, -1]] = SEAM
    bumps = np.zeros((len(rings), AROUND))
    if name == "head":
        for ring, part in NOSE.items():
            bumps[ring, 0] = part * a
    loft = Loft(
        start, line, u, v, rings[:, 0], depth, width, du, np.zeros(len(rings)), free, bumps, middle=name in named
    )
    return loft, _paint(name, female)


def _line(
    name: str,
    com: np.ndarray,
    semi: np.ndarray,
    joint: Callable[[str], np.ndarray],
    soles: Mapping[str, Vec3],
) -> tuple[np.ndarray, np.ndarray]:
    """Where a segment's line begins and ends, in the frame of its link [m]."""
    origin = np.zeros(3)
    match name:
        case "pelvis":
            return np.array([com[0], 0.0, com[2] - 0.90 * semi[2]]), np.array([com[0], 0.0, joint("abdomen")[2]])
        case "abdomen" | "lower_chest" | "upper_chest":
            above = {"abdomen": "lower_chest", "lower_chest": "upper_chest", "upper_chest": "sternum"}[name]
            return np.array([com[0], 0.0, 0.0]), np.array([com[0], 0.0, joint(above)[2]])
        case "sternum":
            return origin + [com[0], 0.0, -0.005], joint("head") + [0.0, 0.0, 0.005]
        case "shoulder_girdle":
            arm = joint("upper_arm")
            return np.array([com[0], -0.10 * arm[1], 1.05 * com[2]]), np.array([arm[0], 1.2 * arm[1], 0.45 * com[2]])
        case "upper_arm":
            return origin, joint("lower_arm")
        case "lower_arm":
            return origin, joint("hand")
        case "hand":
            return origin, 2.15 * com
        case "upper_leg":
            return origin, joint("lower_leg")
        case "lower_leg":
            return origin, joint("foot")
        case "foot":
            heel, ball = np.array(soles["left_heel_inner"]), np.array(soles["left_ball_inner"])
            return np.array([heel[0], com[1], heel[2]]), np.array([ball[0], com[1], ball[2]])
        case "toes":
            tip = np.array(soles["left_tip_inner"])
            return np.array([0.0, com[1], tip[2]]), np.array([tip[0] + 0.006, com[1], tip[2]])
        case _:  # the head, from the neck to the crown
            height = semi[2] / 0.894
            return com + [-0.030, 0.0, -1.04 * height], com + [0.0, 0.0, 0.88 * height]


def _size(name: str, semi: np.ndarray, u: np.ndarray, v: np.ndarray, length: float) -> tuple[float, float]:
    """Semi-axes along u and v that the parts are of [m]."""
    across = (float(np.abs(u) @ semi), float(np.abs(v) @ semi))
    if name in ("lower_arm", "upper_arm", "lower_leg"):
        # Across the axes the cylinder looks thicker than it is; the thinner side tells.
        thin = float(np.min(semi))
        return thin, thin
    if name == "hand":
        return 0.25 * length, 0.115 * length
    if name in ("foot", "toes"):
        return float(semi[2]), float(semi[1])
    return across


def _outline(
    name: str, named: Mapping[str, Link], rings: np.ndarray, start: np.ndarray, line: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depths, widths and centres of a trunk segment's rings, so that the trunk is one smooth column [m]."""
    heights, depths, widths, centers = [], [], [], []
    origin = np.zeros(3)
    own = np.zeros(3)
    for part in STACK:
        link = named[part]
        origin = origin + (np.array(link.joint.position) if part != "pelvis" else 0.0)
        moments = np.diag(np.array(link.inertia))
        semi = 2.0 * np.sqrt((0.5 * moments.sum() - moments) / link.mass)
        heights.append(origin[2] + link.com[2])
        depths.append(semi[0])
        widths.append(semi[1])
        centers.append(origin[0] + link.com[0])
        if part == name:
            own = origin.copy()
    z = own[2] + start[2] + rings[:, 0] * line[2]
    depth, width, center = (np.interp(z, heights, values) for values in (depths, widths, centers))
    return depth * rings[:, 1], width * rings[:, 2], center - own[0] - start[0]


# ---- paint -----------------------------------------------------------------------------------------------------------
def _paint(name: str, female: bool) -> Paint:
    match name:
        case "head":
            return Paint(lambda t, ahead: _head_color(t, ahead, female), lambda loft: _face(loft, female))
        case "abdomen" | "lower_chest" | "upper_chest":
            return Paint(lambda t, ahead: OWN, _pad)
        case "pelvis":
            return Paint(lambda t, ahead: OWN if female else SHORTS)
        case "sternum":
            return Paint(lambda t, ahead: OWN if t < 0.45 else SKIN)
        case "shoulder_girdle":
            return Paint(lambda t, ahead: OWN if t < 0.55 else SKIN)
        case "upper_leg":
            return Paint(lambda t, ahead: SHORTS if not female and t < 0.4 else SKIN)
        case _:
            return Paint(lambda t, ahead: SKIN)


def _head_color(t: float, ahead: float, female: bool) -> Vec3:
    hair = t > 0.80 or (t > 0.58 and ahead < 0.35) or (t > 0.36 and ahead < -0.15) or (t > 0.22 and ahead < -0.6)
    if not hair:
        return SKIN
    return BROWN_HAIR if female else DARK_HAIR


def _pad(loft: Loft) -> tuple[Visual, ...]:
    """What fills the gap that opens behind a trunk segment and the one beneath it when the spine bends."""
    size = (round(0.94 * float(loft.a[1]), 4), round(0.94 * float(loft.b[1]), 4), 0.05)
    place = loft.start + loft.du[1] * loft.u
    return (Visual("ellipsoid", size, (round(float(place[0]), 4), 0.0, 0.0), color=OWN),)


def _face(loft: Loft, female: bool) -> tuple[Visual, ...]:
    """Eyes, mouth, ears, and a woman's bun."""
    depth, width = float(loft.a.max()), float(loft.b.max())

    def place(t: float, ahead: float, aside: float) -> Vec3:
        """On the surface at a part of the height, `aside` from the middle as a part of the width there."""
        a, b, du = (float(np.interp(t, loft.t, values)) for values in (loft.a, loft.b, loft.du))
        at = loft.start + t * loft.line + (du + ahead * a) * loft.u + aside * b * loft.v
        return (round(float(at[0]), 4), round(float(at[1]), 4), round(float(at[2]), 4))

    parts = [Visual("ellipsoid", (0.08 * depth, 0.24 * width, 0.05 * depth), place(0.315, 0.95, 0.0), color=LIPS)]
    for sign in (1.0, -1.0):
        eye, ear = place(0.56, 0.88, 0.42 * sign), place(0.50, -0.08, 1.0 * sign)
        parts.append(Visual("ellipsoid", (0.08 * depth, 0.14 * width, 0.075 * depth), eye, color=EYES))
        parts.append(Visual("ellipsoid", (0.16 * depth, 0.10 * width, 0.26 * depth), ear, color=SKIN))
    if female:
        bun = place(0.80, -1.10, 0.0)
        size = 0.36 * depth
        parts.append(Visual("ellipsoid", (size, size, size), bun, color=BROWN_HAIR))
    return tuple(parts)
