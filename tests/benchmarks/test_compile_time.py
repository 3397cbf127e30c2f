"""Compile times are measured in processes of their own, from an empty cache and then from the cache."""

from __future__ import annotations

import pytest

from echelon.benchmarks.compile_time import compile_time


def test_loading_from_the_cache_is_well_under_a_second_and_under_compiling():
    spent = compile_time("hopper")
    assert spent.cached < spent.fresh
    assert spent.cached < 1.0


def test_what_goes_wrong_there_is_said_here():
    with pytest.raises(RuntimeError, match="nobody") as caught:
        compile_time("nobody")
    assert "\n" not in str(caught.value)
