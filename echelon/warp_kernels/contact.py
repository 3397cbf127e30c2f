"""Forces on links: contact with a local plane, springs between links, joint limits, servos.

Every stiff force here is *implicit*: a spring and damper F = -K x - C v is evaluated at the end of the step,
v + h a and x + h (v + h a), which gives

    F = -K (x + h v) - C v - h (C + h K) a,

so that its last term adds h (C + h K) to the inertia of the link or joint it acts on. The articulated-body algorithm
carries that along at no cost (see `articulated.forward_dynamics`), and a stiff servo on a light toe, or stiff friction
under it, is stable at a millisecond. With h = 0 the same functions give the plain force; Runge-Kutta uses that.

Contact
-------
A site is a point, sphere or ellipsoid on a link; the ground is, for each site, a plane n . x = d (unit normal n, offset
d) that terrain hands in. The contact point is the site's deepest.

* **Normal**: N = k depth - c v_n, active from the moment of penetration until the force would pull: never adhesive.
  Since the implicit term acts on an acceleration that is not known yet, it is let in only as far as the load allows:
  its size is at most N / `PEEL_ACCELERATION`, so a surface torn away at up to that acceleration is never held back.
  The damper is let in no farther than that either: what is left of it would act explicitly, and shake a light toe.
* **Tangential**: a spring and damper from the *anchor*, the place where the foot last stuck. What is stored is the
  strain, the displacement from the anchor [m], as a vector in the world: it needs no rebasing when the origin floats.
  Its rate is the velocity of the material point that touches, so the same law serves a foot and a rolling wheel.
  Where spring and damper ask for more than friction times load the foot slides, and the anchor is dragged along. The
  implicit term while sliding is the derivative of the projection on the friction cone, which keeps the direction
  steady, and along it only as much as stops something light and slow within a step: the magnitude stays Coulomb's.
* **Spin**: a patch of some radius resists turning about the normal in the same way, by friction times load times
  2/3 of its radius (a disc under even pressure).
* **Rolling** resistance is a moment against any turning, a lever arm times the load: what brings a fallen body to rest
  on turf.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from echelon.warp_kernels.articulated import ContactLoad
from echelon.warp_kernels.kinematics import Kinematics
from echelon.warp_kernels.model import ContactSite, Joint, Model
from echelon.warp_kernels.spatial import (
    Matrix,
    Vector,
    add,
    apply,
    apply_transposed,
    cross,
    dot,
    is_zero,
    multiply,
    negate,
    norm,
    scale,
    skew,
    subtract,
    transpose,
)
from echelon.warp_kernels.trace import absolute, clamp, guarded, maximum, minimum, select, sqrt

PEEL_ACCELERATION = 30.0
"""Up to this acceleration of the site away from the ground, contact never pulls [m/s^2].

