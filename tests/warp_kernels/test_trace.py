"""Traced scalars: what folds, what does not, and that emitted code computes what NumPy computes."""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from engine_scenes import emitted

from echelon.warp_kernels.emit import Target, operation_count, statements
from echelon.warp_kernels.trace import (
    ATAN_COEFFICIENTS,
    COS_COEFFICIENTS,
    SIN_COEFFICIENTS,
    Expr,
    Graph,
    absolute,
    asin,
    atan2,
    clamp,
    equal,
    floor,
    guarded,
    logical_not,
    maximum,
    minimum,
    probe,
    record_probes,
    select,
    sincos,
    sqrt,
)

EPS = 2.0**-24  # half a unit in the last place of a float32 one


@pytest.fixture
def graph() -> Graph:
    return Graph()


@pytest.fixture
def x(graph: Graph) -> Expr:
    return graph.input("x")


@pytest.fixture
def y(graph: Graph) -> Expr:
    return graph.input("y")


def same(a: Expr, b: Expr) -> bool:
    return a.graph is b.graph and a.index == b.index


# ---- folding and hash-consing ----------------------------------------------------------------------------------------
def test_the_same_operation_on_the_same_operands_is_one_node(graph: Graph, x: Expr, y: Expr):
    first = (x + y) * (x - y)
    count = len(graph.nodes)
    again = (y + x) * (x - y)  # sums and products commute
    assert same(first, again)
    assert len(graph.nodes) == count
    assert not same(x - y, y - x)
    assert same(graph.input("x"), x)


def test_nothing_is_reassociated(x: Expr, y: Expr):
    z = x.graph.input("z")
    assert not same((x + y) + z, x + (y + z))
    assert not same((x * y) * z, x * (y * z))
    assert not same(x * y + x * z, x * (y + z))
    assert not same((x + y) - y, x)


@pytest.mark.parametrize(
    ("folded", "expected"),
    [
        (lambda x, y: x + 0.0, lambda x, y: x),
        (lambda x, y: 0 + x, lambda x, y: x),
        (lambda x, y: x - 0.0, lambda x, y: x),
        (lambda x, y: 0.0 - x, lambda x, y: -x),
        (lambda x, y: x * 1.0, lambda x, y: x),
        (lambda x, y: -1.0 * x, lambda x, y: -x),
        (lambda x, y: x / 1.0, lambda x, y: x),
        (lambda x, y: -operator.neg(x), lambda x, y: x),
        (lambda x, y: x + (-y), lambda x, y: x - y),
        (lambda x, y: (-x) + y, lambda x, y: y - x),
        (lambda x, y: x - (-y), lambda x, y: x + y),
        (lambda x, y: (-x) * y, lambda x, y: -(x * y)),
        (lambda x, y: x * (-y), lambda x, y: -(x * y)),
        (lambda x, y: (-x) * (-y), lambda x, y: x * y),
        (lambda x, y: select(x < y, x, x), lambda x, y: x),
        (lambda x, y: ~~(x < y), lambda x, y: x < y),
        (lambda x, y: y > x, lambda x, y: x < y),
        (lambda x, y: y >= x, lambda x, y: x <= y),
        (lambda x, y: (x < y) & True, lambda x, y: x < y),
        (lambda x, y: False | (x < y), lambda x, y: x < y),
    ],
)
def test_what_amounts_to_a_simpler_node_is_that_node(
    x: Expr, y: Expr, folded: Callable[[Expr, Expr], Expr], expected: Callable[[Expr, Expr], Expr]
):
    assert same(folded(x, y), expected(x, y))


@pytest.mark.parametrize(
    ("function", "value"),
    [
        (lambda x: 0.0 * x, 0.0),
        (lambda x: x * 0, 0.0),
        (lambda x: 0.0 / x, 0.0),
        (lambda x: x - x, 0.0),
        (lambda x: guarded(x < 1.0, [0.0])[0], 0.0),
    ],
)
def test_what_is_zero_whatever_x_is_a_constant(x: Expr, function: Callable[[Expr], Expr], value: float):
    assert function(x).constant_value == value


