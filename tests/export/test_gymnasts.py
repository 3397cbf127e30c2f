"""Gymnasts on a stage and in pictures: joint hierarchies that retarget, two bodies in one shot, seen from the side."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel

from echelon.export.camera import side_views
from echelon.export.pictures import render_strip
from echelon.export.renderer import Renderer, RenderingUnavailable
from echelon.export.stage.characters import link_paths, reference_origins
from echelon.export.stage_source import StageSource
from echelon.export.usd import Representation, write_stage
from echelon.recording import Recording
from echelon.scenario import Scenario
from echelon.simulation import simulate
from tests.export.stage_validation import nvidia_issues, usd_errors

HEADING = 0.5
LEFT_HAND = (
    "pelvis/abdomen/lower_chest/upper_chest/sternum/left_shoulder_girdle/left_upper_arm/left_lower_arm/left_hand"
)


@pytest.fixture(scope="module")
def gl() -> None:
    """Skips a test where nothing can be drawn."""
    try:
        Renderer((16, 16), []).close()
    except RenderingUnavailable as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    plan = Scenario.from_dict(
        {
            "name": "pair",
            "seconds": 0.3,
            "crowd": {"count": 4, "start_pattern": "line", "start_jitter": 0.0},
            "world": {"ground": "mat", "half_length": 5.0, "half_width": 7.0},
            "performance": {
                "maneuver": "knee-bend",
                "heading": HEADING,
                "casts": [{"character": "gymnast-male"}, {"character": "gymnast-female"}],
            },
        }
    )
    return simulate(plan, recording=tmp_path_factory.mktemp("gym") / "pair.recording", threads=1)


@pytest.fixture(scope="module")
def stages(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("stages")
    return {name: write_stage(recording, folder / f"{name}.usd", name) for name in get_args(Representation)}


def skeletons(stage: Any) -> dict[str, tuple[Any, Any]]:
    """The query of each agent's skeleton, and its prim, by the agent's name."""
    found = {}
    cache = UsdSkel.Cache()
    for root in stage.GetDefaultPrim().GetChild("Crowd").GetChildren():
        if root.IsA(UsdSkel.Root):
            cache.Populate(UsdSkel.Root(root), Usd.TraverseInstanceProxies())
            (skeleton,) = (
                prim for prim in root.GetFilteredChildren(Usd.TraverseInstanceProxies()) if prim.IsA(UsdSkel.Skeleton)
            )
            found[root.GetName()] = cache.GetSkelQuery(UsdSkel.Skeleton(skeleton)), skeleton
    return found


def test_joints_hang_as_a_body_does(recording: Recording, stages: dict[str, Path]) -> None:
    stage = Usd.Stage.Open(str(stages["skel"]))
    found = skeletons(stage)
    assert list(found) == ["gymnast_male_000", "gymnast_male_001", "gymnast_female_002", "gymnast_female_003"]
    for query, _ in found.values():
        joints = list(query.GetJointOrder())
        assert joints == list(link_paths(recording.casts[0].body))
        assert LEFT_HAND in joints
        valid, why = query.GetTopology().Validate()
        assert valid, why
        assert query.GetTopology().GetNumJoints() == 22


def test_rest_and_bind_are_the_reference_pose_with_arms_out(recording: Recording, stages: dict[str, Path]) -> None:
    stage = Usd.Stage.Open(str(stages["skel"]))
    found = skeletons(stage)
    for name, cast in (("gymnast_male_000", recording.casts[0]), ("gymnast_female_002", recording.casts[1])):
        query, skeleton = found[name]
        origins = reference_origins(cast.body)
        assert query.HasBindPose()
        assert query.HasRestPose()
        bind = np.asarray(UsdSkel.Skeleton(skeleton).GetBindTransformsAttr().Get())
        rest = np.asarray(UsdSkel.Skeleton(skeleton).GetRestTransformsAttr().Get())
        np.testing.assert_allclose(bind[:, 3, :3], origins, atol=1e-6)
        np.testing.assert_allclose(rest[:, 3, :3], [link.joint.position for link in cast.body.links], atol=1e-6)
        hands = [cast.body.link_index(f"{side}_hand") for side in ("left", "right")]
        shoulders = [cast.body.link_index(f"{side}_upper_arm") for side in ("left", "right")]
        # A T: hands as high as shoulders, and far out.
        np.testing.assert_allclose(bind[hands, 3, 2], bind[shoulders, 3, 2], atol=0.1)
        assert bind[hands[0], 3, 1] > 0.6
        assert bind[hands[1], 3, 1] < -0.6


@pytest.mark.parametrize("frame", [0, 9])
def test_joints_are_where_the_recording_has_them(frame: int, recording: Recording, stages: dict[str, Path]) -> None:
    stage = Usd.Stage.Open(str(stages["skel"]))
    places = UsdGeom.XformCache(frame)
    for agent, (query, skeleton) in enumerate(skeletons(stage).values()):
        joints = np.asarray(query.ComputeJointSkelTransforms(frame)) @ np.asarray(
            places.GetLocalToWorldTransform(skeleton)
        )
        np.testing.assert_allclose(joints[:, 3, :3], recording.link_poses[frame, agent, :, :3], atol=1e-5)


@pytest.mark.parametrize("name", get_args(Representation))
def test_validators_have_nothing_to_say(name: str, stages: dict[str, Path]) -> None:
    assert usd_errors(Usd.Stage.Open(str(stages[name]))) == []
    assert nvidia_issues(stages[name]) == []


@pytest.mark.parametrize("name", get_args(Representation))
def test_a_stage_is_read_back_with_mat_and_heading(name: str, recording: Recording, stages: dict[str, Path]) -> None:
    source = StageSource(stages[name])
    assert source.world.mat == pytest.approx((5.0, 7.0))
    assert source.world.heading == pytest.approx(HEADING)
    assert [len(cast.colors) for cast in source.casts] == [2, 2]
    np.testing.assert_allclose(
        source.body_places(0, 10), recording.link_poses[:10, :, 0, :3], atol=1e-5, err_msg="pelvises"
    )


def test_a_camera_at_the_side_keeps_all_of_everybody_in_the_picture(recording: Recording) -> None:
    poses = recording.link_poses[:, :, :, :3]
    for frame, view in enumerate(side_views(poses[:, :, 0], HEADING, recording.frame_rate, 4.0 / 3.0)):
        to_camera = np.linalg.inv(view.pose())
        seen = poses[frame].reshape(-1, 3) @ to_camera[:3, :3].T + to_camera[:3, 3]
        half = np.tan(0.5 * view.field_of_view)
        assert np.all(seen[:, 2] < 0.0)
        assert np.all(np.abs(seen[:, 1] / seen[:, 2]) < half)
        assert np.all(np.abs(seen[:, 0] / seen[:, 2]) < 4.0 / 3.0 * half)
        # From the right: who faces the heading faces the picture's right side.
        right = view.pose()[:3, 0]
        np.testing.assert_allclose(right, [np.cos(HEADING), np.sin(HEADING), 0.0], atol=1e-9)


@pytest.mark.usefixtures("gl")
def test_a_strip_from_the_side_shows_the_mat(recording: Recording, tmp_path: Path) -> None:
    from PIL import Image

    path = render_strip(recording, tmp_path / "strip.png", interval=0.1, count=3, size=(120, 160), camera="side")
    picture = np.asarray(Image.open(path)).astype(float)
    assert picture.shape[:2] == (160, 3 * 120 + 8)
    blue = (picture[..., 2] > 1.5 * picture[..., 0]) & (picture[..., 2] > picture[..., 1])
    assert blue[100:].mean() > 0.3
