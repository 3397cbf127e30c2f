"""`echelon bench terrain`: how many times a second the ground can be asked, on one core, and whether it answers right.

The ground is that of a course, as wheels feel it: its height and normal below a point, from the quadtree. It is asked
*riding* (at the wheels of riders, tick by tick, as in a race: each query is near one of the last), and at places drawn
at random from the *road* and from all of the *land*, where no query is near another.

A rate counts only if the ground is the ground: at random places the quadtree's heights must be those of the course's
surfaces, within the tolerance that road and land were cut into triangles with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from echelon.benchmarks.machine import machine_name, package_versions
from echelon.benchmarks.terrain_queries import look_down, measure_queries
from echelon.terrain.course import Course
from echelon.terrain.road import LAND_TOLERANCE, ROAD_TOLERANCE, RoadSurfaces
from echelon.warp_kernels.start import start_warp

Progress = Callable[[int, int], None]
Row = dict[str, Any]

COURSE = "city-race"
QUERIES = 1_000_000  # of each kind
CHECKED = 2000  # places of each surface at which the answer is compared with it
SEED = 2


def run_terrain_benchmark(
    *, course: str = COURSE, queries: int = QUERIES, progress: Progress | None = None
) -> list[Row]:
    """Measure how fast the ground of a course can be asked.

    Args:
        course: Its name, or a file that `Course.load` takes.
        queries: How many of each kind.
        progress: Called with (steps done, of how many): the course is laid, its ground is checked, and asked.

    Returns:
        Rows of plain data, ready for JSON: `queries_per_second` and `query_ns` of each kind of place (`where`); None
        if the ground is not right, and `why` says so.

    Raises:
        InputError: There is no such course.
    """
    report = progress or (lambda done, total: None)
    start_warp()
    report(0, 3)
    surfaces = Course.load(course).surfaces
    report(1, 3)
    errors = worst_errors(surfaces)
    report(2, 3)
    rates = measure_queries(surfaces, "cpu", queries)
    report(3, 3)
    sane = all(error <= limit for error, limit in zip(errors, (ROAD_TOLERANCE, LAND_TOLERANCE), strict=True))
    found = (
        f"heights are within {1e3 * errors[0]:.2g} mm of the road's and {1e3 * errors[1]:.2g} mm of the land's surface"
    )
    if not sane:
        found += f", more than {1e3 * ROAD_TOLERANCE:g} and {1e3 * LAND_TOLERANCE:g}"
    kinds = (("riding", rates.riding), ("road, at random", rates.on_road), ("land, at random", rates.anywhere))
    return [
        {
            "course": course,
            "where": where,
            "queries_per_second": rate if sane else None,
            "query_ns": 1e9 / rate if sane else None,
            "triangles": rates.triangles,
            "threads": 1,
            "sane": sane,
            "why": found,
            "machine": machine_name(),
            "versions": package_versions(),
        }
        for where, rate in kinds
    ]


def worst_errors(surfaces: RoadSurfaces) -> tuple[float, float]:
    """Largest difference of the heights that wheels feel from those of road and land, at random places [m]."""
    random = np.random.default_rng(SEED)
    land, line = surfaces.land, surfaces.centreline
    s, offset = random.uniform(0.0, line.length, CHECKED), surfaces.half_width * random.uniform(-1.0, 1.0, CHECKED)
    road = line.position(s)[:, :2] + offset[:, None] * line.left(s)
    low, high = np.array([land.range_u, land.range_v]).T
    places = np.concatenate([road, random.uniform(low, high, (CHECKED, 2))])
    points = wp.array(np.c_[places, np.zeros(len(places))], dtype=wp.vec3d, device="cpu")
    planes = wp.zeros(len(places), dtype=wp.vec4d, device="cpu")
    wp.launch(look_down, len(places), [surfaces.quadtree.data("cpu"), points], [planes], device="cpu")
    x, y, z, d = planes.numpy().T
    heights = (d - x * places[:, 0] - y * places[:, 1]) / z
    error = np.abs(heights - surfaces.height(places))
    return float(np.max(error[:CHECKED])), float(np.max(error[CHECKED:]))


def print_table(rows: Sequence[Row], console: Console | None = None) -> None:
    """Print what `run_terrain_benchmark` returned."""
    console = console or Console()
    if not rows:
        console.print("Nothing was measured.")
        return
    row = rows[0]
    table = Table(title=f"The ground of {row['course']}, asked by one core", box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("where", "million queries a second", "a query [ns]"):
        table.add_column(Text(heading), justify="left" if heading == "where" else "right")
    for found in rows:
        rate = found["queries_per_second"]
        numbers = ("–", "–") if rate is None else (f"{1e-6 * rate:.2f}", f"{found['query_ns']:.0f}")
        table.add_row(found["where"], *numbers)
    console.print(table)
    for line in (
        f"{row['triangles']:,} triangles; {row['why']}.",
        f"{row['machine']}; {row['versions']}.",
    ):
        console.print(line, markup=False, highlight=False)
