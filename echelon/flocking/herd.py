"""A herd: what its members remember, and the launches that a frame takes. What they want is in `herding`."""

# pyright: reportGeneralTypeIssues=false
# Warp turns the structs that stand in annotations here into objects of its own.

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp

from echelon.flocking.commanded import command_constant, command_random
from echelon.flocking.herding import (
    BLOCK,
    HerdMind,
    HerdRules,
    Seen,
    enter_herd,
    find_farthest,
    look_round,
    make_up_mind,
    want,
)
from echelon.flocking.marching import follow_march, march_of
from echelon.flocking.perception import pen_of
from echelon.scenario import HerdSettings, WorldSettings
from echelon.terrain.walls import wall_grid
from echelon.warp_kernels.neighbours import CellTable, cell_table, empty_cells
from echelon.warp_kernels.replay import Phase, Share, launch_all, side_by_side, slices

CELL_PER_SPACING = 0.7  # size of the grid's cells: a settled herd stands at about 0.7 of the desired separation
RADIUS_PER_SPACING = 0.5  # radius of a herd of n, over spacing times the square root of n, with some room
ABSENT = (math.inf, math.inf, 0.0, 0.0)  # the place and velocity of a user who is not there

SEEING_MODES = ("herd", "march")
"""Modes in which what an agent wants depends on its neighbours."""

_COPIED = (
    *("spacing", "visibility", "gain", "max_speed", "max_change", "flee_distance", "flee_gain", "wander_gain"),
    *("wander_arrive", "wall_distance", "wall_gain", "radius", "clearance", "clearance_gain", "lookahead"),
)


@dataclass(frozen=True)
class HerdArrays:
    """What a herd remembers from frame to frame, and what it finds out in each.

    Attributes:
        mind: What it knows and wants as a whole.
        table: Everybody's place, and the hash grid to find them by.
        seen: The neighbours of each.
        sums: Sums of places and counts of members, shape [blocks].
        farthest: Place of the member farthest from the centroid, and its distance [m], shape [blocks].
        commanded: Desired velocity in the mode "random" [m/s], shape [agents].
        intended: What each wants in this frame [m/s], shape [agents].
        known: What each wanted in the frame before, which the others go by [m/s], shape [agents].
    """

    mind: HerdMind
    table: CellTable
    seen: Seen
    sums: wp.array[wp.vec3]
    farthest: wp.array[wp.vec3]
    commanded: wp.array[wp.vec2]
    intended: wp.array[wp.vec2]
    known: wp.array[wp.vec2]


