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
from echelon.export.picture_source import PEN_NAME, DrawnCast, DrawnFence, DrawnPart, DrawnPen, DrawnWorld
from echelon.export.shapes import POST_HALF_WIDTH, Mesh
from echelon.warp_kernels.model import Vec3

_RECTANGLE_POINTS = 5  # of the ground's mesh, its middle included; an oval has more


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
        self.world = _read_world(world)
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
        return self.link_poses(first, last)[:, :, 0, :2]


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
        for mesh in _meshes(agents[0]):
            owner = _moving_ancestor(mesh)
            relative = str(owner.GetPath().MakeRelativePath(agents[0].GetPath()))
            found.setdefault(relative, []).append(_part(mesh, owner))
        self.links = tuple(tuple(parts) for parts in found.values())
        self.colors = _own_colors(agents)
        self._owners = [agent.GetPrimAtPath(name) for agent in agents for name in found]

    def poses(self, cache: UsdGeom.XformCache) -> np.ndarray:
        """Poses of links at the cache's time, shape [agents, links, 7]."""
        matrices = Vt.Matrix4dArray([cache.GetLocalToWorldTransform(owner) for owner in self._owners])
        return _poses(np.asarray(matrices)).reshape(len(self.colors), len(self.links), 7)


class _Skeletons:
    """Agents of one look with a skeleton each, geometry bound rigidly to its joints."""

    def __init__(self, agents: Sequence[Usd.Prim]) -> None:
        self._agents = agents
        skels = UsdSkel.Cache()
        self._queries = []
        for agent in agents:
            skels.Populate(UsdSkel.Root(agent), Usd.TraverseInstanceProxies())
            skeleton = next(prim for prim in _beneath(agent) if prim.IsA(UsdSkel.Skeleton))
            self._queries.append(skels.GetSkelQuery(UsdSkel.Skeleton(skeleton)))
        bind = np.asarray(self._queries[0].GetJointWorldBindTransforms())
        links: list[list[DrawnPart]] = [[] for _ in bind]
        for prim in _meshes(agents[0]):
            mesh, source = _read_mesh(prim, agents[0])
            joint_of = np.asarray(UsdSkel.BindingAPI(prim).GetJointIndicesPrimvar().Get())[source]
            for joint in np.unique(joint_of).tolist():
                # Bound in a pose in which all links are parallel to the world: only their origins differ.
                part = _selected(mesh, joint_of == joint, bind[joint, 3, :3])
                links[joint].append(DrawnPart(part, _own_color(prim)))
        self.links = tuple(tuple(parts) for parts in links)
        self.colors = _own_colors(agents)

    def poses(self, cache: UsdGeom.XformCache) -> np.ndarray:
        """Poses of links at the cache's time, shape [agents, links, 7]."""
        found = []
        for agent, query in zip(self._agents, self._queries, strict=True):
            joints = np.asarray(query.ComputeJointSkelTransforms(cache.GetTime()))
            found.append(joints @ np.asarray(cache.GetLocalToWorldTransform(agent)))
        return _poses(np.stack(found))


class _Points:
    """Agents of one look as instances of point instancers, one for each link."""

    def __init__(self, instancers: Sequence[Usd.Prim]) -> None:
        self._instancers = [UsdGeom.PointInstancer(prim) for prim in instancers]
        links = []
        for prim, instancer in zip(instancers, self._instancers, strict=True):
            prototype = prim.GetStage().GetPrimAtPath(instancer.GetPrototypesRel().GetTargets()[0])
            links.append(tuple(_part(mesh, prototype) for mesh in _meshes(prototype)))
        self.links = tuple(links)
        colors = UsdGeom.PrimvarsAPI(instancers[0]).GetPrimvar("displayColor").ComputeFlattened()
        self.colors = np.asarray(colors, dtype=np.float32)

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


def _troupes(crowd: Usd.Prim) -> list[_Rigs | _Skeletons | _Points]:
    """The crowd, in groups of agents that look alike, in the stage's order."""
    groups: dict[tuple[str, ...], list[Usd.Prim]] = {}
    for prim in crowd.GetChildren():
        if prim.IsA(UsdGeom.PointInstancer):
            ids = UsdGeom.PointInstancer(prim).GetIdsAttr().Get()
            key = ("points", *map(str, ids))
        elif prim.IsA(UsdSkel.Root) or prim.IsA(UsdGeom.Xform):
            below = [str(mesh.GetPath().MakeRelativePath(prim.GetPath())) for mesh in _meshes(prim)]
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


# ---- the world -----------------------------------------------------------------------------------------------------
def _read_world(world: Usd.Prim) -> DrawnWorld:
    """Ground and fences; the corral is the square around the fence of that name."""
    oval, fences, pen = None, [], None
    for prim in world.GetChildren():
        meshes = _meshes(prim)
        if prim.GetName() == "Ground":
            for turf in (mesh for mesh in meshes if mesh.GetName() == "turf"):
                points = _part(turf, world).mesh.points
                if len(points) > _RECTANGLE_POINTS:
                    oval = (float(np.abs(points[:, 0]).max()), float(np.abs(points[:, 1]).max()))
            continue
        fences += [DrawnFence(prim.GetName(), _part(mesh, world).mesh) for mesh in meshes]
        if prim.GetName() == PEN_NAME and meshes:
            low, high = fences[-1].mesh.extent[:, :2].astype(np.float64)
            middle = 0.5 * (low + high)
            pen = DrawnPen((float(middle[0]), float(middle[1])), float((high - low).max()) - 2.0 * POST_HALF_WIDTH)
    return DrawnWorld(oval, tuple(fences), pen)


