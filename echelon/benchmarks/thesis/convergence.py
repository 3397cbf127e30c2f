"""What half the step changes: rise, angular momentum and peak force of every maneuver that is reported.

A maneuver is done by the same gymnasts twice, with the step that it ships with and with half of it; control decides as
often either way. All its commands are one batch, and the command that changes most is told. Each is watched until its
landing is over: what comes later is balance, which forgets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast, gymnast
from echelon.agents.gymnasts.script import Script, load_script
from echelon.benchmarks.thesis.dives import DIVES, HEIGHT, divers, edge_behind
from echelon.benchmarks.thesis.experiments import FidelitySettings, Measure
from echelon.benchmarks.thesis.land import falls_onto_feet, land
from echelon.benchmarks.thesis.leap import script_of
from echelon.benchmarks.thesis.published import LEAST_MOMENTUM, published_rows
from echelon.benchmarks.thesis.rows import Measured, Published
from echelon.benchmarks.thesis.trials import filtered_peak, gymnast_of, trials
from echelon.simulation.performance import Performance
from echelon.terrain.platform import PlatformTerrain

FRAME_RATE = 300  # where heights and forces are followed [1/s]
LEAP_SECONDS, SOMERSAULT_SECONDS, HANDSPRING_SECONDS, DIVE_SECONDS = 3.2, 3.4, 3.6, 2.6
"""From standing until a landing is over, or long after a diver's liftoff [s]."""
HEIGHTS = tuple(tenth / 10 for tenth in range(1, 11))
DISTANCES: Mapping[str, tuple[float, ...]] = {
    "male": (0.4, 0.8, 1.1, 1.2, 1.6, 2.0, 2.1, 2.12),
    "female": (0.4, 0.8, 1.2, 1.57),
}
FALLS: Mapping[str, tuple[float, ...]] = {
    "male": (0.2, 0.3, 0.45, 0.6, 0.75, 0.85, 1.0, 1.15),
    "female": (0.2, 0.3, 0.45, 0.6, 0.7, 0.8, 0.85, 0.92),
}
SPEEDS = (-1.0, 0.0, 1.0, 2.0, 3.0)
"""Commands: rises and distances of leaps [m], falls of the soles [m], speeds of landings [m/s]."""

Quantities = Mapping[str, np.ndarray]
"""For each command of a maneuver by quantity what came of it, shape [commands]: "rise", how much higher the centre of
mass came than it began [m]; "angular momentum" about the lateral axis where it was highest [kg m^2/s]; "peak force" of
the ground on the filtered plate [N]."""


@dataclass(frozen=True)
class Change:
    """What half the step changes most among a maneuver's commands.

    Attributes:
        share: Of the value with the shipped step [%], never negative.
        command: Of which command, as people say it; empty if there is but one.
        before, after: The value with the shipped step and with half of it, in the quantity's unit.
    """

    share: float
    command: str
    before: float
    after: float


@dataclass(frozen=True)
class Maneuver:
    """A maneuver that can be done with any step.

    Attributes:
        commands: What its gymnasts are told, a word or two each.
        perform: Does it, under settings.
    """

    commands: Sequence[str]
    perform: Callable[[FidelitySettings], Quantities]

    def changes(self, settings: FidelitySettings) -> dict[str, Change]:
        """By quantity the greatest change."""
        steps = settings.steps_per_second or Gymnast.steps_per_second
        usual = self.perform(replace(settings, steps_per_second=steps))
        finer = self.perform(replace(settings, steps_per_second=2 * steps))
        return {name: greatest_change(name, self.commands, usual[name], finer[name]) for name in usual}


def greatest_change(quantity: str, commands: Sequence[str], before: np.ndarray, after: np.ndarray) -> Change:
    """The greatest change among commands, with values of shape [commands] each; what is not finite counts as all."""
    least = LEAST_MOMENTUM if quantity == "angular momentum" else 1e-9
    share = 100.0 * np.abs(after - before) / np.maximum(np.abs(before), least)
    share = np.where(np.isfinite(share), share, 100.0)
    worst = int(np.argmax(share))
    return Change(float(share[worst]), commands[worst], float(before[worst]), float(after[worst]))


# ---- the maneuvers ---------------------------------------------------------------------------------------------------
def maneuver_named(name: str, body: str) -> Maneuver:
    """A maneuver by the name that its rows are published under, done by the man or the woman."""
    if name == "landing from a fall":
        return _falls(body)
    if name == "landing with speed":
        return _fast_landings(body)
    if name in DIVES:
        return _dive(body, name)
    script, values, commands, seconds, character = _on_the_ground(body, name)

    def perform(settings: FidelitySettings) -> Quantities:
        return _followed(character, trials(character, script, values, settings, frame_rate=FRAME_RATE), seconds)

    return Maneuver(commands, perform)


