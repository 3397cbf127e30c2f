"""Contact between characters as native code: the part of a substep that only those run who have somebody beside them.

The physics is `meeting`'s; what stands here is in which order it runs and where its numbers are. For each of an
agent's ghosts and each pair of capsules the same statements run in a loop, so their number does not grow with either.

First come three numbers of what an agent is due from the frame before. The numbers of a ghost, `ghost_size` of them,
stand in memory one after the other: its motion, then what is kept of
each pair of capsules. A lane that has fewer ghosts than others of its block has ghosts far away instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from echelon.warp_kernels.character import AgentState
from echelon.warp_kernels.emit import Target, statements
from echelon.warp_kernels.meeting import (
    CONTACT_TIME,
    GHOST_MOTION,
    GHOSTS,
    PAIR_MEMORY,
    STEPS_IN_CONTACT,
    UNDECIDED,
    Bumper,
    CapsulePair,
    Ghost,
    Law,
    PairMemory,
    ghost_wrench,
    moved_ghost,
    root_motion,
    root_wrench,
    settling_wrench,
    touch,
)
from echelon.warp_kernels.spatial import Vector, add
from echelon.warp_kernels.trace import Graph, select

DUE_SIZE = 3
"""Numbers of what an agent is due: an impulse along the world's axes [N s]."""

PAIR_SIZE = 14
"""Numbers of a pair of capsules: three of each end, and a radius, of both."""


@dataclass(frozen=True)
class MeetingCode:
    """Code that leaves the wrench of all ghosts on the first link in ``w[6]``.

    Attributes:
        before: To stand before the loop over substeps.
        each_substep: To stand at the beginning of each substep.
    """

    before: str
    each_substep: str


def ghost_size(bumper: Bumper) -> int:
    """How many numbers a ghost is kept as."""
    return GHOST_MOTION + PAIR_MEMORY * bumper.pair_count


def absent_ghost(bumper: Bumper) -> np.ndarray:
    """The numbers of a ghost so far away that it touches nobody, shape [ghost_size]."""
    motion = [0.0, 0.0, 1e4, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6, 0.0, 0.0, 0.0, 0.0, 0.0]
    return np.array(motion + [UNDECIDED, 0.0, 0.0] * bumper.pair_count, dtype=np.float32)


def contact_frequency(step: float) -> float:
    """Angular frequency of contacts at a substep [s]: [rad/s]."""
    return float(np.pi / max(CONTACT_TIME, STEPS_IN_CONTACT * step))


def pair_values(own: Bumper, other: Bumper) -> list[list[float]]:
    """Each capsule of one with each of another, as `PAIR_SIZE` numbers about the centres of mass [m]."""
    return [
        [*a.start, *a.end, a.radius, *b.start, *b.end, b.radius] for a in own.about_center for b in other.about_center
    ]


def pair_of(values: Sequence[Any]) -> CapsulePair:
    """From the numbers that `pair_values` gives."""
    v = list(values)
    return CapsulePair(v[0:3], v[3:6], v[6], v[7:10], v[10:13], v[13])


def pair_effect(
    bumper: Bumper,
    other_bumper: Bumper,
    law: Law,
    step: float,
    root: tuple[Vector, Vector, Vector, Vector],
    ghost: Ghost,
    pair: CapsulePair,
    memory: PairMemory,
) -> tuple[Vector, Vector, PairMemory, Any]:
    """What one pair of capsules does to the agent's first link and to the ghost, its new memory, whether it touches."""
    own, other = root_motion(*root, bumper.center), ghost.motion
    found = touch(own, other, pair, memory, bumper.mobility, other_bumper.mobility, law, step)
    return root_wrench(own, found, bumper.center), ghost_wrench(other, found), found.memory, found.touching


