"""Stages say what the recording says, in every representation, and both validators have nothing to say about them."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import dataclasses
import errno
import json
import os
import time
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel
from scipy.spatial.transform import Rotation

from echelon.errors import InputError
from echelon.export.usd import Representation, suggested_representation, write_stage
from echelon.recording import Recording
from tests.export.stage_validation import nvidia_issues, usd_errors
from tests.export.synthetic import on_disk, synthetic_recording

REPRESENTATIONS = get_args(Representation)
LINKS = ("body", "body/upper_leg", "body/upper_leg/lower_leg")
FRAMES = (0, 5, 11)

# Rules of the NVIDIA validator that are not meant for us, with the reason.
NOT_APPLICABLE = {"UsdAsciiPerformanceChecker": "a .usda was asked for, so text was wanted"}


@pytest.fixture(scope="module")
def recording() -> Recording:
    return synthetic_recording(agent_count=4, frame_count=12)


@pytest.fixture(scope="module")
def stages(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("stages")
    return {name: Usd.Stage.Open(str(write_stage(recording, folder / f"{name}.usd", name))) for name in REPRESENTATIONS}


def changed(recording: Recording, **values: Any) -> Recording:
    return cast("Recording", dataclasses.replace(cast("Any", recording), **values))


def pose_matrices(poses: np.ndarray) -> np.ndarray:
    """Poses [..., 7] as USD's row-vector matrices, shape [..., 4, 4]."""
    matrices = np.zeros((*poses.shape[:-1], 4, 4))
    turns = Rotation.from_quat(poses[..., 3:].reshape(-1, 4)).as_matrix().reshape(*poses.shape[:-1], 3, 3)
    matrices[..., :3, :3] = np.swapaxes(turns, -1, -2)
    matrices[..., 3, :3] = poses[..., :3]
    matrices[..., 3, 3] = 1.0
    return matrices


def expected(recording: Recording, frame: int) -> np.ndarray:
    """World matrices of all links at a frame, shape [agents, links, 4, 4]."""
    return pose_matrices(np.asarray(recording.link_poses[frame]))


def rig_matrices(stage: Any, recording: Recording, code: Any) -> np.ndarray:
    cache = UsdGeom.XformCache(code)
    return np.array(
        [
            [cache.GetLocalToWorldTransform(stage.GetPrimAtPath(f"/border_collie/Crowd/hopper_{agent:03d}/{link}"))]
            for agent in range(recording.agent_count)
            for link in LINKS
        ]
    ).reshape(recording.agent_count, len(LINKS), 4, 4)


def skel_matrices(stage: Any, recording: Recording, code: Any) -> np.ndarray:
    found = []
    xforms = UsdGeom.XformCache(code)
    for agent in range(recording.agent_count):
        root = UsdSkel.Root(stage.GetPrimAtPath(f"/border_collie/Crowd/hopper_{agent:03d}"))
        cache = UsdSkel.Cache()
        assert cache.Populate(root, Usd.TraverseInstanceProxies())
        skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath(root.GetPath().AppendChild("skeleton")))
        query = cache.GetSkelQuery(skeleton)
        world = np.array(xforms.GetLocalToWorldTransform(skeleton.GetPrim()))
        found.append([np.array(joint) @ world for joint in query.ComputeJointSkelTransforms(code)])
        assert list(query.GetJointOrder()) == list(LINKS)
    return np.array(found)


def points_matrices(stage: Any, recording: Recording, code: Any) -> np.ndarray:
    found = []
    for link in LINKS:
        path = f"/border_collie/Crowd/hopper_{link.rpartition('/')[2]}"
        instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath(path))
        world = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(instancer.GetPrim()))
        found.append([np.array(m) @ world for m in instancer.ComputeInstanceTransformsAtTime(code, code)])
    return np.swapaxes(np.array(found), 0, 1)


