"""Small bodies, sloping ground and short ways to run them, shared by the engine's tests."""

# pyright: reportGeneralTypeIssues=false
# (Warp's types mean other things to it than to Python.)

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from echelon.agents.bodies import load_body
from echelon.agents.hopper import Hopper
from echelon.agents.servo import ServoedBody
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.frame import ChunkArrays, Engine
from echelon.warp_kernels.model import AXIS_COUNT, ContactSite, Joint, JointKind, Link, Matrix3, Vec3
from echelon.warp_kernels.native import NativeFunction
from echelon.warp_kernels.reference import Body

STEP = 1.0 / 1200.0
GRAVITY = 9.80665


# ---- bodies ----------------------------------------------------------------------------------------------------------
def diagonal(x: float, y: float, z: float) -> Matrix3:
    return ((x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z))


def free_link(
    mass: float, inertia: Matrix3, sites: Sequence[ContactSite], *, height: float = 0.0, name: str = "thing"
) -> Body:
    """One rigid link, free in space."""
    joint = Joint("root", "free", position=(0.0, 0.0, height))
    return Body(name=name, links=(Link("link", None, joint, mass, inertia=inertia),), contacts=tuple(sites))


def ball_body(radius: float = 0.2, mass: float = 3.0, **site: Any) -> Body:
    """A solid sphere that touches with its surface."""
    moment = 0.4 * mass * radius**2
    contact = ContactSite("skin", "link", (0.0, 0.0, 0.0), radii=(radius, radius, radius), **site)
    return free_link(mass, diagonal(moment, moment, moment), [contact], height=radius, name="ball")


def block_body(half: Vec3 = (0.2, 0.15, 0.05), mass: float = 4.0, **site: Any) -> Body:
    """A solid box that touches with its four lower corners."""
    a, b, c = half
    inertia = diagonal(mass / 3.0 * (b * b + c * c), mass / 3.0 * (a * a + c * c), mass / 3.0 * (a * a + b * b))
    corners = [
        ContactSite(f"corner {i}", "link", (x, y, -c), **site)
        for i, (x, y) in enumerate(((a, b), (a, -b), (-a, b), (-a, -b)))
    ]
    return free_link(mass, inertia, corners, height=c, name="block")


def mixed_joints(seed: int = 3) -> Body:
    """Every joint there is below a free root: two branches, full inertia tensors, oblique axes at right angles."""
    rng = np.random.default_rng(seed)
    kinds: tuple[JointKind, ...] = ("free", "gimbal", "ball", "universal", "slider", "pin")
    links: list[Link] = []
    for index, parent in enumerate((None, 0, 1, 0, 3, 4)):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0][: AXIS_COUNT[kinds[index]]]
        points = rng.normal(size=(6, 3)) * 0.15
        inertia = sum((np.eye(3) * (p @ p) - np.outer(p, p) for p in points), start=np.zeros((3, 3)))
        joint = Joint(
            f"joint {index}",
            kinds[index],
            position=tuple(rng.normal(size=3) * 0.3),
            axes=tuple(tuple(map(float, axis)) for axis in axes),  # type: ignore[arg-type]
        )
        links.append(
            Link(
                f"link {index}",
                None if parent is None else f"link {parent}",
                joint,
                float(rng.uniform(0.5, 3.0)),
                com=tuple(rng.normal(size=3) * 0.2),
                inertia=tuple(tuple(row) for row in inertia),  # type: ignore[arg-type]
            )
        )
    return Body(name="mixed", links=tuple(links))


@cache
def body_named(name: str) -> Body:
    """A body that ships, or "mixed"."""
    return mixed_joints() if name == "mixed" else load_body(name)


@cache
def hopper() -> Hopper:
    """One hopper for all tests: programs are kept by character."""
    return Hopper()


@cache
def puppet(name: str, frequency: float = 2.0) -> ServoedBody:
    """A body without contacts, a servo of about this frequency [Hz] and half of critical damping at every joint.

    Gains follow from what each joint moves if all others are loose, so that they suit toes and hips, and Runge-Kutta.
    """
    body = replace(body_named(name), contacts=())
    inertia = 1.0 / np.diag(np.linalg.inv(body.mass_matrix(body.q_reference)))
    omega = 2.0 * np.pi * frequency
    return ServoedBody(body, tuple(omega**2 * inertia), tuple(omega * inertia))