Torn away faster than that, a site with an implicit force may pull for a single substep. More would be safer there and
leave more of the damper out: 3 g lets a light toe come to rest.
"""

ROLL_RATE = 0.3
"""Turning slower than this, rolling resistance fades, so that it does not depend on a sign [rad/s]."""

SLIP_SPEED = 0.01
"""Speed below which the friction of a site without an anchor fades, so that it does not depend on a sign [m/s]."""


NO_MATRIX: Matrix = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]


@dataclass(frozen=True)
class Contact:
    """What one site feels.

    Attributes:
        load: Force and implicit inertia on the link.
        normal_force: Before the implicit correction, never negative [N].
        depth: Of penetration, negative above the plane [m].
        strain: New strain: three numbers in the world [m], and one angle [rad] if the site has a patch.
        strain_rate: Its rate while touching [m/s], [rad/s], for integrators that advance it themselves.
    """

    load: ContactLoad
    normal_force: Any
    depth: Any
    strain: Vector
    strain_rate: Vector


def strain_count(site: ContactSite) -> int:
    """How many state variables a site keeps."""
    if site.tangential_stiffness == 0.0:
        return 0
    return 4 if site.patch_radius > 0.0 else 3


def contact(
    kin: Kinematics,
    model: Model,
    site: ContactSite,
    plane: Sequence[Any],
    strain: Sequence[Any],
    step: Any,
    advance: Any,
) -> Contact:
    """Contact of one site with its local plane.

    Args:
        plane: n_x, n_y, n_z (unit) and offset d [m] of n . x = d in the world.
        strain: The site's strain at the end of the last step (see `Contact`).
        step: h of the implicit terms [s]; 0 for the plain force.
        advance: By how much the strain has grown since it was stored [s]: the step under semi-implicit Euler, 0
            where the integrator advances the strain itself.
    """
    place = kin.tree.node_of_link[model.link_index(site.link)]
    rotation, origin = kin.world(place)
    normal = apply_transposed(rotation, list(plane[:3]))
    point = add(list(site.position), _deepest(site, normal))
    height = dot(list(plane[:3]), origin) - plane[3] + dot(normal, point)
    touching = height < 0.0
    implicit_step = 0.0 if site.integration == "explicit" else step
    if site.use == "usual":
        return _touch(kin, model, site, plane, strain, implicit_step, advance, normal, point, height, touching)
    # A rare site: all that follows is skipped while nobody touches.
    found = _touch(kin, model, site, plane, strain, implicit_step, advance, normal, point, height, touching)
    load = found.load
    blocks = [*_upper(load.inertia), *_entries(load.coupling), *_upper(load.mass)] if not is_zero(implicit_step) else []
    values = [*load.moment, *load.force, found.normal_force, *found.strain, *found.strain_rate, *blocks]
    values = guarded(touching, values)
    moment, force, N = values[0:3], values[3:6], values[6]
    count = len(found.strain)
    strains, rates = values[7 : 7 + count], values[7 + count : 7 + 2 * count]
    if blocks:
        rest = values[7 + 2 * count :]
        load = ContactLoad(
            moment, force, _from_upper(rest[0:6]), [rest[6:9], rest[9:12], rest[12:15]], _from_upper(rest[15:21])
        )
    else:
        load = ContactLoad(moment, force, load.inertia, load.coupling, load.mass)
    return Contact(load, N, -height, strains, rates)


def _touch(
    kin: Kinematics,
    model: Model,
    site: ContactSite,
    plane: Sequence[Any],
    strain: Sequence[Any],
    step: Any,
    advance: Any,
    normal: Vector,
    point: Vector,
    height: Any,
    touching: Any,
) -> Contact:
    """The contact of a site whose contact point and height over the plane are known; normal and point in link axes."""
    place = kin.tree.node_of_link[model.link_index(site.link)]
    rotation, _ = kin.world(place)
    omega = kin.omega[place]
    n = list(plane[:3])
    # Velocity of the material point that touches, along the world's axes, and its parts.
    slip = add(kin.world_velocity(place), apply(rotation, cross(omega, point)))
    v_n = dot(n, slip)
    v_t = _tangential(slip, v_n, n)

    # Normal: spring and damper at the end of the step, never pulling.
    k, c = site.stiffness, site.damping
    B_n: Any = 0.0
    if is_zero(step):
        N = select(touching, maximum(-k * height - c * v_n, 0.0), 0.0)
    else:
        spring = maximum(-k * height, 0.0)
        damper = minimum(c + step * k, spring * (1.0 / (PEEL_ACCELERATION * step)))
        N = maximum(spring - damper * v_n, 0.0)
        B_n = minimum(step * damper, N * (1.0 / PEEL_ACCELERATION))

    force, B, new_strain = _friction(rotation, normal, n, v_t, N, site, strain, step, advance)
    force = apply_transposed(rotation, add(force, scale(N, n)))
    # B acts on the acceleration of the contact point: a + alpha x r, and w x (w x r) which is known.
    if not is_zero(step):
        B = [[B[i][j] + B_n * (normal[i] * normal[j]) for j in range(3)] for i in range(3)]
    moment, torsion = _spin_friction(normal, omega, N, site, strain, step, advance)
    rate: Vector = []
    if strain_count(site) >= 3:
        rate = [0.0 if is_zero(x) else select(touching, x, 0.0) for x in v_t]
    if strain_count(site) == 4:
        new_strain = [*new_strain, torsion[1]]
        rate = [*rate, select(touching, dot(normal, omega), 0.0)]
    load = _load(kin, place, model, rotation, site, point, force, B, moment, torsion[0], normal)
    if site.rolling_resistance > 0.0:
        slowing = (-site.rolling_resistance * N) / maximum(norm(omega), ROLL_RATE)
        turning = [a + slowing * w for a, w in zip(load.moment, omega, strict=True)]
        load = ContactLoad(turning, load.force, load.inertia, load.coupling, load.mass)
    return Contact(load, N, -height, new_strain, rate)


def _entries(matrix: Matrix) -> list[Any]:
    return [entry for row in matrix for entry in row]


def _upper(matrix: Matrix) -> list[Any]:
    return [matrix[i][j] for i in range(3) for j in range(i, 3)]


def _from_upper(entries: Sequence[Any]) -> Matrix:
    a, b, c, d, e, f = entries
    return [[a, b, c], [b, d, e], [c, e, f]]


def _deepest(site: ContactSite, normal: Vector) -> Vector:
    """From the site's centre to its deepest point against a plane of this normal, in the link's axes."""
    a, b, c = site.radii
    if a == b == c:
        return scale(-a, normal)
    # Support point of an ellipsoid: -A^2 n / |A n|; the length cannot vanish, the normal being a unit vector.
    squares = (a * a, b * b, c * c)
    stretched = [squares[i] * normal[i] for i in range(3)]
    length = sqrt(maximum(dot(stretched, normal), 1e-12))
    return scale(-1.0 / length, stretched)


def _travel(site: ContactSite, normal: Vector, omega: Vector, point: Vector) -> Vector:
    """Velocity of the contact point beside that of the link's origin, along the link's axes.

    Over a rounded site the point moves as the link turns above it: under the axle of a wheel it is always the lowest,
    and what touches next is not the material that is torn upwards there at omega^2 r.
    """
    a, b, c = site.radii
    if a == b == c:
        return cross(omega, list(site.position))
    # The derivative of the support point by the normal, which turns by -omega x n in the link's axes.
    squares = (a * a, b * b, c * c)
    turn = cross(omega, normal)
    stretched = [squares[i] * normal[i] for i in range(3)]
    length = sqrt(maximum(dot(stretched, normal), 1e-12))
    inverse = 1.0 / length
    along = dot(stretched, turn) * (inverse * inverse)
    rolled = [inverse * (squares[i] * turn[i] - along * stretched[i]) for i in range(3)]
    return add(cross(omega, point), rolled)


def _tangential(vector: Vector, along: Any, n: Vector) -> Vector:
    """A vector without its part along n, which is given; exactly zero there if n is a structural axis."""
    return [0.0 if isinstance(n[i], float) and n[i] == 1.0 else vector[i] - along * n[i] for i in range(3)]


def _friction(
    rotation: Matrix,
    normal: Vector,
    n: Vector,
    v_t: Vector,
    N: Any,
    site: ContactSite,
    strain: Sequence[Any],
    step: Any,
    advance: Any,
) -> tuple[Vector, Matrix, Vector]:
    """Tangential force along the world's axes, its implicit matrix in the link's, and the new strain.

    ``normal`` is the plane's normal in the link's axes, ``n`` in the world's.
    """
    limit = site.friction * N
    c = site.tangential_damping
    if site.tangential_stiffness == 0.0:
        speed = sqrt(dot(v_t, v_t))
        factor = limit / maximum(speed, SLIP_SPEED)
        along = [[(1.0 if i == j else 0.0) - normal[i] * normal[j] for j in range(3)] for i in range(3)]
        if is_zero(step):
            return scale(-factor, v_t), NO_MATRIX, []
        return scale(-factor, v_t), [[(step * factor) * entry for entry in row] for row in along], []
    k = site.tangential_stiffness
    # The strain of the present positions, without what turned out of the plane.
    s = add(list(strain[:3]), scale(advance, v_t))
    s = _tangential(s, dot(s, n), n)
    trial = add(scale(k, s), scale(c + step * k, v_t))
    size = sqrt(dot(trial, trial))
    sliding = limit <= size  # in the air as well, where both may be zero
    inverse_size = 1.0 / maximum(size, 1e-9)
    ratio = select(sliding, limit * inverse_size, 1.0)
    force = scale(-ratio, trial)
    B = NO_MATRIX
    if not is_zero(step):
        # Sticking: B_t (1 - n n^T). Sliding: B_t (1 - n n^T - t t^T), the derivative of the projection on the cone, and
        # along t so much that friction stops what is light and slow within a step, but does not throw it back.
        B_t = ratio * (step * (c + step * k))
        B_along = minimum(B_t, step * limit / maximum(norm(v_t), 1e-9))
        less = select(sliding, B_t - B_along, 0.0)
        t = apply_transposed(rotation, scale(inverse_size, trial))
        B = [
            [B_t * ((1.0 if i == j else 0.0) - normal[i] * normal[j]) - less * (t[i] * t[j]) for j in range(3)]
            for i in range(3)
        ]
    # Sliding drags the anchor: spring and damper together give just the limit, the spring what the damper leaves of it.
    touching = N > 0.0
    left = maximum(limit - c * (dot(v_t, trial) * inverse_size), 0.0) * (inverse_size * (1.0 / k))
    new: Vector = []
    for i in range(3):
        dragged = left * trial[i]
        new.append(0.0 if is_zero(v_t[i]) else select(touching, select(sliding, dragged, s[i]), 0.0))
    return force, B, new


def _spin_friction(
    normal: Vector, omega: Vector, N: Any, site: ContactSite, strain: Sequence[Any], step: Any, advance: Any
) -> tuple[Any, tuple[Any, Any]]:
    """Moment about the normal, (its implicit coefficient, the new twist)."""
    if strain_count(site) < 4:
        return 0.0, (0.0, 0.0)
    radius = site.patch_radius
    k, c = site.tangential_stiffness * radius * radius, site.tangential_damping * radius * radius
    limit = (2.0 / 3.0 * radius * site.friction) * N
    rate = dot(normal, omega)
    twist = strain[3] + advance * rate
    trial = k * twist + (c + step * k) * rate
    moment = -clamp(trial, -limit, limit)
    sliding = (limit <= trial) | (trial <= -limit)
    B: Any = 0.0
    if not is_zero(step):
        B = step * (c + step * k)
        B = select(sliding, minimum(B, step * limit / maximum(absolute(rate), 1e-9)), B)
    left = -moment - c * rate
    dragged = select(left * moment < 0.0, left * (1.0 / k), 0.0)
    new = select(N > 0.0, select(sliding, dragged, twist), 0.0)
    return moment, (B, new)


def _load(
    kin: Kinematics,
    place: int,
    model: Model,
    rotation: Matrix,
    site: ContactSite,
    point: Vector,
    force: Vector,
    B: Matrix,
    moment: Any,
    B_spin: Any,
    normal: Vector,
) -> ContactLoad:
    """Force at a point, its implicit matrix B, and a moment about the normal, carried to the link's origin."""
    if B is NO_MATRIX:
        turning = cross(point, force)
        if not is_zero(moment):
            turning = add(turning, scale(moment, normal))
        return ContactLoad(turning, force, NO_MATRIX, NO_MATRIX, NO_MATRIX)
    rx = skew(point)
    coupling = multiply(rx, B)
    inertia = multiply(coupling, transpose(rx))
    if not is_zero(B_spin):
        inertia = [[inertia[i][j] + B_spin * (normal[i] * normal[j]) for j in range(3)] for i in range(3)]
    inertia = [[inertia[min(i, j)][max(i, j)] for j in range(3)] for i in range(3)]
    mass = [[B[min(i, j)][max(i, j)] for j in range(3)] for i in range(3)]
    # How fast the velocity at the contact changes: the algorithm's acceleration, plus gravity, plus a centripetal part.
    omega = kin.omega[place]
    gravity = scale(-model.gravity, [rotation[2][0], rotation[2][1], rotation[2][2]])
    known = add(gravity, cross(omega, _travel(site, normal, omega, point)))
    force = subtract(force, apply(mass, known))
    turning = cross(point, force)
    if not is_zero(moment):
        turning = add(turning, scale(moment, normal))
    return ContactLoad(turning, force, inertia, coupling, mass)


