"""Chapter 8, the standing somersaults: do they end balanced, and what does a backpack change?

Every trial is a gymnast of its own; the usual one and all disturbed ones are one batch. When a gymnast arrives in a row
of its script is known to the tick, from how long it has been there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast, gymnast
from echelon.agents.gymnasts.script import Script, load_script
from echelon.benchmarks.thesis.experiments import FidelitySettings, Measure
from echelon.benchmarks.thesis.published import published_rows
from echelon.benchmarks.thesis.rows import Measured, Published
from echelon.benchmarks.thesis.trials import arrivals, gymnast_of, in_frame, rests_on_feet, trials

SECONDS = 6.0  # from standing to long after the landing [s]
WHOLE_TURN = 0.2  # by which a somersault may differ from one turn [rad]
HANDS_UNTIL = 0.1  # no hand touches the ground later than this from the start [s]
DISTURBED, SEED = 128, 5
"""How many trials with other hip angles at liftoff and timings, and what they are drawn from."""
WATCHED = (
    "row", "row_age", "time", "fallen", "hands_unloaded", "somersault", "pitch_rate", "momentum_y", "vx", "vy", "vz",
    "com_height", "foot_clearance",
)  # fmt: skip


@dataclass(frozen=True)
class Somersaults:
    """What became of somersaults, an entry for each.

    Attributes:
        balanced: Whether each came round once, on its feet alone, and stood still.
        liftoff, opening, touchdown, standing: When each left the ground, opened the tuck, landed, and began to stand
            up [s]; NaN where it did not.
        highest: Greatest height of the centre of mass over the ground [m].
        peak_rate: Greatest rate of the pelvis's somersault in flight [rad/s].
        momentum: Angular momentum in flight, in its middle [kg m^2/s].
        peak_force: Greatest force of the ground [N].
    """

    balanced: np.ndarray
    liftoff: np.ndarray
    opening: np.ndarray
    touchdown: np.ndarray
    standing: np.ndarray
    highest: np.ndarray
    peak_rate: np.ndarray
    momentum: np.ndarray
    peak_force: np.ndarray


def perform(
    character: Gymnast, script: Script, values: Sequence[Mapping[str, float]], settings: FidelitySettings
) -> Somersaults:
    """Somersaults by one body, with parameters of their own each.

    Args:
        character: Who.
        script: With rows called tuck, open, absorb and rise.
        values: Parameters that differ from the script's, for each.
        settings: How to run them.
    """
    run = trials(character, script, values, settings)
    seen = run.run(SECONDS, WATCHED)
    highest, hardest = run.now("highest"), run.now("hardest")
    run.close()
    liftoff, opening, touchdown, standing = (arrivals(script, seen, row) for row in ("tuck", "open", "absorb", "rise"))
    flight = (seen["time"] > liftoff) & ~(seen["time"] > touchdown)
    middle = np.argmax(seen["time"] > 0.5 * (liftoff + touchdown), axis=0)
    turned = np.abs(np.abs(seen["somersault"][-1]) - 2.0 * math.pi) < WHOLE_TURN
    return Somersaults(
        balanced=turned & rests_on_feet(seen, touchdown, hands_until=HANDS_UNTIL),
        liftoff=liftoff,
        opening=opening,
        touchdown=touchdown,
        standing=standing,
        highest=highest,
        peak_rate=np.max(np.abs(seen["pitch_rate"]) * flight, axis=0),
        momentum=in_frame(seen["momentum_y"], middle),
        peak_force=hardest,
    )


# ---- what was published ----------------------------------------------------------------------------------------------
def measure_back(settings: FidelitySettings) -> list[Measured]:
    """Figure 8.8: the male's standing back somersault."""
    script = load_script("standing-back-somersault")
    found = perform(gymnast_of("male"), script, _usual_and_disturbed(script, {}), settings)
    return [_tried(row, found) for row in published_rows("back-somersault")]


def measure_forward(settings: FidelitySettings) -> list[Measured]:
    """Figures 8.9 and 8.10: the female's standing forward somersault, also with a backpack."""
    script = load_script("standing-forward-somersault")
    rows = published_rows("forward-somersault")
    without = perform(gymnast_of("female"), script, _usual_and_disturbed(script, {}), settings)
    found: dict[tuple[float, bool], Somersaults] = {(0.0, True): without}
    for mass in sorted({row.number("backpack [kg]") for row in rows} - {0.0}):
        carrying = gymnast("female", backpack=mass)
        found[mass, False] = perform(carrying, script, [{}], settings)
        found[mass, True] = perform(carrying, script, _usual_and_disturbed(script, {"backpack": mass}), settings)
    return [
        _carried(row, found[row.number("backpack [kg]"), row.given.get("script") != "as without"], without)
        for row in rows
    ]


def _usual_and_disturbed(script: Script, values: Mapping[str, float]) -> list[dict[str, float]]:
    return [dict(values), *({**one, **values} for one in script.varied(DISTURBED, SEED))]


def _tried(row: Published, found: Somersaults) -> Measured:
    if row.quantity == "ends balanced":
        return Measured(row, float(found.balanced[0]))
    return Measured(row, float(np.mean(found.balanced[1:])))


def _carried(row: Published, found: Somersaults, without: Somersaults) -> Measured:
    """A row about a somersault with a backpack; differences are from that without."""
    differences = _differences(found, without)
    if row.quantity not in differences:
        return _tried(row, found)
    difference = differences[row.quantity]
    if math.isnan(difference):
        return Measured(row, None, note="never got so far")
    return Measured(row, difference, note=NOTES.get(row.quantity, ""))


def _differences(found: Somersaults, without: Somersaults) -> dict[str, float]:
    """By quantity, what is different in the usual one; moments are counted from liftoff."""

    def after_liftoff(one: Somersaults, moment: np.ndarray) -> float:
        return float(moment[0] - one.liftoff[0])

    return {
        "later opening": after_liftoff(found, found.opening) - after_liftoff(without, without.opening),
        "difference of touchdown": abs(
            after_liftoff(found, found.touchdown) - after_liftoff(without, without.touchdown)
        ),
        "later balance": after_liftoff(found, found.standing) - after_liftoff(without, without.standing),
        "higher centre of mass": float(found.highest[0] - without.highest[0]),
        "higher peak rate": float(found.peak_rate[0] - without.peak_rate[0]),
    }


NOTES: Mapping[str, str] = {
    "later opening": "counted from liftoff; ours opens by the somersault ahead, not by the clock",
    "difference of touchdown": "counted from liftoff",
    "later balance": "from liftoff to standing up",
}

MEASURES: Mapping[str, Measure] = {"back-somersault": measure_back, "forward-somersault": measure_forward}
"""For `maneuvers`, which gathers what is measured of chapter 8."""
