"""The frame kernel of a character on a kind of terrain: plain Warp around what was emitted.

A thread carries a *block* of as many agents as the target has lanes from one frame boundary to the next:

    rebase        the floating origin moves to where the root is, exactly, in float64
    look up       ground and walls beneath and beside each contact site become local planes
    tick x 8      scripts, control, then substeps with the state in registers
    check         an agent whose state is no longer finite goes back to where it was, and stays there
    observe       link poses, velocities, phase, flags and events, into the frame's slot of a chunk

Where the ground is rough, the sites that usually touch it (wheels, feet) have their planes looked up each tick, each
where it will be half a tick later. Whatever touches it rarely, and walls, are looked up once, where the root is.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false, reportInvalidTypeForm=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python. There is no
# `from __future__ import annotations`, since the kernel's types are variables of the function that makes it.

from functools import lru_cache
from typing import Any

import warp as wp

from echelon.warp_kernels.character import HELD, LOST, REMOVED, Character
from echelon.warp_kernels.emit import Target, cpu_compiler_flags
from echelon.warp_kernels.ghosts import CARRIED, FALLING, LYING, UNTOUCHABLE
from echelon.warp_kernels.meeting import GHOST_MOTION, GHOSTS, PAIR_MEMORY, Bumper
from echelon.warp_kernels.meeting_code import DUE_SIZE, absent_ghost
from echelon.warp_kernels.neighbours import NOBODY
from echelon.warp_kernels.program import POSE_SIZE, Integrator, Program
from echelon.warp_kernels.scripts import arrive_function

SURFACES = {"ground": 0, "wall": 1}


def type_of(data: Any) -> Any:
    """The Warp type to annotate a kernel argument with that takes this struct instance."""
    return data._cls


@lru_cache(maxsize=32)
def compiled_program(
    character: Character,
    step: float,
    tick: float,
    integrator: Integrator,
    target: Target,
    level: bool,
    bumper: Bumper | None = None,
) -> Program:
    """The program of a character, made once."""
    return Program(character, step, tick, integrator, target, level, bumper)


@lru_cache(maxsize=64)
def frame_kernel(program: Program, look_up: Any, terrain_type: Any, rough: bool) -> Any:
    """The frame kernel of one program on one kind of terrain."""
    lanes = program.target.lanes
    layout = program.layout
    body = program.character.body
    control, substeps, observe = program.control, program.substeps, program.observe
    begin, keep_finite, keep_poses = program.begin, program.keep_finite, program.keep_poses
    locate = program.locate
    site_count = len(body.contacts)
    measure_places = [layout.memory[name] for name in program.character.records]
    measure_count = len(measure_places)
    measure_at = wp.types.vector(length=max(measure_count, 1), dtype=wp.int32)(*(measure_places or [0]))
    # Which site's place, as `locate` gives them, a site's plane is looked up at; -1 for the root's.
    located_list = [
        program.located_sites.index(i) if rough and i in program.located_sites else -1 for i in range(site_count)
    ]
    located = wp.types.vector(length=max(site_count, 1), dtype=wp.int32)(*(located_list or [0]))
    surface_list = [SURFACES[site.surface] for site in body.contacts]
    surfaces = wp.types.vector(length=max(site_count, 1), dtype=wp.int32)(*(surface_list or [0]))
    at_root = {surface for surface, place in zip(surface_list, located_list, strict=True) if place < 0}
    ground_at_root, wall_at_root = SURFACES["ground"] in at_root, SURFACES["wall"] in at_root
    link_count = len(body.links)
    event_count = len(program.character.events)
    command_count = len(program.character.commands)
    free_root = body.links[0].joint.kind == "free"
    # The origin stays where it is for a body that is tied to the world, and takes other free roots along.
    floats = free_root and all(None not in (spring.link_a, spring.link_b) for spring in body.springs)
    later_roots = [layout.q + body.q_start(i) for i in range(1, link_count) if body.links[i].joint.kind == "free"]
    later_root_count = len(later_roots)
    later_root_places = wp.types.vector(length=max(later_root_count, 1), dtype=wp.int32)(*(later_roots or [0]))
    heights = [layout.memory[name] for name in getattr(program.character, "heights", ())]
    height_count = len(heights)
    height_places = wp.types.vector(length=max(height_count, 1), dtype=wp.int32)(*(heights or [0]))
    phase_at, fallen_at, loaded_at = (layout.memory[name] for name in ("phase", "fallen", "loaded"))
    frozen_at = layout.frozen
    root_q = layout.q
    velocity_at = POSE_SIZE * link_count
    meets = program.bumper is not None
    if meets and not floats:
        raise ValueError(f"character {program.character.name!r} is tied to the world and cannot meet others")
    touch_at = layout.touch or 0
    absent = absent_ghost(program.bumper).tolist() if program.bumper is not None else [0.0]
    ghost_numbers = len(absent)
    pair_count = program.bumper.pair_count if program.bumper is not None else 1
    given_at = GHOST_MOTION - 3
    absent_numbers = wp.types.vector(length=ghost_numbers, dtype=wp.float32)(*absent)
    script = getattr(program.character, "script", None)
    scripted = script is not None
    arrive = arrive_function(layout, script) if script is not None else _no_script

    @wp.func
    def keep_plane(
        block: int,
        lane: int,
        site: int,
        plane: wp.vec4d,
        origin: wp.vec3d,
        planes_out: wp.array3d[wp.float32],
    ):
        """Keep a site's plane relative to the agent's origin."""
        offset = plane[3] - plane[0] * origin[0] - plane[1] * origin[1] - plane[2] * origin[2]
        planes_out[block, 4 * site, lane] = wp.float32(plane[0])
        planes_out[block, 4 * site + 1, lane] = wp.float32(plane[1])
        planes_out[block, 4 * site + 2, lane] = wp.float32(plane[2])
        planes_out[block, 4 * site + 3, lane] = wp.float32(offset)

    @wp.func
    def look_up_at_root(
        block: int,
        lane: int,
        terrain: terrain_type,
        state: wp.array3d[wp.float32],
        origins: wp.array2d[wp.float64],
        planes_out: wp.array3d[wp.float32],
    ):
        """Planes of the sites of one agent that take what is under and beside its root."""
        agent = block * lanes + lane
        origin = wp.vec3d(origins[agent, 0], origins[agent, 1], origins[agent, 2])
        point = origin
        if wp.static(free_root):
            point = origin + wp.vec3d(
                wp.float64(state[block, root_q, lane]),
                wp.float64(state[block, root_q + 1, lane]),
                wp.float64(state[block, root_q + 2, lane]),
            )
        ground = wp.vec4d()
        wall = wp.vec4d()
        if wp.static(ground_at_root):
            ground = look_up(0, point, terrain)
        if wp.static(wall_at_root):
            wall = look_up(1, point, terrain)
        for site in range(site_count):
            if located[site] < 0:
                if surfaces[site] == 0:
                    keep_plane(block, lane, site, ground, origin, planes_out)
                else:
                    keep_plane(block, lane, site, wall, origin, planes_out)

    @wp.func
    def look_up_at_sites(
        block: int,
        lane: int,
        terrain: terrain_type,
        origins: wp.array2d[wp.float64],
        places: wp.array3d[wp.float32],
        planes_out: wp.array3d[wp.float32],
    ):
        """Planes of the sites of one agent whose ground is looked up where they stand."""
        agent = block * lanes + lane
        origin = wp.vec3d(origins[agent, 0], origins[agent, 1], origins[agent, 2])
        for site in range(site_count):
            place = located[site]
            if place >= 0:
                point = origin + wp.vec3d(
                    wp.float64(places[block, 3 * place, lane]),
                    wp.float64(places[block, 3 * place + 1, lane]),
                    wp.float64(places[block, 3 * place + 2, lane]),
                )
                keep_plane(block, lane, site, look_up(0, point, terrain), origin, planes_out)

    @wp.func
    def most_ghosts(block: int, ghost_counts: wp.array[wp.int32], ghosts: wp.array3d[wp.float32]) -> int:
        """The most ghosts that a lane of this block has; the other lanes get as many, far away."""
        most = wp.int32(0)
        for lane in range(lanes):
            most = wp.max(most, ghost_counts[block * lanes + lane])
        if most > 0:
            for lane in range(lanes):
                for ghost in range(ghost_counts[block * lanes + lane], most):
                    for part in range(ghost_numbers):
                        ghosts[block, DUE_SIZE + ghost * ghost_numbers + part, lane] = absent_numbers[part]
        return most

    @wp.func
    def close_accounts(
        block: int,
        lane: int,
        first_agent: int,
        ghost_counts: wp.array[wp.int32],
        ghost_indices: wp.array2d[wp.int32],
        ghosts: wp.array3d[wp.float32],
        partners_out: wp.array2d[wp.int32],
        given_out: wp.array2d[wp.vec3],
        pressed_out: wp.array2d[wp.float32],
    ):
        """Write down whom an agent met, what it gave them, and how far the springs between them are pressed."""
        agent = block * lanes + lane
        own = first_agent + agent
        if ghost_counts[agent] == 0 and partners_out[own, 0] == NOBODY:
            return
        for ghost in range(GHOSTS):
            if ghost < ghost_counts[agent]:
                at = DUE_SIZE + ghost * ghost_numbers
                partners_out[own, ghost] = ghost_indices[agent, ghost]
                given_out[own, ghost] = wp.vec3(
                    ghosts[block, at + given_at, lane],
                    ghosts[block, at + given_at + 1, lane],
                    ghosts[block, at + given_at + 2, lane],
                )
                for pair in range(pair_count):
                    pressed = ghosts[block, at + GHOST_MOTION + PAIR_MEMORY * pair + 2, lane]
                    pressed_out[agent, ghost * pair_count + pair] = pressed
            else:
                partners_out[own, ghost] = NOBODY

    @wp.kernel(module="unique", module_options=_module_options(program), enable_backward=False)
    def advance_frame(
        first_block: int,
        agent_count: int,
        first_agent: int,
        tick: int,
        clock: wp.array[int],
        # where
        terrain: terrain_type,
        event_places: wp.array[int],
        # who
        parameters: wp.array3d[wp.float32],
        command: wp.array2d[wp.float32],
        scripts: wp.array2d[wp.float32],
        # whom they meet
        law: wp.array[wp.float32],
        ghost_counts: wp.array[wp.int32],
        ghost_indices: wp.array2d[wp.int32],
        # state
        state: wp.array3d[wp.float32],
        origins: wp.array2d[wp.float64],
        command_lanes: wp.array3d[wp.float32],
        backup: wp.array3d[wp.float32],
        places: wp.array3d[wp.float32],
        planes: wp.array3d[wp.float32],
        seen: wp.array3d[wp.float32],
        ghosts: wp.array3d[wp.float32],
        # out: what others see
        positions_out: wp.array[wp.vec3],
        velocities_out: wp.array[wp.vec3],
        fallen_out: wp.array[wp.int32],
        places_out: wp.array[wp.vec3d],
        attitudes_out: wp.array[wp.quat],
        spins_out: wp.array[wp.vec3],
        bearings_out: wp.array[wp.int32],
        partners_out: wp.array2d[wp.int32],
        given_out: wp.array2d[wp.vec3],
        pressed_out: wp.array2d[wp.float32],
        # out: the recording
        poses_out: wp.array4d[wp.float32],
        origins_out: wp.array3d[wp.float64],
        chunk_velocities_out: wp.array3d[wp.float32],
        chunk_desired_out: wp.array3d[wp.float32],
        measures_out: wp.array3d[wp.float32],
        phases_out: wp.array2d[wp.int8],
        contacts_out: wp.array2d[wp.uint8],
        chunk_fallen_out: wp.array2d[wp.uint8],
        frozen_out: wp.array2d[wp.uint8],
        events_out: wp.array3d[wp.int16],
        touches_out: wp.array2d[wp.int16],
    ):
        block = first_block + wp.tid()
        slot = clock[0]
        tick_count = clock[1]
        for lane in range(lanes):
            agent = block * lanes + lane
            if wp.static(floats):
                for axis in range(3):
                    shift = state[block, root_q + axis, lane]
                    # What is not finite stays in the state, where it will be noticed.
                    if wp.isfinite(shift):
                        origins[agent, axis] = origins[agent, axis] + wp.float64(shift)
                        state[block, root_q + axis, lane] = wp.float32(0.0)
                        for root in range(later_root_count):
                            place = later_root_places[root] + axis
                            state[block, place, lane] = state[block, place, lane] - shift
                        if axis == 2:
                            for remembered in range(height_count):
                                place = height_places[remembered]
                                state[block, place, lane] = state[block, place, lane] - shift
            for part in range(command_count):
                command_lanes[block, part, lane] = command[first_agent + wp.min(agent, agent_count - 1), part]
        begin(state, backup, block)
        for lane in range(lanes):
            look_up_at_root(block, lane, terrain, state, origins, planes)
        meeting = wp.int32(0)
        if wp.static(meets):
            meeting = most_ghosts(block, ghost_counts, ghosts)

        for _ in range(tick_count):
            if wp.static(rough):
                locate(state, places, block)
                for lane in range(lanes):
                    look_up_at_sites(block, lane, terrain, origins, places, planes)
            if wp.static(scripted):
                for lane in range(lanes):
                    arrive(block, lane, state, scripts)
            control(state, parameters, command_lanes, block)
            substeps(state, parameters, command_lanes, planes, ghosts, law, block, meeting, tick)

        # Whatever is not finite, or was frozen before, stays where it was at the start of the frame.
        keep_finite(state, backup, block)
        observe(state, seen, block)
        keep_poses(seen, poses_out, block, slot, agent_count)
        for lane in range(lanes):
            agent = block * lanes + lane
            if agent < agent_count:
                for axis in range(3):
                    origins_out[slot, agent, axis] = origins[agent, axis]
                    chunk_velocities_out[slot, agent, axis] = seen[block, velocity_at + axis, lane]
                for measure in range(measure_count):
                    measured = state[block, measure_at[measure], lane]
                    measures_out[slot, agent, measure] = wp.where(wp.isfinite(measured), measured, wp.float32(0.0))
                phases_out[slot, agent] = wp.int8(state[block, phase_at, lane])
                for part in range(command_count):
                    chunk_desired_out[slot, agent, part] = command_lanes[block, part, lane]
                contacts_out[slot, agent] = wp.uint8(wp.where(state[block, loaded_at, lane] > 0.5, 1, 0))
                flag = state[block, frozen_at, lane]
                lost = wp.where(flag == LOST, 1, 0)
                down = wp.where(state[block, fallen_at, lane] > 0.5, 1, 0)
                chunk_fallen_out[slot, agent] = wp.uint8(down)
                frozen_out[slot, agent] = wp.uint8(lost)
                fallen_out[first_agent + agent] = wp.where(flag == HELD, 2, wp.max(down, lost))
                for event in range(event_count):
                    events_out[slot, agent, event] = wp.int16(state[block, event_places[event], lane])
                positions_out[first_agent + agent] = wp.vec3(
                    wp.float32(origins[agent, 0] + wp.float64(seen[block, 0, lane])),
                    wp.float32(origins[agent, 1] + wp.float64(seen[block, 1, lane])),
                    wp.float32(origins[agent, 2] + wp.float64(seen[block, 2, lane])),
                )
                velocities_out[first_agent + agent] = wp.vec3(
                    seen[block, velocity_at, lane],
                    seen[block, velocity_at + 1, lane],
                    seen[block, velocity_at + 2, lane],
                )
                if wp.static(meets):
                    # Only the first touch after a frame without one is something that happens.
                    touched = state[block, touch_at, lane]
                    first_touch = wp.where(state[block, touch_at + 1, lane] < 0.0, touched, -1.0)
                    touches_out[slot, agent] = wp.int16(first_touch)
                    if tick_count > 0:
                        close_accounts(
                            block,
                            lane,
                            first_agent,
                            ghost_counts,
                            ghost_indices,
                            ghosts,
                            partners_out,
                            given_out,
                            pressed_out,
                        )
                    places_out[first_agent + agent] = wp.vec3d(
                        origins[agent, 0] + wp.float64(seen[block, 0, lane]),
                        origins[agent, 1] + wp.float64(seen[block, 1, lane]),
                        origins[agent, 2] + wp.float64(seen[block, 2, lane]),
                    )
                    attitudes_out[first_agent + agent] = wp.quat(
                        seen[block, 3, lane], seen[block, 4, lane], seen[block, 5, lane], seen[block, 6, lane]
                    )
                    spins_out[first_agent + agent] = wp.vec3(
                        seen[block, velocity_at + 3, lane],
                        seen[block, velocity_at + 4, lane],
                        seen[block, velocity_at + 5, lane],
                    )
                    bearing = wp.where(state[block, loaded_at, lane] > 0.5, CARRIED, FALLING)
                    bearing = wp.where(flag == HELD, CARRIED, wp.where(down == 1, LYING, bearing))
                    bearings_out[first_agent + agent] = bearing
                    if flag == LOST or flag == REMOVED:  # noqa: SIM109
                        bearings_out[first_agent + agent] = UNTOUCHABLE
                if wp.where(flag == REMOVED, 1, lost) == 1:
                    # It does not move any more, and its speeds may be what is not finite.
                    velocities_out[first_agent + agent] = wp.vec3(0.0, 0.0, 0.0)
                    for axis in range(3):
                        chunk_velocities_out[slot, agent, axis] = wp.float32(0.0)
                if flag == REMOVED:
                    positions_out[first_agent + agent] = wp.vec3(wp.inf, wp.inf, wp.inf)

    return advance_frame


@wp.func
def _no_script(block: int, lane: int, state: wp.array3d[wp.float32], scripts: wp.array2d[wp.float32]):
    """Nothing: what a kernel names for characters without scripts, and never calls."""


def _module_options(program: Program) -> dict[str, Any]:
    # Unrolling the loops over lanes would only make more to compile. Multiply-adds stand in the code (see `emit`),
    # and the compilers, CUDA's too, are to make no others.
    options: dict[str, Any] = {"enable_backward": False, "max_unroll": 1, "fuse_fp": False}
    if not program.target.cuda:
        options["cpu_compiler_flags"] = cpu_compiler_flags(program.target.lanes)
    return options
