"""A stage that Echelon wrote, read back as the pictures see it: whatever representation its crowd has.

Geometry, colours and transforms come from the composed prims themselves, so a stage that was worked on in another
program (a fence moved, the characters dressed in other geometry) is drawn as it is now.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from pxr import Tf, Usd, UsdGeom, UsdSkel, Vt
from scipy.spatial.transform import Rotation

from echelon.errors import InputError
from echelon.export.drawn_parts import DrawnPart
from echelon.export.picture_source import DrawnCast
from echelon.export.removed import places_to_frame
from echelon.export.stage_prims import (
    beneath,
    drawn_part,
    meshes_beneath,
    moving_ancestor,
    own_color,
    own_colors,
    read_mesh,
    rigid_poses,
    selected,
)
from echelon.export.stage_world import read_world


class StageSource:
    """A stage as the pictures see it; see `PictureSource`."""

    def __init__(self, path: Path) -> None:
        """
        Args:
            path: Of a .usd, .usda or .usdc file.

        Raises:
            InputError: It cannot be opened, or Echelon did not write it.
        """
        self._stage = _open(path)
        root = self._stage.GetDefaultPrim()
        if not root or not all(root.GetChild(name) for name in ("World", "Crowd")):
            raise InputError(f"{path}: is not a stage that Echelon wrote: it has no World and Crowd in a default prim")
        world, crowd = root.GetChild("World"), root.GetChild("Crowd")
        self.frame_rate = round(self._stage.GetTimeCodesPerSecond())
        self._start = round(self._stage.GetStartTimeCode())
        self.frame_count = round(self._stage.GetEndTimeCode()) - self._start + 1
        self.world = read_world(world)
        self._troupes = _troupes(crowd)
        if not self._troupes or self.frame_count < 1:
            raise InputError(f"{path}: there is nothing to draw: nobody in {crowd.GetPath()}, or no frames")
        firsts = np.cumsum([0] + [len(troupe.colors) for troupe in self._troupes])
        self.casts = tuple(
            DrawnCast(int(first), troupe.links, troupe.colors)
            for first, troupe in zip(firsts, self._troupes, strict=False)
        )
        actors = root.GetChild("Actors")
        self._actors = [_Rigs([prim]) for prim in actors.GetChildren()] if actors else []
        self.actors = tuple(tuple(part for link in actor.links for part in link) for actor in self._actors)
        self._cache = UsdGeom.XformCache()

    def link_poses(self, first: int, last: int) -> np.ndarray:
        links = max(len(troupe.links) for troupe in self._troupes)
        poses = np.zeros((last - first, sum(len(troupe.colors) for troupe in self._troupes), links, 7))
        poses[..., 6] = 1.0
        for frame in range(first, last):
            self._cache.SetTime(self._start + frame)
            agent = 0
            for troupe in self._troupes:
                found = troupe.poses(self._cache)
                poses[frame - first, agent : agent + len(found), : found.shape[1]] = found
                agent += len(found)
        return poses

    def actor_poses(self, first: int, last: int) -> np.ndarray:
        poses = np.zeros((last - first, len(self._actors), 7))
        for frame in range(first, last):
            self._cache.SetTime(self._start + frame)
            for index, actor in enumerate(self._actors):
                poses[frame - first, index] = actor.poses(self._cache)[0, 0]
        return poses

    def body_places(self, first: int, last: int) -> np.ndarray:
        places = np.zeros((last - first, sum(len(troupe.colors) for troupe in self._troupes), 3))
        for frame in range(first, last):
            self._cache.SetTime(self._start + frame)
            agent = 0
            for troupe in self._troupes:
                found = troupe.places(self._cache)
                places[frame - first, agent : agent + len(found)] = found
                agent += len(found)
        return places_to_frame(places, self.removed(first, last))

    def removed(self, first: int, last: int) -> np.ndarray:
        found = np.zeros((last - first, sum(len(troupe.colors) for troupe in self._troupes)), bool)
        for frame in range(first, last):
            gone = [troupe.invisible(self._start + frame) for troupe in self._troupes]
            found[frame - first] = np.concatenate(gone)
        return found


def _open(path: Path) -> Usd.Stage:
    if not path.is_file():
        raise InputError(f"{path}: there is no such stage")
    try:
        return Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise InputError(f"{path}: cannot be opened as a stage: {reason}") from None


# ---- the crowd -----------------------------------------------------------------------------------------------------
class _Rigs:
    """Agents of one look with a transform a link, or one actor; agents need not have any of Echelon's link names."""

    def __init__(self, agents: Sequence[Usd.Prim]) -> None:
        found: dict[str, list[DrawnPart]] = {}
        for mesh in meshes_beneath(agents[0]):
            owner = moving_ancestor(mesh)
            relative = str(owner.GetPath().MakeRelativePath(agents[0].GetPath()))
            found.setdefault(relative, []).append(drawn_part(mesh, owner))
        self.links = tuple(tuple(parts) for parts in found.values())
        self.colors = own_colors(agents)
        self._agents = agents
        self._owners = [agent.GetPrimAtPath(name) for agent in agents for name in found]

    def places(self, cache: UsdGeom.XformCache) -> np.ndarray:
        """Where the first links are at the cache's time [m], shape [agents, 3]."""
        roots = [cache.GetLocalToWorldTransform(owner) for owner in self._owners[:: len(self.links)]]
        return np.asarray(Vt.Matrix4dArray(roots))[:, 3, :3]

    def poses(self, cache: UsdGeom.XformCache) -> np.ndarray:
        """Poses of links at the cache's time, shape [agents, links, 7]."""
        matrices = Vt.Matrix4dArray([cache.GetLocalToWorldTransform(owner) for owner in self._owners])
        return rigid_poses(np.asarray(matrices)).reshape(len(self.colors), len(self.links), 7)

    def invisible(self, time: float) -> np.ndarray:
        """Which agents are invisible at a time code, bool, shape [agents]."""
        return _invisible(self._agents, time)


