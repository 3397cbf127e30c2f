"""The gymnast: a human body whose servos follow a script, with feedback where the script asks for it.

The bodies are those of *Simulation of Leaping, Tumbling, Landing, and Balancing Humans* (see `body`). What
one does is a script (see `script`), one row after another; everything here is the same for all of them, and a row says
how much of it takes part:

* **Paths.** Each channel (see `channels`) moves along a Hermite curve to its row's target.
* **Balance**, equations 7.1 and 7.2: the centre of mass is held over the middle of the feet by leaning on the ankles,

      offset = kp (COM_d - COM) - kv d(COM)/dt,

  which is taken from the ankles' desired pitch and added to their roll, and a share of which the hips take the other
  way (`balance`, `com_x`, `com_y`, `hip_share`).
* **Feet flat**, equations 7.3 and 7.4: what foot and ground are apart is taken from the ankle (`flat`).
* **The torso's pitch by the hips**: the hip wants to be where it is, turned by what the pelvis is off (`upright`).
* **Foot placement** before a landing, equation 6.1: hips swing the feet to where they should meet the ground ahead of
  the centre of mass, which depends on how fast it travels (`placement`).

Signs are those of the bodies' axes: x forward, y left, z up, a positive pitch leans forward. A gymnast faces its
`heading`, and forward is along that, whatever the pelvis does meanwhile.

One who touches the ground with anything but feet or hands, or leans too far where the row forbids it, has *fallen*:
the servos let go, and a body comes to rest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from echelon.agents.gymnasts.body import HEIGHTS, Sex, gymnast_body
from echelon.agents.gymnasts.channels import (
    CHANNELS,
    GROUPS,
    LIMBS,
    NECK,
    NECK_JOINT,
    SHOULDER,
    SIDES,
    SPINE,
    SPINE_JOINTS,
    JointAxis,
    shoulder_orientation,
)
from echelon.agents.gymnasts.joints import joint_strength
from echelon.agents.gymnasts.measures import (
    MEASURES,
    least,
    look_ahead,
    mass_in_motion,
    mean,
    measure_pelvis,
    middle,
    place_of,
    total,
)
from echelon.agents.gymnasts.posture import channels_of
from echelon.agents.gymnasts.standing import standing_q
from echelon.warp_kernels.character import NO_EVENT, Population, View
from echelon.warp_kernels.contact import JointForces
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.scripts import CAPTURED, PATH_PARTS, ScriptLayout, path_now
from echelon.warp_kernels.spatial import Vector, apply_transposed, cross
from echelon.warp_kernels.trace import asin, clamp, logical_not, maximum, minimum, select, sincos

GAINS: Mapping[str, tuple[float, float]] = {
    "hip": (2075.0, 150.0),
    "hip_side": (3105.0, 223.0),
    "hip_turn": (800.0, 50.0),
    "knee": (1600.0, 70.0),
    "ankle": (902.0, 18.0),
    "ankle_side": (1040.0, 17.0),
    "toe": (446.0, 4.0),
    "neck": (150.0, 9.0),
    "clavicle": (600.0, 25.0),
    "shoulder": (350.0, 25.0),
    "elbow": (70.0, 5.0),
    "wrist": (5.0, 0.3),
}
"""kp [N m/rad] and kv [N m s/rad] of the male's servos, by group."""

SPINE_GAINS: Mapping[str, tuple[float, float]] = {
    "spine_l3": (1671.0, 151.0),
    "spine_l1": (3200.0, 190.0),
    "spine_t7": (2800.0, 140.0),
    "spine_t4": (2200.0, 100.0),
}
GAIN_BODY = 97.84 * 1.84**2  # mass times height squared of the body that the gains above are for [kg m^2]
ARMS_SPREAD = 0.2  # of one who stands at ease [rad]
LIMP_STIFFNESS, LIMP_DAMPING = 0.01, 0.2  # what is left of the gains of one who has fallen
FALL_FORCE = 40.0  # on a part that should not touch the ground [N]
FALL_TIME = 0.03  # for which it does before one has fallen [s]
FEELS = 5.0  # a foot or hand that is pressed harder than this is loaded [N]
STANDING_TILT = 10.0  # [rad]: never reached, so a row that names no `fall_tilt` allows any

