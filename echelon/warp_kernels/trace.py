"""Scalars that remember how they were computed.

The engine's mathematics is written once, as ordinary Python over *scalars*.
A scalar is one of three things:

* a NumPy float64 array (one entry an agent): the function then simply
  computes. This is the reference implementation;
* a Python float: a constant of the body;
* an `Expr`: a node of a `Graph`. The function then builds the graph of its
  own arithmetic, from which `emit` writes straight-line code.

A graph is hash-consed (the same operation on the same operands is one node),
folds constants in float32, and drops what nothing reads. It never
reassociates: the emitted code performs the operations in the order in which
the source wrote them.

An `Expr` has no truth value. Branches are `select`, and both sides are always
computed, so the source must guard the arguments of divisions and roots.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Union

import numpy as np

Scalar = Union["Expr", np.ndarray, float]
"""What the engine's mathematics computes with."""

Mask = Union["Expr", np.ndarray, bool]
"""The outcome of a comparison: one truth value an agent."""

# Operations whose result is a mask.
MASK_OPS = frozenset({"lt", "le", "eq", "and", "or", "not"})
COMMUTATIVE_OPS = frozenset({"add", "mul", "eq", "and", "or"})

# Half-angle polynomials over |y| <= pi/2, in powers of y^2 (error of the sine 1.4e-8 of it, of the cosine 5e-10).
SIN_COEFFICIENTS = (-0.16666657957539574, 0.008333050227096996, -0.00019809012002609816, 2.605078334771971e-06)
COS_COEFFICIENTS = (
    -0.49999999355286046,
    0.04166663613752589,
    -0.0013888359836727454,
    2.4760079881530617e-05,
    -2.605002788480526e-07,
)
# atan(t)/t for 0 <= t <= 1 in powers of t^2 (relative error 1.8e-8).
ATAN_COEFFICIENTS = (
    0.9999999863667086,
    -0.3333309395707277,
    0.19993054104782637,
    -0.1420713364424044,
    0.10654677363673652,
    -0.07533676013479434,
    0.043039367437929826,
    -0.01628300778849602,
    0.002903552477748081,
)


@dataclass(frozen=True)
class Probe:
    """A named intermediate value and the source line that named it."""

    name: str
    value: Any
    source: str


class Graph:
    """An expression graph; nodes are stored in the order in which the source first needed them.

    Attributes:
        nodes: (operation, operands); operands are node indices, except for the value of a constant and the name of
            an input.
        probes: What `probe` was called with while this graph was being built.
    """

    def __init__(self) -> None:
        self.nodes: list[tuple[str, tuple[Any, ...]]] = []
        self.probes: list[Probe] = []
        self._index_of: dict[tuple[str, tuple[Any, ...]], int] = {}

    def input(self, name: str) -> Expr:
        """A value that the emitted code receives; `name` is the expression that reads it there."""
        return self._node("input", (name,))

    def constant(self, value: float) -> Expr:
        """A constant, rounded to float32."""
        with np.errstate(over="ignore"):
            rounded = np.float32(value)  # what overflows is refused when code is made of it
        if np.isnan(rounded):
            raise ValueError("a constant that is not a number reached the graph")
        # Positive and negative zero are equal as keys but are not the same number; keep one of them.
        return self._node("const", (float(rounded) + 0.0,))

    def lift(self, value: Scalar) -> Expr:
        """This value as a node of this graph."""
        if isinstance(value, Expr):
            if value.graph is not self:
                raise ValueError("an expression of another graph was mixed in")
            return value
        return self.constant(float(value))

    def apply(self, op: str, *operands: Expr) -> Expr:
        """The node for one operation, folded if its operands allow it."""
        folded = _fold(self, op, operands)
        if folded is not None:
            return folded
        indices = [operand.index for operand in operands]
        if op in COMMUTATIVE_OPS:
            indices.sort()
        return self._node(op, tuple(indices))

    def _node(self, op: str, operands: tuple[Any, ...]) -> Expr:
        key = (op, operands)
        index = self._index_of.get(key)
        if index is None:
            index = len(self.nodes)
            self.nodes.append(key)
            self._index_of[key] = index
        return Expr(self, index)


