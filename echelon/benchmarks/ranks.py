"""What ranks cost: a frame's time over agents and ranks, measured, modelled, and predicted beyond.

::

    mpiexec -n 2 python -m mpi4py -m echelon.benchmarks.ranks

measures on these ranks and prints four tables: what a frame costs one process, what of it each rank does for the whole
crowd, what one exchange costs, and the frame times that the model predicts for these ranks beside those measured.
`docs/scaling.md` tells how to read them.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from echelon.ranks import Exchange, Ranks
from echelon.scenario import Scenario
from echelon.simulation import Simulation
from echelon.simulation.scene import SceneFrames
from echelon.warp_kernels.frame import ChunkArrays

SIZES = (1000, 4000, 16000)
REPEATS = 5
FRAMES = 10


@dataclass(frozen=True)
class Network:
    """What ranks talk over.

    Attributes:
        latency: Of one message between two ranks [s].
        bandwidth: Into one rank, copies included [bytes/s].
    """

    latency: float
    bandwidth: float

    def exchange_seconds(self, agents: float, ranks: int, bytes_per_agent: float) -> float:
        """One Allgatherv of everybody's rows, on a ring: r - 1 steps, in which each rank gets what it does not have."""
        if ranks == 1:
            return 0.0
        return (ranks - 1) * self.latency + agents * bytes_per_agent * (ranks - 1) / ranks / self.bandwidth


@dataclass(frozen=True)
class FrameModel:
    """What a frame costs one core, from which frames on any number of ranks are predicted.

    Attributes:
        act, see_want: Of a rank's own agents [s] an agent.
        everybody: What each rank does for the whole crowd: hash grids, counting at the gate [s] an agent.
        fixed: Launching and Python [s].
        record: Noting and handing over what is recorded of a rank's own agents [s] an agent.
        bytes_per_agent: Told to the other ranks.
        recorded_bytes: Written for one agent and frame.
    """

    act: float
    see_want: float
    everybody: float
    fixed: float
    bytes_per_agent: float
    record: float = 0.0
    recorded_bytes: float = 0.0

    def parts(
        self, agents: float, ranks: int, network: Network, cores: int = 1, efficiency: float = 0.85
    ) -> dict[str, float]:
        """Seconds of a frame by what they go to.

        Args:
            agents: In the crowd.
            ranks: That it is dealt to.
            network: Between these.
            cores: Of each rank.
            efficiency: Of each core beside others of its rank.
        """
        speed = 1.0 if cores == 1 else cores * efficiency
        own = math.ceil(agents / ranks)
        return {
            "act": own * self.act / speed,
            "see_want": own * self.see_want / speed,
            "everybody": agents * self.everybody / speed,
            "exchange": network.exchange_seconds(agents, ranks, self.bytes_per_agent),
            "record": own * self.record,
            "fixed": self.fixed,
        }

    def frame_seconds(self, agents: float, ranks: int, network: Network, cores: int = 1) -> float:
        """A frame's time [s]; arguments as for `parts`."""
        return sum(self.parts(agents, ranks, network, cores).values())


# ---- measuring -------------------------------------------------------------------------------------------------------
def frame_seconds(plan: Scenario, ranks: Ranks) -> tuple[float, dict[str, float], float]:
    """The least time of a frame without recording, that of its phases, and the bytes told of an agent."""
    simulation = Simulation(plan, threads=1, ranks=ranks)
    engine = simulation.engine
    engine.bind(ChunkArrays.allocate(1, engine.agent_count, engine.character, engine.device))
    seen = SceneFrames.allocate(1, simulation.scene, engine.agent_count)

    def frames() -> None:
        for _ in range(FRAMES):
            simulation.advance(0, seen)
        seen.events.clear()

    frames()
    times: list[float] = []
    phases: list[dict[str, float]] = []
    for _ in range(REPEATS):
        before = dict(simulation.clock.seconds)
        times.append(_timed(frames) / FRAMES)
        phases.append({name: (s - before[name]) / FRAMES for name, s in simulation.clock.seconds.items()})
    simulation.close()
    least = times.index(min(times))
    return times[least], phases[least], simulation.bytes_told


def exchange_seconds(ranks: Ranks, agents: int, bytes_per_agent: int) -> float:
    """The least time of an exchange [s]: whatever else a machine does only adds to it."""
    rows = np.zeros((agents, bytes_per_agent), np.uint8)
    exchange = Exchange(ranks, agents, [rows])
    exchange()
    # As many as take about a fifth of a second, the same on all ranks.
    repeats = ranks.broadcast(int(np.clip(0.2 / _timed(exchange), 3, 2000)))
    times = []
    for _ in range(REPEATS):
        ranks.barrier()
        exchange()
        times.append(_timed(lambda: [exchange() for _ in range(repeats)]) / repeats)
    return min(times)


