"""The physics layer: masses, joints, poses and velocities as USD's own physics parser finds them."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdPhysics
from scipy.spatial.transform import Rotation

from echelon.errors import InputError
from echelon.export.physics import write_physics
from echelon.export.stage.articulations import LEAST_MASS
from echelon.export.stage.joints import physics_joint
from echelon.export.usd import write_stage
from echelon.recording import Recording
from echelon.warp_kernels.model import Joint, Model
from tests.export.stage_validation import nvidia_issues, usd_errors
from tests.export.synthetic import hopper_model, joints_model, on_disk, synthetic_recording

FRAME = 5
CROWD = "/border_collie/Crowd"


class Pose:
    """A place and an orientation; ``a * b`` is b as seen from the frame that a is seen from."""

    def __init__(self, place: Any, turn: Rotation) -> None:
        self.place = np.array(place, dtype=float)
        self.turn = turn

    @classmethod
    def read(cls, place: Any, quaternion: Any) -> Pose:
        return cls(place, Rotation.from_quat([*quaternion.GetImaginary(), quaternion.GetReal()]))

    def __mul__(self, other: Pose) -> Pose:
        return Pose(self.place + self.turn.apply(other.place), self.turn * other.turn)

    def inverse(self) -> Pose:
        return Pose(-self.turn.inv().apply(self.place), self.turn.inv())

    def distance(self, other: Pose) -> float:
        """The greater of metres and radians apart."""
        apart = np.linalg.norm(self.place - other.place)
        return max(float(apart), float((self.turn.inv() * other.turn).magnitude()))


@pytest.fixture(scope="module", params=["hopper", "every joint", "hung from the world"])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, Any, Path]:
    models = {
        "hopper": hopper_model(),
        "every joint": joints_model(),
        "hung from the world": joints_model(
            root=Joint("hook", "universal", (0.0, 0.0, 3.0), ((1.0, 0, 0), (0, 1.0, 0)))
        ),
    }
    recording = synthetic_recording(agent_count=2, frame_count=12, falls=(), model=models[request.param])
    path = write_physics(recording, tmp_path_factory.mktemp("physics") / "physics.usd", FRAME)
    return recording, Usd.Stage.Open(str(path)), path


def link_prim(stage: Any, agent: int, name: str) -> Any:
    return stage.GetPrimAtPath(f"{CROWD}/hopper_{agent:03d}/{name.replace(' ', '_')}")


def joint_prim(stage: Any, agent: int, name: str) -> Any:
    return stage.GetPrimAtPath(f"{CROWD}/hopper_{agent:03d}/joints/{name}")


def body_pose(prim: Any) -> Pose:
    ops = {op.GetOpName(): op.Get() for op in UsdGeom.Xformable(prim).GetOrderedXformOps()}
    return Pose.read(ops["xformOp:translate"], ops["xformOp:orient"])


def body_after(prim: Any, seconds: float) -> Pose:
    """Where a body is after a short time at the velocities that it has."""
    pose = body_pose(prim)
    com = np.array(prim.GetAttribute("physics:centerOfMass").Get())
    velocity = pose.turn.apply(np.array(prim.GetAttribute("physics:velocity").Get()))
    spin = pose.turn.apply(np.radians(np.array(prim.GetAttribute("physics:angularVelocity").Get())))
    turn = Rotation.from_rotvec(seconds * spin) * pose.turn
    return Pose(pose.place + pose.turn.apply(com) + seconds * velocity - turn.apply(com), turn)


def joint_frame(prim: Any, side: int) -> Pose:
    """A joint's frame in the body on one of its sides, 0 or 1, or in the world where there is none."""
    place = prim.GetAttribute(f"physics:localPos{side}").Get()
    return Pose.read(place, prim.GetAttribute(f"physics:localRot{side}").Get())