class _Skeletons:
    """Agents of one look with a skeleton each, geometry bound rigidly to its joints."""

    def __init__(self, agents: Sequence[Usd.Prim]) -> None:
        self._agents = agents
        skels = UsdSkel.Cache()
        self._queries = []
        for agent in agents:
            skels.Populate(UsdSkel.Root(agent), Usd.TraverseInstanceProxies())
            skeleton = next(prim for prim in beneath(agent) if prim.IsA(UsdSkel.Skeleton))
            self._queries.append(skels.GetSkelQuery(UsdSkel.Skeleton(skeleton)))
        bind = np.asarray(self._queries[0].GetJointWorldBindTransforms())
        links: list[list[DrawnPart]] = [[] for _ in bind]
        for prim in meshes_beneath(agents[0]):
            mesh, source = read_mesh(prim, agents[0])
            joint_of = np.asarray(UsdSkel.BindingAPI(prim).GetJointIndicesPrimvar().Get())[source]
            for joint in np.unique(joint_of).tolist():
                # Bound in a pose in which all links are parallel to the world: only their origins differ.
                part = selected(mesh, joint_of == joint, bind[joint, 3, :3])
                links[joint].append(DrawnPart(part, own_color(prim)))
        self.links = tuple(tuple(parts) for parts in links)
        self.colors = own_colors(agents)

    def places(self, cache: UsdGeom.XformCache) -> np.ndarray:
        """Where the first links are at the cache's time [m], shape [agents, 3]."""
        return self.poses(cache)[:, 0, :3]

    def poses(self, cache: UsdGeom.XformCache) -> np.ndarray:
        """Poses of links at the cache's time, shape [agents, links, 7]."""
        found = []
        for agent, query in zip(self._agents, self._queries, strict=True):
            joints = np.asarray(query.ComputeJointSkelTransforms(cache.GetTime()))
            found.append(joints @ np.asarray(cache.GetLocalToWorldTransform(agent)))
        return rigid_poses(np.stack(found))

    def invisible(self, time: float) -> np.ndarray:
        """Which agents are invisible at a time code, bool, shape [agents]."""
        return _invisible(self._agents, time)


