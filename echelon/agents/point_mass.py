"""The point mass: what crowds are made of where bodies are left out, as a body among the others.

The literature's simplest system: a mass that takes up any desired velocity, as far as a bounded acceleration allows.
Here it is a puck that slides on the ground without friction,

    F = m clamp(k (v_d - v), a_max)

pushed through its middle and kept level. It is never off balance and never falls; what walls and others do to it is
what they do to any body. Next to it one sees what balance, gait and steering cost the other characters.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from echelon.agents.wall_bumper import wall_bumper
from echelon.warp_kernels.character import Capsule, Population, View
from echelon.warp_kernels.contact import JointForces
from echelon.warp_kernels.model import ContactSite, Joint, Link, Model, Visual
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.trace import maximum, minimum, select, sqrt

MASS = 16.4  # as heavy as a hopper [kg]
RADIUS = 0.35  # [m]
HALF_HEIGHT = 0.12  # [m]
CAPSULE = Capsule((-0.04, 0.0, 0.0), (0.04, 0.0, 0.0), RADIUS - 0.04)  # that others touch
INERTIA = (0.55, 0.55, 1.00)  # of a flat disc [kg m^2]
VELOCITY_GAIN = 4.0  # k [1/s]
ACCELERATION_LIMIT = 4.0  # a_max [m/s^2]
LEVEL_STIFFNESS, LEVEL_DAMPING = 120.0, 12.0  # that keep it level [N m/rad], [N m s/rad]
SPIN_DAMPING = 2.0  # about the upright axis [N m s/rad]
MARKER = (0.92, 0.90, 0.84)
SKID, BUMPER = "skid", "bumper"


def point_mass_model() -> Model:
    """A flat puck, a skid beneath it, and the sphere that walls stop."""
    puck = Link(
        name="puck",
        parent=None,
        joint=Joint("root", "free", position=(0.0, 0.0, HALF_HEIGHT)),
        mass=MASS,
        inertia=((INERTIA[0], 0.0, 0.0), (0.0, INERTIA[1], 0.0), (0.0, 0.0, INERTIA[2])),
        visuals=(
            Visual("cylinder", (RADIUS, 0.7 * HALF_HEIGHT, 0.0)),
            Visual("ellipsoid", (0.86 * RADIUS, 0.86 * RADIUS, 0.10), position=(0.0, 0.0, 0.7 * HALF_HEIGHT)),
            Visual("ellipsoid", (0.10, 0.10, 0.06), position=(0.0, 0.0, HALF_HEIGHT + 0.04), color=MARKER),
        ),
    )
    return Model(
        name="point-mass",
        links=(puck,),
        contacts=(
            ContactSite(
                SKID,
                "puck",
                (0.0, 0.0, 0.0),
                radii=(HALF_HEIGHT, HALF_HEIGHT, HALF_HEIGHT),
                stiffness=20_000.0,
                damping=800.0,
                tangential_stiffness=0.0,
                friction=0.0,
                integration="explicit",
            ),
            wall_bumper(BUMPER, "puck", RADIUS),
        ),
    )


class PointMass:
    """The puck as a `Character`: commands are the desired velocity along world x and y [m/s]."""

    name: str = "point-mass"
    commands: tuple[str, ...] = ("velocity_x", "velocity_y")
    phase_names: tuple[str, ...] = ("sliding",)
    events: tuple[str, ...] = ()
    records: tuple[str, ...] = ()
    memory: Mapping[str, float] = {"phase": 0.0, "fallen": 0.0, "loaded": 0.0}
    capsules: tuple[Capsule, ...] = (CAPSULE,)
    parameters: Mapping[str, float] = {"acceleration_limit": ACCELERATION_LIMIT}
    steps_per_second: int = 480
    steps_per_tick: int = 4

    def __init__(self) -> None:
        self.body = Body.from_dict(point_mass_model().to_dict())

    def population(self, count: int, seed: int, variation: float, in_phase: bool) -> Population:
        """Pucks at rest on the ground, their accelerations a little different from one to the next.

        Args:
            count: How many.
            seed: Of what differs.
            variation: Relative standard deviation of the acceleration's bound.
            in_phase: Means nothing here: pucks have no phase.
        """
        # Two numbers an agent, from its own counter, so that agent i is the same in any crowd.
        bits = np.random.Philox(key=seed).random_raw(count * 2).reshape(count, 2)
        uniform = (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53
        spread = np.sqrt(-2.0 * np.log(1.0 - uniform[:, 0])) * np.cos(2.0 * np.pi * uniform[:, 1]) * variation
        q = np.tile(self.body.q_reference, (count, 1))
        q[:, 2] -= self.body.mass * self.body.gravity / self.body.contacts[0].stiffness
        return Population(
            q=q,
            u=np.zeros((count, self.body.u_count)),
            parameters={"acceleration_limit": ACCELERATION_LIMIT * (1.0 + np.clip(spread, -0.4, 0.4))},
            memory={},
        )

    def control(self, view: View) -> None:
        """Nothing is decided: the force follows the velocity at every substep."""

    def actuate(self, view: View, joints: JointForces) -> None:
        """Push toward the desired velocity, and keep level."""
        memory, command, u = view.memory, view.command, view.u
        memory["loaded"] = select(view.contacts[SKID].normal_force > 0.0, 1.0, 0.0)
        x = VELOCITY_GAIN * (command["velocity_x"] - u[0])
        y = VELOCITY_GAIN * (command["velocity_y"] - u[1])
        share = minimum(view.parameters["acceleration_limit"] / maximum(sqrt(x * x + y * y), 1e-6), 1.0)
        joints.tau[0] = joints.tau[0] + (self.body.mass * share) * x
        joints.tau[1] = joints.tau[1] + (self.body.mass * share) * y
        # Turning by z_body x z_world would bring it level; both in the body's axes.
        rotation, _ = view.kin.world(view.kin.tree.node_of_link[0])
        joints.tau[3] = joints.tau[3] - LEVEL_STIFFNESS * rotation[2][1] - LEVEL_DAMPING * u[3]
        joints.tau[4] = joints.tau[4] + LEVEL_STIFFNESS * rotation[2][0] - LEVEL_DAMPING * u[4]
        joints.tau[5] = joints.tau[5] - SPIN_DAMPING * u[5]
