"""What every agent's prim says about it, over time: who it is, how fast, in which phase, whether it has fallen."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import numpy as np
from pxr import Gf, Sdf, Vt

from echelon.export.stage.motion import CastMotion
from echelon.export.stage.time_samples import author, author_constant, bends, changes


def author_agent_data(prim: Sdf.PrimSpec, motion: CastMotion, agent: int) -> None:
    """Author one agent's colour, number, velocity [m/s], controller phase and whether it has fallen, as primvars.

    All are ``constant`` and so reach the instanced geometry beneath. Numbers change only where they are sampled;
    ``primvars:phase`` counts in the crowd's ``phaseNames``.

    Args:
        prim: The agent's prim.
        motion: How its cast moved.
        agent: Its index in the cast.
    """
    names = Sdf.ValueTypeNames
    if not motion.timing.in_clip:
        _author_identity(prim, motion, agent)
    velocity = motion.velocities[:, agent]
    frames = bends(velocity)
    values = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(velocity[frames]))
    author(prim, "primvars:velocity", names.Vector3f, values, frames, interpolation="constant", timing=motion.timing)
    for name, column in (("primvars:phase", motion.phases), ("primvars:fallen", motion.fallen)):
        frames = changes(column[:, agent])
        author(
            prim,
            name,
            names.Int,
            column[frames, agent].tolist(),
            frames,
            interpolation="constant",
            timing=motion.timing,
        )


def author_visibility(prim: Sdf.PrimSpec, motion: CastMotion, agent: int) -> None:
    """Author that one agent is invisible while it has been taken away; nothing of one that never is."""
    gone = motion.removed[:, agent]
    if not gone.any():
        return
    frames = changes(gone)
    values = ["invisible" if now else "inherited" for now in gone[frames].tolist()]
    author(prim, "visibility", Sdf.ValueTypeNames.Token, values, frames, timing=motion.timing)


def _author_identity(prim: Sdf.PrimSpec, motion: CastMotion, agent: int) -> None:
    names = Sdf.ValueTypeNames
    color = Vt.Vec3fArray([Gf.Vec3f(*motion.colors[agent].tolist())])
    author_constant(prim, "primvars:displayColor", names.Color3fArray, color, interpolation="constant")
    author_constant(prim, "primvars:agentId", names.Int, int(motion.ids[agent]), interpolation="constant")
