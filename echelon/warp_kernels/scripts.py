"""Scripts: what a character does one thing after another, as numbers that the frame kernel reads.

A script is a table of *rows*. In a row the character moves each of its *channels* (a joint's angle, say) along a path
to a target, under *settings* that last as long as the row does; it leaves for another row when the clauses of one of
its *transitions* hold, the first that does. A clause is a range that a *measure* must be in. Rows also have *captures*,
clauses that should hold on arrival: they change nothing, but which of them failed is kept, and says why a landing did.

Scripts are data, so a crowd whose members all do something else runs one program, and a tuner tries a hundred variants
in one launch. `arrive` stands before each control tick, an agent at a time: it looks at what the last tick measured,
changes rows where it is time, and leaves path and settings in the controller's memory, where the traced part of
control finds them.

A row in memory, as `ScriptLayout` lays it out:

    targets [channels]     NaN: the channel goes on as it was
    durations [channels]   of the path to the target [s]
    settings [settings]
    start                  1: paths start from what is measured, 0: from what was wanted
    phase                  for recordings
    transitions            TRANSITIONS times (next row, then CLAUSES times (measure, least, greatest)); -1: none
    captures               CAPTURES times (measure, least, greatest); measure -1: none
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false, reportInvalidTypeForm=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import warp as wp

from echelon.warp_kernels.character import StateLayout
from echelon.warp_kernels.trace import minimum

TRANSITIONS, CLAUSES, CAPTURES = 4, 3, 6
CLAUSE_SIZE = 3
TRANSITION_SIZE = 1 + CLAUSES * CLAUSE_SIZE
NOT_BEGUN = -1.0
"""Value of the memory variable `row` of an agent whose script has not begun."""

CAPTURED = tuple(f"captured.{capture}" for capture in range(CAPTURES))
"""Names of the memory variables that keep what captures asked about."""

PATH_PARTS = ("start", "slope", "target", "duration", "age")
"""What is kept of a channel's path: value [rad] and rate [rad/s] at its start, target [rad], duration and age [s]."""


@dataclass(frozen=True)
class ScriptLayout:
    """How a character's scripts are laid out.

    Attributes:
        channels: Names of what moves along paths.
        settings: Names and usual values of what a row sets.
        measures: Names of memory variables that clauses may ask about.
        resets: Names of memory variables that become zero on arrival in a row.
    """

    channels: tuple[str, ...]
    settings: Mapping[str, float]
    measures: tuple[str, ...]
    resets: tuple[str, ...] = ()

    @property
    def duration_place(self) -> int:
        return len(self.channels)

    @property
    def setting_place(self) -> int:
        return 2 * len(self.channels)

    @property
    def start_place(self) -> int:
        return self.setting_place + len(self.settings)

    @property
    def phase_place(self) -> int:
        return self.start_place + 1

    @property
    def transition_place(self) -> int:
        return self.phase_place + 1

    @property
    def capture_place(self) -> int:
        return self.transition_place + TRANSITIONS * TRANSITION_SIZE

    @property
    def row_size(self) -> int:
        """How many numbers a row has."""
        return self.capture_place + CAPTURES * CLAUSE_SIZE

    def memory(self) -> dict[str, float]:
        """What a character with such scripts must keep in memory, with initial values.

        `row` counts through all scripts of a crowd, `first_row` is where the agent's own begins; `row_age` is the time
        since arrival [s], which control must advance; `missed` has bit i set where capture i failed on the last
        arrival, `captured.i` is what it asked about then, and `arrivals` counts rows.
        """
        kept = {"row": NOT_BEGUN, "first_row": 0.0, "row_age": 0.0, "missed": 0.0, "arrivals": 0.0}
        kept |= dict.fromkeys(CAPTURED, 0.0)
        for channel in self.channels:
            kept |= {f"path.{channel}.{part}": 1.0 if part in ("duration", "age") else 0.0 for part in PATH_PARTS}
            kept[f"wanted.{channel}"] = 0.0
            kept[f"wanted_rate.{channel}"] = 0.0
            kept[f"measured.{channel}"] = 0.0
        return kept | {f"row.{name}": value for name, value in self.settings.items()}


def _vector(places: Sequence[int]) -> Any:
    return wp.types.vector(length=max(len(places), 1), dtype=wp.int32)(*(list(places) or [0]))


