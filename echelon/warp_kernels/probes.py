"""Where do the lanes leave the reference? Probes of both, side by side.

Source that is traced may name intermediate values with `trace.probe`. Code that runs does not carry them. Asked for,
one control tick and one substep are evaluated twice from the state of a `ReferenceRun`, in float64 by NumPy and in
float32 by native code that was emitted for the probes alone, and the first value on which they differ is reported with
the line of source that named it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from echelon.warp_kernels.character import AgentState, View
from echelon.warp_kernels.kinematics import kinematics
from echelon.warp_kernels.native import NativeFunction
from echelon.warp_kernels.program import evaluate_substep
from echelon.warp_kernels.reference_run import Divergence, ReferenceRun, diverging_probe
from echelon.warp_kernels.trace import MASK_OPS, Expr, Probe, record_probes, select


def divergence_of_lanes(run: ReferenceRun, tolerance: float = 1e-5, lanes: int = 8) -> Divergence | None:
    """The first probe at which native code leaves the reference within a tick and a substep of the present state."""
    return diverging_probe(reference_probes(run), lane_probes(run, lanes), tolerance)


def reference_probes(run: ReferenceRun) -> list[Probe]:
    """What the probes see in a control tick and a substep of the present state, in float64; the run stays as it is."""
    with record_probes() as entries:
        _tick_and_substep(run, run.state, run.parameters, run.command, run.planes)
    return entries


def lane_probes(run: ReferenceRun, lanes: int = 8) -> list[Probe]:
    """The same from native code in float32, emitted for the purpose."""
    state = run.state
    values = [
        *state.q,
        *state.u,
        *(x for strain in state.strains for x in strain),
        *state.memory.values(),
        state.substep,
    ]
    values += [*run.parameters.values(), *run.command.values(), *(x for plane in run.planes for x in plane)]
    entries: list[Probe] = []

    def probed(inputs: list[Any]) -> list[Any]:
        remaining = iter(inputs)
        traced = AgentState(
            q=[next(remaining) for _ in state.q],
            u=[next(remaining) for _ in state.u],
            strains=[[next(remaining) for _ in strain] for strain in state.strains],
            memory={name: next(remaining) for name in state.memory},
            substep=next(remaining),
        )
        parameters = {name: next(remaining) for name in run.parameters}
        command = {name: next(remaining) for name in run.command}
        planes = [[next(remaining) for _ in plane] for plane in run.planes]
        with record_probes() as found:
            _tick_and_substep(run, traced, parameters, command, planes)
        entries.extend(found)
        return [_number(entry.value) for entry in found]

    native = NativeFunction(probed, len(values), lanes)
    columns = [np.broadcast_to(np.asarray(value, dtype=float), (run.agent_count,)) for value in values]
    results = native(np.stack(columns, axis=1))
    return [replace(entry, value=results[:, i]) for i, entry in enumerate(entries)]


def _tick_and_substep(
    run: ReferenceRun,
    state: AgentState,
    parameters: dict[str, Any],
    command: dict[str, Any],
    planes: Sequence[Sequence[Any]],
) -> None:
    character, step, tick = run.character, run.step, run.tick * run.step
    kin = kinematics(character.body.tree, state.q, state.u)
    view = View(
        state.q, state.u, kin, dict(state.memory), parameters, command, state.substep, step, tick, step
    )  # fmt: skip
    character.control(view)
    decided = AgentState(state.q, state.u, state.strains, view.memory, state.substep)
    implicit = step if run.integrator == "semi-implicit" else 0.0
    evaluate_substep(character, decided, parameters, command, planes, step, tick, implicit, implicit)


def _number(value: Any) -> Any:
    """A probed value as a number: of a mask one or zero."""
    if isinstance(value, Expr) and value.op in MASK_OPS:
        return select(value, 1.0, 0.0)
    return value
