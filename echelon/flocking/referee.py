"""The referee: who is in the corral, who has come in or gone out, and who has run into whom.

Two whose discs overlap have collided; that is reported once, when they begin to, by the one of lower index. To know
when, the referee remembers everybody's place of the frame before. Totals are whole numbers, so that they are the same
in whatever order they are added up.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import warp as wp

from echelon.flocking.perception import Pen, is_inside, pen_of
from echelon.scenario import HerdSettings, WorldSettings
from echelon.warp_kernels.atomics import atomic_increase
from echelon.warp_kernels.neighbours import NOBODY, CellTable, cell_entry, is_somewhere
from echelon.warp_kernels.replay import Phase, Share, launch_all

wp.set_module_options({"enable_backward": False})

PARTNER_LIMIT = 4
"""Of how many collisions that one begins in one frame the partners are named; all are counted."""

NEVER = wp.constant(-(2**31))  # the number of a frame that is none; a run-up before frame 0 has negative numbers

TOTALS = ("inside", "penned_frames", "gates", "collisions")
INSIDE = wp.constant(0)  # how many are in the corral
PENNED_FRAMES = wp.constant(1)  # for how many frames on end enough have been
GATES = wp.constant(2)  # how often someone has come in or gone out
COLLISIONS = wp.constant(3)  # how many collisions have begun


@wp.kernel
def begin_count(
    # out
    totals: wp.array[wp.int32],
):
    totals[INSIDE] = 0


@wp.func
def overlap(a: wp.vec2, b: wp.vec2, least: float) -> bool:
    """Whether two places are nearer than `least` [m]; never where one is not a number."""
    gap = a - b
    return wp.dot(gap, gap) < least * least


@wp.kernel
def count_agent(
    first: int,
    own: wp.vec2i,
    # model
    pen: Pen,
    least: float,
    # state in
    frame_in: wp.array[wp.int32],
    last_frame_in: wp.array[wp.int32],
    table: CellTable,
    previous_in: wp.array[wp.vec2],
    # state in and out
    inside: wp.array[wp.int32],
    totals: wp.array[wp.int32],
    # out
    gates_out: wp.array[wp.int32],
    collisions_out: wp.array[wp.int32],
    partners_out: wp.array2d[wp.int32],
    collision_count_out: wp.array[wp.int32],
):
    """Look at one agent: is it inside, has it passed the gate, which collisions with a higher index has it begun?

    The last is looked for only for agents from `own[0]` to before `own[1]`.
    """
    agent = first + wp.tid()
    place = table.places[agent]
    is_in = wp.where(is_inside(place, pen), 1, 0)
    if is_in == 1:
        atomic_increase(totals, INSIDE, 1)
    gates_out[agent] = 0
    # Who is nowhere any more has not gone through the gate.
    if last_frame_in[0] != NEVER and is_in != inside[agent] and is_somewhere(place):
        gates_out[agent] = is_in - inside[agent]
        atomic_increase(totals, GATES, 1)
    inside[agent] = is_in

    begun = wp.int32(0)
    if agent >= own[0] and agent < own[1] and is_somewhere(place) and frame_in[0] != last_frame_in[0]:
        columns = wp.vec2i(
            int(wp.floor((place[0] - least) / table.cell_size)), int(wp.floor((place[0] + least) / table.cell_size))
        )
        rows = wp.vec2i(
            int(wp.floor((place[1] - least) / table.cell_size)), int(wp.floor((place[1] + least) / table.cell_size))
        )
        for row in range(rows[0], rows[1] + 1):
            for column in range(columns[0], columns[1] + 1):
                other = table.heads[cell_entry(column, row, table)]
                while other != NOBODY:
                    now = other > agent and overlap(place, table.places[other], least)
                    if now and not overlap(previous_in[agent], previous_in[other], least):
                        enter_partner(agent, other, begun, partners_out)
                        begun += 1
                    other = table.nexts[other]
    collisions_out[agent] = begun
    if begun > 0:
        collision_count_out[agent] = collision_count_out[agent] + begun
        atomic_increase(totals, COLLISIONS, begun)


@wp.func
def enter_partner(agent: int, other: int, begun: int, partners_out: wp.array2d[wp.int32]):
    """Keep the row of partners sorted by index; of more than it holds, the lowest."""
    slot = wp.min(begun, partners_out.shape[1])
    moving = wp.bool(True)
    while moving and slot > 0:
        if partners_out[agent, slot - 1] > other:
            if slot < partners_out.shape[1]:
                partners_out[agent, slot] = partners_out[agent, slot - 1]
            slot -= 1
        else:
            moving = wp.bool(False)
    if slot < partners_out.shape[1]:
        partners_out[agent, slot] = other


@wp.kernel
def end_count(
    # model
    enough: int,
    # state in
    frame_in: wp.array[wp.int32],
    table: CellTable,
    # state in and out
    last_frame: wp.array[wp.int32],
    totals: wp.array[wp.int32],
    # out
    previous_out: wp.array[wp.vec2],
):
    """Remember everybody's place; the first thread counts the frames for which enough have been inside."""
    agent = wp.tid()
    previous_out[agent] = table.places[agent]
    if agent == 0 and frame_in[0] != last_frame[0]:
        last_frame[0] = frame_in[0]
        totals[PENNED_FRAMES] = wp.where(totals[INSIDE] >= enough, totals[PENNED_FRAMES] + 1, 0)