def joint_motion(prim: Any, seconds: float) -> Pose | None:
    """The transform between the two joint frames after a time, by the joint's state; None of a spherical joint."""
    states = {}
    for freedom in ("angular", "linear", "rotX", "rotY", "rotZ"):
        position = prim.GetAttribute(f"state:{freedom}:physics:position")
        if position:
            rate = prim.GetAttribute(f"state:{freedom}:physics:velocity").Get()
            states[freedom] = position.Get() + seconds * rate
    if prim.GetTypeName() == "PhysicsPrismaticJoint":
        return Pose([states["linear"], 0.0, 0.0], Rotation.identity())
    if prim.GetTypeName() == "PhysicsRevoluteJoint":
        return Pose(np.zeros(3), Rotation.from_rotvec([np.radians(states["angular"]), 0.0, 0.0]))
    if prim.GetTypeName() == "PhysicsJoint":
        angles = [states.get(name, 0.0) for name in ("rotX", "rotY", "rotZ")]
        return Pose(np.zeros(3), Rotation.from_euler("XYZ", angles, degrees=True))
    return None


def test_validators_find_nothing(case: tuple[Recording, Any, Path]) -> None:
    _, stage, path = case
    assert usd_errors(stage) == []
    assert nvidia_issues(path) == []


def test_poses_are_those_of_the_frame(case: tuple[Recording, Any, Path]) -> None:
    recording, stage, _ = case
    poses = np.asarray(recording.link_poses)[FRAME]
    cache = UsdGeom.XformCache()
    for agent in range(recording.agent_count):
        for index, link in enumerate(recording.casts[0].body.links):
            prim = link_prim(stage, agent, link.name)
            expected = Pose(poses[agent, index, :3], Rotation.from_quat(poses[agent, index, 3:]))
            assert body_pose(prim).distance(expected) < 1e-6
            world = np.array(cache.GetLocalToWorldTransform(prim))
            assert np.allclose(world[3, :3], expected.place, atol=1e-6)


def test_masses_are_the_models(case: tuple[Recording, Any, Path]) -> None:
    recording, stage, _ = case
    for link in recording.casts[0].body.links:
        mass = UsdPhysics.MassAPI(link_prim(stage, 1, link.name))
        assert np.isclose(mass.GetMassAttr().Get(), link.mass)
        assert np.allclose(mass.GetCenterOfMassAttr().Get(), link.com)
        axes = Pose.read(np.zeros(3), mass.GetPrincipalAxesAttr().Get()).turn.as_matrix()
        tensor = axes @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ axes.T
        assert np.allclose(tensor, link.inertia, atol=1e-6)


@pytest.mark.filterwarnings("ignore:LoadUsdPhysicsFromRange")  # its successor is not in older releases
def test_usd_parses_bodies_joints_and_articulations(case: tuple[Recording, Any, Path]) -> None:
    recording, stage, _ = case
    body = recording.casts[0].body
    found = UsdPhysics.LoadUsdPhysicsFromRange(stage, ["/border_collie"])
    kinds = UsdPhysics.ObjectType
    assert len(found[kinds.RigidBody][0]) == recording.agent_count * len(body.links)
    paths, articulations = found[kinds.Articulation]
    assert sorted(str(path) for path in paths) == [f"{CROWD}/hopper_{agent:03d}" for agent in range(2)]
    joined = sum(link.joint.kind != "free" for link in body.links)
    assert all(len(articulation.articulatedJoints) == joined for articulation in articulations)
    schemas = {
        "pin": kinds.RevoluteJoint,
        "slider": kinds.PrismaticJoint,
        "ball": kinds.SphericalJoint,
        "universal": kinds.D6Joint,
        "gimbal": kinds.D6Joint,
    }
    for index, link in enumerate(body.links):
        if link.joint.kind == "free":
            continue
        paths, joints = found[schemas[link.joint.kind]]
        joint = dict(zip(map(str, paths), joints, strict=True))[str(joint_prim(stage, 1, link.joint.name).GetPath())]
        assert joint.body1 == link_prim(stage, 1, link.name).GetPath()
        parent = body.parents[index]
        if parent >= 0:
            assert joint.body0 == link_prim(stage, 1, body.links[parent].name).GetPath()
        if link.joint.kind in ("universal", "gimbal"):
            dof = UsdPhysics.JointDOF
            locked = {limit.first for limit in joint.jointLimits if limit.second.lower > limit.second.upper}
            across = {dof.TransX, dof.TransY, dof.TransZ}
            assert locked == (across if link.joint.kind == "gimbal" else across | {dof.RotZ})


