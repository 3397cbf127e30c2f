"""Bicycles left to themselves: start some, let the engine roll them, and look at what they did.

    bicycle = Bicycle(benchmark_bicycle())
    q, u = bicycle.rolling(np.array([3.0, 5.0, 8.0]), lean_rate=0.1)
    coast = roll(bicycle, q, u, seconds=10.0)
    np.degrees(coast.lean[-1]), coast.fallen[-1]

They roll on flat, open ground, computed as in scenarios: float32 lanes, semi-implicit Euler.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from echelon.agents.riders.bicycle import STEER, STEER_SPEED, Bicycle
from echelon.scenario import WorldSettings
from echelon.terrain.flat import FlatTerrain
from echelon.warp_kernels.frame import ChunkArrays, Engine
from echelon.warp_kernels.start import start_warp


@dataclass(frozen=True)
class Coast:
    """What bicycles did, look by look; the first look is the start.

    Attributes:
        bicycle: All of them.
        times: Of the looks [s],                    shape [looks]
        q: Generalised positions in the world,      shape [looks, bicycles, q_count]
        u: Generalised speeds,                      shape [looks, bicycles, u_count]
        fallen: Whether they lie on the ground,     shape [looks, bicycles]
    """

    bicycle: Bicycle
    times: np.ndarray
    q: np.ndarray
    u: np.ndarray
    fallen: np.ndarray

    @property
    def lean(self) -> np.ndarray:
        """To the right [rad], shape [looks, bicycles]."""
        return self.bicycle.lean(self.q)

    @property
    def lean_rate(self) -> np.ndarray:
        """Turning of the frame about its own long axis, to the right [rad/s], shape [looks, bicycles]."""
        return self.u[..., 3]

    @property
    def steer(self) -> np.ndarray:
        """To the left [rad], shape [looks, bicycles]."""
        return self.q[..., STEER]

    @property
    def steer_rate(self) -> np.ndarray:
        """[rad/s], shape [looks, bicycles]."""
        return self.u[..., STEER_SPEED]

    @property
    def heading(self) -> np.ndarray:
        """From x towards y [rad], shape [looks, bicycles]."""
        return self.bicycle.heading(self.q)

    @property
    def speed(self) -> np.ndarray:
        """Of the rear contact along the ground [m/s], shape [looks, bicycles]."""
        return np.hypot(self.u[..., 0], self.u[..., 1])

    @property
    def energy(self) -> np.ndarray:
        """Kinetic and potential [J], without what the tyres hold; shape [looks, bicycles]."""
        return self.bicycle.body.energy(self.q, self.u).sum(axis=-1)


def roll(
    bicycle: Bicycle,
    q: np.ndarray,
    u: np.ndarray,
    seconds: float,
    *,
    steer_torque: float | np.ndarray = 0.0,
    looks_per_second: int = 60,
) -> Coast:
    """Let bicycles roll.

    Args:
        bicycle: What they are.
        q, u: From where, shapes [bicycles, q_count] and [bicycles, u_count]; see `Bicycle.rolling`, and
            `Coast.q[-1]`, `Coast.u[-1]` to go on after a push (tyres then take up their side forces anew).
        seconds: How long [s].
        steer_torque: That turns the fork to the left all the while, one number or one a bicycle [N m]; 0 is hands off.
        looks_per_second: How often to look; a substep is 1 / `Bicycle.steps_per_second` or a little less.
    """
    start_warp()
    substeps = -(-bicycle.steps_per_second // looks_per_second)
    looks, count = round(seconds * looks_per_second), len(q)
    open_ground = FlatTerrain.of(WorldSettings(ground="plane", corral=None))
    engine = Engine(
        bicycle, count, open_ground, frame_rate=looks_per_second, substeps=substeps, tick=substeps, threads=1
    )
    engine.bind(ChunkArrays.allocate(1, count, bicycle))
    engine.set_origins(q[:, :3])
    engine.set_q(np.concatenate([np.zeros((count, 3)), q[:, 3:]], axis=1))
    engine.set_u(u)
    engine.set_command("steer_torque", np.broadcast_to(steer_torque, count))
    seen = [(np.array(q, dtype=float), np.array(u, dtype=float), np.zeros(count, dtype=bool))]
    for _ in range(looks):
        engine.advance(0)
        place = engine.q.astype(float)
        place[:, :3] += engine.origins.numpy()[:count]
        seen.append((place, engine.u.astype(float), engine.memory("fallen") > 0.5))
    engine.close()
    q, u, fallen = (np.stack(values) for values in zip(*seen, strict=True))
    return Coast(bicycle, np.arange(looks + 1) / looks_per_second, q, u, fallen)
