"""The group layer of a ride: riders on a road, the user, obstacles, and the referee, in one go a frame.

    locate, see    where everybody is along the road, and whom each sees
    group, decide  the speed and offset that each wants: the papers' grouping, and tactics
    choose         the offset at which each can ride
    draft          how much air the others spare each
    command        where to steer and how fast, clear of others, of obstacles and of the road's edge
    judge          who has come how far, who has left the road or touched somebody, in this frame
    user           rides on to the next frame, as everybody else is about to

What a rider reads of another is where that one is and what its plan was a frame before, both of which `locate` finds;
so all that follows is done rider by rider, in slices over threads (`echelon.warp_kernels.replay`).
"""

# pyright: reportGeneralTypeIssues=false
# Warp turns the structs that stand in annotations here into objects of its own.

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from echelon.flocking import (
    bicycle,
    clearance,
    drafting,
    grouping,
    overtaking,
    person,
    road_following,
    road_obstacles,
    road_referee,
    road_riders,
    road_user,
    tactics,
)
from echelon.flocking.corner_speeds import corner_speeds
from echelon.flocking.road_referee import RoadReferee
from echelon.flocking.road_riders import RIDING, UNFINISHED, RidersSeen, RoadRiders, RoadRules
from echelon.flocking.road_user import RoadUser
from echelon.flocking.start_grid import StartGrid, riding_edge, start_grid
from echelon.scenario.road import ObstacleSettings, PelotonSettings, UserSettings
from echelon.terrain.spline import Centreline
from echelon.warp_kernels import neighbours
from echelon.warp_kernels.neighbours import cell_table, empty_cells
from echelon.warp_kernels.replay import Phase, Replay, Share, launch_all, side_by_side

RUN_OUT = 40.0
"""On an open road the finish is so far before its end, so that there is some road left to slow down on [m]."""

CELLS_PER_SIGHT = 4  # of the grid that neighbours are found in, along the visibility: whoever sees few looks at all
LONG_AGO = -(2**30)  # the frame in which the first target was chosen

_COPIED = (
    *("distance_gain", "velocity_gain", "grouping_limit", "gathering", "visibility", "sight", "pursuit_distance"),
    *(
        "pursuit_time",
        "lookahead",
        "braking",
        "eagerness",
        "slowest",
        "side_clearance",
        "obstacle_clearance",
        "gap",
        "headway",
    ),
    *("sideways_speed", "body_length", "body_behind", "body_half_width", "wheelbase"),
)
_REMEMBERED = ("s", "laps", "heading", "target", "keeping", "chosen", "lane", "lane_rate", "command_speed")