SETTINGS: Mapping[str, float] = {
    **{f"kp.{group}": 1.0 for group in GROUPS},
    **{f"kv.{group}": 1.0 for group in GROUPS},
    "balance": 0.0,
    "com_x": 0.0,
    "com_y": 0.0,
    "balance_kpx": 4.7,
    "balance_kvx": 0.77,
    "balance_kpy": 2.06,
    "balance_kvy": 0.34,
    "hip_share": 1.2,
    "flat": 0.0,
    "upright": 0.0,
    "upright_pitch": 0.0,
    "upright_gain": 1.0,
    "upright_rate": 0.014,
    "placement": 0.0,
    "placement_kp": 2.0,
    "placement_kv": 0.1,
    "placement_x": 0.0,
    "placement_per_speed": 0.0,
    "placement_per_speed_squared": 0.0,
    "placement_upright": 0.6,
    "placement_from_here": 0.0,
    "push_x": 0.0,
    "push_y": 0.0,
    "fall_tilt": STANDING_TILT,
    "ahead_height": 0.0,
    "ahead_inertia": 20.0,
    "step_damping": 1.0,
}
"""What a row sets, and what holds where it does not. `balance`, `flat`, `upright` and `placement` are shares from 0
(off) to 1; `com_x`, `com_y` are where the centre of mass should be from the middle of the feet [m]; `balance_kp*`
[rad/m] and `balance_kv*` [rad s/m] are those of equations 7.1 and 7.2; `upright_pitch` [rad], `upright_gain` and
`upright_rate` [s] turn the hips by the pelvis's pitch; `placement_kp` [rad/m] and `placement_kv` [rad s/m] are those of
6.1, the feet should be `placement_x` + `placement_per_speed` v + `placement_per_speed_squared` v |v| ahead of the
centre of mass [m], and are moved there while the cosine of the pelvis's tilt is above `placement_upright`, the hips
starting from where their path has them, or with `placement_from_here` of 1 from where they are, which leaves nothing of
the distance;
`push_x`, `push_y` are a force on the sternum, forward and to the left [N];
`fall_tilt` is how far the pelvis may tilt while a foot is loaded [rad]; `ahead_height` [m] and `ahead_inertia`
[kg m^2] are the height of the centre of mass over the ground until which, and the inertia with which,
`somersault_ahead` looks ahead; `step_damping` is how much is left of the damping that a step adds: a stiffness kp taken
implicitly over a step h damps as h kp does, some percent of kv; with 0 that is taken off kv, and servos damp alike with
every step."""

FOOT_LINKS = ("foot", "toes")
HAND_LINKS = ("hand",)


