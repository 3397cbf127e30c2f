"""A made-up run to look at: hoppers that turn a corner in front of a collie, feet on the ground in stance.

Nothing is simulated; positions, hops and legs are written down so that tests know where everything is.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from echelon.recording import EVENT_DTYPE, EVENT_NAMES, PHASE_NAMES, Actor, Cast, Recording, RecordingWriter
from echelon.warp_kernels.model import Joint, Link, Model, Visual

FLIGHT_SECONDS = 0.40
STANCE_SECONDS = 0.24
LIFTOFF_HEIGHT = 0.85  # [m] of the body's middle
SPEED = 1.6  # [m/s]
TURN_AT = 2.0  # [s], when all of them turn to the left


@dataclass(frozen=True)
class SceneRecording:
    """The attributes of a Recording that pictures and plots read, in memory."""

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
    actors: tuple[Actor, ...]
    actor_poses: np.ndarray
    summary: dict[str, Any]
    path: Path = Path("scene")
    phase_names: tuple[str, ...] = PHASE_NAMES
    event_names: tuple[str, ...] = EVENT_NAMES
    status: str = "done"

    @property
    def agent_count(self) -> int:
        return self.link_poses.shape[1]

    @property
    def times(self) -> np.ndarray:
        return np.arange(self.frame_count) / self.frame_rate


def hopper_model() -> Model:
    """An ellipsoid, an upper leg on the hip, a lower leg that slides out of it."""
    return Model(
        name="hopper",
        links=(
            Link("body", None, Joint("root", "free"), 20.0, visuals=(Visual("ellipsoid", (0.35, 0.3, 0.25)),)),
            Link(
                "upper_leg",
                "body",
                Joint("hip", "universal", axes=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))),
                2.0,
                visuals=(Visual("capsule", (0.06, 0.2, 0.0), position=(0.0, 0.0, -0.25)),),
            ),
            Link(
                "lower_leg",
                "upper_leg",
                Joint("leg", "slider", position=(0.0, 0.0, -0.4), axes=((0.0, 0.0, -1.0),)),
                1.0,
                visuals=(
                    Visual("capsule", (0.035, 0.22, 0.0), position=(0.0, 0.0, -0.2), color=(0.35, 0.36, 0.38)),
                    Visual("ellipsoid", (0.06, 0.05, 0.03), position=(0.0, 0.0, -0.43), color=(0.03, 0.03, 0.03)),
                ),
            ),
        ),
    )


def scene_world(corral: bool = True) -> dict[str, Any]:
    """The oval infield, and the corral near its far end."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 25)
    bend = 28.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    outline = np.concatenate([bend + [17.0, 0.0], -bend - [17.0, 0.0]])
    walls = [{"name": "infield", "points": outline.tolist(), "closed": True, "height": 1.2}]
    data: dict[str, Any] = {"ground": {"shape": "oval", "half_length": 45.0, "half_width": 28.0}, "walls": walls}
    if corral:
        fence = [[20.0, 3.0], [20.0, 5.0], [30.0, 5.0], [30.0, -5.0], [20.0, -5.0], [20.0, -3.0]]
        walls.append({"name": "corral", "points": fence, "closed": False, "height": 1.2})
        data["corral"] = {"center": [25.0, 0.0], "size": 10.0, "opening": 6.0, "facing": [-1.0, 0.0]}
    return data


def distinct_colors(count: int) -> np.ndarray:
    """Saturated linear RGB colours around the wheel, neighbours in the list far apart; shape [count, 3]."""
    hue = (np.arange(count) * 0.618034) % 1.0
    wheel = np.clip(np.abs((hue[:, None] * 6.0 + [0.0, 4.0, 2.0]) % 6.0 - 3.0) - 1.0, 0.0, 1.0)
    return 0.08 + 0.72 * wheel**1.6


