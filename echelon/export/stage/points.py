"""The crowd as points: a PointInstancer for each link of a cast, with an instance an agent. For thousands.

Orientations are authored in half *and* in single precision, because some readers know only the first. Velocities are
those of the link frames' origins and serve motion blur.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pxr import Gf, Sdf, Vt

from echelon.export.stage.characters import link_names, link_radius, links_path
from echelon.export.stage.motion import CastMotion, angular_velocities, rates, shown_frames
from echelon.export.stage.time_samples import author, author_constant, author_op_order, bends, changes, define


def author_points(
    crowd: Sdf.PrimSpec,
    assets: Sdf.Path,
    motion: CastMotion,
    origin: np.ndarray,
    frame_rate: int,
    advance: Callable[[], None],
) -> None:
    """Author a point instancer for every link of a cast.

    Args:
        crowd: The crowd, or its variant, that gets the instancers as children.
        assets: Where the character assets are.
        motion: How the agents moved.
        origin: See `points_origin`.
        frame_rate: Frames a second.
        advance: Called after each link.
    """
    for index, name in enumerate(link_names(motion.body)):
        prim = define(crowd, f"{motion.name}_{name}", "PointInstancer", motion.timing)
        if not motion.timing.in_clip:
            prim.kind = "component"
            _author_prototype(prim, name, links_path(assets, motion.name).AppendChild(name))
            author_constant(prim, "xformOp:translate", Sdf.ValueTypeNames.Double3, Gf.Vec3d(*origin.tolist()))
            author_op_order(prim, ["xformOp:translate"])
            ids = Vt.Int64Array.FromNumpy(motion.ids.astype(np.int64))
            author_constant(prim, "ids", Sdf.ValueTypeNames.Int64Array, ids)
            indices = Vt.IntArray(motion.agent_count, 0)
            author_constant(prim, "protoIndices", Sdf.ValueTypeNames.IntArray, indices)
            _author_colors(prim, motion.colors)
        _author_instances(prim, motion, index, origin, frame_rate)
        _author_invisible(prim, motion)
        advance()


def points_origin(positions: np.ndarray) -> np.ndarray:
    """What the positions of a cast's instances count from [m], as they are single precision: whence the cast came.

    Args:
        positions: Of its root links at the first frame [m], shape [agents, 3].
    """
    return np.round(positions.mean(axis=0))


def _author_prototype(prim: Sdf.PrimSpec, name: str, asset: Sdf.Path) -> None:
    """One prototype, beneath the instancer, where it is not drawn for itself."""
    scope = Sdf.PrimSpec(prim, "prototypes", Sdf.SpecifierDef, "Scope")
    prototype = Sdf.PrimSpec(scope, name, Sdf.SpecifierDef, "Xform")
    prototype.referenceList.Prepend(Sdf.Reference("", asset))
    targets = Sdf.RelationshipSpec(prim, "prototypes", False)
    targets.targetPathList.Prepend(prototype.path.StripAllVariantSelections())


def _author_instances(prim: Sdf.PrimSpec, motion: CastMotion, index: int, origin: np.ndarray, frame_rate: int) -> None:
    names = Sdf.ValueTypeNames
    world = motion.positions[:, :, index]
    positions = (world - origin).astype(np.float32)
    orientations = motion.orientations[:, :, index]
    velocities = motion.velocities if index == 0 else rates(world, frame_rate)
    spins = np.degrees(angular_velocities(orientations, frame_rate))
    reach = np.float32(link_radius(motion.body, index))
    arrays = {
        "positions": (names.Point3fArray, Vt.Vec3fArray, positions),
        "orientations": (names.QuathArray, Vt.QuathArray, orientations.astype(np.float16)),
        "orientationsf": (names.QuatfArray, Vt.QuatfArray, orientations.astype(np.float32)),
        "velocities": (names.Vector3fArray, Vt.Vec3fArray, velocities.astype(np.float32)),
        "angularVelocities": (names.Vector3fArray, Vt.Vec3fArray, spins.astype(np.float32)),
        "extent": (
            names.Float3Array,
            Vt.Vec3fArray,
            np.stack([positions.min(axis=1) - reach, positions.max(axis=1) + reach], axis=1),
        ),
    }
    kept, timing = shown_frames(motion), motion.timing
    # All are sampled at the same frames: velocities that are not sampled where positions are would be ignored.
    rows = [values[kept].reshape(kept.stop - kept.start, -1) for _, _, values in arrays.values()]
    frames = bends(np.concatenate(rows, axis=1))
    for name, (type_name, array, values) in arrays.items():
        author(prim, name, type_name, map(array.FromNumpy, values[kept][frames]), frames, timing=timing)
    for name, column in (("primvars:phase", motion.phases[kept]), ("primvars:fallen", motion.fallen[kept])):
        frames = changes(column)
        values = map(Vt.IntArray.FromNumpy, column[frames])
        author(prim, name, names.IntArray, values, frames, interpolation="varying", timing=timing)


def _author_invisible(prim: Sdf.PrimSpec, motion: CastMotion) -> None:
    """Author which instances are not shown: those who have been taken away."""
    gone = motion.removed[shown_frames(motion)]
    if not gone.any():
        return
    frames = changes(gone)
    ids = motion.ids.astype(np.int64)
    values = (Vt.Int64Array.FromNumpy(ids[gone[frame]]) for frame in frames)
    author(prim, "invisibleIds", Sdf.ValueTypeNames.Int64Array, values, frames, timing=motion.timing)


def _author_colors(prim: Sdf.PrimSpec, colors: np.ndarray) -> None:
    """Each individual's colour; individuals that look the same share an entry."""
    different, which = np.unique(colors, axis=0, return_inverse=True)
    values = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(different))
    names = Sdf.ValueTypeNames
    author_constant(prim, "primvars:displayColor", names.Color3fArray, values, interpolation="varying")
    author_constant(
        prim, "primvars:displayColor:indices", names.IntArray, Vt.IntArray.FromNumpy(which.reshape(-1).astype(np.int32))
    )
