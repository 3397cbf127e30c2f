"""A scenario: who stands where, what they want, in which world, for how long. A TOML file or these dataclasses."""

from echelon.scenario.herd import CollieSettings, HerdSettings
from echelon.scenario.performance import PERFORMERS, CastSettings, PerformanceSettings, ScriptSettings
from echelon.scenario.road import ObstacleSettings, PelotonSettings, TacticsSettings, UserSettings
from echelon.scenario.scenario import CHARACTERS, RIDERS, CrowdSettings, EngineSettings, Scenario, ShotSettings
from echelon.scenario.world import (
    ColumnFieldSettings,
    CorralSettings,
    GapSettings,
    PlatformSettings,
    WallSettings,
    WorldSettings,
)

__all__ = [
    "CHARACTERS",
    "PERFORMERS",
    "RIDERS",
    "CastSettings",
    "CollieSettings",
    "ColumnFieldSettings",
    "CorralSettings",
    "CrowdSettings",
    "EngineSettings",
    "GapSettings",
    "HerdSettings",
    "ObstacleSettings",
    "PelotonSettings",
    "PerformanceSettings",
    "PlatformSettings",
    "Scenario",
    "ScriptSettings",
    "ShotSettings",
    "TacticsSettings",
    "UserSettings",
    "WallSettings",
    "WorldSettings",
]
