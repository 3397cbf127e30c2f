"""A floor with gymnasts on it, each of whom follows a script (`Scene`).

They want nothing of one another: who does what, and when, is settled before the first frame (`roles`), and the engine
goes through their scripts by itself. At the end the gym tells who still stands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from echelon.agents.gymnasts.airborne import in_the_air
from echelon.agents.gymnasts.channels import SIDES
from echelon.agents.gymnasts.gymnast import ARMS_SPREAD, Gymnast
from echelon.agents.gymnasts.posture import channels_of
from echelon.agents.gymnasts.standing import site_points, standing_q
from echelon.recording import Actor
from echelon.scenario import Scenario
from echelon.simulation.casts import CastPart
from echelon.simulation.ground_below import ground_planes
from echelon.simulation.roles import Roles, evenly, roles_of
from echelon.simulation.scene import SceneFrames
from echelon.terrain.flat import FlatTerrain
from echelon.terrain.platform import PlatformTerrain
from echelon.terrain.walls import world_dict
from echelon.warp_kernels.character import Character, Population
from echelon.warp_kernels.frame import Engine, Terrain
from echelon.warp_kernels.replay import Share
from echelon.warp_kernels.spatial import quaternion_product

BALANCED_SPEED = 0.3
"""Who stands still has a centre of mass slower than this [m/s]."""

BALANCED_TILT = 0.6
"""And a pelvis tilted by less than this [rad]."""

_TOLD = (
    "fallen", "loaded", "vx", "vy", "vz", "upright", "row", "highest", "hardest", "somersault", "twist",
)  # fmt: skip
"""Memory variables that the summary needs."""


class Gym:
    """The gymnasts' world; see `Scene`.

    Attributes:
        casts: Who they are.
        roles: What they do.
    """

    measure_names: tuple[str, ...] = ()
    control_names: tuple[str, ...] = ()
    beyond = 0
    by_agent: frozenset[str] = frozenset()

    def __init__(self, scenario: Scenario, casts: Sequence[CastPart], device: str = "cpu") -> None:
        """
        Args:
            scenario: What plays, with the text of its maneuvers (`roles.with_scripts`).
            casts: Who they are.
            device: A Warp device.

        Raises:
            InputError: A maneuver is wrong, or has no parameter of a name that the scenario gives.
        """
        self.scenario = scenario
        self.casts = tuple(casts)
        self.roles: Roles = roles_of(scenario, casts)
        platform = scenario.world.platform
        self.terrain: Terrain = (
            FlatTerrain.of(scenario.world, device)
            if platform is None
            else PlatformTerrain.of(platform.height, platform.edge, platform.heading)
        )
        heading = scenario.performance.heading if scenario.performance is not None else 0.0
        self.world: Mapping[str, Any] = world_dict(scenario.world) | {"heading": heading}
        self.actors: tuple[Actor, ...] = ()
        self._device = device
        self._engines: tuple[Engine, ...] = ()
        self._starting_heights = np.zeros(scenario.crowd.count)

    def divide(self, share: Share) -> None:
        """Nobody's wants are worked out here."""

    def load(self) -> None:
        """There are no kernels to load."""

    def people(self, character: Character) -> tuple[Population, np.ndarray]:
        settings = self.scenario.performance
        assert settings is not None
        seed, count = self.scenario.population_seed, self.scenario.crowd.count
        q, u, balls = [], [], []
        parameters: dict[str, list[np.ndarray]] = {}
        memory: dict[str, list[np.ndarray]] = {}
        turn = [0.0, 0.0, math.sin(0.5 * settings.heading), math.cos(0.5 * settings.heading)]
        for cast in self.casts:
            # Individuals do not depend on how many others there are: those before are made and let go.
            people = cast.character.population(cast.first + cast.count, seed, settings.strength_variation, False)
            own = slice(cast.first, None)
            body = cast.character.body
            if settings.lean != 0.0:
                people = leaning(cast.character, people, settings.lean)
            if settings.falls:
                people = self._dropped(cast, people)
            self._starting_heights[cast.first : cast.first + cast.count] = body.center_of_mass(people.q[own])[:, 2]
            balls.append(np.full(cast.count, site_points(body, people.q[0])["left_ball_inner"][0]))
            rows = people.q[own].copy()
            rows[:, 3:7] = quaternion_product(turn, rows[0, 3:7].tolist())
            q.append(rows)
            u.append(people.u[own])
            for kept, given in ((parameters, people.parameters), (memory, people.memory)):
                for name, values in given.items():
                    kept.setdefault(name, []).append(values[own])
        parameters["heading"] = [np.full(count, settings.heading)]
        return (
            Population(
                np.concatenate(q),
                np.concatenate(u),
                {name: np.concatenate(values) for name, values in parameters.items()},
                {name: np.concatenate(values) for name, values in memory.items()},
            ),
            self._places(np.concatenate(balls), settings.heading),
        )

    def _dropped(self, cast: CastPart, people: Population) -> Population:
        """A cast in the air, each in the posture in which its maneuver begins."""
        settings = self.scenario.performance
        assert settings is not None
        assert isinstance(cast.character, Gymnast)
        tables, which = self.roles.tables
        spread = evenly(len(people.q), self.scenario.population_seed, "drop")
        falls = settings.drop + settings.drop_spread * spread
        forward = np.array([math.cos(settings.heading), math.sin(settings.heading)])
        q, u = people.q.copy(), people.u.copy()
        memory = {name: np.array(values) for name, values in people.memory.items()}
        for table in np.unique(which[cast.agents]):
            those = np.array(cast.agents)[which[cast.agents] == table]
            speeds = np.full(len(those), settings.drop_speed)
            dropped = in_the_air(cast.character, tables[table], speeds, falls=falls[those])
            q[those], u[those] = dropped.q, dropped.u
            u[those, :2] = speeds[:, None] * forward
            for name, values in dropped.memory.items():
                memory.setdefault(name, np.full(len(q), cast.character.memory[name]))[those] = values
        return replace(people, q=q, u=u, memory=memory)

    def _places(self, balls: np.ndarray, heading: float) -> np.ndarray:
        """Where everybody starts on the ground [m], shape [agents, 3]; casts are mixed among the places.

        Args:
            balls: How far ahead of the pelvis each one's balls of the feet are [m], shape [agents].
            heading: Which way they face [rad].
        """
        flat = self.scenario.start_positions()
        if len(self.casts) > 1 and not self.scenario.crowd.positions:
            bits = np.random.Philox(key=self.scenario.population_seed).random_raw(len(flat))
            flat = flat[np.argsort(bits, kind="stable")]
        places = np.column_stack([flat, np.zeros(len(flat))])
        if self.scenario.world.platform is not None:
            # Whoever stands at its edge stands on it, heels in the air or not: the balls of the feet are at the place.
            forward = np.array([math.cos(heading), math.sin(heading)])
            places[:, :2] -= balls[:, None] * forward
            places[:, 2] = self.scenario.world.platform.height
            return places
        planes = ground_planes(self.terrain, places, self._device)
        places[:, 2] = (planes[:, 3] - (planes[:, :2] * flat).sum(axis=1)) / planes[:, 2]
        return places

    def prepare(self, engines: Sequence[Engine]) -> None:
        tables, which = self.roles.tables
        for engine in engines:
            engine.set_scripts(tables, which[engine.mine])
        self._engines = tuple(engines)

    def public(self) -> dict[str, wp.array]:
        return {}

    def step(self, frame: int, engine: Engine, between: Callable[[], None] | None = None) -> None:
        """Scripts go on by themselves."""
        if between is not None:
            between()

    def keep(self, frame: int, slot: int, frames: SceneFrames) -> None:
        """The characters record what there is to know."""

    def keep_actors(self, slot: int, frames: SceneFrames) -> None:
        """There are none."""

    def begin(self) -> None:
        """Nothing is an event here."""

    @property
    def finished(self) -> bool:
        return False

    def ride(self, controls: np.ndarray) -> None:
        """Nobody rides among gymnasts."""

    def tallies(self) -> dict[str, wp.array]:
        count = self.scenario.crowd.count
        found = np.zeros((len(_TOLD), count), np.float32)
        for engine in self._engines:
            for place, name in enumerate(_TOLD):
                found[place, engine.mine] = engine.memory(name)
        self._told = {
            name: wp.array(values, dtype=wp.float32, device=self._device)
            for name, values in zip(_TOLD, found, strict=True)
        }
        return self._told

    def summary(self, last_frame: int, means: Mapping[str, np.ndarray]) -> dict[str, Any]:
        told = {name: array.numpy().astype(np.float64) for name, array in self._told.items()}
        speed = np.sqrt(told["vx"] ** 2 + told["vy"] ** 2 + told["vz"] ** 2)
        upright = told["upright"] > math.cos(BALANCED_TILT)
        balanced = (told["fallen"] < 0.5) & (told["loaded"] > 0.5) & (speed < BALANCED_SPEED) & upright
        rows = told["row"].astype(int) % self.roles.tables[0].shape[1]
        performers: list[dict[str, Any]] = []
        for cast in self.casts:
            for agent in cast.agents:
                role = self.roles.each[agent]
                performers.append(
                    {
                        "cast": cast.name,
                        "maneuver": role.maneuver,
                        "delay": role.delay,
                        "row": role.row_names[rows[agent]],
                        "balanced": bool(balanced[agent]),
                        "fallen": bool(told["fallen"][agent] > 0.5),
                        "rise": _rounded(told["highest"][agent] - self._starting_heights[agent]),
                        "peak_force": _rounded(told["hardest"][agent]),
                        "somersault": _rounded(told["somersault"][agent]),
                        "twist": _rounded(told["twist"][agent]),
                    }
                )
        return {
            "in_corral": 0,
            "balanced": int(balanced.sum()),
            "maneuvers": _by_maneuver(performers),
            "performers": performers,
        }

    def state(self) -> dict[str, np.ndarray]:
        return {}

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        """What there is of a state is the engines'."""