def random_motion(
    body: Body, count: int, seed: int, *, angle: float = 0.4, speed: float = 1.5
) -> tuple[np.ndarray, np.ndarray]:
    """States about the reference pose, rounded to float32 so that lanes and reference start from the same."""
    rng = np.random.default_rng(seed)
    q = np.tile(body.q_reference, (count, 1)) + angle * rng.normal(size=(count, body.q_count))
    u = speed * rng.normal(size=(count, body.u_count))
    return as_float32(body.normalized(q)), as_float32(u)


def as_float32(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, dtype=np.float32).astype(float)


# ---- ground ----------------------------------------------------------------------------------------------------------
@wp.struct
class Slope:
    normal: wp.vec3d
    wall_offset: wp.float64


@wp.func
def look_up_slope(surface: int, point: wp.vec3d, slope: Slope) -> wp.vec4d:
    """A plane through the origin, and a wall at x = wall_offset that faces backwards."""
    if surface == 1:
        return wp.vec4d(wp.float64(-1.0), wp.float64(0.0), wp.float64(0.0), -slope.wall_offset)
    return wp.vec4d(slope.normal[0], slope.normal[1], slope.normal[2], wp.float64(0.0))


@dataclass(frozen=True)
class SlopedTerrain:
    """A plane through the world's origin that falls along +x, and a wall."""

    data: Any
    look_up: Any = look_up_slope
    level: bool = False
    rough: bool = False

    @classmethod
    def of(cls, angle: float, wall_at: float = 1e6) -> SlopedTerrain:
        slope = Slope()
        slope.normal = wp.vec3d(*slope_normal(angle))
        slope.wall_offset = wall_at
        return cls(slope)


def slope_normal(angle: float) -> tuple[float, float, float]:
    """Unit normal of ground that falls along +x by an angle [rad]."""
    return (float(np.sin(angle)), 0.0, float(np.cos(angle)))


def on_slope(body: Body, angle: float, height: float) -> np.ndarray:
    """q of a free link lying flat on the slope, its origin `height` above it [m]."""
    q = body.q_reference.copy()
    q[:3] = height * np.array(slope_normal(angle))
    q[3:7] = (0.0, np.sin(0.5 * angle), 0.0, np.cos(0.5 * angle))
    return q


# ---- running ---------------------------------------------------------------------------------------------------------
@dataclass
class Flight:
    """An engine with a chunk to look into."""

    engine: Engine
    chunk: ChunkArrays

    def advance(self, frames: int) -> Flight:
        for _ in range(frames):
            self.engine.advance(0)
        return self

    @property
    def q(self) -> np.ndarray:
        """Generalised positions in the world, float64, shape [agents, q_count]."""
        q, body = self.engine.q.astype(float), self.engine.character.body
        for index, link in enumerate(body.links):
            if link.joint.kind == "free":
                at = body.q_start(index)
                q[:, at : at + 3] += self.engine.origins.numpy()[: self.engine.agent_count]
        return q

    @property
    def u(self) -> np.ndarray:
        """Generalised speeds, float64, shape [agents, u_count]."""
        return self.engine.u.astype(float)


def start(
    character: Character, q: np.ndarray, u: np.ndarray | None = None, *, angle: float = 0.0, **settings: Any
) -> Flight:
    """An engine with agents on a slope, ready to advance; eight lanes and steps of 1/1200 s unless told otherwise."""
    q = np.atleast_2d(q)
    terrain = SlopedTerrain.of(angle, settings.pop("wall_at", 1e6))
    engine = Engine(character, len(q), terrain, **{"lanes": 8, "substeps": 40, "tick": 5, **settings})
    chunk = ChunkArrays.allocate(1, len(q), character)
    engine.bind(chunk)
    engine.set_q(q)
    engine.set_u(np.zeros((len(q), character.body.u_count)) if u is None else np.atleast_2d(u))
    return Flight(engine, chunk)


@cache
def emitted(function: Callable[[list[Any]], Sequence[Any]], input_count: int, lanes: int) -> NativeFunction:
    """A function of scalars as native code, compiled once for all tests."""
    return NativeFunction(function, input_count, lanes)
