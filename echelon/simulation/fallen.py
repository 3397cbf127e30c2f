"""What becomes of those who have fallen: they lie, or stand up again, or are taken away (`CrowdSettings.fallen`).

Whoever falls goes limp and lies where it came to rest; that is the character's own doing, and others see it there. What
comes after `fallen_seconds` is done here, between frames, to the few whom it concerns:

    lie       nothing
    stand     once it has come to rest and nobody else is where it would stand, it is *held*: the engine keeps it at the
              pose that is given for each frame (`echelon.agents.getting_up`), until its controller starts anew
    remove    it is *removed*: others do not see it, it touches nobody, and pictures and stages do not show it

In recordings those who are held or removed are in a phase of their own (`PHASES`), so that a reader sees it.

Whoever gets up goes by what everybody was in the frame before, so that it does not matter who is looked at first, nor
on which rank. Of two who lie close together only one begins at a time: each may begin in one frame of `TURNS` only, in
that frame the one of lower number first.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from echelon.agents.getting_up import getting_up
from echelon.errors import InputError
from echelon.recording import EVENT_NAMES, REMOVED_PHASE
from echelon.scenario import Scenario
from echelon.simulation.ground_below import ground_planes
from echelon.warp_kernels.character import HELD, LOST, REMOVED
from echelon.warp_kernels.frame import Engine
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.spatial import quaternion_product

PHASES = ("getting up", REMOVED_PHASE)
"""Phases of those who are held or removed, after the character's own."""

TURNS = 10
"""Each may begin to get up in one frame of so many."""

REST_SPEED = 0.5
"""Who moves faster than this has not come to rest [m/s]."""

STOREYS = 3.0
"""Others this much higher or lower are not in the way: the road may cross itself [m]."""

NUDGE = 1e-3
"""Part of the time over which speeds on the way are measured."""

SMOOTHING = 0.04
"""Sites that are lowest by less than this bear a body together while it gets up [m]."""

CANDIDATES_AT_ONCE = 64
"""So many are compared with the whole crowd at a time, which bounds memory."""

GONE = -1  # in the count of frames lain: has been removed