MATRICES = {"rig": rig_matrices, "skel": skel_matrices, "points": points_matrices}


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_every_link_is_where_it_was(stages: dict[str, Any], recording: Recording, representation: str) -> None:
    for frame in FRAMES:
        found = MATRICES[representation](stages[representation], recording, Usd.TimeCode(frame))
        assert np.abs(found - expected(recording, frame)).max() < 2e-6
    default = MATRICES[representation](stages[representation], recording, Usd.TimeCode.Default())
    assert np.abs(default - expected(recording, 0)).max() < 2e-6


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_recording_from_disk_gives_the_same(recording: Recording, tmp_path: Path, representation: Any) -> None:
    stored = on_disk(recording, tmp_path / "herd.recording")
    stage = Usd.Stage.Open(str(write_stage(stored, tmp_path / "herd.usd", representation)))
    found = MATRICES[representation](stage, recording, Usd.TimeCode(7))
    assert np.abs(found - expected(recording, 7)).max() < 1e-5
    assert json.loads(stage.GetRootLayer().customLayerData["echelon"]["scenario"]) == recording.scenario


@pytest.mark.parametrize("suffix", [".usd", ".usda"])
@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_validators_find_nothing(recording: Recording, tmp_path: Path, representation: Any, suffix: str) -> None:
    path = write_stage(recording, tmp_path / f"herd{suffix}", representation)
    assert usd_errors(Usd.Stage.Open(str(path))) == []
    assert nvidia_issues(path, NOT_APPLICABLE if suffix == ".usda" else {}) == []


def test_validators_find_nothing_with_all_variants(recording: Recording, tmp_path: Path) -> None:
    path = write_stage(recording, tmp_path / "herd.usd", "skel", also=("rig", "points"))
    stage = Usd.Stage.Open(str(path))
    variants = stage.GetPrimAtPath("/border_collie/Crowd").GetVariantSets().GetVariantSet("representation")
    assert sorted(variants.GetVariantNames()) == ["points", "rig", "skel"]
    assert variants.GetVariantSelection() == "skel"
    assert nvidia_issues(path) == []
    for name in REPRESENTATIONS:
        variants.SetVariantSelection(name)
        found = MATRICES[name](stage, recording, Usd.TimeCode(5))
        assert np.abs(found - expected(recording, 5)).max() < 2e-6
        assert usd_errors(stage) == []


def test_metadata(stages: dict[str, Any], recording: Recording) -> None:
    for name, stage in stages.items():
        assert stage.GetDefaultPrim().GetPath() == "/border_collie"
        assert [prim.GetName() for prim in stage.GetPseudoRoot().GetChildren()] == ["border_collie"]
        assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
        assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
        assert stage.GetMetadata("kilogramsPerUnit") == 1.0
        assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == recording.frame_rate
        assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0.0, recording.frame_count - 1.0)
        data = stage.GetRootLayer().customLayerData["echelon"]
        assert json.loads(data["scenario"]) == recording.scenario
        assert json.loads(data["summary"]) == recording.summary
        crowd = stage.GetPrimAtPath("/border_collie/Crowd")
        assert crowd.GetVariantSets().GetVariantSelection("representation") == name
        assert list(crowd.GetAttribute("phaseNames").Get()) == list(recording.phase_names)


def test_kinds_and_materials(stages: dict[str, Any]) -> None:
    for stage in stages.values():
        kinds = {prim.GetName(): Usd.ModelAPI(prim).GetKind() for prim in stage.Traverse() if prim.GetKind()}
        assert kinds["border_collie"] == "assembly"
        assert {kinds[name] for name in ("World", "Crowd", "Actors")} == {"group"}
        assert {kinds[name] for name in ("Ground", "infield", "corral", "collie")} == {"component"}
        everything = Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())
        meshes = [prim for prim in everything if prim.GetTypeName() == "Mesh"]
        assert len(meshes) > 5
        for mesh in meshes:
            material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
            assert material, mesh.GetPath()
            assert UsdGeom.Mesh(mesh).GetExtentAttr().HasAuthoredValue()
            assert UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals").HasAuthoredValue()


