"""One run of a group test, and what is measured in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from echelon.benchmarks.group_problems import ORCA, GroupTest
from echelon.benchmarks.orca import OrcaPlanner
from echelon.recording import EVENT_NAMES
from echelon.scenario import Scenario
from echelon.simulation.loop import Simulation
from echelon.simulation.scene import SceneFrames
from echelon.warp_kernels.frame import ChunkArrays

RECOVERED = 0.15  # of the speed: so near to its new velocity everybody must come, and stay
SMOOTHING = 1.0  # over which a velocity is averaged, about two hops [s]
CROSSING_LIMIT = 0.05  # deeper than this bodies must not overlap [m]
SETTLED = 5.0  # at the end of a run, over which what is kept is averaged [s]


@dataclass(frozen=True)
class Track:
    """Where everybody was.

    Attributes:
        scenario: Of the run.
        positions: On the ground [m], shape [frames, agents, 2].
        velocities: [m/s], shape [frames, agents, 2].
        fallen: Shape [frames, agents].
        crossings: How deep the capsules of each have overlapped another's at the most [m], shape [agents].
        collisions: Pairs that began to overlap, in all frames.
    """

    scenario: Scenario
    positions: np.ndarray
    velocities: np.ndarray
    fallen: np.ndarray
    crossings: np.ndarray
    collisions: int


@dataclass(frozen=True)
class Outcome:
    """What one run came to.

    Attributes:
        agents: How many there were.
        falls: How many have fallen.
        collisions: How often two came nearer than two radii.
        passed: Of a test with obstacles, how many came past them and did not fall; else those who did not fall.
        crossed: How many bodies went through another deeper than 5 cm.
        lost: How many fell, did not come past the obstacles, or went through another.
        dispersion: Root mean square distance from the centroid at the end, over that at the start.
        recovery: After a turn, time until all keep within 15 % of the new velocity [s]; nan where not asked, or never.
        distance: To the nearest other, mean over those who stand and the last seconds [m].
        nearest: The least distance between two that stood, ever [m].
        off_speed: Difference from the velocity asked for, root mean square over the last seconds [m/s].
    """

    agents: int
    falls: int
    collisions: int
    passed: int
    crossed: int
    lost: int
    dispersion: float
    recovery: float
    distance: float
    nearest: float
    off_speed: float

    @property
    def clean(self) -> bool:
        """Nobody fell, and nobody ran into anybody or through him."""
        return self.falls == 0 and self.collisions == 0 and self.crossed == 0


def run_test(test: GroupTest, seed: int, *, threads: int | None = None) -> Track:
    """Run a test with a seed.

    Raises:
        InputError: Its planner is not installed.
    """
    scenario = test.scenario(seed)
    planner = OrcaPlanner(scenario) if test.law == ORCA else None
    return track(Simulation(scenario, threads=threads), planner)


def track(simulation: Simulation, planner: OrcaPlanner | None = None) -> Track:
    """Run a simulation that has not begun to the end of its scenario, without recording it.

    Args:
        simulation: What to run.
        planner: Who says what everybody wants, if not the scenario's own law.
    """
    scenario, engine = simulation.scenario, simulation.engine
    count = scenario.step_count + 1
    engine.bind(ChunkArrays.allocate(1, engine.agent_count, simulation.character, engine.device))
    seen = SceneFrames.allocate(1, simulation.scene, engine.agent_count)
    positions = np.zeros((count, engine.agent_count, 2))
    velocities = np.zeros((count, engine.agent_count, 2))
    fallen = np.zeros((count, engine.agent_count), dtype=bool)
    deepest = np.zeros(engine.agent_count)
    try:
        for frame in range(count):
            simulation.advance(0, seen)
            positions[frame] = engine.positions.numpy()[:, :2]
            velocities[frame] = engine.velocities.numpy()[:, :2]
            fallen[frame] = engine.fallen.numpy() != 0
            if engine.meetings is not None:
                deepest = np.maximum(deepest, engine.meetings.crossings.numpy()[: engine.agent_count])
            if planner is not None:
                planner.plan(engine)
    finally:
        simulation.close()
    collisions = sum(event[3] == EVENT_NAMES.index("collision") for event in seen.events)
    return Track(scenario, positions, velocities, fallen, deepest, collisions)


def outcome(track: Track) -> Outcome:
    """What a run came to."""
    scenario, places = track.scenario, track.positions
    down = track.fallen.any(axis=0)
    up = ~down
    crossed = track.crossings > CROSSING_LIMIT
    finish = finish_line(scenario)
    past = up if finish is None else up & (places[-1, :, 0] > finish)
    asked = np.array(asked_velocity(scenario))
    last = round(SETTLED * scenario.frame_rate)
    off = track.velocities[-last:, up] - asked
    return Outcome(
        agents=track.fallen.shape[1],
        falls=int(down.sum()),
        collisions=track.collisions,
        passed=int(past.sum()),
        crossed=int(crossed.sum()),
        lost=int((~past | crossed).sum()),
        dispersion=_spread(places[-1, up]) / _spread(places[0]) if up.any() else float("nan"),
        recovery=recovery_time(track),
        distance=float(np.mean([np.mean(_nearest(frame[up])) for frame in places[-last::10]])),
        nearest=min(
            float(np.min(_nearest(frame[~lying]), initial=np.inf))
            for frame, lying in zip(places, track.fallen, strict=True)
        ),
        off_speed=float(np.sqrt(np.mean(np.sum(off**2, axis=-1)))) if up.any() else float("nan"),
    )


def finish_line(scenario: Scenario) -> float | None:
    """x beyond which somebody has passed all obstacles [m]; None where there are none."""
    ends = [scenario.world.gap.center[0]] if scenario.world.gap is not None else []
    ends += [float(x + radius) for x, _, radius in scenario.world.all_columns()]
    return max(ends) + scenario.herd.radius if ends else None


def asked_velocity(scenario: Scenario) -> tuple[float, float]:
    """What the group is told at the end [m/s]."""
    return scenario.herd.turns[-1][1:] if scenario.herd.turns else scenario.herd.desired_velocity


def recovery_time(track: Track) -> float:
    """From the last turn until all who stand keep within `RECOVERED` of the velocity asked for [s]; nan for never."""
    scenario = track.scenario
    if not scenario.herd.turns:
        return float("nan")
    asked = np.asarray(asked_velocity(scenario))
    width = max(1, round(SMOOTHING * scenario.frame_rate))
    sums = np.cumsum(np.concatenate([np.zeros((1, *track.velocities.shape[1:])), track.velocities]), axis=0)
    mean = (sums[width:] - sums[:-width]) / width  # entry k: of the frames from k to k + width - 1
    off = np.asarray(np.linalg.norm(mean - asked, axis=-1) > RECOVERED * float(np.linalg.norm(asked)))
    late = np.flatnonzero((off & ~track.fallen.any(axis=0)).any(axis=1))
    begun = round(scenario.herd.turns[-1][0] * scenario.frame_rate)
    if len(late) and late[-1] == len(off) - 1:
        return float("nan")
    settled = (int(late[-1]) + 1 if len(late) else begun) + 0.5 * (width - 1)
    return max(float(settled - begun) / scenario.frame_rate, 0.0)


def _spread(places: np.ndarray) -> float:
    """Root mean square distance from the centroid [m]."""
    return float(np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=-1))))


def _nearest(places: np.ndarray) -> np.ndarray:
    """Distance from each to its nearest other [m]; empty where there are not two."""
    if len(places) < 2:
        return np.empty(0)
    return KDTree(places).query(places, k=2)[0][:, 1]
