"""A made-up recording for the tests of the export room: three-link hoppers that bounce along, nothing simulated.

The poses come from a joint-by-joint product of transforms, so that every link hangs on its parent exactly, and the
attributes are those of `echelon.recording.Recording`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.spatial.transform import Rotation

from echelon.recording import EVENT_DTYPE, EVENT_NAMES, PHASE_NAMES, Actor, Cast, Recording, RecordingWriter
from echelon.warp_kernels.model import ContactSite, Joint, Link, Model, Visual

HOP_SECONDS = 0.62


@dataclass(frozen=True)
class SyntheticRecording:
    """The attributes of a Recording, held in memory."""

    scenario: dict[str, Any]
    frame_rate: int
    frame_count: int
    casts: tuple[Cast, ...]
    agent_count: int
    world: dict[str, Any]
    link_poses: np.ndarray
    velocities: np.ndarray
    desired_velocities: np.ndarray
    phases: np.ndarray
    contacts: np.ndarray
    fallen: np.ndarray
    frozen: np.ndarray
    in_corral: np.ndarray
    events: np.ndarray
    actors: tuple[Actor, ...]
    actor_poses: np.ndarray
    summary: dict[str, Any]
    path: Path = Path("synthetic")
    phase_names: tuple[str, ...] = PHASE_NAMES
    event_names: tuple[str, ...] = EVENT_NAMES
    status: str = "done"
    times: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", np.arange(self.frame_count) / self.frame_rate)


def hopper_model() -> Model:
    """Body, upper leg on a three-axis hip, lower leg on a slider: 3 links, 10 degrees of freedom."""
    return Model(
        name="hopper",
        links=(
            Link(
                name="body",
                parent=None,
                joint=Joint("root", "free", position=(0.0, 0.0, 1.0)),
                mass=20.0,
                com=(0.02, 0.0, 0.01),
                inertia=((0.9, 0.05, 0.0), (0.05, 0.7, 0.02), (0.0, 0.02, 1.1)),
                visuals=(
                    Visual("ellipsoid", (0.35, 0.28, 0.16)),
                    Visual("ellipsoid", (0.08, 0.2, 0.05), position=(0.3, 0.0, 0.05), color=(0.02, 0.02, 0.03)),
                ),
            ),
            Link(
                name="upper_leg",
                parent="body",
                joint=Joint(
                    "hip",
                    "gimbal",
                    position=(0.0, 0.0, -0.05),
                    axes=((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
                    limits=(None, (-0.6, 0.6), (-0.8, 0.9)),
                    limit_stiffness=500.0,
                ),
                mass=2.0,
                com=(0.0, 0.0, -0.2),
                inertia=((0.03, 0.0, 0.0), (0.0, 0.03, 0.0), (0.0, 0.0, 0.004)),
                visuals=(Visual("capsule", (0.06, 0.2, 0.0), position=(0.0, 0.0, -0.2)),),
            ),
            Link(
                name="lower_leg",
                parent="upper_leg",
                joint=Joint(
                    "leg", "slider", position=(0.0, 0.0, -0.4), axes=((0.0, 0.0, -1.0),), limits=((-0.05, 0.3),)
                ),
                mass=0.8,
                com=(0.0, 0.0, -0.2),
                inertia=((0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.001)),
                visuals=(
                    Visual("capsule", (0.035, 0.2, 0.0), position=(0.0, 0.0, -0.2), color=(0.4, 0.4, 0.42)),
                    Visual("cylinder", (0.05, 0.02, 0.0), position=(0.0, 0.0, -0.02), color=(0.02, 0.02, 0.03)),
                ),
            ),
        ),
        contacts=(
            ContactSite("foot", "lower_leg", (0.0, 0.0, -0.42), radii=(0.04, 0.04, 0.04), friction=0.9),
            ContactSite("hull", "body", (0.0, 0.0, 0.0), radii=(0.35, 0.28, 0.16), friction=0.5),
            ContactSite("flank", "body", (0.0, 0.0, 0.0), radii=(0.35, 0.35, 0.35), surface="wall", friction=0.4),
            ContactSite("knee", "upper_leg", (0.06, 0.0, -0.3), friction=0.5),
        ),
    )


def joints_model(root: Joint | None = None) -> Model:
    """A chain with every kind of joint, skew axes, both hands of gimbal, lopsided links."""
    slant = (0.6, 0.0, 0.8)
    joints = [
        root if root is not None else Joint("root", "free"),
        Joint("pin", "pin", (0.3, 0.1, 0.0), axes=(slant,), limits=((-0.7, 0.9),)),
        Joint("universal", "universal", (0.2, 0.0, 0.1), axes=((0.0, 1.0, 0.0), slant), limits=((-0.5, 0.6), None)),
        Joint(
            "right",
            "gimbal",
            (0.0, 0.2, 0.1),
            axes=((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
            limits=((-0.4, 0.5), None, (-0.6, 0.7)),
        ),
        Joint(
            "left",
            "gimbal",
            (0.1, 0.0, -0.2),
            axes=((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
            limits=((-0.4, 0.5), None, (-0.6, 0.8)),
        ),
        Joint("slide", "slider", (0.1, 0.1, 0.1), axes=(slant,), limits=((-0.2, 0.3),)),
        Joint("round", "ball", (0.0, 0.1, 0.2)),
    ]
    names = [f"link {joint.name}" for joint in joints]
    rng = np.random.default_rng(3)
    links = []
    for index, joint in enumerate(joints):
        turn = Rotation.from_rotvec(rng.uniform(-1.0, 1.0, 3)).as_matrix()
        tensor = turn @ np.diag(rng.uniform(0.5, 1.0, 3)) @ turn.T
        rows = [tuple(float(value) for value in row) for row in 0.5 * (tensor + tensor.T)]
        links.append(
            Link(
                name=names[index],
                parent=names[index - 1] if index else None,
                joint=joint,
                mass=1.0 + index,
                com=(0.05, -0.02 * index, 0.03),
                inertia=(rows[0], rows[1], rows[2]),  # pyright: ignore[reportArgumentType]
                visuals=(Visual("box", (0.1, 0.05, 0.05)),),
            )
        )
    return Model(name="chain", links=tuple(links))


def world(corral: bool = True) -> dict[str, Any]:
    """An oval, and the corral near its far end."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 9)
    bend = 28.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    outline = np.concatenate([bend + [17.0, 0.0], -bend - [17.0, 0.0]])
    walls: list[dict[str, Any]] = [
        {"name": "infield", "points": outline.tolist(), "closed": True, "height": 1.2},
    ]
    data: dict[str, Any] = {"ground": {"shape": "oval", "half_length": 45.0, "half_width": 28.0}, "walls": walls}
    if corral:
        fence = [[20.0, 2.0], [20.0, 5.0], [30.0, 5.0], [30.0, -5.0], [20.0, -5.0], [20.0, -2.0]]
        walls.append({"name": "corral", "points": fence, "closed": False, "height": 1.2})
        data["corral"] = {"center": [25.0, 0.0], "size": 10.0, "opening": 4.0, "facing": [-1.0, 0.0]}
    return data


