"""The settings of a ride: what they refuse, and in which words."""

from __future__ import annotations

from typing import Any

import pytest

from echelon.scenario.road import ObstacleSettings, PelotonSettings, TacticsSettings, UserSettings
from echelon.settings import SettingError, plain, read

CASES: list[tuple[type, dict[str, Any], str]] = [
    (PelotonSettings, {"mode": "follow"}, "peloton.mode = 'follow': must be one of 'pursuit', 'lookahead'"),
    (PelotonSettings, {"gap": 0.0}, "peloton.gap = 0.0: must be at least 0.1 and at most 50 m"),
    (PelotonSettings, {"training_speed": 3.0, "training_spread": 3.0}, "peloton.training_spread = 3: must be below"),
    (PelotonSettings, {"start_speed": 1.0}, "peloton.start_speed = 1: must be at least slowest, 2 m/s"),
    (PelotonSettings, {"row_spacing": 1.5}, "peloton.row_spacing = 1.5: riders would overlap; must be at least 1.7 m"),
    (PelotonSettings, {"lateral_spacing": 0.4}, "peloton.lateral_spacing = 0.4: riders would overlap"),
    (PelotonSettings, {"body_half_width": 0.9, "lateral_spacing": 2.0}, "peloton.body_length = 1.7: must be at least"),
    (PelotonSettings, {"tactics": {"closed_gap": 9.0}}, "peloton.tactics.closed_gap = 9: must be below chase_gap, 8 m"),
    (PelotonSettings, {"tactics": {"attack": 9.0}}, "peloton.tactics.attack: unknown key; did you mean 'attacks'?"),
    (UserSettings, {"keys": []}, "user.keys = []: must hold at least one"),
    (UserSettings, {"keys": [[0, 9, 0], [0, 9, 1]]}, "user.keys[1] = [0.0, 9.0, 1.0]: its time must be more than 0"),
    (UserSettings, {"keys": [[0, 0, 0]]}, "user.keys[0] = [0.0, 0.0, 0.0]: its speed must be above 0"),
    (ObstacleSettings, {"kind": "car", "distance": 9.0, "speed": 1.0}, "obstacles.speed = 1: must be 0 for a car"),
    (ObstacleSettings, {"kind": "dog", "distance": 9.0}, "obstacles.kind = 'dog': must be one of"),
]


@pytest.mark.parametrize(("kind", "data", "message"), CASES, ids=[message[:40] for _, _, message in CASES])
def test_what_cannot_be_is_named(kind: type, data: dict[str, Any], message: str) -> None:
    key = {PelotonSettings: "peloton", UserSettings: "user", ObstacleSettings: "obstacles"}[kind]
    with pytest.raises(SettingError) as caught:
        read(kind, data, key)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "settings",
    [
        PelotonSettings(mode="lookahead", tactics=TacticsSettings(attacks=0.0)),
        PelotonSettings(drafting=True),
        UserSettings(by="distance", keys=((0.0, 9.0, 1.0), (500.0, 11.0, 0.0))),
        ObstacleSettings("jogger", 40.0, 1.0, speed=2.5),
    ],
)
def test_plain_data_gives_them_back(settings: Any) -> None:
    assert read(type(settings), plain(settings)) == settings


def test_obstacles_have_the_size_of_their_kind_unless_told() -> None:
    assert ObstacleSettings("car", 10.0).size == (4.4, 1.8)
    assert ObstacleSettings("barrier", 10.0, length=20.0).size == (20.0, 1.5)
