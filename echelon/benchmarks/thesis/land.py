"""Chapter 6: from how high, and how fast, gymnasts land and find their balance.

Every trial is a gymnast of its own, all trials of an experiment and a body one batch. They begin in the air, in the
posture with which the script of the landing reaches for the ground, at a height and with a speed of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.agents.gymnasts.airborne import in_the_air
from echelon.agents.gymnasts.gymnast import Gymnast, gymnast
from echelon.agents.gymnasts.script import Script
from echelon.benchmarks.thesis.experiments import FidelitySettings, Measure
from echelon.benchmarks.thesis.leap import script_of, stands
from echelon.benchmarks.thesis.published import published_rows, rows_by_body
from echelon.benchmarks.thesis.rows import Measured, Published
from echelon.benchmarks.thesis.trials import arrivals, filtered_peak, gymnast_of, in_frame, trials

SECONDS = 4.5  # from the start of a fall to long after the landing [s]
FINE_FRAME_RATE = 1200
"""How often forces are followed and control decides [1/s]. Legs that reach for the ground are stiff, and those that
absorb give way: control that looks 300 times a second changes over up to 3.3 ms after the feet came down, and the peak
force is then up to 17 % larger or smaller by where in a tick that was."""
FALL_STEP, LOWEST_FALL, HIGHEST_FALL = 0.05, 0.2, 2.5  # [m]
LAW_FALLS = (0.2, 1.3)
"""Between these falls the growth of the peak force with the height is fitted [m]."""
HEIGHT_WITH_SPEED = 1.25  # of the centre of mass, where landings with speed begin [m]
SLOW = 0.1  # a centre of mass that is slower may be balanced wherever it is [m/s]
WATCHED = (
    "row", "row_age", "time", "fallen", "vx", "vy", "vz", "upright", "unloaded", "feet_x", "com_x",
)  # fmt: skip


@dataclass(frozen=True)
class Landings:
    """What became of landings, an entry for each.

    Attributes:
        balanced: Whether one stands still on both feet from 2.5 s after touchdown on.
        peak: Greatest vertical force of the ground, as a filtered force plate tells it [N] (see `filtered_peak`).
        feet_ahead: Feet ahead of the centre of mass at touchdown [m].
        speed_at_balance: Of the centre of mass, forward, when it is over the feet or slow, which is where the thesis
            lets balance take over [m/s]; NaN where it never was.
        seen: What was watched after each frame, by name, shape [frames, agents].
    """

    balanced: np.ndarray
    peak: np.ndarray
    feet_ahead: np.ndarray
    speed_at_balance: np.ndarray
    seen: Mapping[str, np.ndarray]


def land(
    character: Gymnast,
    script: Script,
    values: Sequence[Mapping[str, float]],
    settings: FidelitySettings,
    *,
    speeds: np.ndarray,
    falls: np.ndarray | None = None,
    height: float = HEIGHT_WITH_SPEED,
) -> Landings:
    """Landings by one body.

    Args:
        character: Who.
        script: With rows called reach, absorb and rise.
        values: Parameters that differ from the script's, for each.
        settings: How to run them.
        speeds: Forward, for each [m/s].
        falls: How high the soles begin, for each [m]; None where the centre of mass begins at `height`.
        height: Of the centre of mass, where `falls` is None [m].
    """
    first = script.table(character.body, values[0])
    people = in_the_air(character, first, speeds, falls=falls, height=height)
    run = trials(
        character,
        script,
        values,
        settings,
        frame_rate=FINE_FRAME_RATE,
        ticks_per_second=FINE_FRAME_RATE,
        people=people,
    )
    seen = run.run(SECONDS, WATCHED)
    run.close()
    touchdown = arrivals(script, seen, "absorb")
    landed = np.argmax(seen["row"] >= script.row_names.index("absorb"), axis=0)
    down = (seen["row"] >= script.row_names.index("rise")) & (seen["fallen"] < 0.5)
    over = down & ((seen["com_x"] * np.sign(speeds) >= 0.0) | (np.abs(seen["vx"]) < SLOW))
    return Landings(
        balanced=np.isfinite(touchdown) & stands(seen, touchdown),
        peak=filtered_peak(seen["vz"], character.body, FINE_FRAME_RATE),
        feet_ahead=in_frame(seen["feet_x"], landed),
        speed_at_balance=np.where(over.any(axis=0), in_frame(seen["vx"], np.argmax(over, axis=0)), np.nan),
        seen=seen,
    )


def falls_onto_feet(character: Gymnast, script: Script, falls: np.ndarray, settings: FidelitySettings) -> Landings:
    """Landings without horizontal speed, from heights of the soles [m]."""
    still = np.zeros(len(falls))
    return land(character, script, [{"speed": 0.0}] * len(falls), settings, speeds=still, falls=falls)


def growth(falls: np.ndarray, peaks: np.ndarray) -> float:
    """Exponent of the power of the height with which peaks grow, by least squares of the logarithms."""
    return float(np.polyfit(np.log(falls), np.log(peaks), 1)[0])


# ---- what was published ----------------------------------------------------------------------------------------------
def land_drop(settings: FidelitySettings) -> list[Measured]:
    """Section 6.2: the greatest fall, and how the peak force grows with it."""
    found: list[Measured] = []
    falls = np.round(np.append(np.arange(LOWEST_FALL, HIGHEST_FALL + 0.5 * FALL_STEP, FALL_STEP), 0.45), 3)
    falls = np.unique(falls)
    for sex, rows in rows_by_body("land-drop").items():
        character = gymnast_of(sex)
        landings = falls_onto_feet(character, script_of("drop-landing", sex), falls, settings)
        weight = character.body.mass * character.body.gravity
        failed = np.flatnonzero(~landings.balanced)
        greatest = falls[failed[0] - 1] if len(failed) and failed[0] else 0.0 if len(failed) else falls[-1]
        fitted = (falls >= LAW_FALLS[0]) & (falls <= LAW_FALLS[1])
        for row in rows:
            if row.quantity == "greatest fall":
                note = "" if len(failed) else "the highest that was tried"
                found.append(Measured(row, float(greatest), note=note))
            elif row.quantity == "peak force":
                at = int(np.argmin(np.abs(falls - row.number("fall [m]"))))
                found.append(Measured(row, float(landings.peak[at] / weight)))
            else:
                found.append(Measured(row, growth(falls[fitted], landings.peak[fitted])))
    return found


def land_speed(settings: FidelitySettings) -> list[Measured]:
    """Table 6.1: landings with horizontal speed."""
    found: list[Measured] = []
    for sex, rows in rows_by_body("land-speed").items():
        found += _with_speed(gymnast_of(sex), sex, rows, settings)
    return found


def land_backpack(settings: FidelitySettings) -> list[Measured]:
    """Table 6.2: the same with a backpack."""
    found: list[Measured] = []
    rows = published_rows("land-backpack")
    for mass in sorted({row.number("backpack [kg]") for row in rows}):
        carried = [row for row in rows if row.number("backpack [kg]") == mass]
        found += _with_speed(gymnast("female", backpack=mass), "female", carried, settings)
    return found


def _with_speed(character: Gymnast, sex: str, rows: Sequence[Published], settings: FidelitySettings) -> list[Measured]:
    script = script_of("drop-landing", sex)
    speeds = sorted({row.number("speed [m/s]") for row in rows})
    landings = land(character, script, [{"speed": v} for v in speeds], settings, speeds=np.array(speeds))
    found: list[Measured] = []
    for row in rows:
        place = speeds.index(row.number("speed [m/s]"))
        if row.quantity == "ends balanced":
            found.append(Measured(row, float(landings.balanced[place])))
        else:
            note = "ours: feet ahead of the centre of mass at touchdown; the thesis's zero is not told"
            found.append(Measured(row, float(landings.feet_ahead[place]), note=note))
    return found


def land_traces(settings: FidelitySettings) -> list[Measured]:
    """Figure 6.3: how the speed is lost."""
    found: list[Measured] = []
    for sex, rows in rows_by_body("land-traces").items():
        speed = rows[0].number("speed [m/s]")
        script = script_of("drop-landing", sex)
        landings = land(gymnast_of(sex), script, [{"speed": speed}], settings, speeds=np.array([speed]))
        for row in rows:
            value = landings.feet_ahead[0] if row.unit == "m" else landings.speed_at_balance[0]
            found.append(
                Measured(row, float(value)) if np.isfinite(value) else Measured(row, None, note="it never balanced")
            )
    return found


MEASURES: Mapping[str, Measure] = {
    "land-drop": land_drop,
    "land-speed": land_speed,
    "land-backpack": land_backpack,
    "land-traces": land_traces,
}
"""Measuring functions by experiment."""
