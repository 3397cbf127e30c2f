"""Chapter 7: how far balance lets a gymnast lean, bend, be pushed and stand on a slope.

Every trial is a gymnast of its own, all trials of an experiment one batch. What could be stood is found as the thesis
found it, in steps from nothing upwards: the largest before the first fall.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from echelon.agents.gymnasts.gymnast import Gymnast, gymnast
from echelon.agents.gymnasts.posture import positions_of
from echelon.agents.gymnasts.script import Script, load_script
from echelon.agents.gymnasts.standing import sole_points
from echelon.benchmarks.thesis.experiments import FidelitySettings, Measure
from echelon.benchmarks.thesis.published import DIRECTIONS, published_rows, rows_by_body
from echelon.benchmarks.thesis.rows import Measured, Published
from echelon.benchmarks.thesis.trials import STILL, gymnast_of, speed_of, trials
from echelon.simulation.performance import Performance
from echelon.terrain.incline import InclineTerrain
from echelon.warp_kernels.character import Population

OFFSET_STEP, LARGEST_OFFSET = 0.005, 0.2  # [m]
PUSH_STEP, LARGEST_PUSH = 5.0, 300.0  # [N]
SLOPE_STEP = 0.5  # [deg]
STEEPEST = 45.0  # [deg]
SLOPE_TRIMS = (-0.04, -0.02, 0.0, 0.02, 0.04, 0.06)
"""Offsets of the centre of mass, uphill or down, that are tried on each slope: the thesis tuned them by hand [m]."""


def standing(performance: Performance) -> np.ndarray:
    """Who has not fallen and is at rest, shape [agents], bool."""
    speed = speed_of({name: performance.now(name) for name in ("vx", "vy", "vz")})
    return standing_through(performance) & (speed < STILL)


def toe_touch(settings: FidelitySettings) -> list[Measured]:
    """Figure 7.2: bending to the toes and back, with balance and without."""
    run = trials(gymnast_of("female"), load_script("toe-touch"), [{"balance": 1.0}, {"balance": 0.0}], settings)
    run.run(9.0)
    stood = standing(run)
    with_balance, without = published_rows("balance-toe-touch")
    return [Measured(with_balance, float(stood[0])), Measured(without, float(stood[1]))]


def knee_bend(settings: FidelitySettings) -> list[Measured]:
    """Figure 7.4: hips down to a height over the ground, on flat feet, the centre of mass inside the support."""
    found: list[Measured] = []
    script = load_script("knee-bend")
    for body, rows in rows_by_body("balance-knee-bend").items():
        character = gymnast_of(body)
        height = next(row.thesis for row in rows if row.quantity == "height of the hips")
        assert height is not None
        depths = [height - ankle for ankle in np.arange(-0.02, 0.081, 0.01)]
        run = trials(character, script, [{"depth": depth} for depth in depths], settings)
        q = run.run(3.4, ["q"])["q"]
        reached = character.body.link_poses(q)[:, :, character.body.link_index("left_upper_leg"), 2].min(axis=0)
        best = int(np.argmin(np.where(standing_through(run), np.abs(reached - height), np.inf)))
        track = q[:, best]
        center = character.body.center_of_mass(track)
        margins = [margin(sole_points(character.body, pose), at) for pose, at in zip(track, center, strict=True)]
        for row in rows:
            value = float(reached[best]) if row.quantity == "height of the hips" else min(margins)
            found.append(Measured(row, value))
    return found


def standing_through(run: Performance) -> np.ndarray:
    """Who has not fallen, shape [agents], bool."""
    return run.now("fallen") < 0.5


def margin(points: np.ndarray, center: np.ndarray) -> float:
    """How far inside the convex hull of points the centre of mass is, seen from above [m]; negative outside."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points[:, :2])
    return float(-(hull.equations[:, :2] @ center[:2] + hull.equations[:, 2]).max())


def offsets(settings: FidelitySettings) -> list[Measured]:
    """Figure 7.5: the largest offset of the centre of mass that is stood, in eight directions."""
    found: list[Measured] = []
    for body, rows in rows_by_body("balance-offset").items():
        found += _offsets(gymnast_of(body), rows, settings)
    return found


def backpacks(settings: FidelitySettings) -> list[Measured]:
    """Figure 7.6: the same with a backpack."""
    found: list[Measured] = []
    rows = published_rows("balance-backpack")
    for mass in sorted({row.number("backpack [kg]") for row in rows}):
        carried = [row for row in rows if row.number("backpack [kg]") == mass]
        found += _offsets(gymnast("female", backpack=mass), carried, settings)
    return found


def _offsets(character: Gymnast, rows: Sequence[Published], settings: FidelitySettings) -> list[Measured]:
    sizes = np.arange(OFFSET_STEP, LARGEST_OFFSET + 1e-9, OFFSET_STEP)
    run = _swaying(character, "com", sizes, settings)
    run.run(10.0)
    stood = standing(run).reshape(len(DIRECTIONS), -1)
    reached = np.hypot(run.now("com_x"), run.now("com_y")).reshape(stood.shape)
    found: list[Measured] = []
    for row in rows:
        direction = DIRECTIONS.index(row.number("direction [deg]"))
        count = _before_the_first_fall(stood[direction])
        if row.quantity == "largest offset asked for":
            found.append(Measured(row, float(sizes[count - 1]) if count else 0.0))
        else:
            found.append(Measured(row, float(reached[direction, count - 1]) if count else 0.0))
    return found


