"""Whom the agents of an engine meet: what contact is like, the hash grid, the ghosts, and what others see of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from echelon.warp_kernels import ghosts
from echelon.warp_kernels.ghosts import PublicMotion, bumper_data, choose_ghosts, enter_bodies, ghost_table
from echelon.warp_kernels.meeting import GHOSTS, Bumper
from echelon.warp_kernels.meeting_code import DUE_SIZE, contact_frequency, ghost_size
from echelon.warp_kernels.neighbours import empty_cells
from echelon.warp_kernels.replay import LIGHT_SLICE, dealt, slices
from echelon.warp_kernels.restitution import restitution_damping


@dataclass(frozen=True)
class ContactSettings:
    """What it is like when two characters touch.

    Attributes:
        restitution: Speed at which they part over the speed at which they met, 0 to 1.
        friction: Coulomb coefficient.
    """

    restitution: float = 0.3
    friction: float = 0.3


_PUBLIC: dict[str, tuple[Any, tuple[int, ...]]] = {
    "places": (wp.vec3d, ()),
    "attitudes": (wp.quat, ()),
    "spins": (wp.vec3, ()),
    "bearings": (wp.int32, ()),
    "partners": (wp.int32, (GHOSTS,)),
    "given": (wp.vec3, (GHOSTS,)),
}
"""What others see, by name: type, and shape of a row."""


def _public(count: int, device: wp.DeviceLike) -> dict[str, wp.array]:
    """Nobody can be touched, and nobody has met anybody."""
    arrays = {name: wp.zeros((count, *row), dtype=dtype, device=device) for name, (dtype, row) in _PUBLIC.items()}
    arrays["partners"].fill_(-1)
    return arrays


class NobodyMet:
    """Stands in for `Meetings` where there is no contact: arrays that nothing reads."""

    def __init__(self, device: wp.DeviceLike) -> None:
        self.ghosts = wp.zeros((1, 1, 1), dtype=wp.float32, device=device)
        self.law = wp.zeros(2, dtype=wp.float32, device=device)
        self.counts = wp.zeros(1, dtype=wp.int32, device=device)
        self.indices = wp.zeros((1, 1), dtype=wp.int32, device=device)
        self.pressed = wp.zeros((1, 1), dtype=wp.float32, device=device)
        self.public = _public(1, device)


class Meetings:
    """The ghosts of an engine's agents.

    Attributes:
        bumper: What others meet of each.
        settings: What contact is like.
        law: Damping ratio and friction, for the kernel.
        public: What others see of everybody besides positions and velocities, by name, shape [crowd] each.
        counts: How many ghosts each of the engine's agents has in this frame, shape [blocks * lanes].
        indices: Their numbers in the crowd, nearest first, shape [blocks * lanes, GHOSTS].
        ghosts: What each is due, and the numbers of its ghosts, shape [blocks, DUE_SIZE + GHOSTS * ghost_size, lanes].
        pressed: How far the springs between each and those whom it met in the frame before were pressed when that
            ended [m], shape [blocks * lanes, GHOSTS * pairs].
        crossings: How deep each of the agents overlapped another when the frame began [m], shape [blocks * lanes].
    """

    def __init__(
        self,
        bumper: Bumper,
        settings: ContactSettings,
        *,
        gravity: float,
        substep: float,
        frame: float,
        shape: tuple[int, int],
        agents: tuple[int, int, int],
        device: str,
    ) -> None:
        """Nobody is near anybody yet.

        Args:
            bumper: What others meet of each.
            settings: What contact is like.
            gravity: [m/s^2].
            substep, frame: Lengths [s].
            shape: Blocks, and agents of each.
            agents: Number in the crowd of the engine's first agent, how many are its own, and how many there are.
            device: Where everything lives.
        """
        blocks, lanes = shape
        self.first_agent, self.agent_count, self.crowd_count = agents
        self.bumper = bumper
        self.settings = settings
        self._lanes = lanes
        self._frame = frame
        self._device = device
        damping = restitution_damping(settings.restitution, contact_frequency(substep) * substep)
        self.law = wp.array([damping, settings.friction], dtype=wp.float32, device=device)
        # Nobody can be touched before the engine has said where everybody is.
        self.public = _public(self.crowd_count, device)
        rows = blocks * lanes
        self.counts = wp.zeros(rows, dtype=wp.int32, device=device)
        self.crossings = wp.zeros(rows, dtype=wp.float32, device=device)
        self.ghosts = wp.zeros((blocks, DUE_SIZE + GHOSTS * ghost_size(bumper), lanes), dtype=wp.float32, device=device)
        self.indices = wp.zeros((rows, GHOSTS), dtype=wp.int32, device=device)
        self.pressed = wp.zeros((rows, GHOSTS * bumper.pair_count), dtype=wp.float32, device=device)
        self._gaps = wp.zeros((rows, GHOSTS), dtype=wp.float32, device=device)
        self._table = ghost_table(bumper, self.crowd_count, device)
        self._data = bumper_data(bumper, gravity, device)

    def load(self) -> None:
        """Load the kernels that look for neighbours."""
        wp.load_module(ghosts, device=self._device)

    def set_pressed(self, pressed: np.ndarray) -> None:
        """Go on from the `pressed` of the engine's own agents."""
        host = self.pressed.numpy()
        host[: len(pressed)] = pressed
        self.pressed.assign(host)

    @property
    def deepest_crossing(self) -> float:
        """How deep any of the agents overlapped another when the last frame began [m]."""
        return float(np.max(self.crossings.numpy()[: self.agent_count]))

    def phases(
        self, threads: int, state: wp.array, origins: wp.array, velocities: wp.array
    ) -> list[list[Callable[[], None]]]:
        """What is to be launched at the beginning of a frame, in slices for so many threads (see `replay`).

        Args:
            threads: How many.
            state, origins: The engine's.
            velocities: Of everybody's first link, shape [crowd] [m/s].
        """
        self.load()
        public = PublicMotion()
        public.places, public.attitudes = self.public["places"], self.public["attitudes"]
        public.velocities, public.spins = velocities, self.public["spins"]
        public.bearings = self.public["bearings"]
        public.partners, public.given = self.public["partners"], self.public["given"]
        table, data = self._table, self._data

        def clear() -> None:
            empty_cells(table)

        def enter(first: int, count: int) -> None:
            wp.launch(enter_bodies, count, inputs=[first, public, data, table], device=self._device)

        def choose(first: int, count: int) -> None:
            inputs = [first, self.first_agent, self._lanes, self._frame, data, table, public, state, origins]
            inputs += [self.pressed]
            outputs = [self.indices, self._gaps, self.counts, self.crossings, self.ghosts]
            wp.launch(choose_ghosts, count, inputs=inputs, outputs=outputs, device=self._device)

        everybody = slices(self.crowd_count, min(threads, self.crowd_count // LIGHT_SLICE))
        own = dealt(self.agent_count, threads)
        return [[clear], [partial(enter, *part) for part in everybody], [partial(choose, *part) for part in own]]
