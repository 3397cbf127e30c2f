"""Contact between characters: a neighbour enters the frame as a ghost, a capsule with mass.

Within a frame an agent is alone. Its neighbours are there all the same, as *ghosts*: rigid bodies that start from
where the neighbours were at the beginning of the frame, move freely, and are pushed by the force that they push with.
Each of two who meet computes the whole encounter for itself, the other's ghost beside its own body, and keeps only
what happens to itself. Nobody waits, nobody writes into another's state, and yet both feel nearly the same impulse,
since both compute the same force from the same numbers:

        what A computes                 what B computes

        A  --F->  <-F--  ghost of B     ghost of A  --F->  <-F--  B
        ^ kept                                                    ^ kept

(A ghost that moves on rails is an infinite mass: two equal bodies then bounce with twice the speed.)

What a ghost lacks of the neighbour is its joints and its control. So it is given the neighbour's *apparent mobility*
(`bumper`): how fast its first link is set in motion by a blow as long as a contact lasts, with everything that hangs
on it. With that the rest is the mechanics of two rigid bodies:

* **Geometry**: the points of two capsules' axes that are closest. Axes that run side by side have no such points; a
  small pull of each towards the middle of its axis chooses the middle of where they overlap, and nothing jumps. What
  pulls is counted as distance, which makes barrels of capsules, a few millimetres thinner at their ends: depth is then
  the least of something, its rate is the velocity along the normal, and the spring gives back what it took.
* **Normal force**: N = k depth - c v, never adhesive. k follows from the *effective mass* mu of the pair at the place
  and in the direction of the contact, mu^-1 = n . (K_a + K_b) n with K the mobility of the touching point, so that
  each contact lasts as long as any other, pi / omega; it is kept as it is until the contact ends or the frame does.
  c = 2 zeta sqrt(k mu), zeta chosen for the wanted restitution (`restitution_damping`). The damper is taken at the
  end of the step, as in `contact`, which makes any c stable; the spring is not, or it would swallow energy.
* **Friction**: Coulomb's, against the slip; near rest only as much as takes away a part of the slip in a step, so
  that it does not depend on a sign.
* **Overlap** that was there when the frame began and that no blow explains (somebody stood up beneath another, a third
  has pushed) is pushed apart, not shot: the spring holds what it held when the last frame ended, and the rest is
  worked off in a few frames at a gentle speed.
* **Settling**: when a frame is over each has written down what it gave to whom. Where the two accounts of an encounter
  differ, as they do when a third was hit by one of them within the frame, each is given half of the difference at the
  beginning of the next frame. So momentum is kept in the long run, whatever each has left out.

All of it is written over scalars, as the rest of the dynamics is (see `trace`): NumPy computes with it, and `program`
emits it, in a part of its own that a block without neighbours within reach skips. Ghosts do not push one another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from echelon.warp_kernels.character import Capsule
from echelon.warp_kernels.spatial import (
    Matrix,
    Vector,
    add,
    apply,
    apply_transposed,
    cross,
    dot,
    negate,
    quaternion_matrix,
    quaternion_normalized,
    quaternion_product,
    scale,
    subtract,
)
from echelon.warp_kernels.trace import absolute, clamp, maximum, minimum, select, sqrt

GHOSTS = 6
"""Neighbours that an agent meets in a frame, at most: as many discs touch a disc of their size."""

GHOST_MOTION = 18
"""Numbers of a ghost: place, attitude, velocity, spin, how it falls, and what it was given (see `Ghost`)."""

PAIR_MEMORY = 3
"""Numbers kept of each pair of capsules within a frame (see `PairMemory`)."""

UNDECIDED = -1.0
"""Stiffness of a pair that has not been looked at in this frame."""

CONTACT_TIME = 0.010
"""How long two characters touch who bounce off each other [s]."""

STEPS_IN_CONTACT = 8
"""A contact lasts at least so many substeps: omega h is then below 0.4."""

SHOVE_RATE = 30.0
"""Whoever overlaps for no good reason when a frame begins parts by this share of the overlap a second [1/s]."""

SHOVE_SPEED = 1.5
"""But no faster than this [m/s]."""

SIDE_BY_SIDE = 0.004
"""Pull of a closest point towards the middle of its axis, as a part of what holds the two points together."""

SLIP_PART = 0.3
"""Friction takes away no more than this part of the slip in a substep."""

MOBILITY_SIZE = 6


@dataclass(frozen=True)
class Bumper:
    """A character as others meet it, in its first link's axes.

    Attributes:
        capsules: That others touch.
        center: Of the whole character's mass, as it usually stands [m].
        mobility: Apparent mobility about that centre: rates of its velocity and of the spin per force and moment,
            symmetric, shape [6, 6] [1/kg], [1/(kg m)], [1/(kg m^2)].
        spin_inertia: Inverse of its angular block, shape [3, 3] [kg m^2].
        reach: Farthest that any capsule comes from the centre [m].
        radius: Of the thickest capsule [m].
    """

    capsules: tuple[Capsule, ...]
    center: tuple[float, float, float]
    mobility: tuple[tuple[float, ...], ...]
    spin_inertia: tuple[tuple[float, ...], ...]
    reach: float
    radius: float

    @property
    def about_center(self) -> tuple[Capsule, ...]:
        """The capsules, from the centre of mass."""
        return tuple(Capsule(_less(c.start, self.center), _less(c.end, self.center), c.radius) for c in self.capsules)

    @property
    def pair_count(self) -> int:
        """How many pairs of capsules two of a kind have."""
        return len(self.capsules) ** 2


@dataclass(frozen=True)
class RigidMotion:
    """A body that can be touched, as scalars of any kind.

    Attributes:
        place: Of its centre of mass [m].
        rotation: Matrix from its axes to the world's.
        velocity: Of its centre [m/s], world axes.
        spin: Angular velocity [rad/s], its own axes.
    """

    place: Vector
    rotation: Matrix
    velocity: Vector
    spin: Vector


@dataclass(frozen=True)
class Ghost:
    """A neighbour as an agent meets it.

    Attributes:
        place: Of its centre of mass, relative to the agent's floating origin [m].
        attitude: Quaternion (x, y, z, w) from its axes to the world's.
        velocity: Of its centre [m/s], world axes.
        spin: Angular velocity [rad/s], its own axes.
        gravity: Its acceleration along z while nothing touches it: 0 where something carries it [m/s^2].
        floor: Velocity along z that it does not fall below, for who lies on the ground [m/s].
        given: Impulse that it got from the agent in this frame, world axes [N s].
    """

    place: Vector
    attitude: Vector
    velocity: Vector
    spin: Vector
    gravity: Any
    floor: Any
    given: Vector

    @classmethod
    def of(cls, values: Sequence[Any]) -> Ghost:
        """From the `GHOST_MOTION` numbers that it is kept as."""
        v = list(values)
        return cls(v[0:3], v[3:7], v[7:10], v[10:13], v[13], v[14], v[15:18])

    @property
    def values(self) -> list[Any]:
        """The numbers that it is kept as."""
        return [*self.place, *self.attitude, *self.velocity, *self.spin, self.gravity, self.floor, *self.given]

    @property
    def motion(self) -> RigidMotion:
        """As a body that can be touched."""
        return RigidMotion(self.place, quaternion_matrix(self.attitude), self.velocity, self.spin)


@dataclass(frozen=True)
class Law:
    """What a contact is like; the first is fixed by the substep, the others are the crowd's.

    Attributes:
        omega: Angular frequency of the spring on the effective mass [rad/s].
        damping_ratio: zeta, of the restitution that is wanted (see `restitution_damping`).
        friction: Coulomb coefficient.
    """

    omega: float
    damping_ratio: Any
    friction: Any


@dataclass(frozen=True)
class CapsulePair:
    """One capsule of each of two bodies, in their axes from their centres of mass [m].

    Attributes:
        own_start, own_end, own_radius: Of the agent's.
        other_start, other_end, other_radius: Of the ghost's.
    """

    own_start: Vector
    own_end: Vector
    own_radius: Any
    other_start: Vector
    other_end: Vector
    other_radius: Any


@dataclass(frozen=True)
class PairMemory:
    """What is kept of a pair of capsules from one substep of a frame to the next.

    Attributes:
        stiffness: Of the present contact [N/m]; 0 apart, `UNDECIDED` when the frame begins.
        slack: Overlap when the frame began that no blow explains, and that is not pressed into the spring [m].
        pressed: How far the spring is pressed after the substep, 0 apart [m].
    """

    stiffness: Any
    slack: Any
    pressed: Any


@dataclass(frozen=True)
class Touch:
    """What one pair of capsules does to both.

    Attributes:
        force: On the agent, world axes; the ghost is pushed the other way [N].
        own_arm, other_arm: From each centre of mass to where the force acts, world axes [m].
        depth: By how much the capsules overlap, negative apart [m].
        touching: Whether they touch.
        memory: To be kept for the next substep.
    """

    force: Vector
    own_arm: Vector
    other_arm: Vector
    depth: Any
    touching: Any
    memory: PairMemory


def _less(point: Sequence[float], origin: Sequence[float]) -> tuple[float, float, float]:
    return (point[0] - origin[0], point[1] - origin[1], point[2] - origin[2])


# ---- geometry --------------------------------------------------------------------------------------------------------
def closest_points(start: Vector, along: Vector, other_start: Vector, other_along: Vector) -> tuple[Any, Any, Any]:
    """Where two line segments are closest, from 0 at their starts to 1 at their ends, and how much barrels are thinner.

    It minimises |p - q|^2 + `SIDE_BY_SIDE` (|a|^2 (s - 1/2)^2 + |b|^2 (t - 1/2)^2) for p = start + s along and
    q = other_start + t other_along: both segments alike, exactly, and without a jump where they are parallel. The
    second term comes third [m^2].
    """
    gap = subtract(start, other_start)
    # From the middles: s and t below run from -1/2 to 1/2.
    gap = [g + 0.5 * (a - b) for g, a, b in zip(gap, along, other_along, strict=True)]
    aa = maximum(dot(along, along), 1e-8) * (1.0 + SIDE_BY_SIDE)
    bb = maximum(dot(other_along, other_along), 1e-8) * (1.0 + SIDE_BY_SIDE)
    ab = dot(along, other_along)
    ag, bg = dot(along, gap), dot(other_along, gap)
    # The regularised determinant is never less than about 1 % of aa bb.
    s = clamp((ab * bg - bb * ag) / (aa * bb - ab * ab), -0.5, 0.5)
    t = clamp((ab * s + bg) / bb, -0.5, 0.5)
    s = clamp((ab * t - ag) / aa, -0.5, 0.5)
    pull = SIDE_BY_SIDE / (1.0 + SIDE_BY_SIDE)
    return s + 0.5, t + 0.5, pull * (aa * (s * s) + bb * (t * t))


# ---- forces ----------------------------------------------------------------------------------------------------------
def touch(
    own: RigidMotion,
    other: RigidMotion,
    pair: CapsulePair,
    memory: PairMemory,
    mobility: Sequence[Sequence[float]],
    other_mobility: Sequence[Sequence[float]],
    law: Law,
    step: float,
) -> Touch:
    """Force between two capsules.

    Args:
        own, other: The bodies.
        pair: Which capsules.
        memory: What was kept of them.
        mobility, other_mobility: Apparent mobilities, symmetric 6 x 6 in each body's axes: rates of the velocity of
            the centre of mass and of the spin, for a force there and a moment [1/kg], [1/(kg m)], [1/(kg m^2)].
        law: What the contact is like.
        step: h [s].
    """
    start, along = _in_world(own, pair.own_start, pair.own_end)
    other_start, other_along = _in_world(other, pair.other_start, pair.other_end)
    s, t, barrel = closest_points(add(own.place, start), along, add(other.place, other_start), other_along)
    axis = add(start, scale(s, along))
    other_axis = add(other_start, scale(t, other_along))
    apart = add(subtract(own.place, other.place), subtract(axis, other_axis))
    square = dot(apart, apart)
    between = scale(1.0 / sqrt(maximum(square, 1e-12)), apart)
    distance = sqrt(maximum(square + barrel, 1e-12))
    n = scale(1.0 / distance, apart)  # from the ghost to the agent: how fast the distance grows as they part
    depth = pair.own_radius + pair.other_radius - distance
    # Half way between the two surfaces.
    own_arm = subtract(axis, scale(pair.own_radius - 0.5 * depth, between))
    other_arm = add(other_axis, scale(pair.other_radius - 0.5 * depth, between))

    slip = subtract(_velocity_at(own, own_arm), _velocity_at(other, other_arm))
    v_n = dot(n, slip)
    v_t = subtract(slip, scale(dot(between, slip), between))
    mu = 1.0 / (point_mobility(mobility, own, own_arm, n) + point_mobility(other_mobility, other, other_arm, n))

    # What was pressed into the spring in the frame before it may give back; whatever else overlaps is not pressed in.
    fresh = memory.stiffness < 0.0
    slack = select(fresh, maximum(depth - memory.pressed, 0.0), memory.slack)
    spring = depth - slack
    touching = spring > 0.0
    k = select(memory.stiffness > 0.0, memory.stiffness, law.omega * law.omega * mu)
    # In the first substep the damper acts as far as the touch is old: that one of the two sees it a step earlier, by a
    # rounding, then makes no difference.
    entered = minimum(spring / maximum(step * absolute(v_n), 1e-9), 1.0)
    c = (2.0 * law.damping_ratio) * sqrt(k * mu) * maximum(entered, 0.0)
    N = maximum((k * spring - c * v_n) / (1.0 + step * c / mu), 0.0)
    N = select(touching, N, 0.0)
    # The slack is worked off at a speed, not by a spring.
    overlap = minimum(slack, depth)
    parting = minimum(SHOVE_RATE * overlap, SHOVE_SPEED)
    shove = (SLIP_PART / step) * mu * (parting - maximum(v_n, 0.0))
    N = select(overlap > 0.0, maximum(N, shove), N)

    speed = sqrt(dot(v_t, v_t))
    slipping = scale(1.0 / maximum(speed, 1e-6), v_t)
    side = point_mobility(mobility, own, own_arm, slipping)
    side = side + point_mobility(other_mobility, other, other_arm, slipping)
    resisted = minimum(law.friction * N, (SLIP_PART / step) * speed / maximum(side, 1e-6))
    force = [N * a - resisted * b for a, b in zip(n, slipping, strict=True)]
    # How far it will be pressed once both have moved on.
    pressed = maximum(spring - step * (v_n + step * N / mu), 0.0)
    kept = PairMemory(select(touching, k, 0.0), slack, pressed)
    return Touch(force, own_arm, other_arm, depth, touching | (overlap > 0.0), kept)


def point_mobility(mobility: Sequence[Sequence[float]], body: RigidMotion, arm: Vector, direction: Vector) -> Any:
    """How fast a point of a body is set in motion along a direction by a force along it [1/kg].

    Args:
        mobility: Apparent mobility of the body (see `touch`).
        arm: From its centre of mass to the point, world axes [m].
        direction: World axes; of any length, which counts twice.
    """
    force = apply_transposed(body.rotation, direction)
    blow = [*force, *cross(apply_transposed(body.rotation, arm), force)]
    total: Any = 0.0
    for i in range(MOBILITY_SIZE):
        # The matrix is symmetric: what stands beside its diagonal counts twice.
        row = 0.5 * mobility[i][i] * blow[i]
        for j in range(i + 1, MOBILITY_SIZE):
            if mobility[i][j] != 0.0:
                row = row + mobility[i][j] * blow[j]
        total = total + (2.0 * blow[i]) * row
    return total


def _in_world(body: RigidMotion, start: Vector, end: Vector) -> tuple[Vector, Vector]:
    """Start of a segment, from the body's centre, and the way to its end; world axes."""
    return apply(body.rotation, start), apply(body.rotation, subtract(end, start))