@pytest.mark.parametrize(("seconds", "tolerance"), [(0.0, 2e-6), (1e-3, 2e-4)])
def test_joints_hold_the_bodies_together(case: tuple[Recording, Any, Path], seconds: float, tolerance: float) -> None:
    """The joint frames on both sides differ by just what the joint's state says, now and a moment later."""
    recording, stage, _ = case
    body = recording.casts[0].body
    moving = 0
    for agent in range(recording.agent_count):
        for index, link in enumerate(body.links):
            if link.joint.kind == "free":
                continue
            prim = joint_prim(stage, agent, link.joint.name)
            parent = body.parents[index]
            inboard = body_after(link_prim(stage, agent, body.links[parent].name), seconds) if parent >= 0 else None
            outboard = body_after(link_prim(stage, agent, link.name), seconds)
            frames = [
                Pose.read(
                    prim.GetAttribute(f"physics:localPos{k}").Get(), prim.GetAttribute(f"physics:localRot{k}").Get()
                )
                for k in (0, 1)
            ]
            first = inboard * frames[0] if inboard is not None else frames[0]
            between = first.inverse() * (outboard * frames[1])
            expected = joint_motion(prim, seconds)
            if expected is None:
                assert np.linalg.norm(between.place) < tolerance
                continue
            assert between.distance(expected) < tolerance, link.joint.name
            before = joint_motion(prim, 0.0)
            assert before is not None
            moving += before.distance(expected) > 2.0 * tolerance
    assert moving > 0 or seconds == 0.0


def test_root_has_the_recorded_velocity(tmp_path: Path) -> None:
    recording = synthetic_recording(agent_count=3, frame_count=12, falls=())
    stage = Usd.Stage.Open(str(write_physics(recording, tmp_path / "physics.usd", FRAME)))
    for agent in range(3):
        prim = link_prim(stage, agent, "body")
        pose, com = body_pose(prim), np.array(prim.GetAttribute("physics:centerOfMass").Get())
        velocity = np.array(prim.GetAttribute("physics:velocity").Get())
        spin = np.radians(np.array(prim.GetAttribute("physics:angularVelocity").Get()))
        of_origin = pose.turn.apply(velocity - np.cross(spin, com))
        assert np.allclose(of_origin, np.asarray(recording.velocities)[FRAME, agent], atol=1e-5)


def test_limits_are_in_degrees_and_turn_with_the_axis() -> None:
    joints = {link.joint.name: link.joint for link in joints_model().links}
    right, left = (physics_joint(joints[name], "here") for name in ("right", "left"))
    assert right.limits == ((-0.4, 0.5), (-np.inf, np.inf), (-0.6, 0.7))
    assert left.limits == ((-0.4, 0.5), (-np.inf, np.inf), (-0.8, 0.6))