def _on_the_ground(body: str, name: str) -> tuple[Script, Sequence[Mapping[str, float]], Sequence[str], float, Gymnast]:
    """Script, values and names of its commands, duration [s] and who does it."""
    character = gymnast_of(body)
    if name == "vertical leap":
        script, told = script_of("vertical-leap", body), [f"{height:g} m" for height in HEIGHTS]
        return script, [{"height": height} for height in HEIGHTS], told, LEAP_SECONDS, character
    if name == "broad jump":
        script, told = script_of("broad-jump", body), [f"{distance:g} m" for distance in DISTANCES[body]]
        return script, [{"distance": distance} for distance in DISTANCES[body]], told, LEAP_SECONDS, character
    if name == "back handspring":
        return load_script("back-handspring"), [{}], [""], HANDSPRING_SECONDS, character
    script = load_script(
        {"back": "standing-back-somersault", "forward": "standing-forward-somersault"}[name.split()[0]]
    )
    mass = float(name.split()[3]) if "with" in name else 0.0
    if mass > 0.0:
        return script, [{"backpack": mass}], [""], SOMERSAULT_SECONDS, gymnast("female", backpack=mass)
    return script, [{}], [""], SOMERSAULT_SECONDS, character


def _dive(body: str, name: str) -> Maneuver:
    character, script = gymnast_of(body), load_script(DIVES[name])

    def perform(settings: FidelitySettings) -> Quantities:
        run = trials(
            character,
            script,
            [{}],
            settings,
            people=divers(character, 1),
            terrain=PlatformTerrain.of(HEIGHT, edge=(edge_behind(character), 0.0)),
            places=np.array([[0.0, 0.0, HEIGHT]]),
            frame_rate=FRAME_RATE,
        )
        return _followed(character, run, DIVE_SECONDS)

    return Maneuver([""], perform)


def _falls(body: str) -> Maneuver:
    falls = np.array(FALLS[body])

    def perform(settings: FidelitySettings) -> Quantities:
        return {"peak force": falls_onto_feet(gymnast_of(body), script_of("drop-landing", body), falls, settings).peak}

    return Maneuver([f"{fall:g} m" for fall in falls], perform)


def _fast_landings(body: str) -> Maneuver:
    script, values = script_of("drop-landing", body), [{"speed": speed} for speed in SPEEDS]

    def perform(settings: FidelitySettings) -> Quantities:
        return {"peak force": land(gymnast_of(body), script, values, settings, speeds=np.array(SPEEDS)).peak}

    return Maneuver([f"{speed:g} m/s" for speed in SPEEDS], perform)


def _followed(character: Gymnast, run: Performance, seconds: float) -> Quantities:
    seen = run.run(seconds, ("com_height", "momentum_y", "vz"))
    run.close()
    highest = np.argmax(seen["com_height"], axis=0)
    agents = np.arange(len(highest))
    return {
        "rise": seen["com_height"][highest, agents] - seen["com_height"][0],
        "angular momentum": seen["momentum_y"][highest, agents],
        "peak force": filtered_peak(seen["vz"], character.body, FRAME_RATE),
    }


# ---- what is reported ------------------------------------------------------------------------------------------------
def measure(settings: FidelitySettings) -> list[Measured]:
    """How much each quantity of each maneuver changes."""
    return [one for rows in _by_maneuver() for one in measured(rows, settings)]


def measured(rows: Sequence[Published], settings: FidelitySettings) -> Iterator[Measured]:
    """The rows of one maneuver by one body."""
    changes = maneuver_named(str(rows[0].given["maneuver"]), rows[0].body).changes(settings)
    for row in rows:
        change = changes[row.quantity.removeprefix("change of ")]
        told = f"{change.command}: " if change.command else ""
        yield Measured(row, change.share, f"{told}{change.before:.4g}, with half the step {change.after:.4g}")


def _by_maneuver() -> list[list[Published]]:
    found: dict[tuple[str, str], list[Published]] = {}
    for row in published_rows("convergence"):
        found.setdefault((row.body, row.condition), []).append(row)
    return list(found.values())


MEASURES: Mapping[str, Measure] = {"convergence": measure}
"""Measuring functions by experiment."""
