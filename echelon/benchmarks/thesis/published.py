"""What the thesis found, experiment by experiment, and what ours is asked to be.

Tables and what text and captions say are numbers. Of figures we have only axes, legends and captions, so their curves
are not here: a row that stands for one has no published value, and its rule is either what the figure's axes bound or
what Echelon asks of itself. Two things make numbers differ that no controller can help: the thesis does not print the
gains of its servos, nor where its contact points are. What depends on little else is reported without a verdict.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

from echelon.benchmarks.thesis.rows import REPORTED, AtLeast, AtMost, Between, Published, Range, Rule, Within

GROUPS = ("leap", "tumble", "land", "balance", "maneuvers", "convergence")
"""Groups of experiments: a chapter each, 4 to 8, and what the step of the simulation changes in all of them."""

DIRECTIONS = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)
"""Directions of offsets and pushes [deg], from straight ahead to the left."""

ROBUST = AtLeast(0.8)
"""Share of slightly disturbed trials that end well; the thesis did not try."""

CONVERGED = AtMost(5.0)
"""By how much half the step may change a maneuver [%]."""

LEAST_MOMENTUM = 20.0
"""A change of angular momentum counts as a share of at least this [kg m^2/s]: who should not turn has next to none.
5 % of it turn a man's crouched body by some three degrees in half a second of flight."""


@dataclass(frozen=True)
class Experiment:
    """An experiment of the thesis.

    Attributes:
        name: As `echelon bench thesis --only` calls it.
        group: Which of `GROUPS`.
        source: Table, figure or section.
        title: What it shows.
    """

    name: str
    group: str
    source: str
    title: str


EXPERIMENTS = (
    Experiment("leap-table", "leap", "Table 4.1", "Rise of vertical leaps for the thesis's parameters"),
    Experiment("leap-command", "leap", "Figure 4.1", "Rise of vertical leaps as commanded"),
    Experiment("leap-force", "leap", "Figure 4.2", "Ground reaction of vertical leaps"),
    Experiment("broad-table", "leap", "Table 4.2", "Distance of broad jumps for the thesis's parameters"),
    Experiment("broad-command", "leap", "Figure 4.4", "Distance of broad jumps as commanded"),
    Experiment("leap-rotation", "leap", "Figure 4.5", "Somersault rate by the hip angle at liftoff"),
    Experiment("tumble-inertia", "tumble", "Figure 5.2", "Inertia about the somersault axis"),
    Experiment("tumble-rate", "tumble", "Figure 5.3", "Somersault rate from layout to pike and tuck"),
    Experiment("tumble-windmill", "tumble", "Section 5.1.1", "Windmilling arms turn the torso"),
    Experiment("tumble-half-somersault", "tumble", "Figure 5.4", "Half a somersault without momentum"),
    Experiment("tumble-twist", "tumble", "Figure 5.7", "A twist by thrown arms, and its undoing"),
    Experiment("land-drop", "land", "Section 6.2", "Landings from a height"),
    Experiment("land-speed", "land", "Table 6.1", "Landings with horizontal speed"),
    Experiment("land-backpack", "land", "Table 6.2", "Landings with a backpack"),
    Experiment("land-traces", "land", "Figure 6.3", "How horizontal speed is lost"),
    Experiment("balance-toe-touch", "balance", "Figure 7.2", "Touching the toes"),
    Experiment("balance-knee-bend", "balance", "Figure 7.4", "Knee bends"),
    Experiment("balance-offset", "balance", "Figure 7.5", "Largest offsets of the centre of mass"),
    Experiment("balance-backpack", "balance", "Figure 7.6", "Largest offsets with a backpack"),
    Experiment("balance-push", "balance", "Figure 7.7", "Largest pushes of 0.25 s on the sternum"),
    Experiment("balance-slope", "balance", "Section 7.3", "Steepest slopes"),
    Experiment("vertical-leap", "maneuvers", "Figures 8.1, 8.2", "Vertical leaps, landed"),
    Experiment("broad-jump", "maneuvers", "Figures 8.3, 8.4", "Broad jumps, landed"),
    Experiment("dives", "maneuvers", "Figure 8.5", "Four dives from 10 m"),
    Experiment("back-handspring", "maneuvers", "Figures 8.6, 8.7", "Back handspring"),
    Experiment("back-somersault", "maneuvers", "Figure 8.8", "Standing back somersault"),
    Experiment("forward-somersault", "maneuvers", "Figures 8.9, 8.10", "Standing forward somersault, with backpacks"),
    Experiment("convergence", "convergence", "All chapters", "What half the step changes at most"),
)

