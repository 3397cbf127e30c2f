r"""A bicycle: two wheels, a fork and a frame, described as the literature describes it.

                               \  steer axis
            z                   \
            ^                    \
            |                     \
          .-|-.                    \---.
         (  o  ) rear hub         ( \o  ) front hub
          '-|-'                    '-\-'
            O------------------------CT-----> x
            |<----- wheelbase ----->|| trail

Axes are x forward, y left, z up; the origin O is where the rear wheel touches the ground, with the bicycle upright and
the fork straight. The frame is the root of the tree and has its origin there, so a bicycle's position is that of its
rear contact. A positive angle of the fork steers left, a positive angle of a wheel rolls forward, a positive lean is
to the right.

`benchmark_bicycle` is the one of Meijaard, Papadopoulos, Ruina and Schwab, *Linearized dynamics equations for the
balance and steer of a bicycle* (2007), whose eigenvalues are known to fourteen digits (see `whipple`).
Its rider is rigid and part of the frame. `racing_bicycle` is what `echelon`'s cyclists ride; its frame is bare.

Each wheel touches the ground with the lowest point of its tyre: a site shaped as a disc, or, with a tyre that has some
width, as a flat ellipsoid whose crown is as round as the tyre's. Rolling without slipping is friction that sticks: the
tyre's tangential spring is stiff enough that eigenvalues agree with those of ideal wheels within three per cent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from echelon.agents.riders.bicycle_looks import crank_visuals, fork_visuals, frame_visuals, wheel_visuals
from echelon.errors import InputError
from echelon.warp_kernels.character import NO_EVENT, Population, View
from echelon.warp_kernels.contact import JointForces
from echelon.warp_kernels.model import ContactSite, Joint, Link, Matrix3, Vec3
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.trace import asin, clamp, logical_not, select

Floats = float | np.ndarray

FRAME, FORK, REAR_WHEEL, FRONT_WHEEL = "frame", "fork", "rear_wheel", "front_wheel"
REAR_TYRE, FRONT_TYRE = "rear_tyre", "front_tyre"

FORK_LIMIT = 1.4  # the bars turn no farther: they meet the frame [rad]
FALLEN_COSINE = 0.5  # of the frame's tilt at which a bicycle counts as fallen: 60 degrees

STEER, REAR_ANGLE, FRONT_ANGLE = 7, 8, 9  # coordinates, after the frame's seven
STEER_SPEED, REAR_SPEED, FRONT_SPEED = 6, 7, 8

ROLLING, FALLEN = range(2)


@dataclass(frozen=True)
class RigidPart:
    """A rigid part of a bicycle, in the bicycle's axes.

    Attributes:
        mass: [kg].
        com: Centre of mass [m].
        inertia: Symmetric tensor about the centre of mass; products have the tensor's sign, as in -m x z [kg m^2].
    """

    mass: float
    com: Vec3
    inertia: Matrix3


@dataclass(frozen=True)
class WheelParameters:
    """A wheel, symmetric about its axle.

    Attributes:
        radius: Of its rolling circle [m].
        mass: [kg].
        inertia_x: About a diameter [kg m^2].
        inertia_y: About the axle [kg m^2].
        tyre_radius: Of the tyre's cross section; 0 for a disc with a sharp edge [m].
    """

    radius: float
    mass: float
    inertia_x: float
    inertia_y: float
    tyre_radius: float = 0.0


@dataclass(frozen=True)
class TyreParameters:
    """How tyres give; the same for both.

    Attributes:
        stiffness, damping: Along the ground's normal [N/m], [N s/m].
        tangential_stiffness, tangential_damping: Of the contact against slipping [N/m], [N s/m].
        friction: Coulomb coefficient.
    """

    stiffness: float = 300_000.0
    damping: float = 1_000.0
    tangential_stiffness: float = 300_000.0
    tangential_damping: float = 1_000.0
    friction: float = 1.0


@dataclass(frozen=True)
class BicycleParameters:
    """A bicycle in the parameters of the literature; see the module's text for axes and origin.

    Attributes:
        wheelbase: Between the wheels' contacts [m].
        trail: From the front contact forward to where the steer axis meets the ground [m].
        steer_tilt: Of the steer axis, backward from the vertical [rad].
        rear_wheel, front_wheel: The wheels, their centres above their contacts.
        frame: Rear frame, with a rider who is part of it if there is one.
        fork: Fork and handlebar.
        tyre: Of both wheels.
        fork_damping: Of the steering joint [N m s/rad].
        rolling_resistance: Damping of each wheel's spin [N m s/rad].
        gravity: [m/s^2].
        bottom_bracket: Axis of the cranks [m].
        saddle: Where a rider's pelvis pivots [m].
        grip: Where the left hand holds; the right one mirrors it [m].
        crank_length: Bottom bracket to pedal [m].
        pedal_offset: Of a pedal's middle from the bicycle's plane [m].
    """

    wheelbase: float
    trail: float
    steer_tilt: float
    rear_wheel: WheelParameters
    front_wheel: WheelParameters
    frame: RigidPart
    fork: RigidPart
    tyre: TyreParameters = field(default_factory=TyreParameters)
    fork_damping: float = 0.0
    rolling_resistance: float = 0.0
    gravity: float = 9.80665
    bottom_bracket: Vec3 = (0.405, 0.0, 0.27)
    saddle: Vec3 = (0.203, 0.0, 0.953)
    grip: Vec3 = (0.97, 0.20, 0.97)
    crank_length: float = 0.165
    pedal_offset: float = 0.11

    def __post_init__(self) -> None:
        sizes = {
            "wheelbase": self.wheelbase,
            "rear_wheel.radius": self.rear_wheel.radius,
            "front_wheel.radius": self.front_wheel.radius,
            "frame.mass": self.frame.mass,
            "fork.mass": self.fork.mass,
        }
        for name, value in sizes.items():
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"bicycle: {name} is {value}, must be greater than 0")
        if not abs(self.steer_tilt) < 0.5 * math.pi:
            raise InputError(
                f"bicycle: steer_tilt is {self.steer_tilt} rad, must lie between -pi/2 and pi/2; 18 degrees are 0.314"
            )

    @property
    def mass(self) -> float:
        """Of everything [kg]."""
        return self.frame.mass + self.fork.mass + self.rear_wheel.mass + self.front_wheel.mass

    @property
    def center_of_mass(self) -> Vec3:
        """Of everything, upright and straight [m]."""
        parts = [
            (self.frame.mass, self.frame.com),
            (self.fork.mass, self.fork.com),
            (self.rear_wheel.mass, (0.0, 0.0, self.rear_wheel.radius)),
            (self.front_wheel.mass, (self.wheelbase, 0.0, self.front_wheel.radius)),
        ]
        x, y, z = (sum(mass * com[i] for mass, com in parts) / self.mass for i in range(3))
        return (x, y, z)

    @property
    def steer_axis(self) -> Vec3:
        """Unit vector up the steer axis: turning about it by a positive angle steers left."""
        return (-math.sin(self.steer_tilt), 0.0, math.cos(self.steer_tilt))

    def on_steer_axis(self, height: float) -> Vec3:
        """The steer axis's point at a height above the ground [m]."""
        return (self.wheelbase + self.trail - height * math.tan(self.steer_tilt), 0.0, height)