def measure(ranks: Ranks, scenario: str = "herd", sizes: Sequence[int] = SIZES) -> dict[str, Any]:
    """Everything: measured alone by the first rank while the others sleep, then together. Rows by table."""
    alone: list[dict[str, float]] = []
    told = 0.0
    with ranks.first_before_others():
        if ranks.is_first:
            for size in sizes:
                whole, phases, told = frame_seconds(_plan(scenario, size), Ranks())
                # One agent of its own: all else that it does, it does for everybody.
                shared, _, _ = frame_seconds(_plan(scenario, size), _one_of(size))
                see_want = phases["see"] + phases["want"]
                row = {"agents": size, "frame_us": whole, "act_us": phases["act"], "see_want_us": see_want}
                alone.append({**row, "everybody_us": shared})
    alone, told = ranks.broadcast((alone, told))
    model = fitted(alone, told)
    exchanges = [
        {"agents": size, "bytes": size * told, "exchange_us": exchange_seconds(ranks, size, int(told))}
        for size in (16, 100, *sizes, 10 * max(sizes))
    ]
    network = _network(exchanges, ranks.size)
    compared = []
    for size in sizes:
        found, _, _ = frame_seconds(_plan(scenario, size), ranks)
        predicted = model.frame_seconds(size, ranks.size, network)
        compared.append({"agents": size, "predicted_us": predicted, "measured_us": found})
    tables = {"alone": alone, "exchange": exchanges, "frames": compared}
    for row in (row for table in tables.values() for row in table):
        row |= {name: round(value * 1e6, 1) for name, value in row.items() if name.endswith("_us")}
    for row in compared:
        row["ratio"] = round(row["predicted_us"] / row["measured_us"], 2)
    return {"ranks": ranks.size, "scenario": scenario, "model": asdict(model), "network": asdict(network), **tables}


def fitted(alone: Sequence[dict[str, float]], bytes_per_agent: float) -> FrameModel:
    """The model of one core from what it took alone [s]; the largest crowd counts for what an agent takes."""
    few, many = alone[0], alone[-1]
    agents = many["agents"]
    everybody = max((many["everybody_us"] - few["everybody_us"]) / (agents - few["agents"]), 0.0)
    fixed = max(few["everybody_us"] - few["agents"] * everybody, 0.0)
    own = (many["frame_us"] - fixed) / agents - everybody
    acting = many["act_us"] / (many["act_us"] + many["see_want_us"])
    return FrameModel(own * acting, own * (1.0 - acting), everybody, fixed, bytes_per_agent)


def _network(rows: Sequence[dict[str, float]], ranks: int) -> Network:
    """Latency from the smallest exchange, bandwidth from the largest."""
    if ranks == 1:
        return Network(0.0, math.inf)
    few, many = rows[0], rows[-1]
    latency = few["exchange_us"] / (ranks - 1)
    seconds = max(many["exchange_us"] - few["exchange_us"], 1e-9)
    return Network(latency, many["bytes"] * (ranks - 1) / ranks / seconds)


def _one_of(count: int) -> Ranks:
    """A rank as if among as many as there are agents, which tells nobody anything."""
    ranks = Ranks()
    ranks.size = count
    return ranks


def _plan(scenario: str, agents: int) -> Scenario:
    ground = ["world.ground=plane"] if scenario == "herd" else []
    return Scenario.load(scenario, [f"crowd.count={agents}", *ground])


def _timed(work: Callable[[], Any]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


# ---- the paper exercise ----------------------------------------------------------------------------------------------
CLUSTER = Network(latency=2e-6, bandwidth=10e9)
"""What `docs/scaling.md` assumes of a cluster: 100 Gbit/s Ethernet or InfiniBand, of which MPI gets 10 GB/s."""


def predictions(
    model: FrameModel, agents: float = 1e6, ranks: Sequence[int] = (1, 10, 50, 100), cores: int = 16
) -> list[dict[str, float]]:
    """The model carried to a cluster: milliseconds of a frame by part, for nodes of so many cores."""
    rows = []
    for count in ranks:
        parts = model.parts(agents, count, CLUSTER, cores)
        rows.append(
            {"agents": agents, "ranks": count, "cores": cores}
            | {f"{name}_ms": round(seconds * 1e3, 2) for name, seconds in parts.items()}
            | {"frame_ms": round(sum(parts.values()) * 1e3, 2)}
        )
    return rows


def main() -> None:
    """Measure on the ranks that have been launched; see the module's text."""
    parser = argparse.ArgumentParser(description="Measure and model what ranks cost.")
    parser.add_argument("--scenario", default="herd")
    parser.add_argument("--agents", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    ranks = Ranks.launched()
    found = measure(ranks, options.scenario, sorted(options.agents))
    if not ranks.is_first:
        return
    found["predictions"] = predictions(FrameModel(**found["model"]))
    if options.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        if isinstance(value, list):
            print(f"\n{name}")
            print("| " + " | ".join(value[0]) + " |")
            print("|" + "---|" * len(value[0]))
            for row in value:
                print("| " + " | ".join(f"{number:g}" for number in row.values()) + " |")
        else:
            print(f"{name}: {value}")


if __name__ == "__main__":
    main()