def meeting_code(
    graph: Graph, state: AgentState, bumper: Bumper, step: float, latch: str, target: Target
) -> MeetingCode:
    """The code of a character's meetings.

    Args:
        graph: Where `state` is.
        state: Of the agent.
        bumper: Of both.
        step: Length of a substep [s].
        latch: Variable that takes the substep of the first touch in a frame.
        target: What the code is for.
    """
    law = Law(contact_frequency(step), graph.input("z[0]"), graph.input("z[1]"))
    root = (state.q[0:3], state.q[3:7], state.u[0:3], state.u[3:6])
    ghost = Ghost.of([graph.input(f"m[{i}]") for i in range(GHOST_MOTION)])
    pair = pair_of([graph.input(f"t[{i}]") for i in range(PAIR_SIZE)])
    memory = PairMemory(graph.input("r[0]"), graph.input("r[1]"), graph.input("r[2]"))
    on_own, on_ghost, kept, touching = pair_effect(bumper, bumper, law, step, root, ghost, pair, memory)
    latched = graph.input(latch)
    first = touching & (latched < 0.0)
    outputs = [(f"w[{i}]", graph.lift(graph.input(f"w[{i}]") + value)) for i, value in enumerate(on_own)]
    outputs += [(f"e[{i}]", graph.lift(graph.input(f"e[{i}]") + value)) for i, value in enumerate(on_ghost)]
    outputs += [("r[0]", graph.lift(kept.stiffness)), ("r[1]", graph.lift(kept.slack))]
    outputs.append(("r[2]", graph.lift(kept.pressed)))
    outputs.append((latch, graph.lift(select(first, state.substep, latched))))
    pair_code = statements(graph, outputs, target, "p")
    due = [graph.input(f"D[{i}]") for i in range(DUE_SIZE)]
    settled = settling_wrench(root_motion(*root, bumper.center), due, state.substep, bumper.center, step)
    due_code = statements(graph, [(f"w[{i}]", graph.lift(value)) for i, value in enumerate(settled)], target, "d")

    graph = Graph()
    ghost = Ghost.of([graph.input(f"m[{i}]") for i in range(GHOST_MOTION)])
    pushes = [graph.input(f"e[{i}]") for i in range(6)]
    moved = moved_ghost(ghost, pushes, bumper.mobility, bumper.spin_inertia, step)
    # How it falls does not change.
    outputs = [(f"m[{i}]", graph.lift(value)) for i, value in enumerate(moved.values) if i not in (13, 14)]
    ghost_code = statements(graph, outputs, target, "g")

    size, pairs = ghost_size(bumper), pair_values(bumper, bumper)
    before = f"const float capsules[{len(pairs)}][{PAIR_SIZE}] = {{\n{_rows(pairs)}}};\n"
    before += f"lanes_in_memory* D = (lanes_in_memory*)(ghosts.data) + (size_t)block * {DUE_SIZE + GHOSTS * size};\n"
    before += f"lanes_in_memory* M = D + {DUE_SIZE};\n"
    before += "const float* laws = (const float*)(law.data);\n"
    before += "lanes z[2] = {(lanes)(laws[0]), (lanes)(laws[1])};\n"
    before += "lanes w[6];\nfor (int i = 0; i < 6; ++i) w[i] = (lanes)(0.0f);\n"
    each = "if (meeting > 0) {\n{\n" + due_code + "}\n"
    each += f"for (int ghost = 0; ghost < meeting; ++ghost) {{\nlanes_in_memory* m = M + ghost * {size};\n"
    each += "lanes e[6];\nfor (int i = 0; i < 6; ++i) e[i] = (lanes)(0.0f);\n"
    each += f"for (int pair = 0; pair < {len(pairs)}; ++pair) {{\n"
    each += f"lanes_in_memory* r = m + {GHOST_MOTION} + {PAIR_MEMORY} * pair;\n"
    each += f"lanes t[{PAIR_SIZE}];\nfor (int i = 0; i < {PAIR_SIZE}; ++i) t[i] = (lanes)(capsules[pair][i]);\n"
    each += pair_code + "}\n" + ghost_code + "}\n}\n"
    return MeetingCode(before, each)


def _rows(rows: Sequence[Sequence[float]]) -> str:
    """Rows of numbers as the language writes them: exactly, in hexadecimal."""
    return ",\n".join("{" + ", ".join(f"{float(np.float32(v)).hex()}f" for v in row) + "}" for row in rows)


def meet(
    bumper: Bumper,
    law: Law,
    step: float,
    root: tuple[Vector, Vector, Vector, Vector],
    ghosts: Sequence[Sequence[Any]],
    others: Bumper | None = None,
) -> tuple[Vector, list[list[Any]], Any]:
    """One substep beside ghosts, over scalars: what the code does, for the reference.

    Args:
        bumper: Of the agent.
        law: What contacts are like.
        step: Length of a substep [s].
        root: Place, attitude, velocity and spin of the agent's first link.
        ghosts: The numbers of each.
        others: The bumper of the ghosts; None if it is the agent's.

    Returns:
        The wrench on the first link, the ghosts' new numbers, and whether anything touches.
    """
    others = others or bumper
    wrench: Vector = [0.0] * 6
    moved: list[list[Any]] = []
    anything: Any = None
    for values in ghosts:
        ghost, pushes, kept_of_pairs = Ghost.of(values[:GHOST_MOTION]), [0.0] * 6, []
        for place, row in enumerate(pair_values(bumper, others)):
            at = GHOST_MOTION + PAIR_MEMORY * place
            memory = PairMemory(values[at], values[at + 1], values[at + 2])
            on_own, on_ghost, kept, touching = pair_effect(bumper, others, law, step, root, ghost, pair_of(row), memory)
            wrench, pushes = add(wrench, on_own), add(pushes, on_ghost)
            kept_of_pairs += [kept.stiffness, kept.slack, kept.pressed]
            anything = touching if anything is None else anything | touching
        moved.append(moved_ghost(ghost, pushes, others.mobility, others.spin_inertia, step).values + kept_of_pairs)
    return wrench, moved, anything
