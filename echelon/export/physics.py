"""The physics layer: a moment of a recording, ready for another engine to take over.

A file of its own, apart from the playback stage: rigid bodies with mass properties, joints with limits, an articulation
root an agent, colliders for what touches the ground and for the ground and fences themselves, and the poses and
velocities of all links at one frame. Joint coordinates and their rates are written as well, under the names that
NVIDIA's joint state schema gives them (``state:<freedom>:physics:position`` in degrees or metres), for engines that
count in them.

::

    /<scenario>
        Assets       articulations, one a cast, and the geometry of their links
        Looks        physics materials
        World        ground and fences, or a road and what stands on it, as colliders
        Crowd        an articulation an agent
        physicsScene
        groups       which colliders pass through one another

Velocities follow UsdPhysics: of a body's centre of mass, in the body's own axes, angles in degrees. The root's linear
velocity is the recorded one; its turning and the rates of the joints are central differences over the frames beside,
carried out along the tree so that links and joints agree.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

from echelon.errors import InputError
from echelon.export.road_scene import RoadScene, is_road, road_scene
from echelon.export.shapes import box_between, columns_mesh, ground_mesh, wall_mesh
from echelon.export.stage import scene
from echelon.export.stage.articulations import (
    JOINTS,
    articulation_path,
    define_articulation,
    joint_names,
    make_collider,
    physics_joints,
    quatf,
    site_paths,
)
from echelon.export.stage.characters import define_links, link_names
from echelon.export.stage.joints import PhysicsJoint
from echelon.export.stage.layer_files import checked_stage_path, save_layer
from echelon.export.stage.meshes import define_mesh, welded
from echelon.export.stage.motion import (
    CastMotion,
    angular_velocities,
    conjugate,
    local_transforms,
    present,
    prim_names,
    rates,
    read_motion,
    rotated,
)
from echelon.recording import Recording

SOLID_GROUND = ("asphalt", "verge", "land")
GROUND_FRICTION = 0.9  # of ground and fences; engines combine it with that of what touches them


@dataclass(frozen=True)
class Moment:
    """A cast at one frame.

    Attributes:
        positions: Origins of the link frames in the world [m], float64,         [agents, links, 3]
        orientations: Quaternions (x, y, z, w),                                  [agents, links, 4]
        velocities: Of the centres of mass, in the links' own axes [m/s],        [agents, links, 3]
        spins: Angular velocities in the links' own axes [rad/s],                [agents, links, 3]
        joint_states: For each link None or coordinates and their rates
            [rad or m, rad/s or m/s],                                            [agents, freedoms, 2]
    """

    positions: np.ndarray
    orientations: np.ndarray
    velocities: np.ndarray
    spins: np.ndarray
    joint_states: tuple[np.ndarray | None, ...]


def write_physics(recording: Recording, path: str | os.PathLike[str], frame: int = 0) -> Path:
    """Write the physics layer of one frame.

    Args:
        recording: What happened.
        path: Where to; .usd and .usdc are binary, .usda is text.
        frame: The frame that another engine is to go on from; negative ones count from the end.

    Returns:
        The path.

    Raises:
        InputError: The path cannot be written to, there is no such frame, a pose is not finite, or a joint cannot be
            written as UsdPhysics.
    """
    target = checked_stage_path(path)
    count = recording.frame_count
    if not -count <= frame < count:
        raise InputError(f"frame = {frame}: the recording has frames 0 to {count - 1}")
    frame %= count
    first = max(frame - 1, 0)
    read = read_motion(recording, slice(first, min(frame + 2, count)))
    motions = [m for m in (present(m, frame - first) for m in read) if m.agent_count]

    layer = Sdf.Layer.CreateAnonymous(".usda")
    stage, paths = scene.begin_stage(recording, layer)
    stage.SetStartTimeCode(frame)
    stage.SetEndTimeCode(frame)
    data = dict(layer.customLayerData)
    data["echelon"] = {**data["echelon"], "frame": frame}
    layer.customLayerData = data
    materials = _define_materials(stage, paths, motions)
    _define_scene(stage, paths, motions)
    ground, fences = _define_world(stage, paths, recording, materials[GROUND_FRICTION])
    scene.define_group(stage, paths.crowd)
    for motion in motions:
        define_links(stage, paths.assets, motion.name, motion.body)
        define_articulation(stage, paths.assets, motion.name, motion.body, materials)
    _define_groups(stage, paths, motions, ground, fences)
    moments = [moment(motion, frame - first, recording.frame_rate) for motion in motions]
    with Sdf.ChangeBlock():
        crowd = layer.GetPrimAtPath(paths.crowd)
        for motion, state in zip(motions, moments, strict=True):
            for agent in range(motion.agent_count):
                _author_agent(crowd, paths, motion, state, agent)
    return save_layer(layer, target)


def moment(motion: CastMotion, index: int, frame_rate: int) -> Moment:
    """The state of a cast at one frame of its motion, velocities from the frames beside it.

    Args:
        motion: A few frames of how the agents moved.
        index: Which of these frames.
        frame_rate: Frames a second.
    """
    body = motion.body
    translations, rotations = local_transforms(motion)
    local_rates = rates(translations, frame_rate)[index]
    local_spins = angular_velocities(rotations, frame_rate)[index]
    positions, orientations = motion.positions[index], motion.orientations[index]
    velocities, spins = np.zeros_like(positions), np.zeros_like(positions)
    states: list[np.ndarray | None] = []
    for link, (parent, joint) in enumerate(zip(body.parents, physics_joints(body), strict=True)):
        if joint is None:
            velocities[:, link] = motion.velocities[index] if link == 0 else local_rates[:, link]
            spins[:, link] = local_spins[:, link]
            states.append(None)
            continue
        state = _joint_state(joint, motion, link, translations, rotations, index, frame_rate)
        spin, slide = joint.rates(state[..., 0], state[..., 1])
        if joint.schema == "spherical":
            spin = local_spins[:, link]
        if parent >= 0:
            frame = orientations[:, parent]
            spins[:, link] = spins[:, parent] + rotated(frame, spin)
            velocities[:, link] = velocities[:, parent] + rotated(frame, slide)
            velocities[:, link] += np.cross(spins[:, parent], positions[:, link] - positions[:, parent])
        else:
            spins[:, link], velocities[:, link] = spin, slide
        states.append(state)
    coms = np.array([link.com for link in body.links])
    velocities += np.cross(spins, rotated(orientations, np.broadcast_to(coms, positions.shape)))
    inverse = conjugate(orientations)
    return Moment(positions, orientations, rotated(inverse, velocities), rotated(inverse, spins), tuple(states))


def _joint_state(
    joint: PhysicsJoint,
    motion: CastMotion,
    link: int,
    translations: np.ndarray,
    rotations: np.ndarray,
    index: int,
    frame_rate: int,
) -> np.ndarray:
    """A joint's coordinates and their rates [rad or m, rad/s or m/s], shape [agents, freedoms, 2]."""
    coordinates = np.stack(
        [
            joint.coordinates(translations[:, agent, link], rotations[:, agent, link], motion.body.links[link].joint)
            for agent in range(motion.agent_count)
        ],
        axis=1,
    )
    return np.stack([coordinates[index], rates(coordinates, frame_rate)[index]], axis=-1)


