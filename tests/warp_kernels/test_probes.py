"""Probes: the first value on which two computations differ, and the line of source that named it."""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from engine_scenes import as_float32, hopper

from echelon.agents import hopper as hopper_source
from echelon.agents.hopper import Hopper
from echelon.warp_kernels.character import View
from echelon.warp_kernels.contact import JointForces
from echelon.warp_kernels.probes import divergence_of_lanes, lane_probes, reference_probes
from echelon.warp_kernels.reference_run import ReferenceRun, diverging_probe, probes_of_substep
from echelon.warp_kernels.trace import Expr, Probe, probe


def standing(character: Hopper, count: int = 5) -> ReferenceRun:
    """Hoppers pressed into the ground by different depths, a little turned."""
    q = np.tile(character.body.q_reference, (count, 1))
    q[:, 2] -= np.linspace(0.001, 0.003, count)
    q[:, 7] = np.linspace(-0.1, 0.1, count)
    u = np.random.default_rng(2).normal(size=(count, character.body.u_count)) * 0.2
    return ReferenceRun(character, as_float32(q), as_float32(u), command={"velocity_x": 0.5})


def line_of(name: str) -> int:
    """The line of the hopper's source on which a probe stands."""
    lines = inspect.getsource(hopper_source).splitlines()
    return next(number for number, line in enumerate(lines, start=1) if f'probe("{name}"' in line)


def test_equal_computations_have_no_diverging_probe():
    one, other = standing(hopper()), standing(hopper())
    assert probes_of_substep(one)
    assert diverging_probe(probes_of_substep(one), probes_of_substep(other), tolerance=0.0) is None


def test_a_planted_difference_is_found_and_its_line_named():
    """One agent of two runs stands a tenth of a millimetre deeper: its foot's load is off, and nothing before that."""
    one, other = standing(hopper()), standing(hopper())
    other.state.q[2][3] -= 1e-4
    found = diverging_probe(reference_probes(one), reference_probes(other), tolerance=1e-6)
    assert found is not None
    assert found.name == "hopper.load"
    assert found.source == f"{hopper_source.__file__}:{line_of('hopper.load')}"
    assert np.flatnonzero(found.expected != found.found).tolist() == [3]
    # An earlier difference is reported first.
    other.state.memory["wanted_x"][0] += 0.5
    found = diverging_probe(reference_probes(one), reference_probes(other), tolerance=1e-6)
    assert found is not None
    assert found.name.startswith("hopper.hip_")
    assert found.source == f"{hopper_source.__file__}:{line_of(found.name)}"


def test_what_is_not_finite_diverges():
    good = [Probe("a", np.array([1.0, 2.0]), "here:1"), Probe("b", np.array([1.0, 2.0]), "here:2")]
    bad = [good[0], replace(good[1], value=np.array([1.0, np.nan]))]
    found = diverging_probe(good, bad, tolerance=1e9)
    assert found is not None
    assert (found.name, found.source) == ("b", "here:2")


def test_probes_of_different_source_cannot_be_compared():
    with pytest.raises(ValueError, match="different orders"):
        diverging_probe([Probe("a", 1.0, "here:1")], [Probe("b", 1.0, "here:1")], tolerance=1.0)


def test_asking_leaves_the_run_as_it_is():
    run = standing(hopper())
    before = [run.q, run.u, *(values.copy() for values in run.state.memory.values())]
    reference_probes(run)
    lane_probes(run)
    after = [run.q, run.u, *run.state.memory.values()]
    for a, b in zip(before, after, strict=True):
        np.testing.assert_array_equal(a, b)


# ---- lanes beside the reference --------------------------------------------------------------------------------------
def test_lanes_see_what_the_reference_sees():
    run = standing(hopper())
    expected, found = reference_probes(run), lane_probes(run, lanes=8)
    assert [entry.name for entry in expected] == [entry.name for entry in found]
    assert [entry.source for entry in expected] == [entry.source for entry in found]
    assert {"hopper.hip_x", "hopper.hip_y", "hopper.load"} <= {entry.name for entry in found}
    for entry in found:
        assert np.shape(entry.value) == (5,)
        assert np.asarray(entry.value).dtype == np.float32
    # The load is the ground's stiffness times a difference of heights, whose last digit is millinewtons in float32.
    assert divergence_of_lanes(run, tolerance=1e-3, lanes=8) is None
    assert divergence_of_lanes(run, tolerance=1e-9, lanes=8) is not None


class Miscounting(Hopper):
    """A hopper whose native code was given another spring than the reference: a planted fault."""

    def actuate(self, view: View, joints: JointForces) -> None:
        traced = isinstance(view.q[0], Expr)
        self.look("before", view.q[2])
        self.look("spring", view.q[10] * (6001.0 if traced else 6000.0))
        self.look("is low", view.q[2] < 0.7)
        self.look("constant", 3.0)
        super().actuate(view, joints)

    def look(self, name: str, value: Any) -> None:
        probe(f"planted.{name}", value)


def test_a_fault_planted_in_the_native_code_is_found():
    run = standing(Miscounting())
    run.state.q[10][:] = -0.01
    found = divergence_of_lanes(run, tolerance=1e-5, lanes=1)
    assert found is not None
    assert found.name == "planted.spring"
    assert found.source == f"{__file__}:{Miscounting.look.__code__.co_firstlineno + 1}"
    np.testing.assert_allclose(found.expected, -60.0)
    np.testing.assert_allclose(found.found, -60.01, rtol=1e-6)
    # Masks count as one and zero, constants as themselves.
    seen = {entry.name: entry.value for entry in lane_probes(run, lanes=1)}
    np.testing.assert_array_equal(seen["planted.is low"], run.state.q[2] < 0.7)
    np.testing.assert_array_equal(seen["planted.constant"], 3.0)