def leaning(character: Character, people: Population, lean: float) -> Population:
    """Gymnasts who stand with the centre of mass ahead of the middle of their feet by so much [m]."""
    q = standing_q(character.body, arms=0.5 * math.pi - ARMS_SPREAD, lean=lean)
    posture = channels_of(character.body, q) | {f"{side}_shoulder_spread": ARMS_SPREAD for side in SIDES}
    count = len(people.q)
    memory = Gymnast.remembering({channel: np.full(count, value) for channel, value in posture.items()})
    return replace(people, q=np.tile(q, (count, 1)), memory={**people.memory, **memory})


def _by_maneuver(performers: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """How many did each maneuver, and what came of it."""
    found: dict[str, dict[str, float]] = {}
    for name in dict.fromkeys(performer["maneuver"] for performer in performers):
        those = [performer for performer in performers if performer["maneuver"] == name]
        found[name] = {
            "performers": len(those),
            "balanced": sum(performer["balanced"] for performer in those),
            "fallen": sum(performer["fallen"] for performer in those),
            "mean_rise": _rounded(float(np.mean([performer["rise"] for performer in those]))),
            "mean_peak_force": _rounded(float(np.mean([performer["peak_force"] for performer in those]))),
        }
    return found


def _rounded(value: float) -> float:
    """To four digits: a summary is for people, and what is behind it is float32."""
    return float(f"{value:.4g}")
