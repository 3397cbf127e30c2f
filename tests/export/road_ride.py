"""A made-up ride to look at: cyclists whose legs turn the cranks, along a small hilly course or a given one.

Nothing is simulated. Riders ride at a steady pace at their own offsets, lean as their speed and the bend ask, and have
hands and feet where the cyclist's own inverse kinematics put them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from echelon.agents.riders.cyclist import Cyclist
from echelon.recording import EVENT_DTYPE, EVENT_NAMES, Actor, Cast
from echelon.terrain.course import Course, LandSettings, ScenerySettings

MEASURES = ("power", "cadence", "gear", "lean", "steer", "crank_torque")


@dataclass(frozen=True)
class RideRecording:
    """The attributes of a Recording of a ride, in memory."""

    scenario: dict[str, Any]
    frame_rate: int
    frame_count: int
    casts: tuple[Cast, ...]
    world: dict[str, Any]
    link_poses: np.ndarray
    velocities: np.ndarray
    desired_velocities: np.ndarray
    phases: np.ndarray
    fallen: np.ndarray
    in_corral: np.ndarray
    events: np.ndarray
    measures: np.ndarray
    actors: tuple[Actor, ...]
    actor_poses: np.ndarray
    summary: dict[str, Any]
    path: Path = Path("ride")
    phase_names: tuple[str, ...] = Cyclist.phase_names
    event_names: tuple[str, ...] = EVENT_NAMES
    measure_names: tuple[str, ...] = MEASURES
    status: str = "done"

    @property
    def agent_count(self) -> int:
        return self.link_poses.shape[1]

    @property
    def times(self) -> np.ndarray:
        return np.arange(self.frame_count) / self.frame_rate


@cache
def small_course() -> Course:
    """A loop of 600 m with a hill, two side streets, houses and trees."""
    angle = 2.0 * np.pi * np.arange(24) / 24
    points = np.column_stack(
        [110.0 * np.cos(angle), 70.0 * np.sin(angle) + 8.0 * np.sin(2.0 * angle), 20.0 + 5.0 * np.sin(angle)]
    )
    return Course(
        name="small-loop",
        points=tuple((float(x), float(y), float(z)) for x, y, z in points),
        side_streets=(((90.0, 0.0), (160.0, 5.0)), ((0.0, 50.0), (0.0, 110.0))),
        land=LandSettings(margin=60.0, hills=3.0, hill_size=200.0),
        scenery=ScenerySettings(house_spacing=30.0, tree_spacing=20.0),
    )


@cache
def cyclist() -> Cyclist:
    return Cyclist()


def distinct_colors(count: int) -> np.ndarray:
    """Saturated linear RGB colours around the wheel, neighbours in the list far apart; shape [count, 3]."""
    hue = (np.arange(count) * 0.618034) % 1.0
    wheel = np.clip(np.abs((hue[:, None] * 6.0 + [0.0, 4.0, 2.0]) % 6.0 - 3.0) - 1.0, 0.0, 1.0)
    return 0.04 + 0.66 * wheel**1.6


def riding_poses(course: Course, s: np.ndarray, offset: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Poses of all links of riders at distances along a course, frames first: [frames, riders, links, 7]."""
    character = cyclist()
    line, radius = course.centreline, character.bicycle.rear_wheel.radius
    flat = s.reshape(-1)
    heading = np.arctan2(*line.tangent(flat)[:, 1::-1].T)
    tangent = line.tangent(flat)
    grade = tangent[:, 2] / np.hypot(tangent[:, 0], tangent[:, 1])
    gear = np.full(len(flat), 2.6)
    rolled = flat / radius
    lean = -np.arctan(speed.reshape(-1) ** 2 * line.curvature(flat) / 9.81)
    # Upright states at the origin, heading along x; then turned, leant about the line on the road and moved.
    q, _ = character.riding(0.0 * flat, speed.reshape(-1), 0.0 * flat, rolled / gear, gear)
    for name in ("rear_wheel", "front_wheel"):
        q[:, character.body.q_start(character.body.link_index(name))] = rolled
    poses = character.body.link_poses(q)
    turn = Rotation.from_euler("ZYX", np.column_stack([heading, -np.arctan(grade), lean]))
    place = line.position(flat)
    place[:, :2] += offset.reshape(-1)[:, None] * line.left(flat)
    place[:, 2] = course.surfaces.height(place[:, :2])
    for link in range(poses.shape[1]):
        poses[:, link, :3] = turn.apply(poses[:, link, :3]) + place
        poses[:, link, 3:] = (turn * Rotation.from_quat(poses[:, link, 3:])).as_quat()
    return poses.reshape(*s.shape, poses.shape[1], 7)


