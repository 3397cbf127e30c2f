"""Chapter 8, four dives from 10 m: how far the bodies have turned and twisted when the hands meet the water.

The water holds nobody: each dive ends when the first hand is at its level. Every trial is a diver of its own, the usual
one and all disturbed ones one batch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.script import Script, load_script
from echelon.agents.gymnasts.standing import site_points
from echelon.benchmarks.thesis.experiments import FidelitySettings, Measure
from echelon.benchmarks.thesis.published import published_rows
from echelon.benchmarks.thesis.rows import Measured, Published
from echelon.benchmarks.thesis.trials import gymnast_of, in_frame, trials
from echelon.simulation.gym import leaning
from echelon.terrain.platform import PlatformTerrain
from echelon.warp_kernels.character import Population

HEIGHT = 10.0  # of the platform [m]
ON_PLATFORM = 0.02  # by which the balls of the feet stand inside its edge [m]
LEAN = 0.056
"""Where the centre of mass is of one whose heels hang over the edge, ahead of the middle of the feet [m]: between the
balls of the feet and the toes."""
SECONDS = 3.8  # from standing until the last diver is in the water [s]
FRAME_RATE = 60
AWAY_BY = 0.25  # after liftoff all that is beneath the platform's surface should be beyond its edge [s]
NEAR = math.radians(20.0)
"""By how much somersault, twist and lean may be off at entry [rad]."""
DISTURBED, SEED = 95, 11
"""How many trials with other hip angles at liftoff and timings, and what they are drawn from."""
DIVES: Mapping[str, str] = {
    "inward 1 1/2 pike": "inward-dive-one-and-a-half-pike",
    "back 1 1/2 with 1/2 twist": "back-dive-one-and-a-half-half-twist",
    "inward 2 1/2 pike": "inward-dive-two-and-a-half-pike",
    "back 1 1/2 with 2 1/2 twists": "back-dive-one-and-a-half-two-and-a-half-twists",
}
"""Scripts of the published dives."""
WATCHED = (
    "fallen", "unloaded", "hand_clearance", "somersault", "twist", "lean", "momentum_y", "vx", "vz", "com_height",
)  # fmt: skip


@dataclass(frozen=True)
class Dives:
    """What became of dives, an entry for each.

    Attributes:
        liftoff, entry: When each left the platform, and when its first hand was at the water [s]; NaN if it did not.
        somersault, twist, lean: Of the pelvis at entry [rad].
        momentum: Angular momentum about the left axis at liftoff [kg m^2/s].
        momentum_at_entry: The same at entry.
        away: Speed away from the platform at liftoff [m/s].
        highest: Greatest height of the centre of mass over the platform [m].
        clearance: How near the edge, measured level, any link came that was beneath the platform's surface later than
            `AWAY_BY` after liftoff [m]; the feet leave from the edge itself.
    """

    liftoff: np.ndarray
    entry: np.ndarray
    somersault: np.ndarray
    twist: np.ndarray
    lean: np.ndarray
    momentum: np.ndarray
    momentum_at_entry: np.ndarray
    away: np.ndarray
    highest: np.ndarray
    clearance: np.ndarray

    def entered(self, somersault: float, twist: float) -> np.ndarray:
        """Whether each came in within `NEAR` of a somersault and a twist of these sizes [rad], whichever way round."""
        off = np.maximum(np.abs(np.abs(self.somersault) - somersault), np.abs(np.abs(self.twist) - twist))
        clear = np.nan_to_num(self.clearance, nan=-1.0) > 0.0
        return np.isfinite(self.entry) & (np.maximum(off, np.abs(self.lean)) < NEAR) & clear


def dive(
    character: Gymnast, script: Script, values: Sequence[Mapping[str, float]], settings: FidelitySettings
) -> Dives:
    """Dives by one body, with parameters of their own each.

    Args:
        character: Who.
        script: Of a dive by one who faces the platform.
        values: Parameters that differ from the script's, for each.
        settings: How to run them.
    """
    run = trials(
        character,
        script,
        values,
        settings,
        people=divers(character, len(values)),
        terrain=PlatformTerrain.of(HEIGHT, edge=(edge_behind(character), 0.0)),
        places=np.tile([0.0, 0.0, HEIGHT], (len(values), 1)),
        frame_rate=FRAME_RATE,
    )
    seen = run.run(SECONDS, [*WATCHED, "q"])
    run.close()
    return _judged(character, seen)


def divers(character: Gymnast, count: int) -> Population:
    """Gymnasts who begin with the weight on the balls of their feet."""
    return leaning(character, character.population(count, 0, 0.0, True), LEAN)


def edge_behind(character: Gymnast) -> float:
    """Where the edge is of a platform that one faces who stands at the origin, heels over it [m]."""
    q = divers(character, 1).q[0]
    return float(site_points(character.body, q)["left_ball_inner"][0]) - ON_PLATFORM


def _judged(character: Gymnast, seen: Mapping[str, np.ndarray]) -> Dives:
    frames = len(seen["fallen"])
    # The last moment at which the feet carried anything: some hop a little in their crouch.
    loaded = seen["unloaded"] < 1.0 / FRAME_RATE
    liftoff = np.minimum(frames - np.argmax(loaded[::-1], axis=0), frames - 1)
    left = liftoff < frames - 1
    # The last ground that a foot was on is the platform.
    over_water = seen["hand_clearance"] + HEIGHT
    wet = (over_water < 0.0) & (np.arange(frames)[:, None] > liftoff)
    entered = left & wet.any(0) & (seen["fallen"].max(0) < 0.5)
    after = np.maximum(np.where(wet.any(0), wet.argmax(0), frames - 1), 1)
    above, beneath = in_frame(over_water, after - 1), in_frame(over_water, after)
    part = np.clip(above / np.where(above > beneath, above - beneath, 1.0), 0.0, 1.0)

    def at_entry(name: str) -> np.ndarray:
        return (1.0 - part) * in_frame(seen[name], after - 1) + part * in_frame(seen[name], after)

    return Dives(
        liftoff=np.where(left, (liftoff + 1) / FRAME_RATE, np.nan),
        entry=np.where(entered, (after + part) / FRAME_RATE, np.nan),
        somersault=at_entry("somersault"),
        twist=at_entry("twist"),
        lean=at_entry("lean"),
        momentum=in_frame(seen["momentum_y"], liftoff),
        momentum_at_entry=at_entry("momentum_y"),
        away=-in_frame(seen["vx"], liftoff),
        highest=seen["com_height"].max(0),
        clearance=_clearance(character, seen["q"], liftoff, after),
    )


def _clearance(character: Gymnast, q: np.ndarray, liftoff: np.ndarray, entry: np.ndarray) -> np.ndarray:
    """How near the edge anything came on the way down, shape [agents]; every fourth frame is looked at."""
    body, edge = character.body, edge_behind(character)
    since = liftoff + round(AWAY_BY * FRAME_RATE)
    nearest = np.full(q.shape[1], np.inf)
    for frame in range(0, len(q), 4):
        falling = np.flatnonzero((since < frame) & (frame <= entry))
        if not len(falling):
            continue
        poses = body.link_poses(q[frame, falling])
        below = poses[..., 2] < HEIGHT
        gaps = np.where(below, edge - poses[..., 0], np.inf).min(axis=1)
        nearest[falling] = np.minimum(nearest[falling], gaps)
    return nearest


def _dives(settings: FidelitySettings) -> list[Measured]:
    """Figure 8.5, and what the thesis did not try: the same dives a little disturbed."""
    rows = published_rows("dives")
    found: list[Measured] = []
    for name, maneuver in DIVES.items():
        own = [row for row in rows if row.given["dive"] == name]
        script = load_script(maneuver)
        dives = dive(gymnast_of(own[0].body), script, [{}, *script.varied(DISTURBED, SEED)], settings)
        found += _measured(own, dives)
    return found


def _measured(rows: Sequence[Published], dives: Dives) -> list[Measured]:
    asked = {row.quantity: math.radians(row.thesis or 0.0) for row in rows}
    good = dives.entered(asked["somersault at entry"], asked["twist at entry"])
    found = []
    for row in rows:
        if row.quantity == "disturbed trials that enter so":
            note = f"{DISTURBED} trials; clear of the platform by {np.min(dives.clearance):.2f} m or more"
            found.append(Measured(row, float(good[1:].mean()), note))
        elif not np.isfinite(dives.entry[0]):
            found.append(Measured(row, None, "did not reach the water hands first"))
        else:
            angle = dives.somersault[0] if row.quantity == "somersault at entry" else dives.twist[0]
            found.append(Measured(row, float(abs(math.degrees(angle)))))
    return found


MEASURES: Mapping[str, Measure] = {"dives": _dives}
"""Measuring functions by experiment."""
