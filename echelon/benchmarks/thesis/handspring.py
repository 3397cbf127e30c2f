"""Chapter 8, the back handspring: does it end balanced, and does the thesis's failure fall as one does?

The usual handspring, disturbed ones and the failure are gymnasts of one batch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.script import Script, load_script
from echelon.benchmarks.thesis.experiments import FidelitySettings, Measure
from echelon.benchmarks.thesis.published import published_rows
from echelon.benchmarks.thesis.rows import Measured
from echelon.benchmarks.thesis.trials import arrivals, first_frame, gymnast_of, in_frame, rests_on_feet, trials

SECONDS = 6.3  # from standing to three seconds after the landing, and a little [s]
FRAME_RATE = 60
WHOLE_TURN = 0.3  # by which the turn may differ from a whole one [rad]
DISTURBED, SEED = 128, 5
"""How many trials with other hip angles at liftoff and timings, and what they are drawn from."""
FAILURE: Mapping[str, float] = {"fold": 0.9}
"""What of the script is other for figure 8.7: hips that bend so much further swing the feet too far forward [rad]."""
WATCHED = (
    "row", "row_age", "time", "fallen", "hands_unloaded", "somersault", "momentum_y", "vx", "vy", "vz", "com_x",
    "feet_x",
)  # fmt: skip


@dataclass(frozen=True)
class Handsprings:
    """What became of handsprings, shape [agents] each.

    Attributes:
        balanced: Whether each came round once and stood still on its feet, having touched the ground with nothing but
            feet and hands, and with no hand after its feet were down.
        fell_backwards: Whether each fell after touchdown, with its centre of mass behind its feet.
        liftoff, hands, release, touchdown: When each left the ground, stood on its hands, left them, and landed [s];
            NaN where it did not.
        first, second: Angular momentum about the lateral axis before the hands came down, and after they had left
            [kg m^2/s]; backwards is negative.
        feet: Ahead of the centre of mass at touchdown [m].
        highest: Greatest height of the centre of mass over the ground [m].
        peak_force: Greatest vertical force of the ground [N].
    """

    balanced: np.ndarray
    fell_backwards: np.ndarray
    liftoff: np.ndarray
    hands: np.ndarray
    release: np.ndarray
    touchdown: np.ndarray
    first: np.ndarray
    second: np.ndarray
    feet: np.ndarray
    highest: np.ndarray
    peak_force: np.ndarray


def perform(
    character: Gymnast, script: Script, values: Sequence[Mapping[str, float]], settings: FidelitySettings
) -> Handsprings:
    """Handsprings by one body, with parameters of their own each.

    Args:
        character: Who.
        script: With rows called flight, hands, return and absorb.
        values: Parameters that differ from the script's, for each.
        settings: How to run them.
    """
    run = trials(character, script, values, settings, frame_rate=FRAME_RATE)
    seen = run.run(SECONDS, WATCHED)
    highest, hardest = run.now("highest"), run.now("hardest")
    run.close()
    liftoff, hands, release, touchdown = (
        arrivals(script, seen, row) for row in ("flight", "hands", "return", "absorb")
    )
    on_hands, released, landed = (first_frame(script, seen, row) for row in ("hands", "return", "absorb"))
    fall = np.where(seen["fallen"][-1] > 0.5, np.argmax(seen["fallen"] > 0.5, axis=0), -1)
    turned = np.abs(seen["somersault"][-1] + 2.0 * np.pi) < WHOLE_TURN  # backwards
    return Handsprings(
        balanced=turned & rests_on_feet(seen, touchdown, hands_until=touchdown),
        fell_backwards=(landed >= 0) & (fall > landed) & (in_frame(seen["com_x"], fall) < 0.0),
        liftoff=liftoff,
        hands=hands,
        release=release,
        touchdown=touchdown,
        first=in_frame(seen["momentum_y"], on_hands - 1),
        second=in_frame(seen["momentum_y"], released),
        feet=in_frame(seen["feet_x"], landed),
        highest=highest,
        peak_force=hardest,
    )


# ---- what was published ----------------------------------------------------------------------------------------------
def measure(settings: FidelitySettings) -> list[Measured]:
    """Figures 8.6 and 8.7: the male's back handspring, and one that fails."""
    script = load_script("back-handspring")
    found = perform(gymnast_of("male"), script, [{}, FAILURE, *script.varied(DISTURBED, SEED)], settings)
    values = {
        "ends balanced": float(found.balanced[0]),
        "falls backwards": float(found.fell_backwards[1]),
        "disturbed trials that end balanced": float(np.mean(found.balanced[2:])),
    }
    return [Measured(row, values[row.quantity]) for row in published_rows("back-handspring")]


MEASURES: Mapping[str, Measure] = {"back-handspring": measure}
"""For `maneuvers`, which gathers what is measured of chapter 8."""
