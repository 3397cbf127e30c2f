"""Chapter 4: how high and how far gymnasts leap, how hard the ground pushes them, and how much they turn.

Every trial is a gymnast of its own, all trials of an experiment and a body one batch. A rise is how much higher the
centre of mass comes than it is in standing; a distance is how far it has travelled when one stands again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.poses import inertia_tensor
from echelon.agents.gymnasts.script import Script, load_script
from echelon.benchmarks.thesis.experiments import FidelitySettings, Measure
from echelon.benchmarks.thesis.published import rows_by_body
from echelon.benchmarks.thesis.rows import Measured, Published
from echelon.benchmarks.thesis.trials import arrivals, gymnast_of, in_frame, speed_of, stays, trials

LEAP_SECONDS = 5.6  # from standing to long after a landing [s]
TAKEOFF_SECONDS = 1.9  # until all are in the air [s]
STANDS_AFTER = 2.5  # from touchdown, one is balanced then or not [s]
STILL = 0.1  # who stands has a centre of mass slower than this [m/s]
IN_THE_AIR = 0.03  # who has felt no ground for longer has left it [s]
UPRIGHT = 0.8  # who stands has a pelvis whose tilt has at least this cosine

WATCHED = (
    "row", "row_age", "time", "fallen", "com_height", "vx", "vy", "vz", "upright", "momentum_y", "unloaded",
    "peak_force", "q",
)  # fmt: skip

ROTATING_HEIGHT = 0.9  # whose crouch leaps are made from that shall turn [m]
TRIED_OFFSETS = (-0.04, 0.0, 0.04, 0.08)
TRIED_HIPS = (-0.6, -0.3, 0.0)
"""What the thesis's tables leave open: offsets of the centre of mass [m] and hip angles at liftoff [rad] that are tried
with each of its rows; the highest leap, or the farthest jump, counts."""


@dataclass(frozen=True)
class Leaps:
    """What became of leaps, an entry for each.

    Attributes:
        rise: How much higher the centre of mass came than in standing [m].
        distance: How far forward it was at the end [m].
        left: Whether the feet left the ground.
        balanced: Whether one who left it stands still on both feet, and has done so from 2.5 s after touchdown.
        liftoff: When the feet left the ground, from the beginning of the crouch [s]; NaN where they did not.
        push: Greatest vertical force of the ground until liftoff [N].
        landing: The same from touchdown on [N].
        momentum: Angular momentum in flight, forward positive [kg m^2/s]; NaN where the feet did not leave.
        inertia_rate: What that momentum turns the body's inertia at liftoff with [rad/s].
    """

    rise: np.ndarray
    distance: np.ndarray
    left: np.ndarray
    balanced: np.ndarray
    liftoff: np.ndarray
    push: np.ndarray
    landing: np.ndarray
    momentum: np.ndarray
    inertia_rate: np.ndarray


def script_of(maneuver: str, sex: str) -> Script:
    """A maneuver that ships, as it was tuned for the man or the woman."""
    return load_script(maneuver if sex == "male" else f"{maneuver}-female")


def leap(
    character: Gymnast,
    script: Script,
    values: Sequence[Mapping[str, float]],
    settings: FidelitySettings,
    seconds: float = LEAP_SECONDS,
) -> Leaps:
    """Leaps by one body, with parameters of their own each.

    Args:
        character: Who.
        script: With rows called crouch, push, flight and absorb.
        values: Parameters that differ from the script's, for each.
        settings: How to run them.
        seconds: For how long [s].
    """
    run = trials(character, script, values, settings)
    start = run.now("q")
    seen = run.run(seconds, WATCHED)
    end = seen["q"][-1]
    run.close()
    body = character.body
    standing = body.center_of_mass(start.astype(np.float64))
    crouch, touchdown = (arrivals(script, seen, row) for row in ("crouch", "absorb"))
    row = {name: script.row_names.index(name) for name in ("push", "absorb")}
    pushing, landing = seen["row"] == row["push"], seen["row"] >= row["absorb"]
    # One who turns too much to rise never comes to the script's flight, and leaves the ground nevertheless.
    off = (seen["row"] >= row["push"]) & (seen["unloaded"] > IN_THE_AIR) & (seen["fallen"] < 0.5)
    left, airborne = np.asarray(off.any(axis=0)), np.argmax(off, axis=0)
    momentum = np.where(left, in_frame(seen["momentum_y"], airborne), np.nan)
    inertia = np.array([inertia_tensor(character.body, q)[1, 1] for q in in_frame(seen["q"], airborne)])
    return Leaps(
        rise=seen["com_height"].max(axis=0) - standing[:, 2],
        distance=body.center_of_mass(end.astype(np.float64))[:, 0] - standing[:, 0],
        left=left,
        balanced=left & stands(seen, touchdown),
        liftoff=np.where(left, in_frame(seen["time"] - seen["unloaded"], airborne), np.nan) - crouch,
        push=np.max(seen["peak_force"] * pushing, axis=0),
        landing=np.max(seen["peak_force"] * landing, axis=0),
        momentum=momentum,
        inertia_rate=momentum / inertia,
    )


def stands(seen: Mapping[str, np.ndarray], touchdown: np.ndarray) -> np.ndarray:
    """Who is on its feet, upright and still, from `STANDS_AFTER` after touchdown to the end, shape [agents], bool."""
    on_feet = (seen["upright"] > UPRIGHT) & (seen["unloaded"] <= 0.0) & (seen["fallen"] < 0.5)
    return stays(on_feet & (speed_of(seen) < STILL), seen["time"], touchdown + STANDS_AFTER)


# ---- vertical leaps --------------------------------------------------------------------------------------------------
def leap_table(settings: FidelitySettings) -> list[Measured]:
    """Table 4.1: the thesis's crouches and leans, with what it leaves open tried."""
    found: list[Measured] = []
    for sex, rows in rows_by_body("leap-table").items():
        fixed = [{"crouch": row.number("l_hip [m]"), "lean": -row.number("hip [rad]")} for row in rows]
        found += _best(rows, _tried(sex, "vertical-leap", rows, fixed, settings), "rise")
    return found