Given = dict[str, float | str]


@cache
def published_rows(experiment: str) -> tuple[Published, ...]:
    """An experiment's rows in the order in which they are reported; raises KeyError for a strange name."""
    return _rows_by_experiment()[experiment]


def rows_by_body(experiment: str) -> dict[str, list[Published]]:
    """An experiment's rows for each body that it has any for; raises KeyError for a strange name."""
    found: dict[str, list[Published]] = {}
    for row in published_rows(experiment):
        found.setdefault(row.body, []).append(row)
    return found


@cache
def _rows_by_experiment() -> dict[str, tuple[Published, ...]]:
    rows = [*_leap(), *_tumble(), *_land(), *_balance(), *_maneuvers(), *_convergence()]
    return {one.name: tuple(row for row in rows if row.experiment == one.name) for one in EXPERIMENTS}


def _row(
    experiment: str,
    body: str,
    given: Given,
    quantity: str,
    unit: str,
    thesis: float | None = None,
    rule: Rule = REPORTED,
    human: float | Range | None = None,
) -> Published:
    return Published(experiment, body, given, quantity, unit, thesis, human, rule)


def _ends_balanced(experiment: str, body: str, given: Given) -> Published:
    return _row(experiment, body, given, "ends balanced", "1", 1.0, AtLeast())


