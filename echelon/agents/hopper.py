"""The one-legged hopping robot: an ellipsoid on a springy leg, and the control that keeps it upright.

Body and task are those of *Dynamically Simulated Characters in Virtual Environments*; the control is Raibert's
(*Legged Robots That Balance*, 1986), three parts that know nothing of each other:

* **Speed**, by where the foot is put. In flight the leg swings so that the foot will land at

      x_f = xdot Ts / 2 + kx (xdot - xdot_d)

  ahead of the hip, Ts being how long the last stance took: xdot Ts / 2 keeps the speed, the rest changes it. A new
  desired velocity is taken up only as the foot leaves the ground.
* **Height**, by thrust: at greatest compression the leg's spring is lengthened by what the coming flight will cost.
* **Attitude**, by hip torque while the foot is loaded, roll and pitch to upright and yaw to the direction of travel.

The state machine moves at control ticks:

    flight --touchdown--> loading --compressed--> compression --leg lengthens--> thrust --extended--> unloading --+
       ^                                                                                                        |
       +-------------------------------------------- foot off the ground --------------------------------------+

A robot that tips over or whose body touches the ground has *fallen*: its servos let go for good, and what is left is
a body on the ground.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from echelon.agents.wall_bumper import wall_bumper
from echelon.warp_kernels.character import NO_EVENT, Capsule, Population, View
from echelon.warp_kernels.contact import JointForces
from echelon.warp_kernels.model import ContactSite, Joint, Link, Matrix3, Model, Visual
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.spatial import apply, apply_transposed, dot
from echelon.warp_kernels.trace import (
    asin,
    atan2,
    clamp,
    equal,
    logical_not,
    maximum,
    minimum,
    probe,
    select,
    sincos,
    sqrt,
)

# ---- the machine -----------------------------------------------------------------------------------------------------
BODY_MASS = 15.0  # [kg]
BODY_RADII = (0.30, 0.26, 0.19)  # of the ellipsoid [m]
BODY_INERTIA = (0.90, 1.00, 1.10)  # [kg m^2]: a shell with its batteries at the rim, not a full ellipsoid
UPPER_LEG_MASS = 0.9  # [kg]
UPPER_LEG_LENGTH = 0.36  # [m]
LOWER_LEG_MASS = 0.5  # [kg]
LEG_LENGTH = 0.72  # hip to foot with the spring at rest [m]
FOOT_RADIUS = 0.035  # [m]
COLLISION_RADIUS = 0.35  # of the sphere that walls stop [m]
CAPSULE = Capsule((-0.04, 0.0, 0.0), (0.04, 0.0, 0.0), 0.26)  # that others touch: as long and wide as the body

# ---- its control -----------------------------------------------------------------------------------------------------
LEG_STIFFNESS = 6000.0  # [N/m]
LEG_DAMPING = 30.0  # [N s/m]
HOP_HEIGHT = 0.14  # rise of the body from liftoff to apex [m]
SPEED_GAIN = 0.085  # kx [s]
TRIM_GAIN = 0.012  # of the slow correction that takes out what is left of a speed error [s] a hop
TRIM_LIMIT = 0.04  # [m]
CHANGE_LIMIT = 1.1  # of a wanted velocity that is taken up at one liftoff; the rest waits for the next [m/s]
REACH_LIMIT = 0.42  # farthest the foot is put from beneath the hip [m]
SWING_STIFFNESS, SWING_DAMPING = 180.0, 11.0  # hip in flight [N m/rad], [N m s/rad]
TWIST_STIFFNESS, TWIST_DAMPING = 6.0, 0.25  # leg about its own axis in flight, where it weighs nothing
TILT_STIFFNESS, TILT_DAMPING = 260.0, 28.0  # hip roll and pitch in stance [N m/rad], [N m s/rad]
YAW_STIFFNESS, YAW_DAMPING = 22.0, 6.0  # [N m/rad], [N m s/rad]
YAW_LIMIT = 6.0  # the foot's patch transmits no more [N m]
FULL_LOAD = 120.0  # load on the foot at which hip torque is given in full [N]
RETRACTION = 0.06  # the leg is this much shorter while it swings [m]
EFFICIENCY = 0.80  # part of the spring's energy that reaches the next apex
THRUST_LIMIT = 0.12  # [m]
LIMP_DAMPING, LIMP_TWIST_DAMPING = 4.0, 0.1  # hip of a fallen robot [N m s/rad]
FALLEN_COSINE = 0.5  # of the tilt at which a robot counts as fallen: 60 degrees
USUAL_STANCE = 0.17  # [s], until the first stance has been timed
SHORTEST_STANCE, LONGEST_STANCE = 0.10, 0.30  # a measured stance is held between these [s]
SWING_TIME = 0.16  # for which the leg stays short after liftoff [s]
START_HEIGHT = 0.08  # of the foot above the ground, on average [m]
TURN_SPEED = 0.4  # below this desired speed a robot keeps facing where it faces [m/s]
TURN_LIMIT = 0.5  # the desired heading turns by no more than this a hop [rad]

FLIGHT, LOADING, COMPRESSION, THRUST, UNLOADING, FALLEN = range(6)
FOOT, BELLY, BUMPER = "foot", "belly", "bumper"

HIP, LEG = 7, 10  # coordinates: three of the hip, one of the leg
HIP_SPEED, LEG_SPEED = 6, 9

STEEL = (0.42, 0.44, 0.47)
RUBBER = (0.10, 0.10, 0.11)


def hopper_model() -> Model:
    """The robot's links, joints, contact sites and looks."""
    half = 0.5 * UPPER_LEG_LENGTH
    rod = UPPER_LEG_MASS * UPPER_LEG_LENGTH**2 / 12.0
    shin_length = LEG_LENGTH - 0.30
    shin = LOWER_LEG_MASS * shin_length**2 / 12.0
    body = Link(
        name="body",
        parent=None,
        joint=Joint("root", "free", position=(0.0, 0.0, LEG_LENGTH + FOOT_RADIUS)),
        mass=BODY_MASS,
        inertia=_diagonal(*BODY_INERTIA),
        visuals=(
            Visual("ellipsoid", BODY_RADII),
            # An eye, so that one can see where it faces.
            Visual("ellipsoid", (0.05, 0.12, 0.05), position=(0.255, 0.0, 0.05), color=(0.03, 0.03, 0.04)),
            Visual("cylinder", (0.10, 0.03, 0.0), position=(0.0, 0.0, 0.18), color=STEEL),
        ),
    )
    upper = Link(
        name="upper_leg",
        parent="body",
        joint=Joint(
            "hip",
            "gimbal",
            axes=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
            limits=((-1.1, 1.1), (-1.1, 1.1), (-1.5, 1.5)),
            limit_stiffness=400.0,
            limit_damping=10.0,
        ),
        mass=UPPER_LEG_MASS,
        com=(0.0, 0.0, -half),
        inertia=_diagonal(rod + 0.001, rod + 0.001, 0.0015),
        visuals=(Visual("cylinder", (0.045, half - 0.04, 0.0), position=(0.0, 0.0, -half - 0.04), color=STEEL),),
    )
    lower = Link(
        name="lower_leg",
        parent="upper_leg",
        # Positive displacement lengthens the leg; zero is the spring's rest length.
        joint=Joint(
            "leg",
            "slider",
            axes=((0.0, 0.0, -1.0),),
            limits=((-0.34, 0.14),),
            limit_stiffness=40_000.0,
            limit_damping=150.0,
        ),
        mass=LOWER_LEG_MASS,
        com=(0.0, 0.0, -LEG_LENGTH + 0.5 * shin_length),
        inertia=_diagonal(shin + 0.0005, shin + 0.0005, 0.0008),
        visuals=(
            Visual("cylinder", (0.024, 0.5 * shin_length, 0.0), position=(0.0, 0.0, -LEG_LENGTH + 0.5 * shin_length)),
            Visual("ellipsoid", (0.06, 0.06, FOOT_RADIUS), position=(0.0, 0.0, -LEG_LENGTH), color=RUBBER),
        ),
    )
    return Model(
        name="hopper",
        links=(body, upper, lower),
        contacts=(
            ContactSite(
                FOOT,
                "lower_leg",
                (0.0, 0.0, -LEG_LENGTH),
                radii=(FOOT_RADIUS, FOOT_RADIUS, FOOT_RADIUS),
                stiffness=50_000.0,
                damping=170.0,
                tangential_stiffness=40_000.0,
                tangential_damping=100.0,
                friction=1.0,
                patch_radius=0.035,
                integration="explicit",
            ),
            ContactSite(
                BELLY,
                "body",
                (0.0, 0.0, 0.0),
                radii=BODY_RADII,
                stiffness=30_000.0,
                damping=700.0,
                tangential_stiffness=15_000.0,
                tangential_damping=400.0,
                friction=0.7,
                patch_radius=0.06,
                rolling_resistance=0.025,
                integration="explicit",
                use="rare",
            ),
            wall_bumper(BUMPER, "body", COLLISION_RADIUS),
        ),
    )