# ---- the two bicycles that ship --------------------------------------------------------------------------------------
def benchmark_bicycle() -> BicycleParameters:
    """The benchmark of Meijaard et al. (2007), Table 1, rider rigid; its z points down, so x z products change sign."""
    return BicycleParameters(
        wheelbase=1.02,
        trail=0.08,
        steer_tilt=math.pi / 10.0,
        rear_wheel=WheelParameters(radius=0.3, mass=2.0, inertia_x=0.0603, inertia_y=0.12),
        front_wheel=WheelParameters(radius=0.35, mass=3.0, inertia_x=0.1405, inertia_y=0.28),
        frame=RigidPart(85.0, (0.3, 0.0, 0.9), _tensor(9.2, 11.0, 2.8, xz=-2.4)),
        fork=RigidPart(4.0, (0.9, 0.0, 0.7), _tensor(0.05892, 0.06, 0.00708, xz=0.00756)),
        gravity=9.81,
        bottom_bracket=(0.41, 0.0, 0.27),
        saddle=(0.19, 0.0, 0.95),
        grip=(0.95, 0.22, 1.0),
    )


def racing_bicycle() -> BicycleParameters:
    """A racing bicycle with a bare frame, for riders that have bodies of their own."""
    tilt, wheelbase, trail = math.radians(17.5), 1.0, 0.06
    up = 0.75  # of the fork's centre along the steer axis, before its own offset [m]
    fork_center = (wheelbase + trail - up * math.sin(tilt) + 0.04, 0.0, up * math.cos(tilt) + 0.03)
    return BicycleParameters(
        wheelbase=wheelbase,
        trail=trail,
        steer_tilt=tilt,
        rear_wheel=WheelParameters(radius=0.335, mass=1.6, inertia_x=0.055, inertia_y=0.11, tyre_radius=0.0125),
        front_wheel=WheelParameters(radius=0.335, mass=1.3, inertia_x=0.05, inertia_y=0.10, tyre_radius=0.0125),
        frame=RigidPart(4.0, (0.43, 0.0, 0.60), _tensor(0.20, 0.45, 0.30)),
        fork=RigidPart(2.2, fork_center, _tensor(0.10, 0.08, 0.06)),
        fork_damping=0.2,
        rolling_resistance=0.028,
    )