# ---- what stands still -------------------------------------------------------------------------------------------
def _define_materials(
    stage: Usd.Stage, paths: scene.StagePaths, motions: Sequence[CastMotion]
) -> dict[float, UsdShade.Material]:
    """A physics material for every coefficient of friction."""
    frictions = {GROUND_FRICTION} | {site.friction for motion in motions for site in motion.body.contacts}
    materials: dict[float, UsdShade.Material] = {}
    for number, friction in enumerate(sorted(frictions), start=1):
        material = UsdShade.Material.Define(stage, paths.looks.AppendChild(f"friction_{number}"))
        physics = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
        physics.CreateStaticFrictionAttr(friction)
        physics.CreateDynamicFrictionAttr(friction)
        physics.CreateRestitutionAttr(0.0)
        materials[friction] = material
    return materials


def _define_scene(stage: Usd.Stage, paths: scene.StagePaths, motions: Sequence[CastMotion]) -> None:
    physics = UsdPhysics.Scene.Define(stage, paths.root.AppendChild("physicsScene"))
    physics.CreateGravityDirectionAttr(Gf.Vec3f(0.0, 0.0, -1.0))
    physics.CreateGravityMagnitudeAttr(motions[0].body.gravity if motions else 9.80665)


def _define_world(
    stage: Usd.Stage, paths: scene.StagePaths, recording: Recording, material: UsdShade.Material
) -> tuple[list[Sdf.Path], list[Sdf.Path]]:
    """The ground as an endless plane and the fences as thin walls, or a road and what stands on it.

    Returns:
        Paths of the ground, and of fences or obstacles.
    """
    scene.define_group(stage, paths.world)
    if is_road(recording.world):
        return _define_road(stage, paths, road_scene(recording.world), material)
    ground = UsdGeom.Plane.Define(stage, paths.world.AppendChild("ground"))
    ground.CreateAxisAttr(UsdGeom.Tokens.z)
    low, high = ground_mesh(recording.world["ground"]).extent.tolist()
    ground.CreateLengthAttr(high[1] - low[1])
    ground.CreateWidthAttr(high[0] - low[0])
    ground.CreateExtentAttr([Gf.Vec3f(*low), Gf.Vec3f(*high)])
    make_collider(ground.GetPrim(), material)
    walls = recording.world.get("walls", [])
    fences: list[Sdf.Path] = []
    for name, wall in zip(prim_names([str(wall["name"]) for wall in walls]), walls, strict=True):
        path = paths.world.AppendChild(name)
        mesh = define_mesh(stage, str(path), welded([wall_mesh(wall["points"], wall["closed"], wall["height"])]))
        UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(UsdPhysics.Tokens.none)
        make_collider(mesh.GetPrim(), material)
        fences.append(path)
    if recording.world.get("columns"):
        path = paths.world.AppendChild("columns")
        mesh = define_mesh(stage, str(path), welded([columns_mesh(recording.world["columns"])]))
        UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(UsdPhysics.Tokens.none)
        make_collider(mesh.GetPrim(), material)
        fences.append(path)
    return [ground.GetPath()], fences


