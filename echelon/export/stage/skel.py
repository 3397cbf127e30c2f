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

from echelon.export.stage.agent_data import author_agent_data
from echelon.export.stage.characters import link_paths, skel_path
from echelon.export.stage.motion import CastMotion, local_transforms
from echelon.export.stage.time_samples import author, author_constant, author_op_order, author_translations, bends

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
    animations = crowd.nameChildren.get(ANIMATIONS) or Sdf.PrimSpec(crowd, ANIMATIONS, Sdf.SpecifierDef, "Scope")
    for agent, name in enumerate(motion.agent_names):
        animation = Sdf.PrimSpec(animations, name, Sdf.SpecifierDef, "SkelAnimation")
        _author_animation(animation, joints, translations[:, agent], rotations[:, agent])
        prim = Sdf.PrimSpec(crowd, name, Sdf.SpecifierDef, "SkelRoot")
        prim.kind = "component"
        prim.instanceable = True
        prim.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=["SkelBindingAPI"]))
        prim.referenceList.Prepend(asset)
        source = Sdf.RelationshipSpec(prim, "skel:animationSource", False)
        source.targetPathList.Prepend(animation.path.StripAllVariantSelections())
        author_agent_data(prim, motion, agent)
        author_translations(prim, motion.positions[:, agent, 0])
        author_op_order(prim, ["xformOp:translate"])
        advance()


def _author_animation(
    prim: Sdf.PrimSpec, joints: Vt.TokenArray, translations: np.ndarray, rotations: np.ndarray
) -> None:
    """Author joint translations [m] [frames, links, 3] and rotations [frames, links, 4]."""
    names = Sdf.ValueTypeNames
    author_constant(prim, "joints", names.TokenArray, joints, uniform=True)
    author_constant(prim, "scales", names.Half3Array, Vt.Vec3hArray(len(joints), Gf.Vec3h(1.0)))
    places = translations.astype(np.float32)
    frames = bends(places)
    author(prim, "translations", names.Float3Array, map(Vt.Vec3fArray.FromNumpy, places[frames]), frames)
    turns = rotations.astype(np.float32)
    frames = bends(turns)
    author(prim, "rotations", names.QuatfArray, map(Vt.QuatfArray.FromNumpy, turns[frames]), frames)