@lru_cache(maxsize=16)
def _arrive(places: tuple[tuple[int, ...], ...], sizes: tuple[int, ...]) -> Any:
    """The stage for places of variables in an agent's state (see `arrive_function`)."""
    paths, wanted, rates, measured, settings, measures, resets, own, captured = places
    channel_count, setting_count, reset_count = sizes[:3]
    duration_place, setting_place, start_place, phase_place, transition_place, capture_place = sizes[3:]
    path_at, wanted_at, rate_at, measured_at = _vector(paths), _vector(wanted), _vector(rates), _vector(measured)
    setting_at, measure_at, reset_at = _vector(settings), _vector(measures), _vector(resets)
    captured_at = _vector(captured)
    row_at, first_at, age_at, missed_at, arrivals_at, phase_at = own
    part_count = len(PATH_PARTS)

    @wp.func
    def holds(
        block: int,
        lane: int,
        row: int,
        place: int,
        state: wp.array3d[wp.float32],
        scripts: wp.array2d[wp.float32],
    ) -> bool:
        """Whether a clause holds; one that asks about nothing does."""
        measure = int(scripts[row, place])
        if measure < 0:
            return True
        value = state[block, measure_at[measure], lane]
        return scripts[row, place + 1] <= value and value <= scripts[row, place + 2]

    @wp.func
    def arrive(block: int, lane: int, state: wp.array3d[wp.float32], scripts: wp.array2d[wp.float32]):
        """Change rows, where it is time."""
        first = int(state[block, first_at, lane])
        row = int(state[block, row_at, lane])
        following = wp.int32(-1)
        if row < 0:
            following = first
        else:
            for transition in range(TRANSITIONS):
                place = transition_place + transition * TRANSITION_SIZE
                target = int(scripts[row, place])
                if following < 0 and target >= 0:
                    ready = wp.bool(True)
                    for clause in range(CLAUSES):
                        if not holds(block, lane, row, place + 1 + clause * CLAUSE_SIZE, state, scripts):
                            ready = False
                    if ready:
                        following = first + target
        if following < 0:
            return
        state[block, row_at, lane] = wp.float32(following)
        state[block, age_at, lane] = wp.float32(0.0)
        state[block, arrivals_at, lane] = state[block, arrivals_at, lane] + 1.0
        state[block, phase_at, lane] = scripts[following, phase_place]
        missed = wp.float32(0.0)
        bit = wp.float32(1.0)
        for capture in range(CAPTURES):
            if not holds(block, lane, following, capture_place + capture * CLAUSE_SIZE, state, scripts):
                missed += bit
            bit *= 2.0
            asked = int(scripts[following, capture_place + capture * CLAUSE_SIZE])
            value = wp.float32(0.0)
            if asked >= 0:
                value = state[block, measure_at[asked], lane]
            state[block, captured_at[capture], lane] = value
        state[block, missed_at, lane] = missed
        for setting in range(setting_count):
            state[block, setting_at[setting], lane] = scripts[following, setting_place + setting]
        for reset in range(reset_count):
            state[block, reset_at[reset], lane] = wp.float32(0.0)
        from_measured = scripts[following, start_place] > 0.5
        for channel in range(channel_count):
            target_angle = scripts[following, channel]
            if not wp.isnan(target_angle):
                at = part_count * channel
                start = state[block, wanted_at[channel], lane]
                slope = state[block, rate_at[channel], lane]
                if from_measured:
                    start = state[block, measured_at[channel], lane]
                    slope = wp.float32(0.0)
                state[block, path_at[at], lane] = start
                state[block, path_at[at + 1], lane] = slope
                state[block, path_at[at + 2], lane] = target_angle
                state[block, path_at[at + 3], lane] = scripts[following, duration_place + channel]
                state[block, path_at[at + 4], lane] = wp.float32(0.0)

    return arrive


def arrive_function(layout: StateLayout, script: ScriptLayout) -> Any:
    """The Warp function (block, lane, state, scripts) that changes rows, for a character's state and scripts."""
    memory = layout.memory
    places = (
        tuple(memory[f"path.{channel}.{part}"] for channel in script.channels for part in PATH_PARTS),
        tuple(memory[f"wanted.{channel}"] for channel in script.channels),
        tuple(memory[f"wanted_rate.{channel}"] for channel in script.channels),
        tuple(memory[f"measured.{channel}"] for channel in script.channels),
        tuple(memory[f"row.{name}"] for name in script.settings),
        tuple(memory[name] for name in script.measures),
        tuple(memory[name] for name in script.resets),
        tuple(memory[name] for name in ("row", "first_row", "row_age", "missed", "arrivals", "phase")),
        tuple(memory[name] for name in CAPTURED),
    )
    sizes = (
        len(script.channels),
        len(script.settings),
        len(script.resets),
        script.duration_place,
        script.setting_place,
        script.start_place,
        script.phase_place,
        script.transition_place,
        script.capture_place,
    )
    return _arrive(places, sizes)


def path_now(path: Mapping[str, Any]) -> tuple[Any, Any]:
    """Where a Hermite path is at its age, and its rate: it starts with its slope, and ends with none.

    Args:
        path: By name of `PATH_PARTS`, scalars of any kind; the duration is positive.
    """
    T = path["duration"]
    s = minimum(path["age"] / T, 1.0)
    rest = 1.0 - s
    start, slope, target = path["start"], path["slope"] * T, path["target"]
    # (1 + 2s)(1 - s)^2 start + s (1 - s)^2 slope + s^2 (3 - 2s) target, with the first and last adding up to one.
    rise = s * s * (3.0 - 2.0 * s)
    value = start + rise * (target - start) + s * rest * rest * slope
    rate = (6.0 * s * rest * (target - start) + rest * (1.0 - 3.0 * s) * slope) / T
    return value, rate