def _velocity_at(body: RigidMotion, arm: Vector) -> Vector:
    return add(body.velocity, cross(apply(body.rotation, body.spin), arm))


# ---- what becomes of both --------------------------------------------------------------------------------------------
def root_motion(
    place: Vector, attitude: Vector, velocity: Vector, spin: Vector, center: Sequence[float]
) -> RigidMotion:
    """The agent's own first link as a body that can be touched.

    Args:
        place, attitude, velocity, spin: Its four parts of q and u (see `model`).
        center: The whole character's centre of mass in the link's axes [m].
    """
    rotation = quaternion_matrix(attitude)
    arm = apply(rotation, list(center))
    carried = apply(rotation, cross(spin, list(center)))
    return RigidMotion(add(place, arm), rotation, add(velocity, carried), spin)


def root_wrench(own: RigidMotion, found: Touch, center: Sequence[float]) -> Vector:
    """What a touch does to the agent: moment about its first link's origin [N m] and force [N], in the link's axes."""
    force = apply_transposed(own.rotation, found.force)
    arm = add(list(center), apply_transposed(own.rotation, found.own_arm))
    return [*cross(arm, force), *force]


def ghost_wrench(other: RigidMotion, found: Touch) -> Vector:
    """What a touch does to the ghost: force [N], and moment about its centre of mass [N m], in its axes."""
    force = negate(apply_transposed(other.rotation, found.force))
    return [*force, *cross(apply_transposed(other.rotation, found.other_arm), force)]


