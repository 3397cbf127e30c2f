"""Chapter 5: what a body in flight does with the angular momentum that it has, and without any.

Gymnasts start in the air, upright, and are watched while they fall: nothing but gravity touches them. The thesis does
not print its somersault rates; ours start slow enough that the tuck stays within the axis of its figure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from echelon.agents.gymnasts.airborne import airborne_population
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.poses import inertia_tensor, poses
from echelon.agents.gymnasts.script import parse_script
from echelon.benchmarks.thesis.experiments import FidelitySettings, Measure
from echelon.benchmarks.thesis.published import published_rows
from echelon.benchmarks.thesis.rows import Measured
from echelon.benchmarks.thesis.trials import gymnast_of, trials

FRAME_RATE = 60
LAYOUT_RATE = 2.5  # somersault rate before a tuck or a pike [rad/s]
SETTLED = 1.5  # after which a body is in the position that it was told to take [s]
LAYOUT_FIRST = 0.2  # for which it somersaults straight before [s]
ARMS_BACK = 0.728  # when thrown arms come back [s]: the thesis's

POSITION = """
[[row]]
name = "straight"
phase = "tumble"
pose = "layout"
next = [{{ to = "position", when = {{ row_age = [0.2, inf] }} }}]
[[row]]
name = "position"
phase = "tumble"
pose = "{pose}"
duration = 0.4
gains = {{ hip = [2, 1.5], knee = [2, 1.5], spine = [2, 1.5], shoulder = [3, 2], elbow = [3, 2] }}
"""

WINDMILL = """
[[row]]
name = "circle"
phase = "tumble"
duration = 1.0
channels = { shoulder = "2*pi" }
next = [{ to = "back", when = { row_age = [1.6, inf] } }]
[[row]]
name = "back"
phase = "tumble"
duration = 1.0
channels = { shoulder = 0.0 }
"""

HALF_SOMERSAULT = """
[[row]]
name = "tuck"
phase = "tumble"
pose = "tuck"
duration = 0.4
channels = { hip = -1.8, knee = 2.0, spine_bend = 0.8, shoulder = 0.0, elbow = 0.0 }
next = [{ to = "arms up", when = { row_age = [0.45, inf] } }]
[[row]]
name = "arms up"
phase = "tumble"
duration = 0.4
channels = { shoulder = "pi" }
next = [{ to = "arms down", when = { row_age = [0.4, inf] } }]
[[row]]
name = "arms down"
phase = "tumble"
duration = 0.4
channels = { shoulder = "2*pi" }
next = [{ to = "arms up again", when = { row_age = [0.4, inf] } }]
[[row]]
name = "arms up again"
phase = "tumble"
duration = 0.4
channels = { shoulder = "3*pi" }
next = [{ to = "straight", when = { row_age = [0.45, inf] } }]
[[row]]
name = "straight"
phase = "tumble"
duration = 0.4
channels = { hip = 0.0, knee = 0.0, ankle = 0.0, spine_bend = 0.0, neck_bend = 0.0 }
"""

THROW = """
[parameters]
throw = 0.03
back = 0.728
throw_time = 0.12
back_time = 0.3
left = 3.3
right = 0.0
[[row]]
name = "layout"
phase = "tumble"
pose = "layout"
next = [{ to = "throw", when = { row_age = ["throw", inf] } }]
[[row]]
name = "throw"
phase = "tumble"
duration = "throw_time"
channels = { left_shoulder_spread = "left", right_shoulder_spread = "right" }
gains = { shoulder = [3, 2], elbow = [3, 2] }
next = [{ to = "back", when = { time = ["back", inf] } }]
[[row]]
name = "back"
phase = "tumble"
pose = "layout"
duration = "back_time"
gains = { shoulder = [3, 2], elbow = [3, 2] }
"""

THROWS: Mapping[str, tuple[float, Mapping[str, float]]] = {
    "male": (-63.261, {"right": -0.2558, "back_time": 0.3674}),
    "female": (-26.117, {"right": -0.1426, "back_time": 0.2871}),
}
"""Angular momentum [kg m^2/s] and parameters of the throw for which it is undone after `ARMS_BACK`, by body: found by
CMA-ES, as the time of the thesis was found for its momentum."""


@dataclass(frozen=True)
class Flight:
    """What was seen of gymnasts in flight, frame by frame.

    Attributes:
        seconds: When each frame was [s], shape [frames].
        somersault, twist: Of the pelvis since the start [rad], shape [frames, agents].
        momentum: Angular momentum about the left axis [kg m^2/s], shape [frames, agents].
        q: Generalised positions at the end, shape [agents, q_count].
    """

    seconds: np.ndarray
    somersault: np.ndarray
    twist: np.ndarray
    momentum: np.ndarray
    q: np.ndarray

    def rate(self, angle: np.ndarray, since: float, until: float) -> np.ndarray:
        """Mean rate of an angle between two times [rad/s], shape [agents]."""
        a, b = np.searchsorted(self.seconds, (since - 1e-9, until - 1e-9))
        return (angle[b] - angle[a]) / (self.seconds[b] - self.seconds[a])


def fly(
    character: Gymnast,
    text: str,
    start: Mapping[str, float],
    seconds: float,
    settings: FidelitySettings,
    *,
    momentum: float = 0.0,
    values: Sequence[Mapping[str, float]] = ({},),
) -> Flight:
    """Gymnasts in flight who follow a script from a position.

    Args:
        character: Who.
        text: The script.
        start: Position that they start in, by channel [rad].
        seconds: For how long [s].
        settings: How to run them.
        momentum: Angular momentum about the left axis: forward somersaults are positive [kg m^2/s].
        values: Parameters of the script, for each.
    """
    script = parse_script(text, "a tumble")
    people = airborne_population(character, start, len(values), momentum=(0.0, momentum, 0.0))
    run = trials(character, script, values, settings, frame_rate=FRAME_RATE, people=people)
    seen = run.run(seconds, ["somersault", "twist", "momentum_y"])
    q = run.now("q")
    run.close()
    frames = len(seen["twist"])
    return Flight(
        seconds=np.arange(1, frames + 1) / FRAME_RATE,
        somersault=seen["somersault"],
        twist=seen["twist"],
        momentum=seen["momentum_y"],
        q=q,
    )


def _inertias(settings: FidelitySettings) -> list[Measured]:
    """Figure 5.2: in the position that the servos hold, with no momentum."""
    found = []
    for row in published_rows("tumble-inertia"):
        character = gymnast_of(row.body)
        text = POSITION.format(pose=row.given["position"])
        flight = fly(character, text, poses()["layout"], SETTLED, settings)
        # Upright, for the axis is the body's own.
        q = np.array(flight.q[0], dtype=float)
        q[:7] = character.body.q_reference[:7]
        found.append(Measured(row, float(inertia_tensor(character.body, q)[1, 1])))
    return found


def _rates(settings: FidelitySettings) -> list[Measured]:
    """Figure 5.3: the rate in pike and tuck over that in layout, and how well momentum is kept."""
    flights: dict[tuple[str, str], Flight] = {}
    found = []
    for row in published_rows("tumble-rate"):
        key = (row.body, str(row.given["position"]))
        if key not in flights:
            character = gymnast_of(row.body)
            layout = poses()["layout"]
            inertia = float(inertia_tensor(character.body, _still(character, layout))[1, 1])
            text = POSITION.format(pose=key[1])
            flights[key] = fly(character, text, layout, 2.0, settings, momentum=LAYOUT_RATE * inertia)
        flight = flights[key]
        somersault = flight.somersault
        before = flight.rate(somersault, 0.05, LAYOUT_FIRST)[0]
        if row.quantity == "peak rate":
            value = float(np.diff(somersault[:, 0]).max() * FRAME_RATE)
        elif row.quantity == "rate over that in layout":
            value = float(flight.rate(somersault, SETTLED, 2.0)[0] / before)
        else:
            drift = np.abs(flight.momentum[:, 0] / flight.momentum[0, 0] - 1.0).max()
            value = float(drift / flight.seconds[-1])
        found.append(Measured(row, value))
    return found


def _still(character: Gymnast, channels: Mapping[str, float]) -> np.ndarray:
    return airborne_population(character, channels).q[0]


def _arms_parallel() -> dict[str, float]:
    """The layout with arms that are not spread."""
    return dict(poses()["layout"]) | {"left_shoulder_spread": 0.0, "right_shoulder_spread": 0.0}


def _windmill(settings: FidelitySettings) -> list[Measured]:
    """Section 5.1.1: both arms go once around, forward and up, and back again."""
    found = []
    for row in published_rows("tumble-windmill"):
        flight = fly(gymnast_of(row.body), WINDMILL, _arms_parallel(), 3.5, settings)
        turned = np.degrees(flight.somersault[:, 0])
        there = turned[np.searchsorted(flight.seconds, 1.6)]
        found.append(Measured(row, float(there if "arms [deg]" in row.given else turned[-1])))
    return found


def _half_somersault(settings: FidelitySettings) -> list[Measured]:
    """Figure 5.4: tucked, the arms circle one and a half times; straight again, the body has turned."""
    found = []
    for row in published_rows("tumble-half-somersault"):
        flight = fly(gymnast_of(row.body), HALF_SOMERSAULT, _arms_parallel(), 2.6, settings)
        note = "six postures of our own: the thesis does not print its angles"
        found.append(Measured(row, float(np.degrees(flight.somersault[-1, 0])), note))
    return found


def _twists(settings: FidelitySettings) -> list[Measured]:
    """Figures 5.5 to 5.7: arms thrown in a layout somersault, and brought back."""
    found = []
    for row in published_rows("tumble-twist"):
        momentum, values = THROWS[row.body]
        flight = fly(gymnast_of(row.body), THROW, poses()["layout"], 2.0, settings, momentum=momentum, values=[values])
        if "arms back at [s]" in row.given:
            value, note = abs(flight.rate(flight.twist, 1.3, 1.9)[0]), "mean from 1.3 to 1.9 s; a wobble remains"
        elif row.quantity == "twist rate":
            value, note = abs(flight.rate(flight.twist, 0.3, ARMS_BACK)[0]), "mean from the throw to the undoing"
        else:
            # Before anything moves, momentum alone says how fast it turns.
            character = gymnast_of(row.body)
            inertia = inertia_tensor(character.body, _still(character, poses()["layout"]))[1, 1]
            thrown = flight.rate(flight.somersault, 0.3, ARMS_BACK)[0]
            value, note = thrown * inertia / momentum, ""
        found.append(Measured(row, float(value), note))
    return found


MEASURES: Mapping[str, Measure] = {
    "tumble-inertia": _inertias,
    "tumble-rate": _rates,
    "tumble-windmill": _windmill,
    "tumble-half-somersault": _half_somersault,
    "tumble-twist": _twists,
}
"""Measuring functions by experiment."""
