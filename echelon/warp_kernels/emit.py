"""From an expression graph to straight-line native code.

One statement a node, in the order in which the source computed it, in static single assignment. On a CPU a value is
a vector of agents (`lanes`, one agent a lane), on a GPU one float; the statements are the same. Multiply-adds are
written as explicit fused operations and the compiler is told to contract nothing by itself, so that neither the
number of lanes nor the compiler's mood changes a bit of the result.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from echelon.warp_kernels.trace import MASK_OPS, Expr, Graph

INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "eq": "==", "and": "&", "or": "|"}


@dataclass(frozen=True)
class Target:
    """What the code is emitted for.

    Attributes:
        lanes: Agents a value holds: 8 or 16 on a CPU, 1 on a GPU or for scalar code.
        cuda: Whether it is CUDA.
    """

    lanes: int
    cuda: bool = False

    @property
    def preamble(self) -> str:
        """Type names that the statements use."""
        if self.lanes == 1:
            return "typedef float lanes; typedef float lanes_in_memory; typedef int mask;\n"
        # Memory need not be aligned to a whole vector: unaligned loads cost nothing where it happens to be.
        return (
            f"typedef float lanes __attribute__((ext_vector_type({self.lanes})));\n"
            f"typedef float lanes_in_memory __attribute__((ext_vector_type({self.lanes}), aligned(4)));\n"
            f"typedef int mask __attribute__((ext_vector_type({self.lanes})));\n"
        )

    def any_lane(self, mask: str) -> str:
        """Whether a mask holds for some agent of the block."""
        return mask if self.lanes == 1 else f"__builtin_reduce_or({mask})"

    def function(self, name: str) -> str:
        """Spelling of fma, sqrt, floor or abs."""
        if self.cuda:
            return {"fma": "fmaf", "sqrt": "sqrtf", "floor": "floorf", "abs": "fabsf"}[name]
        return f"__builtin_elementwise_{name}"


def host_lanes() -> int:
    """How many agents this machine's vectors hold: 16 with AVX-512, 8 with AVX2, 4 elsewhere."""
    flags = _cpu_flags()
    if "avx512f" in flags:
        return 16
    if "avx2" in flags:
        return 8
    return 4


def cpu_compiler_flags(lanes: int) -> str:
    """Flags for Warp's CPU compiler; only those that this machine's compiler knows."""
    flags = "-ffp-contract=off"
    if platform.machine().lower() in ("x86_64", "amd64"):
        flags += " -march=native"
        if lanes == 16:
            flags += " -mprefer-vector-width=512"
    return flags


def _cpu_flags() -> frozenset[str]:
    try:
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as lines:
            for line in lines:
                if line.startswith("flags"):
                    return frozenset(line.partition(":")[2].split())
    except OSError:
        # Not Linux: no list of features to read, so promise nothing beyond the baseline.
        return frozenset()
    return frozenset()


def statements(graph: Graph, outputs: Sequence[tuple[str, Expr]], target: Target, prefix: str = "t") -> str:
    """Code that computes the outputs and then assigns them.

    Args:
        graph: The graph; inputs are spelled as they were named.
        outputs: (place to assign to, value). All values are computed before the first is assigned, so a place may
            also be an input.
        prefix: Start of the temporaries' names; differs between blocks in one scope.
    """
    roots = [value.index for _, value in outputs]
    live = _live(graph, roots)
    uses = _use_counts(graph, live, roots)
    fused = _fused_products(graph, live, uses)
    absorbed = set(fused.values())
    groups = _guard_groups(graph, live, roots)
    hidden = {index for group in groups.values() for index in group.inside}

    def name(index: int) -> str:
        op, operands = graph.nodes[index]
        if op == "const":
            return f"(lanes)({_literal(operands[0])})"
        return f"{prefix}{index}"

    def statement(index: int) -> str:
        kind = "mask" if graph.nodes[index][0] in MASK_OPS else "lanes"
        return f"const {kind} {prefix}{index} = {_expression(graph, index, fused, name, target)};"

    def is_statement(index: int) -> bool:
        return graph.nodes[index][0] not in ("const", "guard") and index not in absorbed

    lines: list[str] = []
    opened: set[int] = set()
    for index in live:
        op, operands = graph.nodes[index]
        if op == "guard" and operands[0] not in opened:
            opened.add(operands[0])
            group = groups[operands[0]]
            lines += [f"lanes {prefix}{guard} = (lanes)(0.0f);" for guard in group.guards]
            lines.append(f"if ({target.any_lane(name(operands[0]))}) {{")
            lines += [statement(inner) for inner in group.inside if is_statement(inner)]
            for guard in group.guards:
                value = name(graph.nodes[guard][1][1])
                lines.append(f"{prefix}{guard} = ({name(operands[0])} ? {value} : (lanes)(0.0f));")
            lines.append("}")
        elif is_statement(index) and index not in hidden:
            lines.append(statement(index))
    lines += [f"{place} = {name(value.index)};" for place, value in outputs]
    return "\n".join(lines) + "\n"


