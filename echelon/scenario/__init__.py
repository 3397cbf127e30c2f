"""A scenario: who stands where, what they want, in which world, for how long. A TOML file or these dataclasses."""

from echelon.scenario.herd import CollieSettings, HerdSettings
from echelon.scenario.road import ObstacleSettings, PelotonSettings, TacticsSettings, UserSettings
from echelon.scenario.scenario import CHARACTERS, RIDERS, CrowdSettings, EngineSettings, Scenario, ShotSettings
from echelon.scenario.world import CorralSettings, WorldSettings

__all__ = [
    "CHARACTERS",
    "RIDERS",
    "CollieSettings",
    "CorralSettings",
    "CrowdSettings",
    "EngineSettings",
    "HerdSettings",
    "ObstacleSettings",
    "PelotonSettings",
    "Scenario",
    "ShotSettings",
    "TacticsSettings",
    "UserSettings",
    "WorldSettings",
]
