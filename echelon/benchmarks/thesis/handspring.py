"""Chapter 8, the back handspring: does it end balanced, and does the thesis's failure fall as one does?

The usual handspring, disturbed ones and the failure are gymnasts of one batch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.agents.characters import character_named
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.script import Script, load_script
from echelon.benchmarks.thesis.experiments import FidelitySettings, Measure
from echelon.benchmarks.thesis.published import published_rows
from echelon.benchmarks.thesis.rows import Measured
from echelon.simulation.performance import Performance

SECONDS = 6.3  # from standing to three seconds after the landing, and a little [s]
FRAME_RATE = 60
STANDS_AFTER = 3.0  # from touchdown, one is balanced then or not [s]
STILL = 0.05  # who stands has a centre of mass slower than this [m/s]
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
    steps = settings.steps_per_second or character.steps_per_second
    performance = Performance(
        character,
        [script.table(character.body, one) for one in values],
        frame_rate=FRAME_RATE,
        substeps=round(steps / FRAME_RATE),
        tick=character.steps_per_tick * max(round(steps / character.steps_per_second), 1),
        threads=settings.threads or 0,
    )
    seen = performance.run(SECONDS, WATCHED)
    highest, hardest = performance.now("highest"), performance.now("hardest")
    performance.close()
    frames = {name: _first_frame(script, seen, name) for name in ("flight", "hands", "return", "absorb")}
    times = {
        name: np.where(frame < 0, np.nan, _at(seen["time"] - seen["row_age"], frame)) for name, frame in frames.items()
    }
    fall = np.where(seen["fallen"][-1] > 0.5, np.argmax(seen["fallen"] > 0.5, axis=0), -1)
    landed = frames["absorb"] >= 0
    return Handsprings(
        balanced=_balanced(seen, times["absorb"]),
        fell_backwards=landed & (fall > frames["absorb"]) & (_at(seen["com_x"], fall) < 0.0),
        liftoff=times["flight"],
        hands=times["hands"],
        release=times["return"],
        touchdown=times["absorb"],
        first=_at(seen["momentum_y"], frames["hands"] - 1),
        second=_at(seen["momentum_y"], frames["return"]),
        feet=_at(seen["feet_x"], frames["absorb"]),
        highest=highest,
        peak_force=hardest,
    )


def _first_frame(script: Script, seen: Mapping[str, np.ndarray], row: str) -> np.ndarray:
    """The first frame in which each gymnast was in a row, shape [agents]; -1 where it never was."""
    there = seen["row"] == script.row_names.index(row)
    return np.where(there.any(axis=0), np.argmax(there, axis=0), -1)


def _at(values: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Each gymnast's value in a frame of its own, shape [agents]; the first frame's where that is negative."""
    return np.take_along_axis(values, np.maximum(frame, 0)[None], axis=0)[0]


def _balanced(seen: Mapping[str, np.ndarray], touchdown: np.ndarray) -> np.ndarray:
    """Whether each stands still on its feet after one whole turn backwards, shape [agents]."""
    time = seen["time"]
    late = time >= touchdown + STANDS_AFTER
    speed = np.sqrt(seen["vx"] ** 2 + seen["vy"] ** 2 + seen["vz"] ** 2)
    still = late.any(axis=0) & np.all((speed < STILL) | ~late, axis=0)
    turned = np.abs(seen["somersault"][-1] + 2.0 * np.pi) < WHOLE_TURN
    on_feet = (seen["fallen"][-1] < 0.5) & (seen["hands_unloaded"][-1] > time[-1] - touchdown)
    return still & turned & on_feet


# ---- what was published ----------------------------------------------------------------------------------------------
def measure(settings: FidelitySettings) -> list[Measured]:
    """Figures 8.6 and 8.7: the male's back handspring, and one that fails."""
    character, script = character_named("gymnast-male"), load_script("back-handspring")
    assert isinstance(character, Gymnast)
    found = perform(character, script, [{}, FAILURE, *script.varied(DISTURBED, SEED)], settings)
    values = {
        "ends balanced": float(found.balanced[0]),
        "falls backwards": float(found.fell_backwards[1]),
        "disturbed trials that end balanced": float(np.mean(found.balanced[2:])),
    }
    return [Measured(row, values[row.quantity]) for row in published_rows("back-handspring")]


MEASURES: Mapping[str, Measure] = {"back-handspring": measure}
"""For `maneuvers`, which gathers what is measured of chapter 8."""