class Herd:
    """The desired velocities of a crowd, one herd.

    Attributes:
        arrays: What it remembers and finds out; a collie and the referees of `group` read it.
        agent_count: How many they are.
        pen: The corral, as kernels see it.
        rules: The settings, as kernels see them.
    """

    by_agent = ("commanded", "intended")
    """Arrays of `state` with a row for each agent."""

    def __init__(
        self,
        settings: HerdSettings,
        world: WorldSettings,
        agent_count: int,
        *,
        frame_rate: int,
        seed: int,
        user: wp.array[wp.vec4] | None = None,
        device: wp.DeviceLike = None,
    ) -> None:
        """Make a herd that has not seen anything yet.

        Args:
            settings: What each member wants.
            world: Where they are.
            agent_count: How many they are.
            frame_rate: Frames a second.
            seed: Of the random goals and velocity changes.
            user: Place and velocity (x, y [m], vx, vy [m/s]) of whom they flee from, shape [1]; None for nobody.
            device: Where the arrays live.
        """
        self.agent_count = agent_count
        self.pen = pen_of(world)
        self.rules = herd_rules(settings, world, agent_count)
        self.arrays = _herd_arrays(settings, agent_count, device)
        self._settings = settings
        self._device = device
        self._seed = seed
        self._period = max(1, round(settings.period * frame_rate))
        self._user = wp.array([ABSENT], dtype=wp.vec4, device=device) if user is None else user
        reach = settings.wall_distance + settings.max_speed / settings.wall_gain if settings.wall_gain > 0.0 else 0.0
        self._walls = wall_grid(world, reach, device)
        self._march = march_of(settings, world, self._walls, frame_rate, device)

    def enqueue(
        self,
        frame: wp.array[wp.int32],
        positions: wp.array[wp.vec3],
        velocities: wp.array[wp.vec3],
        fallen: wp.array[wp.int32],
        desired_out: wp.array[wp.vec2],
    ) -> None:
        """Launch what a frame takes, one thing after another; can be captured in a graph.

        Args:
            frame: Number of the frame, shape [1].
            positions: World positions [m], shape [agents].
            velocities: World velocities [m/s], shape [agents].
            fallen: 1 for those who have fallen, shape [agents].
            desired_out: Gets the desired velocities [m/s], shape [agents].
        """
        share = Share.whole(self.agent_count)
        for phase in [*self.look(positions, fallen, share), self.see(fallen, share)]:
            launch_all(phase)
        for phase in self.want(frame, velocities, fallen, desired_out, share):
            launch_all(phase)

    def enqueue_look(self, positions: wp.array[wp.vec3], fallen: wp.array[wp.int32]) -> None:
        """Launch only the first part of a frame: everybody's place, and the hash grid; arguments as for `enqueue`."""
        for phase in self.look(positions, fallen, Share.whole(self.agent_count)):
            launch_all(phase)

    def look(self, positions: wp.array[wp.vec3], fallen: wp.array[wp.int32], share: Share) -> list[Phase]:
        """The phases of the first part of a frame: everybody's place, and the hash grid; arguments as for `enqueue`."""
        a = self.arrays

        def enter(first: int, count: int) -> None:
            inputs = [first, positions, fallen, a.intended]
            wp.launch(enter_herd, count, inputs=inputs, outputs=[a.table, a.known, a.sums], device=self._device)

        return [[partial(empty_cells, a.table)], share.everybody(enter, BLOCK)]

    def see(self, fallen: wp.array[wp.int32], share: Share) -> Phase:
        """The phase that follows `look`: the neighbours of each; arguments as for `enqueue`."""
        a = self.arrays

        def look_round_slice(first: int, count: int) -> None:
            inputs = [first, self._settings.visibility, fallen, a.table]
            wp.launch(look_round, count, inputs=inputs, outputs=[a.seen], device=self._device)

        return share.own(look_round_slice) if self._settings.mode in SEEING_MODES else []

    def want(
        self,
        frame: wp.array[wp.int32],
        velocities: wp.array[wp.vec3],
        fallen: wp.array[wp.int32],
        desired_out: wp.array[wp.vec2],
        share: Share,
    ) -> list[Phase]:
        """The phases that follow `see`: the herd's mind, and what each wants; arguments as for `enqueue`."""
        a, rules, device, settings = self.arrays, self.rules, self._device, self._settings

        def mind() -> None:
            inputs = [rules, self.pen, self._seed, a.sums, self._user]
            wp.launch(make_up_mind, dim=1, inputs=inputs, outputs=[a.mind], device=device)

        def constant(first: int, count: int) -> None:
            inputs = [first, wp.vec2(*settings.desired_velocity)]
            wp.launch(command_constant, count, inputs=inputs, outputs=[desired_out], device=device)

        def random(first: int, count: int) -> None:
            inputs = [first, frame, self._period, self._seed, settings.change, settings.max_speed, a.commanded]
            wp.launch(command_random, count, inputs=inputs, outputs=[desired_out], device=device)

        def herding(first: int, count: int) -> None:
            inputs = [first, rules, self.pen, self._walls, velocities, a.known, fallen, self._user, a.table, a.mind]
            outputs = [a.seen, a.intended, desired_out]
            wp.launch(want, count, inputs=inputs, outputs=outputs, device=device)

        def march(first: int, count: int) -> None:
            inputs = [first, self._march, frame, velocities, a.known, fallen, a.table]
            outputs = [a.seen, a.intended, desired_out]
            wp.launch(follow_march, count, inputs=inputs, outputs=outputs, device=device)

        def farthest(first: int, count: int) -> None:
            inputs = [first, fallen, a.table, a.mind]
            wp.launch(find_farthest, count, inputs=inputs, outputs=[a.farthest], device=device)

        if settings.mode == "constant":
            return [[mind], share.own(constant)]
        if settings.mode == "random":
            return [[mind], share.own(random)]
        if settings.mode == "march":
            return [[mind], share.own(march)]
        blocks = [partial(farthest, *part) for part in slices(len(a.farthest), share.team.size)]
        return [[mind], side_by_side(share.own(herding), blocks)]

    def state(self) -> dict[str, np.ndarray]:
        """What the next frame depends on besides its arguments; copies."""
        mind = self.arrays.mind
        return {
            "centroid": mind.centroid.numpy().copy(),
            "goal": mind.goal.numpy().copy(),
            "goal_count": mind.goal_count.numpy().copy(),
            "commanded": self.arrays.commanded.numpy().copy(),
            "intended": self.arrays.intended.numpy().copy(),
        }

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from what `state` gave."""
        mind = self.arrays.mind
        mind.centroid.assign(state["centroid"])
        mind.goal.assign(state["goal"])
        mind.goal_count.assign(state["goal_count"])
        self.arrays.commanded.assign(state["commanded"])
        self.arrays.intended.assign(state["intended"])


def herd_radius(settings: HerdSettings, agent_count: int) -> float:
    """About the radius that a herd of this size needs [m]."""
    return RADIUS_PER_SPACING * settings.spacing * math.sqrt(agent_count)


def herd_rules(settings: HerdSettings, world: WorldSettings, agent_count: int) -> HerdRules:
    """The rules of a herd of this size in this world."""
    rules = HerdRules()
    for name in _COPIED:
        setattr(rules, name, getattr(settings, name))
    rules.wander = int(settings.wander)
    radius = herd_radius(settings, agent_count)
    rules.stray_distance = settings.visibility + 0.5 * radius
    # So far from the fence that the whole herd has room, but always on the field.
    rules.goal_clearance = min(radius + settings.wall_distance, 0.5 * min(world.half_width, world.half_length))
    rules.goal_half_length = world.half_length - rules.goal_clearance
    rules.goal_radius = min(world.half_width, world.half_length) - rules.goal_clearance
    return rules


def _herd_arrays(settings: HerdSettings, agent_count: int, device: wp.DeviceLike) -> HerdArrays:
    mind = HerdMind()
    mind.centroid = wp.zeros(1, dtype=wp.vec2, device=device)
    mind.member_count = wp.zeros(1, dtype=wp.int32, device=device)
    mind.fleeing = wp.zeros(1, dtype=wp.int32, device=device)
    mind.goal = wp.zeros(1, dtype=wp.vec2, device=device)
    mind.goal_count = wp.zeros(1, dtype=wp.int32, device=device)
    mind.velocity = wp.zeros(1, dtype=wp.vec2, device=device)
    blocks = math.ceil(agent_count / BLOCK)
    rows = (agent_count, min(settings.neighbours, max(1, agent_count - 1)))
    seen = Seen()
    seen.found = wp.zeros(agent_count, dtype=wp.int32, device=device)
    seen.indices = wp.zeros(rows, dtype=wp.int32, device=device)
    seen.distances = wp.zeros(rows, dtype=wp.float32, device=device)
    seen.towards = wp.zeros(rows, dtype=wp.vec2, device=device)
    seen.fastest = wp.zeros(rows, dtype=wp.float32, device=device)
    return HerdArrays(
        mind=mind,
        table=cell_table(agent_count, CELL_PER_SPACING * settings.spacing, settings.visibility, device),
        seen=seen,
        sums=wp.zeros(blocks, dtype=wp.vec3, device=device),
        farthest=wp.zeros(blocks, dtype=wp.vec3, device=device),
        commanded=wp.zeros(agent_count, dtype=wp.vec2, device=device),
        intended=wp.zeros(agent_count, dtype=wp.vec2, device=device),
        known=wp.zeros(agent_count, dtype=wp.vec2, device=device),
    )
