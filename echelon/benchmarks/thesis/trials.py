"""Trials: gymnasts who each follow a script with values of its own, all of an experiment in one batch.

What most experiments ask of what they watched is here as well: when a row was reached, and who stands in the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from echelon.agents.characters import character_named
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.script import Script
from echelon.benchmarks.thesis.experiments import FidelitySettings
from echelon.simulation.performance import Performance
from echelon.warp_kernels.character import Population
from echelon.warp_kernels.frame import Terrain
from echelon.warp_kernels.reference import Body

STANDS_AFTER = 3.0  # from touchdown, one is balanced then or not [s]
STILL = 0.05  # who stands has a centre of mass slower than this [m/s]
PLATE_WINDOW = 0.01  # over which the force of the ground is averaged, as force plates are filtered [s]


def gymnast_of(sex: str) -> Gymnast:
    """The thesis's man or woman; one object each, so that programs are compiled once."""
    character = character_named(f"gymnast-{sex}")
    assert isinstance(character, Gymnast)
    return character


def trials(
    character: Gymnast,
    script: Script,
    values: Sequence[Mapping[str, float]],
    settings: FidelitySettings,
    *,
    frame_rate: int = 30,
    ticks_per_second: int = 0,
    people: Population | None = None,
    terrain: Terrain | None = None,
    places: np.ndarray | None = None,
) -> Performance:
    """Gymnasts, ready to start; a finer step keeps the time between control ticks.

    Args:
        character: Who.
        script: What they do.
        values: Parameters that differ from the script's, for each.
        settings: How to run them.
        frame_rate: How often a second they can be watched [1/s].
        ticks_per_second: How often control decides [1/s]; 0 for as often as suits the character.
        people, terrain, places: As for a `Performance`.
    """
    steps = settings.steps_per_second or character.steps_per_second
    return Performance(
        character,
        [script.table(character.body, one) for one in values],
        people=people,
        terrain=terrain,
        places=places,
        frame_rate=frame_rate,
        substeps=round(steps / frame_rate),
        tick=max(round(steps / (ticks_per_second or character.steps_per_second / character.steps_per_tick)), 1),
        threads=settings.threads or 0,
    )


def filtered_peak(vz: np.ndarray, body: Body, frame_rate: int) -> np.ndarray:
    """Greatest vertical force of the ground on each gymnast as a filtered force plate tells it [N], shape [agents].

    A foot of 1 kg that stops within a millisecond makes a spike that no filtered plate shows. The force, which is what
    the body's momentum gains and its weight, is averaged over `PLATE_WINDOW` twice: a triangle so wide at half its
    height. A single average jumps where such a spike enters it.

    Args:
        vz: Vertical speed of the centre of mass after each frame [m/s], shape [frames, agents].
        body: Whose mass it is.
        frame_rate: Frames a second [1/s].
    """
    width = max(round(PLATE_WINDOW * frame_rate), 1)
    means = np.diff(vz.astype(np.float64), axis=0) * frame_rate
    for _ in range(2):
        sums = np.cumsum(np.insert(means, 0, 0.0, axis=0), axis=0)
        means = (sums[width:] - sums[:-width]) / width
    return body.mass * (means.max(axis=0) + body.gravity)


def first_frame(script: Script, seen: Mapping[str, np.ndarray], row: str) -> np.ndarray:
    """The first frame in which each gymnast was in a row, shape [agents]; -1 where it never was.

    Args:
        script: What they do.
        seen: What was watched, "row" among it, each of shape [frames, agents].
        row: Name of the row.
    """
    there = seen["row"] == script.row_names.index(row)
    return np.where(there.any(axis=0), np.argmax(there, axis=0), -1)


def in_frame(values: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Each gymnast's value in a frame of its own, shape [agents, ...]; the first frame's where that is negative."""
    return values[np.maximum(frame, 0), np.arange(len(frame))]


def arrivals(script: Script, seen: Mapping[str, np.ndarray], row: str) -> np.ndarray:
    """When each gymnast first arrived in a row [s], shape [agents]; NaN where it never did.

    Args:
        script, seen, row: As for `first_frame`; "time" and "row_age" were watched as well.
    """
    frame = first_frame(script, seen, row)
    return np.where(frame < 0, np.nan, in_frame(seen["time"] - seen["row_age"], frame))


def speed_of(seen: Mapping[str, np.ndarray]) -> np.ndarray:
    """Of the centre of mass [m/s], of the shape of "vx", "vy" and "vz" each."""
    return np.sqrt(seen["vx"] ** 2 + seen["vy"] ** 2 + seen["vz"] ** 2)


def stays(so: np.ndarray, time: np.ndarray, since: np.ndarray) -> np.ndarray:
    """Who is so from a moment of its own to the end, shape [agents], bool; nobody whose moment never came.

    Args:
        so: Who is in each frame, shape [frames, agents], bool.
        time: When each frame was [s], the same shape.
        since: The moments [s], shape [agents]; NaN for none.
    """
    late = time >= since
    return late.any(axis=0) & np.all(so | ~late, axis=0)


def rests_on_feet(
    seen: Mapping[str, np.ndarray], touchdown: np.ndarray, *, hands_until: np.ndarray | float
) -> np.ndarray:
    """Who is still from `STANDS_AFTER` after touchdown to the end, having touched nothing but with feet and hands.

    Args:
        seen: What was watched, "time", "fallen", "hands_unloaded", "vx", "vy" and "vz" among it, each of shape
            [frames, agents].
        touchdown: When the feet came down [s], shape [agents]; NaN where they did not.
        hands_until: From then on hands touched nothing either [s], for all or of shape [agents].

    Returns:
        Shape [agents], bool.
    """
    still = stays(speed_of(seen) < STILL, seen["time"], touchdown + STANDS_AFTER)
    hands_off = seen["hands_unloaded"][-1] > seen["time"][-1] - hands_until
    return still & (seen["fallen"][-1] < 0.5) & hands_off
