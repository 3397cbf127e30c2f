"""The group layer of a scenario: the herd, the collie, and the referee, in one go a frame.

    see         the hash grid, and everybody's nearest neighbours in it
    referee     who is in the corral, who passed its gate, who collided, in this frame
    want        desired velocities of everybody, from the places and velocities of this frame and the collie's
    collie      rides on to the next frame, as everybody else is about to

The launches of a frame are captured once in graphs and replayed, a large crowd's in slices over threads
(`echelon.warp_kernels.replay`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import ModuleType

import numpy as np
import warp as wp

from echelon.flocking import bicycle, commanded, drivers, herding, marching, person, referee
from echelon.flocking.collie import Collie
from echelon.flocking.herd import Herd
from echelon.flocking.referee import Referee
from echelon.scenario import Scenario
from echelon.warp_kernels import neighbours
from echelon.warp_kernels.replay import Phase, Replay, Share, launch_all, side_by_side


class Group:
    """What a crowd wants, whom it flees from, and how it fares.

    Attributes:
        herd: The crowd as a herd.
        collie: Whom it flees from, if there is anybody.
        referee: Who counts.
        share: Which agents it is for, and on which threads; set it before the first step.
    """

    def __init__(self, scenario: Scenario, device: wp.DeviceLike = None) -> None:
        """Make the group layer of a scenario; nothing has been seen yet, and the collie is at its start.

        Args:
            scenario: Herd, world, collie, number of agents, frame rate and seed are read.
            device: Where everything lives.
        """
        count, rate = scenario.crowd.count, scenario.frame_rate
        self.collie: Collie | None = None
        if scenario.collie is not None:
            self.collie = Collie(scenario.collie, scenario.herd, scenario.world, count, frame_rate=rate, device=device)
        self.herd = Herd(
            scenario.herd,
            scenario.world,
            count,
            frame_rate=rate,
            seed=scenario.seed,
            user=None if self.collie is None else self.collie.arrays.user,
            device=device,
        )
        # Before the first frame everybody means to go on as they start.
        self.herd.arrays.intended.fill_(wp.vec2(*scenario.crowd.start_velocity))
        self.referee = Referee(scenario.herd, scenario.world, count, device=device)
        self._device = wp.get_device(device)
        self._frame = wp.zeros(1, dtype=wp.int32, device=device)
        self._nobody_fell = wp.zeros(count, dtype=wp.int32, device=device)
        self.share = Share.whole(count)
        self._replay = Replay(self._modules(scenario), device)

    def _modules(self, scenario: Scenario) -> list[ModuleType]:
        """Those of the kernels that this scenario launches: to compile the others would take longer than these."""
        modules = [herding, neighbours, referee]
        if scenario.herd.mode in ("constant", "random"):
            modules.append(commanded)
        elif scenario.herd.mode == "march":
            modules.append(marching)
        if self.collie is not None:
            modules += [bicycle, drivers, person]
        return modules

    def step(
        self,
        frame: int,
        positions: wp.array[wp.vec3],
        velocities: wp.array[wp.vec3],
        desired_out: wp.array[wp.vec2],
        fallen: wp.array[wp.int32] | None = None,
        between: Callable[[], None] | None = None,
    ) -> None:
        """See and want in one frame, and take the collie to the next.

        The referee's counts are then those of this frame, the collie's pose is that of the next.

        Args:
            frame: Number of the frame, from 0.
            positions: World positions [m], shape [agents].
            velocities: World velocities [m/s], shape [agents].
            desired_out: Gets the desired velocities [m/s], shape [agents].
            fallen: 1 for those who have fallen, shape [agents]; None where nobody has.
            between: Called when everything is seen and nothing wanted yet: for a stopwatch.
        """
        down = self._nobody_fell if fallen is None else fallen
        self.set_frame(frame)
        arrays = (positions, velocities, down, desired_out)
        self._replay(arrays, partial(self.stages, *arrays), self.share.team, between)

    def enqueue(
        self,
        positions: wp.array[wp.vec3],
        velocities: wp.array[wp.vec3],
        fallen: wp.array[wp.int32],
        desired_out: wp.array[wp.vec2],
    ) -> None:
        """Launch what `step` replays, after `set_frame`, for a capture of one's own; arguments as there."""
        for stage in self.stages(positions, velocities, fallen, desired_out):
            for phase in stage:
                launch_all(phase)

    def stages(
        self,
        positions: wp.array[wp.vec3],
        velocities: wp.array[wp.vec3],
        fallen: wp.array[wp.int32],
        desired_out: wp.array[wp.vec2],
    ) -> tuple[list[Phase], list[Phase]]:
        """What a frame launches to see and to want, in slices for the threads of `share`; arguments as for `step`."""
        herd, share = self.herd, self.share
        mind, wanting = herd.want(self._frame, velocities, fallen, desired_out, share)
        begin, looking, end = self.referee.count(self._frame, herd.arrays.table, share)
        seeing = [*herd.look(positions, fallen, share), begin, side_by_side(herd.see(fallen, share), looking), end]
        deciding = [mind, wanting]
        if self.collie is not None:
            deciding.append([partial(self.collie.enqueue, self._frame, herd.arrays)])
        return seeing, deciding

    def look(self, frame: int, positions: wp.array[wp.vec3], fallen: wp.array[wp.int32] | None = None) -> None:
        """Let the referee count a frame after which there is no other; arguments as for `step`."""
        self.set_frame(frame)
        self.herd.enqueue_look(positions, self._nobody_fell if fallen is None else fallen)
        self.referee.enqueue(self._frame, self.herd.arrays.table)

    def load(self) -> None:
        """Load the kernels, compiling those that nobody has compiled before."""
        self._replay.load()

    def state(self) -> dict[str, np.ndarray]:
        """All that the next frame depends on besides its arguments, by names like "herd.goal"; copies."""
        return {
            f"{part}.{name}": array for part, owner in self._parts().items() for name, array in owner.state().items()
        }

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from what `state` gave, to the same bits."""
        for part, owner in self._parts().items():
            prefix = f"{part}."
            owner.load_state({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})

    def _parts(self) -> dict[str, Herd | Collie | Referee]:
        parts: dict[str, Herd | Collie | Referee] = {"herd": self.herd, "referee": self.referee}
        if self.collie is not None:
            parts["collie"] = self.collie
        return parts

    def set_frame(self, frame: int) -> None:
        """Say which frame `enqueue` is about."""
        if self._device.is_cpu:
            self._frame.numpy()[0] = frame
        else:
            self._frame.fill_(frame)
