"""Character assets: what the prims of a crowd reference, authored once.

They are abstract prims under ``Assets``, so nothing draws them where they stand:

* ``<cast>_links/<link>``: the geometry of each link in its own frame. Rigs and point instancers share it as instances.
* ``<cast>_rig``: a transform for each link, nested as the links hang, in the reference pose.
* ``<cast>_skel``: a skeleton with the links as joints and the geometry bound to it rigidly.

To dress a cast in other geometry, let ``<cast>_links`` reference an asset that has a prim for each link.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from echelon.export.shapes import Mesh
from echelon.export.stage.meshes import define_mesh, mesh_names, surfaces_by_color, welded
from echelon.export.stage.motion import prim_names
from echelon.warp_kernels.model import Model, Vec3

GEOMETRY = "geometry"  # name of the instanced geometry under a link of a rig
SKELETON = "skeleton"


def links_path(assets: Sdf.Path, cast: str) -> Sdf.Path:
    return assets.AppendChild(f"{cast}_links")


def rig_path(assets: Sdf.Path, cast: str) -> Sdf.Path:
    return assets.AppendChild(f"{cast}_rig")


def skel_path(assets: Sdf.Path, cast: str) -> Sdf.Path:
    return assets.AppendChild(f"{cast}_skel")


def link_names(body: Model) -> tuple[str, ...]:
    """Prim names of the links."""
    return prim_names(body.link_names)


def link_paths(body: Model) -> tuple[str, ...]:
    """Where each link stands in a rig, relative to it, such as ``body/upper_leg``; also its joint's token."""
    paths: list[str] = []
    for name, parent in zip(link_names(body), body.parents, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return tuple(paths)


def link_radius(body: Model, index: int) -> float:
    """Radius about a link's origin of the ball that holds all its geometry [m]."""
    meshes = [mesh for group in surfaces_by_color(body.links[index].visuals).values() for mesh in group]
    return max((float(np.linalg.norm(mesh.points, axis=1).max()) for mesh in meshes), default=0.0)


def reference_origins(body: Model) -> np.ndarray:
    """Origins of the link frames in the reference pose, where all are parallel [m], shape [links, 3]."""
    origins = np.zeros((len(body.links), 3))
    for index, (link, parent) in enumerate(zip(body.links, body.parents, strict=True)):
        origins[index] = np.asarray(link.joint.position) + (origins[parent] if parent >= 0 else 0.0)
    return origins


def define_links(stage: Usd.Stage, assets: Sdf.Path, cast: str, body: Model) -> None:
    """Define the geometry of every link, each in its own frame."""
    root = links_path(assets, cast)
    stage.CreateClassPrim(root).SetTypeName("Xform")
    for name, link in zip(link_names(body), body.links, strict=True):
        path = root.AppendChild(name)
        UsdGeom.Xform.Define(stage, path)
        groups = surfaces_by_color(link.visuals)
        for mesh_name, (color, meshes) in zip(mesh_names(list(groups)), groups.items(), strict=True):
            define_mesh(stage, str(path.AppendChild(mesh_name)), welded(meshes), color)


def define_rig(stage: Usd.Stage, assets: Sdf.Path, cast: str, body: Model) -> None:
    """Define nested link transforms in the reference pose, with the links' geometry instanced beneath them."""
    root = rig_path(assets, cast)
    stage.CreateClassPrim(root).SetTypeName("Xform")
    for name, path, link in zip(link_names(body), link_paths(body), body.links, strict=True):
        xform = UsdGeom.Xform.Define(stage, root.AppendPath(path))
        xform.AddTranslateOp().Set(Gf.Vec3d(*link.joint.position))
        xform.AddOrientOp().Set(Gf.Quatf(1.0))
        if link.visuals:
            geometry = UsdGeom.Xform.Define(stage, root.AppendPath(path).AppendChild(GEOMETRY)).GetPrim()
            geometry.GetReferences().AddInternalReference(links_path(assets, cast).AppendChild(name))
            geometry.SetInstanceable(True)


def define_skel(stage: Usd.Stage, assets: Sdf.Path, cast: str, body: Model) -> None:
    """Define a skeleton in the reference pose and the geometry of all links, rigidly bound to it."""
    path = skel_path(assets, cast)
    stage.CreateClassPrim(path).SetTypeName("SkelRoot")
    skeleton = UsdSkel.Skeleton.Define(stage, path.AppendChild(SKELETON))
    origins = reference_origins(body)
    skeleton.CreateJointsAttr(Vt.TokenArray(list(link_paths(body))))
    skeleton.CreateBindTransformsAttr(_translations(origins))
    skeleton.CreateRestTransformsAttr(_translations(np.array([link.joint.position for link in body.links])))
    groups: dict[Vec3 | None, list[tuple[int, Mesh]]] = {}
    for index, link in enumerate(body.links):
        for color, meshes in surfaces_by_color(link.visuals).items():
            groups.setdefault(color, []).extend((index, mesh) for mesh in meshes)
    for name, (color, parts) in zip(mesh_names(list(groups)), groups.items(), strict=True):
        moved = [_moved(mesh, origins[index]) for index, mesh in parts]
        surface = welded(moved)
        mesh = define_mesh(stage, str(path.AppendChild(name)), surface, color)
        owners = np.concatenate(
            [
                np.full(len(welded([part]).points), index, np.int32)
                for (index, _), part in zip(parts, moved, strict=True)
            ]
        )
        binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
        binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
        binding.CreateJointIndicesPrimvar(False, 1).Set(Vt.IntArray.FromNumpy(owners))
        binding.CreateJointWeightsPrimvar(False, 1).Set(Vt.FloatArray(len(owners), 1.0))


def _translations(origins: np.ndarray) -> Vt.Matrix4dArray:
    return Vt.Matrix4dArray([Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*origin)) for origin in origins.tolist()])


def _moved(mesh: Mesh, offset: np.ndarray) -> Mesh:
    return Mesh(
        points=(mesh.points + offset).astype(np.float32),
        normals=mesh.normals,
        face_vertex_counts=mesh.face_vertex_counts,
        face_vertex_indices=mesh.face_vertex_indices,
    )