class Expr:
    """A traced scalar or mask: a node of a graph."""

    __slots__ = ("graph", "index")
    __array_ufunc__ = None  # NumPy scalars must let our operators answer

    def __init__(self, graph: Graph, index: int) -> None:
        self.graph = graph
        self.index = index

    @property
    def op(self) -> str:
        return self.graph.nodes[self.index][0]

    @property
    def constant_value(self) -> float | None:
        """The value of a constant node, None for any other."""
        op, operands = self.graph.nodes[self.index]
        return operands[0] if op == "const" else None

    def __bool__(self) -> bool:
        frame = sys._getframe(1)
        raise TypeError(
            f"a traced value was used as a truth value at {frame.f_code.co_filename}:{frame.f_lineno}; use select()"
        )

    def __add__(self, other: Scalar) -> Expr:
        return self.graph.apply("add", self, self.graph.lift(other))

    __radd__ = __add__

    def __sub__(self, other: Scalar) -> Expr:
        return self.graph.apply("sub", self, self.graph.lift(other))

    def __rsub__(self, other: Scalar) -> Expr:
        return self.graph.apply("sub", self.graph.lift(other), self)

    def __mul__(self, other: Scalar) -> Expr:
        return self.graph.apply("mul", self, self.graph.lift(other))

    __rmul__ = __mul__

    def __truediv__(self, other: Scalar) -> Expr:
        return self.graph.apply("div", self, self.graph.lift(other))

    def __rtruediv__(self, other: Scalar) -> Expr:
        return self.graph.apply("div", self.graph.lift(other), self)

    def __neg__(self) -> Expr:
        return self.graph.apply("neg", self)

    def __lt__(self, other: Scalar) -> Expr:
        return self.graph.apply("lt", self, self.graph.lift(other))

    def __le__(self, other: Scalar) -> Expr:
        return self.graph.apply("le", self, self.graph.lift(other))

    def __gt__(self, other: Scalar) -> Expr:
        return self.graph.apply("lt", self.graph.lift(other), self)

    def __ge__(self, other: Scalar) -> Expr:
        return self.graph.apply("le", self.graph.lift(other), self)

    def __and__(self, other: Mask) -> Expr:
        # There are no constant masks: a mask and its opposite hold never, one or the other always.
        other = other if isinstance(other, Expr) else self if bool(other) else ~self
        return self if other is self else self.graph.apply("and", self, other)

    __rand__ = __and__

    def __or__(self, other: Mask) -> Expr:
        other = other if isinstance(other, Expr) else ~self if bool(other) else self
        return self if other is self else self.graph.apply("or", self, other)

    __ror__ = __or__

    def __invert__(self) -> Expr:
        return self.graph.apply("not", self)


# ---- functions of scalars ----------------------------------------------------------------------------------------
def select(condition: Mask, if_true: Scalar, if_false: Scalar) -> Any:
    """``if_true`` where ``condition`` holds, else ``if_false``; both are computed."""
    if isinstance(condition, Expr):
        graph = condition.graph
        return graph.apply("select", condition, graph.lift(if_true), graph.lift(if_false))
    if isinstance(condition, bool):
        return if_true if condition else if_false
    return np.where(condition, if_true, if_false)  # type: ignore[arg-type]


def equal(a: Scalar, b: Scalar) -> Any:
    """Whether two scalars are equal (state numbers; never for results of rounding)."""
    if isinstance(a, Expr):
        return a.graph.apply("eq", a, a.graph.lift(b))
    return np.equal(a, b)  # type: ignore[arg-type]


def logical_not(condition: Mask) -> Any:
    """The opposite of a mask."""
    return ~condition if isinstance(condition, Expr) else np.logical_not(condition)  # type: ignore[arg-type]


