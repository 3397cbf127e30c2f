"""A body in MuJoCo: another algorithm, by other people, to race and to check against.

Every link becomes one MuJoCo body at its joint's position: a pin one hinge, a universal joint two and a gimbal three
hinges in the same place, a slider a slide joint, ball and free what they are there. Inertia goes in as a full tensor
about the centre of mass. What is asked for is added: springs and dampers at the joints in place of servos, a floor
under the contact sites, `connect` constraints in place of springs between links, `joint` constraints in place of
gears. Walls and joint limits are left out.

Coordinates mean the same on both sides, so conversion is a permutation (`CoordinateOrder`): MuJoCo orders bodies
depth first and writes quaternions w first.

MuJoCo is an optional extra: importing this module without it raises ModuleNotFoundError.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo's names live in an extension module that has no type stubs.)

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from echelon.warp_kernels.model import ContactSite, Link, Model, Spring, Use

_QUATERNION_WXYZ = (3, 0, 1, 2)  # where w x y z stand among our x y z w

EXPLICIT_DAMPING = "plain euler"
"""What we call MuJoCo's Euler without the implicit joint damping of its default, which costs a factorisation."""

INTEGRATORS: Mapping[str, Any] = {
    name: mujoco.mjtIntegrator.__members__[member]
    for name, member in (
        ("euler", "mjINT_EULER"),
        (EXPLICIT_DAMPING, "mjINT_EULER"),
        ("implicitfast", "mjINT_IMPLICITFAST"),
        ("discrete", "mjINT_DISCRETE"),  # since 3.13: stiffness implicit too
        ("rk4", "mjINT_RK4"),
    )
    if member in mujoco.mjtIntegrator.__members__
}
"""Integrators that the installed MuJoCo has, by the names that it gives them in XML, and `EXPLICIT_DAMPING`."""

VERSION: str = mujoco.__version__


@contextmanager
def without_log() -> Iterator[None]:
    """MuJoCo writes a file into the current folder when a simulation blows up; here that is looked for and reported."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


@dataclass(frozen=True)
class JointSpring:
    """A spring and damper at a joint, towards its reference position.

    Attributes:
        stiffness: [N m/rad or N/m].
        damping: [N m s/rad or N s/m].
    """

    stiffness: float
    damping: float


@dataclass(frozen=True)
class Coupling:
    """Two joints of one axis that turn together.

    Attributes:
        driven, driving: Their names.
        ratio: Turns of the first for a turn of the second.
    """

    driven: str
    driving: str
    ratio: float


def peer_spec(
    model: Model,
    *,
    springs: Mapping[str, Sequence[JointSpring]] | None = None,
    floor: bool = False,
    use: Use | None = None,
    tied: bool = False,
    couplings: Sequence[Coupling] = (),
    step: float = 1.0 / 1200.0,
    integrator: str = "euler",
    energy: bool = False,
) -> mujoco.MjSpec:
    """Describe a body to MuJoCo; `peer_model` compiles what comes back, and it can be written as XML for others.

    Where nothing is asked for that needs them, MuJoCo's constraints are switched off altogether, which is faster. Its
    solver is its default, Newton's method with pyramidal friction cones and a dense Jacobian.

    Args:
        model: The body.
        springs: By name of the joint, one for each of its axes (one for a ball joint).
        floor: Whether its ground contact sites are spheres and ellipsoids over a floor at z = 0.
        use: Which of these sites, "usual" or "rare"; None for all.
        tied: Whether each spring between two links becomes a constraint that keeps its ends together.
        couplings: Joints that turn together.
        step: Time step [s].
        integrator: One of `INTEGRATORS`.
        energy: Whether MuJoCo computes energies in every step, which costs a little.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.autolimits = False
    spec.option.gravity = [0.0, 0.0, -model.gravity]
    spec.option.timestep = step
    spec.option.integrator = INTEGRATORS[integrator]
    spec.option.disableflags |= _switched_off(
        # A state that blows up must be seen, not quietly put back to the start.
        "AUTORESET",
        # Looking for islands among constraints costs, and a single body is one.
        "ISLAND",
        *(["EULERDAMP"] if integrator == EXPLICIT_DAMPING else []),
        *(["CONSTRAINT"] if not (floor or tied or couplings) else []),
    )
    if energy:
        spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    if floor:
        # What touches meets the floor and nothing else.
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], contype=0, conaffinity=1)
    bodies = {}
    for link in model.links:
        parent = spec.worldbody if link.parent is None else bodies[link.parent]
        body = parent.add_body(name=link.name, pos=link.joint.position)
        body.explicitinertial = True
        body.mass = link.mass
        body.ipos = link.com
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = link.inertia
        body.fullinertia = [xx, yy, zz, xy, xz, yz]
        _add_joints(body, link, (springs or {}).get(link.joint.name, ()))
        bodies[link.name] = body
    if floor:
        for site in model.contacts:
            if site.surface == "ground" and use in (None, site.use):
                _add_site(bodies[site.link], site)
    for spring in model.springs if tied else ():
        _add_tie(spec, bodies, spring)
    for coupling in couplings:
        equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT)
        equality.name1, equality.name2 = f"{coupling.driven} 0", f"{coupling.driving} 0"
        # A polynomial, lowest order first.
        equality.data[:5] = [0.0, coupling.ratio, 0.0, 0.0, 0.0]
    return spec


def peer_model(model: Model, **options: Any) -> mujoco.MjModel:
    """A body compiled for MuJoCo; options as `peer_spec` takes them."""
    return peer_spec(model, **options).compile()