def ride_recording(
    riders: int = 3,
    frame_count: int = 20,
    *,
    course: Course | None = None,
    start: float = 40.0,
    speed: float = 8.0,
    frame_rate: int = 30,
    obstacles: tuple[dict[str, Any], ...] = (),
    actors: bool = True,
) -> Any:
    """A group on its way; the result is a `RideRecording`, which passes for a `Recording`."""
    course = course or small_course()
    seconds = np.arange(frame_count)[:, None] / frame_rate
    row, column = np.divmod(np.arange(riders), 3)
    speeds = np.full((frame_count, riders), speed) * (1.0 + 0.01 * np.sin(0.3 * seconds + np.arange(riders)))
    s = start - 3.2 * row + 0.5 * np.sin(np.arange(riders)) + speed * seconds
    offset = np.broadcast_to(1.4 * (column - 1.0) + 0.3 * np.cos(2.0 * np.arange(riders)) - 1.0, s.shape)
    poses = riding_poses(course, s, offset, speeds)
    character, line = cyclist(), course.centreline
    cast_actors: tuple[Actor, ...] = (Actor("user", "bicycle"), Actor("jogger", "jogger")) if actors else ()
    actor_poses = np.zeros((frame_count, len(cast_actors), 7))
    for index, (ahead, aside, pace) in enumerate([(7.0, 0.5, speed), (30.0, -3.2, 2.8)][: len(cast_actors)]):
        where = start + ahead + pace * seconds[:, 0]
        place = line.position(where)
        place[:, :2] += aside * line.left(where)
        place[:, 2] = course.surfaces.height(place[:, :2])
        tangent = line.tangent(where)
        turn = np.column_stack([np.arctan2(tangent[:, 1], tangent[:, 0]), -np.arcsin(tangent[:, 2])])
        actor_poses[:, index, :3] = place
        actor_poses[:, index, 3:] = Rotation.from_euler("ZY", turn).as_quat()
    velocity = speeds[..., None] * line.tangent(s)
    measures = np.zeros((frame_count, riders, len(MEASURES)), dtype=np.float32)
    measures[..., 0] = 260.0 + 90.0 * np.sin(0.2 * seconds + np.arange(riders))
    measures[..., 1] = 84.0
    measures[..., 2] = 2.6
    measures[..., 3] = -np.arctan(speeds**2 * line.curvature(s) / 9.81)
    return RideRecording(
        scenario={"name": "small-ride", "title": "A small ride", "seed": 1},
        frame_rate=frame_rate,
        frame_count=frame_count,
        casts=(Cast("cyclist", character.body, 0, riders, distinct_colors(riders)),),
        world={"ground": {"shape": "road"}, "course": course.to_dict(), "obstacles": list(obstacles), "walls": []},
        link_poses=poses,
        velocities=velocity.astype(np.float32),
        desired_velocities=velocity[..., :2].astype(np.float32),
        phases=np.zeros(s.shape, dtype=np.int8),
        fallen=np.zeros(s.shape, dtype=bool),
        in_corral=np.zeros(frame_count, dtype=np.int32),
        events=np.zeros(0, EVENT_DTYPE),
        measures=measures,
        actors=cast_actors,
        actor_poses=actor_poses,
        summary={"frames": frame_count, "falls": 0, "collisions": 0, "off_road": 0},
    )
