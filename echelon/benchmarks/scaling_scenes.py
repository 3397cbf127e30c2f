"""Who is simulated where in `echelon bench scaling`: one herd on open ground, one peloton on one road, of any size.

A larger crowd is more of the same: hoppers stand as far apart; riders ride as far apart, on a road that grows with
their number, first wider, up to thirty metres, and then longer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from echelon.errors import InputError
from echelon.scenario import Scenario
from echelon.terrain.course import Course, LandSettings, ScenerySettings

Kind = Literal["hoppers", "riders"]
KINDS: tuple[Kind, ...] = ("hoppers", "riders")

SIZES: Mapping[Kind, Sequence[int]] = {
    "hoppers": (16, 50, 105, 1_000, 10_000, 100_000),
    "riders": (18, 100, 1_000, 10_000),
}

SECONDS: Mapping[Kind, float] = {"hoppers": 300.0, "riders": 90.0}
"""The longest run [s]."""

SEED = 1

PLANE_PER_AGENT = 60.0  # of the open ground [m^2]
PLANE_LEAST = 60.0  # half its side [m]

ROW_SPACING, LATERAL_SPACING = 3.2, 1.2  # of riders at the start, as in scenarios [m]
EDGE_MARGIN = 0.9  # [m]
COLUMNS_LEAST, COLUMNS_MOST = 4, 24  # riders abreast; the widest road has room for that many
RIDING_SPEED = 8.0  # that riders start with [m/s]
ROOM_AHEAD = 300.0  # beyond what riders cover [m]
POINT_SPACING = 20.0  # of the road's centreline [m]
WAVE, WAVE_HEIGHT = 400.0, 2.0  # the road goes up and down: length and amplitude [m]


@dataclass(frozen=True)
class Scene:
    """A crowd of one size.

    Attributes:
        kind: Who.
        agents: How many.
        scenario: Who is where, and for how long at most.
        described: In a line.
    """

    kind: Kind
    agents: int
    scenario: Scenario
    described: str


def sizes_of(kind: Kind, most: int | None) -> tuple[int, ...]:
    """The sizes to measure, up to ``most`` agents.

    Raises:
        InputError: None is so small.
    """
    found = tuple(size for size in SIZES[kind] if most is None or size <= most)
    if not found:
        raise InputError(f"--most {most}: must be at least {SIZES[kind][0]}, the smallest crowd of {kind}")
    return found


def scene_of(kind: Kind, agents: int, folder: Path) -> Scene:
    """A crowd of one size; riders' course is written into a folder."""
    return _hoppers(agents) if kind == "hoppers" else _riders(agents, folder)


def _hoppers(agents: int) -> Scene:
    half_size = max(PLANE_LEAST, math.sqrt(PLANE_PER_AGENT * agents) / 2.0)
    scenario = Scenario.from_dict(
        {
            "name": f"{agents}-hoppers",
            "seconds": SECONDS["hoppers"],
            "seed": SEED,
            "crowd": {"character": "hopper", "count": agents},
            "world": {"ground": "plane", "half_length": half_size},
        }
    )
    described = f"a herd on open ground, {scenario.crowd.start_spacing:g} m apart at the start"
    return Scene("hoppers", agents, scenario, described)


def _riders(agents: int, folder: Path) -> Scene:
    columns = min(max(round(math.sqrt(agents) / 2.5), COLUMNS_LEAST), COLUMNS_MOST)
    grid = ROW_SPACING * -(-agents // columns)
    course = straight_course(
        f"straight-of-{agents}",
        grid + 1.5 * RIDING_SPEED * SECONDS["riders"] + ROOM_AHEAD,
        max(8.0, LATERAL_SPACING * (columns - 1) + 2.0 * EDGE_MARGIN + 0.4),
    )
    path = folder / f"{course.name}.toml"
    path.write_text(course.to_toml(), encoding="utf-8")
    scenario = Scenario.from_dict(
        {
            "name": f"{agents}-riders",
            "seconds": SECONDS["riders"],
            "seed": SEED,
            "crowd": {"character": "cyclist", "count": agents},
            "world": {"ground": "road", "course": str(path)},
            "peloton": {
                "columns": columns,
                "row_spacing": ROW_SPACING,
                "lateral_spacing": LATERAL_SPACING,
                "edge_margin": EDGE_MARGIN,
                "start_speed": RIDING_SPEED,
            },
        }
    )
    described = (
        f"a peloton {columns} abreast on a straight road {course.width:.1f} m wide that goes up and down by "
        f"{WAVE_HEIGHT:g} m every {WAVE:g} m"
    )
    return Scene("riders", agents, scenario, described)


def straight_course(name: str, length: float, width: float) -> Course:
    """A road along x that goes up and down, land beside it, nothing on that.

    Args:
        name: Of the course.
        length: [m].
        width: [m].
    """
    count = math.ceil(length / POINT_SPACING) + 1
    points = tuple(
        (x, 0.0, WAVE_HEIGHT * math.sin(2.0 * math.pi * x / WAVE)) for x in (POINT_SPACING * i for i in range(count))
    )
    nothing = ScenerySettings(house_spacing=0.0, tree_spacing=0.0, lamp_spacing=0.0, hydrant_spacing=0.0, depth=5.0)
    return Course(
        name,
        closed=False,
        width=width,
        points=points,
        land=LandSettings(margin=20.0, hills=0.0),
        scenery=nothing,
    )
