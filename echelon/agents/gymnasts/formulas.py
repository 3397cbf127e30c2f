"""Formulas of named numbers, as scripts and objectives have them in their files.

    "0.985 * leg"        "highest - standing"        "table(height, [0.2, 0.6, 1.0], [0.71, 0.55, 0.4])"

Numbers, names, ``+ - * /``, parentheses, ``pi`` and the functions ``abs``, ``sqrt``, ``min``, ``max`` and, piecewise
linear, ``table(x, xs, ys)``. A formula is parsed once, and its names are then known; its value is that of numbers, or
of arrays of them, one for each gymnast.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any

import numpy as np

from echelon.errors import InputError

_BINARY: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "abs": np.abs,
    "sqrt": lambda value: np.sqrt(np.maximum(value, 0.0)),
    "min": lambda *values: reduce(np.minimum, values),
    "max": lambda *values: reduce(np.maximum, values),
    "table": np.interp,
}
_ARGUMENTS: Mapping[str, tuple[int, int]] = {
    "abs": (1, 1),
    "sqrt": (1, 1),
    "min": (2, 8),
    "max": (2, 8),
    "table": (3, 3),
}


@dataclass(frozen=True)
class Formula:
    """A formula that has been found to be one.

    Attributes:
        text: As it was given.
        names: What it asks about.
    """

    text: str
    names: tuple[str, ...]

    def value(self, numbers: Mapping[str, Any]) -> Any:
        """Its value.

        Args:
            numbers: By name; scalars, or arrays that fit one another. The root of what is negative is zero, and what
                is divided by zero is not finite.
        """
        with np.errstate(all="ignore"):
            return _evaluate(_parsed(self.text), numbers)


def formula(where: str, text: str) -> Formula:
    """A formula from its text.

    Args:
        where: Who asks, for messages.
        text: The formula.

    Raises:
        InputError: It is none.
    """
    try:
        node = _parsed(text)
        _check(node)
    except (SyntaxError, ValueError, RecursionError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else str(error)
        raise InputError(
            f"{where} = {text!r}: is no formula ({reason}); it may have names, numbers, + - * /, parentheses, pi, "
            f"{', '.join(_FUNCTIONS)}"
        ) from None
    found = [inner.id for inner in ast.walk(node) if isinstance(inner, ast.Name)]
    names = tuple(sorted({*found} - {*_FUNCTIONS, "pi"}))
    return Formula(text, names)


@lru_cache(maxsize=1024)
def _parsed(text: str) -> ast.expr:
    return ast.parse(text.strip(), mode="eval").body


def _check(node: ast.AST) -> None:
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return
        case ast.Name():
            return
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            _check(operand)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            _check(left)
            _check(right)
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in _FUNCTIONS:
            least, most = _ARGUMENTS[name]
            if not least <= len(arguments) <= most:
                count = f"{least}" if least == most else f"{least} to {most}"
                raise ValueError(f"{name} takes {count} arguments")
            if name == "table":
                _check(arguments[0])
                _check_table(arguments[1], arguments[2])
                return
            for argument in arguments:
                _check(argument)
        case _:
            raise ValueError(f"{ast.unparse(node)!r} is not allowed")


def _check_table(xs: ast.AST, ys: ast.AST) -> None:
    if not (isinstance(xs, ast.List) and isinstance(ys, ast.List) and len(xs.elts) == len(ys.elts) > 0):
        raise ValueError("table takes x and two lists of the same length")
    for entry in (*xs.elts, *ys.elts):
        _check(entry)


def _evaluate(node: ast.AST, numbers: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant(value=value):
            return float(value)  # type: ignore[arg-type]
        case ast.Name(id="pi"):
            return math.pi
        case ast.Name(id=name):
            return numbers[name]
        case ast.UnaryOp(operand=operand):
            return -_evaluate(operand, numbers)
        case ast.BinOp(left=left, op=op, right=right):
            # NumPy's division, which does not raise.
            return np.asarray(_BINARY[type(op)](np.asarray(_evaluate(left, numbers)), _evaluate(right, numbers)))
        case ast.List(elts=entries):
            return [_evaluate(entry, numbers) for entry in entries]
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return _FUNCTIONS[name](*[_evaluate(argument, numbers) for argument in arguments])
    raise ValueError(f"{ast.unparse(node)!r} is not allowed")
