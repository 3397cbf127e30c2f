"""Meshes onto a stage: points shared where faces meet, sharp edges in the normals, one prim a colour."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from echelon.export.shapes import Mesh, joined, visual_mesh
from echelon.warp_kernels.model import Vec3, Visual


@dataclass(frozen=True)
class Surface:
    """A mesh whose points are shared and whose normals belong to corners: what a stage wants of a `shapes.Mesh`.

    Attributes:
        points: Vertices [m], float32, shape [n, 3].
        face_vertex_counts: Corners of each face, int32, shape [faces].
        face_vertex_indices: Vertices of the corners, int32, shape [corners].
        normals: Different unit normals, float32, shape [m, 3].
        normal_indices: Normals of the corners, int32, shape [corners].
    """

    points: np.ndarray
    face_vertex_counts: np.ndarray
    face_vertex_indices: np.ndarray
    normals: np.ndarray
    normal_indices: np.ndarray


def welded(meshes: Sequence[Mesh]) -> Surface:
    """One surface of several meshes; points are shared within each mesh, never between two."""
    whole = joined(meshes)
    owner = np.repeat(np.arange(len(meshes)), [len(mesh.points) for mesh in meshes])
    points, point_of = _different(np.column_stack([owner, whole.points]))
    normals, normal_of = _different(whole.normals)
    return Surface(
        points=np.ascontiguousarray(points[:, 1:], dtype=np.float32),
        face_vertex_counts=whole.face_vertex_counts,
        face_vertex_indices=point_of[whole.face_vertex_indices].astype(np.int32),
        normals=np.ascontiguousarray(normals, dtype=np.float32),
        normal_indices=normal_of[whole.face_vertex_indices].astype(np.int32),
    )


def surfaces_by_color(visuals: Sequence[Visual]) -> dict[Vec3 | None, list[Mesh]]:
    """Meshes of visuals in their link's frame, gathered by colour; None is the individual's own."""
    found: dict[Vec3 | None, list[Mesh]] = {}
    for visual in visuals:
        found.setdefault(visual.color, []).append(visual_mesh(visual))
    return found


def mesh_names(colors: Sequence[Vec3 | None]) -> list[str]:
    """Prim names for meshes of these colours: ``skin`` for the individual's own, ``trim_1`` and so on for others."""
    numbers = iter(range(1, len(colors) + 1))
    return ["skin" if color is None else f"trim_{next(numbers)}" for color in colors]


def define_mesh(stage: Usd.Stage, path: str, surface: Surface, color: Vec3 | None = None) -> UsdGeom.Mesh:
    """Define a polygon mesh with extent, normals and, if given, a colour of its own (linear RGB)."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(surface.points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(surface.face_vertex_counts))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(surface.face_vertex_indices))
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([surface.points.min(axis=0), surface.points.max(axis=0)])))
    primvars = UsdGeom.PrimvarsAPI(mesh)
    normals = primvars.CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, UsdGeom.Tokens.faceVarying)
    normals.Set(Vt.Vec3fArray.FromNumpy(surface.normals))
    normals.SetIndices(Vt.IntArray.FromNumpy(surface.normal_indices))
    if color is not None:
        mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set(Vt.Vec3fArray([color]))
    return mesh


def _different(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The different rows in order of their first appearance, and for each row which of them it is."""
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=int)
    rank[order] = np.arange(len(order))
    return rows[first[order]], rank[inverse.reshape(-1)]
