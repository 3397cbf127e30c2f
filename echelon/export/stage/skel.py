"""The crowd as skeletons: one instanced character asset a cast, one SkelAnimation an agent.

The agent's prim carries the place of its root link in double precision; joints are relative to it, so that single
precision is enough for them however far the agent has gone. Extents of SkelRoots and Skeletons are left to USD, which
computes them from the animation.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pxr import Gf, Sdf, Vt

from echelon.export.stage.agent_data import author_agent_data, author_visibility
from echelon.export.stage.characters import link_paths, skel_path
from echelon.export.stage.motion import CastMotion, local_transforms
from echelon.export.stage.time_samples import (
    Timing,
    author,
    author_constant,
    author_op_order,
    author_translations,
    bends,
    define,
)

ANIMATIONS = "Animations"


def author_skels(crowd: Sdf.PrimSpec, assets: Sdf.Path, motion: CastMotion, advance: Callable[[], None]) -> None:
    """Author an instance of the skinned character and its animation for every agent of a cast.

    Args:
        crowd: The crowd, or its variant, that gets the agents as children.
        assets: Where the character assets are.
        motion: How the agents moved.
        advance: Called after each agent.
    """
    translations, rotations = local_transforms(motion)
    roots = [index for index, parent in enumerate(motion.body.parents) if parent < 0]
    translations[:, :, roots] -= motion.positions[:, :, :1]
    joints = Vt.TokenArray(list(link_paths(motion.body)))
    asset = Sdf.Reference("", skel_path(assets, motion.name))
    animations = crowd.nameChildren.get(ANIMATIONS) or define(crowd, ANIMATIONS, "Scope", motion.timing)
    for agent, name in enumerate(motion.agent_names):
        animation = define(animations, name, "SkelAnimation", motion.timing)
        prim = define(crowd, name, "SkelRoot", motion.timing)
        if not motion.timing.in_clip:
            author_constant(animation, "joints", Sdf.ValueTypeNames.TokenArray, joints, uniform=True)
            scales = Vt.Vec3hArray(len(joints), Gf.Vec3h(1.0))
            author_constant(animation, "scales", Sdf.ValueTypeNames.Half3Array, scales)
            prim.kind = "component"
            prim.instanceable = True
            prim.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=["SkelBindingAPI"]))
            prim.referenceList.Prepend(asset)
            source = Sdf.RelationshipSpec(prim, "skel:animationSource", False)
            source.targetPathList.Prepend(animation.path.StripAllVariantSelections())
            author_op_order(prim, ["xformOp:translate"])
        _author_animation(animation, translations[:, agent], rotations[:, agent], motion.timing)
        author_agent_data(prim, motion, agent)
        author_visibility(prim, motion, agent)
        author_translations(prim, motion.positions[:, agent, 0], motion.timing)
        advance()


def _author_animation(prim: Sdf.PrimSpec, translations: np.ndarray, rotations: np.ndarray, timing: Timing) -> None:
    """Author joint translations [m] [frames, links, 3] and rotations [frames, links, 4]."""
    names = Sdf.ValueTypeNames
    places = translations.astype(np.float32)
    frames = bends(places)
    values = map(Vt.Vec3fArray.FromNumpy, places[frames])
    author(prim, "translations", names.Float3Array, values, frames, timing=timing)
    turns = rotations.astype(np.float32)
    frames = bends(turns)
    author(prim, "rotations", names.QuatfArray, map(Vt.QuatfArray.FromNumpy, turns[frames]), frames, timing=timing)