def minimum(a: Scalar, b: Scalar) -> Any:
    """The smaller; ``b`` if either is not a number."""
    return select(_less(a, b), a, b)


def maximum(a: Scalar, b: Scalar) -> Any:
    """The larger; ``b`` if either is not a number."""
    return select(_less(b, a), a, b)


def clamp(value: Scalar, lower: Scalar, upper: Scalar) -> Any:
    """``value`` held between ``lower`` and ``upper``."""
    return minimum(maximum(value, lower), upper)


def sqrt(x: Scalar) -> Any:
    """Square root; the caller guards against negative arguments."""
    return x.graph.apply("sqrt", x) if isinstance(x, Expr) else np.sqrt(x)


def absolute(x: Scalar) -> Any:
    """Absolute value."""
    return x.graph.apply("abs", x) if isinstance(x, Expr) else np.abs(x)


def floor(x: Scalar) -> Any:
    """Largest whole number not above x."""
    return x.graph.apply("floor", x) if isinstance(x, Expr) else np.floor(x)


def sincos(x: Scalar) -> tuple[Any, Any]:
    """Sine and cosine of an angle [rad]; traced, good to float32 for any angle of a few turns."""
    if not isinstance(x, Expr):
        return np.sin(x), np.cos(x)
    turns = floor(x * (0.5 / np.pi) + 0.5)
    half = (x - turns * (2.0 * np.pi)) * 0.5
    square = half * half
    sine = half + half * square * _horner(square, SIN_COEFFICIENTS)
    cosine = 1.0 + square * _horner(square, COS_COEFFICIENTS)
    twice = sine + sine
    return twice * cosine, 1.0 - twice * sine


def atan2(y: Scalar, x: Scalar) -> Any:
    """Angle of the vector (x, y) [rad]; zero for the zero vector."""
    if not isinstance(x, Expr) and not isinstance(y, Expr):
        return np.arctan2(y, x)
    size_x, size_y = absolute(x), absolute(y)
    larger, smaller = maximum(size_x, size_y), minimum(size_x, size_y)
    tangent = smaller / maximum(larger, 1e-30)
    angle = tangent * _horner(tangent * tangent, ATAN_COEFFICIENTS)
    angle = select(_less(size_x, size_y), 0.5 * np.pi - angle, angle)
    angle = select(_less(x, 0.0), np.pi - angle, angle)
    return select(_less(y, 0.0), -angle, angle)


def asin(x: Scalar) -> Any:
    """Arc sine of a value between -1 and 1 (held there) [rad]."""
    x = clamp(x, -1.0, 1.0)
    return atan2(x, sqrt(maximum(1.0 - x * x, 0.0)))


def guarded(condition: Mask, values: Sequence[Scalar]) -> list[Any]:
    """``values`` where ``condition`` holds, else zeros, for what is rarely needed.

    Means the same as a `select` of each value, but emitted code skips the arithmetic that only these values need
    unless the condition holds for some agent of a block. What an agent gets does not depend on the others.
    """
    if isinstance(condition, Expr):
        graph = condition.graph
        return [graph.apply("guard", condition, graph.lift(value)) for value in values]
    return [select(condition, value, 0.0) for value in values]


def probe(name: str, value: Scalar) -> None:
    """Name an intermediate value, to be compared between the reference and the lanes (see `record_probes`)."""
    frame = sys._getframe(1)
    entry = Probe(name, value, f"{frame.f_code.co_filename}:{frame.f_lineno}")
    if isinstance(value, Expr):
        value.graph.probes.append(entry)
    recorder = _recorder.get()
    if recorder is not None:
        recorder.append(entry)


@contextmanager
def record_probes() -> Iterator[list[Probe]]:
    """Collect what `probe` is called with, while NumPy computes or a graph is built."""
    entries: list[Probe] = []
    token = _recorder.set(entries)
    try:
        yield entries
    finally:
        _recorder.reset(token)


