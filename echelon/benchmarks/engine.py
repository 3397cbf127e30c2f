"""`echelon bench engine`: the engine against MuJoCo, same bodies, same run, one core.

* The **hopper**'s whole substep (control, contact, dynamics, integration) while it hops, against a MuJoCo step of its
  body on its foot, with leg spring, hip springs and contact, but without control.
* The **cyclist**'s whole substep (control, two wheels on a road that is looked up in its quadtree, the springs at
  hands and feet, the chain, dynamics, integration) while it rides, against a MuJoCo step of its body that rolls on a
  plane, with constraints at hands and feet and for the chain, and springs for servos, but without control.
* The **gymnast**'s whole substep (script, balance, a servo at every joint, 12 points of the soles loaded and 19 more
  that meet the ground in a fall, dynamics of 53 degrees of freedom, integration) while it stands, against a MuJoCo step
  of its body that stands on 12 spheres on a plane, with springs of the servos' gains at its joints, without control.
* **male**, **female** and other bodies: servos and dynamics in free flight, against MuJoCo with springs and dampers
  at the joints, contact off.

Both engines take turns, round by round, so that a machine that grows slower slows both; what is reported are medians.
MuJoCo may use whichever of its integrators is the fastest that is sane. Since a rate per step rewards small steps,
there is a second measure: each engine at its **largest sane step**, found on a short ladder, and how many seconds of
one agent's life a second of computing gives. A run that is not sane (see `sanity`) has no rate; the row says why.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.riders.cyclist import Cyclist
from echelon.agents.servo import ServoedBody
from echelon.benchmarks.compile_time import compile_time
from echelon.benchmarks.engine_runs import CYCLIST, GYMNAST, HOPPER, character_of, start_run, stride_of
from echelon.benchmarks.gymnast_run import STANDING_STRIDE
from echelon.benchmarks.machine import machine_name, package_versions
from echelon.benchmarks.riding_run import RIDING_STRIDE
from echelon.benchmarks.sanity import Verdict
from echelon.benchmarks.timed_engine import STRIDE, Run, Stride
from echelon.errors import InputError
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.program import Integrator

if TYPE_CHECKING:
    from echelon.benchmarks.peer_runs import PeerRun

Progress = Callable[[int, int], None]

SAME_STEP, LARGEST_STEP = "same step", "largest sane step"
"""What a row measures: both engines at one step, or each at its own largest."""

BODIES = (HOPPER, CYCLIST, GYMNAST, "male", "female")
AGENTS = 512
ROUNDS = 20  # of a second each
QUICK_AGENTS = 64
QUICK_ROUNDS = 10
TRIAL_AGENTS = 96  # on the ladder
TRIAL_ROUNDS = 10
CHOOSING_ROUNDS = 3  # in which MuJoCo's integrators compete

LADDER = (STRIDE, Stride(16, 4), Stride(8, 2))
"""From small steps to large, all with the control ticks of scenarios: 120 a second, riders' 90."""
RIDING_LADDER = (RIDING_STRIDE, Stride(27, 9), Stride(24, 8), Stride(21, 7), Stride(18, 6))
FLIGHT_LADDER = (STRIDE, Stride(16, 2), Stride(10, 1), Stride(8, 1), Stride(4, 1))
STANDING_LADDER = (STANDING_STRIDE, Stride(30, 3), Stride(24, 3))
RUNGE_KUTTA_STRIDE = Stride(40, 5)  # a step at which MuJoCo's is stable too
PEER_LADDER = (1 / 720, 1 / 480, 1 / 300, 1 / 240, 1 / 180, 1 / 120)
"""Of MuJoCo where there is control: a step longer than a tick would let it act less often [s]."""
PEER_FLIGHT_LADDER = (*PEER_LADDER, 1 / 60)

PEER_INTEGRATORS = ("euler", "plain euler", "implicitfast", "discrete")  # those of our default's order and cost
NO_PEER = "MuJoCo is not installed; `pip install 'echelon[bench]'` adds it"


