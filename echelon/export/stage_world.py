"""The world of a stage as the pictures see it: a field with its fences, or a road and what is around it."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import json

import numpy as np
from pxr import Usd, UsdGeom
from scipy.spatial.transform import Rotation

from echelon.export.drawn_road import DrawnRoad, DrawnThings
from echelon.export.picture_source import PEN_NAME, DrawnFence, DrawnPen, DrawnWorld, drawn_platform
from echelon.export.road_scene import GroundPart
from echelon.export.shapes import POST_HALF_WIDTH
from echelon.export.stage.scene import PLATFORM
from echelon.export.stage_prims import drawn_part, meshes_beneath, own_color, read_mesh

_RECTANGLE_POINTS = 5  # of the ground's mesh, its middle included; an oval has more
ROAD, ROADSIDE, OBSTACLES = "Road", "Roadside", "Obstacles"
_GRAY = (0.5, 0.5, 0.5)


def read_world(world: Usd.Prim) -> DrawnWorld:
    """Ground and fences, the corral being the square around the fence of that name; or a road."""
    if world.GetChild(ROAD):
        return DrawnWorld(None, (), None, _read_road(world))
    oval, fences, pen, mat = None, [], None, None
    heading = float(world.GetCustomDataByKey("heading") or 0.0)
    platform = None
    for prim in world.GetChildren():
        meshes = meshes_beneath(prim)
        if prim.GetName() == PLATFORM:
            platform = drawn_platform(json.loads(prim.GetCustomDataByKey("platform")))
            continue
        if prim.GetName() == "Ground":
            for turf in (mesh for mesh in meshes if mesh.GetName() == "turf"):
                points = drawn_part(turf, world).mesh.points
                if len(np.unique(points, axis=0)) > _RECTANGLE_POINTS:
                    oval = (float(np.abs(points[:, 0]).max()), float(np.abs(points[:, 1]).max()))
            for found in (mesh for mesh in meshes if mesh.GetName() == "mat"):
                points = drawn_part(found, world).mesh.points
                mat = (float(np.abs(points[:, 0]).max()), float(np.abs(points[:, 1]).max()))
            continue
        fences += [DrawnFence(prim.GetName(), drawn_part(mesh, world).mesh) for mesh in meshes]
        if prim.GetName() == PEN_NAME and meshes:
            low, high = fences[-1].mesh.extent[:, :2].astype(np.float64)
            middle = 0.5 * (low + high)
            pen = DrawnPen((float(middle[0]), float(middle[1])), float((high - low).max()) - 2.0 * POST_HALF_WIDTH)
    return DrawnWorld(oval, tuple(fences), pen, heading=heading, mat=mat, platform=platform)


# ---- a road --------------------------------------------------------------------------------------------------------
def _read_road(world: Usd.Prim) -> DrawnRoad:
    """Ground from every mesh that is neither beside the road nor an obstacle; things from instancers and obstacles."""
    ground: list[GroundPart] = []
    things: list[DrawnThings] = []
    for prim in world.GetChildren():
        if prim.GetName() == ROADSIDE:
            for below in prim.GetChildren():
                if below.IsA(UsdGeom.PointInstancer):
                    things += _read_instances(UsdGeom.PointInstancer(below))
        elif prim.GetName() == OBSTACLES:
            things += [_read_obstacle(below) for below in prim.GetChildren() if meshes_beneath(below)]
        else:
            ground += [_read_ground(mesh, world) for mesh in meshes_beneath(prim)]
    # Paint is above the rest and drawn as it is.
    ground.sort(key=lambda part: part.name == "paint")
    return DrawnRoad(tuple(ground), tuple(things))


def _read_ground(prim: Usd.Prim, world: Usd.Prim) -> GroundPart:
    mesh, source = read_mesh(prim, world)
    st = UsdGeom.PrimvarsAPI(prim).GetPrimvar("st")
    values = st.ComputeFlattened() if st and st.HasAuthoredValue() else None
    uv = None
    if values is not None and len(values) == len(UsdGeom.Mesh(prim).GetPointsAttr().Get()):
        uv = np.asarray(values, dtype=np.float32)[source]
    return GroundPart(prim.GetName(), mesh, own_color(prim) or _GRAY, uv)


def _read_instances(instancer: UsdGeom.PointInstancer) -> list[DrawnThings]:
    """Things of each prototype of an instancer."""
    stage = instancer.GetPrim().GetStage()
    which = np.asarray(instancer.GetProtoIndicesAttr().Get())
    to_world = np.asarray(UsdGeom.XformCache().GetLocalToWorldTransform(instancer.GetPrim()))
    positions = np.asarray(instancer.GetPositionsAttr().Get(), dtype=np.float64) @ to_world[:3, :3] + to_world[3, :3]
    turns = Rotation.from_quat(np.asarray(instancer.GetOrientationsfAttr().Get(), dtype=np.float64)).as_matrix()
    scales = np.asarray(instancer.GetScalesAttr().Get(), dtype=np.float64)
    frames = to_world[:3, :3].T @ (turns * scales[:, None, :])
    primvar = UsdGeom.PrimvarsAPI(instancer.GetPrim()).GetPrimvar("displayColor")
    values = primvar.ComputeFlattened() if primvar and primvar.HasAuthoredValue() else None
    colors = np.asarray(values, dtype=np.float64) if values is not None else np.empty((0, 3))
    if len(colors) != len(which):
        colors = np.tile(_GRAY, (len(which), 1))
    found = []
    for number, path in enumerate(instancer.GetPrototypesRel().GetTargets()):
        prototype = stage.GetPrimAtPath(path)
        chosen = which == number
        if chosen.any():
            parts = tuple(drawn_part(mesh, prototype) for mesh in meshes_beneath(prototype))
            found.append(DrawnThings(prototype.GetName(), parts, positions[chosen], frames[chosen], colors[chosen]))
    return found


def _read_obstacle(prim: Usd.Prim) -> DrawnThings:
    to_world = np.asarray(UsdGeom.XformCache().GetLocalToWorldTransform(prim))
    parts = tuple(drawn_part(mesh, prim) for mesh in meshes_beneath(prim))
    kind = prim.GetName().rpartition("_")[0]
    return DrawnThings(kind, parts, to_world[None, 3, :3], to_world[None, :3, :3].transpose(0, 2, 1), np.array([_GRAY]))