# ---- springs between links -----------------------------------------------------------------------------------------
def spring_forces(
    kin: Kinematics, model: Model, factors: Mapping[str, Any] | None = None
) -> dict[int, list[tuple[Vector, Vector]]]:
    """(moment, force) on each link from the model's springs, in the link's axes about its origin; explicit.

    Args:
        factors: By name of a spring, what its force is multiplied by; 1 for those that are not named.
    """
    result: dict[int, list[tuple[Vector, Vector]]] = {}
    for spring in model.springs:
        ends = []
        for name, position in ((spring.link_a, spring.position_a), (spring.link_b, spring.position_b)):
            if name is None:
                ends.append((None, list(position), [0.0, 0.0, 0.0], list(position)))
                continue
            place = kin.tree.node_of_link[model.link_index(name)]
            rotation, origin = kin.world(place)
            velocity = add(kin.world_velocity(place), apply(rotation, cross(kin.omega[place], list(position))))
            ends.append((name, add(origin, apply(rotation, list(position))), velocity, list(position)))
        gap = subtract(ends[1][1], ends[0][1])
        rate = subtract(ends[1][2], ends[0][2])
        if spring.rest_length == 0.0:
            on_a = add(scale(spring.stiffness, gap), scale(spring.damping, rate))
            # Not along the gap, so both act in its middle: angular momentum is kept.
            arms = scale(0.5, gap), scale(-0.5, gap)
        else:
            length = sqrt(maximum(dot(gap, gap), 1e-12))
            along = scale(1.0 / length, gap)
            on_a = scale(spring.stiffness * (length - spring.rest_length) + spring.damping * dot(rate, along), along)
            arms = None, None
        if factors and spring.name in factors:
            on_a = scale(factors[spring.name], on_a)
        for (name, _, _, position), force, arm in zip(ends, (on_a, negate(on_a)), arms, strict=True):
            if name is None:
                continue
            link = model.link_index(name)
            rotation, _ = kin.world(kin.tree.node_of_link[link])
            local = apply_transposed(rotation, force)
            point = position if arm is None else add(position, apply_transposed(rotation, arm))
            result.setdefault(link, []).append((cross(point, local), local))
    return result