def test_constants_are_computed_in_float32(graph: Graph):
    a, b = 0.1, 0.7
    f32 = np.float32
    for found, expected in (
        (graph.constant(a) + b, f32(a) + f32(b)),
        (graph.constant(a) - b, f32(a) - f32(b)),
        (graph.constant(a) * b, f32(a) * f32(b)),
        (graph.constant(a) / b, f32(a) / f32(b)),
        (sqrt(graph.constant(a)), np.sqrt(f32(a))),
        (absolute(graph.constant(-a)), f32(a)),
        (-graph.constant(a), -f32(a)),
    ):
        assert found.constant_value == float(expected)
    assert (graph.constant(a) + b).constant_value != a + b
    # Both zeros are one constant, and its sign is plus.
    assert same(graph.constant(-0.0), graph.constant(0.0))
    assert np.copysign(1.0, graph.constant(-0.0).constant_value or 0.0) == 1.0


def test_numbers_of_numpy_let_the_expression_answer(x: Expr):
    assert same(np.float64(2.0) * x, 2.0 * x)
    assert same(np.float32(2.0) + x, x + 2.0)  # type: ignore[operator]
    assert same(np.array(3.0) - x, 3.0 - x)


def test_what_cannot_be_code_is_refused(graph: Graph, x: Expr):
    with pytest.raises(ValueError, match="not a number"):
        graph.constant(float("nan"))
    with pytest.raises(ValueError, match="another graph"):
        _ = x + Graph().input("x")
    with pytest.raises(ValueError, match="two constants"):
        _ = graph.constant(1.0) < 2.0
    with pytest.raises(ValueError, match="infinite"):
        statements(graph, [("out", x + 1e39)], Target(1))


def test_a_truth_value_is_refused_and_the_message_says_where(x: Expr):
    line = inspect.currentframe().f_lineno + 2  # type: ignore[union-attr]
    with pytest.raises(TypeError) as caught:
        bool(x < 1.0)
    assert f"{__file__}:{line}" in str(caught.value)
    assert "select()" in str(caught.value)

    def branch(value: Expr) -> float:
        return 1.0 if value > 2.0 else 0.0

    with pytest.raises(TypeError, match=rf"test_trace\.py:{branch.__code__.co_firstlineno + 1};"):
        branch(x)
    with pytest.raises(TypeError, match="truth value"):
        max(x, x + 1.0)


def test_only_what_is_needed_is_emitted(graph: Graph, x: Expr, y: Expr):
    needed = x * x
    sqrt(absolute(y) + 3.0)
    code = statements(graph, [("out", needed)], Target(8))
    assert "y" not in code
    assert "sqrt" not in code
    assert operation_count(graph, [needed]) == 1


def test_a_product_used_once_becomes_a_multiply_add(graph: Graph, x: Expr, y: Expr):
    def count(value: Expr) -> int:
        return statements(graph, [("out", value)], Target(1, cuda=True)).count("fmaf(")

    assert count(x * y + 1.0) == 1
    assert count(x * y - 1.0) == 1
    assert count(1.0 - x * y) == 1
    product = x * y
    assert count((product + 1.0) * product) == 0  # its rounded value is needed anyway
    assert count(x * y + y * 3.0) == 1


# ---- select, guarded and their kin on NumPy --------------------------------------------------------------------------
def test_select_and_its_kin_on_numpy():
    a, b = np.array([1.0, 2.0, -3.0]), np.array([2.0, 1.0, -3.0])
    np.testing.assert_array_equal(select(a < b, a, b), np.minimum(a, b))
    np.testing.assert_array_equal(minimum(a, b), np.minimum(a, b))
    np.testing.assert_array_equal(maximum(a, b), np.maximum(a, b))
    np.testing.assert_array_equal(clamp(a, -1.0, 1.5), np.clip(a, -1.0, 1.5))
    np.testing.assert_array_equal(equal(a, b), [False, False, True])
    np.testing.assert_array_equal(logical_not(a < b), [False, True, True])
    np.testing.assert_array_equal(guarded(a < b, [a, b])[1], [2.0, 0.0, 0.0])
    assert select(True, 1.0, 2.0) == 1.0
    assert select(False, 1.0, 2.0) == 2.0