def operation_count(graph: Graph, outputs: Iterable[Expr]) -> int:
    """How many operations an evaluation usually takes: a fused multiply-add is one, what is guarded is none."""
    roots = [value.index for value in outputs]
    live = _live(graph, roots)
    fused = _fused_products(graph, live, _use_counts(graph, live, roots))
    hidden = {index for group in _guard_groups(graph, live, roots).values() for index in group.inside}
    counted = [index for index in live if graph.nodes[index][0] not in ("const", "input") and index not in hidden]
    return len(counted) - sum(index not in hidden for index in fused)


@dataclass(frozen=True)
class _GuardGroup:
    """Guards of one condition and the nodes that nothing else needs."""

    guards: tuple[int, ...]
    inside: tuple[int, ...]


def _guard_groups(graph: Graph, live: Sequence[int], roots: Sequence[int]) -> dict[int, _GuardGroup]:
    """For each guarding condition, what can be skipped where it holds for nobody."""
    guards: dict[int, list[int]] = {}
    for index in live:
        op, operands = graph.nodes[index]
        if op == "guard":
            guards.setdefault(operands[0], []).append(index)
    if not guards:
        return {}
    # What is needed whatever the conditions say, or by more than one of them, stays outside.
    outside = set(_live(graph, roots, through_guards=False))
    reached = {
        condition: set(_live(graph, (graph.nodes[guard][1][1] for guard in members), through_guards=False)) - outside
        for condition, members in guards.items()
    }
    shared = {index for index in live if sum(index in nodes for nodes in reached.values()) > 1}
    outside |= set(_live(graph, shared, through_guards=False))
    groups: dict[int, _GuardGroup] = {}
    for condition, members in guards.items():
        inside = tuple(sorted(reached[condition] - outside))
        for index in inside:
            op, operands = graph.nodes[index]
            if op == "guard":
                raise ValueError("a guarded value needs another guarded value: guard both by one condition")
            late = [i for i in operands if op not in ("const", "input") and i not in inside and i >= members[0]]
            if late:
                raise ValueError("guards of one condition must be made together")
        groups[condition] = _GuardGroup(tuple(members), inside)
    return groups


def _use_counts(graph: Graph, live: Sequence[int], roots: Sequence[int]) -> list[int]:
    uses = [0] * len(graph.nodes)
    for index in live:
        op, operands = graph.nodes[index]
        if op not in ("const", "input"):
            for operand in operands:
                uses[operand] += 1
    for index in roots:
        uses[index] += 1
    return uses


def _live(graph: Graph, roots: Iterable[int], through_guards: bool = True) -> list[int]:
    """Indices of all nodes that the roots need, ascending; of a guard only its condition, if so asked."""
    seen: set[int] = set()
    stack = list(roots)
    while stack:
        index = stack.pop()
        if index in seen:
            continue
        seen.add(index)
        op, operands = graph.nodes[index]
        if op == "guard" and not through_guards:
            stack.append(operands[0])
        elif op not in ("const", "input"):
            stack.extend(operands)
    return sorted(seen)


def _fused_products(graph: Graph, live: Sequence[int], uses: Sequence[int]) -> dict[int, int]:
    """For each sum or difference that becomes a multiply-add, the product that it takes in."""
    fused: dict[int, int] = {}
    for index in live:
        op, operands = graph.nodes[index]
        if op not in ("add", "sub"):
            continue
        # The later operand first: it is the product that was just computed.
        for operand in sorted(operands, reverse=True):
            if graph.nodes[operand][0] == "mul" and uses[operand] == 1:
                fused[index] = operand
                break
    return fused


def _expression(graph: Graph, index: int, fused: dict[int, int], name: Callable[[int], str], target: Target) -> str:
    op, operands = graph.nodes[index]
    if index in fused:
        product = fused[index]
        a, b = (name(i) for i in graph.nodes[product][1])
        rest = operands[0] if operands[1] == product else operands[1]
        if op == "add":
            return f"{target.function('fma')}({a}, {b}, {name(rest)})"
        if operands[1] == product:
            return f"{target.function('fma')}(-{a}, {b}, {name(rest)})"
        return f"{target.function('fma')}({a}, {b}, -{name(rest)})"
    if op == "input":
        return operands[0]
    if op in INFIX:
        return f"({name(operands[0])} {INFIX[op]} {name(operands[1])})"
    if op == "neg":
        return f"-{name(operands[0])}"
    if op == "not":
        return f"({name(operands[0])} == 0)"
    if op == "select":
        return f"({name(operands[0])} ? {name(operands[1])} : {name(operands[2])})"
    return f"{target.function(op)}({name(operands[0])})"


def _literal(value: float) -> str:
    """A float literal that loses nothing: hexadecimal."""
    if value in (float("inf"), float("-inf")):
        raise ValueError("an infinite constant reached the code")
    return f"{value.hex()}f"
