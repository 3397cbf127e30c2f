"""Other engines beside ours in `echelon bench scaling`: many of the same body at once, each in a world of its own.

    python -m echelon.benchmarks.scaling_peers '{"engine": "MuJoCo Warp", "agents": 1000, "threads": [1, 2]}'

prints the rows as JSON. Everybody simulates the hopper's body that is set down on its foot, with leg spring and hip
springs, a floor, and neither control nor others: the passive half of what ours does. The engines:

* **MuJoCo**, its `rollout`: all agents from C, in as many threads as are asked for, float64.
* **MuJoCo Warp**: the same model as Warp kernels on the CPU, one launch after another captured as a graph, which is
  faster than launching; Warp runs a launch on one thread. float32.
* **Newton (MuJoCo)**: Newton with its solver for robots, which drives MuJoCo Warp. The model is read from MuJoCo's XML.
* **Newton (Featherstone)**: its own articulated dynamics and compliant contact, explicit, which is sane only at smaller
  steps: the largest of a ladder.

They are optional: `pip install 'echelon[peers]'`.
"""

# pyright: reportAttributeAccessIssue=false, reportMissingImports=false
# (MuJoCo's names live in an extension module that has no type stubs; the others need not be installed.)

from __future__ import annotations

import json
import sys
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from echelon.agents.hopper import Hopper
from echelon.benchmarks.machine import machine_name, package_versions
from echelon.benchmarks.sanity import Verdict, judge_standing
from echelon.benchmarks.timed_engine import STRIDE
from echelon.simulation.cost import peak_memory
from echelon.warp_kernels.start import start_warp

if TYPE_CHECKING:
    from echelon.benchmarks.mujoco_peer import CoordinateOrder

Row = dict[str, Any]

MUJOCO, MUJOCO_WARP = "MuJoCo", "MuJoCo Warp"
NEWTON, NEWTON_FEATHERSTONE = "Newton (MuJoCo)", "Newton (Featherstone)"

PACKAGES = {
    MUJOCO: ("mujoco",),
    MUJOCO_WARP: ("mujoco", "mujoco_warp"),
    NEWTON: ("mujoco", "mujoco_warp", "newton"),
    NEWTON_FEATHERSTONE: ("mujoco", "newton"),
}
"""Modules that each engine needs; MuJoCo compiles the model for all."""

DISTRIBUTIONS = {"mujoco": "mujoco", "mujoco_warp": "mujoco-warp", "newton": "newton"}

AGENTS = 1000
STANDING_SECONDS = 0.25  # it is set down anew after this time, before it could topple [s]
ROUNDS = 3  # the fastest counts
EXPLICIT_LADDER: Sequence[float] = (STRIDE.step, STRIDE.step / 2, STRIDE.step / 4, STRIDE.step / 8)  # [s]
CONTACTS_MOST, CONSTRAINTS_MOST = 8, 32  # of one agent, that room is made for
WHAT = "standing on its foot with springs, without control; agents do not meet"


