"""Between two frames everybody is between where they are in them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from echelon.play.moments import Moment, between


def moment(x: float, turn: float, sign: float = 1.0) -> Moment:
    pose = np.array([x, 0.0, 1.0, 0.0, 0.0, sign * math.sin(0.5 * turn), sign * math.cos(0.5 * turn)])
    return Moment(np.tile(pose, (2, 3, 1)), pose[None], np.array([False, True]), 0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_halfway(sign: float) -> None:
    middle = between(moment(0.0, 0.1), moment(2.0, 0.3, sign), 0.5)
    np.testing.assert_allclose(middle.links, moment(1.0, 0.2).links, atol=1e-9)
    np.testing.assert_allclose(middle.actors, moment(1.0, 0.2).actors, atol=1e-9)


def test_attitudes_stay_of_unit_length() -> None:
    part = between(moment(0.0, 0.0), moment(0.0, 2.0), 0.3).links
    np.testing.assert_allclose(np.linalg.norm(part[..., 3:], axis=-1), 1.0)


def test_at_the_ends_it_is_the_frames_themselves() -> None:
    first, last = moment(0.0, 0.1), moment(1.0, 0.2)
    assert between(first, last, 0.0) is first
    assert between(first, last, 1.0) is last


def test_who_is_gone_has_no_place() -> None:
    assert moment(3.0, 0.0).places.tolist() == [[3.0, 0.0, 1.0]]
    rider = moment(3.0, 0.0).rider
    assert rider is not None
    assert rider[0] == 3.0