def _swaying(character: Gymnast, parameter: str, sizes: np.ndarray, settings: FidelitySettings) -> Performance:
    """Gymnasts to whom something is done along the ground, for each of `DIRECTIONS` one of each size, ready to start.

    Args:
        character: Who.
        parameter: Of the script, less the axis that its name ends with.
        sizes: How much.
        settings: How to run them.
    """
    asked = [(math.radians(direction), size) for direction in DIRECTIONS for size in sizes]
    values = [{f"{parameter}_x": size * math.cos(a), f"{parameter}_y": size * math.sin(a)} for a, size in asked]
    return trials(character, load_script("sway"), values, settings)


def _before_the_first_fall(stood: np.ndarray) -> int:
    """How many trials in a row were stood, from the first, shape [trials]."""
    return int(np.argmin(np.append(stood, False)))


def pushes(settings: FidelitySettings) -> list[Measured]:
    """Figure 7.7: the largest push on the sternum that is stood, in eight directions."""
    forces = np.arange(PUSH_STEP, LARGEST_PUSH + 1e-9, PUSH_STEP)
    found: list[Measured] = []
    for body, rows in rows_by_body("balance-push").items():
        run = _swaying(gymnast_of(body), "push", forces, settings)
        run.run(11.0)
        stood = standing(run).reshape(len(DIRECTIONS), -1)
        for row in rows:
            count = _before_the_first_fall(stood[DIRECTIONS.index(row.number("direction [deg]"))])
            found.append(Measured(row, float(forces[count - 1]) if count else 0.0))
    return found


def slopes(settings: FidelitySettings) -> list[Measured]:
    """Section 7.3: the steepest slope that the male stands on, the offset of the centre of mass tuned for each."""
    character, script = gymnast_of("male"), load_script("stand-on-slope")
    angles = np.arange(10.0, STEEPEST + 1e-9, SLOPE_STEP)
    found: list[Measured] = []
    for row in published_rows("balance-slope"):
        direction = row.number("direction [deg]")
        # The ground rises where the direction points: ahead, behind, to the left or to the right.
        rises = np.radians(angles)
        along = direction in (0.0, 180.0)
        sign = 1.0 if direction in (0.0, 90.0) else -1.0
        values = [
            {"slope": sign * rise, "com_x": trim} if along else {"tilt": sign * rise, "com_y": trim}
            for rise in rises
            for trim in SLOPE_TRIMS
        ]
        stood = np.asarray(_on_slopes(character, script, values, settings).reshape(len(angles), -1).any(axis=1))
        count = _before_the_first_fall(stood)
        note = "" if count else f"does not stand at {angles[0]:g} deg"
        found.append(Measured(row, float(angles[count - 1]) if count else None, note))
    return found


def _on_slopes(
    character: Gymnast, script: Script, values: Sequence[Mapping[str, float]], settings: FidelitySettings
) -> np.ndarray:
    """Who stands after some seconds on the ground that their script expects, shape [agents], bool."""
    usual = {name: parameter.value for name, parameter in script.parameters.items()}
    angles = np.array([usual | {"slope": 0.0} | dict(one) for one in values])
    slope = np.array([one["slope"] for one in angles])
    tilt = np.array([one["tilt"] for one in angles])
    # Lanes climb along x: who has the rise on the left faces -y.
    heading = np.where(tilt != 0.0, -0.5 * math.pi, 0.0)
    grades = np.tan(slope + tilt)
    tables = [script.table(character.body, one) for one in angles]
    channels = Gymnast.script.channels
    start = {name: np.array([table[0, place] for table in tables]) for place, name in enumerate(channels)}
    start = {name: np.nan_to_num(value.astype(float)) for name, value in start.items()}
    q = positions_of(character.body, start)
    q[:, 3:7] = np.column_stack([np.zeros((len(q), 2)), np.sin(0.5 * heading), np.cos(0.5 * heading)])
    q[:, :3] = 0.0
    for agent, grade in enumerate(grades):
        # The lowest point of the soles on the plane through the origin.
        points = sole_points(character.body, q[agent])
        q[agent, 0] -= points[:, 0].mean()
        points[:, 0] -= points[:, 0].mean()
        q[agent, 2] -= (points[:, 2] - grade * points[:, 0]).min() - 0.001
    people = Population(
        q,
        np.zeros((len(q), character.body.u_count)),
        {"heading": heading, "strength": np.ones(len(q))},
        Gymnast.remembering(start),
    )
    terrain = InclineTerrain.of(grades)
    run = trials(
        character, script, angles.tolist(), settings, people=people, terrain=terrain,
        places=InclineTerrain.starts(len(q)),
    )  # fmt: skip
    run.run(8.0)
    return standing(run)


MEASURES: dict[str, Measure] = {
    "balance-toe-touch": toe_touch,
    "balance-knee-bend": knee_bend,
    "balance-offset": offsets,
    "balance-backpack": backpacks,
    "balance-push": pushes,
    "balance-slope": slopes,
}
