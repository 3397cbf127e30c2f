"""A herd from Python: run it, ask the recording what happened, write a stage.

What it shows:

1. a scenario that is changed and checked before it runs (`echelon.Scenario`);
2. a run (`echelon.simulate`), which gives a recording;
3. what can be asked of a recording: speeds, hop rhythm, distances, the corral, a centre of mass;
4. the stage, in the representation for large crowds;
5. that the same scenario gives the same bits.

How to run it, in an environment where Echelon is installed:

    python examples/herd.py                        sixteen robots, until they are penned
    python examples/herd.py --agents 40 --seconds 20 --out forty
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

import echelon


def main(agents: int = 16, seconds: float = 180.0, out: Path = Path()) -> dict[str, float]:
    """Run the example.

    Args:
        agents: How many robots.
        seconds: How long at most [s].
        out: Folder for the recording and the stage.

    Returns:
        What was printed, by name.
    """
    # 1. The scenario that ships, with changes. A mistake in them is an InputError of one line, before anything runs.
    overrides = [f"crowd.count={agents}", f"seconds={seconds}", "seed=3"]
    scenario = echelon.Scenario.load("border-collie", overrides)
    places = scenario.start_positions()
    print(f"{scenario.title}: {agents} robots start about ({places[:, 0].mean():.1f}, {places[:, 1].mean():.1f}) m")

    # 2. The run. Without `recording` it would go to a temporary folder that disappears with `run`.
    run = echelon.simulate(scenario, recording=out / "herd.recording", progress=show_progress)
    print(f"\n{run.frame_count} frames at {run.frame_rate} a second, {run.summary['falls']} falls")

    # 3. What happened. Arrays are read from disk as they are indexed.
    found = {
        "greatest speed of the herd [m/s]": herd_speed(run).max(),
        "time between touchdowns [s]": hop_period(run),
        "part of the time on the ground": run.contacts[:].mean(),
        "mean distance to the nearest neighbour at the end [m]": nearest_neighbours(run, -1).mean(),
        "robots in the corral at the end": float(run.in_corral[-1]),
        "height of the centre of mass of robot 0 at the end [m]": center_of_mass(run, -1, 0)[2],
    }
    for name, value in found.items():
        print(f"  {name:<56} {value:.2f}")

    # 4. The stage.
    stage = run.export(out / "herd.usd", representation="points")
    print(f"wrote {stage} ({stage.stat().st_size / 1e6:.1f} MB)")

    # 5. Again, on two threads: the same bits.
    again = echelon.simulate(scenario, threads=2)
    same = again.summary["state_hash"] == run.summary["state_hash"]
    print(f"a second run on two threads ended in {'the same' if same else 'ANOTHER'} state")
    return found | {"same": float(same)}


def show_progress(done: int, total: int) -> None:
    """A line that grows; called after every frame."""
    if done % 30 == 0:
        print(".", end="", flush=True)


def herd_speed(run: echelon.Run) -> np.ndarray:
    """Speed of the middle of the herd along the ground [m/s], shape [frames]."""
    return np.linalg.norm(run.velocities[:, :, :2].mean(axis=1), axis=1)


def hop_period(run: echelon.Run) -> float:
    """Mean time from one touchdown to the next of the same robot [s], counted in whole frames."""
    touchdowns = run.events[run.events["kind"] == run.event_names.index("touchdown")]
    gaps = [np.diff(touchdowns["frame"][touchdowns["agent"] == agent]) for agent in range(run.agent_count)]
    return float(np.concatenate(gaps).mean()) / run.frame_rate


def nearest_neighbours(run: echelon.Run, frame: int) -> np.ndarray:
    """Distance of each robot to the one nearest to it [m], shape [agents]."""
    places = run.link_poses[frame, :, 0, :2]
    return KDTree(places).query(places, k=2)[0][:, 1]


def center_of_mass(run: echelon.Run, frame: int, agent: int) -> np.ndarray:
    """Of a robot, from the poses of its links and the masses of its body [m], shape [3]."""
    links = run.casts[0].body.links
    centers = [world_point(pose, link.com) for pose, link in zip(run.link_poses[frame, agent], links, strict=True)]
    return np.average(centers, axis=0, weights=[link.mass for link in links])


def world_point(pose: np.ndarray, point: tuple[float, float, float]) -> np.ndarray:
    """A point of a link in the world: a pose is x y z and the quaternion x y z w."""
    axis, w = pose[3:6], pose[6]
    turned = np.cross(axis, point)
    return pose[:3] + np.array(point) + 2.0 * (w * turned + np.cross(axis, turned))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="A herd from Python.")
    parser.add_argument("--agents", type=int, default=16)
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--out", type=Path, default=Path())
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    main(arguments.agents, arguments.seconds, arguments.out)
