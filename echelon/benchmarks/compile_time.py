"""How long a body takes to compile, and to load from the cache, in processes and a kernel cache of their own.

What counts is from the traced controller to the bound kernel. Warp's own start-up and its precompiled header, which
every first compilation on a machine pays, are paid beforehand by a kernel that does nothing, under the same flags.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import warp as wp

import echelon


@dataclass(frozen=True)
class CompileTime:
    """Seconds from a character to a kernel that can be launched.

    Attributes:
        fresh: With an empty kernel cache [s].
        cached: In a later process, from the cache that the first one left [s].
    """

    fresh: float
    cached: float


def compile_time(body_name: str) -> CompileTime:
    """Measure a body that the engine's benchmark knows, with the default integrator and step.

    Raises:
        RuntimeError: If the measuring process fails; the message is the last line that it wrote.
    """
    with tempfile.TemporaryDirectory(prefix="echelon-kernels-") as cache:
        fresh, cached = (_in_a_process(body_name, cache) for _ in range(2))
    return CompileTime(fresh, cached)


def _in_a_process(body_name: str, cache: str) -> float:
    above = str(Path(echelon.__file__).parent.parent)
    path = os.pathsep.join(entry for entry in (above, os.environ.get("PYTHONPATH")) if entry)
    done = subprocess.run(
        [sys.executable, "-m", __name__, body_name],
        env={**os.environ, "WARP_CACHE_PATH": cache, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        raise RuntimeError(f"body {body_name!r}: compiling it failed: {lines[-1] if lines else 'no message'}")
    return float(json.loads(done.stdout.splitlines()[-1])["seconds"])


def _measure(body_name: str) -> float:
    """Seconds to compile or load one body in this process."""
    from echelon.benchmarks.engine_runs import character_of, ground_of, stride_of
    from echelon.benchmarks.timed_engine import bound_engine
    from echelon.warp_kernels.emit import cpu_compiler_flags, host_lanes
    from echelon.warp_kernels.start import start_warp

    character = character_of(body_name)
    stride, ground = stride_of(character), ground_of(character)
    start_warp()
    options = {"enable_backward": False, "cpu_compiler_flags": cpu_compiler_flags(host_lanes())}

    @wp.kernel(module="unique", module_options=options, enable_backward=False)
    def nothing(numbers_out: wp.array[wp.float32]):
        numbers_out[wp.tid()] = 0.0  # pyright: ignore[reportIndexIssue] (an array in a kernel)

    wp.launch(nothing, dim=1, outputs=[wp.zeros(1, dtype=wp.float32, device="cpu")], device="cpu")
    start = time.perf_counter()
    bound_engine(character, host_lanes(), stride, "semi-implicit", ground)
    return time.perf_counter() - start


if __name__ == "__main__":
    print(json.dumps({"seconds": _measure(sys.argv[1])}))
