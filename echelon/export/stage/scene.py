"""All of a stage but the crowd: its metadata, materials, the ground and its fences, actors, lights and cameras."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt

from echelon.export.actor_looks import actor_visuals
from echelon.export.road_scene import RoadScene
from echelon.export.shapes import columns_mesh, fence_mesh, ground_mesh, platform_mesh, rectangle_mesh
from echelon.export.stage.camera import APERTURE, CameraMove
from echelon.export.stage.meshes import define_mesh, mesh_names, surfaces_by_color, welded
from echelon.export.stage.motion import continuous, prim_name, prim_names
from echelon.export.stage.road import define_road
from echelon.export.stage.time_samples import author, author_op_order, author_orientations, author_translations, bends
from echelon.recording import Recording
from echelon.warp_kernels.model import Vec3

TURF: Vec3 = (0.10, 0.19, 0.05)  # linear RGB
MEADOW: Vec3 = (0.16, 0.20, 0.08)
WATER: Vec3 = (0.03, 0.20, 0.28)
MAT: Vec3 = (0.055, 0.16, 0.34)
TIMBER: Vec3 = (0.28, 0.17, 0.09)
STONE: Vec3 = (0.42, 0.40, 0.37)
PLATFORM = "Platform"  # name of the prim of one above water
MEADOW_DEPTH = 0.02  # [m] below the turf, so that the two never share a plane
MEADOW_REACH = 60.0  # [m] beyond the ground on every side


@dataclass(frozen=True)
class StagePaths:
    """Where things are on a stage."""

    root: Sdf.Path

    @property
    def looks(self) -> Sdf.Path:
        return self.root.AppendChild("Looks")

    @property
    def assets(self) -> Sdf.Path:
        return self.root.AppendChild("Assets")

    @property
    def world(self) -> Sdf.Path:
        return self.root.AppendChild("World")

    @property
    def crowd(self) -> Sdf.Path:
        return self.root.AppendChild("Crowd")

    @property
    def actors(self) -> Sdf.Path:
        return self.root.AppendChild("Actors")

    @property
    def lights(self) -> Sdf.Path:
        return self.root.AppendChild("Lights")

    @property
    def cameras(self) -> Sdf.Path:
        return self.root.AppendChild("Cameras")


def begin_stage(recording: Recording, layer: Sdf.Layer) -> tuple[Usd.Stage, StagePaths]:
    """Open a stage on an empty layer, with its metadata, its default prim and the scopes for materials and assets."""
    stage = Usd.Stage.Open(layer)
    name = str(recording.scenario.get("name", "")) or "stage"
    paths = StagePaths(Sdf.Path.absoluteRootPath.AppendChild(prim_name(name)))
    root = UsdGeom.Xform.Define(stage, paths.root)
    Usd.ModelAPI(root).SetKind(Kind.Tokens.assembly)
    stage.SetDefaultPrim(root.GetPrim())
    set_metrics(stage)
    stage.SetTimeCodesPerSecond(recording.frame_rate)
    stage.SetFramesPerSecond(recording.frame_rate)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(recording.frame_count - 1)
    layer.documentation = f"{name}, simulated by Echelon"
    layer.customLayerData = custom_layer_data(recording)
    UsdGeom.Scope.Define(stage, paths.looks)
    UsdGeom.Scope.Define(stage, paths.assets)
    return stage, paths


def set_metrics(stage: Usd.Stage) -> None:
    """z up, metres, kilograms."""
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetMetadata("kilogramsPerUnit", 1.0)


def custom_layer_data(recording: Recording) -> dict[str, Any]:
    """What a layer says about its origin; the scenario and the run's summary are JSON, so that nothing is lost."""
    return {
        "echelon": {
            "version": version("echelon"),
            "scenario": json.dumps(recording.scenario, sort_keys=True),
            "summary": json.dumps(recording.summary, sort_keys=True),
        }
    }


def define_group(stage: Usd.Stage, path: Sdf.Path, material: UsdShade.Material | None = None) -> UsdGeom.Xform:
    """Define a transform of kind group, with a material for all beneath it that has none of its own."""
    return _define_model(stage, path, Kind.Tokens.group, material)