def _tensor(xx: float, yy: float, zz: float, xz: float = 0.0) -> Matrix3:
    return ((xx, 0.0, xz), (0.0, yy, 0.0), (xz, 0.0, zz))


# ---- as a body -------------------------------------------------------------------------------------------------------
def bicycle_links(parameters: BicycleParameters) -> tuple[Link, ...]:
    """Frame (the free root), fork, rear wheel and front wheel, with their looks.

    The frame's origin is the rear contact; the fork's is on the steer axis at the height of the front hub.
    """
    p = parameters
    steer_origin = p.on_steer_axis(p.front_wheel.radius)
    frame = Link(
        FRAME,
        None,
        Joint("root", "free"),
        p.frame.mass,
        p.frame.com,
        p.frame.inertia,
        frame_visuals(
            rear_hub=(0.0, 0.0, p.rear_wheel.radius),
            bottom_bracket=p.bottom_bracket,
            saddle=p.saddle,
            head_bottom=p.on_steer_axis(_head_bottom(p)),
            head_top=p.on_steer_axis(_head_top(p)),
        ),
    )
    fork = Link(
        FORK,
        FRAME,
        Joint(
            "steer",
            "pin",
            steer_origin,
            (p.steer_axis,),
            limits=((-FORK_LIMIT, FORK_LIMIT),),
            limit_stiffness=300.0,
            limit_damping=3.0,
        ),
        p.fork.mass,
        _from(steer_origin, p.fork.com),
        p.fork.inertia,
        fork_visuals(
            hub=_from(steer_origin, (p.wheelbase, 0.0, p.front_wheel.radius)),
            crown=_from(steer_origin, p.on_steer_axis(_head_bottom(p) - 0.015)),
            stem=_from(steer_origin, p.on_steer_axis(_head_top(p) + 0.06)),
            grip=_from(steer_origin, p.grip),
        ),
    )
    rear = _wheel(REAR_WHEEL, FRAME, (0.0, 0.0, p.rear_wheel.radius), p.rear_wheel)
    hub = _from(steer_origin, (p.wheelbase, 0.0, p.front_wheel.radius))
    return frame, fork, rear, _wheel(FRONT_WHEEL, FORK, hub, p.front_wheel)


def _from(origin: Vec3, point: Vec3) -> Vec3:
    return (point[0] - origin[0], point[1] - origin[1], point[2] - origin[2])


def _head_bottom(p: BicycleParameters) -> float:
    """Height of the lower end of the head tube: it clears the front tyre [m]."""
    return 2.0 * p.front_wheel.radius + 0.06


def _head_top(p: BicycleParameters) -> float:
    """Height of the head tube's upper end [m]."""
    return max(_head_bottom(p) + 0.10, p.grip[2] - 0.11)


def _wheel(name: str, parent: str, hub: Vec3, wheel: WheelParameters) -> Link:
    return Link(
        name,
        parent,
        Joint(name, "pin", hub, ((0.0, 1.0, 0.0),), continuous=True),
        wheel.mass,
        inertia=((wheel.inertia_x, 0.0, 0.0), (0.0, wheel.inertia_y, 0.0), (0.0, 0.0, wheel.inertia_x)),
        visuals=wheel_visuals(wheel.radius),
    )


