"""A scenario: who stands where, what they want, in which world, for how long. A TOML file or these dataclasses."""

from echelon.scenario.scenario import (
    CHARACTERS,
    CollieSettings,
    CorralSettings,
    CrowdSettings,
    EngineSettings,
    HerdSettings,
    Scenario,
    ShotSettings,
    WorldSettings,
)

__all__ = [
    "CHARACTERS",
    "CollieSettings",
    "CorralSettings",
    "CrowdSettings",
    "EngineSettings",
    "HerdSettings",
    "Scenario",
    "ShotSettings",
    "WorldSettings",
]