# ---- materials ---------------------------------------------------------------------------------------------------
def define_material(stage: Usd.Stage, path: Sdf.Path, roughness: float) -> UsdShade.Material:
    """Define a preview surface that takes its colour from ``displayColor``, wherever that is inherited from."""
    material = UsdShade.Material.Define(stage, path)
    reader = UsdShade.Shader.Define(stage, path.AppendChild("displayColor"))
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    reader.CreateInput("fallback", Sdf.ValueTypeNames.Float3).Set(Gf.Vec3f(0.5))
    color = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    surface = UsdShade.Shader.Define(stage, path.AppendChild("surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(color)
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(roughness)
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    return material


# ---- what stands still -------------------------------------------------------------------------------------------
def define_world(
    stage: Usd.Stage,
    paths: StagePaths,
    world: dict[str, Any],
    road: RoadScene | None,
    painted: UsdShade.Material,
    earthy: UsdShade.Material,
) -> None:
    """Define the ground, what lies around it, every fence; or the road and what stands beside it."""
    define_group(stage, paths.world)
    if road is not None:
        define_road(stage, paths.world, paths.assets, road, painted, earthy)
        return
    ground = _define_component(stage, paths.world.AppendChild("Ground"), earthy)
    turf = ground_mesh(world["ground"])
    if "heading" in world:
        stage.GetPrimAtPath(paths.world).SetCustomDataByKey("heading", float(world["heading"]))
    name, color = {"mat": ("mat", MAT), "water": ("water", WATER)}.get(world["ground"].get("shape"), ("turf", TURF))
    if "platform" in world:
        platform = _define_component(stage, paths.world.AppendChild(PLATFORM), painted)
        define_mesh(
            stage, str(platform.GetPath().AppendChild("concrete")), welded([platform_mesh(world["platform"])]), STONE
        )
        platform.GetPrim().SetCustomDataByKey("platform", json.dumps(world["platform"]))
    define_mesh(stage, str(ground.GetPath().AppendChild(name)), welded([turf]), color)
    reach = turf.extent[1] + MEADOW_REACH
    meadow = define_mesh(
        stage,
        str(ground.GetPath().AppendChild("meadow")),
        welded([rectangle_mesh(float(reach[0]), float(reach[1]))]),
        MEADOW,
    )
    meadow.AddTranslateOp().Set(Gf.Vec3d(0.0, 0.0, -MEADOW_DEPTH))
    walls = world.get("walls", [])
    for name, wall in zip(prim_names([str(wall["name"]) for wall in walls]), walls, strict=True):
        fence = _define_component(stage, paths.world.AppendChild(name), painted)
        surface = welded([fence_mesh(wall["points"], wall["closed"], wall["height"])])
        define_mesh(stage, str(fence.GetPath().AppendChild("fence")), surface, TIMBER)
    if world.get("columns"):
        columns = _define_component(stage, paths.world.AppendChild("columns"), painted)
        surface = welded([columns_mesh(world["columns"])])
        define_mesh(stage, str(columns.GetPath().AppendChild("stone")), surface, STONE)


def define_lights(stage: Usd.Stage, paths: StagePaths) -> None:
    """Define an afternoon: a sun and the sky."""
    UsdGeom.Scope.Define(stage, paths.lights)
    sun = UsdLux.DistantLight.Define(stage, paths.lights.AppendChild("sun"))
    sun.CreateAngleAttr(0.53)
    sun.CreateIntensityAttr(3.0)
    sun.CreateColorAttr(Gf.Vec3f(1.0, 0.95, 0.86))
    sun.AddRotateXYZOp().Set(Gf.Vec3f(38.0, -22.0, 0.0))
    sky = UsdLux.DomeLight.Define(stage, paths.lights.AppendChild("sky"))
    sky.CreateIntensityAttr(0.6)
    sky.CreateColorAttr(Gf.Vec3f(0.62, 0.76, 1.0))


# ---- what moves --------------------------------------------------------------------------------------------------
def define_actors(stage: Usd.Stage, paths: StagePaths, recording: Recording, painted: UsdShade.Material) -> None:
    """Define the actors, such as the collie on its bicycle; `author_actors` moves them."""
    define_group(stage, paths.actors, painted)
    for name, entry in zip(actor_names(recording), recording.actors, strict=True):
        actor = _define_component(stage, paths.actors.AppendChild(name))
        geometry = UsdGeom.Scope.Define(stage, actor.GetPath().AppendChild("geometry"))
        groups = surfaces_by_color(actor_visuals(entry))
        for mesh_name, (color, meshes) in zip(mesh_names(list(groups)), groups.items(), strict=True):
            define_mesh(stage, str(geometry.GetPath().AppendChild(mesh_name)), welded(meshes), color)


def author_actors(layer: Sdf.Layer, paths: StagePaths, recording: Recording) -> None:
    """Author the actors' poses, frame by frame."""
    poses = np.asarray(recording.actor_poses[:], dtype=np.float64)
    for index, name in enumerate(actor_names(recording)):
        prim = layer.GetPrimAtPath(paths.actors.AppendChild(name))
        author_translations(prim, poses[:, index, :3])
        author_orientations(prim, continuous(poses[:, index, 3:]))
        author_op_order(prim, ["xformOp:translate", "xformOp:orient"])


def actor_names(recording: Recording) -> tuple[str, ...]:
    """Prim names of the actors."""
    return prim_names([actor.name for actor in recording.actors])


def define_cameras(stage: Usd.Stage, paths: StagePaths, moves: Mapping[str, CameraMove]) -> None:
    """Define cameras by name, which `author_cameras` moves; USD counts their lengths in tenths of a metre here."""
    UsdGeom.Scope.Define(stage, paths.cameras)
    for name, move in moves.items():
        camera = UsdGeom.Camera.Define(stage, paths.cameras.AppendChild(name))
        camera.CreateHorizontalApertureAttr(10.0 * APERTURE[0])
        camera.CreateVerticalApertureAttr(10.0 * APERTURE[1])
        camera.CreateClippingRangeAttr(Gf.Vec2f(0.1, 10_000.0))
        camera.CreateFocusDistanceAttr(float(move.focus_distances[0]))


def author_cameras(layer: Sdf.Layer, paths: StagePaths, moves: Mapping[str, CameraMove]) -> None:
    """Author the cameras' positions, directions and focal lengths, frame by frame where they change."""
    for name, move in moves.items():
        prim = layer.GetPrimAtPath(paths.cameras.AppendChild(name))
        author_translations(prim, move.positions)
        author_orientations(prim, move.orientations)
        author_op_order(prim, ["xformOp:translate", "xformOp:orient"])
        lengths = (10.0 * move.focal_lengths).astype(np.float32)
        frames = bends(lengths)
        author(prim, "focalLength", Sdf.ValueTypeNames.Float, lengths[frames].tolist(), frames)


def define_phase_names(stage: Usd.Stage, paths: StagePaths, recording: Recording) -> None:
    """Write down on the crowd what the numbers in ``primvars:phase`` mean."""
    crowd = stage.GetPrimAtPath(paths.crowd)
    names = crowd.CreateAttribute("phaseNames", Sdf.ValueTypeNames.TokenArray, True, Sdf.VariabilityUniform)
    names.Set(Vt.TokenArray(list(recording.phase_names)))


def _define_component(stage: Usd.Stage, path: Sdf.Path, material: UsdShade.Material | None = None) -> UsdGeom.Xform:
    return _define_model(stage, path, Kind.Tokens.component, material)


def _define_model(stage: Usd.Stage, path: Sdf.Path, kind: str, material: UsdShade.Material | None) -> UsdGeom.Xform:
    xform = UsdGeom.Xform.Define(stage, path)
    Usd.ModelAPI(xform).SetKind(kind)
    if material is not None:
        UsdShade.MaterialBindingAPI.Apply(xform.GetPrim()).Bind(material)
    return xform