class Gymnast:
    """A human who follows a script, as a `Character`.

    Its parameters: `heading`, where it faces [rad]; `strength`, of all its servos.

    Args:
        body: Who; see `body.gymnast_body`.
        name: What scenarios call it.
        gain: Of all servos against the male's.
        strongest: Greatest torques of the joints, which the parameter `strength` multiplies as well, as
            `joints.joint_strength` has them [N m], shape [u_count, 2]; None for any.
    """

    commands: tuple[str, ...] = ()
    events: tuple[str, ...] = ("touchdown", "liftoff", "fall")
    records: tuple[str, ...] = (
        "row", "arrivals", "missed", *CAPTURED, "foot_force", "hand_force", "com_height", "vx", "vy", "vz",
        "somersault", "twist", "momentum_x", "momentum_y", "momentum_z", "peak_force",
    )  # fmt: skip
    phase_names: tuple[str, ...] = ("standing", "crouch", "push", "flight", "tumble", "landing", "hands", "fallen")
    steps_per_second: int = 1200
    steps_per_tick: int = 4
    script = ScriptLayout(CHANNELS, SETTINGS, MEASURES, resets=("knee_rate_peak", "peak_force"))
    parameters: Mapping[str, float] = {"heading": 0.0, "strength": 1.0}
    heights: tuple[str, ...] = ("ground",)

    def __init__(
        self,
        body: Body,
        name: str = "gymnast",
        gain: float = 1.0,
        strongest: np.ndarray | None = None,
    ) -> None:
        self.name = name
        self.body = body
        self.gain = gain
        self.strongest = strongest
        self._links = {link.name: index for index, link in enumerate(body.links)}
        self._joints = {link.joint.name: index for index, link in enumerate(body.links)}
        self.memory: Mapping[str, float] = self._memory()
        self._feet = [site for site in body.contacts if site.link.endswith(FOOT_LINKS)]
        self._hands = [site for site in body.contacts if site.link.endswith(HAND_LINKS)]
        self._others = [site for site in body.contacts if site not in self._feet and site not in self._hands]

    def _memory(self) -> dict[str, float]:
        kept: dict[str, float] = {"phase": 0.0, "fallen": 0.0, "loaded": 1.0}
        kept |= {"touchdown": NO_EVENT, "liftoff": NO_EVENT, "fall": NO_EVENT}
        kept |= {name: 0.0 for name in MEASURES}
        kept |= {
            "ground": 0.0,
            "knee_rate_peak": 0.0,
            "peak_force": 0.0,
            "lying": 0.0,
            "last_pitch": 0.0,
            "last_twist": 0.0,
        }
        # Over the whole run, for those who judge it.
        kept |= {"highest": 0.0, "hardest": 0.0}
        kept |= self.script.memory()
        for group in GROUPS:
            kept |= {f"kp.{group}": 1.0, f"kv.{group}": 1.0}
        for side in SIDES:
            kept |= {f"desired.{side}_{name}": 0.0 for name in LIMBS}
            kept |= {f"desired.{side}_shoulder.{part}": float(part == "w") for part in "xyzw"}
        kept |= {f"desired.{name}": 0.0 for name in (*SPINE, *NECK)}
        return kept

    def population(self, count: int, seed: int, variation: float, in_phase: bool) -> Population:
        """Gymnasts who stand at ease, soles on the ground, and whose strength differs by about `variation`."""
        bits = np.random.Philox(key=seed).random_raw(count * 2).reshape(count, 2)
        uniform = (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53
        normal = np.sqrt(-2.0 * np.log(1.0 - uniform[:, 0])) * np.cos(2.0 * math.pi * uniform[:, 1])
        q = self._at_ease
        posture = channels_of(self.body, q) | {f"{side}_shoulder_spread": ARMS_SPREAD for side in SIDES}
        return Population(
            q=np.tile(q, (count, 1)),
            u=np.zeros((count, self.body.u_count)),
            parameters={"strength": 1.0 + np.clip(variation * normal, -0.3, 0.3)},
            memory=self.remembering({channel: np.full(count, value) for channel, value in posture.items()}),
        )

    @cached_property
    def _at_ease(self) -> np.ndarray:
        """Generalised positions of one who stands with the arms hanging, shape [q_count]."""
        return standing_q(self.body, arms=0.5 * math.pi - ARMS_SPREAD)

    @staticmethod
    def remembering(channels: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The memory of gymnasts whose channels are where they want them to be, each of shape [agents]."""
        kept: dict[str, np.ndarray] = {}
        for channel, value in channels.items():
            for name in (f"path.{channel}.start", f"path.{channel}.target", f"wanted.{channel}", f"measured.{channel}"):
                kept[name] = np.asarray(value)
        return kept

    # ---- every control tick ------------------------------------------------------------------------------------------
    def control(self, view: View) -> None:
        """Measure, move along the paths, and add what the row asks for."""
        memory = view.memory
        self._measure(view)
        memory["row_age"] = memory["row_age"] + view.tick
        memory["time"] = memory["time"] + view.tick
        wanted = self._follow_paths(view)
        self._balance(view, wanted)
        self._hold_torso(view, wanted)
        self._place_feet(view, wanted)
        self._flatten_feet(view, wanted)
        self._hand_to_servos(view, wanted)

    def _measure(self, view: View) -> None:
        """What balance and transitions go by, into memory."""
        memory = view.memory
        c, s = _cosine_and_sine(view.parameters["heading"])

        def facing(vector: Sequence[Any]) -> Vector:
            """A vector of the world along forward, left and up."""
            return [c * vector[0] + s * vector[1], c * vector[1] - s * vector[0], vector[2]]

        center, velocity, momentum = mass_in_motion(self.body, view.kin)
        feet = [place_of(self.body, view.kin, site) for site in self._feet]
        hands = [place_of(self.body, view.kin, site) for site in self._hands]
        lowest_foot = least([place[2] for place in feet])
        loaded = memory["foot_force"] > FEELS
        memory["ground"] = select(loaded, lowest_foot, memory["ground"])
        memory["foot_clearance"] = lowest_foot - memory["ground"]
        if hands:
            memory["hand_clearance"] = least([place[2] for place in hands]) - memory["ground"]
        sole = facing([middle([place[axis] for place in feet]) for axis in range(3)])
        forward = facing(center)
        memory["com_x"], memory["com_y"] = forward[0] - sole[0], forward[1] - sole[1]
        memory["feet_x"] = sole[0] - forward[0]
        memory["com_height"] = center[2] - memory["ground"]
        memory["highest"] = maximum(memory["highest"], memory["com_height"])
        # By what the body's momentum gained, not by what contacts ask for before their dampers give way (see
        # `contact`): a foot of 1 kg that stops within a substep asks for much more than the ground ever carries.
        gained = (velocity[2] - memory["vz"]) * (1.0 / view.tick)
        memory["reaction"] = select(memory["time"] > 0.0, self.body.mass * (gained + self.body.gravity), 0.0)
        memory["peak_force"] = maximum(memory["peak_force"], memory["reaction"])
        memory["hardest"] = maximum(memory["hardest"], memory["reaction"])
        memory["vx"], memory["vy"], memory["vz"] = facing(velocity)
        memory["momentum_x"], memory["momentum_y"], memory["momentum_z"] = facing(momentum)
        measure_pelvis(view, facing)
        look_ahead(memory, self.body.gravity)
        knee_rates = [view.u[self._speed(LIMBS["knee"], side)] for side in SIDES]
        memory["hip"] = mean([view.q[self._coordinate(LIMBS["hip"], side)] for side in SIDES])
        memory["knee"] = mean([view.q[self._coordinate(LIMBS["knee"], side)] for side in SIDES])
        memory["knee_rate"] = mean(knee_rates)
        memory["knee_rate_peak"] = maximum(memory["knee_rate_peak"], memory["knee_rate"])
        memory["knee_rate_share"] = memory["knee_rate"] / maximum(memory["knee_rate_peak"], 0.1)
        tilted = (memory["upright"] < self._cosine_of(memory["row.fall_tilt"])) & loaded
        down = tilted | (memory["lying"] > FALL_TIME) | (memory["fallen"] > 0.5)
        newly = down & (memory["fallen"] < 0.5)
        memory["fall"] = select(newly, maximum(view.substep, 0.0), memory["fall"])
        memory["fallen"] = select(down, 1.0, 0.0)
        memory["phase"] = select(down, float(len(self.phase_names) - 1), memory["phase"])
        for side in SIDES:
            for name, joint in LIMBS.items():
                sign = joint.sign * (joint.mirror if side == "right" else 1.0)
                memory[f"measured.{side}_{name}"] = sign * view.q[self._coordinate(joint, side)]
        # What is several joints, or three angles of one, is taken to be where it should be.
        for channel in (*(f"{side}_{name}" for side in SIDES for name in SHOULDER), *SPINE, *NECK):
            memory[f"measured.{channel}"] = memory[f"wanted.{channel}"]

    @staticmethod
    def _cosine_of(angle: Any) -> Any:
        return _cosine_and_sine(minimum(angle, math.pi))[0]

    def _follow_paths(self, view: View) -> dict[str, Any]:
        """Where each channel should be now by its path; ages the paths."""
        memory = view.memory
        wanted: dict[str, Any] = {}
        for channel in CHANNELS:
            age = f"path.{channel}.age"
            memory[age] = memory[age] + view.tick
            value, rate = path_now({part: memory[f"path.{channel}.{part}"] for part in PATH_PARTS})
            memory[f"wanted.{channel}"], memory[f"wanted_rate.{channel}"] = value, rate
            wanted[channel] = value
        return wanted

    def _balance(self, view: View, wanted: dict[str, Any]) -> None:
        """Equations 7.1 and 7.2: ankles lean against where the centre of mass is off, hips bend the other way."""
        memory = view.memory
        share = memory["row.balance"]
        offset_x = memory["row.balance_kpx"] * (memory["row.com_x"] - memory["com_x"])
        offset_x = share * (offset_x - memory["row.balance_kvx"] * memory["vx"])
        offset_y = memory["row.balance_kpy"] * (memory["row.com_y"] - memory["com_y"])
        offset_y = share * (offset_y - memory["row.balance_kvy"] * memory["vy"])
        for side, outwards in (("left", 1.0), ("right", -1.0)):
            wanted[f"{side}_ankle"] = wanted[f"{side}_ankle"] - offset_x
            wanted[f"{side}_hip"] = wanted[f"{side}_hip"] + memory["row.hip_share"] * offset_x
            wanted[f"{side}_ankle_roll"] = wanted[f"{side}_ankle_roll"] + outwards * offset_y
            wanted[f"{side}_hip_spread"] = wanted[f"{side}_hip_spread"] - outwards * memory["row.hip_share"] * offset_y

    def _hold_torso(self, view: View, wanted: dict[str, Any]) -> None:
        """Hips turn the pelvis to the pitch that it should have, from wherever they are."""
        memory = view.memory
        share = memory["row.upright"]
        turn = memory["row.upright_gain"] * (memory["pitch"] - memory["row.upright_pitch"])
        turn = turn + memory["row.upright_rate"] * memory["pitch_rate"]
        for side in SIDES:
            here = view.q[self._coordinate(LIMBS["hip"], side)]
            wanted[f"{side}_hip"] = wanted[f"{side}_hip"] + share * (here + turn - wanted[f"{side}_hip"])

    def _place_feet(self, view: View, wanted: dict[str, Any]) -> None:
        """Equation 6.1: hips swing the feet to where they should come down, as seen from the centre of mass."""
        memory = view.memory
        speed = memory["vx"]
        size = maximum(speed, -speed)
        desired = memory["row.placement_x"] + memory["row.placement_per_speed"] * speed
        desired = desired + memory["row.placement_per_speed_squared"] * speed * size
        swing = memory["row.placement_kp"] * (desired - memory["feet_x"])
        # How fast the feet move from the centre of mass, by how fast the hips and the pelvis turn.
        rate = mean([view.u[self._speed(LIMBS["hip"], side)] for side in SIDES]) + memory["pitch_rate"]
        swing = swing + memory["row.placement_kv"] * rate
        running = memory["row.placement"] * select(memory["row.placement_upright"] < memory["upright"], 1.0, 0.0)
        for side in SIDES:
            here = view.q[self._coordinate(LIMBS["hip"], side)] - wanted[f"{side}_hip"]
            wanted[f"{side}_hip"] = wanted[f"{side}_hip"] + running * (memory["row.placement_from_here"] * here - swing)

    def _flatten_feet(self, view: View, wanted: dict[str, Any]) -> None:
        """Equations 7.3 and 7.4: an ankle wants to be where it is, less what the foot is off the level."""
        share = view.memory["row.flat"]
        for side, outwards in (("left", 1.0), ("right", -1.0)):
            rotation, _ = view.kin.world(view.kin.tree.node_of_link[self._links[f"{side}_foot"]])
            pitch = asin(clamp(-rotation[2][0], -1.0, 1.0))
            roll = asin(clamp(rotation[2][1], -1.0, 1.0))
            for channel, off in ((f"{side}_ankle", pitch), (f"{side}_ankle_roll", outwards * roll)):
                here = view.memory[f"measured.{channel}"]
                wanted[channel] = wanted[channel] + share * (here - off - wanted[channel])

    def _hand_to_servos(self, view: View, wanted: dict[str, Any]) -> None:
        """Desired coordinates of the joints, and the gains of this row."""
        memory = view.memory
        limp = memory["fallen"] > 0.5
        for group in GROUPS:
            strength = self.gain * view.parameters["strength"]
            memory[f"kp.{group}"] = strength * select(limp, LIMP_STIFFNESS, memory[f"row.kp.{group}"])
            memory[f"kv.{group}"] = strength * select(limp, LIMP_DAMPING, memory[f"row.kv.{group}"])
        for side in SIDES:
            for name, joint in LIMBS.items():
                sign = joint.sign * (joint.mirror if side == "right" else 1.0)
                memory[f"desired.{side}_{name}"] = sign * wanted[f"{side}_{name}"]
            angles = [wanted[f"{side}_{name}"] for name in ("shoulder", "shoulder_spread", "shoulder_turn")]
            for part, value in zip("xyzw", shoulder_orientation(side, *angles), strict=True):
                memory[f"desired.{side}_shoulder.{part}"] = value
        for name in SPINE:
            memory[f"desired.{name}"] = (1.0 / len(SPINE_JOINTS)) * wanted[name]
        for name in NECK:
            memory[f"desired.{name}"] = wanted[name]

    # ---- every substep -----------------------------------------------------------------------------------------------
    def actuate(self, view: View, joints: JointForces) -> None:
        """A servo at each joint, equation 3.3, and what contacts feel."""
        memory, h = view.memory, view.implicit_step
        taken_off = h * (1.0 - memory["row.step_damping"])

        def stiffness_and_damping(group: str, gains: tuple[float, float]) -> tuple[Any, Any]:
            kp, kv = gains[0] * memory[f"kp.{group}"], gains[1] * memory[f"kv.{group}"]
            # Not less than none: together with the step's own damping that is stable with any stiffness.
            return kp, maximum(kv - taken_off * kp, 0.0)

        def servo(joint: str, axis: int, desired: Any, group: str, gains: tuple[float, float]) -> None:
            at_q, at_u = self._place(joint, axis)
            kp, kv = stiffness_and_damping(group, gains)
            joints.servo(at_u, view.q[at_q], view.u[at_u], desired, 0.0, kp, kv, h, self._strength(view, at_u))

        for side in SIDES:
            for name, axis in LIMBS.items():
                joint = f"{side}_{axis.joint}"
                servo(joint, axis.axis, memory[f"desired.{side}_{name}"], axis.group, GAINS[axis.group])
            at_q, at_u = self._place(f"{side}_shoulder", 0)
            kp, kv = stiffness_and_damping("shoulder", GAINS["shoulder"])
            desired = [memory[f"desired.{side}_shoulder.{part}"] for part in "xyzw"]
            here, turning = list(view.q[at_q : at_q + 4]), list(view.u[at_u : at_u + 3])
            strengths = [self._strength(view, at_u + i) for i in range(3)]
            limited = [one for one in strengths if one is not None]
            joints.ball_servo(at_u, here, turning, desired, kp, kv, h, limited or None)
        for joint in SPINE_JOINTS:
            for name, axis in SPINE.items():
                servo(joint, axis, memory[f"desired.{name}"], "spine", SPINE_GAINS[joint])
        for name, axis in NECK.items():
            servo(NECK_JOINT, axis, memory[f"desired.{name}"], "neck", GAINS["neck"])
        c, s = _cosine_and_sine(view.parameters["heading"])
        x, y = memory["row.push_x"], memory["row.push_y"]
        view.pushes["sternum"] = [c * x - s * y, s * x + c * y, 0.0]
        self._feel(view)
        self._keep_momentum(view, joints, c, s)

    def _strength(self, view: View, speed: int) -> tuple[Any, Any] | None:
        """Greatest torques of an axis [N m], towards smaller and towards greater angles; None for any."""
        if self.strongest is None:
            return None
        low, high = (float(torque) for torque in self.strongest[speed])
        return low * view.parameters["strength"], high * view.parameters["strength"]

    def _feel(self, view: View) -> None:
        """Latch what the contacts carry."""
        memory = view.memory
        foot = total([view.contacts[site.name].normal_force for site in self._feet])
        hand = total([view.contacts[site.name].normal_force for site in self._hands])
        other = total([view.contacts[site.name].normal_force for site in self._others])
        loaded, before = foot > FEELS, memory["loaded"] > 0.5
        came_down, left = loaded & logical_not(before), logical_not(loaded) & before
        memory["touchdowns"] = memory["touchdowns"] + select(came_down & (memory["unloaded"] > 0.02), 1.0, 0.0)
        for event, happened in (("touchdown", came_down), ("liftoff", left)):
            memory[event] = select(happened & (memory[event] < 0.0), view.substep, memory[event])
        memory["loaded"] = select(loaded, 1.0, 0.0)
        memory["unloaded"] = select(loaded, 0.0, memory["unloaded"] + view.step)
        memory["hands_unloaded"] = select(hand > FEELS, 0.0, memory["hands_unloaded"] + view.step)
        memory["lying"] = select(other > FALL_FORCE, memory["lying"] + view.step, 0.0)
        memory["foot_force"], memory["hand_force"] = foot, hand

    def _keep_momentum(self, view: View, joints: JointForces, c: Any, s: Any) -> None:
        """In the air, a moment on the pelvis against what the step adds to the angular momentum L.

        Semi-implicit Euler takes L, seen from the turning pelvis, ahead by -h omega x L where it should turn it, and
        so lengthens it by h/2 |omega x L|^2 a second for each of its own: some percent in a fast twist. The next term
        of that turn, h/2 omega x (omega x L) as a moment, leaves its length.
        """
        memory = view.memory
        force = total([contact.normal_force for contact in view.contacts.values()])
        airborne = select(force > 0.0, 0.0, 0.5 * view.implicit_step)
        x, y = memory["momentum_x"], memory["momentum_y"]
        in_world = [c * x - s * y, s * x + c * y, memory["momentum_z"]]
        rotation, _ = view.kin.world(0)
        omega = list(view.kin.omega[0])
        moment = cross(omega, cross(omega, apply_transposed(rotation, in_world)))
        for axis in range(3):
            joints.tau[3 + axis] = joints.tau[3 + axis] + airborne * moment[axis]

    # ---- where joints are --------------------------------------------------------------------------------------------
    def _place(self, joint: str, axis: int) -> tuple[int, int]:
        index = self._joints[joint]
        return self.body.q_start(index) + axis, self.body.u_start(index) + axis

    def _coordinate(self, joint: JointAxis, side: str) -> int:
        return self._place(f"{side}_{joint.joint}", joint.axis)[0]

    def _speed(self, joint: JointAxis, side: str) -> int:
        return self._place(f"{side}_{joint.joint}", joint.axis)[1]


def gymnast(
    sex: Sex,
    *,
    backpack: float = 0.0,
    height: float | None = None,
    mass: float | None = None,
    name: str = "",
    strength_limits: bool = False,
    joint_limits: bool = False,
    mat: bool = False,
) -> Gymnast:
    """A gymnast whose servos are as much stronger than the male's as its limbs are harder to move.

    Args:
        sex: Whose proportions.
        backpack: What is carried [kg]; servos stay those of the body without it.
        height, mass: Of the body [m], [kg]; None for the thesis's.
        name: What scenarios call it; made of the sex if empty.
        strength_limits: Whether joints are no stronger than a trained human's (see `joints`).
        joint_limits: Whether joints have soft stops where a human's end.
        mat: Whether the ground is a gymnastics mat's.
    """
    bare = gymnast_body(sex, height=height, mass=mass)
    tallness = HEIGHTS[sex] if height is None else height
    body = bare
    if backpack > 0.0 or joint_limits or mat:
        body = gymnast_body(sex, height=height, mass=mass, backpack=backpack, limits=joint_limits, mat=mat)
    strongest = joint_strength(body, sex, tallness, bare.mass) if strength_limits else None
    return Gymnast(body, name or f"gymnast-{sex}", bare.mass * tallness**2 / GAIN_BODY, strongest)


def _cosine_and_sine(angle: Any) -> tuple[Any, Any]:
    sine, cosine = sincos(angle)
    return cosine, sine