def wheel_sites(parameters: BicycleParameters) -> tuple[ContactSite, ContactSite]:
    """The tyres: discs with a round edge, `rear_tyre` and `front_tyre`."""
    rear, front = (
        ContactSite(
            name,
            link,
            (0.0, 0.0, 0.0),
            # An ellipsoid of half width b has a crown of radius b^2 / r at its lowest point.
            radii=(wheel.radius, math.sqrt(wheel.radius * wheel.tyre_radius), wheel.radius),
            stiffness=parameters.tyre.stiffness,
            damping=parameters.tyre.damping,
            tangential_stiffness=parameters.tyre.tangential_stiffness,
            tangential_damping=parameters.tyre.tangential_damping,
            friction=parameters.tyre.friction,
        )
        for name, link, wheel in (
            (REAR_TYRE, REAR_WHEEL, parameters.rear_wheel),
            (FRONT_TYRE, FRONT_WHEEL, parameters.front_wheel),
        )
    )
    return rear, front


def frame_sites(parameters: BicycleParameters) -> tuple[ContactSite, ...]:
    """What else meets the ground when it lies there: saddle, pedals (held by the frame) and both ends of the bars."""
    p = parameters
    origin = p.on_steer_axis(p.front_wheel.radius)
    places: list[tuple[str, str, Vec3, float]] = [("saddle", FRAME, p.saddle, 0.07)]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        foot = (p.bottom_bracket[0] + sign * p.crank_length, sign * p.pedal_offset, p.bottom_bracket[2])
        places.append((f"{side}_pedal", FRAME, foot, 0.03))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        places.append((f"{side}_grip", FORK, _from(origin, (p.grip[0], sign * p.grip[1], p.grip[2])), 0.03))
    return tuple(
        ContactSite(
            name,
            link,
            position,
            radii=(radius, radius, radius),
            stiffness=40_000.0,
            damping=1_000.0,
            tangential_stiffness=20_000.0,
            tangential_damping=400.0,
            friction=0.6,
            use="rare",
        )
        for name, link, position, radius in places
    )


