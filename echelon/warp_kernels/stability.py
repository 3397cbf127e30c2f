"""Before anything runs: are a body's explicit forces gentle enough for the step?

Semi-implicit Euler takes servos, joint limits and implicit contacts implicitly, and those are stable whatever they
are. Springs between links and contacts with explicit integration are not: a spring k and damper c that act on a mass m
follow a step h only while h sqrt(k / m) and h c / m stay well under one. What m is depends on where and in which
direction the force acts: pushing a toe sideways moves less mass than pushing the pelvis. With J the Jacobian of the
velocity that the force resists and M the mass matrix, the *effective mass* along a direction n is

    m = 1 / (n^T J M^-1 J^T n),

here taken in the reference pose, with every joint loose; servos only add to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from echelon.warp_kernels.model import ContactSite, ModelError, Spring
from echelon.warp_kernels.reference import Body

SPRING_LIMIT = 0.5
"""Largest h sqrt(k / m) and h c / m of a spring between links."""

CONTACT_LIMIT = 0.6
"""The same of an explicit contact, which acts for a moment and not for ever."""

_ALL = np.eye(3)
_UP = np.array([[0.0, 0.0, 1.0]])
_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class _Force:
    """One spring and damper and the least mass that it may act on.

    Attributes:
        name: As a message calls it.
        stiffness, damping: [N/m], [N s/m]; of a patch [N m/rad], [N m s/rad].
        mass: Effective mass [kg]; of a patch, inertia [kg m^2].
        limit: Largest h sqrt(k / m) and h c / m.
        angular: Whether it is a patch that resists spin.
        or_else: What, besides a gentler force or a shorter step, would pass.
    """

    name: str
    stiffness: float
    damping: float
    mass: float
    limit: float
    angular: bool = False
    or_else: str = ""

    def terms(self, step: float) -> tuple[_Term, _Term]:
        """Stiffness and damping over what is allowed at a step [s]."""
        turning = "N m/rad" if self.angular else "N/m"
        k = _Term("stiffness", self.stiffness, turning, "h sqrt(k / m)", step * np.sqrt(self.stiffness / self.mass))
        c = _Term("damping", self.damping, turning.replace("/", " s/"), "h c / m", step * self.damping / self.mass)
        return k, c


@dataclass(frozen=True)
class _Term:
    """The stiffness or damping of a force and the number that must stay small."""

    kind: Literal["stiffness", "damping"]
    value: float
    unit: str
    formula: str
    ratio: float


def check_explicit_forces(body: Body, step: float) -> None:
    """See that every explicit force of a body is stable at a step under semi-implicit Euler.

    Args:
        body: Whose springs and explicit contact sites are checked.
        step: Length of a substep [s].

    Raises:
        ModelError: One line that names the spring or site that fails by most, and what would pass.
    """
    terms = [(force, term) for force in _explicit_forces(body) for term in force.terms(step)]
    if not terms:
        return
    force, worst = max(terms, key=lambda pair: pair[1].ratio / pair[0].limit)
    if worst.ratio <= force.limit:
        return
    factor = force.limit / worst.ratio
    most = _rounded_down(worst.value * (factor**2 if worst.kind == "stiffness" else factor))
    longest = _rounded_down(1e3 * step * factor)
    mass = f"an inertia of {force.mass:.4g} kg m^2" if force.angular else f"an effective mass of {force.mass:.4g} kg"
    raise ModelError(
        f"body {body.name!r}, {force.name}: {worst.kind} {worst.value:.6g} {worst.unit} on {mass} is too much for a "
        f"step of {1e3 * step:.4g} ms, since {worst.formula} = {worst.ratio:.3g} is above {force.limit}; what would "
        f"pass: at most {most} {worst.unit}, or a step of at most {longest} ms{force.or_else}"
    )


def _rounded_down(value: float) -> str:
    """Three digits, never more than the value: what is proposed must pass."""
    digits = 2 - int(np.floor(np.log10(value)))
    return f"{np.floor(value * 10.0**digits) / 10.0**digits:.{max(digits, 0)}f}"


def _explicit_forces(body: Body) -> Iterator[_Force]:
    """Every explicit spring and damper of a body, with its effective mass in the reference pose."""
    sites = [site for site in body.contacts if site.integration == "explicit"]
    if not body.springs and not sites:
        return
    try:
        mobility = np.linalg.inv(body.mass_matrix(body.q_reference))
    except np.linalg.LinAlgError:
        raise ModelError(f"body {body.name!r}: its mass matrix is singular in the reference pose") from None
    for spring in body.springs:
        yield _spring(body, spring, mobility)
    for site in sites:
        yield from _contact(body, site, mobility)


def _spring(body: Body, spring: Spring, mobility: np.ndarray) -> _Force:
    ends = [_point(body, spring.link_a, spring.position_a), _point(body, spring.link_b, spring.position_b)]
    gap = ends[1][0] - ends[0][0]
    length = float(np.linalg.norm(gap))
    # A bushing resists every motion of its ends, a spring with a rest length what is along it.
    directions = gap[None, :] / length if spring.rest_length > 0.0 and length > 0.0 else _ALL
    mass = _least_mass(ends[1][1] - ends[0][1], directions, mobility)
    return _Force(f"spring {spring.name!r}", spring.stiffness, spring.damping, mass, SPRING_LIMIT)


def _contact(body: Body, site: ContactSite, mobility: np.ndarray) -> Iterator[_Force]:
    place = body.link_index(site.link)
    # Links are parallel to the world in the reference pose. The wall may stand on any side.
    if site.surface == "ground":
        jacobian = _point(body, site.link, (site.position[0], site.position[1], site.position[2] - site.radii[2]))[1]
        normal, tangential = _UP, _LEVEL
    else:
        jacobian = _point(body, site.link, site.position)[1]
        normal, tangential = _LEVEL, _ALL
    mass = _least_mass(jacobian, normal, mobility)
    name, implicit = f"contact {site.name!r}", ', or integration = "implicit"'
    yield _Force(name, site.stiffness, site.damping, mass, CONTACT_LIMIT, or_else=implicit)
    if site.tangential_stiffness == 0.0 or site.friction == 0.0:
        return
    k, c = site.tangential_stiffness, site.tangential_damping
    mass = _least_mass(jacobian, tangential, mobility)
    yield _Force(f"{name}, tangential", k, c, mass, CONTACT_LIMIT, or_else=implicit)
    if site.patch_radius > 0.0:
        spin = body.link_velocities(body.q_reference, np.eye(body.u_count))[:, place, 3:]
        area = site.patch_radius**2
        inertia = _least_mass(spin, normal, mobility)
        yield _Force(f"{name}, patch", area * k, area * c, inertia, CONTACT_LIMIT, angular=True, or_else=implicit)


def _point(body: Body, link: str | None, position: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Where a point of a link is in the reference pose [m], and its Jacobian, shape [u_count, 3]."""
    if link is None:
        return np.array(position), np.zeros((body.u_count, 3))
    place = body.link_index(link)
    moving = body.link_velocities(body.q_reference, np.eye(body.u_count))[:, place]
    origin = body.link_poses(body.q_reference)[place, :3]
    return origin + position, moving[:, :3] + np.cross(moving[:, 3:], position)


def _least_mass(jacobian: np.ndarray, directions: np.ndarray, mobility: np.ndarray) -> float:
    """The least effective mass among orthogonal directions and all between them; infinite where nothing moves."""
    along = directions @ jacobian.T
    largest = float(np.linalg.eigvalsh(along @ mobility @ along.T)[-1])
    return 1.0 / largest if largest > 0.0 else np.inf