def _tried(
    sex: str, maneuver: str, rows: Sequence[Published], fixed: Sequence[Mapping[str, float]], settings: FidelitySettings
) -> list[list[float]]:
    """For each row what every combination of `TRIED_OFFSETS` and `TRIED_HIPS` gave [m]; -1 where none left."""
    choices = [{"ahead": offset, "hip_end": hip} for offset in TRIED_OFFSETS for hip in TRIED_HIPS]
    values = [{**one, **choice, "by_height": 0.0} for one in fixed for choice in choices]
    leaps = leap(gymnast_of(sex), script_of(maneuver, sex), values, settings, 2.6)
    rises = np.where(leaps.left, leaps.rise, -1.0).reshape(len(rows), len(choices))
    return rises.tolist()


def _best(rows: Sequence[Published], tried: Sequence[Sequence[float]], what: str) -> list[Measured]:
    note = f"greatest {what} of several offsets of the centre of mass and hip angles at liftoff, which are not printed"
    return [
        Measured(row, max(values), note=note)
        if max(values) > 0.0
        else Measured(row, None, note="the feet did not leave the ground")
        for row, values in zip(rows, tried, strict=True)
    ]


def leap_command(settings: FidelitySettings) -> list[Measured]:
    """Figure 4.1: commanded heights, and whether one ends balanced."""
    return commanded("leap-command", "vertical-leap", "height", settings)