def _define_road(
    stage: Usd.Stage, paths: scene.StagePaths, road: RoadScene, material: UsdShade.Material
) -> tuple[list[Sdf.Path], list[Sdf.Path]]:
    """Asphalt, verge and land as they are drawn, and a box for everything that stands on the road."""
    ground: list[Sdf.Path] = []
    for part in road.ground:
        if part.name in SOLID_GROUND:
            path = paths.world.AppendChild(part.name)
            mesh = define_mesh(stage, str(path), welded([part.mesh]), part.color)
            UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(UsdPhysics.Tokens.none)
            make_collider(mesh.GetPrim(), material)
            ground.append(path)
    obstacles: list[Sdf.Path] = []
    for obstacle in road.obstacles:
        path = paths.world.AppendChild(obstacle.name)
        extents = np.array([part.mesh.extent for part in obstacle.parts])
        low, high = extents[:, 0].min(axis=0).tolist(), extents[:, 1].max(axis=0).tolist()
        mesh = define_mesh(stage, str(path), welded([box_between(low, high)]))
        mesh.AddTranslateOp().Set(Gf.Vec3d(*obstacle.pose[:3].tolist()))
        mesh.AddOrientOp().Set(quatf(obstacle.pose[3:]))
        UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
        make_collider(mesh.GetPrim(), material)
        obstacles.append(path)
    return ground, obstacles