def moved_ghost(
    ghost: Ghost,
    wrench: Vector,
    mobility: Sequence[Sequence[float]],
    spin_inertia: Sequence[Sequence[float]],
    step: float,
) -> Ghost:
    """A ghost one substep later, by semi-implicit Euler.

    Args:
        ghost: As it was.
        wrench: Sum of what touches do to it (see `ghost_wrench`).
        mobility: Its apparent mobility.
        spin_inertia: Inverse of the mobility's angular block, which makes a spinning body tumble [kg m^2].
        step: [s].
    """
    rotation = quaternion_matrix(ghost.attitude)
    tumbling = negate(cross(ghost.spin, apply([list(row) for row in spin_inertia], ghost.spin)))
    blow = [*wrench[:3], *add(list(wrench[3:]), tumbling)]
    rate = [dot(list(mobility[i]), blow) for i in range(3)]
    turning = [dot(list(mobility[3 + i]), blow) for i in range(3)]
    velocity = add(ghost.velocity, scale(step, apply(rotation, rate)))
    velocity[2] = maximum(velocity[2] + step * ghost.gravity, ghost.floor)
    spin = add(ghost.spin, scale(step, turning))
    attitude = quaternion_normalized(quaternion_product(ghost.attitude, [*scale(0.5 * step, spin), 1.0]))
    place = add(ghost.place, scale(step, velocity))
    given = add(ghost.given, scale(step, apply(rotation, list(wrench[:3]))))
    return Ghost(place, attitude, velocity, spin, ghost.gravity, ghost.floor, given)


def settling_wrench(own: RigidMotion, due: Vector, substep: Any, center: Sequence[float], step: float) -> Vector:
    """What brings an agent, in the first substep of a frame, what it is due from the frame before.

    Args:
        own: The agent.
        due: Impulse that it is due, world axes [N s].
        substep: Which of the frame this is, from 0.
        center: The whole character's centre of mass in the link's axes [m].
        step: h [s].

    Returns:
        Moment about its first link's origin [N m] and force [N], in the link's axes.
    """
    share = select(substep < 0.5, 1.0 / step, 0.0)
    force = apply_transposed(own.rotation, scale(share, due))
    return [*cross(list(center), force), *force]
