"""Prims of a stage as the pictures see them: meshes in the frame of what carries them, colours, poses."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pxr import Usd, UsdGeom
from scipy.spatial.transform import Rotation

from echelon.export.drawn_parts import DrawnPart
from echelon.export.shapes import Mesh
from echelon.warp_kernels.model import Vec3


def beneath(prim: Usd.Prim) -> list[Usd.Prim]:
    """The prim and all below it, instanced ones included."""
    return list(Usd.PrimRange(prim, Usd.TraverseInstanceProxies()))


def meshes_beneath(prim: Usd.Prim) -> list[Usd.Prim]:
    return [below for below in beneath(prim) if below.IsA(UsdGeom.Mesh)]


def moving_ancestor(mesh: Usd.Prim) -> Usd.Prim:
    """The transform that carries a mesh: the nearest that is not part of a shared, and so motionless, asset."""
    prim = mesh.GetParent()
    while prim.IsInstanceProxy() or prim.IsInstance() or not prim.IsA(UsdGeom.Xform):
        prim = prim.GetParent()
    return prim


def drawn_part(prim: Usd.Prim, owner: Usd.Prim) -> DrawnPart:
    """A mesh prim in its owner's frame, with a colour where it has one of its own."""
    return DrawnPart(read_mesh(prim, owner)[0], own_color(prim))


def read_mesh(prim: Usd.Prim, owner: Usd.Prim) -> tuple[Mesh, np.ndarray]:
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


def selected(mesh: Mesh, wanted: np.ndarray, origin: np.ndarray) -> Mesh:
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


def own_color(prim: Usd.Prim) -> Vec3 | None:
    """Linear RGB that is authored on the prim itself."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor")
    if not primvar or not primvar.HasAuthoredValue():
        return None
    red, green, blue = primvar.Get()[0]
    return (float(red), float(green), float(blue))


def own_colors(prims: Sequence[Usd.Prim]) -> np.ndarray:
    """Linear RGB of each prim, grey where it has none, float32, shape [prims, 3]."""
    return np.array([own_color(prim) or (0.5, 0.5, 0.5) for prim in prims], dtype=np.float32)


def rigid_poses(matrices: np.ndarray) -> np.ndarray:
    """Poses [..., 7] of rigid transforms as USD has them, for row vectors, shape [..., 4, 4]."""
    flat = matrices.reshape(-1, 4, 4)
    turns = Rotation.from_matrix(flat[:, :3, :3].transpose(0, 2, 1)).as_quat()
    return np.concatenate([flat[:, 3, :3], turns], axis=1).reshape(*matrices.shape[:-2], 7)