def commanded(experiment: str, maneuver: str, parameter: str, settings: FidelitySettings) -> list[Measured]:
    """How high or far those came who were told to, and whether they ended balanced.

    Args:
        experiment: Of whose rows one that has no command is about the greatest command of all.
        maneuver: What they do.
        parameter: Of its script, "height" or "distance".
        settings: How to run them.
    """
    found: list[Measured] = []
    for sex, rows in rows_by_body(experiment).items():
        asked = sorted({row.number("commanded [m]") for row in rows if row.given})
        leaps = leap(gymnast_of(sex), script_of(maneuver, sex), [{parameter: x} for x in asked], settings)
        reached = leaps.rise if parameter == "height" else leaps.distance
        for row in rows:
            place = asked.index(row.number("commanded [m]")) if row.given else -1
            found.append(Measured(row, float((leaps.balanced if row.quantity == "ends balanced" else reached)[place])))
    return found


def leap_force(settings: FidelitySettings) -> list[Measured]:
    """Figure 4.2: the force of the ground until liftoff."""
    found: list[Measured] = []
    for sex, rows in rows_by_body("leap-force").items():
        heights = sorted({row.number("commanded [m]") for row in rows})
        character = gymnast_of(sex)
        values = [{"height": height} for height in heights]
        leaps = leap(character, script_of("vertical-leap", sex), values, settings, TAKEOFF_SECONDS)
        weight = character.body.mass * character.body.gravity
        for row in rows:
            place = heights.index(row.number("commanded [m]"))
            value = leaps.liftoff[place] if row.unit == "s" else leaps.push[place]
            found.append(Measured(row, float(value / weight if row.unit == "body weight" else value)))
    return found


def leap_rotation(settings: FidelitySettings) -> list[Measured]:
    """Figure 4.5: the hip angle that is wanted at liftoff turns the body forwards or backwards."""
    found: list[Measured] = []
    for sex, rows in rows_by_body("leap-rotation").items():
        leaps = rotating_leaps(sex, [row.number("hip at liftoff [rad]") for row in rows], settings)
        for place, row in enumerate(rows):
            if leaps.left[place]:
                found.append(Measured(row, float(leaps.inertia_rate[place])))
            else:
                found.append(Measured(row, None, note="the feet did not leave the ground"))
    return found


def rotating_leaps(sex: str, hips: Sequence[float], settings: FidelitySettings) -> Leaps:
    """Leaps from the crouch of 0.9 m with other hip angles wanted at liftoff [rad]."""
    script = script_of("vertical-leap", sex)
    values = [{"height": ROTATING_HEIGHT, "hip": hip, "hip_by_height": 0.0} for hip in hips]
    return leap(gymnast_of(sex), script, values, settings, TAKEOFF_SECONDS)


# ---- broad jumps -----------------------------------------------------------------------------------------------------
def broad_table(settings: FidelitySettings) -> list[Measured]:
    """Table 4.2: the thesis's crouches, offsets and arms, with everything else as in our jump of that distance."""
    found: list[Measured] = []
    for sex, rows in rows_by_body("broad-table").items():
        values = [
            {
                "by_distance": 0.0,
                "crouch": row.number("l_hip [m]"),
                "ahead": row.number("offset [m]"),
                "shoulder": row.number("shoulder [rad]"),
                "distance": row.thesis or 0.0,
            }
            for row in rows
        ]
        jumps = leap(gymnast_of(sex), script_of("broad-jump", sex), values, settings)
        for place, row in enumerate(rows):
            if jumps.left[place]:
                how = "" if jumps.balanced[place] else "; did not end balanced"
                found.append(Measured(row, float(jumps.distance[place]), note=f"with our hip angle and timing{how}"))
            else:
                found.append(Measured(row, None, note="the feet did not leave the ground"))
    return found


def broad_command(settings: FidelitySettings) -> list[Measured]:
    """Figure 4.4: commanded distances, and whether one ends balanced."""
    return commanded("broad-command", "broad-jump", "distance", settings)


MEASURES: Mapping[str, Measure] = {
    "leap-table": leap_table,
    "leap-command": leap_command,
    "leap-force": leap_force,
    "broad-table": broad_table,
    "broad-command": broad_command,
    "leap-rotation": leap_rotation,
}
"""Measuring functions by experiment."""
