"""Long runs are written clip by clip, and read back as if they were in one file."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import os
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from echelon.errors import InputError
from echelon.export import usd
from echelon.export.stage.clips import clips_folder, stretches
from echelon.export.usd import Representation, suggested_clip_frames, write_stage
from echelon.recording import Recording
from tests.export.stage_validation import nvidia_issues, usd_errors
from tests.export.synthetic import on_disk, synthetic_recording

REPRESENTATIONS = get_args(Representation)
CLIP = 8  # frames
TIMES = (0.0, 3.0, 7.0, 7.5, 8.0, 8.25, 15.5, 16.0, 20.0, 20.75, 21.0)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return synthetic_recording(agent_count=3, frame_count=22, falls=(1,))


@pytest.fixture(scope="module")
def stages(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Any, Any]]:
    """For each representation the stage in one file and the stage in clips."""
    folder = tmp_path_factory.mktemp("stages")
    found = {}
    for name in REPRESENTATIONS:
        whole = write_stage(recording, folder / f"{name}_whole.usd", name)
        clipped = write_stage(recording, folder / f"{name}_clips.usd", name, clip_frames=CLIP)
        found[name] = (Usd.Stage.Open(str(whole)), Usd.Stage.Open(str(clipped)))
    return found


def values(stage: Any, time: Any) -> dict[str, Any]:
    """Every attribute of the crowd at a time, instances looked into."""
    crowd = stage.GetPrimAtPath("/border_collie/Crowd")
    prims = Usd.PrimRange(crowd, Usd.TraverseInstanceProxies())
    return {str(attr.GetPath()): attr.Get(time) for prim in prims for attr in prim.GetAttributes()}


def numbers(value: Any) -> np.ndarray:
    """An attribute's value as numbers, quaternions with one sign."""
    if isinstance(value, list | tuple) or hasattr(value, "__len__"):
        array = np.array([np.asarray(numbers(entry)) for entry in value]) if len(value) else np.empty(0)
        return array
    if hasattr(value, "GetReal"):
        quaternion = np.array([value.GetReal(), *value.GetImaginary()], dtype=float)
        return quaternion * (1.0 if quaternion[np.abs(quaternion).argmax()] > 0.0 else -1.0)
    return np.asarray(value, dtype=float)


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_clips_say_what_one_file_says(stages: dict[str, tuple[Any, Any]], representation: str) -> None:
    whole, clipped = stages[representation]
    moving = 0
    for time in (*TIMES, Usd.TimeCode.Default()):
        expected, found = values(whole, time), values(clipped, time)
        # Where clips are used, links that never move are left to the joints: they may say more, never something else.
        assert set(expected) <= set(found)
        for path, value in expected.items():
            if isinstance(value, str) or value is None or "Token" in type(value).__name__:
                assert str(found[path]) == str(value), path
                continue
            assert np.allclose(numbers(found[path]), numbers(value), atol=2e-6), (time, path)
        moving += sum(np.any(numbers(found[path]) != 0.0) for path in expected if path.endswith("xformOp:orient"))
    if representation == "rig":
        assert moving > 20


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_links_are_where_they_were_in_every_clip(
    stages: dict[str, tuple[Any, Any]], recording: Recording, representation: str
) -> None:
    """World transforms through the clips, so not only attribute by attribute."""
    _, stage = stages[representation]
    poses = np.asarray(recording.link_poses)
    for frame in (0, 5, 8, 13, 16, 21):
        if representation == "points":
            instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/border_collie/Crowd/hopper_lower_leg"))
            to_world = np.array(UsdGeom.XformCache(frame).GetLocalToWorldTransform(instancer.GetPrim()))
            found = np.array(
                [np.array(m) @ to_world for m in instancer.ComputeInstanceTransformsAtTime(float(frame), float(frame))]
            )[:, 3, :3]
            assert np.allclose(found, poses[frame, :, 2, :3], atol=3e-6)
        elif representation == "rig":
            cache = UsdGeom.XformCache(frame)
            path = "/border_collie/Crowd/hopper_{:03d}/body/upper_leg/lower_leg"
            found = [cache.GetLocalToWorldTransform(stage.GetPrimAtPath(path.format(agent))) for agent in range(3)]
            assert np.allclose(np.array(found)[:, 3, :3], poses[frame, :, 2, :3], atol=3e-6)


def test_clips_lie_beside_the_stage(stages: dict[str, tuple[Any, Any]]) -> None:
    _, stage = stages["rig"]
    path = Path(stage.GetRootLayer().realPath)
    names = sorted(os.listdir(clips_folder(path)))
    assert names == ["000000.usdc", "000008.usdc", "000016.usdc", "manifest.usda"]
    api = Usd.ClipsAPI(stage.GetPrimAtPath("/border_collie/Crowd"))
    assert [asset.path for asset in api.GetClipAssetPaths("rig")] == [
        f"./rig_clips.clips/{name}" for name in names[:-1]
    ]
    manifest = Sdf.Layer.FindOrOpen(str(clips_folder(path) / "manifest.usda"))
    held: set[str] = set()
    for name in names[:-1]:
        clip = Sdf.Layer.FindOrOpen(str(clips_folder(path) / name))
        clip.Traverse("/", lambda where: held.add(str(where)) if where.IsPropertyPath() else None)
    declared: set[str] = set()
    manifest.Traverse("/", lambda where: declared.add(str(where)) if where.IsPropertyPath() else None)
    assert declared == held
    # Nothing is sampled twice: the stage itself has no samples of the crowd.
    root = stage.GetRootLayer()
    assert not [p for p in samples_of(root) if "/Crowd" in p]


