"""A recording becomes an OpenUSD stage.

::

    /<scenario>                assembly, the default prim; all else is beneath it
        Looks                  materials; colours come from displayColor
        Assets                 abstract character assets, see `characters`
        World                  ground and fences
        Actors                 the collie
        Crowd                  variant set "representation": rig, skel or points
        Lights, Cameras

A stage holds the representation that was asked for, selected in the variant set. To choose between several in one
stage, ask for more with ``also``: each costs the time and the room on disk that it would cost alone, which is why they
are not always there. Sample f is at time code f.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from pxr import Sdf

from echelon.errors import InputError
from echelon.export.stage import scene
from echelon.export.stage.camera import framed
from echelon.export.stage.characters import define_links, define_rig, define_skel
from echelon.export.stage.layer_files import checked_stage_path, save_layer
from echelon.export.stage.motion import CastMotion, read_motion
from echelon.export.stage.points import author_points
from echelon.export.stage.rig import author_rigs
from echelon.export.stage.skel import author_skels
from echelon.recording import Recording

Representation = Literal["rig", "skel", "points"]
Progress = Callable[[int, int], None]

VARIANT_SET = "representation"
RIG_AGENT_LIMIT = 150  # beyond which rigs make a stage that is slow to open


def suggested_representation(agent_count: int) -> Representation:
    """``rig`` for as many agents as tools open at ease, ``points`` for more."""
    return "rig" if agent_count <= RIG_AGENT_LIMIT else "points"


def write_stage(
    recording: Recording,
    path: str | os.PathLike[str],
    representation: Representation = "rig",
    progress: Progress | None = None,
    *,
    also: Sequence[Representation] = (),
) -> Path:
    """Write a recording as a stage.

    Args:
        recording: What happened.
        path: Where to; .usd and .usdc are binary, .usda is text.
        representation: Of the crowd: ``rig`` (a transform a link), ``skel`` (an instanced skeleton an agent) or
            ``points`` (a point instancer a link); the one that the stage shows.
        progress: Called with (done, total) as the work goes on.
        also: Further representations to choose from in the variant set.

    Returns:
        The path.

    Raises:
        InputError: The path cannot be written to, a representation is unknown, or a pose is not finite.
    """
    target = checked_stage_path(path)
    wanted = [name for name in get_args(Representation) if name == representation or name in also]
    for name in (representation, *also):
        if name not in wanted:
            raise InputError(f"representation {name!r} is not one of {', '.join(get_args(Representation))}")
    motions = [motion for motion in read_motion(recording) if motion.agent_count]
    steps = sum(len(m.body.links) if name == "points" else m.agent_count for m in motions for name in wanted)
    advance = _counter(progress, steps + 2)

    layer = Sdf.Layer.CreateAnonymous(".usda")
    paths = _define_static(recording, layer, motions, wanted)
    with Sdf.ChangeBlock():
        scene.author_actors(layer, paths, recording)
        crowd = layer.GetPrimAtPath(paths.crowd)
        for name in wanted:
            variant = _variant(crowd, name)
            for motion in motions:
                if name == "rig":
                    author_rigs(variant, paths.assets, motion, advance)
                elif name == "skel":
                    author_skels(variant, paths.assets, motion, advance)
                else:
                    author_points(variant, paths.assets, motion, recording.frame_rate, advance)
        crowd.variantSelections[VARIANT_SET] = representation
    advance()
    save_layer(layer, target)
    advance()
    return target


def _define_static(
    recording: Recording, layer: Sdf.Layer, motions: Sequence[CastMotion], wanted: Sequence[str]
) -> scene.StagePaths:
    """Everything but the crowd's variants."""
    stage, paths = scene.begin_stage(recording, layer)
    painted = scene.define_material(stage, paths.looks.AppendChild("painted"), roughness=0.45)
    earthy = scene.define_material(stage, paths.looks.AppendChild("earthy"), roughness=0.95)
    scene.define_world(stage, paths, recording.world, painted, earthy)
    scene.define_actors(stage, paths, recording, painted)
    scene.define_group(stage, paths.crowd, painted)
    scene.define_phase_names(stage, paths, recording)
    scene.define_lights(stage, paths)
    for motion in motions:
        if "rig" in wanted or "points" in wanted:
            define_links(stage, paths.assets, motion.name, motion.body)
        if "rig" in wanted:
            define_rig(stage, paths.assets, motion.name, motion.body)
        if "skel" in wanted:
            define_skel(stage, paths.assets, motion.name, motion.body)
    if motions:
        herd = np.concatenate([motion.positions[:, :, 0] for motion in motions], axis=1)
        others = np.asarray(recording.actor_poses[:], dtype=np.float64)[..., :3].reshape(len(herd), -1, 3)
        move = framed(herd, others, recording.frame_rate)
        scene.define_camera(stage, paths, move)
        with Sdf.ChangeBlock():
            scene.author_camera(layer, paths, move)
    return paths


def _variant(crowd: Sdf.PrimSpec, name: str) -> Sdf.PrimSpec:
    """A new variant of the crowd's representation; returns the prim inside it."""
    if VARIANT_SET not in crowd.variantSets:
        crowd.variantSetNameList.Prepend(VARIANT_SET)
        Sdf.VariantSetSpec(crowd, VARIANT_SET)
    return Sdf.VariantSpec(crowd.variantSets[VARIANT_SET], name).primSpec


def _counter(progress: Progress | None, total: int) -> Callable[[], None]:
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    return advance