# ---- chapter 4 -------------------------------------------------------------------------------------------------------
def _leap() -> Iterator[Published]:
    # l_hip, hip angle, rise
    table_4_1 = {
        "male": (
            (0.85, 0.0, 0.073),
            (0.75, -0.5, 0.224),
            (0.65, -1.0, 0.476),
            (0.55, -1.5, 0.713),
            (0.45, -1.8, 0.948),
        ),
        "female": ((0.7, 0.0, 0.041), (0.6, -0.5, 0.240), (0.5, -1.0, 0.648), (0.4, -1.5, 1.158)),
    }
    for body, trials in table_4_1.items():
        for length, hip, rise in trials:
            yield _row("leap-table", body, {"l_hip [m]": length, "hip [rad]": hip}, "rise", "m", rise)
    for body, record in (("male", 1.22), ("female", 0.76)):
        for tenth in range(1, 11):
            given: Given = {"commanded [m]": tenth / 10}
            yield _row("leap-command", body, given, "rise", "m", rule=Within(0.05, of=tenth / 10))
            yield _row("leap-command", body, given, "ends balanced", "1", rule=AtLeast(1.0))
        yield _row("leap-command", body, {}, "highest leap", "m", 1.0, Within(0.05), human=record)
    for body in ("male", "female"):
        for height in (0.2, 0.5, 0.8):
            # The figure's axis ends at 6000 N.
            given = {"commanded [m]": height}
            yield _row("leap-force", body, given, "peak force", "N", rule=AtMost(6000.0))
    # The person leapt 0.45 m.
    half: Given = {"commanded [m]": 0.5}
    yield _row("leap-force", "male", half, "peak force", "body weight", 5.8, AtMost(), human=2.5)
    yield _row("leap-force", "male", half, "time from standing to liftoff", "s", 1.1, Within(relative=0.3), human=1.1)
    # l_hip, offset of the centre of mass, shoulder, distance
    table_4_2 = {
        "male": ((0.72, 0.05, 1.8, 0.376), (0.68, 0.07, 2.8, 1.155), (0.50, 0.08, 3.2, 2.120)),
        "female": ((0.68, 0.02, 1.8, 0.31), (0.52, 0.04, 2.8, 0.69), (0.40, 0.06, 3.2, 1.57)),
    }
    for body, trials in table_4_2.items():
        for length, offset, shoulder, distance in trials:
            given = {"l_hip [m]": length, "offset [m]": offset, "shoulder [rad]": shoulder}
            yield _row("broad-table", body, given, "distance", "m", distance)
    commands = {"male": (0.4, 0.8, 1.2, 1.6, 2.0, 2.12), "female": (0.4, 0.8, 1.2, 1.57)}
    for body, longest, norm in (("male", 2.12, 2.2), ("female", 1.57, 1.7)):
        for distance in commands[body]:
            given = {"commanded [m]": distance}
            yield _row("broad-command", body, given, "distance", "m", rule=Within(0.1, of=distance))
            yield _row("broad-command", body, given, "ends balanced", "1", rule=AtLeast(1.0))
        yield _row("broad-command", body, {}, "longest jump", "m", longest, Within(0.1), human=norm)
    # The figure's axis ends at 15 rad/s either way; a leap with flexed hips turns forwards, one with extended hips
    # backwards, and where between the two it does not turn depends on gains.
    for body in ("male", "female"):
        for hip, rule in (
            (-2.8, Between(0.0, 15.0)),
            (-2.0, Between(0.0, 15.0)),
            (-1.0, Between(-15.0, 15.0)),
            (1.0, Between(-15.0, 0.0)),
            (2.0, Between(-15.0, 0.0)),
        ):
            yield _row("leap-rotation", body, {"hip at liftoff [rad]": hip}, "somersault rate", "rad/s", rule=rule)


# ---- chapter 5 -------------------------------------------------------------------------------------------------------
def _tumble() -> Iterator[Published]:
    inertias = {"male": (18.31, 5.84, 4.84), "female": (7.43, 2.52, 1.92)}
    for body, (layout, pike, tuck) in inertias.items():
        for position, inertia, near in (("layout", layout, 0.03), ("pike", pike, 0.08), ("tuck", tuck, 0.08)):
            rule = Within(relative=near)
            yield _row("tumble-inertia", body, {"position": position}, "inertia", "kg m^2", inertia, rule)
    for body, (layout, pike, tuck) in inertias.items():
        for position, inertia in (("pike", pike), ("tuck", tuck)):
            # What momentum makes of the inertias; the curve itself is bounded by its axis.
            given: Given = {"position": position}
            ratio = round(layout / inertia, 3)
            yield _row("tumble-rate", body, given, "rate over that in layout", "1", ratio, Within(relative=0.08))
            yield _row("tumble-rate", body, given, "peak rate", "rad/s", rule=AtMost(14.0))
            yield _row("tumble-rate", body, given, "change of momentum a second", "1", rule=AtMost(0.02))
    circle: Given = {"arms [deg]": 360.0}
    undone: Given = {"arms": "there and back"}
    yield _row("tumble-windmill", "male", circle, "torso turned against the arms", "deg", 20.0, Within(3.0))
    yield _row("tumble-windmill", "male", undone, "torso turned", "deg", 0.0, Within(1.0))
    yield _row("tumble-half-somersault", "male", {}, "turned", "deg", 90.0, Within(15.0))
    for body in ("male", "female"):
        thrown: Given = {"arms": "thrown"}
        back: Given = {"arms back at [s]": 0.728}
        yield _row("tumble-twist", body, thrown, "twist rate", "rad/s", rule=Between(0.5, 10.0))
        yield _row("tumble-twist", body, thrown, "somersault rate over that before", "1", rule=Between(0.5, 1.0))
        yield _row("tumble-twist", body, back, "twist rate", "rad/s", 0.0, Within(0.5))


