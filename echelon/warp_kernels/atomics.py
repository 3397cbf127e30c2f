"""Atomic operations that are atomic on a CPU, too.

Warp's own are plain reads and writes there, as its launches have one thread; ours have several (`replay`). What is
exchanged and added this way must not depend on the order: whole numbers are added up, lists are searched as sets.
"""

# pyright: reportArgumentType=false, reportGeneralTypeIssues=false, reportReturnType=false, reportIndexIssue=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

_EXCHANGE = """
#if defined(__CUDA_ARCH__)
    return atomicExch(values.data + index, value);
#else
    return __atomic_exchange_n(values.data + index, value, __ATOMIC_RELAXED);
#endif
"""

_ADD = """
#if defined(__CUDA_ARCH__)
    atomicAdd(values.data + index, value);
#else
    __atomic_fetch_add(values.data + index, value, __ATOMIC_RELAXED);
#endif
"""


@wp.func_native(_EXCHANGE)
def atomic_exchange(values: wp.array[wp.int32], index: int, value: int) -> int:
    """Put a value where another was, and give that one; `values` is contiguous."""


@wp.func_native(_ADD)
def atomic_increase(values: wp.array[wp.int32], index: int, value: int):
    """Add to a number; `values` is contiguous."""