# ---- joints --------------------------------------------------------------------------------------------------------
@dataclass
class JointForces:
    """Generalised forces and what their implicit part adds to each joint's inertia, one entry a speed."""

    tau: list[Any]
    implicit: list[Any]

    @classmethod
    def none(cls, count: int) -> JointForces:
        return cls([0.0] * count, [0.0] * count)

    def servo(
        self,
        speed: int,
        q: Any,
        u: Any,
        desired: Any,
        desired_rate: Any,
        kp: Any,
        kv: Any,
        step: Any,
        strength: tuple[Any, Any] | None = None,
    ) -> None:
        """Add the servo tau = kp (desired - q) + kv (desired_rate - u) of a one-axis joint, implicitly.

        Equation 6 of *Animating Human Athletics*. kp [N m/rad], kv [N m s/rad] (or N/m, N s/m). It is no stronger than
        `strength`, its greatest torque towards smaller (not positive) and towards greater values.
        """
        self._drive(speed, kp * (desired - q - step * u) + kv * (desired_rate - u), step * (kv + step * kp), strength)

    def _drive(self, speed: int, tau: Any, implicit: Any, strength: tuple[Any, Any] | None) -> None:
        """Add a torque and what it gives up for acceleration; one at the end of its strength gives up nothing."""
        if strength is not None:
            weakest, strongest = strength
            beyond = (tau < weakest) | (strongest < tau)
            tau, implicit = clamp(tau, weakest, strongest), select(beyond, 0.0, implicit)
        self.tau[speed] = self.tau[speed] + tau
        self.implicit[speed] = self.implicit[speed] + implicit

    def ball_servo(
        self,
        speed: int,
        quaternion: Vector,
        omega: Vector,
        desired: Vector,
        kp: Any,
        kv: Any,
        step: Any,
        strength: Sequence[tuple[Any, Any]] | None = None,
    ) -> None:
        """The same for a ball joint, towards a desired orientation (x, y, z, w) at rest; turns the shorter way.

        `strength` is that of each of its three speeds.
        """
        # Error quaternion from the present to the desired orientation, in the link's axes: conj(q) * desired.
        x, y, z, w = [-quaternion[0], -quaternion[1], -quaternion[2], quaternion[3]]
        dx, dy, dz, dw = desired
        error = [
            w * dx + x * dw + y * dz - z * dy,
            w * dy - x * dz + y * dw + z * dx,
            w * dz + x * dy - y * dx + z * dw,
        ]
        cosine = w * dw - x * dx - y * dy - z * dz
        sign = select(cosine < 0.0, -2.0, 2.0)
        for i in range(3):
            torque = kp * (sign * error[i] - step * omega[i]) - kv * omega[i]
            self._drive(speed + i, torque, step * (kv + step * kp), None if strength is None else strength[i])

    def limits(self, model: Model, q: Sequence[Any], u: Sequence[Any], step: Any) -> None:
        """Add the springs and dampers that hold joints within their limits; they push back, never pull."""
        found: list[tuple[int, Any, Any, Any]] = []
        for index, link in enumerate(model.links):
            joint: Joint = link.joint
            for axis, limit in enumerate(joint.limits):
                if limit is None or joint.limit_stiffness == 0.0:
                    continue
                at_q, at_u = model.q_start(index) + axis, model.u_start(index) + axis
                k, c = joint.limit_stiffness, joint.limit_damping
                beyond = q[at_q] - clamp(q[at_q], limit[0], limit[1])
                push = -k * (beyond + step * u[at_u]) - c * u[at_u]
                outside = (q[at_q] < limit[0]) | (limit[1] < q[at_q])
                active = ((beyond > 0.0) & (push < 0.0)) | ((beyond < 0.0) & (push > 0.0))
                found.append((at_u, outside, select(active, push, 0.0), select(active, step * (c + step * k), 0.0)))
        if not found:
            return
        # Limits are rarely met, by any joint of any agent.
        somewhere = found[0][1]
        for _, outside, _, _ in found[1:]:
            somewhere = somewhere | outside
        values = guarded(somewhere, [value for _, _, push, extra in found for value in (push, extra)])
        for place, (at_u, *_) in enumerate(found):
            self.tau[at_u] = self.tau[at_u] + values[2 * place]
            self.implicit[at_u] = self.implicit[at_u] + values[2 * place + 1]