class Fallen:
    """Those of an engine's agents who have fallen, and what becomes of them.

    Attributes:
        mode: "lie", "stand" or "remove".
    """

    def __init__(self, scenario: Scenario, engine: Engine) -> None:
        """
        Args:
            scenario: For `crowd.fallen` and `crowd.fallen_seconds`.
            engine: Whose agents they are.

        Raises:
            InputError: They are to stand up, and this character cannot.
        """
        self.mode = scenario.crowd.fallen
        self._engine = engine
        self._wait = max(1, round(scenario.crowd.fallen_seconds * scenario.frame_rate))
        way = getting_up(engine.character)
        if self.mode == "stand" and way is None:
            raise InputError(
                f"crowd.fallen = 'stand': a {engine.character.name} cannot get up; must be 'lie' or 'remove'"
            )
        count, q_count = engine.agent_count, engine.character.body.q_count
        # How long each has lain, in frames; of those who get up: for how many frames, whence, and from which pose.
        self._lain = np.zeros(count if self.mode != "lie" else 0, np.int32)
        standing = count if self.mode == "stand" else 0
        self._rising = np.zeros(standing, np.int32)
        self._place = np.zeros((standing, 3))
        self._lying = np.zeros((standing, q_count), np.float32)
        self._way = way
        if way is not None:
            self._duration = round(way.seconds * engine.frame_rate)
        self._here = {name: array.numpy() for name, array in engine.public.items()} if engine.device == "cpu" else None

    @property
    def phase_names(self) -> tuple[str, ...]:
        """Of a recording: the character's, and where somebody may be in them those of `PHASES`."""
        names = self._engine.character.phase_names
        return names if self.mode == "lie" else (*names, *PHASES)

    def summary(self, counts: Mapping[str, int]) -> dict[str, int]:
        """What a run's summary says of it, given how often each kind of event has happened."""
        if self.mode == "lie":
            return {}
        return {"stood_up": counts["stand"]} if self.mode == "stand" else {"removed": counts["remove"]}

    # ---- between frames --------------------------------------------------------------------------------------------
    def step(self, frame: int) -> list[tuple[int, int, int, int]]:
        """Before the engine advances to a frame: do what is due.

        Args:
            frame: Its number.

        Returns:
            (frame, substep, agent, index into `EVENT_NAMES`) of those who stand again or are gone from this frame on.
        """
        if self.mode == "lie":
            return []
        down = self._public("fallen")[self._engine.mine] != 0
        if not down.any():
            self._lain[:] = 0
            return []
        self._lain[:] = np.where(self._lain == GONE, GONE, np.where(down, self._lain + 1, 0))
        if self.mode == "remove":
            who = np.flatnonzero(self._lain > self._wait)
            self._remove(who)
        else:
            who = self._rise(frame)
        kind = EVENT_NAMES.index("stand" if self.mode == "stand" else "remove")
        return [(frame, 0, int(agent) + self._engine.first_agent, kind) for agent in who]

    def _remove(self, agents: np.ndarray) -> None:
        if not len(agents):
            return
        rows = self._rows(agents)
        rows[~np.isfinite(rows)] = 0.0
        layout = self._engine.layout
        rows[:, layout.frozen] = REMOVED
        rows[:, layout.memory["fallen"]] = 1.0
        rows[:, layout.memory["loaded"]] = 0.0
        rows[:, layout.memory["phase"]] = len(self._engine.character.phase_names) + PHASES.index(REMOVED_PHASE)
        rows[:, layout.u : layout.u + self._engine.character.body.u_count] = 0.0
        self._set_rows(agents, rows)
        self._lain[agents] = GONE

    def _rise(self, frame: int) -> np.ndarray:
        """Let begin whoever may, take on whoever is on the way; returns those who stand again."""
        first = self._engine.first_agent
        waiting = (self._lain > self._wait) & (self._rising == 0)
        waiting &= (np.arange(first, first + len(waiting)) - frame) % TURNS == 0
        candidates = np.flatnonzero(waiting)
        if len(candidates):
            self._begin(candidates, frame)
        self._rising[self._rising > 0] += 1
        # One frame more than the way is long: in the one before it is where its controller will start.
        done = np.flatnonzero(self._rising > self._duration + 1)
        if len(done):
            self._set_rows(done, self._fresh_rows(done))
            self._rising[done] = 0
            self._lain[done] = 0
        rising = np.flatnonzero(self._rising > 0)
        if len(rising):
            self._hold(rising)
        return done

    # ---- who may begin ---------------------------------------------------------------------------------------------
    def _begin(self, candidates: np.ndarray, frame: int) -> None:
        """Of those who have lain long enough, let begin whoever lies still and has room."""
        engine = self._engine
        speeds = self._public("velocities")[candidates + engine.first_agent]
        still = np.sum(speeds * speeds, axis=1) < REST_SPEED**2
        rows = self._rows(candidates)
        may = still & (rows[:, engine.layout.frozen] != LOST)
        if not may.any():
            return
        candidates, rows = candidates[may], rows[may]
        body = engine.character.body
        self._lying[candidates] = rows[:, engine.layout.q : engine.layout.q + body.q_count]
        self._place[candidates] = self._origins()[candidates] + self._lying[candidates, :3]
        candidates = candidates[self._has_room(candidates, frame)]
        self._rising[candidates] = 1

    def _has_room(self, agents: np.ndarray, frame: int) -> np.ndarray:
        """Whether nobody is in the way of each, neither where it lies nor where it will be."""
        assert self._way is not None
        first, crowd = self._engine.first_agent, self._engine.crowd_count
        heading = self._heading(agents)
        ahead = np.column_stack([np.cos(heading), np.sin(heading)])
        start = self._place[agents]
        end = start[:, :2] + self._way.advance(np.ones(len(agents)))[:, None] * ahead
        positions = self._public("positions").astype(np.float64)
        fallen = self._public("fallen")
        numbers = np.arange(crowd)
        free = np.ones(len(agents), bool)
        for begin in range(0, len(agents), CANDIDATES_AT_ONCE):
            part = slice(begin, begin + CANDIDATES_AT_ONCE)
            mine = agents[part, None] + first
            # Who lies there too is in the way only if it may begin in this frame, and comes first.
            rival = (fallen != 1) | ((numbers < mine) & ((numbers - frame) % TURNS == 0))
            level = np.abs(positions[:, 2] - start[part, None, 2]) < STOREYS
            near = np.zeros_like(rival)
            for place in (start[part, :2], end[part]):
                gaps = positions[None, :, :2] - place[:, None]
                near |= np.sum(gaps * gaps, axis=2) < self._way.clearance**2
            free[part] = ~np.any(near & level & rival & (numbers != mine), axis=1)
        return free

    # ---- on the way ------------------------------------------------------------------------------------------------
    def _hold(self, agents: np.ndarray) -> None:
        """Give those who get up the pose of this frame, and its speeds."""
        engine, layout = self._engine, self._engine.layout
        body = engine.character.body
        s = np.minimum((self._rising[agents] - 1) / self._duration, 1.0)
        q, u = self._moving(agents, s)
        rows = self._memory_rows(len(agents), {})
        rows[:, layout.frozen] = HELD
        rows[:, layout.memory["fallen"]] = 1.0
        rows[:, layout.memory["phase"]] = len(engine.character.phase_names) + PHASES.index("getting up")
        q[:, :3] -= self._origins()[agents]
        rows[:, layout.q : layout.q + body.q_count] = q
        rows[:, layout.u : layout.u + body.u_count] = u
        self._set_rows(agents, rows)

    def _moving(self, agents: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """q, the root's in the world, and u of those who get up, after parts s of the time."""
        assert self._way is not None
        count = len(agents)
        before, after = np.maximum(s - NUDGE, 0.0), np.minimum(s + NUDGE, 1.0)
        q = self._posed(np.tile(agents, 3), np.concatenate([before, s, after]))
        duration = (after - before) * self._way.seconds
        return q[count : 2 * count], _speeds(q[:count], q[2 * count :], duration)

    def _posed(self, agents: np.ndarray, s: np.ndarray) -> np.ndarray:
        """q of those who get up, the root's in the world, after parts s of the time."""
        way, engine = self._way, self._engine
        assert way is not None
        lying, place, heading = self._lying[agents].astype(np.float64), self._place[agents], self._heading(agents)
        ahead = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(len(agents))])
        below = ground_planes(engine.terrain, place, engine.device)
        # Where it began, seen from the ground beneath it: how high over what its shape would have it be.
        foot = place - _over(place, below)[:, None] * below[:, :3]
        begun = _over(place, below)[:, None] - _touching(way.body, lying, below[:, :3])
        path = foot + way.advance(s)[:, None] * ahead
        planes = ground_planes(engine.terrain, path, engine.device)
        path[:, 2] = (planes[:, 3] - planes[:, 0] * path[:, 0] - planes[:, 1] * path[:, 1]) / planes[:, 2]
        grade = -np.sum(planes[:, :2] * ahead[:, :2], axis=1) / planes[:, 2]

        last = way.fresh(lying, heading, grade, self._parameters(agents)).q
        ended = np.sum(last[:, :3] * planes[:, :3], axis=1)[:, None] - _touching(way.body, last, planes[:, :3])
        posture = way.posture(s, lying, heading, grade)
        q = lying + way.joints(s)[:, None] * (posture - lying)
        q[:, 3:7] = _slerp(lying[:, 3:7], posture[:, 3:7], way.turn(s))
        share = (s * s * (3.0 - 2.0 * s))[:, None]
        exact, smooth = np.moveaxis(_touching(way.body, q, planes[:, :3]), 1, 0)
        beyond = (1.0 - share) * begun + share * ended
        sunk = (1.0 - share) * np.minimum(begun, 0.0) + share * np.minimum(ended, 0.0)
        height = np.maximum(smooth + beyond[:, 1], exact + sunk[:, 0])
        q[:, :3] = path + height[:, None] * planes[:, :3]
        return q

    def _fresh_rows(self, agents: np.ndarray) -> np.ndarray:
        """State of those who start anew where they have got up."""
        engine, layout, way = self._engine, self._engine.layout, self._way
        assert way is not None
        body, heading = engine.character.body, self._heading(agents)
        at = self._posed(agents, np.ones(len(agents)))
        planes = ground_planes(engine.terrain, at[:, :3], engine.device)
        ahead = np.column_stack([np.cos(heading), np.sin(heading)])
        grade = -np.sum(planes[:, :2] * ahead, axis=1) / planes[:, 2]
        lying = self._lying[agents].astype(np.float64)
        fresh = way.fresh(lying, heading, grade, self._parameters(agents))
        rows = self._memory_rows(len(agents), fresh.memory)
        q = fresh.q
        q[:, :3] = at[:, :3] - self._origins()[agents]
        rows[:, layout.q : layout.q + body.q_count] = q
        rows[:, layout.u : layout.u + body.u_count] = fresh.u
        return rows

    def _heading(self, agents: np.ndarray) -> np.ndarray:
        """Direction in plan that each faces once it is upright: by the shortest turn from how it lies [rad]."""
        # Of a turn about any axis, the part about the vertical: what is left once it does not tilt any more.
        z, w = self._lying[agents, 5].astype(np.float64), self._lying[agents, 6].astype(np.float64)
        return 2.0 * np.arctan2(np.where(w < 0.0, -z, z), np.abs(w))

    # ---- the engine's rows -----------------------------------------------------------------------------------------
    def _memory_rows(self, count: int, memory: Mapping[str, np.ndarray]) -> np.ndarray:
        """State of controllers as they start, all else zero, shape [count, size]."""
        layout, character = self._engine.layout, self._engine.character
        rows = np.zeros((count, layout.size), np.float32)
        for name, value in {**character.memory, **memory}.items():
            rows[:, layout.memory[name]] = value
        return rows

    def _places(self, agents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.divmod(agents, self._engine.lanes)

    def _rows(self, agents: np.ndarray) -> np.ndarray:
        """State of some agents, shape [agents, size]; a copy."""
        block, lane = self._places(agents)
        return self._engine.state.numpy()[block, :, lane]

    def _set_rows(self, agents: np.ndarray, rows: np.ndarray) -> None:
        block, lane = self._places(agents)
        host = self._engine.state.numpy()
        host[block, :, lane] = rows
        if self._here is None:
            self._engine.state.assign(host)

    def _parameters(self, agents: np.ndarray) -> dict[str, np.ndarray]:
        block, lane = self._places(agents)
        host = self._engine.parameters.numpy()
        names = self._engine.program.parameter_names
        return {name: host[block, place, lane].astype(np.float64) for place, name in enumerate(names)}

    def _origins(self) -> np.ndarray:
        return self._engine.origins.numpy()

    def _public(self, name: str) -> np.ndarray:
        """What everybody was in the frame before, by number in the crowd."""
        return self._engine.public[name].numpy() if self._here is None else self._here[name]

    # ---- state -----------------------------------------------------------------------------------------------------
    def state(self) -> dict[str, np.ndarray]:
        """All that the next frame depends on, a row for each of the engine's agents; copies. Nothing where they lie."""
        if self.mode == "lie":
            return {}
        if self.mode == "remove":
            return {"lain": self._lain.copy()}
        arrays = {"lain": self._lain, "rising": self._rising, "place": self._place, "lying": self._lying}
        return {name: array.copy() for name, array in arrays.items()}

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from what `state` gave, of the whole crowd: with a row for each agent of it."""
        mine: dict[str, Any] = {name: array[self._engine.mine] for name, array in state.items()}
        if self.mode == "lie":
            return
        self._lain[:] = mine["lain"]
        if self.mode == "stand":
            self._rising[:], self._place[:], self._lying[:] = mine["rising"], mine["place"], mine["lying"]


# ---- geometry --------------------------------------------------------------------------------------------------------
def _over(places: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Height of places over their planes [m]."""
    return np.sum(places * planes[:, :3], axis=1) - planes[:, 3]


def _touching(body: Body, q: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """How high above a plane the root is where the lowest contact site just touches it [m], shape [agents, 2].

    Once as it is, and once a little more, so that it changes smoothly as another site becomes the lowest.

    Args:
        body: Whose.
        q: Generalised positions, wherever the root is, shape [agents, q_count].
        normals: Of the planes, shape [agents, 3].
    """
    q = q.copy()
    q[:, :3] = 0.0
    kin = body.kinematics(q, np.zeros((len(q), body.u_count)))
    heights = []
    for site in body.contacts:
        if site.surface != "ground":
            continue
        rotation, origin = kin.world(body.tree.node_of_link[body.link_index(site.link)])
        # The plane's normal in the link's axes, and how far the site reaches against it.
        normal = [sum(rotation[i][j] * normals[:, i] for i in range(3)) for j in range(3)]
        middle = sum(origin[i] * normals[:, i] + normal[i] * site.position[i] for i in range(3))
        reach = np.sqrt(sum((site.radii[i] * normal[i]) ** 2 for i in range(3)))
        heights.append(reach - middle)
    found = np.array(heights)
    exact = found.max(axis=0)
    smooth = exact + SMOOTHING * np.log(np.sum(np.exp((found - exact) / SMOOTHING), axis=0))
    return np.stack([exact, smooth], axis=1)


def _slerp(a: np.ndarray, b: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Unit quaternions on the short way from a to b, shape [agents, 4]."""
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    cosine = np.sum(a * b, axis=1)
    b = np.where(cosine[:, None] < 0.0, -b, b)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    sine = np.sin(angle)
    straight = sine < 1e-6
    first = np.where(straight, 1.0 - share, np.sin((1.0 - share) * angle) / np.where(straight, 1.0, sine))
    second = np.where(straight, share, np.sin(share * angle) / np.where(straight, 1.0, sine))
    mixed = first[:, None] * a + second[:, None] * b
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


def _speeds(before: np.ndarray, after: np.ndarray, duration: np.ndarray) -> np.ndarray:
    """Generalised speeds between two positions [agents, q_count], so long apart [s]; shape [agents, u_count]."""
    x, y, z, w = (before[:, 3 + i] * sign for i, sign in enumerate((-1.0, -1.0, -1.0, 1.0)))
    turn = np.stack(quaternion_product([x, y, z, w], [after[:, 3 + i] for i in range(4)]), axis=1)
    turn = np.where(turn[:, 3:] < 0.0, -turn, turn)
    change = np.concatenate([after[:, :3] - before[:, :3], 2.0 * turn[:, :3], after[:, 7:] - before[:, 7:]], axis=1)
    return change / duration[:, None]