def test_geometry_is_shared_and_individuals_keep_their_colour(stages: dict[str, Any], recording: Recording) -> None:
    assert len(stages["rig"].GetPrototypes()) == 3
    assert len(stages["skel"].GetPrototypes()) == 1
    colors = recording.casts[0].colors
    for name, mesh in (("rig", "body/geometry/skin"), ("skel", "skin")):
        for agent in range(recording.agent_count):
            prim = stages[name].GetPrimAtPath(f"/border_collie/Crowd/hopper_{agent:03d}/{mesh}")
            assert prim.IsInstanceProxy()
            primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
            assert np.allclose(primvar.Get()[0], colors[agent], atol=1e-6)
    instancer = stages["points"].GetPrimAtPath("/border_collie/Crowd/hopper_body")
    flattened = UsdGeom.PrimvarsAPI(instancer).GetPrimvar("displayColor").ComputeFlattened()
    assert np.allclose(np.array(flattened), colors, atol=1e-6)


def test_agents_tell_their_state_where_it_changes(stages: dict[str, Any], recording: Recording) -> None:
    phases, fallen = np.asarray(recording.phases), np.asarray(recording.fallen)
    velocities = np.asarray(recording.velocities)
    for name in ("rig", "skel"):
        for agent in range(recording.agent_count):
            prim = stages[name].GetPrimAtPath(f"/border_collie/Crowd/hopper_{agent:03d}")
            primvars = UsdGeom.PrimvarsAPI(prim)
            assert primvars.GetPrimvar("agentId").Get() == agent
            for frame in range(recording.frame_count):
                assert primvars.GetPrimvar("phase").Get(frame) == phases[frame, agent]
                assert primvars.GetPrimvar("fallen").Get(frame) == fallen[frame, agent]
                assert np.allclose(primvars.GetPrimvar("velocity").Get(frame), velocities[frame, agent], atol=1e-6)
            changes = int((np.diff(phases[:, agent]) != 0).sum())
            assert primvars.GetPrimvar("phase").GetAttr().GetNumTimeSamples() == (changes + 1 if changes else 0)
    upright, lying = (
        stages["rig"].GetPrimAtPath(f"/border_collie/Crowd/hopper_{agent:03d}").GetAttribute("primvars:fallen")
        for agent in (0, 1)
    )
    assert upright.GetNumTimeSamples() == 0
    assert lying.GetTimeSamples() == [0.0, recording.frame_count // 2]


def test_points_carry_ids_velocities_and_both_orientations(stages: dict[str, Any], recording: Recording) -> None:
    poses = np.asarray(recording.link_poses)
    for link, name in enumerate(("body", "upper_leg", "lower_leg")):
        instancer = UsdGeom.PointInstancer(stages["points"].GetPrimAtPath(f"/border_collie/Crowd/hopper_{name}"))
        assert list(instancer.GetIdsAttr().Get()) == list(range(recording.agent_count))
        for frame in FRAMES:
            half = np.array([[*q.GetImaginary(), q.GetReal()] for q in instancer.GetOrientationsAttr().Get(frame)])
            single = np.array([[*q.GetImaginary(), q.GetReal()] for q in instancer.GetOrientationsfAttr().Get(frame)])
            assert np.abs(half - single).max() < 1e-3
            assert np.abs(np.abs((single * poses[frame, :, link, 3:]).sum(axis=1)) - 1.0).max() < 1e-6
        velocities = np.array(instancer.GetVelocitiesAttr().Get(5))
        if link == 0:
            assert np.allclose(velocities, np.asarray(recording.velocities)[5], atol=1e-6)
        else:
            moved = (poses[6, :, link, :3] - poses[4, :, link, :3]) * 0.5 * recording.frame_rate
            assert np.allclose(velocities, moved, atol=1e-4)
        extent = np.array(instancer.GetExtentAttr().Get(5))
        origins = np.array(instancer.GetPositionsAttr().Get(5))
        assert (extent[0] < origins.min(axis=0)).all()
        assert (extent[1] > origins.max(axis=0)).all()
        spins = np.radians(np.array(instancer.GetAngularVelocitiesAttr().Get(3)))
        turned = Rotation.from_rotvec(2.0 * spins / recording.frame_rate) * Rotation.from_quat(poses[2, :, link, 3:])
        assert (turned * Rotation.from_quat(poses[4, :, link, 3:]).inv()).magnitude().max() < 1e-5


def test_collie_rides_along(stages: dict[str, Any], recording: Recording) -> None:
    poses = np.asarray(recording.actor_poses)
    collie = stages["rig"].GetPrimAtPath("/border_collie/Actors/collie")
    for frame in FRAMES:
        found = np.array(UsdGeom.XformCache(frame).GetLocalToWorldTransform(collie))
        assert np.abs(found - pose_matrices(poses[frame, 0])).max() < 1e-6


def test_camera_sees_everybody(tmp_path: Path) -> None:
    recording = synthetic_recording(agent_count=20, frame_count=60)
    stage = Usd.Stage.Open(str(write_stage(recording, tmp_path / "herd.usd", "points")))
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/border_collie/Cameras/main"))
    for frame in range(0, 60, 7):
        frustum = camera.GetCamera(frame).frustum
        for position in np.asarray(recording.link_poses[frame])[:, 0, :3].tolist():
            assert frustum.Intersects(Gf.Vec3d(*position)), (frame, position)


def test_binary_unless_text_is_asked_for(recording: Recording, tmp_path: Path) -> None:
    for suffix, start in ((".usd", b"PXR-USDC"), (".usdc", b"PXR-USDC"), (".usda", b"#usda")):
        path = write_stage(recording, tmp_path / f"herd{suffix}")
        assert path.read_bytes().startswith(start)
    assert sorted(os.listdir(tmp_path)) == ["herd.usd", "herd.usda", "herd.usdc"]


def test_same_recording_same_bytes(recording: Recording, tmp_path: Path) -> None:
    first, second = (write_stage(recording, tmp_path / f"{name}.usda", "skel").read_bytes() for name in "ab")
    assert first == second


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_progress_comes_to_its_end(recording: Recording, tmp_path: Path, representation: Any) -> None:
    calls: list[tuple[int, int]] = []
    write_stage(recording, tmp_path / "herd.usd", representation, lambda done, total: calls.append((done, total)))
    assert [done for done, _ in calls] == list(range(1, len(calls) + 1))
    assert {total for _, total in calls} == {len(calls)}


def test_open_stage_shows_what_replaced_it(tmp_path: Path) -> None:
    path = write_stage(synthetic_recording(agent_count=2, frame_count=3), tmp_path / "herd.usd")
    stage = Usd.Stage.Open(str(path))
    write_stage(synthetic_recording(agent_count=3, frame_count=3), path)
    assert stage.GetPrimAtPath("/border_collie/Crowd/hopper_002")


def test_bad_paths_are_one_line_before_any_work(tmp_path: Path) -> None:
    blank = cast("Recording", None)  # nothing may be asked of it
    (tmp_path / "folder.usd").mkdir()
    for name, words in (
        ("herd.obj", r"suffix '\.obj' is not one of \.usd, \.usdc, \.usda"),
        ("nowhere/herd.usd", "there is no folder"),
        ("folder.usd", "is a folder, not a file"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            write_stage(blank, tmp_path / name)
        assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == ["folder.usd"]


def test_failed_write_leaves_what_was_there(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "herd.usd"
    path.write_bytes(b"before")

    def no_space(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", no_space)
    with pytest.raises(InputError, match="No space left on device"):
        write_stage(recording, path)
    assert path.read_bytes() == b"before"
    assert os.listdir(tmp_path) == ["herd.usd"]


def test_unwritable_file_is_one_line(recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Sdf.Layer, "Export", lambda *_, **__: False)
    with pytest.raises(InputError, match="cannot be written") as caught:
        write_stage(recording, tmp_path / "herd.usd")
    assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == []


def test_bad_input_is_one_line(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'sprite' is not one of auto, rig, skel, points"):
        write_stage(recording, tmp_path / "herd.usd", cast("Any", "sprite"))
    poses = np.array(recording.link_poses)
    poses[3, 2, 1, 0] = np.nan
    with pytest.raises(InputError, match="agent 2 at frame 3 are not finite"):
        write_stage(changed(recording, link_poses=poses), tmp_path / "herd.usd")
    with pytest.raises(InputError, match="no frames yet"):
        write_stage(changed(recording, frame_count=0), tmp_path / "herd.usd")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_smallest_recordings(tmp_path: Path, representation: Any) -> None:
    one = synthetic_recording(agent_count=1, frame_count=1, collie=False, corral=False, falls=())
    stage = Usd.Stage.Open(str(write_stage(one, tmp_path / "one.usd", representation)))
    assert np.abs(MATRICES[representation](stage, one, Usd.TimeCode(0)) - expected(one, 0)).max() < 2e-6
    nobody = changed(one, casts=(), agent_count=0, link_poses=np.zeros((1, 0, 0, 7)))
    empty = Usd.Stage.Open(str(write_stage(nobody, tmp_path / "nobody.usd", representation)))
    assert empty.GetPrimAtPath("/border_collie/Crowd").GetVariantSets().HasVariantSet("representation")


def test_two_casts_side_by_side(tmp_path: Path) -> None:
    both = synthetic_recording(agent_count=5, frame_count=4)
    cast_ = both.casts[0]
    first = dataclasses.replace(cast_, agent_count=2, colors=cast_.colors[:2])
    second = dataclasses.replace(cast_, name="hop per", first_agent=2, agent_count=3, colors=cast_.colors[2:])
    split = changed(both, casts=(first, second))
    stage = Usd.Stage.Open(str(write_stage(split, tmp_path / "herd.usd")))
    children = [prim.GetName() for prim in stage.GetPrimAtPath("/border_collie/Crowd").GetChildren()]
    assert children == ["hopper_000", "hopper_001", "hop_per_002", "hop_per_003", "hop_per_004"]
    body = stage.GetPrimAtPath("/border_collie/Crowd/hop_per_004/body")
    found = np.array(UsdGeom.XformCache(3).GetLocalToWorldTransform(body))
    assert np.abs(found - expected(both, 3)[4, 0]).max() < 2e-6


def test_many_agents_are_points() -> None:
    assert [suggested_representation(count) for count in (16, 150, 151, 5000)] == ["rig", "rig", "points", "points"]


def test_a_small_crowd_is_rigs_unless_told_otherwise(recording: Recording, tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(write_stage(recording, tmp_path / "herd.usd")))
    crowd = stage.GetPrimAtPath("/border_collie/Crowd")
    assert crowd.GetVariantSets().GetVariantSelection("representation") == "rig"


@pytest.fixture(scope="module")
def herd() -> Recording:
    """105 robots, 30 s at 30 frames a second."""
    return synthetic_recording(agent_count=105, frame_count=900)


@pytest.mark.parametrize(("representation", "seconds"), [("rig", 3.0), ("points", 1.0)])
def test_a_herd_is_written_in_time(herd: Recording, tmp_path: Path, representation: Any, seconds: float) -> None:
    """Processor time, so that what else the machine does counts less."""
    taken = []
    for _ in range(2):
        start = time.process_time()
        write_stage(herd, tmp_path / "herd.usd", representation)
        taken.append(time.process_time() - start)
    assert min(taken) < seconds