_recorder: ContextVar[list[Probe] | None] = ContextVar("probe_recorder", default=None)


def _less(a: Scalar, b: Scalar) -> Any:
    if isinstance(a, Expr):
        return a < b
    if isinstance(b, Expr):
        return b > a
    return np.less(a, b)


def _horner(x: Scalar, coefficients: tuple[float, ...]) -> Any:
    total: Any = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total


# ---- folding -----------------------------------------------------------------------------------------------------
def _fold(graph: Graph, op: str, operands: tuple[Expr, ...]) -> Expr | None:
    """The simpler node that an operation amounts to, or None.

    ``0 * x`` folds to 0 as if x were finite: a structural zero of a body stays one even beside a state that has
    diverged, which is caught elsewhere.
    """
    values = [operand.constant_value for operand in operands]
    if op in ("add", "sub", "mul", "div") and None not in values:
        a, b = np.float32(values[0]), np.float32(values[1])  # type: ignore[arg-type]
        match op:
            case "add":
                return graph.constant(float(a + b))
            case "sub":
                return graph.constant(float(a - b))
            case "mul":
                return graph.constant(float(a * b))
            case _:
                return graph.constant(float(a / b))
    match op:
        case "add":
            return _fold_add(operands, values)
        case "sub":
            return _fold_sub(graph, operands, values)
        case "mul":
            return _fold_mul(graph, operands, values)
        case "div":
            if values[0] == 0.0:
                return graph.constant(0.0)
            if values[1] == 1.0:
                return operands[0]
        case "neg":
            if values[0] is not None:
                return graph.constant(-values[0])
            if operands[0].op == "neg":
                return Expr(graph, graph.nodes[operands[0].index][1][0])
        case "sqrt":
            if values[0] is not None:
                return graph.constant(float(np.sqrt(np.float32(values[0]))))
        case "abs":
            if values[0] is not None:
                return graph.constant(abs(values[0]))
        case "select":
            if operands[1].index == operands[2].index:
                return operands[1]
        case "guard":
            if values[1] == 0.0:
                return operands[1]
        case "not":
            if operands[0].op == "not":
                return Expr(graph, graph.nodes[operands[0].index][1][0])
        case "lt" | "le" if None not in values:
            raise ValueError("a comparison of two constants reached the graph: decide it in Python")
    return None


def _negated(operand: Expr) -> Expr | None:
    """x if the operand is -x."""
    op, args = operand.graph.nodes[operand.index]
    return Expr(operand.graph, args[0]) if op == "neg" else None


def _fold_add(operands: tuple[Expr, ...], values: list[float | None]) -> Expr | None:
    a, b = operands
    if values[0] == 0.0:
        return b
    if values[1] == 0.0:
        return a
    if (inner := _negated(b)) is not None:
        return a - inner
    if (inner := _negated(a)) is not None:
        return b - inner
    return None


def _fold_sub(graph: Graph, operands: tuple[Expr, ...], values: list[float | None]) -> Expr | None:
    a, b = operands
    if values[1] == 0.0:
        return a
    if values[0] == 0.0:
        return -b
    if a.index == b.index:
        return graph.constant(0.0)
    if (inner := _negated(b)) is not None:
        return a + inner
    return None


def _fold_mul(graph: Graph, operands: tuple[Expr, ...], values: list[float | None]) -> Expr | None:
    for this, other in ((0, 1), (1, 0)):
        if values[this] == 0.0:
            return graph.constant(0.0)
        if values[this] == 1.0:
            return operands[other]
        if values[this] == -1.0:
            return -operands[other]
    first, second = _negated(operands[0]), _negated(operands[1])
    if first is not None and second is not None:
        return first * second
    # Signs move outwards so that products of the same factors are found to be the same node.
    if first is not None:
        return -(first * operands[1])
    if second is not None:
        return -(operands[0] * second)
    return None
