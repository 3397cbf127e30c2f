"""The crowd as rigs: a prim an agent, a transform a link, animated; what opens everywhere."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from collections.abc import Callable

from pxr import Sdf

from echelon.export.stage.agent_data import author_agent_data, author_visibility
from echelon.export.stage.characters import link_paths, rig_path
from echelon.export.stage.motion import CastMotion, local_transforms
from echelon.export.stage.time_samples import author_orientations, author_translations, bends, define


def author_rigs(crowd: Sdf.PrimSpec, assets: Sdf.Path, motion: CastMotion, advance: Callable[[], None]) -> None:
    """Author an animated rig for every agent of a cast.

    A transform that never leaves its place in the reference pose is left to the character asset. Where the run is
    written clip by clip, what the next one holds is not known: there the joints alone decide.

    Args:
        crowd: The crowd, or its variant, that gets the agents as children.
        assets: Where the character assets are.
        motion: How the agents moved.
        advance: Called after each agent.
    """
    translations, rotations = local_transforms(motion)
    paths = link_paths(motion.body)
    asset = Sdf.Reference("", rig_path(assets, motion.name))
    for agent, name in enumerate(motion.agent_names):
        prim = define(crowd, name, "Xform", motion.timing)
        if not motion.timing.in_clip:
            prim.kind = "component"
            prim.referenceList.Prepend(asset)
        author_agent_data(prim, motion, agent)
        author_visibility(prim, motion, agent)
        specs: list[Sdf.PrimSpec] = []
        for index, path in enumerate(paths):
            parent = motion.body.parents[index]
            spec = Sdf.PrimSpec(specs[parent] if parent >= 0 else prim, path.rpartition("/")[2], Sdf.SpecifierOver)
            specs.append(spec)
            place, turn = translations[:, agent, index], rotations[:, agent, index]
            joint = motion.body.links[index].joint
            slides, turns = joint.kind in ("free", "slider"), joint.kind != "slider"
            if not motion.clip_by_clip:
                slides = len(bends(place)) > 1 or tuple(place[0]) != joint.position
                turns = len(bends(turn)) > 1 or tuple(turn[0]) != (0.0, 0.0, 0.0, 1.0)
            if slides:
                author_translations(spec, place, motion.timing)
            if turns:
                author_orientations(spec, turn, motion.timing)
        advance()
