"""The emitted snippets as CUDA: compiled to PTX by NVRTC, which needs no GPU."""

# pyright: reportIndexIssue=false, reportFunctionMemberAccess=false
# (Warp's types mean other things to it than to Python.)

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import warp as wp
from engine_scenes import SlopedTerrain, hopper, puppet

from echelon.agents.characters import character_named
from echelon.warp_kernels import frame_kernel, ghosts
from echelon.warp_kernels.bumper import bumper_of
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.emit import Target
from echelon.warp_kernels.program import Integrator, Program

ARCHITECTURE = 80


@wp.kernel(module="unique", enable_backward=False)
def nothing_much(values: wp.array[wp.float32]):
    values[wp.tid()] = 1.0


@pytest.fixture(scope="module", autouse=True)
def nvrtc(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Skip all where this Warp cannot compile the simplest kernel there is for CUDA."""
    folder = tmp_path_factory.mktemp("nvrtc")
    try:
        wp.compile_aot_module(nothing_much.module, arch=ARCHITECTURE, module_dir=folder, use_ptx=True)
    except Exception as error:
        pytest.skip(f"this Warp has no NVRTC to compile CUDA with: {' '.join(str(error).split())}")
    if not list(folder.glob("*.ptx")):
        pytest.skip("this Warp has no NVRTC to compile CUDA with: no PTX came of the simplest kernel")


def compiled(character: Character, integrator: Integrator, folder: Path, meets: bool = False) -> tuple[str, str]:
    """(CUDA source, PTX) of the frame kernel of a character that meets others or does not."""
    bumper = bumper_of(character, 1 / 1200) if meets else None
    program = Program(character, 1 / 1200, 5 / 1200, integrator, Target(lanes=1, cuda=True), bumper=bumper)
    terrain: Any = SlopedTerrain.of(0.0)
    kernel = frame_kernel.frame_kernel(program, terrain.look_up, frame_kernel.type_of(terrain.data), terrain.rough)
    wp.compile_aot_module(kernel.module, arch=ARCHITECTURE, module_dir=folder, use_ptx=True)
    (source,), (ptx,) = folder.glob("*.cu"), folder.glob("*.ptx")
    return source.read_text(), ptx.read_text()


@pytest.mark.parametrize(
    ("name", "integrator"),
    [("hopper", "semi-implicit"), ("hopper", "rk4"), ("male", "semi-implicit"), ("gymnast-male", "semi-implicit")],
)
def test_the_frame_kernel_compiles(name: str, integrator: Integrator, tmp_path: Path):
    followed = character_named(name) if name == "gymnast-male" else None  # one that follows scripts
    character = followed or (hopper() if name == "hopper" else puppet(name))
    source, ptx = compiled(character, integrator, tmp_path)
    assert ".visible .entry" in ptx
    assert f".target sm_{ARCHITECTURE}" in ptx
    # Nothing of the CPU's is left in it.
    assert "__builtin_elementwise" not in source
    assert "ext_vector_type" not in source
    # Our multiply-adds and no others; the four stages of Runge-Kutta add some in their loops when they are unrolled.
    fused = len(re.findall(r"fma\.rn\.f32", ptx))
    written = source.count("fmaf(")
    assert written > 400
    # A script's stage is plain Warp, whose loops are unrolled as well: 3 % more were counted.
    assert fused <= written * (1.2 if integrator == "rk4" else 1.05 if followed else 1.02)
    # Everything of a substep is in float32: doubles are for origins and planes alone.
    assert len(re.findall(r"(add|mul|fma)\.rn\.f64", ptx)) < 100
    assert "sin.approx" not in ptx


def test_contact_between_characters_compiles(tmp_path: Path):
    source, ptx = compiled(hopper(), "semi-implicit", tmp_path / "frame", meets=True)
    assert ".visible .entry" in ptx
    assert "__builtin_elementwise" not in source
    assert "capsules[1][14]" in source
    wp.compile_aot_module(ghosts, arch=ARCHITECTURE, module_dir=tmp_path / "ghosts", use_ptx=True)
    assert ".visible .entry" in next((tmp_path / "ghosts").glob("*.ptx")).read_text()
