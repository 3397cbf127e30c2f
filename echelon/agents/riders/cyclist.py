"""The cyclist: a rider on a racing bicycle who balances, steers, pedals, and can fall.

Twelve segments (or the fifteen of the 1995 paper) on a bicycle of five links, 28 (33) speeds, closed into loops by
springs at hands and feet and by the chain. What is controlled, and where it stands:

* **Balance and direction**: `steering` gives the fork an angle from lean and heading; the arms' inverse kinematics and
  servos bring it there. No torque acts on the fork itself.
* **Speed**: `pedalling` gives a crank torque from the speed error, within the rider's power; legs push the pedals with
  it, and their servos follow the inverse kinematics of the pedals' circle; ankles swing as measured in cyclists.
* Waist (and neck and wrists) are held; the pelvis turns freely on the saddle.

Air resists with 1/2 rho CdA v^2, less what shelter spares; each wheel's bearing and tyre with a torque proportional to
its rate. What the road does comes through the tyres alone.

A rider who leans by more than 55 degrees, or of whom anything but a tyre touches the ground, has *fallen*: the hands
let go, servos go limp within a fifth of a second, the feet come out of the pedals, and what is left lies on the ground.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from echelon.agents.riders.bicycle import (
    FRONT_SPEED,
    FRONT_TYRE,
    REAR_SPEED,
    REAR_TYRE,
    STEER,
    STEER_SPEED,
    BicycleParameters,
    racing_bicycle,
)
from echelon.agents.riders.body import (
    CRANK,
    SIDES,
    RiderParameters,
    cyclist_model,
    rider_capsules,
)
from echelon.agents.riders.limbs import ArmReach, leg_pose
from echelon.agents.riders.pedalling import (
    CADENCE,
    FRONT_SHARE,
    FULL_GRIP,
    HIGHEST_GEAR,
    LOWEST_GEAR,
    PEAK_TIME,
    POWER_PEAK,
    POWER_SUSTAINED,
    SHIFTING,
    TORQUE_FILTER,
    Chain,
    available_power,
    brake_torque,
    reserve_after,
    right_share,
    wanted_gear,
    wanted_torque,
)
from echelon.agents.riders.steering import (
    FORK_FILTER,
    FORK_LIMIT,
    PURSUIT_FILTER,
    Attitude,
    filtered,
    followed_curvature,
    heading_fork,
    pursuit_fork,
    wanted_curvature,
)
from echelon.warp_kernels.character import NO_EVENT, Capsule, Population, View
from echelon.warp_kernels.contact import JointForces
from echelon.warp_kernels.model import Model
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.trace import absolute, clamp, guarded, logical_not, maximum, probe, select, sincos, sqrt

AIR_DENSITY = 1.2  # [kg/m^3]
DRAG_AREA = 0.29  # CdA of the usual rider [m^2]
DRAG_HEIGHT = 1.05  # at which the air pushes [m]
LEAN_LIMIT = math.radians(35.0)  # that the usual rider dares in a bend
FALLEN_COSINE = math.cos(math.radians(55.0))
LIMP_TIME = 0.2  # in which a fallen rider's servos let go [s]
LIMP_DAMPING = 0.06  # part of their damping that stays
END_STIFFNESS, END_DAMPING = 150.0, 1.0  # of a limp body's joints at the end of their range [N m/rad], [N m s/rad]
POWER_FILTER = 0.25  # time constant of the power that is recorded [s]
SEAT_DAMPING = 5.0  # of the pelvis on the saddle [N m s/rad]

# Servos: stiffness [N m/rad] and damping [N m s/rad].
WAIST = (1500.0, 100.0)
SHOULDER, SHOULDER_TURN = (500.0, 20.0), (200.0, 8.0)
ELBOW = (400.0, 15.0)
HIP, KNEE, ANKLE = (200.0, 6.0), (200.0, 6.0), (500.0, 10.0)
NECK, WRIST = (60.0, 3.0), (80.0, 1.5)

RIDING, BRAKING, FALLEN = range(3)
LEG_JOINTS = ("hip", "knee", "ankle")
ARM_JOINTS = ("elbow", "forward", "abduction")
ARM_AXES = ("elbow", "shoulder.1", "shoulder.2", "shoulder.3")


@dataclass(frozen=True)
class _Axis:
    """One axis of a joint: its places in q and u."""

    q: int
    u: int


def _memory() -> dict[str, float]:
    names = {
        "phase": float(RIDING),
        "fallen": 0.0,
        "loaded": 0.0,
        "fall": NO_EVENT,
        # measures
        "power": 0.0,  # through the chain, smoothed [W]
        "cadence": 0.0,  # turns of the cranks a minute
        "gear": 2.0,  # turns of the wheel for a turn of the cranks
        "lean": 0.0,  # to the right [rad]
        "steer": 0.0,  # to the left [rad]
        "crank_torque": 0.0,  # that the legs are to give [N m]
        # the rest
        "reserve": PEAK_TIME * (POWER_PEAK - POWER_SUSTAINED),  # [J]
        "twist": 0.0,  # of the chain [rad]
        "fork": 0.0,  # angle that the arms are asked for [rad]
        "turning": 0.0,  # curvature that is wanted, once and twice filtered [1/m]
        "curvature": 0.0,
        "strength": 1.0,  # of the servos: 0 is limp
        "brake": 0.0,  # [N m]
        "drag": 0.0,  # of the air [N s/m]
        "drag_moment": 0.0,  # [N m]
    }
    for side, _ in SIDES:
        for joint in LEG_JOINTS:
            names |= {f"{side}_{joint}": 0.0, f"{side}_{joint}_rate": 0.0, f"{side}_{joint}_torque": 0.0}
        for joint in ARM_JOINTS:
            names[f"{side}_{joint}"] = 0.0
    return names


class Cyclist:
    """A rider on a racing bicycle as a `Character`.

    Commands, each frame:

    * ``velocity_x``, ``velocity_y``: from the rear wheel's contact towards the point to steer for; its length is the
      speed to ride at [m/s].
    * ``look_ahead``: Distance to that point [m]; 0 steers by the paper's law, for the heading alone.
    * ``shelter``: Part of the air's resistance that others spare, 0 to 1.

    Args:
        rider: How large and heavy.
        bicycle: What is ridden; `body.fitted_bicycle` sets one up for the rider.
        fifteen_segments: The rider of 1995, with head and hands of its own, instead of that of 1998.
        freewheel: Whether the chain only drives, so that legs may rest; a fixed gear otherwise, as in the papers.
        brakes: Whether there are any; slowing down is left to the legs otherwise, as in the papers.
    """

    commands: tuple[str, ...] = ("velocity_x", "velocity_y", "look_ahead", "shelter")
    phase_names: tuple[str, ...] = ("riding", "braking", "fallen")
    events: tuple[str, ...] = ("fall",)
    records: tuple[str, ...] = ("power", "cadence", "gear", "lean", "steer", "crank_torque")
    memory: Mapping[str, float] = _memory()
    parameters: Mapping[str, float] = {
        "power_sustained": POWER_SUSTAINED,
        "power_peak": POWER_PEAK,
        "drag_area": DRAG_AREA,
        "lean_limit": LEAN_LIMIT,
    }
    # Measured: gaits, gaps and balance of power are the same at 480 and at 2400 a second; at 360 springs break.
    steps_per_second: int = 900
    steps_per_tick: int = 10

    def __init__(
        self,
        rider: RiderParameters | None = None,
        bicycle: BicycleParameters | None = None,
        *,
        fifteen_segments: bool = False,
        freewheel: bool = False,
        brakes: bool = True,
    ) -> None:
        self.rider = rider or RiderParameters()
        self.bicycle = bicycle or racing_bicycle()
        self.freewheel = freewheel
        self.brakes = brakes
        self.fifteen_segments = fifteen_segments
        self.name = "cyclist-1995" if fifteen_segments else "cyclist"
        self.body = Body.from_dict(cyclist_model(self.rider, self.bicycle, fifteen_segments=fifteen_segments).to_dict())
        self.capsules: tuple[Capsule, ...] = rider_capsules(self.rider, self.bicycle)
        self._arms = ArmReach(self.rider, self.bicycle)
        self._axes = _axes_by_name(self.body)
        self._limits = _limits(self.body, self._axes)
        self._rare = tuple(s.name for s in self.body.contacts if s.use == "rare" and s.surface == "ground")

    # ---- starting ----------------------------------------------------------------------------------------------------
    def population(
        self,
        count: int,
        seed: int,
        variation: float,
        in_phase: bool,
        *,
        heading: float | np.ndarray = 0.0,
        speed: float | np.ndarray = 6.0,
        grade: float | np.ndarray = 0.0,
    ) -> Population:
        """Riders on their way, upright, cranks anywhere, each with a strength of its own.

        Args:
            count: How many.
            seed: Of what differs.
            variation: Relative standard deviation of the powers.
            in_phase: All start with the same crank angle.
            heading: Direction in plan, from x towards y [rad], one or one a rider.
            speed: Along the road [m/s], likewise.
            grade: Of the road along the heading, rise over run, likewise.
        """
        # Numbers of an agent's own counter, so that agent i is the same in any crowd.
        bits = np.random.Philox(key=seed).random_raw(count * 8).reshape(count, 8)
        uniform = (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53
        spread = np.clip(np.sqrt(-2.0 * np.log(1.0 - uniform[:, 0])) * variation, -0.4, 0.4)
        angle = 2.0 * math.pi * uniform[:, 1]
        crank = np.full(count, 0.5 * math.pi) if in_phase else 2.0 * math.pi * uniform[:, 2] - math.pi
        heading, speed, grade = (np.broadcast_to(np.asarray(x, dtype=float), (count,)) for x in (heading, speed, grade))
        gear = np.clip(speed / (self.bicycle.rear_wheel.radius * CADENCE), LOWEST_GEAR, HIGHEST_GEAR)
        q, u = self.riding(heading, speed, grade, crank, gear)
        sustained = POWER_SUSTAINED * (1.0 + spread * np.cos(angle))
        peak = np.maximum(POWER_PEAK * (1.0 + spread * np.sin(angle)), sustained)
        return Population(
            q=q,
            u=u,
            parameters={"power_sustained": sustained, "power_peak": peak},
            memory={"gear": gear, "reserve": PEAK_TIME * (peak - sustained)},
        )

    def riding(
        self, heading: np.ndarray, speed: np.ndarray, grade: np.ndarray, crank: np.ndarray, gear: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """States of riders who roll straight ahead, hands on the bars and feet on the pedals.

        Args:
            heading, speed, grade: As for `population`, shape [riders].
            crank: Angle of the cranks, 0 with the left one forward [rad], shape [riders].
            gear: Turns of the wheel for a turn of the cranks, shape [riders].

        Returns:
            q and u, shapes [riders, q_count] and [riders, u_count].
        """
        p, count = self.bicycle, len(speed)
        q = np.tile(self.body.q_reference, (count, 1))
        u = np.zeros((count, self.body.u_count))
        rate = speed / (p.rear_wheel.radius * gear)
        self._sit(q, u, crank, rate)
        load = self.body.mass * self.body.gravity / p.tyre.stiffness
        front = load * self.body.center_of_mass(q)[:, 0] / p.wheelbase
        climb = np.arctan(grade)
        pitch = -climb + np.arcsin((2.0 * front - load) / p.wheelbase)
        normal = np.column_stack([-np.sin(climb) * np.cos(heading), -np.sin(climb) * np.sin(heading), np.cos(climb)])
        along = np.column_stack([np.cos(climb) * np.cos(heading), np.cos(climb) * np.sin(heading), np.sin(climb)])
        q[:, 0:3] = (front - load)[:, None] * normal
        sine, cosine = np.sin(0.5 * pitch), np.cos(0.5 * pitch)
        q[:, 3], q[:, 4] = -np.sin(0.5 * heading) * sine, np.cos(0.5 * heading) * sine
        q[:, 5], q[:, 6] = np.sin(0.5 * heading) * cosine, np.cos(0.5 * heading) * cosine
        u[:, 0:3] = speed[:, None] * along
        u[:, REAR_SPEED], u[:, FRONT_SPEED] = speed / p.rear_wheel.radius, speed / p.front_wheel.radius
        return q, u

    def _sit(self, q: np.ndarray, u: np.ndarray, crank: np.ndarray, rate: np.ndarray) -> None:
        """Put riders into their posture, hands and feet where they belong, at a crank angle and its rate."""
        q[:, self._axes[CRANK].q], u[:, self._axes[CRANK].u] = crank, rate
        q[:, self._axes["seat"].q] = self.rider.pelvis_pitch
        q[:, self._axes["waist.1"].q] = self.rider.waist_flexion
        if self.fifteen_segments:
            q[:, self._axes["neck"].q] = self.rider.neck_flexion
        nudge = 1e-5
        for side, sign in SIDES:
            now, later = (
                self._leg(sign, np.sin(angle), np.cos(angle), self.rider.pelvis_pitch)
                for angle in (crank, crank + nudge)
            )
            for joint in LEG_JOINTS:
                axis = self._axes[f"{side}_{joint}"]
                q[:, axis.q] = getattr(now, joint)
                u[:, axis.u] = (getattr(later, joint) - getattr(now, joint)) / nudge * rate
            straight = np.zeros(len(q)), np.ones(len(q))
            for name, value in zip(ARM_AXES, self._arms.angles(sign, *straight), strict=True):
                q[:, self._axes[f"{side}_{name}"].q] = value

    def _leg(self, sign: float, crank_sine: Any, crank_cosine: Any, pitch: Any) -> Any:
        """A leg's pose; the left crank is on top a quarter turn before it points forward."""
        return leg_pose(self.rider, self.bicycle, sign * crank_cosine, -sign * crank_sine, pitch)

    # ---- every control tick ------------------------------------------------------------------------------------------
    def control(self, view: View) -> None:
        """Balance, choose torque, gear and brakes, and lay out what limbs do until the next tick."""
        memory, command, u = view.memory, view.command, view.u
        rotation, _ = view.kin.world(view.kin.tree.node_of_link[0])
        attitude = Attitude.of(rotation, u[0:3], u[3:6])
        x, y = command["velocity_x"], command["velocity_y"]
        error = sqrt(x * x + y * y) - attitude.speed
        fallen = memory["fallen"] > 0.5
        memory["strength"] = select(fallen, maximum(memory["strength"] - view.tick / LIMP_TIME, 0.0), 1.0)
        self._steer(view, attitude)
        self._pedal(view, error)
        if self.brakes:
            brake = brake_torque(error, attitude.lean, self.body.mass, self.bicycle.rear_wheel.radius)
            memory["brake"] = select(fallen, 0.0, brake)
        air = (0.5 * AIR_DENSITY) * view.parameters["drag_area"] * (1.0 - command["shelter"])
        memory["drag"] = air * sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
        memory["drag_moment"] = (-DRAG_HEIGHT) * memory["drag"] * attitude.speed
        memory["lean"] = attitude.lean
        memory["steer"] = view.q[STEER]
        memory["phase"] = select(fallen, float(FALLEN), float(RIDING))
        if self.brakes:
            memory["phase"] = select(memory["brake"] > 0.0, float(BRAKING), memory["phase"])

    def _steer(self, view: View, attitude: Attitude) -> None:
        """The fork's angle, and arms that reach for the bars there."""
        memory, command = view.memory, view.command
        x, y, look_ahead = command["velocity_x"], command["velocity_y"], command["look_ahead"]
        lean_limit = view.parameters["lean_limit"]
        curvature = wanted_curvature(attitude, x, y, look_ahead, memory["curvature"], lean_limit)
        memory["turning"] = followed_curvature(memory["turning"], curvature, attitude.speed, view.tick)
        memory["curvature"] = filtered(memory["curvature"], memory["turning"], PURSUIT_FILTER, view.tick)
        pursuit, _ = pursuit_fork(attitude, memory["curvature"], self.bicycle)
        fork = select(look_ahead > 0.0, pursuit, heading_fork(attitude, x, y))
        fork = clamp(fork, -FORK_LIMIT, FORK_LIMIT)
        memory["fork"] = filtered(memory["fork"], fork, FORK_FILTER, view.tick)
        probe("cyclist.fork", memory["fork"])
        sine, cosine = sincos(memory["fork"])
        for side, sign in SIDES:
            elbow, forward, abduction, _ = self._arms.angles(sign, sine, cosine)
            memory[f"{side}_elbow"] = elbow
            memory[f"{side}_forward"] = forward
            memory[f"{side}_abduction"] = abduction

    def _pedal(self, view: View, error: Any) -> None:
        """Gear, crank torque within the rider's power, and legs that give it."""
        memory, parameters, tick = view.memory, view.parameters, view.tick
        crank = self._axes[CRANK]
        crank_rate = view.u[crank.u]
        memory["gear"] = filtered(memory["gear"], wanted_gear(view.u[REAR_SPEED]), SHIFTING, tick)
        sustained, peak = parameters["power_sustained"], parameters["power_peak"]
        memory["reserve"] = reserve_after(memory["reserve"], memory["power"], sustained, peak, tick)
        power = available_power(memory["reserve"], sustained, peak)
        radius = self.bicycle.rear_wheel.radius
        torque = wanted_torque(error, memory["gear"], crank_rate, power, radius, self.freewheel)
        torque = memory["strength"] * filtered(memory["crank_torque"], torque, TORQUE_FILTER, tick)
        memory["crank_torque"] = torque
        memory["cadence"] = (60.0 / (2.0 * math.pi)) * crank_rate
        probe("cyclist.crank_torque", torque)

        pitch, pitch_rate = view.q[self._axes["seat"].q], view.u[self._axes["seat"].u]
        angle = view.q[crank.q]
        # Targets run along a straight line from here to where the leg will be a tick from now.
        now, middle, later = (sincos(angle + part * tick * crank_rate) for part in (0.0, 0.5, 1.0))
        half_pitch_sine, half_pitch_cosine = sincos(pitch + 0.5 * tick * pitch_rate)
        share = right_share(torque, -middle[1])
        for side, sign in SIDES:
            here = self._leg(sign, *now, pitch)
            there = self._leg(sign, *later, pitch + tick * pitch_rate)
            pushing = self._leg(sign, *middle, pitch + 0.5 * tick * pitch_rate)
            force = torque * (share if sign < 0.0 else 1.0 - share) * (1.0 / self.bicycle.crank_length)
            # Tangential to the pedal's circle, forward over the top; then in the pelvis's axes.
            along_x, along_z = -sign * middle[0] * force, -sign * middle[1] * force
            pushed = (
                half_pitch_cosine * along_x - half_pitch_sine * along_z,
                half_pitch_sine * along_x + half_pitch_cosine * along_z,
            )
            for joint, given in zip(LEG_JOINTS, pushing.torques(pushed), strict=True):
                start, end = getattr(here, joint), getattr(there, joint)
                memory[f"{side}_{joint}"] = start
                memory[f"{side}_{joint}_rate"] = (end - start) * (1.0 / tick)
                memory[f"{side}_{joint}_torque"] = given

    # ---- every substep -----------------------------------------------------------------------------------------------
    def actuate(self, view: View, joints: JointForces) -> None:
        """Servos, chain, brakes, air and bearings; notice a fall and let go."""
        memory, u = view.memory, view.u
        fallen = self._latch(view)
        self._drive(view, joints)
        strength = memory["strength"]
        damping = LIMP_DAMPING + (1.0 - LIMP_DAMPING) * strength
        self._hold(view, joints, strength, damping)
        for side, _ in SIDES:
            for joint, (kp, kv) in zip(LEG_JOINTS, (HIP, KNEE, ANKLE), strict=True):
                rate, axis = memory[f"{side}_{joint}_rate"], self._axes[f"{side}_{joint}"]
                # Where the leg is to be at the end of the step.
                target = memory[f"{side}_{joint}"] + view.step * rate
                memory[f"{side}_{joint}"] = target
                kp_now, kv_now = kp * strength, kv * damping
                joints.servo(axis.u, view.q[axis.q], u[axis.u], target, rate, kp_now, kv_now, view.implicit_step)
                joints.tau[axis.u] = joints.tau[axis.u] + memory[f"{side}_{joint}_torque"]
            view.springs[f"{side}_grip"] = select(fallen, 0.0, 1.0)
            view.springs[f"{side}_pedal"] = select(strength > 0.0, 1.0, 0.0)
        self._limit(view, joints, fallen)
        for axis in range(3):
            joints.tau[axis] = joints.tau[axis] - memory["drag"] * u[axis]
        joints.tau[4] = joints.tau[4] + memory["drag_moment"]

    def _latch(self, view: View) -> Any:
        """Notice what happens between ticks; returns whether the rider has fallen."""
        memory, contacts = view.memory, view.contacts
        rotation, _ = view.kin.world(view.kin.tree.node_of_link[0])
        bears = (contacts[REAR_TYRE].normal_force > 0.0) | (contacts[FRONT_TYRE].normal_force > 0.0)
        memory["loaded"] = select(bears, 1.0, 0.0)
        down = rotation[2][2] < FALLEN_COSINE
        for name in self._rare:
            down = down | (contacts[name].depth > 0.0)
        before = memory["fallen"] > 0.5
        memory["fall"] = select(down & logical_not(before), view.substep, memory["fall"])
        memory["fallen"] = select(down, 1.0, memory["fallen"])
        return before | down

    def _drive(self, view: View, joints: JointForces) -> None:
        """Chain, brakes and bearings."""
        memory, u, h = view.memory, view.u, view.implicit_step
        crank, gear = self._axes[CRANK].u, memory["gear"]
        chain = Chain.pulled(memory["twist"], gear, u[crank], u[REAR_SPEED], view.step, h, self.freewheel)
        memory["twist"] = chain.twist
        joints.tau[REAR_SPEED] = joints.tau[REAR_SPEED] + chain.torque
        joints.tau[crank] = joints.tau[crank] - gear * chain.torque
        joints.implicit[REAR_SPEED] = joints.implicit[REAR_SPEED] + chain.implicit
        joints.implicit[crank] = joints.implicit[crank] + gear * gear * chain.implicit
        power = chain.torque * u[REAR_SPEED]
        memory["power"] = memory["power"] + (view.step / POWER_FILTER) * (power - memory["power"])
        p = self.bicycle
        for speed, damping in ((REAR_SPEED, p.rolling_resistance), (FRONT_SPEED, p.rolling_resistance)):
            joints.servo(speed, 0.0, u[speed], 0.0, 0.0, 0.0, damping, h)
        joints.servo(STEER_SPEED, 0.0, u[STEER_SPEED], 0.0, 0.0, 0.0, p.fork_damping, h)
        seat = self._axes["seat"].u
        joints.servo(seat, 0.0, u[seat], 0.0, 0.0, 0.0, SEAT_DAMPING, h)
        if self.brakes:
            for speed, part in ((REAR_SPEED, 1.0 - FRONT_SHARE), (FRONT_SPEED, FRONT_SHARE)):
                grip = clamp(u[speed] * (1.0 / FULL_GRIP), -1.0, 1.0)
                joints.tau[speed] = joints.tau[speed] - part * memory["brake"] * grip

    def _limit(self, view: View, joints: JointForces, fallen: Any) -> None:
        """Hold a limp body's joints within their range; while riding none comes near."""
        found = []
        for axis, (lower, upper) in self._limits:
            beyond = view.q[axis.q] - clamp(view.q[axis.q], lower, upper)
            slowed = select(absolute(beyond) > 0.0, END_DAMPING * view.u[axis.u], 0.0)
            found.append(-END_STIFFNESS * beyond - slowed)
        for (axis, _), push in zip(self._limits, guarded(fallen, found), strict=True):
            joints.tau[axis.u] = joints.tau[axis.u] + push

    def _hold(self, view: View, joints: JointForces, strength: Any, damping: Any) -> None:
        """Servos of what is held: waist, arms on the bars, and the neck and wrists of the rider who has them."""
        rider = self.rider
        held: list[tuple[str, Any, tuple[float, float]]] = [
            ("waist.1", rider.waist_flexion, WAIST),
            ("waist.2", 0.0, WAIST),
            ("waist.3", 0.0, WAIST),
        ]
        for side, sign in SIDES:
            held += [
                (f"{side}_shoulder.1", view.memory[f"{side}_forward"], SHOULDER),
                (f"{side}_shoulder.2", view.memory[f"{side}_abduction"], SHOULDER),
                (f"{side}_shoulder.3", -sign * rider.elbows_out, SHOULDER_TURN),
                (f"{side}_elbow", view.memory[f"{side}_elbow"], ELBOW),
            ]
            if self.fifteen_segments:
                held += [(f"{side}_wrist.1", 0.0, WRIST), (f"{side}_wrist.2", 0.0, WRIST)]
        if self.fifteen_segments:
            held.append(("neck", rider.neck_flexion, NECK))
        for name, target, (kp, kv) in held:
            axis = self._axes[name]
            joints.servo(
                axis.u, view.q[axis.q], view.u[axis.u], target, 0.0, kp * strength, kv * damping, view.implicit_step
            )


def _axes_by_name(body: Model) -> dict[str, _Axis]:
    """Every axis of every joint but the root's, by the name of its speed."""
    axes: dict[str, _Axis] = {}
    for index, link in enumerate(body.links):
        q, u, count = body.q_start(index), body.u_start(index), len(link.joint.axes)
        for place in range(count):
            name = link.joint.name if count == 1 else f"{link.joint.name}.{place + 1}"
            axes[name] = _Axis(q + place, u + place)
    return axes


def _limits(body: Model, axes: Mapping[str, _Axis]) -> tuple[tuple[_Axis, tuple[float, float]], ...]:
    """Axes whose joints have limits without springs, and the limits."""
    found: list[tuple[_Axis, tuple[float, float]]] = []
    for link in body.links:
        joint = link.joint
        for place, limit in enumerate(joint.limits):
            if limit is not None and joint.limit_stiffness == 0.0:
                name = joint.name if len(joint.axes) == 1 else f"{joint.name}.{place + 1}"
                found.append((axes[name], limit))
    return tuple(found)