@dataclass(frozen=True)
class RefereeArrays:
    """What the referee has seen, of the frame that was looked at last.

    Attributes:
        totals: See `TOTALS`: the first two are of this frame, the others of all frames so far, shape [4].
        inside: 1 for those in the corral, shape [agents].
        gates: 1 for those who have come in since the frame before, -1 for those who have gone out, shape [agents].
        collisions: How many collisions with others of higher index have begun in this frame, shape [agents].
        partners: The indices of those others, as many as there are, ascending, shape [agents, PARTNER_LIMIT].
        collision_count: How many collisions of each with others of higher index have begun so far, shape [agents].
        previous: Places [m], shape [agents].
        last_frame: Number of the frame, shape [1].
    """

    totals: wp.array[wp.int32]
    inside: wp.array[wp.int32]
    gates: wp.array[wp.int32]
    collisions: wp.array[wp.int32]
    partners: wp.array2d[wp.int32]
    collision_count: wp.array[wp.int32]
    previous: wp.array[wp.vec2]
    last_frame: wp.array[wp.int32]


class Referee:
    """Counts a crowd in the corral, at its gate, and in collisions.

    Attributes:
        arrays: What it has seen.
    """

    by_agent = ("inside", "previous", "collision_count")
    """Arrays of `state` with a row for each agent."""

    def __init__(
        self, settings: HerdSettings, world: WorldSettings, agent_count: int, *, device: wp.DeviceLike = None
    ) -> None:
        """Begin with nothing seen.

        Args:
            settings: For the radius of a body.
            world: For the corral, and what part of the crowd counts as penned.
            agent_count: How many there are.
            device: Where the arrays live.
        """
        self._agent_count = agent_count
        self._device = device
        self._pen = pen_of(world)
        self._least = 2.0 * settings.radius
        fraction = 1.0 if world.corral is None else world.corral.penned_fraction
        self._enough = max(1, int(np.ceil(fraction * agent_count - 1e-9)))

        def whole(*shape: int) -> wp.array:
            return wp.zeros(shape, dtype=wp.int32, device=device)

        self.arrays = RefereeArrays(
            totals=whole(len(TOTALS)),
            inside=whole(agent_count),
            gates=whole(agent_count),
            collisions=whole(agent_count),
            partners=whole(agent_count, PARTNER_LIMIT),
            collision_count=whole(agent_count),
            previous=wp.full(agent_count, wp.vec2(np.inf, np.inf), dtype=wp.vec2, device=device),
            last_frame=wp.full(1, NEVER, dtype=wp.int32, device=device),
        )

    def enqueue(self, frame: wp.array[wp.int32], table: CellTable) -> None:
        """Launch a look at everybody; can be captured in a graph.

        Args:
            frame: Number of the frame, shape [1]; looking at the same frame twice counts nothing twice.
            table: Everybody's place, in the hash grid.
        """
        for phase in self.count(frame, table, Share.whole(self._agent_count)):
            launch_all(phase)

    def count(self, frame: wp.array[wp.int32], table: CellTable, share: Share) -> list[Phase]:
        """The phases of a look: before, at everybody, and after; arguments as for `enqueue`."""
        a, device = self.arrays, self._device
        own = wp.vec2i(share.first, share.first + share.count)

        def begin() -> None:
            wp.launch(begin_count, dim=1, outputs=[a.totals], device=device)

        def look(first: int, count: int) -> None:
            inputs = [first, own, self._pen, self._least, frame, a.last_frame, table, a.previous, a.inside, a.totals]
            outputs = [a.gates, a.collisions, a.partners, a.collision_count]
            wp.launch(count_agent, count, inputs=inputs, outputs=outputs, device=device)

        def end() -> None:
            inputs = [self._enough, frame, table, a.last_frame, a.totals]
            wp.launch(end_count, self._agent_count, inputs, [a.previous], device=device)

        return [[begin], share.everybody(look, least=1), [end]]

    def totals(self) -> dict[str, int]:
        """The totals by name; waits for the device."""
        return dict(zip(TOTALS, self.arrays.totals.numpy().tolist(), strict=True))

    def collisions(self) -> list[tuple[int, int]]:
        """Pairs that began to overlap in the frame looked at last, lower index first, sorted; waits for the device."""
        begun = np.minimum(self.arrays.collisions.numpy(), PARTNER_LIMIT)
        partners = self.arrays.partners.numpy()
        return [(int(a), int(b)) for a in np.flatnonzero(begun) for b in partners[a, : begun[a]]]

    def state(self) -> dict[str, np.ndarray]:
        """What the next frame depends on besides its arguments; copies."""
        counted = self.arrays.totals.numpy()[1:3].copy()
        return {name: array.numpy().copy() for name, array in self._persistent().items()} | {"counted": counted}

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from what `state` gave."""
        a = self.arrays
        for name, array in self._persistent().items():
            array.assign(state[name])
        inside, collisions = (int(array.numpy().sum()) for array in (a.inside, a.collision_count))
        penned_frames, gates = state["counted"].tolist()
        a.totals.assign(np.array([inside, penned_frames, gates, collisions], dtype=np.int32))

    def _persistent(self) -> dict[str, wp.array]:
        a = self.arrays
        agents = {"inside": a.inside, "previous": a.previous, "collision_count": a.collision_count}
        return agents | {"last_frame": a.last_frame}
