"""What the actors look like: those who are in the picture but are not simulated as bodies."""

from __future__ import annotations

from functools import cache

from echelon.export.scenery_assets import jogger_visuals
from echelon.export.shapes import STEEL, WHEEL_RADIUS, WHEELBASE, bicycle_visuals, capsule_between
from echelon.recording import Actor
from echelon.warp_kernels.model import Vec3, Visual

COLLIE = "collie"  # the actor on a bicycle who is a dog

_JERSEY: Vec3 = (0.78, 0.55, 0.01)
_BIB: Vec3 = (0.015, 0.017, 0.025)
_SKIN: Vec3 = (0.40, 0.21, 0.125)
_HELMET: Vec3 = (0.80, 0.80, 0.78)
_TYRE: Vec3 = (0.015, 0.015, 0.016)
_FRAME: Vec3 = (0.02, 0.10, 0.30)


def actor_visuals(actor: Actor) -> tuple[Visual, ...]:
    """Shapes of an actor in its own frame: origin on the ground halfway between the wheels or feet, x forward [m]."""
    if actor.kind == "jogger":
        return jogger_visuals()
    return bicycle_visuals() if actor.name == COLLIE else racer_visuals()


@cache
def racer_visuals() -> tuple[Visual, ...]:
    """A racing cyclist in yellow, hands on the drops: the user, who rides along."""
    rear, front, hub = -0.5 * WHEELBASE, 0.5 * WHEELBASE, WHEEL_RADIUS
    turned = (0.7071067811865476, 0.0, 0.0, 0.7071067811865476)
    crank, saddle = (rear + 0.41, 0.0, 0.27), (rear + 0.20, 0.0, 0.95)
    head, bar = (rear + 0.86, 0.0, 0.82), (rear + 0.95, 0.0, 0.93)
    hip, shoulder, chin = (rear + 0.22, 0.0, 1.04), (rear + 0.70, 0.0, 1.40), (rear + 0.86, 0.0, 1.52)
    parts = [
        *(Visual("torus", (WHEEL_RADIUS - 0.014, 0.014, 0.0), (x, 0.0, hub), turned, _TYRE) for x in (rear, front)),
        *(Visual("torus", (WHEEL_RADIUS - 0.035, 0.010, 0.0), (x, 0.0, hub), turned, STEEL) for x in (rear, front)),
        *(Visual("cylinder", (0.03, 0.05, 0.0), (x, 0.0, hub), turned, STEEL) for x in (rear, front)),
        capsule_between((rear, 0.0, hub), crank, 0.013, _FRAME),
        capsule_between((rear, 0.0, hub), saddle, 0.011, _FRAME),
        capsule_between(crank, saddle, 0.016, _FRAME),
        capsule_between(crank, head, 0.019, _FRAME),
        capsule_between((rear + 0.235, 0.0, 0.84), head, 0.016, _FRAME),
        capsule_between((front, 0.0, hub), head, 0.015, _FRAME),
        capsule_between(head, bar, 0.014, STEEL),
        capsule_between((bar[0], -0.20, bar[2]), (bar[0], 0.20, bar[2]), 0.014, _TYRE),
        Visual("cylinder", (0.095, 0.004, 0.0), (crank[0], -0.05, crank[2]), turned, STEEL),
        Visual("ellipsoid", (0.14, 0.07, 0.025), (saddle[0], 0.0, saddle[2] + 0.02), color=_TYRE),
        capsule_between((hip[0], -0.07, hip[2]), (hip[0], 0.07, hip[2]), 0.115, _BIB),
        capsule_between(
            (hip[0] + 0.06, 0.0, hip[2] + 0.03), (shoulder[0] - 0.06, 0.0, shoulder[2] - 0.06), 0.13, _JERSEY
        ),
        capsule_between((shoulder[0], -0.13, shoulder[2]), (shoulder[0], 0.13, shoulder[2]), 0.075, _JERSEY),
        capsule_between((shoulder[0], 0.0, shoulder[2]), chin, 0.05, _SKIN),
        Visual("ellipsoid", (0.10, 0.08, 0.115), (chin[0] + 0.03, 0.0, chin[2] + 0.07), color=_SKIN),
        Visual("ellipsoid", (0.145, 0.095, 0.085), (chin[0] + 0.005, 0.0, chin[2] + 0.135), color=_HELMET),
    ]
    for side, angle in ((1.0, (0.155, -0.05)), (-1.0, (-0.155, 0.05))):
        pedal = (crank[0] + angle[0], 0.11 * side, crank[2] + angle[1])
        knee = (rear + 0.58, 0.09 * side, 0.83) if side > 0.0 else (rear + 0.47, 0.09 * side, 0.66)
        ankle = (pedal[0] - 0.11, pedal[1], pedal[2] + 0.11)
        heel, toe = (ankle[0] - 0.03, ankle[1], ankle[2] - 0.05), (pedal[0] + 0.06, pedal[1], pedal[2] + 0.02)
        middle = (0.5 * (hip[0] + knee[0]), 0.09 * side, 0.5 * (hip[2] + knee[2]))
        elbow, hand = (rear + 0.76, 0.25 * side, 1.10), (bar[0] + 0.02, 0.20 * side, bar[2] + 0.02)
        parts += [
            capsule_between((crank[0], 0.06 * side, crank[2]), (pedal[0], 0.06 * side, pedal[2]), 0.012, STEEL),
            capsule_between((hip[0], 0.09 * side, hip[2]), middle, 0.085, _BIB),
            capsule_between(middle, knee, 0.066, _SKIN),
            capsule_between(knee, ankle, 0.048, _SKIN),
            capsule_between(heel, toe, 0.036, _HELMET),
            capsule_between((shoulder[0], 0.18 * side, shoulder[2]), elbow, 0.046, _JERSEY),
            capsule_between(elbow, hand, 0.036, _SKIN),
        ]
    return tuple(parts)
