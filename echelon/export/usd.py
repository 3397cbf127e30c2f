"""A recording becomes an OpenUSD stage.

::

    /<scenario>                assembly, the default prim; all else is beneath it
        Looks                  materials; colours come from displayColor
        Assets                 abstract character assets, see `characters`
        World                  ground and fences, or a road and what is around it
        Actors                 the collie, the user, a jogger
        Crowd                  variant set "representation": rig, skel or points
        Lights, Cameras

A stage holds the representation that was asked for, selected in the variant set. To choose between several in one
stage, ask for more with ``also``: each costs the time and the room on disk that it would cost alone, which is why they
are not always there. Sample f is at time code f.

The crowd's motion in a long run, a race of half an hour say, is in value clips beside the stage, so that neither who
writes nor who reads it needs room for all of it at once; see `echelon.export.stage.clips`.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from pxr import Sdf, Usd

from echelon.errors import InputError
from echelon.export.removed import places_to_frame, removed_agents
from echelon.export.road_cameras import ROAD_CAMERAS, camera_ways
from echelon.export.road_scene import RoadScene, is_road, road_scene
from echelon.export.stage import scene
from echelon.export.stage.camera import APERTURE, CameraMove, framed, looking
from echelon.export.stage.characters import define_links, define_rig, define_skel
from echelon.export.stage.clips import (
    MANIFEST,
    SUFFIX,
    Stretch,
    add_to_manifest,
    author_clip_sets,
    check_clips_folder,
    clip_path,
    remove_clips,
    replacing_clips,
    stretches,
)
from echelon.export.stage.layer_files import checked_stage_path, save_layer
from echelon.export.stage.motion import CastMotion, read_motion, shown
from echelon.export.stage.points import author_points, points_origin
from echelon.export.stage.rig import author_rigs
from echelon.export.stage.skel import author_skels
from echelon.export.stage.time_samples import Timing
from echelon.recording import Recording

Representation = Literal["rig", "skel", "points"]
Progress = Callable[[int, int], None]

VARIANT_SET = "representation"
RIG_AGENT_LIMIT = 150  # beyond which rigs make a stage that is slow to open
LARGEST_FILE_TRANSFORMS = 3_000_000  # of links, over all frames, in one file; more are written clip by clip
FRAMES_AT_ONCE = 512  # read from the recording
CLIP_TRANSFORMS = 500_000  # of links, over the frames of a value clip


def suggested_representation(agent_count: int) -> Representation:
    """``rig`` for as many agents as tools open at ease, ``points`` for more."""
    return "rig" if agent_count <= RIG_AGENT_LIMIT else "points"


def suggested_clip_frames(recording: Recording) -> int:
    """How many frames of a run to write to each value clip; 0 for a run that is short enough for one file."""
    frame_transforms = sum(cast.agent_count * len(cast.body.links) for cast in recording.casts)
    if frame_transforms * recording.frame_count <= LARGEST_FILE_TRANSFORMS:
        return 0
    return max(CLIP_TRANSFORMS // frame_transforms, 2)


def write_stage(
    recording: Recording,
    path: str | os.PathLike[str],
    representation: Representation | Literal["auto"] = "auto",
    progress: Progress | None = None,
    *,
    also: Sequence[Representation] = (),
    clip_frames: int | None = None,
) -> Path:
    """Write a recording as a stage.

    Args:
        recording: What happened.
        path: Where to; .usd and .usdc are binary, .usda is text.
        representation: Of the crowd: ``rig`` (a transform a link), ``skel`` (an instanced skeleton an agent) or
            ``points`` (a point instancer a link); the one that the stage shows. ``auto`` takes what
            `suggested_representation` says.
        progress: Called with (done, total) as the work goes on.
        also: Further representations to choose from in the variant set.
        clip_frames: Frames in each value clip, in a folder beside the stage (see `echelon.export.stage.clips`); 0 for
            everything in one file, None for what `suggested_clip_frames` says.

    Returns:
        The path.

    Raises:
        InputError: The path cannot be written to, a representation is unknown, or a pose is not finite.
    """
    target = checked_stage_path(path)
    if representation == "auto":
        representation = suggested_representation(recording.agent_count)
    wanted = [name for name in get_args(Representation) if name == representation or name in also]
    for name in (representation, *also):
        if name not in wanted:
            allowed = ", ".join(("auto", *get_args(Representation)))
            raise InputError(f"representation {name!r} is not one of {allowed}")
    check_clips_folder(target)
    if clip_frames is None:
        clip_frames = suggested_clip_frames(recording)
    if clip_frames < 0:
        raise InputError(f"clip_frames = {clip_frames}: must be 0 or the number of frames in a value clip")
    clips = stretches(recording.frame_count, clip_frames) if clip_frames else ()
    if clips:
        # The stage itself shows the first frame, its velocities included.
        after = min(recording.frame_count - 1, 1)
        motions = _motions(recording, slice(0, 1 + after), beside=(0, after), clip_by_clip=True)
    else:
        motions = _motions(recording, slice(None))
    steps = sum(len(m.body.links) if name == "points" else m.agent_count for m in motions for name in wanted)
    advance = _counter(progress, steps * (len(clips) + 1) + 2)

    layer = Sdf.Layer.CreateAnonymous(".usda")
    paths = _define_static(recording, layer, motions, wanted)
    with Sdf.ChangeBlock():
        scene.author_actors(layer, paths, recording)
        crowd = layer.GetPrimAtPath(paths.crowd)
        for name in wanted:
            _author_crowd(_variant(crowd, name), paths.assets, motions, name, recording, advance)
        crowd.variantSelections[VARIANT_SET] = representation
    advance()
    if clips:
        stage = Usd.Stage.Open(layer)
        author_clip_sets(stage.GetPrimAtPath(paths.crowd), target, clips, wanted)
        _write_clips(recording, target, clips, wanted, advance)
    save_layer(layer, target)
    if not clips:
        remove_clips(target)
    advance()
    return target


def _write_clips(
    recording: Recording, target: Path, clips: Sequence[Stretch], wanted: Sequence[str], advance: Callable[[], None]
) -> None:
    manifest = Sdf.Layer.CreateAnonymous(".usda")
    with replacing_clips(target) as folder:
        for clip in clips:
            layer = Sdf.Layer.CreateAnonymous(SUFFIX)
            before, after = min(clip.first, 1), min(recording.frame_count - 1 - clip.last, 1)
            frames = slice(clip.first - before, clip.last + after + 1)
            timing = Timing(clip.first, in_clip=True)
            motions = _motions(recording, frames, timing=timing, beside=(before, after), clip_by_clip=True)
            with Sdf.ChangeBlock():
                for name in wanted:
                    crowd = Sdf.CreatePrimInLayer(layer, clip_path(name))
                    _author_crowd(crowd, crowd.path, motions, name, recording, advance)
            add_to_manifest(manifest, layer)
            save_layer(layer, folder / clip.file_name)
        save_layer(manifest, folder / MANIFEST)


def _motions(recording: Recording, frames: slice, **fields: Any) -> list[CastMotion]:
    """Motion of the casts that have agents, with some fields set."""
    return [replace(motion, **fields) for motion in read_motion(recording, frames) if motion.agent_count]


def _author_crowd(
    crowd: Sdf.PrimSpec,
    assets: Sdf.Path,
    motions: Sequence[CastMotion],
    name: str,
    recording: Recording,
    advance: Callable[[], None],
) -> None:
    """Author one representation of all casts beneath a prim."""
    for motion in motions:
        if name == "rig":
            author_rigs(crowd, assets, shown(motion), advance)
        elif name == "skel":
            author_skels(crowd, assets, shown(motion), advance)
        else:
            agents = slice(int(motion.ids[0]), int(motion.ids[-1]) + 1)
            origin = points_origin(np.asarray(recording.link_poses[0, agents, 0, :3], dtype=np.float64))
            author_points(crowd, assets, motion, origin, recording.frame_rate, advance)


def _define_static(
    recording: Recording, layer: Sdf.Layer, motions: Sequence[CastMotion], wanted: Sequence[str]
) -> scene.StagePaths:
    """Everything but the crowd's variants."""
    stage, paths = scene.begin_stage(recording, layer)
    painted = scene.define_material(stage, paths.looks.AppendChild("painted"), roughness=0.45)
    earthy = scene.define_material(stage, paths.looks.AppendChild("earthy"), roughness=0.95)
    road = road_scene(recording.world) if is_road(recording.world) else None
    scene.define_world(stage, paths, recording.world, road, painted, earthy)
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
        moves = _camera_moves(recording, road)
        scene.define_cameras(stage, paths, moves)
        with Sdf.ChangeBlock():
            scene.author_cameras(layer, paths, moves)
    return paths


def _camera_moves(recording: Recording, road: RoadScene | None) -> dict[str, CameraMove]:
    """Cameras by name."""
    # Bit by bit: what is read at once stays in memory until it has been put together.
    steps = range(0, recording.frame_count, FRAMES_AT_ONCE)
    parts = [slice(first, first + FRAMES_AT_ONCE) for first in steps]
    places = np.concatenate(
        [
            places_to_frame(
                np.array(recording.link_poses[part, :, 0, :3], dtype=np.float64), removed_agents(recording, part)
            )
            for part in parts
        ]
    )
    if road is None:
        others = np.asarray(recording.actor_poses[:], dtype=np.float64)[..., :3].reshape(len(places), -1, 3)
        return {"main": framed(places, others, recording.frame_rate)}
    blocked = np.concatenate([np.empty((0, 2)), *[placed.positions[:, :2] for placed in road.placed]])
    ways = camera_ways(ROAD_CAMERAS, places, recording.frame_rate, APERTURE[0] / APERTURE[1], blocked)
    return {name: looking(way) for name, way in ways.items()}


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
