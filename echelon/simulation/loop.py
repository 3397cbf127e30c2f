"""The frame loop: see, want, act, record.

    frame k                                                              frame k+1
    see --> want --> act: substeps of control, contact and dynamics --> record --> see ...

Characters meet only at frame boundaries, through what the group layer sees of them there (`scene`); within a frame
each is alone with the ground beneath it and one kernel launch carries everybody across
(`echelon.warp_kernels.frame`). What happened streams to a recording (`recorded`).

Where several ranks simulate one crowd (`echelon.ranks`), each has some of the agents, and after acting all tell each
other what others see of them: that is all that passes between them in a frame. What a scene does for everybody (the
hash grid, the collie) every rank does alike, from the same numbers.

Time is a whole number of frames; frame 0 is the start.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from echelon.ranks import Ranks
from echelon.recording import EVENT_NAMES
from echelon.scenario import Scenario
from echelon.simulation.casts import casts_of, joined_states, share_public
from echelon.simulation.cost import PhaseClock
from echelon.simulation.fallen import Fallen
from echelon.simulation.field import Field
from echelon.simulation.gym import Gym
from echelon.simulation.roles import with_scripts
from echelon.simulation.scene import Scene, SceneFrames
from echelon.simulation.telling import Telling
from echelon.warp_kernels.character import Character
from echelon.warp_kernels.frame import ChunkArrays, Engine
from echelon.warp_kernels.meetings import ContactSettings
from echelon.warp_kernels.replay import Share
from echelon.warp_kernels.start import checked_device


class Simulation:
    """A scenario that is running: who, where, what they want, and the frame that it has come to.

    Attributes:
        scenario: What runs.
        casts: Who.
        scene: Where, and what they want.
        engines: Everybody's bodies, an engine for each cast that has agents here; those of one crowd share what agents
            see of one another.
        fallen: What becomes of those who fall.
        frame: Frames done; frame 0, the start, counts as one once it has been observed.
        counts: How often each kind of event has happened, in chunks that are done.
        measure_sums: Of each measure over the frames of these chunks, shape [agents, measures], of this rank's agents.
        ranks: Who simulate the crowd together.
        clock: Seconds spent in each phase so far: `clock.seconds`, by `echelon.simulation.cost.PHASES`.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        threads: int | None = None,
        device: str = "cpu",
        world: Mapping[str, Any] | None = None,
        ranks: Ranks | None = None,
    ) -> None:
        """Put everybody where they start.

        Args:
            scenario: What to run.
            threads: On a CPU; 0 decides by the work there is; None leaves it to the scenario.
            device: A Warp device, "cpu", "cuda" or "cuda:1".
            world: That of the recording to go on with; None makes it anew.
            ranks: Who simulate the crowd together; None for this process alone.

        Raises:
            InputError: There are more ranks than agents, or the scenario asks for what is not there, or there is no
                such device.
        """
        device = checked_device(device)
        self.ranks = ranks or Ranks()
        self.ranks.check(scenario.crowd.count)
        first, count = self.ranks.part(scenario.crowd.count)
        scenario = with_scripts(scenario) if scenario.performs else scenario
        self.scenario = scenario
        self.mine = slice(first, first + count)
        self.casts = casts_of(scenario)
        if scenario.performs:
            self.scene: Scene = Gym(scenario, self.casts, device)
        elif scenario.on_road:
            # Loaded where it is ridden on: what lays a road is a third of the time that a run takes to begin.
            from echelon.simulation.road import Road

            self.scene = Road(scenario, device, world)
        else:
            self.scene = Field(scenario, device)
        parts = [(cast, range(max(cast.first, first), min(cast.agents.stop, first + count))) for cast in self.casts]
        threads = scenario.engine.threads if threads is None else threads
        self.engines = tuple(self._engine_of(cast.character, part, threads, device) for cast, part in parts if part)
        share_public(self.engines)
        self.scene.divide(Share(scenario.crowd.count, first, count, self.engine.team, self.scene.beyond))
        with self.ranks.first_before_others():
            for engine in self.engines:
                engine.load()
            self.scene.load()
        self._populate()
        self.fallen = Fallen(scenario, self.engine)
        self.frame = 0
        self.counts = dict.fromkeys(EVENT_NAMES, 0)
        self.measure_sums = np.zeros((count, len(self.measure_names)))
        self.clock = PhaseClock()
        self._seen = partial(self.clock.lap, "see")
        public = {f"engine.{name}": array for name, array in self.engine.public.items()}
        public |= {f"scene.{name}": array for name, array in self.scene.public().items()}
        self._tell = Telling(self.ranks, scenario.crowd.count, public)

    def _engine_of(self, character: Character, agents: range, threads: int, device: str) -> Engine:
        """The engine of some agents of the crowd, by their numbers."""
        crowd, settings = self.scenario.crowd, self.scenario.engine
        needs = character.steps_per_second, character.steps_per_tick
        substeps, tick = settings.stride(self.scenario.frame_rate, *needs)
        return Engine(
            character,
            len(agents),
            self.scene.terrain,
            frame_rate=self.scenario.frame_rate,
            substeps=substeps,
            tick=tick,
            integrator=settings.integrator,
            lanes=settings.lanes,
            threads=threads,
            device=device,
            first_agent=agents.start,
            crowd_count=crowd.count,
            contact=ContactSettings(crowd.restitution, crowd.friction) if crowd.contact else None,
        )

    @property
    def engine(self) -> Engine:
        """The engine of the first cast, the only one of most crowds."""
        return self.engines[0]

    @property
    def character(self) -> Character:
        """Who the first cast are; phases, events and records are the same for all."""
        return self.casts[0].character

    @property
    def bytes_told(self) -> int:
        """What other ranks are told of one agent, each frame."""
        return self._tell.bytes_per_agent

    @property
    def measure_names(self) -> tuple[str, ...]:
        """What is measured of each agent in each frame: the character's own, then the scene's."""
        return (*self.character.records, *self.scene.measure_names)

    def _populate(self) -> None:
        people, places = self.scene.people(self.character)
        for engine in self.engines:
            engine.set_q(people.q[engine.mine])
            engine.set_u(people.u[engine.mine])
            for name, values in people.parameters.items():
                engine.set_parameter(name, values[engine.mine])
            for name, values in people.memory.items():
                engine.set_memory(name, values[engine.mine])
            engine.set_origins(places[engine.mine])
        self.scene.prepare(self.engines)

    # ---- state -----------------------------------------------------------------------------------------------------
    def state(self) -> dict[str, np.ndarray]:
        """Everything that the next frame depends on, by name; copies. Of agents, those of this rank."""
        return self.shared_state() | self.agent_state()

    def shared_state(self) -> dict[str, np.ndarray]:
        """What there is of the state that is not of single agents; the same on all ranks."""
        scene = {f"scene.{k}": array for k, array in self.scene.state().items() if k not in self.scene.by_agent}
        return scene | {"counts": np.array(list(self.counts.values()), dtype=np.int64)}

    def agent_state(self) -> dict[str, np.ndarray]:
        """What there is of it with a row for each agent, of this rank."""
        engine = {f"engine.{name}": array for name, array in joined_states(self.engines).items()}
        scene = {f"scene.{k}": array[self.mine] for k, array in self.scene.state().items() if k in self.scene.by_agent}
        scene |= {f"fallen.{name}": array for name, array in self.fallen.state().items()}
        return engine | scene | {"measure_sums": self.measure_sums.copy()}

    def load_state(self, state: Mapping[str, np.ndarray], frame: int) -> None:
        """Go on from what `state` gave when ``frame`` was the next; of agents, from that of the whole crowd."""
        parts: dict[str, dict[str, np.ndarray]] = {"engine": {}, "scene": {}, "fallen": {}}
        for name, array in state.items():
            room, _, rest = name.partition(".")
            if rest:
                parts[room][rest] = array
        for engine in self.engines:
            engine.load_full_state(parts["engine"])
        self.scene.load_state(parts["scene"])
        self.fallen.load_state(parts["fallen"])
        self.counts = dict(zip(self.counts, map(int, state["counts"]), strict=True))
        self.measure_sums = np.array(state["measure_sums"][self.mine])
        self.frame = frame
        self.scene.begin()

    def state_hash(self) -> str:
        """SHA-256 of the present state: equal for equal runs, on any number of ranks; all call it at once."""
        digest = hashlib.sha256()
        shared, agents = self.shared_state(), self.agent_state()
        for name in sorted([*shared, *agents]):
            digest.update(name.encode())
            for rows in [shared[name]] if name in shared else self.ranks.in_order(agents[name]):
                digest.update(np.ascontiguousarray(rows).reshape(-1).view(np.uint8).data)
        return self.ranks.broadcast(digest.hexdigest())

    # ---- frames ----------------------------------------------------------------------------------------------------
    def advance(self, slot: int, seen: SceneFrames) -> None:
        """One frame into a slot: everybody acts on what was wanted before, then sees, and wants anew.

        The first frame is only looked at: nobody has moved yet.
        """
        clock = self.clock
        clock.start()
        if self.frame > 0:
            seen.events += self.fallen.step(self.frame)
        for engine in self.engines:
            engine.advance(slot, observe_only=self.frame == 0)
        clock.lap("act")
        self._tell()
        clock.lap("exchange")
        self.scene.keep_actors(slot, seen)
        clock.lap("record")
        self.scene.step(self.frame, self.engine, self._seen)
        clock.lap("want")
        self.scene.keep(self.frame, slot, seen)
        clock.lap("record")
        self.frame += 1

    def bind(self, frames: int) -> tuple[ChunkArrays, ...]:
        """Let each engine observe into a chunk of so many frames; returns the chunks, engine by engine."""
        chunks = []
        for engine in self.engines:
            chunks.append(ChunkArrays.allocate(frames, engine.agent_count, engine.character, engine.device))
            engine.bind(chunks[-1])
        return tuple(chunks)

    def preroll(self) -> None:
        """Simulate the scenario's preroll, unrecorded; frame 0 is where it ends."""
        count = round(self.scenario.shot.preroll * self.scenario.frame_rate)
        if count == 0:
            return
        self.bind(1)
        for frame in range(count):
            if frame > 0:
                self.fallen.step(frame - count)
            for engine in self.engines:
                engine.advance(0, observe_only=frame == 0)
            self._tell()
            self.scene.step(frame - count, self.engine)
        self.scene.begin()

    @property
    def finished(self) -> bool:
        """Whether what the scenario runs until has come about."""
        return self.scene.finished

    def summary(self) -> dict[str, object]:
        """What the run came to; nothing in it depends on the clock. All ranks call it at once."""
        state_hash = self.state_hash()
        sums = self.ranks.gather(self.measure_sums)
        Telling(self.ranks, self.scenario.crowd.count, self.scene.tallies())()
        return self.ranks.broadcast(self._summary(sums, state_hash) if self.ranks.is_first else None)

    def _summary(self, measure_sums: np.ndarray, state_hash: str) -> dict[str, object]:
        last = self.frame - 1
        means = dict(zip(self.measure_names, measure_sums.T / self.frame, strict=True))
        return {
            "frames": self.frame,
            "seconds": last / self.scenario.frame_rate,
            "falls": self.counts["fall"],
            "collisions": self.counts["collision"],
            "contacts": self.counts["contact"],
            "nonfinite": self.counts["nonfinite"],
            **self.fallen.summary(self.counts),
            **self.scene.summary(last, means),
            "state_hash": state_hash,
        }

    def close(self) -> None:
        """Let go of threads."""
        for engine in self.engines:
            engine.close()