class _Points:
    """Agents of one look as instances of point instancers, one for each link."""

    def __init__(self, instancers: Sequence[Usd.Prim]) -> None:
        self._instancers = [UsdGeom.PointInstancer(prim) for prim in instancers]
        links = []
        for prim, instancer in zip(instancers, self._instancers, strict=True):
            prototype = prim.GetStage().GetPrimAtPath(instancer.GetPrototypesRel().GetTargets()[0])
            links.append(tuple(drawn_part(mesh, prototype) for mesh in meshes_beneath(prototype)))
        self.links = tuple(links)
        colors = UsdGeom.PrimvarsAPI(instancers[0]).GetPrimvar("displayColor").ComputeFlattened()
        self.colors = np.asarray(colors, dtype=np.float32)

    def places(self, cache: UsdGeom.XformCache) -> np.ndarray:
        """Where the first links are at the cache's time [m], shape [agents, 3]."""
        to_world = np.asarray(cache.GetLocalToWorldTransform(self._instancers[0].GetPrim()))
        positions = np.asarray(self._instancers[0].GetPositionsAttr().Get(cache.GetTime()), dtype=np.float64)
        return positions @ to_world[:3, :3] + to_world[3, :3]

    def poses(self, cache: UsdGeom.XformCache) -> np.ndarray:
        """Poses of links at the cache's time, shape [agents, links, 7]."""
        poses = np.zeros((len(self.colors), len(self.links), 7))
        for link, instancer in enumerate(self._instancers):
            to_world = np.asarray(cache.GetLocalToWorldTransform(instancer.GetPrim()))
            positions = np.asarray(instancer.GetPositionsAttr().Get(cache.GetTime()), dtype=np.float64)
            turns = np.asarray(instancer.GetOrientationsfAttr().Get(cache.GetTime()), dtype=np.float64)
            poses[:, link, :3] = positions @ to_world[:3, :3] + to_world[3, :3]
            poses[:, link, 3:] = (Rotation.from_matrix(to_world[:3, :3].T) * Rotation.from_quat(turns)).as_quat()
        return poses

    def invisible(self, time: float) -> np.ndarray:
        """Which agents are invisible at a time code, bool, shape [agents]."""
        hidden = self._instancers[0].GetInvisibleIdsAttr().Get(time)
        if not hidden:
            return np.zeros(len(self.colors), bool)
        return np.isin(np.asarray(self._instancers[0].GetIdsAttr().Get()), np.asarray(hidden))


def _invisible(agents: Sequence[Usd.Prim], time: float) -> np.ndarray:
    """Which prims are invisible at a time code, bool, shape [agents]."""
    hidden = [UsdGeom.Imageable(agent).ComputeVisibility(time) == UsdGeom.Tokens.invisible for agent in agents]
    return np.array(hidden)


def _troupes(crowd: Usd.Prim) -> list[_Rigs | _Skeletons | _Points]:
    """The crowd, in groups of agents that look alike, in the stage's order."""
    groups: dict[tuple[str, ...], list[Usd.Prim]] = {}
    for prim in crowd.GetChildren():
        if prim.IsA(UsdGeom.PointInstancer):
            ids = UsdGeom.PointInstancer(prim).GetIdsAttr().Get()
            key = ("points", *map(str, ids))
        elif prim.IsA(UsdSkel.Root) or prim.IsA(UsdGeom.Xform):
            below = [str(mesh.GetPath().MakeRelativePath(prim.GetPath())) for mesh in meshes_beneath(prim)]
            if not below:  # the animations of skeletons, or nothing to see
                continue
            key = ("skel" if prim.IsA(UsdSkel.Root) else "rig", prim.GetName().rpartition("_")[0], *below)
        else:
            continue
        groups.setdefault(key, []).append(prim)
    kinds: dict[str, Callable[[Sequence[Usd.Prim]], _Rigs | _Skeletons | _Points]] = {
        "points": _Points,
        "skel": _Skeletons,
        "rig": _Rigs,
    }
    return [kinds[key[0]](prims) for key, prims in groups.items()]
