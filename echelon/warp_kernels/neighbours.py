"""Who is near whom: a hash grid of agents on the ground, searched in growing rings.

The ground is cut into square cells. A cell (column, row) of the endless plane belongs to entry (column mod side,
row mod side) of a square table, and each entry heads a linked list of the agents in its cells. The table's side is

1. a power of two, so that "mod" is a bit mask, right for negative numbers too;
2. more than the number of cells across the widest search, so that no search meets an entry twice;
3. at least the square root of the number of agents, so that lists stay short however large the crowd.

Building is one exchange an agent; a search for the k nearest looks at the agent's own cell, then at the ring of cells
around it, and so on, until k are found that are nearer than any agent in the next ring could be:

        . . . . .       Everything within `covered` of the agent has been seen after ring 1:
        . 1 1 1 .       covered = 1 cell + the way from the agent to the nearest edge of its own cell.
        . 1 a 1 .       In a crowd of even density two or three rings are enough, however many agents there are:
        . 1 1 1 .       the cost is linear in agents.
        . . . . .

The order of the lists depends on how the agents were dealt to threads, so nothing may: what a search returns is the
same whatever the order. `nearest_neighbours` sorts by (distance, index), which leaves no ties.

Agents whose position is not finite, or absurdly far away, are in no list: nobody sees them and they see nobody.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import math

import warp as wp

from echelon.warp_kernels.atomics import atomic_exchange

wp.set_module_options({"enable_backward": False})

NOBODY = wp.constant(-1)
HORIZON = wp.constant(1.0e7)  # [m]; nearer to the origin than this, the number of a cell is an exact integer
MOST_RINGS = 32  # a search far wider than the distance between neighbours gets larger cells, not more of them


@wp.struct
class CellTable:
    """The hash grid as kernels see it.

    Attributes:
        heads: An agent of each entry, or -1, shape [side * side].
        nexts: The next agent of the same entry, or -1, shape [agents].
        places: Positions on the ground when the table was built [m], shape [agents].
        cell_size: [m].
        mask: Side of the table, a power of two, minus one.
        shift: Logarithm of the side to base two.
        rings: How many rings of cells the widest search needs.
    """

    heads: wp.array[wp.int32]
    nexts: wp.array[wp.int32]
    places: wp.array[wp.vec2]
    cell_size: wp.float32
    mask: wp.int32
    shift: wp.int32
    rings: wp.int32


def cell_table(agent_count: int, cell_size: float, reach: float, device: wp.DeviceLike = None) -> CellTable:
    """An empty table.

    Args:
        agent_count: How many agents it is for.
        cell_size: About the distance between neighbours is best [m]; larger where `reach` is very much larger.
        reach: Radius of the widest search [m].
        device: Where it lives.
    """
    cell_size = max(cell_size, reach / MOST_RINGS)
    rings = math.ceil(reach / cell_size)
    side = 1 << max(2, math.ceil(math.log2(max(2 * rings + 2, math.sqrt(agent_count)))))
    table = CellTable()
    table.heads = wp.full(side * side, -1, dtype=wp.int32, device=device)
    table.nexts = wp.full(agent_count, -1, dtype=wp.int32, device=device)
    table.places = wp.zeros(agent_count, dtype=wp.vec2, device=device)
    table.cell_size = cell_size
    table.mask, table.shift = side - 1, side.bit_length() - 1
    table.rings = rings
    return table


# ---- building --------------------------------------------------------------------------------------------------------
@wp.func
def is_somewhere(place: wp.vec2) -> bool:
    """Whether a place is finite and not absurdly far away."""
    return wp.abs(place[0]) < HORIZON and wp.abs(place[1]) < HORIZON


def empty_cells(table: CellTable) -> None:
    """Forget everybody, before agents are entered anew; can be captured in a graph."""
    heads: wp.array = table.heads  # type: ignore[assignment]
    heads.fill_(-1)


@wp.func
def cell_entry(column: int, row: int, table: CellTable) -> int:
    """The entry of the table that a cell belongs to."""
    return ((row & table.mask) << table.shift) + (column & table.mask)


@wp.func
def enter_agent(agent: int, place: wp.vec2, table: CellTable):
    """Put an agent into the list of its cell; every agent once after `empty_cells`."""
    table.places[agent] = place
    table.nexts[agent] = NOBODY
    if is_somewhere(place):
        column = int(wp.floor(place[0] / table.cell_size))
        row = int(wp.floor(place[1] / table.cell_size))
        table.nexts[agent] = atomic_exchange(table.heads, cell_entry(column, row, table), agent)


# ---- searching -------------------------------------------------------------------------------------------------------
@wp.func
def nearest_neighbours(
    agent: int,
    visibility: float,
    table: CellTable,
    # out
    indices_out: wp.array2d[wp.int32],
    distances_out: wp.array2d[wp.float32],
) -> int:
    """Find the nearest others, as many as the rows of `indices_out` hold.

    Args:
        agent: Who looks.
        visibility: Others farther away than this are not seen [m]; at most the `reach` of the table.
        table: The hash grid.
        indices_out: Row `agent` gets their indices by (distance, index), shape [agents, cap].
        distances_out: Row `agent` gets their distances [m], shape [agents, cap].

    Returns:
        How many were found; what lies beyond them in the rows is left as it was.
    """
    place = table.places[agent]
    cap = indices_out.shape[1]
    found = wp.int32(0)
    if not is_somewhere(place):
        return found

    size = table.cell_size
    column = int(wp.floor(place[0] / size))
    row = int(wp.floor(place[1] / size))
    # From the agent to the nearest edge of its own cell; rounded down, for the cells were found in float32.
    inside = wp.vec2(place[0] - float(column) * size, place[1] - float(row) * size)
    edge = wp.min(wp.min(inside[0], size - inside[0]), wp.min(inside[1], size - inside[1]))
    slack = 1.0e-5 * (wp.abs(place[0]) + wp.abs(place[1]) + size)

    visible_sq = visibility * visibility
    ring = wp.int32(0)
    searching = wp.bool(True)
    while searching:
        for dy in range(-ring, ring + 1):
            # The top and bottom of a ring are whole rows of cells, between them are only its two ends.
            stride = wp.int32(1)
            if wp.abs(dy) != ring:
                stride = 2 * ring
            dx = -ring
            while dx <= ring:
                other = table.heads[cell_entry(column + dx, row + dy, table)]
                while other != NOBODY:
                    if other != agent:
                        gap = table.places[other] - place
                        distance_sq = wp.dot(gap, gap)
                        if distance_sq <= visible_sq:
                            found = insert_neighbour(agent, other, distance_sq, found, cap, indices_out, distances_out)
                    other = table.nexts[other]
                dx += stride
        covered = wp.max(float(ring) * size + edge - slack, 0.0)
        if found == cap and distances_out[agent, cap - 1] <= covered * covered:
            searching = False
        if ring >= table.rings or covered >= visibility:
            searching = False
        ring += 1

    for k in range(found):
        distances_out[agent, k] = wp.sqrt(distances_out[agent, k])
    return found


@wp.func
def insert_neighbour(
    agent: int,
    other: int,
    distance_sq: float,
    found: int,
    cap: int,
    # out
    indices_out: wp.array2d[wp.int32],
    distances_out: wp.array2d[wp.float32],
) -> int:
    """Insert into a row sorted by (squared distance, index) that holds `found` of at most `cap`; gives the new one."""
    place = found
    if found == cap:
        last = distances_out[agent, cap - 1]
        if distance_sq > last or (distance_sq == last and other > indices_out[agent, cap - 1]):
            return found
        place = cap - 1
    moving = wp.bool(True)
    while place > 0 and moving:
        before = distances_out[agent, place - 1]
        if distance_sq < before or (distance_sq == before and other < indices_out[agent, place - 1]):
            distances_out[agent, place] = before
            indices_out[agent, place] = indices_out[agent, place - 1]
            place -= 1
        else:
            moving = False
    distances_out[agent, place] = distance_sq
    indices_out[agent, place] = other
    return wp.min(found + 1, cap)