# ---- chapter 6 -------------------------------------------------------------------------------------------------------
def _land() -> Iterator[Published]:
    for body, height in (("male", 1.15), ("female", 0.92)):
        yield _row("land-drop", body, {}, "greatest fall", "m", height, AtLeast())
        yield _row("land-drop", body, {"fall [m]": 0.45}, "peak force", "body weight", human=(5.0, 7.0))
        # In people it grows with the root of the height.
        growth = Within(0.15, of=0.5)
        yield _row("land-drop", body, {}, "exponent of peak force over height", "1", rule=growth, human=0.5)
    speeds = (3.0, 2.0, 1.0, 0.0, -1.0)
    deltas = {"male": (0.16, 0.20, 0.20, 0.08, -0.01), "female": (-0.06, 0.04, 0.14, 0.08, -0.08)}
    for body, corrections in deltas.items():
        for speed, delta in zip(speeds, corrections, strict=True):
            yield from _landing("land-speed", body, {"speed [m/s]": speed}, delta)
    packed = {2.0: (-0.06, 0.04, 0.14, 0.08, -0.085), 4.0: (-0.06, 0.06, 0.15, 0.08, -0.105)}
    for mass, corrections in packed.items():
        for speed, delta in zip(speeds, corrections, strict=True):
            yield from _landing("land-backpack", "female", {"backpack [kg]": mass, "speed [m/s]": speed}, delta)
    for body in ("male", "female"):
        given: Given = {"speed [m/s]": 2.0}
        yield _row("land-traces", body, given, "feet ahead of the centre of mass at touchdown", "m", rule=AtLeast(0.0))
        yield _row("land-traces", body, given, "speed when balance begins", "m/s", rule=Within(0.3, of=0.0))


def _landing(experiment: str, body: str, given: Given, delta: float) -> Iterator[Published]:
    yield _ends_balanced(experiment, body, given)
    yield _row(experiment, body, given, "correction of the feet", "m", delta)


# ---- chapter 7 -------------------------------------------------------------------------------------------------------
def _balance() -> Iterator[Published]:
    yield _row("balance-toe-touch", "female", {"balance": "balance on"}, "stands", "1", 1.0, AtLeast())
    yield _row("balance-toe-touch", "female", {"balance": "balance off"}, "stands", "1", 0.0, AtMost())
    for body, height in (("male", 0.52), ("female", 0.47)):
        given: Given = {"commanded [m]": height}
        yield _row("balance-knee-bend", body, given, "height of the hips", "m", height, Within(0.02))
        yield _row("balance-knee-bend", body, given, "least margin of support", "m", rule=AtLeast(0.0))
    for body in ("male", "female"):
        for direction in DIRECTIONS:
            yield from _offsets("balance-offset", body, {"direction [deg]": direction})
    for mass in (2.0, 4.0):
        for direction in DIRECTIONS:
            yield from _offsets("balance-backpack", "female", {"backpack [kg]": mass, "direction [deg]": direction})
    for body, least in (("male", 110.0), ("female", 60.0)):
        for direction in DIRECTIONS:
            given = {"direction [deg]": direction}
            yield _row("balance-push", body, given, "largest push", "N", rule=AtLeast(least))
    for direction, slope in ((0.0, 33.7), (180.0, 38.6), (90.0, 25.7), (270.0, 25.7)):
        yield _row("balance-slope", "male", {"direction [deg]": direction}, "steepest slope", "deg", slope, AtLeast())


def _offsets(experiment: str, body: str, given: Given) -> Iterator[Published]:
    yield _row(experiment, body, given, "largest offset asked for", "m")
    yield _row(experiment, body, given, "offset reached", "m")