def _switched_off(*flags: str) -> int:
    """MuJoCo's bits for what it is not to do; what an older one does not know it does not do either."""
    known = mujoco.mjtDisableBit.__members__
    return sum(int(known[f"mjDSBL_{flag}"]) for flag in flags if f"mjDSBL_{flag}" in known)


def _add_tie(spec: mujoco.MjSpec, bodies: Mapping[str, mujoco.MjsBody], spring: Spring) -> None:
    ends = (spring.link_a, spring.position_a), (spring.link_b, spring.position_b)
    names = f"{spring.name} a", f"{spring.name} b"
    for name, (link, position) in zip(names, ends, strict=True):
        (spec.worldbody if link is None else bodies[link]).add_site(name=name, pos=position)
    equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_CONNECT, objtype=mujoco.mjtObj.mjOBJ_SITE)
    equality.name1, equality.name2 = names


def _add_joints(body: mujoco.MjsBody, link: Link, springs: Sequence[JointSpring]) -> None:
    name, kind = link.joint.name, link.joint.kind
    if kind == "free":
        body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_FREE)
        return
    if kind == "ball":
        joints = [body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_BALL)]
    else:
        moving = mujoco.mjtJoint.mjJNT_SLIDE if kind == "slider" else mujoco.mjtJoint.mjJNT_HINGE
        joints = [
            body.add_joint(name=f"{name} {number}", type=moving, axis=axis)
            for number, axis in enumerate(link.joint.axes)
        ]
    for joint, spring in zip(joints, springs, strict=bool(springs)):
        joint.stiffness = _linear(joint.stiffness, spring.stiffness)
        joint.damping = _linear(joint.damping, spring.damping)


def _linear(present: Any, value: float) -> Any:
    """A coefficient of a linear law: newer MuJoCos hold a polynomial's, lowest order first, older ones a number."""
    return [value] + [0.0] * (len(present) - 1) if isinstance(present, np.ndarray) else value


def _add_site(body: mujoco.MjsBody, site: ContactSite) -> None:
    a, b, c = site.radii
    shape = mujoco.mjtGeom.mjGEOM_SPHERE if a == b == c else mujoco.mjtGeom.mjGEOM_ELLIPSOID
    # Friction in the plane only (condim 3): without the torsion that our sites have, which is the faster.
    body.add_geom(
        type=shape,
        size=[a, b, c],
        pos=site.position,
        condim=3,
        friction=[site.friction, 0.005, 0.0001],
        contype=1,
        conaffinity=0,
    )


# ---- coordinates -----------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class CoordinateOrder:
    """Where our coordinates stand in MuJoCo's.

    Attributes:
        qpos_from_q: For every entry of qpos the index of the same thing in our q, shape [q_count].
        qvel_from_u: For every entry of qvel the index of the same thing in our u, shape [u_count].
    """

    qpos_from_q: np.ndarray
    qvel_from_u: np.ndarray

    @classmethod
    def of(cls, model: Model, mj_model: mujoco.MjModel) -> CoordinateOrder:
        """The order for a body and what `peer_model` made of it."""
        qpos_from_q = np.full(mj_model.nq, -1)
        qvel_from_u = np.full(mj_model.nv, -1)
        for index, link in enumerate(model.links):
            q, u, kind = model.q_start(index), model.u_start(index), link.joint.kind
            first = link.joint.name if kind in ("free", "ball") else f"{link.joint.name} 0"
            joint = mj_model.joint(first).id
            qpos, qvel = mj_model.jnt_qposadr[joint], mj_model.jnt_dofadr[joint]
            if kind == "free":
                qpos_from_q[qpos : qpos + 7] = [q, q + 1, q + 2, *(q + 3 + i for i in _QUATERNION_WXYZ)]
                qvel_from_u[qvel : qvel + 6] = range(u, u + 6)
            elif kind == "ball":
                qpos_from_q[qpos : qpos + 4] = [q + i for i in _QUATERNION_WXYZ]
                qvel_from_u[qvel : qvel + 3] = range(u, u + 3)
            else:
                for number in range(len(link.joint.axes)):
                    qpos_from_q[qpos + number] = q + number
                    qvel_from_u[qvel + number] = u + number
        if sorted(qpos_from_q) != list(range(model.q_count)) or sorted(qvel_from_u) != list(range(model.u_count)):
            raise ValueError(
                f"body {model.name!r}: MuJoCo has {mj_model.nq} coordinates and {mj_model.nv} speeds, "
                f"which are not our {model.q_count} and {model.u_count}"
            )
        return cls(qpos_from_q, qvel_from_u)

    def write(self, data: mujoco.MjData, q: np.ndarray, u: np.ndarray | None = None) -> None:
        """Put one state into MuJoCo's data; q has shape [q_count], u [u_count], left alone if not given."""
        data.qpos[:] = q[self.qpos_from_q]
        if u is not None:
            data.qvel[:] = u[self.qvel_from_u]

    def read(self, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
        """(q, u) of MuJoCo's data."""
        q = np.empty_like(data.qpos)
        q[self.qpos_from_q] = data.qpos
        return q, self.to_u(data.qvel)

    def to_u(self, qvel: np.ndarray) -> np.ndarray:
        """What stands in MuJoCo's order of speeds, in ours; shape [u_count]."""
        ours = np.empty_like(qvel)
        ours[self.qvel_from_u] = qvel
        return ours