class Bicycle:
    """A bicycle whose rider, if any, is rigid and rides hands off; a `Character`.

    Its one command is a torque that turns the fork to the left [N m]; zero is hands off. A bicycle has *fallen* when it
    leans by more than 60 degrees or when more than its tyres touches the ground; then the torque lets go.

    Args:
        parameters: What it is made of.
        start_speed: At which `population` has it roll [m/s].
    """

    name: str = "bicycle"
    commands: tuple[str, ...] = ("steer_torque",)
    phase_names: tuple[str, ...] = ("rolling", "fallen")
    events: tuple[str, ...] = ("fall",)
    records: tuple[str, ...] = ("lean", "steer")
    parameters: Mapping[str, float] = {}
    # Measured: the benchmark's eigenvalues are within 2.2 % of ideal at 1/1200 s, 2.8 % at 1/720 s, 1.4 % at 1/4800 s.
    steps_per_second: int = 1200
    steps_per_tick: int = 10
    memory: Mapping[str, float] = {
        "phase": ROLLING,
        "fallen": 0.0,
        "loaded": 0.0,
        "fall": NO_EVENT,
        "lean": 0.0,  # to the right [rad]
        "steer": 0.0,  # to the left [rad]
    }

    def __init__(self, parameters: BicycleParameters, start_speed: float = 5.0) -> None:
        self.bicycle = parameters
        self.start_speed = start_speed
        frame, *others = bicycle_links(parameters)
        cranks = crank_visuals(parameters.crank_length, parameters.pedal_offset, parameters.bottom_bracket)
        self.body = Body(
            name="bicycle",
            links=(replace(frame, visuals=frame.visuals + cranks), *others),
            contacts=(*wheel_sites(parameters), *frame_sites(parameters)),
            gravity=parameters.gravity,
        )
        self._frame_sites = tuple(site.name for site in frame_sites(parameters))

    def population(self, count: int, seed: int, variation: float, in_phase: bool) -> Population:
        """Upright bicycles at the start speed; nothing differs."""
        q, u = self.rolling(np.full(count, self.start_speed))
        return Population(q, u, parameters={}, memory={})

    def rolling(
        self,
        speed: Floats,
        *,
        lean: Floats = 0.0,
        steer: Floats = 0.0,
        lean_rate: Floats = 0.0,
        steer_rate: Floats = 0.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bicycles that roll along x without slipping, tyres bearing their load.

        Arguments are numbers or arrays of one shape; lean is to the right, steer to the left, both small.

        Args:
            speed: Forward [m/s].
            lean, steer: [rad].
            lean_rate, steer_rate: [rad/s].

        Returns:
            q and u, shapes [..., q_count] and [..., u_count]; the rear contact is at the world's origin.
        """
        p = self.bicycle
        v, phi, delta, phi_dot, delta_dot = np.broadcast_arrays(speed, lean, steer, lean_rate, steer_rate)
        q = np.zeros((*v.shape, self.body.q_count))
        u = np.zeros((*v.shape, self.body.u_count))
        front_load = p.mass * p.gravity * p.center_of_mass[0] / p.wheelbase
        rear_sinks = (p.mass * p.gravity - front_load) / p.tyre.stiffness
        front_sinks = front_load / p.tyre.stiffness
        pitch = math.asin((front_sinks - rear_sinks) / p.wheelbase)
        half_pitch = math.sin(0.5 * pitch), math.cos(0.5 * pitch)
        q[..., 2] = -rear_sinks
        q[..., 3] = np.sin(0.5 * phi) * half_pitch[1]
        q[..., 4] = np.cos(0.5 * phi) * half_pitch[0]
        q[..., 5] = np.sin(0.5 * phi) * half_pitch[0]
        q[..., 6] = np.cos(0.5 * phi) * half_pitch[1]
        q[..., STEER] = delta
        u[..., 0] = v
        u[..., 3] = phi_dot
        # The front wheel does not slip sideways: to first order this is how fast the bicycle then turns.
        u[..., 5] = (v * delta + p.trail * delta_dot) * math.cos(p.steer_tilt) / p.wheelbase
        u[..., STEER_SPEED] = delta_dot
        u[..., REAR_SPEED] = v / p.rear_wheel.radius
        u[..., FRONT_SPEED] = v / p.front_wheel.radius
        return q, u

    def lean(self, q: np.ndarray) -> np.ndarray:
        """Lean to the right of states of shape [..., q_count], against gravity [rad]."""
        x, y, z, w = (q[..., 3 + i] for i in range(4))
        return np.arcsin(np.clip(2.0 * (y * z + x * w), -1.0, 1.0))

    def heading(self, q: np.ndarray) -> np.ndarray:
        """Direction of the frame in plan, from x towards y, of states of shape [..., q_count] [rad]."""
        x, y, z, w = (q[..., 3 + i] for i in range(4))
        # Across the frame is level whatever the lean; along it is not.
        return np.arctan2(-2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z))

    # ---- control -----------------------------------------------------------------------------------------------------
    def control(self, view: View) -> None:
        """Nothing to decide: only note how it stands."""
        memory = view.memory
        rotation, _ = view.kin.world(view.kin.tree.node_of_link[0])
        memory["lean"] = asin(clamp(rotation[2][1], -1.0, 1.0))
        memory["steer"] = view.q[STEER]
        memory["phase"] = select(memory["fallen"] > 0.5, float(FALLEN), float(ROLLING))

    def actuate(self, view: View, joints: JointForces) -> None:
        """Bearings, the torque on the fork, and noticing a fall."""
        p, memory = self.bicycle, view.memory
        rotation, _ = view.kin.world(view.kin.tree.node_of_link[0])
        bears = (view.contacts[REAR_TYRE].normal_force > 0.0) | (view.contacts[FRONT_TYRE].normal_force > 0.0)
        memory["loaded"] = select(bears, 1.0, 0.0)
        down = rotation[2][2] < FALLEN_COSINE
        for name in self._frame_sites:
            down = down | (view.contacts[name].normal_force > 0.0)
        fallen = memory["fallen"] > 0.5
        memory["fall"] = select(down & logical_not(fallen), view.substep, memory["fall"])
        memory["fallen"] = select(down, 1.0, memory["fallen"])
        for speed, damping in (
            (STEER_SPEED, p.fork_damping),
            (REAR_SPEED, p.rolling_resistance),
            (FRONT_SPEED, p.rolling_resistance),
        ):
            joints.servo(speed, 0.0, view.u[speed], 0.0, 0.0, 0.0, damping, view.implicit_step)
        torque = select(fallen | down, 0.0, view.command["steer_torque"])
        joints.tau[STEER_SPEED] = joints.tau[STEER_SPEED] + torque