def run_engine_benchmark(
    *, bodies: Sequence[str] = BODIES, quick: bool = False, progress: Progress | None = None
) -> list[dict[str, Any]]:
    """Measure the engine, and MuJoCo beside it where it is installed.

    Args:
        bodies: Names of bodies, or paths that `load_body` takes.
        quick: Few agents, no ladder of steps, no Runge-Kutta, no compile times.
        progress: Called with (measurements done, of how many).

    Returns:
        Rows of plain data, ready for JSON; times in microseconds of one agent's substep (`substep_us`) and of one
        MuJoCo step (`peer_step_us`), `ratio` the second over the first, `real_time_factor` seconds of one agent's
        life in a second. What could not be measured is None, and `why` or `peer_why` says why.

    Raises:
        InputError: If there is no such body.
    """
    characters = {name: character_of(name) for name in bodies}
    jobs = [(name, job) for name in characters for job in _jobs(name, quick)]
    rows: list[dict[str, Any]] = []
    if progress is not None:
        progress(0, len(jobs))
    for done, (name, job) in enumerate(jobs):
        rows = job(name, characters[name], rows)
        if progress is not None:
            progress(done + 1, len(jobs))
    return rows


Job = Callable[[str, Character, list[dict[str, Any]]], list[dict[str, Any]]]


def _jobs(name: str, quick: bool) -> list[Job]:
    if quick:
        return [_rate_quickly]
    return [_rate, *([_rate_of_runge_kutta] if name == HOPPER else []), _rate_at_largest_steps, _add_compile_time]