# ---- polynomials -----------------------------------------------------------------------------------------------------
def series(x: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    return sum((c * x**k for k, c in enumerate(coefficients)), start=np.zeros_like(x))


def test_polynomials_are_as_good_as_they_say():
    half = np.linspace(1e-3, 0.5 * np.pi, 20_001)
    square = half * half
    sine = half + half * square * series(square, SIN_COEFFICIENTS)
    cosine = 1.0 + square * series(square, COS_COEFFICIENTS)
    assert np.max(np.abs(sine - np.sin(half)) / np.sin(half)) < 1.4e-8
    assert np.max(np.abs(cosine - np.cos(half))) < 5e-10
    tangent = np.linspace(1e-3, 1.0, 20_001)
    angle = tangent * series(tangent * tangent, ATAN_COEFFICIENTS)
    assert np.max(np.abs(angle / np.arctan(tangent) - 1.0)) < 1.8e-8


def both(x: list[Any]) -> list[Any]:
    return [*sincos(x[0])]


def quadrants(x: list[Any]) -> list[Any]:
    return [atan2(x[0], x[1]), asin(x[2])]


@pytest.mark.parametrize("lanes", [1, 8])
def test_sine_and_cosine(lanes: int):
    angles = np.concatenate([np.linspace(-4 * np.pi, 4 * np.pi, 4001), np.linspace(-1e-3, 1e-3, 101), [0.0]])
    angles = angles.astype(np.float32).astype(float)[:, None]
    found = emitted(both, 1, lanes)(angles)
    expected = np.concatenate([np.sin(angles), np.cos(angles)], axis=1)
    turn = np.abs(angles[:, 0]) <= np.pi
    # Within a turn to float32; beyond it the angle itself has been rounded.
    assert np.max(np.abs(found - expected)[turn]) < 6 * EPS
    assert np.max(np.abs(found - expected)) < 20 * EPS
    small = np.abs(angles[:, 0]) < 1e-3
    np.testing.assert_allclose(found[small, 0], angles[small, 0], rtol=3 * EPS + 2e-7, atol=0)
    np.testing.assert_array_equal(found[-1], [0.0, 1.0])


def test_arc_tangent_and_arc_sine_all_round():
    rng = np.random.default_rng(0)
    angle = np.linspace(-np.pi, np.pi, 2001)
    length = 10.0 ** rng.uniform(-6, 6, size=angle.size)
    sine = np.sin(np.linspace(-0.5 * np.pi, 0.5 * np.pi, angle.size))
    inputs = np.stack([length * np.sin(angle), length * np.cos(angle), sine], axis=1).astype(np.float32).astype(float)
    found = emitted(quadrants, 3, 8)(inputs)
    assert np.max(np.abs(found[:, 0] - np.arctan2(inputs[:, 0], inputs[:, 1]))) < 8 * EPS
    # Close to one the arc sine turns the rounding of 1 - x^2 into its root.
    assert np.max(np.abs(found[:, 1] - np.arcsin(inputs[:, 2]))) < 6e-4
    inner = np.abs(inputs[:, 2]) < 0.99
    assert np.max(np.abs(found[inner, 1] - np.arcsin(inputs[inner, 2]))) < 8 * EPS


@pytest.mark.parametrize(
    ("y", "x", "angle"),
    [
        (0.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (1.0, 0.0, 0.5 * np.pi),
        (-1.0, 0.0, -0.5 * np.pi),
        (0.0, -1.0, np.pi),
        (1.0, 1.0, 0.25 * np.pi),
        (1.0, -1.0, 0.75 * np.pi),
        (-1.0, 1.0, -0.25 * np.pi),
        (-1.0, -1.0, -0.75 * np.pi),
        (1e-30, 1.0, 1e-30),
        (1e30, 1.0, 0.5 * np.pi),
        (-1e30, -1e30, -0.75 * np.pi),
        (1e-37, -1.0, np.pi),
    ],
)
def test_corners_of_the_arc_tangent(y: float, x: float, angle: float):
    found = emitted(quadrants, 3, 8)(np.array([[y, x, 0.0]]))[0, 0]
    assert found == pytest.approx(angle, rel=4 * EPS, abs=1e-35)
    assert atan2(np.float64(y), np.float64(x)) == pytest.approx(angle, rel=1e-12)


@pytest.mark.parametrize(
    ("value", "angle"), [(1.0, 0.5 * np.pi), (-1.0, -0.5 * np.pi), (1.5, 0.5 * np.pi), (-9.0, -0.5 * np.pi), (0.0, 0.0)]
)
def test_corners_of_the_arc_sine(value: float, angle: float):
    assert emitted(quadrants, 3, 8)(np.array([[0.0, 1.0, value]]))[0, 1] == pytest.approx(angle, rel=4 * EPS, abs=1e-12)
    assert asin(np.float64(value)) == pytest.approx(angle, rel=1e-12, abs=1e-15)


# ---- random graphs ---------------------------------------------------------------------------------------------------
INPUTS = 6
VALUE_OPERATIONS: dict[str, Callable[[Any, Any, Any], Any]] = {
    "add": lambda a, b, mask: a + b,
    "sub": lambda a, b, mask: a - b,
    "mul": lambda a, b, mask: a * b,
    "neg": lambda a, b, mask: -a,
    "abs": lambda a, b, mask: absolute(a),
    "floor": lambda a, b, mask: floor(a * 0.5),
    "select": lambda a, b, mask: select(mask, a, b),
    "minimum": lambda a, b, mask: minimum(a, b),
    "maximum": lambda a, b, mask: maximum(a, b),
    "clamp": lambda a, b, mask: clamp(a, -3.0, b),
}
MASK_OPERATIONS: tuple[Callable[[Any, Any, Any, Any], Any], ...] = (
    lambda a, b, m, n: a < b,
    lambda a, b, m, n: a >= b,
    lambda a, b, m, n: equal(a, b),
    lambda a, b, m, n: (m & n) | (b < a),
    lambda a, b, m, n: logical_not(m) & True,
)


class RandomFunction:
    """A function of scalars made of random operations on small whole numbers, each of them exact in float32.

    Values whose bound has grown too large are clamped: float32 and float64 then agree exactly, however operations are
    fused. What would fold to a constant is not drawn, since constants cannot be compared.
    """

    def __init__(self, seed: int, operations: int, inputs: int) -> None:
        rng = np.random.default_rng(seed)
        self.steps: list[tuple[str, tuple[int, ...]]] = []
        graph = Graph()
        pool: list[Any] = [graph.input(f"x[{i}]") for i in range(inputs)]
        bounds = [8.0] * inputs
        masks: list[Any] = [pool[0] < pool[1]]
        while len(self.steps) < operations:
            kind = str(rng.choice([*VALUE_OPERATIONS, "mask"]))
            a, b = (int(i) for i in rng.integers(max(0, len(pool) - 12), len(pool), size=2))
            m, n = (int(i) for i in rng.integers(len(masks), size=2))
            if kind == "mask":
                which = int(rng.integers(len(MASK_OPERATIONS)))
                masks.append(MASK_OPERATIONS[which](pool[a], pool[b], masks[m], masks[n]))
                self.steps.append(("mask", (which, a, b, m, n)))
                continue
            value = VALUE_OPERATIONS[kind](pool[a], pool[b], masks[m])
            bound = {"mul": bounds[a] * bounds[b]}.get(kind, bounds[a] + bounds[b] + 6.0)
            if value.constant_value is not None:
                continue
            self.steps.append((kind, (a, b, m)))
            if bound > 2.0**11:
                value, bound = clamp(value, -5.0, 6.0), 6.0
                self.steps.append(("bound", ()))
            pool.append(value)
            bounds.append(bound)

    def __call__(self, inputs: list[Any]) -> list[Any]:
        pool, masks = list(inputs), [inputs[0] < inputs[1]]
        for kind, operands in self.steps:
            if kind == "mask":
                which, a, b, m, n = operands
                masks.append(MASK_OPERATIONS[which](pool[a], pool[b], masks[m], masks[n]))
            elif kind == "bound":
                pool[-1] = clamp(pool[-1], -5.0, 6.0)
            else:
                a, b, m = operands
                pool.append(VALUE_OPERATIONS[kind](pool[a], pool[b], masks[m]))
        return pool[-8:]


class GuardedFunction:
    """Groups of guarded values, each group with parts of its own, parts shared with another, and parts used openly."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def __call__(self, x: list[Any]) -> list[Any]:
        open_part = RandomFunction(self.seed, 20, len(x))(x)
        shared = RandomFunction(self.seed + 1, 20, len(x))(x)
        # Guards of one condition belong together, so the functions' conditions differ.
        k = float(self.seed % 12) - 5.0
        conditions = [x[0] < x[1] + k, (x[2] < k) & (x[3] < 0.0), x[4] < k - 100.0]
        results = list(open_part)
        for place, condition in enumerate(conditions):
            own = RandomFunction(self.seed + 2 + place, 30, len(x))([*x[1:], shared[place]])
            results += guarded(condition, [*own, own[0] * shared[3], own[1] * own[2] + open_part[place], 0.0, 7.0])
        # What is guarded feeds arithmetic, also together.
        return [*results, results[8] + results[-1], results[9] * results[10] - open_part[0]]


class Chorus:
    """Several functions of the same inputs as one, to be compiled once."""

    def __init__(self, *parts: Callable[[list[Any]], list[Any]]) -> None:
        self.parts = parts

    def __call__(self, x: list[Any]) -> list[Any]:
        return [value for part in self.parts for value in part(x)]


RANDOM_GRAPHS = Chorus(
    *(RandomFunction(seed, 60, INPUTS) for seed in range(14)), *(GuardedFunction(seed) for seed in range(100, 107))
)


@pytest.mark.parametrize("lanes", [1, 8])
def test_random_graphs_compute_what_numpy_computes(lanes: int):
    inputs = np.random.default_rng(1).integers(-8, 9, size=(333, INPUTS)).astype(float)
    # Blocks in which nobody, everybody and somebody meets each condition.
    inputs[:64, 2:4] = 5.0
    inputs[64:128, :2] = (-1.0, 2.0)
    expected = RANDOM_GRAPHS([inputs[:, i] for i in range(INPUTS)])
    expected = np.stack([np.broadcast_to(np.asarray(value, dtype=float), 333) for value in expected], axis=1)
    assert np.unique(expected).size > 30
    np.testing.assert_array_equal(emitted(RANDOM_GRAPHS, INPUTS, lanes)(inputs), expected)


def test_guarded_arithmetic_is_skipped_and_not_counted(graph: Graph, x: Expr, y: Expr):
    costly = sqrt(x * x + y * y)
    value = guarded(x < 0.0, [costly])[0]
    code = statements(graph, [("out", value)], Target(8))
    before, _, inside = code.partition("if (__builtin_reduce_or(")
    assert "sqrt" in inside
    assert "sqrt" not in before
    assert operation_count(graph, [value]) < operation_count(graph, [costly])
    # What others need as well is computed in the open.
    openly = statements(graph, [("out", value), ("too", costly)], Target(8))
    assert "sqrt" in openly.partition("if (")[0]


def test_guards_that_cannot_be_skipped_apart_are_refused(graph: Graph, x: Expr, y: Expr):
    inner = guarded(x < 0.0, [x * y])[0]
    outer = guarded(y < 0.0, [inner + 1.0])[0]
    with pytest.raises(ValueError, match="guard both by one condition"):
        statements(graph, [("out", outer)], Target(8))
    first = guarded(x < 1.0, [x * 3.0])[0]
    late = guarded(x < 1.0, [sqrt(first * y)])[0]
    with pytest.raises(ValueError, match=r"guard both|made together"):
        statements(graph, [("out", first), ("too", late)], Target(8))


# ---- probes ----------------------------------------------------------------------------------------------------------
def test_probes_are_kept_by_graph_or_recorder(graph: Graph, x: Expr):
    probe("squared", x * x)
    line = inspect.currentframe().f_lineno - 1  # type: ignore[union-attr]
    (entry,) = graph.probes
    assert entry.name == "squared"
    assert entry.source == f"{__file__}:{line}"
    assert same(entry.value, x * x)
    with record_probes() as entries:
        probe("number", np.array([1.0]))
    probe("nobody listens", np.array([2.0]))
    assert [entry.name for entry in entries] == ["number"]