def scene_recording(
    agent_count: int = 16,
    frame_count: int = 150,
    frame_rate: int = 30,
    *,
    center: tuple[float, float] = (-6.0, -4.0),
    collie: bool = True,
    corral: bool = True,
    plane: bool = False,
) -> Any:
    """A herd that hops along x, then along y; the result is a `SceneRecording`, which passes for a `Recording`."""
    seconds = np.arange(frame_count)[:, None] / frame_rate
    offset = (np.arange(agent_count) * 0.37) % 1.0 * (FLIGHT_SECONDS + STANCE_SECONDS)
    side = int(np.ceil(np.sqrt(agent_count)))
    start = np.array(center) + 2.5 * np.array(
        [[i % side + 0.5 * (i // side % 2) - 0.5 * side, i // side - 0.5 * side] for i in range(agent_count)]
    )
    ground, heading = _walked(seconds, start)
    cycle = (seconds + offset) % (FLIGHT_SECONDS + STANCE_SECONDS)
    height = _height(cycle)
    in_stance = cycle >= FLIGHT_SECONDS
    middle_of_stance = seconds + (FLIGHT_SECONDS + 0.5 * STANCE_SECONDS - cycle)
    foot_ground, _ = _walked(middle_of_stance, start)
    lift = np.where(in_stance, 0.0, 0.18 * np.sin(np.pi * np.clip(cycle / FLIGHT_SECONDS, 0.0, 1.0)))
    # In flight the foot swings from where it stood to where it will.
    last_foot, _ = _walked(middle_of_stance - FLIGHT_SECONDS - STANCE_SECONDS, start)
    swing = np.where(in_stance, 1.0, np.clip(cycle / FLIGHT_SECONDS, 0.0, 1.0))[..., None]
    foot = np.concatenate([last_foot + swing * (foot_ground - last_foot), lift[..., None]], axis=2)

    root = np.concatenate([ground, height[..., None]], axis=2)
    poses = np.zeros((frame_count, agent_count, 3, 7))
    tilt = 0.06 * np.sin(2.0 * np.pi * cycle / (FLIGHT_SECONDS + STANCE_SECONDS))
    turn = Rotation.from_euler("ZY", np.stack([heading, tilt], axis=-1).reshape(-1, 2))
    poses[:, :, 0, :3] = root
    poses[:, :, 0, 3:] = turn.as_quat().reshape(frame_count, agent_count, 4)
    leg = root - foot
    length = np.linalg.norm(leg, axis=2)
    unit = leg / length[..., None]
    leg_turn = Rotation.from_rotvec(
        (np.cross([0.0, 0.0, 1.0], unit) * np.arccos(unit[..., 2:3].clip(-1.0, 1.0))
         / np.maximum(np.linalg.norm(np.cross([0.0, 0.0, 1.0], unit), axis=2, keepdims=True), 1e-9)).reshape(-1, 3)
    )  # fmt: skip
    for link, place in ((1, root), (2, foot + 0.46 * unit)):
        poses[:, :, link, :3] = place
        poses[:, :, link, 3:] = leg_turn.as_quat().reshape(frame_count, agent_count, 4)

    velocity = np.gradient(root, axis=0) * frame_rate if frame_count > 1 else np.zeros_like(root)
    desired = SPEED * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    touched = in_stance[1:] & ~in_stance[:-1]
    frames, agents = np.nonzero(touched)
    events = np.zeros(len(frames), dtype=EVENT_DTYPE)
    events["frame"], events["agent"] = frames, agents

    actors: tuple[Actor, ...] = (Actor("collie", "bicycle"),) if collie else ()
    actor_poses = np.zeros((frame_count, len(actors), 7))
    if collie:
        actor_poses[:, 0, 0] = center[0] - 14.0 + 3.0 * seconds[:, 0]
        actor_poses[:, 0, 1] = center[1] - 7.0 + 0.5 * seconds[:, 0]
        actor_poses[:, 0, 3:] = Rotation.from_euler("Z", [[np.arctan2(0.5, 3.0)]]).as_quat()
    inside = (np.abs(root[..., 0] - 25.0) < 5.0) & (np.abs(root[..., 1]) < 5.0)
    return SceneRecording(
        scenario={"name": "corner", "title": "Round the corner", "seed": 1, "herd": {"radius": 0.35}},
        frame_rate=frame_rate,
        frame_count=frame_count,
        casts=(Cast("hopper", hopper_model(), 0, agent_count, distinct_colors(agent_count)),),
        world={"ground": {"shape": "plane", "half_size": 60.0}, "walls": []} if plane else scene_world(corral),
        link_poses=poses,
        velocities=velocity.astype(np.float32),
        desired_velocities=desired.astype(np.float32),
        phases=np.where(in_stance, 2, 0).astype(np.int8),
        fallen=np.zeros(in_stance.shape, dtype=bool),
        in_corral=inside.sum(axis=1).astype(np.int32),
        events=events,
        actors=actors,
        actor_poses=actor_poses,
        summary={"frames": frame_count, "falls": 0, "collisions": 0, "in_corral": int(inside[-1].sum())},
    )


def record_scene(scene: SceneRecording, path: Path) -> Recording:
    """The same run as a recording on disk, in several chunks."""
    writer = RecordingWriter.create(
        path,
        scenario=scene.scenario,
        frame_rate=scene.frame_rate,
        frame_limit=scene.frame_count,
        casts=scene.casts,
        world=scene.world,
        actors=scene.actors,
        length=16,
    )
    with writer:
        for begin in range(0, scene.frame_count, 16):
            frames = {name: array[: scene.frame_count - begin] for name, array in writer.buffers().items()}
            chunk = slice(begin, begin + 16)
            frames["origins"][:] = np.round(scene.link_poses[chunk, :, 0, :3])
            frames["link_poses"][:] = scene.link_poses[chunk]
            frames["link_poses"][..., :3] -= frames["origins"][:, :, None]
            for name in ("velocities", "desired_velocities", "phases", "fallen", "in_corral", "actor_poses"):
                frames[name][:] = getattr(scene, name)[chunk]
            inside = (scene.events["frame"] >= begin) & (scene.events["frame"] < begin + 16)
            writer.append(frames, {"frame": np.array(begin)}, scene.events[inside])
        writer.finish(scene.summary)
    return Recording(path)


def _height(cycle: np.ndarray) -> np.ndarray:
    """Height of the body over the ground [m] at times [s] since liftoff: a parabola, then a half sine."""
    flown = 0.5 * 9.81 * cycle * (FLIGHT_SECONDS - cycle)
    pressed = -0.16 * np.sin(np.pi * (cycle - FLIGHT_SECONDS) / STANCE_SECONDS)
    return LIFTOFF_HEIGHT + np.where(cycle < FLIGHT_SECONDS, flown, pressed)


def _walked(seconds: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places [frames, agents, 2] [m] and headings [frames, agents] [rad] at times broadcast to [frames, agents]."""
    seconds = np.broadcast_to(seconds, (len(seconds), len(start)))
    before, after = np.minimum(seconds, TURN_AT), np.maximum(seconds - TURN_AT, 0.0)
    place = start + SPEED * np.stack([before, after], axis=-1)
    return place, 0.5 * np.pi * np.clip((seconds - TURN_AT) / 0.6, 0.0, 1.0)