# ---- chapter 8 -------------------------------------------------------------------------------------------------------
def _maneuvers() -> Iterator[Published]:
    for rise in (0.16, 0.33, 0.58):
        given: Given = {"commanded [m]": rise}
        yield _row("vertical-leap", "female", given, "rise", "m", rise, Within(0.05))
        yield _ends_balanced("vertical-leap", "female", given)
    for distance in (1.1, 2.1):
        given = {"commanded [m]": distance}
        yield _row("broad-jump", "male", given, "distance", "m", distance, Within(0.1))
        yield _ends_balanced("broad-jump", "male", given)
    # A dive ends head first: one and a half somersaults are 540 degrees.
    for body, dive, somersault, twist in (
        ("male", "inward 1 1/2 pike", 540.0, 0.0),
        ("male", "back 1 1/2 with 1/2 twist", 540.0, 180.0),
        ("female", "inward 2 1/2 pike", 900.0, 0.0),
        ("female", "back 1 1/2 with 2 1/2 twists", 540.0, 900.0),
    ):
        given = {"dive": dive}
        yield _row("dives", body, given, "somersault at entry", "deg", somersault, Within(20.0))
        yield _row("dives", body, given, "twist at entry", "deg", twist, Within(20.0))
        yield _row("dives", body, given, "disturbed trials that enter so", "1", rule=ROBUST)
    yield from _tried("back-handspring", "male", {"script": "as tuned"})
    yield _row("back-handspring", "male", {"script": "the failure"}, "falls backwards", "1", 1.0, AtLeast())
    yield from _tried("back-somersault", "male", {})
    yield from _tried("forward-somersault", "female", {"backpack [kg]": 0.0})
    # Moments later than without a backpack: opening the tuck, touchdown (its sign is not told), balance.
    for mass, opening, touchdown, balance in ((2.0, -0.07, 0.015, 0.0), (4.0, -0.12, 0.02, -0.43)):
        untuned: Given = {"backpack [kg]": mass, "script": "as without"}
        tuned: Given = {"backpack [kg]": mass, "script": "tuned again"}
        yield _row("forward-somersault", "female", untuned, "ends balanced", "1", 0.0)
        yield from _tried("forward-somersault", "female", tuned)
        yield _row("forward-somersault", "female", tuned, "later opening", "s", opening)
        yield _row("forward-somersault", "female", tuned, "difference of touchdown", "s", touchdown, Within(0.03))
        yield _row("forward-somersault", "female", tuned, "later balance", "s", balance)
        yield _row("forward-somersault", "female", tuned, "higher centre of mass", "m", rule=AtLeast(0.0))
        yield _row("forward-somersault", "female", tuned, "higher peak rate", "rad/s", rule=AtMost(0.0))


def _tried(experiment: str, body: str, given: Given) -> Iterator[Published]:
    yield _ends_balanced(experiment, body, given)
    yield _row(experiment, body, given, "disturbed trials that end balanced", "1", rule=ROBUST)


# ---- all chapters ----------------------------------------------------------------------------------------------------
def _convergence() -> Iterator[Published]:
    both = ("male", "female")
    for maneuver, bodies in {
        "vertical leap": both,
        "broad jump": both,
        "back handspring": ("male",),
        "back somersault": ("male",),
        "forward somersault": ("female",),
        "forward somersault with 2 kg": ("female",),
        "forward somersault with 4 kg": ("female",),
        "inward 1 1/2 pike": ("male",),
        "back 1 1/2 with 1/2 twist": ("male",),
        "inward 2 1/2 pike": ("female",),
        "back 1 1/2 with 2 1/2 twists": ("female",),
        "landing from a fall": both,
        "landing with speed": both,
    }.items():
        # Who lands only, has no rise, and next to no momentum.
        quantities = ("peak force",) if maneuver.startswith("landing") else ("rise", "angular momentum", "peak force")
        for body in bodies:
            for quantity in quantities:
                yield _row("convergence", body, {"maneuver": maneuver}, f"change of {quantity}", "%", rule=CONVERGED)