def test_axes_that_a_d6_joint_cannot_have() -> None:
    slant = (0.6, 0.0, 0.8)
    twisted = Joint("hip", "universal", axes=((1.0, 0.0, 0.0), slant))
    with pytest.raises(InputError, match="body 'b', joint 'hip': axes of a universal joint must be at right angles"):
        physics_joint(twisted, "body 'b', joint 'hip'")
    free = Joint("neck", "gimbal", axes=((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    assert physics_joint(free, "neck").schema == "spherical"
    limited = dataclasses.replace(free, limits=((-1.0, 1.0), None, None))
    with pytest.raises(InputError, match="axes of a gimbal joint"):
        physics_joint(limited, "neck")


def test_world_is_solid_and_sites_know_what_they_touch(tmp_path: Path) -> None:
    recording = synthetic_recording(agent_count=2, frame_count=3)
    stage = Usd.Stage.Open(str(write_physics(recording, tmp_path / "physics.usda")))
    for path in ("World/ground", "World/infield", "World/corral"):
        prim = stage.GetPrimAtPath(f"/border_collie/{path}")
        assert prim.HasAPI(UsdPhysics.CollisionAPI)
        assert not prim.HasAPI(UsdPhysics.RigidBodyAPI)
    members = {}
    for name in ("ground", "fences", "ground_sites", "wall_sites"):
        group = UsdPhysics.CollisionGroup(stage.GetPrimAtPath(f"/border_collie/groups/{name}"))
        members[name] = {str(path) for path in group.GetCollidersCollectionAPI().GetIncludesRel().GetTargets()}
        assert all(stage.GetPrimAtPath(path).HasAPI(UsdPhysics.CollisionAPI) for path in members[name])
    assert members["wall_sites"] == {f"{CROWD}/hopper_{agent:03d}/body/contact_flank" for agent in range(2)}
    assert len(members["ground_sites"]) == 6
    table = UsdPhysics.CollisionGroup.ComputeCollisionGroupTable(stage)
    group = "/border_collie/groups/{}".format
    assert not table.IsCollisionEnabled(group("ground_sites"), group("fences"))
    assert not table.IsCollisionEnabled(group("wall_sites"), group("ground"))
    assert table.IsCollisionEnabled(group("ground_sites"), group("ground"))
    assert table.IsCollisionEnabled(group("wall_sites"), group("fences"))


def test_gravity_and_frame_are_written_down(tmp_path: Path) -> None:
    recording = synthetic_recording(agent_count=2, frame_count=6)
    stage = Usd.Stage.Open(str(write_physics(recording, tmp_path / "physics.usd", -1)))
    physics = UsdPhysics.Scene(stage.GetPrimAtPath("/border_collie/physicsScene"))
    assert np.isclose(physics.GetGravityMagnitudeAttr().Get(), recording.casts[0].body.gravity)
    assert stage.GetRootLayer().customLayerData["echelon"]["frame"] == 5
    place = np.array(body_pose(link_prim(stage, 0, "body")).place)
    assert np.allclose(place, np.asarray(recording.link_poses)[-1, 0, 0, :3])


def test_playback_stage_knows_no_physics(tmp_path: Path) -> None:
    recording = synthetic_recording(agent_count=2, frame_count=3)
    stage = Usd.Stage.Open(str(write_stage(recording, tmp_path / "herd.usd")))
    assert not any(schema.startswith("Physics") for prim in stage.Traverse() for schema in prim.GetAppliedSchemas())


def test_massless_link_is_almost_massless(tmp_path: Path) -> None:
    hopper = hopper_model()
    light = dataclasses.replace(hopper.links[1], mass=0.0, inertia=((0.0,) * 3,) * 3)
    model = Model(name="hopper", links=(hopper.links[0], light, hopper.links[2]), contacts=hopper.contacts)
    recording = synthetic_recording(agent_count=1, frame_count=2, model=model, falls=())
    stage = Usd.Stage.Open(str(write_physics(recording, tmp_path / "physics.usd")))
    assert np.isclose(link_prim(stage, 0, "upper_leg").GetAttribute("physics:mass").Get(), LEAST_MASS)


def test_recording_from_disk(tmp_path: Path) -> None:
    recording = synthetic_recording(agent_count=2, frame_count=8, falls=())
    stored = on_disk(recording, tmp_path / "herd.recording")
    stage = Usd.Stage.Open(str(write_physics(stored, tmp_path / "physics.usd", 4)))
    poses = np.asarray(recording.link_poses)[4]
    for agent in range(2):
        for index, link in enumerate(recording.casts[0].body.links):
            expected = Pose(poses[agent, index, :3], Rotation.from_quat(poses[agent, index, 3:]))
            assert body_pose(link_prim(stage, agent, link.name)).distance(expected) < 1e-5


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    recording = synthetic_recording(agent_count=1, frame_count=3, falls=())
    for frame in (3, -4):
        with pytest.raises(InputError, match=f"frame = {frame}: the recording has frames 0 to 2"):
            write_physics(recording, tmp_path / "physics.usd", frame)
    with pytest.raises(InputError, match="there is no folder"):
        write_physics(recording, tmp_path / "nowhere" / "physics.usd")
    assert os.listdir(tmp_path) == []
