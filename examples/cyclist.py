"""A cyclist from ahead: how a bend begins, and how one ends that was asked for too fast.

What it shows:

1. a character driven by hand, frame by frame, without a scenario (`Engine`);
2. what the group layer would command: a point ahead, by its direction and distance;
3. what the rider does about it: the bars turn the *other* way first, then the body leans, then the bars follow;
4. pictures of states that were never recorded.

How to run it, in an environment where Echelon is installed:

    python examples/cyclist.py                                    a bend of 14 m radius at 7 m/s
    python examples/cyclist.py --speed 10 --radius 8 --daring     and one that no tyre holds
    python examples/cyclist.py --radius 0 --out rider.png         straight ahead, from the side
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from PIL import Image

from echelon.agents.riders.cyclist import Cyclist
from echelon.export.camera import View
from echelon.export.pictures import render_still
from echelon.recording import Cast, Recording
from echelon.terrain.incline import InclineTerrain
from echelon.warp_kernels.frame import ChunkArrays, Engine

FRAME_RATE = 30
STRAIGHT = 2.0  # before the bend begins [s]
AFTER = 6.0  # [s]


@dataclass
class Seen:
    """Poses of one rider, in the shape in which pictures are made of recordings."""

    link_poses: np.ndarray
    casts: tuple[Cast, ...]
    path: Path = Path("cyclist")
    frame_rate: int = FRAME_RATE
    actors: tuple = ()
    actor_poses: Any = None
    world: Any = None

    def __post_init__(self) -> None:
        self.frame_count = len(self.link_poses)
        self.actor_poses = np.zeros((self.frame_count, 0, 7))
        self.world = {"ground": {"shape": "plane", "half_size": 100.0}, "walls": []}


def main(
    speed: float = 7.0, radius: float = 14.0, daring: bool = False, out: Path = Path("cyclist.png")
) -> dict[str, float]:
    """Run the example.

    Args:
        speed: [m/s].
        radius: Of the bend to the left [m]; 0 goes on straight ahead.
        daring: Whether the rider leans as far as it takes.
        out: The picture to write.

    Returns:
        What was printed, by name.
    """
    # 1. One rider on flat ground, already at speed.
    rider = Cyclist()
    frames = round((STRAIGHT + AFTER) * FRAME_RATE)
    engine = Engine(rider, 1, InclineTerrain.of([0.0]), substeps=rider.steps_per_second // FRAME_RATE, tick=6)
    seen = ChunkArrays.allocate(frames, 1, rider)
    engine.bind(seen)
    start = rider.population(1, seed=1, variation=0.0, in_phase=False, speed=speed)
    engine.set_q(start.q)
    engine.set_u(start.u)
    for name, values in start.memory.items():
        engine.set_memory(name, values)
    if daring:
        engine.set_parameter("lean_limit", np.ones(1))

    # 2. A point on the circle that begins where the rider is heading, a second and a half ahead.
    ahead = max(8.0, 1.5 * speed)
    for frame in range(frames):
        turning = radius > 0.0 and frame >= STRAIGHT * FRAME_RATE
        x, y, z, w = engine.q[0, 3:7]
        heading = np.arctan2(2.0 * (z * w - x * y), 1.0 - 2.0 * (x * x + z * z)) if turning else 0.0
        bearing = heading + (np.arcsin(min(0.5 * ahead / radius, 0.99)) if turning else 0.0)
        engine.set_command("velocity_x", speed * np.cos([bearing]))
        engine.set_command("velocity_y", speed * np.sin([bearing]))
        engine.set_command("look_ahead", np.array([ahead]))
        engine.advance(frame)

    # 3. What happened.
    begin = round(STRAIGHT * FRAME_RATE)
    measures = np.degrees(seen.measures.numpy()[begin:, 0])
    steer, lean = (measures[:, rider.records.index(name)] for name in ("steer", "lean"))
    down = seen.fallen.numpy()[begin:, 0] > 0
    found = {
        "steered to the right at first [deg]": float(-steer[:FRAME_RATE].min()),
        "leant to the left in the end [deg]": float(-lean[-FRAME_RATE:].mean()),
        "fell after [s]": float(np.argmax(down)) / FRAME_RATE if down.any() else float("inf"),
    }
    for name, value in found.items():
        print(f"{name:40} {value:.2f}")

    # 4. Pictures.
    poses = seen.poses.numpy().astype(float)
    poses[..., :3] += seen.origins.numpy()[:, :, None]
    cast_of_one = Cast("cyclist", rider.body, 0, 1, np.array([[0.55, 0.05, 0.04]]))
    source = cast(Recording, Seen(poses, (cast_of_one,)))
    if radius <= 0.0:
        _snapshot(source, out, begin, azimuth=-68.0, size=(900, 640), distance=4.3)
        return found
    middle = round(found["fell after [s]"] * FRAME_RATE) + begin if down.any() else begin + 15
    steps = (-18, -6, 3, 9, 30, 90) if down.any() else (-15, -6, 3, 12, 24, 45)
    with tempfile.TemporaryDirectory() as folder:
        pictures = []
        for index, step in enumerate(steps):
            path = Path(folder) / f"{index}.png"
            shown = min(middle + step, frames - 1)
            _snapshot(source, path, shown, azimuth=-10.0 if down.any() else 8.0, size=(360, 330), distance=5.6)
            pictures.append(Image.open(path).convert("RGB"))
        strip = Image.new("RGB", (364 * len(pictures) - 4, 330), (255, 255, 255))
        for index, picture in enumerate(pictures):
            strip.paste(picture, (364 * index, 0))
    _save(strip, out)
    return found


def _snapshot(
    source: Recording, path: Path, frame: int, azimuth: float, size: tuple[int, int], distance: float
) -> None:
    """A picture of a frame from a camera that goes along [deg], [pixels], [m]."""
    frame_link, pelvis = source.link_poses[frame, 0, 0], source.link_poses[frame, 0, 5]
    middle = 0.6 * pelvis[:3] + 0.4 * frame_link[:3]
    turn, rise = np.radians(azimuth), np.radians(11.0)
    target = np.array([middle[0] + 0.1, middle[1], 0.7 if pelvis[2] > 0.7 else 0.45])
    eye = target + distance * np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    view = View((eye[0], eye[1], eye[2]), (target[0], target[1], target[2]))
    render_still(source, path, time=frame / FRAME_RATE, size=size, camera=view)
    _save(Image.open(path).convert("RGB"), path)


def _save(picture: Image.Image, path: Path) -> None:
    """With few colours, so that files stay small."""
    picture.quantize(200, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--speed", type=float, default=7.0, help="speed [m/s]")
    parser.add_argument("--radius", type=float, default=14.0, help="radius of the bend [m]; 0 is none")
    parser.add_argument("--daring", action="store_true", help="lean as far as it takes")
    parser.add_argument("--out", type=Path, default=Path("cyclist.png"), help="the picture to write")
    arguments = parser.parse_args()
    main(arguments.speed, arguments.radius, arguments.daring, arguments.out)
