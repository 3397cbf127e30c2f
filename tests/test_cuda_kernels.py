"""Every kernel that is written in a file of its own, as CUDA: compiled to PTX by NVRTC, which needs no GPU.

The frame kernels, which are made for each character, are compiled in `warp_kernels/test_emit_cuda.py`.
"""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest
import warp as wp

import echelon

PACKAGE = Path(echelon.__file__).parent
ARCHITECTURE = 80


def kernels_of(path: Path) -> list[str]:
    """Names of the kernels at a file's outermost level."""
    return re.findall(r"^@wp\.kernel\b.*\n(?:#.*\n)*def (\w+)", path.read_text(encoding="utf-8"), flags=re.MULTILINE)


FILES = {
    path.relative_to(PACKAGE).with_suffix("").as_posix().replace("/", "."): kernels_of(path)
    for path in sorted(PACKAGE.rglob("*.py"))
    if kernels_of(path)
}


def test_there_are_kernels_to_compile() -> None:
    assert {"flocking.herding", "flocking.road_riders", "flocking.referee", "warp_kernels.ghosts"} <= set(FILES)


@pytest.mark.parametrize("name", FILES)
def test_it_compiles(name: str, tmp_path: Path) -> None:
    if not wp.get_cuda_supported_archs():
        pytest.skip("this Warp has no NVRTC to compile CUDA with")
    module = importlib.import_module(f"echelon.{name}")
    wp.compile_aot_module(module, arch=ARCHITECTURE, module_dir=tmp_path, use_ptx=True)
    ptx = "".join(path.read_text() for path in tmp_path.glob("*.ptx"))
    for kernel in FILES[name]:
        assert f"{kernel}_" in ptx