def samples_of(layer: Any) -> list[str]:
    found: list[str] = []
    layer.Traverse(
        "/", lambda p: found.append(str(p)) if p.IsPropertyPath() and layer.GetNumTimeSamplesForPath(p) else None
    )
    return found


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_validators_find_nothing(recording: Recording, tmp_path: Path, representation: Any) -> None:
    path = write_stage(recording, tmp_path / "long.usd", representation, clip_frames=CLIP)
    assert usd_errors(Usd.Stage.Open(str(path))) == []
    assert nvidia_issues(path) == []


def test_several_representations_share_their_clips(recording: Recording, tmp_path: Path) -> None:
    path = write_stage(recording, tmp_path / "all.usd", "rig", also=("points", "skel"), clip_frames=CLIP)
    stage = Usd.Stage.Open(str(path))
    variants = stage.GetPrimAtPath("/border_collie/Crowd").GetVariantSets().GetVariantSet("representation")
    poses = np.asarray(recording.link_poses)
    variants.SetVariantSelection("points")
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/border_collie/Crowd/hopper_body"))
    start = np.round(poses[0, :, 0, :3].mean(axis=0))
    assert np.allclose(np.array(instancer.GetPositionsAttr().Get(12.0)) + start, poses[12, :, 0, :3], atol=1e-5)
    variants.SetVariantSelection("rig")
    body = stage.GetPrimAtPath("/border_collie/Crowd/hopper_002/body")
    assert np.allclose(body.GetAttribute("xformOp:translate").Get(12.0), poses[12, 2, 0, :3])


def test_recording_from_disk_is_read_stretch_by_stretch(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = on_disk(recording, tmp_path / "herd.recording")
    asked: list[int] = []
    read = usd.read_motion

    def watched(source: Recording, frames: slice = slice(None)) -> Any:
        asked.append(frames.stop - frames.start)
        return read(source, frames)

    monkeypatch.setattr(usd, "read_motion", watched)
    write_stage(stored, tmp_path / "herd.usd", "points", clip_frames=CLIP)
    assert max(asked) == CLIP + 3, "more frames than a clip's, its end and one to either side were read at once"


def test_stretches_cover_a_run_once() -> None:
    assert [(clip.first, clip.last) for clip in stretches(22, 8)] == [(0, 8), (8, 16), (16, 21)]
    assert [(clip.first, clip.last) for clip in stretches(17, 8)] == [(0, 8), (8, 16)]
    assert [(clip.first, clip.last) for clip in stretches(1, 8)] == [(0, 0)]


def test_only_long_runs_are_cut(recording: Recording) -> None:
    assert suggested_clip_frames(recording) == 0

    class Long:
        casts = recording.casts
        frame_count = 1_000_000

    frames = suggested_clip_frames(cast("Recording", Long))
    assert 9 * frames <= usd.CLIP_TRANSFORMS < 9 * (frames + 1)


def test_short_stage_over_a_long_one_takes_its_clips_away(recording: Recording, tmp_path: Path) -> None:
    path = write_stage(recording, tmp_path / "herd.usd", clip_frames=CLIP)
    write_stage(recording, path, clip_frames=4)
    assert len(os.listdir(clips_folder(path))) == 7
    write_stage(recording, path)
    assert os.listdir(tmp_path) == ["herd.usd"]


def test_what_is_in_the_way_is_left_alone(recording: Recording, tmp_path: Path) -> None:
    folder = tmp_path / "herd.clips"
    folder.mkdir()
    (folder / "holiday.mp4").write_bytes(b"dear")
    with pytest.raises(InputError, match=r"'herd\.clips' beside it holds other things"):
        write_stage(recording, tmp_path / "herd.usd", clip_frames=CLIP)
    assert (folder / "holiday.mp4").read_bytes() == b"dear"
    with pytest.raises(InputError, match="clip_frames = -1"):
        write_stage(recording, tmp_path / "other.usd", clip_frames=-1)


def test_failure_half_way_leaves_what_was_there(recording: Recording, tmp_path: Path) -> None:
    path = write_stage(recording, tmp_path / "herd.usd", clip_frames=CLIP)
    before = {file.name: file.read_bytes() for file in clips_folder(path).iterdir()}

    def stop(done: int, total: int) -> None:
        if done > 0.6 * total:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_stage(recording, path, "skel", stop, clip_frames=CLIP)
    assert {file.name: file.read_bytes() for file in clips_folder(path).iterdir()} == before
    assert sorted(os.listdir(tmp_path)) == ["herd.clips", "herd.usd"]


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_progress_comes_to_its_end(recording: Recording, tmp_path: Path, representation: Any) -> None:
    calls: list[tuple[int, int]] = []
    write_stage(
        recording, tmp_path / "h.usd", representation, lambda done, total: calls.append((done, total)), clip_frames=CLIP
    )
    assert [done for done, _ in calls] == list(range(1, len(calls) + 1))
    assert {total for _, total in calls} == {len(calls)}