def _define_groups(
    stage: Usd.Stage,
    paths: scene.StagePaths,
    motions: Sequence[CastMotion],
    ground: Sequence[Sdf.Path],
    fences: Sequence[Sdf.Path],
) -> None:
    """Sites made for the ground pass through fences, those made for walls through the ground, as in the simulation."""
    sites: dict[str, list[Sdf.Path]] = {"ground": [], "wall": []}
    for motion in motions:
        for site, path in zip(motion.body.contacts, site_paths(motion.body), strict=True):
            sites[site.surface] += [paths.crowd.AppendChild(name).AppendPath(path) for name in motion.agent_names]
    scope = UsdGeom.Scope.Define(stage, paths.root.AppendChild("groups")).GetPath()
    members = {
        "ground": list(ground),
        "fences": list(fences),
        "ground_sites": sites["ground"],
        "wall_sites": sites["wall"],
    }
    passing = {"ground_sites": "fences", "wall_sites": "ground"}
    for name, targets in members.items():
        group = UsdPhysics.CollisionGroup.Define(stage, scope.AppendChild(name))
        group.GetCollidersCollectionAPI().CreateIncludesRel().SetTargets(targets)
    for name, other in passing.items():
        group = UsdPhysics.CollisionGroup(stage.GetPrimAtPath(scope.AppendChild(name)))
        group.CreateFilteredGroupsRel().SetTargets([scope.AppendChild(other)])


# ---- agents ------------------------------------------------------------------------------------------------------
def _author_agent(crowd: Sdf.PrimSpec, paths: scene.StagePaths, motion: CastMotion, state: Moment, agent: int) -> None:
    """One agent: a reference to its articulation, and its state."""
    types = Sdf.ValueTypeNames
    prim = Sdf.PrimSpec(crowd, motion.agent_names[agent], Sdf.SpecifierDef, "Xform")
    prim.kind = "component"
    prim.referenceList.Prepend(Sdf.Reference("", articulation_path(paths.assets, motion.name)))
    for link, name in enumerate(link_names(motion.body)):
        body = Sdf.PrimSpec(prim, name, Sdf.SpecifierOver)
        place, turn = state.positions[agent, link], state.orientations[agent, link]
        speed, spin = state.velocities[agent, link], np.degrees(state.spins[agent, link])
        _set(body, "xformOp:translate", types.Double3, Gf.Vec3d(*place.tolist()))
        _set(body, "xformOp:orient", types.Quatf, quatf(turn))
        _set(body, "physics:velocity", types.Vector3f, Gf.Vec3f(*speed.tolist()))
        _set(body, "physics:angularVelocity", types.Vector3f, Gf.Vec3f(*spin.tolist()))
    joints = Sdf.PrimSpec(prim, JOINTS, Sdf.SpecifierOver)
    named = zip(joint_names(motion.body), physics_joints(motion.body), state.joint_states, strict=True)
    for name, joint, coordinates in named:
        if joint is None or coordinates is None or not joint.freedoms:
            continue
        spec = Sdf.PrimSpec(joints, name, Sdf.SpecifierOver)
        schemas = [f"PhysicsJointStateAPI:{freedom}" for freedom in joint.freedoms]
        spec.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=schemas))
        unit = 1.0 if joint.schema == "prismatic" else float(np.degrees(1.0))
        for freedom, (value, rate) in zip(joint.freedoms, (unit * coordinates[agent]).tolist(), strict=True):
            _set(spec, f"state:{freedom}:physics:position", types.Float, value)
            _set(spec, f"state:{freedom}:physics:velocity", types.Float, rate)


def _set(prim: Sdf.PrimSpec, name: str, type_name: Sdf.ValueTypeName, value: object) -> None:
    Sdf.AttributeSpec(prim, name, type_name).default = value