def _diagonal(x: float, y: float, z: float) -> Matrix3:
    return ((x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z))


class Hopper:
    """The hopper as a `Character`: commands are the desired velocity along world x and y [m/s]."""

    name: str = "hopper"
    commands: tuple[str, ...] = ("velocity_x", "velocity_y")
    phase_names: tuple[str, ...] = ("flight", "loading", "compression", "thrust", "unloading", "fallen")
    events: tuple[str, ...] = ("touchdown", "liftoff", "fall")
    records: tuple[str, ...] = ()
    capsules: tuple[Capsule, ...] = (CAPSULE,)
    # Measured: hopping at 1/720 s and at 1/2400 s differs by under one per cent in speed, height and rhythm.
    steps_per_second: int = 720
    steps_per_tick: int = 6
    memory: Mapping[str, float] = {
        "phase": FLIGHT,
        "fallen": 0.0,
        "loaded": 0.0,
        # latched while substepping, in this frame
        "touchdown": NO_EVENT,
        "liftoff": NO_EVENT,
        "fall": NO_EVENT,
        # latched until control has seen it
        "touched": 0.0,
        # 1 from the first loss of load in thrust until the next landing, so that a hop has one liftoff
        "away": 1.0,
        "watch_touchdown": 0.0,
        "watch_liftoff": 0.0,
        # ticks in this phase, and of this stance; seconds of the last one
        "in_phase": 0.0,
        "stance": 0.0,
        "stance_time": USUAL_STANCE,
        # what is wanted since the last liftoff
        "wanted_x": 0.0,
        "wanted_y": 0.0,
        "trim_x": 0.0,
        "trim_y": 0.0,
        # of the hop since the last liftoff: sums of speed over its ticks, and how many
        "travel_x": 0.0,
        "travel_y": 0.0,
        "hop": 0.0,
        "heading": 0.0,
        # servo targets
        "hip_x": 0.0,
        "hip_y": 0.0,
        "leg": 0.0,
        # what the hip does in this phase
        "hip_stiffness": 0.0,
        "hip_damping": 0.0,
        "twist_stiffness": 0.0,
        "twist_damping": 0.0,
        "grip": 0.0,
        "yaw_moment": 0.0,
    }
    parameters: Mapping[str, float] = {"leg_stiffness": LEG_STIFFNESS, "hop_height": HOP_HEIGHT}

    def __init__(self) -> None:
        self.body = Body.from_dict(hopper_model().to_dict())

    def population(self, count: int, seed: int, variation: float, in_phase: bool) -> Population:
        """Robots in the air above their places, facing anywhere, leg and hop a little different from one to the next.

        Args:
            count: How many.
            seed: Of what differs.
            variation: Relative standard deviation of leg stiffness and hop height.
            in_phase: All start at the same height, and so at the same phase of their hop.
        """
        # Five numbers an agent, from its own counter, so that agent i is the same in any crowd.
        bits = np.random.Philox(key=seed).random_raw(count * 8).reshape(count, 8)
        uniform = (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53
        spread = np.sqrt(-2.0 * np.log(1.0 - uniform[:, 0])) * variation
        angle = 2.0 * math.pi * uniform[:, 1]
        yaw = 2.0 * math.pi * uniform[:, 2] - math.pi
        q = np.tile(self.body.q_reference, (count, 1))
        q[:, 2] += START_HEIGHT if in_phase else START_HEIGHT * 2.0 * uniform[:, 3]
        q[:, 5], q[:, 6] = np.sin(0.5 * yaw), np.cos(0.5 * yaw)
        return Population(
            q=q,
            u=np.zeros((count, self.body.u_count)),
            parameters={
                "leg_stiffness": LEG_STIFFNESS * (1.0 + np.clip(spread * np.cos(angle), -0.3, 0.3)),
                "hop_height": HOP_HEIGHT * (1.0 + np.clip(spread * np.sin(angle), -0.3, 0.3)),
            },
            memory={"heading": yaw},
        )

    # ---- every control tick ------------------------------------------------------------------------------------------
    def control(self, view: View) -> None:
        """Move the state machine, place the foot, choose the leg's length."""
        memory = view.memory
        phase = memory["phase"]
        leg, leg_rate = view.q[LEG], view.u[LEG_SPEED]
        compression = memory["leg"] - leg
        touched = memory["touched"] > 0.5
        loaded = memory["loaded"] > 0.5

        in_flight, in_loading = equal(phase, FLIGHT), equal(phase, LOADING)
        in_compression, in_thrust = equal(phase, COMPRESSION), equal(phase, THRUST)
        in_unloading = equal(phase, UNLOADING)
        fallen = memory["fallen"] > 0.5

        landing = in_flight & touched
        leaving = in_unloading & logical_not(loaded)
        following = phase
        following = select(landing, float(LOADING), following)
        following = select(in_loading & (compression > 0.012), float(COMPRESSION), following)
        # A bounce that never loads the leg goes straight back to flight.
        following = select(
            in_loading & logical_not(loaded) & (0.03 / view.tick < memory["in_phase"]), float(FLIGHT), following
        )
        deepest = in_compression & (leg_rate > 0.0)
        following = select(deepest, float(THRUST), following)
        following = select(in_thrust & (compression < 0.012), float(UNLOADING), following)
        following = select(in_thrust & logical_not(loaded), float(UNLOADING), following)
        following = select(leaving, float(FLIGHT), following)
        following = select(fallen, float(FALLEN), following)

        self._take_up(view, leaving)
        self._thrust(view, deepest, leg)
        self._place_foot(view)

        # Time is counted in ticks; seconds are made of it where they are needed.
        memory["in_phase"] = select(equal(following, phase), memory["in_phase"] + 1.0, 0.0)
        standing = in_loading | in_compression | in_thrust | in_unloading
        stance = select(standing, memory["stance"] + 1.0, 0.0)
        measured = clamp(view.tick * stance, SHORTEST_STANCE, LONGEST_STANCE)
        memory["stance_time"] = select(leaving, measured, memory["stance_time"])
        memory["stance"] = select(leaving, 0.0, stance)
        memory["touched"] = select(leaving | landing, 0.0, memory["touched"])
        memory["away"] = select(landing, 0.0, memory["away"])
        memory["phase"] = following
        self._begin_phase(view)

    def _begin_phase(self, view: View) -> None:
        """What the hip does in this phase: swing, push against tilt, or hang limp; and what to watch for."""
        memory = view.memory
        phase, limp = memory["phase"], memory["fallen"] > 0.5
        swinging = equal(phase, FLIGHT)
        memory["hip_stiffness"] = select(swinging, SWING_STIFFNESS, 0.0)
        memory["hip_damping"] = select(limp, LIMP_DAMPING, select(swinging, SWING_DAMPING, 0.0))
        memory["twist_stiffness"] = select(swinging, TWIST_STIFFNESS, 0.0)
        memory["twist_damping"] = select(limp, LIMP_TWIST_DAMPING, select(swinging, TWIST_DAMPING, 0.0))
        memory["grip"] = select(equal(phase, COMPRESSION) | equal(phase, THRUST), 1.0, 0.0)
        # What to latch until the next tick.
        waiting = swinging & (memory["touched"] < 0.5)
        memory["watch_touchdown"] = select(waiting, 1.0, 0.0)
        pushing_off = (equal(phase, THRUST) | equal(phase, UNLOADING)) & (memory["away"] < 0.5)
        memory["watch_liftoff"] = select(pushing_off, 1.0, 0.0)
        rotation, _ = view.kin.world(view.kin.tree.node_of_link[0])
        sine, cosine = _heading_error(memory["heading"], rotation)
        turn = select(cosine < 0.0, select(sine < 0.0, -1.0, 1.0), sine)
        memory["yaw_moment"] = clamp(YAW_STIFFNESS * turn - YAW_DAMPING * view.u[5], -YAW_LIMIT, YAW_LIMIT)

    def _take_up(self, view: View, leaving: Any) -> None:
        """At liftoff, and only then: a new desired velocity, a new heading, and the trim of the last hop's error."""
        memory, command = view.memory, view.command
        hop = memory["hop"] + 1.0
        memory["hop"] = select(leaving, 0.0, hop)
        changes = []
        for axis, speed in (("x", view.u[0]), ("y", view.u[1])):
            travel = memory[f"travel_{axis}"] + speed
            memory[f"travel_{axis}"] = select(leaving, 0.0, travel)
            # The mean speed of the hop, since the body slows in every stance and liftoff alone would flatter it.
            error = memory[f"wanted_{axis}"] - travel / hop
            # Only small errors are the trim's business: a push or a new command is the gain's.
            correction = select(error * error < 0.16, TRIM_GAIN * error, 0.0)
            trim = clamp(memory[f"trim_{axis}"] + correction, -TRIM_LIMIT, TRIM_LIMIT)
            memory[f"trim_{axis}"] = select(leaving, trim, memory[f"trim_{axis}"])
            changes.append(command[f"velocity_{axis}"] - memory[f"wanted_{axis}"])
        size = sqrt(changes[0] * changes[0] + changes[1] * changes[1])
        share = minimum(CHANGE_LIMIT / maximum(size, 1e-6), 1.0)
        for axis, change in zip(("x", "y"), changes, strict=True):
            wanted = memory[f"wanted_{axis}"]
            memory[f"wanted_{axis}"] = select(leaving, wanted + share * change, wanted)
        x, y = command["velocity_x"], command["velocity_y"]
        turn = atan2(y, x) - memory["heading"]
        turn = select(math.pi < turn, turn - 2.0 * math.pi, turn)
        turn = select(turn < -math.pi, turn + 2.0 * math.pi, turn)
        heading = memory["heading"] + clamp(turn, -TURN_LIMIT, TURN_LIMIT)
        heading = select(math.pi < heading, heading - 2.0 * math.pi, heading)
        heading = select(heading < -math.pi, heading + 2.0 * math.pi, heading)
        turning = leaving & (x * x + y * y > TURN_SPEED * TURN_SPEED)
        memory["heading"] = select(turning, heading, memory["heading"])

    def _thrust(self, view: View, deepest: Any, leg: Any) -> None:
        """At greatest compression, lengthen the spring so that its energy will lift the body to the next apex."""
        memory = view.memory
        rotation, _ = view.kin.world(view.kin.tree.node_of_link[1])
        upright = rotation[2][2]  # cosine of the leg's tilt
        stiffness = view.parameters["leg_stiffness"]
        compressed = -leg
        lift = compressed * upright + view.parameters["hop_height"]
        weight = self.body.mass * self.body.gravity
        energy = weight * lift / EFFICIENCY
        length = sqrt(maximum(2.0 * energy / stiffness, 0.0)) - compressed
        thrust = clamp(length, 0.0, THRUST_LIMIT)
        phase = memory["phase"]
        # Short while swinging forward, long again before it lands; thrust lasts until the foot is off the ground.
        swinging = equal(phase, FLIGHT) & (memory["in_phase"] < SWING_TIME / view.tick)
        aloft = select(swinging, -RETRACTION, 0.0)
        length = select(equal(phase, FLIGHT), aloft, memory["leg"])
        length = select(equal(phase, LOADING) | equal(phase, COMPRESSION), 0.0, length)
        memory["leg"] = select(deepest, thrust, length)

    def _place_foot(self, view: View) -> None:
        """Hip angles that put the foot where it will bring about the wanted velocity."""
        memory = view.memory
        half_stance = 0.5 * memory["stance_time"]
        ahead = []
        for axis, speed in (("x", view.u[0]), ("y", view.u[1])):
            error = speed - memory[f"wanted_{axis}"]
            ahead.append(half_stance * speed + SPEED_GAIN * error - memory[f"trim_{axis}"])
        reach = sqrt(ahead[0] * ahead[0] + ahead[1] * ahead[1])
        shorten = minimum(REACH_LIMIT / maximum(reach, 1e-3), 1.0)
        x, y = shorten * ahead[0] / LEG_LENGTH, shorten * ahead[1] / LEG_LENGTH
        down = -sqrt(maximum(1.0 - x * x - y * y, 0.1))
        rotation, _ = view.kin.world(view.kin.tree.node_of_link[0])
        # The leg points along (-sin b, sin a cos b, -cos a cos b) of the body after turns a about x and b about y.
        along = apply_transposed(rotation, [x, y, down])
        flight = equal(memory["phase"], FLIGHT)
        memory["hip_x"] = select(flight, clamp(atan2(along[1], -along[2]), -1.0, 1.0), memory["hip_x"])
        memory["hip_y"] = select(flight, clamp(asin(-along[0]), -1.0, 1.0), memory["hip_y"])
        probe("hopper.hip_x", memory["hip_x"])
        probe("hopper.hip_y", memory["hip_y"])

    # ---- every substep -----------------------------------------------------------------------------------------------
    def actuate(self, view: View, joints: JointForces) -> None:
        """Leg spring, hip servo in flight, attitude torque in stance; latch touchdown, liftoff and fall."""
        memory, h = view.memory, view.implicit_step
        q, u = view.q, view.u
        load = view.contacts[FOOT].normal_force
        rotation, _ = view.kin.world(view.kin.tree.node_of_link[0])
        self._latch(view, load, rotation)

        joints.servo(
            LEG_SPEED, q[LEG], u[LEG_SPEED], memory["leg"], 0.0, view.parameters["leg_stiffness"], LEG_DAMPING, h
        )

        kp, kv = memory["hip_stiffness"], memory["hip_damping"]
        joints.servo(HIP_SPEED, q[HIP], u[HIP_SPEED], memory["hip_x"], 0.0, kp, kv, h)
        joints.servo(HIP_SPEED + 1, q[HIP + 1], u[HIP_SPEED + 1], memory["hip_y"], 0.0, kp, kv, h)
        kp, kv = memory["twist_stiffness"], memory["twist_damping"]
        joints.servo(HIP_SPEED + 2, q[HIP + 2], u[HIP_SPEED + 2], 0.0, 0.0, kp, kv, h)

        # Attitude, only while the foot bears weight, since the foot would slip otherwise.
        share = memory["grip"] * minimum(load * (1.0 / FULL_LOAD), 1.0)
        omega = list(u[3:6])
        # Turning the body by z_body x z_world would bring it upright; both in the body's axes.
        moment_x = share * (-TILT_STIFFNESS * rotation[2][1] - TILT_DAMPING * omega[0])
        moment_y = share * (TILT_STIFFNESS * rotation[2][0] - TILT_DAMPING * omega[1])
        moment_z = share * memory["yaw_moment"]
        # The leg is pushed the other way; a hip torque is the moment's component along its axis.
        moment = [-moment_x, -moment_y, -moment_z]
        third = view.kin.tree.node_of_link[1]  # the hip is three one-axis nodes, the last of which is the leg
        turn_1, turn_2 = view.kin.rotation[third - 2], view.kin.rotation[third - 1]
        axis_2 = [turn_1[i][1] for i in range(3)]
        axis_3 = apply(turn_1, [turn_2[i][2] for i in range(3)])
        joints.tau[HIP_SPEED] = joints.tau[HIP_SPEED] + moment[0]
        joints.tau[HIP_SPEED + 1] = joints.tau[HIP_SPEED + 1] + dot(axis_2, moment)
        joints.tau[HIP_SPEED + 2] = joints.tau[HIP_SPEED + 2] + dot(axis_3, moment)
        probe("hopper.load", load)

    def _latch(self, view: View, load: Any, rotation: Any) -> None:
        """Notice what happens between ticks; control says what to watch for."""
        memory = view.memory
        bears = load > 0.0
        touch = bears & (memory["watch_touchdown"] > 0.5)
        lift = logical_not(bears) & (memory["watch_liftoff"] > 0.5)
        memory["touchdown"] = select(touch, view.substep, memory["touchdown"])
        memory["liftoff"] = select(lift, view.substep, memory["liftoff"])
        memory["watch_touchdown"] = select(touch, 0.0, memory["watch_touchdown"])
        memory["watch_liftoff"] = select(lift, 0.0, memory["watch_liftoff"])
        memory["touched"] = select(touch, 1.0, memory["touched"])
        memory["away"] = select(lift, 1.0, memory["away"])
        memory["loaded"] = select(bears, 1.0, 0.0)
        down = (rotation[2][2] < FALLEN_COSINE) | (view.contacts[BELLY].normal_force > 0.0)
        newly = down & (memory["fallen"] < 0.5)
        memory["fall"] = select(newly, view.substep, memory["fall"])
        memory["fallen"] = select(down, 1.0, memory["fallen"])


def _heading_error(heading: Any, rotation: Any) -> tuple[Any, Any]:
    """Sine and cosine (times a positive length) of the turn from where the body faces to the desired heading."""
    sine, cosine = sincos(heading)
    facing_x, facing_y = rotation[0][0], rotation[1][0]
    return facing_x * sine - facing_y * cosine, facing_x * cosine + facing_y * sine