@dataclass(frozen=True)
class Standing:
    """The body that is set down, as MuJoCo has it.

    Attributes:
        step: [s].
        spec, model: MuJoCo's.
        order: Where our coordinates stand in MuJoCo's.
        q, u: The start, in our coordinates.
    """

    step: float
    spec: Any
    model: Any
    order: CoordinateOrder
    q: np.ndarray
    u: np.ndarray

    @classmethod
    def at(cls, step: float) -> Standing:
        """Compiled for a step [s]."""
        from echelon.benchmarks.mujoco_peer import CoordinateOrder, peer_spec
        from echelon.benchmarks.peer_runs import standing_pose, standing_springs

        body = Hopper().body
        spec = peer_spec(body, springs=standing_springs(), floor=True, step=step)
        model = spec.compile()
        order = CoordinateOrder.of(body, model)
        return cls(step, spec, model, order, standing_pose(body), np.zeros(body.u_count))

    @property
    def steps(self) -> int:
        """Until it is set down anew."""
        return round(STANDING_SECONDS / self.step)

    def to_ours(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(q, u) of MuJoCo's states, shapes [..., nq] and [..., nv]."""
        q, u = np.empty_like(qpos, dtype=float), np.empty_like(qvel, dtype=float)
        q[..., self.order.qpos_from_q] = qpos
        u[..., self.order.qvel_from_u] = qvel
        return q, u


class Peer(ABC):
    """An engine, ready to be timed.

    Attributes:
        step: [s].
        integrator, precision: In words.
        contacts: Sites of one agent that can touch the floor.
    """

    step: float
    integrator: str
    precision: str
    contacts: int = 2

    @abstractmethod
    def run(self) -> float:
        """Set everybody down and simulate; how long one agent's step took [us]."""

    @abstractmethod
    def watched(self) -> tuple[np.ndarray, np.ndarray]:
        """The same of one agent, looked at after every step: q and u, shapes [steps + 1, ...]."""

    def verdict(self) -> Verdict:
        """Whether what is timed is sane."""
        from echelon.benchmarks.peer_runs import spring_stiffness, standing_springs

        body = Hopper().body
        q, u = self.watched()
        if not (np.isfinite(q).all() and np.isfinite(u).all()):
            return Verdict(False, "its state stopped being finite")
        foot = next(site for site in body.contacts if site.surface == "ground" and min(site.radii) == max(site.radii))
        poses = body.link_poses(q)[:, body.link_index(foot.link)]
        soles = poses[:, 2] + _rotated_z(poses[:, 3:7], np.array(foot.position)) - foot.radii[2]
        loaded = float(np.mean(soles[1:] <= 0.0))
        return judge_standing(body, q, u, spring_stiffness(body, standing_springs()), loaded)


def _rotated_z(quaternion: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Height of a point [m] turned by quaternions (x, y, z, w), shape [..., 4]."""
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    return (
        2.0 * (x * z - y * w) * point[0] + 2.0 * (y * z + x * w) * point[1] + (1.0 - 2.0 * (x * x + y * y)) * point[2]
    )


# ---- MuJoCo ----------------------------------------------------------------------------------------------------------
class RolloutPeer(Peer):
    """MuJoCo's own many at once."""

    integrator, precision = "euler", "float64"

    def __init__(self, agents: int, threads: int, step: float) -> None:
        import mujoco
        from mujoco.rollout import Rollout

        self.step = step
        self._standing = Standing.at(step)
        model = self._standing.model
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        self._datas = [mujoco.MjData(model) for _ in range(threads)]
        self._standing.order.write(self._datas[0], self._standing.q, self._standing.u)
        start = np.zeros(mujoco.mj_stateSize(model, full))
        mujoco.mj_getState(model, self._datas[0], start, full)
        self._starts = np.tile(start, (agents, 1))
        self._rollout = Rollout(nthread=threads if threads > 1 else 0)
        self._seen: np.ndarray = np.zeros(0)

    def run(self) -> float:
        steps = self._standing.steps
        begin = time.perf_counter()
        states, _ = self._rollout.rollout(self._standing.model, self._datas, self._starts, nstep=steps)
        seconds = time.perf_counter() - begin
        self._seen = np.concatenate([self._starts[:1], np.asarray(states)[0]])
        return seconds / (steps * len(self._starts)) * 1e6

    def watched(self) -> tuple[np.ndarray, np.ndarray]:
        self.run()
        nq = self._standing.model.nq
        # A state is the time, qpos, qvel.
        return self._standing.to_ours(self._seen[:, 1 : 1 + nq], self._seen[:, 1 + nq :][:, : self._standing.model.nv])


# ---- Warp ------------------------------------------------------------------------------------------------------------
class CapturedPeer(Peer):
    """An engine made of Warp launches, replayed as a captured graph on the CPU."""

    precision = "float32"
    steps: int
    graph_steps = 1

    def __init__(self, agents: int) -> None:
        self._agents = agents
        self._set_down()
        self._advance()  # compiles
        with wp.ScopedCapture(device="cpu") as capture:
            self._advance()
        self._graph: Any = capture.graph

    @abstractmethod
    def _set_down(self) -> None:
        """Put everybody back to the start."""

    @abstractmethod
    def _advance(self) -> None:
        """`graph_steps` steps."""

    @abstractmethod
    def _state(self) -> tuple[np.ndarray, np.ndarray]:
        """(q, u) of the first agent."""

    def run(self) -> float:
        self._set_down()
        launches = self.steps // self.graph_steps
        begin = time.perf_counter()
        for _ in range(launches):
            wp.capture_launch(self._graph)
        return (time.perf_counter() - begin) / (launches * self.graph_steps * self._agents) * 1e6

    def watched(self) -> tuple[np.ndarray, np.ndarray]:
        self._set_down()
        states = [self._state()]
        for _ in range(self.steps // self.graph_steps):
            wp.capture_launch(self._graph)
            states.append(self._state())
        q, u = zip(*states, strict=True)
        return np.stack(q), np.stack(u)


class MujocoWarpPeer(CapturedPeer):
    """MuJoCo Warp on the CPU."""

    integrator = "euler"

    def __init__(self, agents: int, step: float) -> None:
        import mujoco

        mujoco_warp: Any = import_module("mujoco_warp")
        self.step = step
        self._standing = Standing.at(step)
        self.steps = self._standing.steps
        model = self._standing.model
        data = mujoco.MjData(model)
        self._standing.order.write(data, self._standing.q, self._standing.u)
        mujoco.mj_forward(model, data)
        # It has no such thing to switch off.
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._package = mujoco_warp
        self._model = mujoco_warp.put_model(model)
        self._data = mujoco_warp.put_data(model, data, nworld=agents, nconmax=CONTACTS_MOST, njmax=CONSTRAINTS_MOST)
        self._start = {name: wp.clone(getattr(self._data, name)) for name in ("qpos", "qvel", "qacc_warmstart", "time")}
        super().__init__(agents)

    def _set_down(self) -> None:
        for name, start in self._start.items():
            wp.copy(getattr(self._data, name), start)

    def _advance(self) -> None:
        self._package.step(self._model, self._data)

    def _state(self) -> tuple[np.ndarray, np.ndarray]:
        return self._standing.to_ours(self._data.qpos.numpy()[0], self._data.qvel.numpy()[0])


class NewtonPeer(CapturedPeer):
    """Newton on the CPU."""

    graph_steps = 2  # back and forth between two states

    def __init__(self, agents: int, step: float, featherstone: bool) -> None:
        newton: Any = import_module("newton")
        self.step = step
        standing = Standing.at(step)
        self.steps = standing.steps
        self.integrator = "semi-implicit, springs explicit" if featherstone else "euler"
        one, all_ = newton.ModelBuilder(), newton.ModelBuilder()
        if not featherstone:
            newton.solvers.SolverMuJoCo.register_custom_attributes(one)
        one.add_mjcf(standing.spec.to_xml())
        all_.replicate(one, agents)
        model = all_.finalize(device="cpu")
        self._newton, self._model = newton, model
        if featherstone:
            self._solver = newton.solvers.SolverFeatherstone(model, angular_damping=0.0)
            self._collisions = newton.CollisionPipeline(model)
            self._contacts = self._collisions.contacts()
        else:
            self._solver = newton.solvers.SolverMuJoCo(model, njmax=CONSTRAINTS_MOST, nconmax=CONTACTS_MOST)
            self._collisions = self._contacts = None
        self._states = model.state(), model.state()
        self._control = model.control()
        # Its coordinates are in our order: x y z, x y z w, hip, leg; speeds start with those of the centre of mass.
        self._q = wp.array(np.tile(standing.q, agents), dtype=wp.float32, device="cpu")
        super().__init__(agents)

    def _set_down(self) -> None:
        for state in self._states:
            wp.copy(state.joint_q, self._q)
            state.joint_qd.zero_()
            self._newton.eval_fk(self._model, state.joint_q, state.joint_qd, state)

    def _advance(self) -> None:
        first, second = self._states
        for before, after in ((first, second), (second, first)):
            before.clear_forces()
            if self._collisions is not None:
                self._collisions.collide(before, self._contacts)
            self._solver.step(before, after, self._control, self._contacts, self.step)

    def _state(self) -> tuple[np.ndarray, np.ndarray]:
        count = len(self._q) // self._agents
        q = self._states[0].joint_q.numpy()[:count].astype(float)
        u = self._states[0].joint_qd.numpy()[: count - 1].astype(float)
        # Ours has the angular velocity in the body's axes. The root's centre of mass is at its origin.
        axis, w = -q[3:6], q[6]
        once = np.cross(axis, u[3:6])
        u[3:6] += 2.0 * (w * once + np.cross(axis, once))
        return q, u


# ---- rows ------------------------------------------------------------------------------------------------------------
def peer_rows(engine: str, agents: int = AGENTS, threads: Sequence[int] = (1,), rounds: int = ROUNDS) -> list[Row]:
    """Rows of one engine: for each number of threads where it has any, else for one.

    Args:
        engine: One of `PACKAGES`.
        agents: How many at once.
        threads: How many at a time.
        rounds: How often it is timed.
    """
    start_warp()
    warnings.simplefilter("ignore")  # of engines about one another
    starts: list[tuple[int, Callable[[], Peer]]]
    if engine == MUJOCO:
        starts = [(count, lambda count=count: RolloutPeer(agents, count, STRIDE.step)) for count in threads]
    elif engine == MUJOCO_WARP:
        starts = [(1, lambda: MujocoWarpPeer(agents, STRIDE.step))]
    elif engine == NEWTON:
        starts = [(1, lambda: NewtonPeer(agents, STRIDE.step, featherstone=False))]
    else:
        step = _largest_sane_step(lambda step: NewtonPeer(1, step, featherstone=True))
        starts = [(1, lambda: NewtonPeer(agents, step, featherstone=True))]
    rows = []
    for count, start in starts:
        peer = start()
        verdict = peer.verdict()
        best = min(peer.run() for _ in range(rounds))
        rows.append(_row(engine, agents, count, peer, best, verdict))
    return rows


def _largest_sane_step(start: Callable[[float], Peer]) -> float:
    """The first of the ladder's steps, from large to small, that is sane; the smallest if none is [s]."""
    return next((step for step in EXPLICIT_LADDER if start(step).verdict().sane), EXPLICIT_LADDER[-1])


def _row(engine: str, agents: int, threads: int, peer: Peer, microseconds: float, verdict: Verdict) -> Row:
    memory = peak_memory()
    return {
        "engine": engine,
        "kind": "hoppers",
        "agents": agents,
        "threads": threads,
        "scene": WHAT,
        "integrator": peer.integrator,
        "precision": peer.precision,
        "step_seconds": peer.step,
        "contacts": peer.contacts,
        "substep_us": microseconds if verdict.sane else None,
        "agent_seconds_per_second": peer.step / microseconds * 1e6 if verdict.sane else None,
        "peak_memory_mb": None if memory is None else memory / 1e6,
        "sane": verdict.sane,
        "why": verdict.why,
        "machine": machine_name(),
        "versions": f"{package_versions()}, {peer_versions(engine)}",
    }


def peer_versions(engine: str) -> str:
    """Versions of an engine's packages."""
    names = [DISTRIBUTIONS[module] for module in PACKAGES[engine]]
    return ", ".join(f"{name} {version(name)}" for name in names)


def missing(engine: str) -> str:
    """Why an engine cannot be run here; empty if it can."""
    absent = [DISTRIBUTIONS[module] for module in PACKAGES[engine] if find_spec(module) is None]
    if not absent:
        return ""
    return f"{' and '.join(absent)} not installed; `pip install 'echelon[peers]'` adds what is missing"


def main(arguments: Sequence[str]) -> None:
    """Measure what is asked for, and print the rows."""
    asked = json.loads(arguments[0])
    print(json.dumps(peer_rows(asked["engine"], asked["agents"], asked["threads"])))


if __name__ == "__main__":
    main(sys.argv[1:])
