"""What a rider wants to know while riding: speed and gear, how the herd or the race stands."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from echelon.flocking.collie import PERSON
from echelon.flocking.person import CONTROLS, DEVELOPMENTS, cadence_of, power_of
from echelon.flocking.road_riders import UNFINISHED
from echelon.scenario import PERFORMERS
from echelon.simulation import Simulation
from echelon.simulation.field import Field
from echelon.simulation.road import Road

_AT = {name: place for place, name in enumerate(CONTROLS)}


def crowd_words(character: str) -> str:
    """What the characters of a scenario are called on the page, in the plural."""
    words = {"hopper": "robots", "cyclist": "riders", "point-mass": "points"}
    return words.get(character, "gymnasts" if character in PERFORMERS else "characters")


def dashboard(simulation: Simulation, controls: np.ndarray, fallen: int) -> dict[str, Any]:
    """What there is to show of a frame: "rider", "herd" and "race", each None where there is no such thing.

    Args:
        simulation: What runs.
        controls: What the person does, by `CONTROLS`.
        fallen: How many have fallen.
    """
    scene = simulation.scene
    found: dict[str, Any] = {"rider": None, "herd": None, "race": None}
    if isinstance(scene, Field):
        counted = scene.group.referee.arrays.totals.numpy()
        count = simulation.scenario.crowd.count
        found["herd"] = {"in_corral": int(counted[0]), "agents": count, "fallen": fallen}
        collie = scene.group.collie
        if collie is not None and scene.control_names:
            bicycle = collie.arrays.bicycle
            speed, steering = float(bicycle.speed.numpy()[0]), float(bicycle.steering.numpy()[0])
            found["rider"] = _rider(controls, speed, steering, 0.0, PERSON[0])
    elif isinstance(scene, Road) and scene.control_names:
        found["race"] = _race(scene)
        user, settings = scene.peloton.user, simulation.scenario.user
        assert user is not None
        assert settings is not None
        speed, steering = user.speed_and_steering()
        found["rider"] = _rider(controls, speed, steering, gradient(simulation), settings.power)
    return found


def gradient(simulation: Simulation) -> float:
    """Of the road where the person is, rise over run; 0 on a field."""
    scene = simulation.scene
    if not isinstance(scene, Road):
        return 0.0
    s = float(scene.peloton.riders.s.numpy()[-1])
    line = scene.course.centreline
    return float(line.grade(s))


def pitch(pose: np.ndarray) -> float:
    """How much higher the front of a bicycle is [rad], from its pose x y z [m], quaternion (x, y, z, w)."""
    x, y, z, w = pose[3:]
    return math.asin(float(np.clip(2.0 * (x * z - y * w), -1.0, 1.0)))


def _rider(controls: np.ndarray, speed: float, steering: float, grade: float, strength: float) -> dict[str, Any]:
    gear = int(controls[_AT["gear"]])
    pedals = controls[_AT["effort"]] > 0.0 or controls[_AT["power"]] > 0.0
    return {
        "speed": speed,
        "gear": gear,
        "gears": len(DEVELOPMENTS),
        "cadence": 60.0 * cadence_of(speed, gear) if pedals else 0.0,
        "power": power_of(controls, speed, strength),
        "steering": math.degrees(steering),
        "gradient": 100.0 * grade,
    }


def _race(scene: Road) -> dict[str, Any]:
    """Where the person is among the riders."""
    referee, laps = scene.peloton.referee, scene.scenario.world.laps or scene.course.laps
    progress, finish = referee.arrays.progress.numpy(), referee.arrays.finish_frame.numpy()
    mine, others = float(progress[-1]), progress[:-1]
    done = finish != UNFINISHED
    # Who has come in is ahead of who has not, by when; else by how far along.
    ahead = np.where(done[:-1], ~done[-1] | (finish[:-1] < finish[-1]), ~done[-1] & (others > mine))
    gaps = others[ahead & ~done[:-1]] - mine
    length = scene.course.centreline.length
    return {
        "place": int(np.count_nonzero(ahead)) + 1,
        "of": len(progress),
        "gap": float(gaps.min()) if len(gaps) else None,
        "distance": mine,
        "length": length * laps,
        "lap": int(max(mine, 0.0) // length) + 1,
        "laps": laps,
    }
