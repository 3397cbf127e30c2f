"""A road on the stage: ground, paint, side streets, and hundreds of instanced things beside it.

::

    World
        Road        component: asphalt, verge, streets, paint; ``primvars:st`` is how far across and metres along
        Land        component
        Roadside    group: a point instancer for each kind, with its prototypes beneath it
        Obstacles   group: instances of cars and barriers

Geometry is authored once, in abstract prims under ``Assets``: ``roadside_<variant>`` and ``obstacle_<n>``.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdShade, Vt

from echelon.export.drawn_parts import DrawnPart
from echelon.export.road_scene import GroundPart, PlacedKind, PlacedObstacle, RoadScene
from echelon.export.scenery_assets import VARIANTS, asset
from echelon.export.shapes import Mesh
from echelon.export.stage.meshes import define_mesh, mesh_names, welded
from echelon.warp_kernels.model import Vec3

ROAD, LAND, ROADSIDE, OBSTACLES = "Road", "Land", "Roadside", "Obstacles"
GEOMETRY = "geometry"


def define_road(
    stage: Usd.Stage,
    world: Sdf.Path,
    assets: Sdf.Path,
    road: RoadScene,
    painted: UsdShade.Material,
    earthy: UsdShade.Material,
) -> None:
    """Define a road and what is around it.

    Args:
        stage: The stage; its world is there already.
        world: Where the world is.
        assets: Where assets are.
        road: What to define.
        painted, earthy: Materials of things and of ground.
    """
    for name in (LAND, ROAD):
        parts = [part for part in road.ground if (part.name == "land") == (name == LAND)]
        if parts:
            component = _define_model(stage, world.AppendChild(name), Kind.Tokens.component, earthy)
            for part in parts:
                _define_ground(stage, component.AppendChild(part.name), part)
    if road.placed:
        group = _define_model(stage, world.AppendChild(ROADSIDE), Kind.Tokens.group, painted)
        for placed in road.placed:
            for variant in VARIANTS[placed.kind]:
                _define_asset(stage, _roadside_path(assets, variant), asset(variant))
            _define_instancer(stage, group.AppendChild(f"{placed.kind}s"), assets, placed)
    if road.obstacles:
        group = _define_model(stage, world.AppendChild(OBSTACLES), Kind.Tokens.group, painted)
        for number, obstacle in enumerate(road.obstacles, start=1):
            path = assets.AppendChild(f"obstacle_{number}")
            _define_asset(stage, path, obstacle.parts)
            _define_obstacle(stage, group.AppendChild(obstacle.name), path, obstacle)


def _roadside_path(assets: Sdf.Path, variant: str) -> Sdf.Path:
    return assets.AppendChild(f"roadside_{variant}")


def _define_model(stage: Usd.Stage, path: Sdf.Path, kind: str, material: UsdShade.Material) -> Sdf.Path:
    xform = UsdGeom.Xform.Define(stage, path)
    Usd.ModelAPI(xform).SetKind(kind)
    UsdShade.MaterialBindingAPI.Apply(xform.GetPrim()).Bind(material)
    return path


def _define_ground(stage: Usd.Stage, path: Sdf.Path, part: GroundPart) -> None:
    """A triangle mesh with a normal a point and, where there are any, texture coordinates."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(part.mesh.points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(part.mesh.face_vertex_counts))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(part.mesh.face_vertex_indices))
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(part.mesh.extent))
    mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set(Vt.Vec3fArray([part.color]))
    primvars = UsdGeom.PrimvarsAPI(mesh)
    _set_indexed(
        primvars.CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, UsdGeom.Tokens.vertex),
        Vt.Vec3fArray,
        part.mesh.normals,
    )
    if part.uv is not None:
        _set_indexed(
            primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex),
            Vt.Vec2fArray,
            part.uv,
        )


def _set_indexed(primvar: UsdGeom.Primvar, array: type, rows: np.ndarray) -> None:
    """Set a primvar to rows of numbers, each different one once."""
    different, which = np.unique(rows.astype(np.float32), axis=0, return_inverse=True)
    primvar.Set(array.FromNumpy(np.ascontiguousarray(different)))
    primvar.SetIndices(Vt.IntArray.FromNumpy(which.reshape(-1).astype(np.int32)))


def _define_asset(stage: Usd.Stage, path: Sdf.Path, parts: Sequence[DrawnPart]) -> None:
    """Geometry to be referenced: a mesh for each colour."""
    stage.CreateClassPrim(path).SetTypeName("Xform")
    colors: dict[Vec3 | None, list[Mesh]] = {}
    for part in parts:
        colors.setdefault(part.color, []).append(part.mesh)
    for name, (color, meshes) in zip(mesh_names(list(colors)), colors.items(), strict=True):
        define_mesh(stage, str(path.AppendChild(name)), welded(meshes), color)


def _define_instancer(stage: Usd.Stage, path: Sdf.Path, assets: Sdf.Path, placed: PlacedKind) -> None:
    instancer = UsdGeom.PointInstancer.Define(stage, path)
    Usd.ModelAPI(instancer).SetKind(Kind.Tokens.component)
    scope = UsdGeom.Scope.Define(stage, path.AppendChild("prototypes")).GetPath()
    reach = np.zeros(len(placed.positions))
    for number, variant in enumerate(VARIANTS[placed.kind]):
        prototype = UsdGeom.Xform.Define(stage, scope.AppendChild(variant)).GetPrim()
        prototype.GetReferences().AddInternalReference(_roadside_path(assets, variant))
        instancer.CreatePrototypesRel().AddTarget(prototype.GetPath())
        size = max(float(np.linalg.norm(part.mesh.points, axis=1).max()) for part in asset(variant))
        reach[placed.variants == number] = size
    count = len(placed.positions)
    turns = np.zeros((count, 4))
    turns[:, 2], turns[:, 3] = np.sin(0.5 * placed.yaws), np.cos(0.5 * placed.yaws)
    positions = placed.positions.astype(np.float32)
    reach = (reach * placed.scales.max(axis=1)).astype(np.float32)[:, None]
    instancer.CreateProtoIndicesAttr(Vt.IntArray.FromNumpy(placed.variants))
    instancer.CreateIdsAttr(Vt.Int64Array.FromNumpy(np.arange(count)))
    instancer.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(positions))
    instancer.CreateOrientationsAttr(Vt.QuathArray.FromNumpy(turns.astype(np.float16)))
    instancer.CreateOrientationsfAttr(Vt.QuatfArray.FromNumpy(turns.astype(np.float32)))
    instancer.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(placed.scales.astype(np.float32)))
    extent = np.stack([(positions - reach).min(axis=0), (positions + reach).max(axis=0)])
    instancer.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(extent))
    primvars = UsdGeom.PrimvarsAPI(instancer)
    color = primvars.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.varying)
    _set_indexed(color, Vt.Vec3fArray, placed.colors)


def _define_obstacle(stage: Usd.Stage, path: Sdf.Path, asset_path: Sdf.Path, obstacle: PlacedObstacle) -> None:
    xform = UsdGeom.Xform.Define(stage, path)
    Usd.ModelAPI(xform).SetKind(Kind.Tokens.component)
    x, y, z, w = obstacle.pose[3:].tolist()
    xform.AddTranslateOp().Set(Gf.Vec3d(*obstacle.pose[:3].tolist()))
    xform.AddOrientOp().Set(Gf.Quatf(w, x, y, z))
    geometry = UsdGeom.Xform.Define(stage, path.AppendChild(GEOMETRY)).GetPrim()
    geometry.GetReferences().AddInternalReference(asset_path)
    geometry.SetInstanceable(True)