def _rate_quickly(name: str, character: Character, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    stride = stride_of(character)
    return [*rows, engine_row(name, character, agents=QUICK_AGENTS, rounds=QUICK_ROUNDS, stride=stride)]


def _rate(name: str, character: Character, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [*rows, engine_row(name, character, stride=stride_of(character))]


def _rate_of_runge_kutta(name: str, character: Character, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [*rows, engine_row(name, character, stride=RUNGE_KUTTA_STRIDE, integrator="rk4")]


def _rate_at_largest_steps(name: str, character: Character, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    ladder, peer_ladder = ladders_of(character)
    stride = largest_sane_stride(character, ladder)
    peers = _peers_at_largest_steps(character, peer_ladder)
    return [*rows, engine_row(name, character, stride=stride, peers=peers, measure=LARGEST_STEP)]


def _add_compile_time(name: str, character: Character, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    spent, step = compile_time(name), stride_of(character).step
    return [
        {**row, "compile_seconds": spent.fresh, "load_seconds": spent.cached}
        if row["body"] == name and row["integrator"] == "semi-implicit" and row["step_seconds"] == step
        else row
        for row in rows
    ]


# ---- one row ---------------------------------------------------------------------------------------------------------
def engine_row(
    name: str,
    character: Character,
    *,
    agents: int = AGENTS,
    rounds: int = ROUNDS,
    stride: Stride = STRIDE,
    integrator: Integrator = "semi-implicit",
    peers: Sequence[PeerRun] | None = None,
    measure: str = SAME_STEP,
) -> dict[str, Any]:
    """Race one character against MuJoCo and judge both.

    Args:
        name: What the row calls the body.
        character: Who is timed.
        agents: How many at once.
        rounds: Rounds of a second each.
        stride: How a frame is divided.
        integrator: Ours.
        peers: MuJoCo's runs to choose from; those at our step if not given. None that is sane: no comparison.
        measure: What the row calls its choice of steps.
    """
    run = start_run(character, agents, stride, integrator)
    if peers is None:
        peers = _peers_at(character, stride.step, integrator)
    judged = [(peer, peer.verdict()) for peer in peers]
    peer = _fastest([peer for peer, verdict in judged if verdict.sane])
    ours, theirs = _take_turns(run, peer, rounds)
    verdict = run.verdict()
    peer_verdict = next((found for other, found in judged if other is peer), judged[0][1] if judged else None)
    program = run.engine.program
    row = {
        "body": name,
        "measure": measure,
        "integrator": integrator,
        "precision": "float32",
        "step_seconds": stride.step,
        "tick_seconds": stride.tick * stride.step,
        "lanes": run.engine.lanes,
        "threads": 1,
        "agents": agents,
        "contacts": len(character.body.contacts),
        "actions": _actions(name),
        "operations": program.substep_operations,
        "substep_us": ours if verdict.sane else None,
        "real_time_factor": stride.step / ours * 1e6 if verdict.sane else None,
        "sane": verdict.sane,
        "why": verdict.why,
        **_peer_columns(peer, theirs, peer_verdict),
        "ratio": theirs / ours if verdict.sane and peer is not None else None,
        "compile_seconds": None,
        "load_seconds": None,
        "machine": machine_name(),
        "versions": package_versions(),
    }
    run.engine.close()
    return row


def _peer_columns(peer: PeerRun | None, microseconds: float, verdict: Verdict | None) -> dict[str, Any]:
    installed = find_spec("mujoco") is not None
    return {
        "peer": f"MuJoCo {version('mujoco')}" if installed else None,
        "peer_integrator": None if peer is None else peer.integrator,
        "peer_precision": "float64" if installed else None,
        "peer_step_seconds": None if peer is None else peer.step,
        "peer_contacts": None if peer is None else peer.contacts,
        "peer_step_us": None if peer is None else microseconds,
        "peer_real_time_factor": None if peer is None else peer.step / microseconds * 1e6,
        "peer_sane": None if verdict is None else verdict.sane,
        "peer_why": (NO_PEER if not installed else "no integrator to compare with") if verdict is None else verdict.why,
    }


def _take_turns(run: Run, peer: PeerRun | None, rounds: int) -> tuple[float, float]:
    """Medians of what a substep of ours and a step of MuJoCo's take [us]; the latter is nan without a peer."""
    ours, theirs = [], []
    run.round()  # the first one warms caches
    for _ in range(rounds):
        ours.append(run.round())
        if peer is not None:
            theirs.append(peer.round())
    return statistics.median(ours), statistics.median(theirs) if theirs else float("nan")


def _fastest(peers: Sequence[PeerRun]) -> PeerRun | None:
    """Who gets farthest in a second, each in its best round: what disturbs one can only slow it."""
    times: list[list[float]] = [[] for _ in peers]
    for _ in range(CHOOSING_ROUNDS):
        for peer, found in zip(peers, times, strict=True):
            found.append(peer.round())
    rates = [peer.step / min(found) for peer, found in zip(peers, times, strict=True)]
    return peers[rates.index(max(rates))] if rates else None


# ---- who and how -----------------------------------------------------------------------------------------------------
def _peers_at(character: Character, step: float, integrator: Integrator) -> list[PeerRun]:
    """MuJoCo at one step with each integrator that is comparable; none where it is not installed."""
    if find_spec("mujoco") is None:
        return []
    from echelon.benchmarks.mujoco_peer import INTEGRATORS
    from echelon.benchmarks.peer_runs import start_peer

    allowed = ("rk4",) if integrator == "rk4" else PEER_INTEGRATORS
    return [start_peer(character, step, name) for name in allowed if name in INTEGRATORS]


def _peers_at_largest_steps(character: Character, ladder: Sequence[float]) -> list[PeerRun]:
    """MuJoCo with each integrator at the last step of the ladder before the first that is not sane."""
    largest: dict[str, PeerRun] = {}
    failed: set[str] = set()
    for step in ladder:
        for peer in _peers_at(character, step, "semi-implicit"):
            if peer.integrator not in failed and peer.verdict().sane:
                largest[peer.integrator] = peer
            else:
                failed.add(peer.integrator)
    return list(largest.values())


def ladders_of(character: Character) -> tuple[Sequence[Stride], Sequence[float]]:
    """Our steps for a character, from small to large, and MuJoCo's [s]."""
    if isinstance(character, ServoedBody):
        return FLIGHT_LADDER, PEER_FLIGHT_LADDER
    if isinstance(character, Gymnast):
        return STANDING_LADDER, PEER_LADDER
    return RIDING_LADDER if isinstance(character, Cyclist) else LADDER, PEER_LADDER


def largest_sane_stride(character: Character, ladder: Sequence[Stride]) -> Stride:
    """The last rung of a ladder of growing steps before the first that is not sane; the first if none is."""
    largest = ladder[0]
    for stride in ladder:
        try:
            run = start_run(character, TRIAL_AGENTS, stride, "semi-implicit")
        except InputError:
            # The engine itself refuses a step that the body's springs and contacts are too stiff for.
            break
        for _ in range(TRIAL_ROUNDS):
            run.round()
        sane = run.verdict().sane
        run.engine.close()
        if not sane:
            break
        largest = stride
    return largest


def _actions(name: str) -> str:
    if name == HOPPER:
        return "hopping at 0, 1 and 2 m/s in all directions"
    if name == CYCLIST:
        return "riding at 6 m/s on a rolling road; MuJoCo: rolling unsteered from 6 m/s for 0.5 s, again and again"
    if name == GYMNAST:
        return "standing, held by balance; MuJoCo: set down on its feet for 0.25 s, again and again"
    return "servos holding a pose in free flight"
