"""How a rider drives: crank torque from speed, shared by two legs, through gears and a chain to the rear wheel.

* **Torque**, equation 7 of *Animating Human Athletics*, in the reading tau = k (v_d - v): here k = K r G, so that a
  metre a second too slow is answered by the same force on the road in every gear. It is bounded by what a rider can
  do: a power for ever and a larger one for about a minute. What is ridden above the first is taken from a *reserve*
  [J] that fills again below it.
* **Sharing**, equations 8 to 10: with th the right crank's angle from the top, the right leg gives w = (sin th + 1) / 2
  of it and the left leg the rest; for braking torque the other way round. The forces are tangential, so that the sum of
  both is the torque at every angle. Each leg's joint torques are those that push its pedal with its force; servos along
  the leg's inverse kinematics do the rest.
* **Gears**: the ratio follows the speed so that the cadence stays at 80 a minute, smoothly, as if there were a sprocket
  for every ratio.
* **The chain** is a spring between crank and rear wheel. Its twist is integrated from the rate G crank - wheel, so that
  the ratio may change under load. Without a freewheel it pushes both ways, and the legs turn as long as the wheel does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from echelon.warp_kernels.trace import absolute, clamp, maximum, minimum, select

POWER_SUSTAINED, POWER_PEAK = 300.0, 550.0  # of the usual rider [W]
PEAK_TIME = 60.0  # for which a rested rider can give the peak power [s]
RECOVERY = 0.5  # part of the power left unused that fills the reserve
FADING = 0.1  # the last part of the reserve, over which what can be given falls to the sustained power

SPEED_GAIN = 300.0  # K: force on the road for each m/s that is missing [N s/m]
TORQUE_LIMIT, SLOWING_LIMIT = 110.0, 60.0  # of the crank, forwards and backwards [N m]
TORQUE_FILTER = 0.08  # time constant of the torque [s]

CADENCE = 80.0 * 2.0 * math.pi / 60.0  # that gears are chosen for [rad/s]
LOWEST_GEAR, HIGHEST_GEAR = 1.0, 4.5  # turns of the wheel for a turn of the cranks
SHIFTING = 1.0  # time constant of the ratio [s]

CHAIN_STIFFNESS, CHAIN_DAMPING = 400.0, 0.7  # at the wheel [N m/rad], [N m s/rad]

BRAKE_MARGIN = 0.4  # brakes are left alone until a rider is this much too fast [m/s]
BRAKE_GAIN = 1.5  # deceleration for each m/s beyond that [1/s]
BRAKE_LIMIT = 2.5  # the strongest braking [m/s^2]; at 3.5 the rear wheel, almost unloaded, slides
BRAKE_LEAN = 0.75  # at which next to no braking is left [rad]
FRONT_SHARE = 0.8  # of the front wheel's brake
FULL_GRIP = 1.0  # wheels that turn slower than this are braked less, and stay where they stand [rad/s]


def wanted_torque(
    speed_error: Any, gear: Any, crank_rate: Any, power: Any, wheel_radius: float, freewheel: bool
) -> Any:
    """Torque that the legs are to give [N m].

    Args:
        speed_error: By how much the bicycle is too slow [m/s].
        gear: Turns of the wheel for a turn of the cranks.
        crank_rate: [rad/s].
        power: That may be given [W].
        wheel_radius: [m].
        freewheel: Whether pushing backwards is of no use.
    """
    torque = (SPEED_GAIN * wheel_radius) * gear * speed_error
    most = minimum(power / maximum(crank_rate, 1.0), TORQUE_LIMIT)
    return clamp(torque, 0.0 if freewheel else -SLOWING_LIMIT, most)


def available_power(reserve: Any, sustained: Any, peak: Any) -> Any:
    """What a rider can give with so much left in reserve [W], [J]."""
    fading = maximum(FADING * PEAK_TIME * (peak - sustained), 1.0)
    return sustained + (peak - sustained) * clamp(reserve / fading, 0.0, 1.0)


def reserve_after(reserve: Any, power: Any, sustained: Any, peak: Any, tick: float) -> Any:
    """The reserve after a tick at this power [J]."""
    over = power - sustained
    change = select(over < 0.0, RECOVERY * over, over)
    return clamp(reserve - tick * change, 0.0, PEAK_TIME * (peak - sustained))


def wanted_gear(wheel_rate: Any) -> Any:
    """The ratio at which the cadence is the usual one."""
    return clamp(wheel_rate * (1.0 / CADENCE), LOWEST_GEAR, HIGHEST_GEAR)


def right_share(torque: Any, sine: Any) -> Any:
    """Part of the torque that the right leg gives (equation 8), from the sine of its crank's angle from the top."""
    share = 0.5 * sine + 0.5
    return select(torque < 0.0, 1.0 - share, share)


def brake_torque(speed_error: Any, lean: Any, mass: float, wheel_radius: float) -> Any:
    """What both brakes hold wheels back with, together [N m].

    Args:
        speed_error: Negative when too fast [m/s].
        lean: Either way: in a bend the tyres have less to spare [rad].
        mass: Of bicycle and rider [kg].
        wheel_radius: [m].
    """
    most = BRAKE_LIMIT * maximum(1.0 - absolute(lean) * (1.0 / BRAKE_LEAN), 0.1)
    deceleration = clamp(-BRAKE_GAIN * (speed_error + BRAKE_MARGIN), 0.0, most)
    return (mass * wheel_radius) * deceleration


@dataclass(frozen=True)
class Chain:
    """What the chain does in a substep.

    Attributes:
        twist: By how far the crank side runs ahead, at the wheel [rad].
        torque: On the wheel [N m]; on the cranks it is -gear times this.
        implicit: What the wheel's inertia is raised by [kg m^2]; the cranks' by gear^2 times this.
    """

    twist: Any
    torque: Any
    implicit: Any

    @classmethod
    def pulled(
        cls, twist: Any, gear: Any, crank_rate: Any, wheel_rate: Any, step: float, implicit_step: float, freewheel: bool
    ) -> Chain:
        """The chain after the last step's motion.

        Spring and damper are taken implicitly at each end for itself: how both ends accelerate together is left out,
        which weighs as if a gram sat on the rim.
        """
        rate = gear * crank_rate - wheel_rate
        twist = twist + step * rate
        if freewheel:
            twist = maximum(twist, 0.0)
        torque = CHAIN_STIFFNESS * twist + (CHAIN_DAMPING + implicit_step * CHAIN_STIFFNESS) * rate
        if freewheel:
            torque = maximum(torque, 0.0)
        return cls(twist, torque, implicit_step * (CHAIN_DAMPING + implicit_step * CHAIN_STIFFNESS))
