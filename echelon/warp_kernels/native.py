"""One function of scalars as native code on its own, outside any frame: for probing, and for tests."""

# pyright: reportGeneralTypeIssues=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

from echelon.warp_kernels.emit import Target, cpu_compiler_flags, statements
from echelon.warp_kernels.trace import Expr, Graph


class NativeFunction:
    """A function of scalars, traced and compiled for lanes of a CPU.

    Args:
        function: Takes the inputs as scalars, gives its results; none of them a mask.
        input_count: How many inputs it takes.
        lanes: Agents a vector.
    """

    def __init__(self, function: Callable[[list[Any]], Sequence[Any]], input_count: int, lanes: int) -> None:
        graph = Graph()
        results = function([graph.input(f"x[{i}]") for i in range(input_count)])
        self.lanes = lanes
        self.input_count = input_count
        self.outputs = [graph.lift(value) for value in results]
        self._kernel = _kernel(graph, self.outputs, input_count, lanes)

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """Results in float32 of inputs in any precision; shapes [agents, results] and [agents, input_count]."""
        agents = len(inputs)
        count = -(-agents // self.lanes)
        padded = np.concatenate([inputs, np.repeat(inputs[-1:], count * self.lanes - agents, axis=0)])
        blocks = padded.astype(np.float32).reshape(count, self.lanes, self.input_count).transpose(0, 2, 1)
        values = wp.array(np.ascontiguousarray(blocks), dtype=wp.float32, device="cpu")
        results = wp.zeros((count, max(len(self.outputs), 1), self.lanes), dtype=wp.float32, device="cpu")
        wp.launch(self._kernel, dim=count, inputs=[values], outputs=[results], device="cpu")
        found = results.numpy().transpose(0, 2, 1).reshape(count * self.lanes, -1)
        return found[:agents, : len(self.outputs)].copy()


def _kernel(graph: Graph, outputs: Sequence[Expr], input_count: int, lanes: int) -> Any:
    target = Target(lanes)
    code = target.preamble
    code += f"lanes_in_memory* x = (lanes_in_memory*)(values.data) + (size_t)block * {input_count};\n"
    code += f"lanes_in_memory* y = (lanes_in_memory*)(results.data) + (size_t)block * {max(len(outputs), 1)};\n"
    code += statements(graph, [(f"y[{i}]", value) for i, value in enumerate(outputs)], target)

    @wp.func_native(code)
    def evaluate(values: wp.array3d[wp.float32], results: wp.array3d[wp.float32], block: int): ...

    options = {"enable_backward": False, "fuse_fp": False, "cpu_compiler_flags": cpu_compiler_flags(lanes)}

    @wp.kernel(module="unique", module_options=options, enable_backward=False)
    def evaluate_blocks(values: wp.array3d[wp.float32], results: wp.array3d[wp.float32]):
        evaluate(values, results, wp.tid())

    return evaluate_blocks