class Peloton:
    """What riders on a road want, and how they fare.

    Attributes:
        grid: Where everybody starts, the user last if there is one.
        riders: What is known of each, the user last.
        user: The user's bicycle, if there is a user.
        obstacles: What is in the way.
        tactics: What each is doing, by `echelon.flocking.tactics.TACTICS`.
        referee: Who counts.
        rules: The settings, as kernels see them.
        actors: Name and kind of those who are no riders but move: the user and the joggers.
        share: Which riders it is for, and on which threads; set it before the first step.
    """

    def __init__(
        self,
        settings: PelotonSettings,
        path: Centreline,
        half_width: float,
        count: int,
        *,
        frame_rate: int,
        seed: int,
        population_seed: int | None = None,
        obstacles: Sequence[ObstacleSettings] = (),
        user: UserSettings | None = None,
        laps: int = 1,
        device: wp.DeviceLike = None,
    ) -> None:
        """Make the group layer of a ride; nothing has been seen yet, and the user is at its start.

        Args:
            settings: How they ride.
            path: Centreline of the road.
            half_width: Of the road [m].
            count: How many ride, the user aside.
            frame_rate: Frames a second.
            seed: Of what they decide at random.
            population_seed: Of how they differ; None takes `seed`.
            obstacles: What is in the way.
            user: Who rides with them, if anybody does.
            laps: How often a closed road is to be ridden round.
            device: Where everything lives.

        Raises:
            InputError: The road has no room for them, or for the obstacles.
        """
        self._settings, self._path, self._seed = settings, path, seed
        self._device = wp.get_device(device)
        riders = count + (user is not None)
        edge = riding_edge(settings, half_width)
        drawn = seed if population_seed is None else population_seed
        self.grid: StartGrid = start_grid(settings, path, half_width, count, seed=drawn, user=user)
        self.rules = _rules(settings, half_width, edge, frame_rate, count)
        self.riders = _riders(self.grid, path, device)
        self.obstacles = road_obstacles.road_obstacles(obstacles, settings, path, half_width, device)
        self.tactics = tactics.tactics_state(riders, device)
        self.referee = RoadReferee(riders, finish_distance(path, laps), device=device)
        self.user: RoadUser | None = None
        if user is not None:
            start = self.grid.positions[-1, :2].tolist()
            self.user = RoadUser(
                user,
                (start[0], start[1]),
                float(self.grid.headings[-1]),
                float(self.grid.speeds[-1]),
                frame_rate=frame_rate,
                device=device,
            )
        joggers = [k for k, obstacle in enumerate(obstacles) if obstacle.kind == "jogger"]
        names = [("user", "bicycle")] if user is not None else []
        names += [("jogger" if len(joggers) == 1 else f"jogger {n + 1}", "jogger") for n in range(len(joggers))]
        self.actors = tuple(names)

        self._joggers = joggers
        self._count, self._frame_rate = riders, frame_rate
        self._data = path.data(device)
        self._speeds = corner_speeds(settings, path, edge, device)
        self._table = cell_table(riders, settings.visibility / CELLS_PER_SIGHT, settings.visibility, device)
        self._seen = _seen(settings, riders, device)
        self._tactics_rules = None if settings.tactics is None else tactics.tactics_rules(settings.tactics)
        keys = user.keys if user is not None else ((0.0, 0.0, 0.0),)
        self._keys = wp.array(keys, dtype=wp.vec3, device=device)
        self._by_distance = int(user is not None and user.by == "distance")
        self._user_start = float(self.grid.s[-1]) if user is not None else 0.0
        self._frame = wp.zeros(1, dtype=wp.int32, device=device)
        self._nobody_fell = wp.zeros(count, dtype=wp.int32, device=device)
        self._nowhere = wp.zeros(1, dtype=wp.vec4, device=device)
        self._no_wish = wp.zeros(1, dtype=wp.float32, device=device)
        self.share = Share.whole(count, riders - count)
        modules = [neighbours, road_riders, grouping, overtaking, drafting, clearance, road_following, road_obstacles]
        self._replay = Replay([*modules, road_referee, road_user, tactics, bicycle, person], device)
        self.set_frame(-1)
        self._enqueue_obstacles()
        if self.user is not None:
            self.user.enqueue_place(self.rules, self._data, self.riders)

    def step(
        self,
        frame: int,
        positions: wp.array[wp.vec3],
        velocities: wp.array[wp.vec3],
        commands_out: wp.array2d[wp.float32],
        fallen: wp.array[wp.int32] | None = None,
        between: Callable[[], None] | None = None,
    ) -> None:
        """See and want in one frame, and take user and joggers to the next.

        The referee's counts are then those of this frame, `actor_poses` are those of the next.

        Args:
            frame: Number of the frame, from 0.
            positions: Of the rear wheels' contacts, in the world [m], shape [agents].
            velocities: Of the same [m/s], shape [agents].
            commands_out: Gets velocity x, y [m/s], distance of the aim [m] and shelter, shape [agents, 4].
            fallen: 1 for those who have fallen, shape [agents]; None where nobody has.
            between: Called when everything is seen and nothing wanted yet: for a stopwatch.
        """
        down = self._nobody_fell if fallen is None else fallen
        self.set_frame(frame)
        arrays: tuple[Any, ...] = (positions, velocities, down, commands_out)
        self._replay(arrays, partial(self.stages, *arrays), self.share.team, between)

    def enqueue(
        self,
        positions: wp.array[wp.vec3],
        velocities: wp.array[wp.vec3],
        fallen: wp.array[wp.int32],
        commands_out: wp.array2d[wp.float32],
    ) -> None:
        """Launch what `step` replays, after `set_frame`, for a capture of one's own; arguments as there."""
        for stage in self.stages(positions, velocities, fallen, commands_out):
            for phase in stage:
                launch_all(phase)

    def stages(
        self,
        positions: wp.array[wp.vec3],
        velocities: wp.array[wp.vec3],
        fallen: wp.array[wp.int32],
        commands_out: wp.array2d[wp.float32],
    ) -> tuple[list[Phase], list[Phase]]:
        """What a frame launches to see and to want, in slices for the threads of `share`; arguments as for `step`."""
        rules, path, riders, table = self.rules, self._data, self.riders, self._table
        seen, frame, share, device, rate = self._seen, self._frame, self.share, self._device, self._frame_rate
        user = self._nowhere if self.user is None else self.user.seen
        wish = self._no_wish if self.user is None else self.user.wish
        finish_frame = self.referee.arrays.finish_frame
        every = max(1, round(rate / overtaking.CHOICES_PER_SECOND))
        dwell, blocked = (
            round(rate * seconds) for seconds in (overtaking.DWELL_SECONDS, overtaking.BLOCKED_DWELL_SECONDS)
        )

        def locate(first: int, count: int) -> None:
            inputs = [first, rules, path, positions, velocities, fallen, user, riders]
            wp.launch(road_riders.locate, count, inputs=inputs, outputs=[table], device=device)

        def see(first: int, count: int) -> None:
            inputs = [first, rules, path, riders, table]
            wp.launch(road_riders.see, count, inputs=inputs, outputs=[seen], device=device)

        def decide(first: int, count: int) -> None:
            inputs = [first, rules, path, self._keys, self._by_distance, self._user_start, frame, finish_frame]
            wp.launch(grouping.group, count, inputs=[*inputs, seen, riders], device=device)
            if self._tactics_rules is not None:
                inputs = [first, rules, self._tactics_rules, self._seed, rate, frame, seen, self.tactics, riders]
                wp.launch(tactics.decide, count, inputs=inputs, device=device)
            inputs = [first, rules, path, self._speeds, every, dwell, blocked, frame, seen, self.obstacles, riders]
            wp.launch(overtaking.choose, count, inputs=inputs, device=device)
            wp.launch(drafting.draft, count, inputs=[first, rules, seen, riders], device=device)
            inputs = [first, rules, path, self._speeds, seen, self.obstacles, table, riders]
            wp.launch(road_following.command, count, inputs=inputs, outputs=[wish, commands_out], device=device)

        timing, judging, remembering = self.referee.phases(frame, rules, path, table, riders, self.obstacles, share)
        seeing = [
            [self._enqueue_obstacles],
            [partial(empty_cells, table)],
            share.everybody(locate),
            share.own(see),
        ]
        deciding = [
            side_by_side(share.own(decide), judging),
            # After deciding: who has come to the finish rides out slowly from the next frame on.
            side_by_side(timing, remembering),
        ]
        if self.user is not None:
            deciding.append([partial(self.user.enqueue, rules, path, riders)])
        return seeing, deciding

    def load(self) -> None:
        """Load the kernels, compiling those that nobody has compiled before."""
        self._replay.load()

    def actor_poses(self) -> np.ndarray:
        """World poses of `actors` in the frame that comes next, float64, shape [actors, 7]; waits for the device."""
        poses = [] if self.user is None else [self.user.pose.numpy()]
        if self._joggers:
            poses.append(self.obstacles.poses.numpy()[self._joggers])
        return np.concatenate([np.zeros((0, 7)), *poses]).astype(np.float64)

    def summary(self) -> list[dict[str, float | int | None]]:
        """What each rider's ride came to, the user last; waits for the device.

        In each: "training_speed" [m/s], "distance" ridden [m], "progress" along the road [m], "laps" completed,
        "finish_time" [s] or None, "off_road", "collisions", "struck", and "shelter", the mean.
        """
        a = self.referee.arrays
        frames = max(1, int(a.frames.numpy()[0]))
        progress, finish = a.progress.numpy(), a.finish_frame.numpy()
        columns = {
            "training_speed": self.riders.training.numpy().astype(np.float64),
            "distance": a.distance.numpy(),
            "progress": progress,
            "laps": np.maximum(progress // self._path.length, 0).astype(np.int64),
            "off_road": a.off_road_count.numpy(),
            "collisions": a.collisions.numpy(),
            "struck": a.struck_count.numpy(),
            "shelter": a.shelter_sum.numpy() / frames,
        }
        return [
            {name: column[i].item() for name, column in columns.items()}
            | {"finish_time": None if finish[i] == UNFINISHED else finish[i].item() / self._frame_rate}
            for i in range(self._count)
        ]

    def state(self) -> dict[str, np.ndarray]:
        """All that the next frame depends on besides its arguments, by names like "riders.lane"; copies."""
        return {name: array.numpy().copy() for name, array in self._persistent().items()}

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from what `state` gave, to the same bits."""
        for name, array in self._persistent().items():
            array.assign(state[name])
        self.referee.count_anew(self._count - self.rules.first_user)

    @property
    def by_rider(self) -> frozenset[str]:
        """Names of those arrays of `state` that have a row for each rider, the user last."""
        shared = ("referee.frames", "obstacles.poses")
        return frozenset(name for name in self._persistent() if name not in shared and not name.startswith("user."))

    def _persistent(self) -> dict[str, wp.array]:
        arrays = {f"riders.{name}": getattr(self.riders, name) for name in _REMEMBERED}
        arrays |= {f"tactics.{name}": getattr(self.tactics, name) for name in ("choice", "age", "pulled", "rest")}
        arrays |= {f"referee.{name}": array for name, array in self.referee.state().items()}
        arrays["obstacles.poses"] = self.obstacles.poses
        if self.user is not None:
            arrays |= {f"user.{name}": array for name, array in self.user.state().items()}
        return arrays

    def _enqueue_obstacles(self) -> None:
        count = self.obstacles.start.shape[0]
        if count:
            inputs = [self._data, self.rules.step, self._frame, self.obstacles]
            wp.launch(road_obstacles.move_obstacles, count, inputs=inputs, device=self._device)

    def set_frame(self, frame: int) -> None:
        """Say which frame `enqueue` is about."""
        if self._device.is_cpu:
            self._frame.numpy()[0] = frame
        else:
            self._frame.fill_(frame)


def finish_distance(path: Centreline, laps: int) -> float:
    """Where the finish is: laps times the length of a closed road, a little before the end of an open one [m]."""
    return laps * path.length if path.closed else path.length - min(RUN_OUT, 0.1 * path.length)


def _rules(settings: PelotonSettings, half_width: float, edge: float, frame_rate: int, count: int) -> RoadRules:
    rules = RoadRules()
    for name in _COPIED:
        setattr(rules, name, getattr(settings, name))
    rules.pursuit = int(settings.mode == "pursuit")
    rules.drafting = int(settings.drafting)
    rules.half_width, rules.edge = half_width, edge
    rules.step = 1.0 / frame_rate
    rules.first_user = count
    return rules


def _riders(grid: StartGrid, path: Centreline, device: wp.DeviceLike) -> RoadRiders:
    laps = np.floor(grid.s / path.length) if path.closed else np.zeros(len(grid.s))
    ahead = np.stack([np.cos(grid.headings), np.sin(grid.headings)], axis=1)
    count = len(grid.s)

    def numbers(values: np.ndarray) -> wp.array:
        return wp.array(np.asarray(values, dtype=np.float32), dtype=wp.float32, device=device)

    def whole(values: np.ndarray) -> wp.array:
        return wp.array(np.asarray(values, dtype=np.int32), dtype=wp.int32, device=device)

    riders = RoadRiders()
    riders.home, riders.training = numbers(grid.offsets), numbers(grid.training_speeds)
    riders.presence = whole(np.full(count, RIDING))
    riders.s, riders.laps = numbers(grid.s - laps * path.length), whole(laps)
    riders.offset = numbers(grid.offsets)
    riders.heading = wp.array(ahead.astype(np.float32), dtype=wp.vec2, device=device)
    riders.along, riders.speed = numbers(grid.speeds), numbers(grid.speeds)
    riders.command_speed, riders.known_speed = numbers(grid.speeds), numbers(grid.speeds)
    for name in ("wanted_offset", "target", "lane", "known_lane", "known_target"):
        setattr(riders, name, numbers(grid.offsets))
    for name in ("sideways", "wanted_speed", "lane_rate", "shelter"):
        setattr(riders, name, numbers(np.zeros(count)))
    riders.keeping, riders.chosen = whole(np.ones(count)), whole(np.full(count, LONG_AGO))
    return riders


def _seen(settings: PelotonSettings, count: int, device: wp.DeviceLike) -> RidersSeen:
    rows = (count, min(settings.neighbours, max(1, count - 1)))
    seen = RidersSeen()
    seen.found = wp.zeros(count, dtype=wp.int32, device=device)
    seen.indices = wp.zeros(rows, dtype=wp.int32, device=device)
    seen.distances = wp.zeros(rows, dtype=wp.float32, device=device)
    seen.ahead = wp.zeros(rows, dtype=wp.float32, device=device)
    return seen