def synthetic_recording(
    agent_count: int = 4,
    frame_count: int = 24,
    frame_rate: int = 30,
    *,
    collie: bool = True,
    corral: bool = True,
    falls: tuple[int, ...] = (1,),
    model: Model | None = None,
) -> Recording:
    """A herd that hops along x; the agents in ``falls`` lie down half way and stay where they are."""
    body = model if model is not None else hopper_model()
    rng = np.random.default_rng(7)
    seconds = np.arange(frame_count)[:, None] / frame_rate
    cycle = seconds / HOP_SECONDS + rng.uniform(size=(1, agent_count))
    columns = int(np.ceil(np.sqrt(agent_count)))
    start = np.array([[2.5 * (i % columns), 2.5 * (i // columns)] for i in range(agent_count)])
    heading = rng.uniform(-0.5, 0.5, size=(1, agent_count)) + 0.3 * np.sin(0.5 * seconds)
    speed = rng.uniform(0.5, 2.0, size=(1, agent_count))

    fallen = np.zeros((frame_count, agent_count), dtype=bool)
    for agent in falls:
        fallen[frame_count // 2 :, agent] = True
    # A fallen agent's clock stands still, so that everything derived from it does.
    stopped = np.where(fallen, seconds[frame_count // 2], seconds)
    cycle = np.where(fallen, cycle[frame_count // 2], cycle)
    heading = np.where(fallen, heading[frame_count // 2], heading)
    height = np.where(fallen, 0.2, 0.75 + 0.25 * np.abs(np.sin(np.pi * cycle)))
    position = np.stack(
        [
            start[:, 0] + speed * stopped * np.cos(heading),
            start[:, 1] + speed * stopped * np.sin(heading),
            height,
        ],
        axis=-1,
    )
    turn = np.stack([heading, 0.1 * np.sin(2.0 * np.pi * cycle), np.where(fallen, 1.3, 0.08 * np.cos(cycle))], axis=-1)
    root = Rotation.from_euler("ZYX", turn.reshape(-1, 3))

    poses = np.zeros((frame_count, agent_count, len(body.links), 7))
    rotations: list[Rotation] = []
    for index, link in enumerate(body.links):
        parent = body.parents[index]
        if link.joint.kind == "free":
            rotation, origin = root, position.reshape(-1, 3)
        else:
            upper = rotations[parent] if parent >= 0 else Rotation.identity(frame_count * agent_count)
            base = poses[:, :, parent, :3].reshape(-1, 3) if parent >= 0 else np.zeros(3)
            joint_turn, joint_shift = _joint_motion(link, index, cycle.reshape(-1))
            rotation = upper * joint_turn
            origin = base + upper.apply(np.asarray(link.joint.position) + joint_shift)
        rotations.append(rotation)
        poses[:, :, index, :3] = origin.reshape(frame_count, agent_count, 3)
        poses[:, :, index, 3:] = rotation.as_quat().reshape(frame_count, agent_count, 4)
    velocity = np.gradient(position, axis=0) * frame_rate if frame_count > 1 else np.zeros_like(position)

    phases = np.where(fallen, 5, (np.floor(5.0 * cycle) % 5).astype(int)).astype(np.int8)
    actors: tuple[Actor, ...] = (Actor("collie", "bicycle"),) if collie else ()
    actor_poses = np.zeros((frame_count, len(actors), 7))
    if collie:
        angle = 0.2 * seconds[:, 0]
        actor_poses[:, 0, 0] = 15.0 * np.cos(angle)
        actor_poses[:, 0, 1] = 15.0 * np.sin(angle)
        actor_poses[:, 0, 3:] = Rotation.from_euler("Z", (angle + 0.5 * np.pi)[:, None]).as_quat()
    made = SyntheticRecording(
        scenario={"name": "border-collie", "seconds": frame_count / frame_rate, "crowd": {"count": agent_count}},
        frame_rate=frame_rate,
        frame_count=frame_count,
        casts=(Cast("hopper", body, 0, agent_count, rng.uniform(0.1, 0.9, size=(agent_count, 3))),),
        agent_count=agent_count,
        world=world(corral),
        link_poses=poses,
        velocities=velocity.astype(np.float32),
        desired_velocities=np.zeros((frame_count, agent_count, 2), dtype=np.float32),
        phases=phases,
        contacts=(phases > 0) & (phases < 5),
        fallen=fallen,
        frozen=np.zeros_like(fallen),
        in_corral=np.zeros(frame_count, dtype=np.int32),
        events=np.zeros(0, EVENT_DTYPE),
        actors=actors,
        actor_poses=actor_poses,
        summary={"frames": frame_count, "state_hash": "0" * 16},
    )
    return cast("Recording", made)


def on_disk(recording: Recording, path: Path) -> Recording:
    """The same recording, written to a folder and opened again; poses lose what float32 cannot hold."""
    with RecordingWriter.create(
        path,
        scenario=recording.scenario,
        frame_rate=recording.frame_rate,
        frame_limit=recording.frame_count,
        casts=recording.casts,
        world=recording.world,
        actors=recording.actors,
        length=recording.frame_count,
    ) as writer:
        frames = writer.buffers()
        poses = np.asarray(recording.link_poses)
        origins = np.round(poses[:, :, 0, :3])
        frames["origins"][:] = origins
        frames["link_poses"][:] = poses
        frames["link_poses"][..., :3] = poses[..., :3] - origins[:, :, None]
        for name in ("velocities", "desired_velocities", "phases", "contacts", "fallen", "frozen", "in_corral"):
            frames[name][:] = getattr(recording, name)
        frames["actor_poses"][:] = recording.actor_poses
        writer.append(frames, {"substep": np.zeros(1)})
        writer.finish(recording.summary)
    return Recording(path)


def _joint_motion(link: Link, index: int, cycle: np.ndarray) -> tuple[Rotation, np.ndarray]:
    """Rotations and displacements [n, 3] of a joint that swings a little, for n values of the hop cycle."""
    swing = 0.3 * np.sin(2.0 * np.pi * cycle[:, None] + index + np.arange(max(len(link.joint.axes), 1)))
    shift = np.zeros((len(cycle), 3))
    turn = Rotation.identity(len(cycle))
    if link.joint.kind == "slider":
        shift = 0.3 * swing[:, :1] * np.asarray(link.joint.axes[0])
    elif link.joint.kind == "ball":
        turn = Rotation.from_rotvec(np.column_stack([swing[:, 0], 0.5 * swing[:, 0], -swing[:, 0]]))
    else:
        for angle, axis in zip(swing.T, link.joint.axes, strict=False):
            turn = turn * Rotation.from_rotvec(angle[:, None] * np.asarray(axis))
    return turn, shift