# ---- prims ---------------------------------------------------------------------------------------------------------
def _beneath(prim: Usd.Prim) -> list[Usd.Prim]:
    """The prim and all below it, instanced ones included."""
    return list(Usd.PrimRange(prim, Usd.TraverseInstanceProxies()))


def _meshes(prim: Usd.Prim) -> list[Usd.Prim]:
    return [below for below in _beneath(prim) if below.IsA(UsdGeom.Mesh)]


def _moving_ancestor(mesh: Usd.Prim) -> Usd.Prim:
    """The transform that carries a mesh: the nearest that is not part of a shared, and so motionless, asset."""
    prim = mesh.GetParent()
    while prim.IsInstanceProxy() or prim.IsInstance() or not prim.IsA(UsdGeom.Xform):
        prim = prim.GetParent()
    return prim


def _part(prim: Usd.Prim, owner: Usd.Prim) -> DrawnPart:
    """A mesh prim in its owner's frame, with a colour where it has one of its own."""
    return DrawnPart(_read_mesh(prim, owner)[0], _own_color(prim))


def _read_mesh(prim: Usd.Prim, owner: Usd.Prim) -> tuple[Mesh, np.ndarray]:
    """A mesh prim in its owner's frame, and which of the prim's points each point of it is."""
    mesh = UsdGeom.Mesh(prim)
    points = np.asarray(mesh.GetPointsAttr().Get(), dtype=np.float64)
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get(), dtype=np.int32)
    corners = np.asarray(mesh.GetFaceVertexIndicesAttr().Get(), dtype=np.int32)
    normals, normal_of_corner = _normals(prim, points, counts, corners)
    # A point with several normals, at an edge, becomes several points.
    pairs, corner = np.unique(np.column_stack([corners, normal_of_corner]), axis=0, return_inverse=True)
    cache = UsdGeom.XformCache()
    to_owner = np.asarray(cache.GetLocalToWorldTransform(prim) * cache.GetLocalToWorldTransform(owner).GetInverse())
    placed = Mesh(
        points=(points[pairs[:, 0]] @ to_owner[:3, :3] + to_owner[3, :3]).astype(np.float32),
        normals=(normals[pairs[:, 1]] @ to_owner[:3, :3]).astype(np.float32),
        face_vertex_counts=counts,
        face_vertex_indices=corner.reshape(-1).astype(np.int32),
    )
    return placed, pairs[:, 0]


def _normals(
    prim: Usd.Prim, points: np.ndarray, counts: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normals of a mesh, shape [n, 3], and which one each corner has; those of the faces where none are authored."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    values = primvar.ComputeFlattened() if primvar and primvar.HasAuthoredValue() else None
    if values is not None and len(values) == len(corners):
        return np.asarray(values, dtype=np.float64), np.arange(len(corners))
    if values is not None and len(values) == len(points):
        return np.asarray(values, dtype=np.float64), corners
    first = np.cumsum(counts) - counts
    a, b, c = (points[corners[first + step]] for step in range(3))
    faces = np.cross(b - a, c - a)
    faces /= np.maximum(np.linalg.norm(faces, axis=1, keepdims=True), 1e-12)
    return faces, np.repeat(np.arange(len(counts)), counts)


def _selected(mesh: Mesh, wanted: np.ndarray, origin: np.ndarray) -> Mesh:
    """The faces of a mesh whose points are wanted, all of a face's or none, relative to an origin [m]."""
    face = np.repeat(np.arange(len(mesh.face_vertex_counts)), mesh.face_vertex_counts)
    kept = wanted[mesh.face_vertex_indices]
    number = np.cumsum(wanted) - 1
    return Mesh(
        points=(mesh.points[wanted] - origin).astype(np.float32),
        normals=mesh.normals[wanted],
        face_vertex_counts=mesh.face_vertex_counts[np.unique(face[kept])],
        face_vertex_indices=number[mesh.face_vertex_indices[kept]].astype(np.int32),
    )


def _own_color(prim: Usd.Prim) -> Vec3 | None:
    """Linear RGB that is authored on the prim itself."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor")
    if not primvar or not primvar.HasAuthoredValue():
        return None
    red, green, blue = primvar.Get()[0]
    return (float(red), float(green), float(blue))


def _own_colors(prims: Sequence[Usd.Prim]) -> np.ndarray:
    """Linear RGB of each prim, grey where it has none, float32, shape [prims, 3]."""
    return np.array([_own_color(prim) or (0.5, 0.5, 0.5) for prim in prims], dtype=np.float32)


def _poses(matrices: np.ndarray) -> np.ndarray:
    """Poses [..., 7] of rigid transforms as USD has them, for row vectors, shape [..., 4, 4]."""
    flat = matrices.reshape(-1, 4, 4)
    turns = Rotation.from_matrix(flat[:, :3, :3].transpose(0, 2, 1)).as_quat()
    return np.concatenate([flat[:, 3, :3], turns], axis=1).reshape(*matrices.shape[:-2], 7)
