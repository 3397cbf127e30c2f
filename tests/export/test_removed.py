"""Whoever has been taken away is not to be seen: on stages of any kind, in clips, in pictures, by cameras."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
import pytest
from PIL import Image
from pxr import Usd, UsdGeom

from echelon.export.camera import View
from echelon.export.physics import write_physics
from echelon.export.pictures import render_still
from echelon.export.removed import places_to_frame, removed_agents
from echelon.export.renderer import Renderer, RenderingUnavailable
from echelon.export.stage_source import StageSource
from echelon.export.usd import Representation, write_stage
from echelon.recording import PHASE_NAMES, REMOVED_PHASE, Recording
from tests.export.stage_validation import nvidia_issues, usd_errors
from tests.export.synthetic import on_disk, synthetic_recording

ABOVE = View((2.0, -4.0, 6.0), (2.0, 1.5, 0.5), 0.9)
REPRESENTATIONS = get_args(Representation)
GONE = {1: 13, 3: 16}  # which agents, and from which frame on
CLIP = 8  # frames: one goes within a clip, the other as one begins


@pytest.fixture(scope="module")
def recording() -> Recording:
    made = cast("Any", synthetic_recording(agent_count=4, frame_count=24, falls=(1, 3), collie=False))
    phases = made.phases.copy()
    for agent, frame in GONE.items():
        phases[frame:, agent] = len(PHASE_NAMES)
    return cast("Recording", replace(made, phases=phases, phase_names=(*PHASE_NAMES, REMOVED_PHASE)))


@pytest.fixture(scope="module")
def gl() -> None:
    """Skips a test where nothing can be drawn."""
    try:
        Renderer((16, 16), []).close()
    except RenderingUnavailable as error:
        pytest.skip(str(error))


def expected(frame: int) -> list[bool]:
    return [agent in GONE and frame >= GONE[agent] for agent in range(4)]


def test_a_recording_tells_who_has_been_taken_away(recording: Recording, tmp_path: Path) -> None:
    found = removed_agents(recording, slice(10, 20))
    np.testing.assert_array_equal(found, [expected(frame) for frame in range(10, 20)])
    # Runs in which nobody can be have no such phase.
    stored = on_disk(synthetic_recording(agent_count=4), tmp_path / "stored")
    assert stored.removed.shape == (24, 4)
    assert stored.removed[5:7].dtype == bool
    assert not stored.removed[:].any()


@pytest.mark.parametrize("clip_frames", [0, CLIP])
@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_on_a_stage_they_are_invisible(
    recording: Recording, representation: Representation, clip_frames: int, tmp_path: Path
) -> None:
    path = write_stage(recording, tmp_path / "herd.usd", representation, clip_frames=clip_frames)
    source = StageSource(path)
    np.testing.assert_array_equal(source.removed(0, 24), [expected(frame) for frame in range(24)])
    stage = Usd.Stage.Open(str(path))
    crowd = stage.GetPrimAtPath("/border_collie/Crowd")
    if representation == "points":
        instancers = [UsdGeom.PointInstancer(prim) for prim in crowd.GetChildren()]
        assert len(instancers) == 3
        for instancer in instancers:
            assert list(instancer.GetInvisibleIdsAttr().Get(14.0)) == [1]
            assert list(instancer.GetInvisibleIdsAttr().Get(23.0)) == [1, 3]
    else:
        for agent, name in ((0, "hopper_000"), (1, "hopper_001")):
            seen = [
                UsdGeom.Imageable(crowd.GetChild(name)).ComputeVisibility(float(frame)) for frame in (0, 12, 13, 23)
            ]
            gone = "invisible" if agent in GONE else "inherited"
            assert seen == ["inherited", "inherited", gone, gone]
        assert crowd.GetChild("hopper_001").GetAttribute("primvars:fallen").Get(20.0) == 1
    if clip_frames == 0:
        assert usd_errors(stage) == []
        assert nvidia_issues(path) == []


def test_another_engine_does_not_get_them(recording: Recording, tmp_path: Path) -> None:
    for frame, expected_names in ((12, 4), (14, 3), (20, 2)):
        path = write_physics(recording, tmp_path / "physics.usd", frame)
        stage = Usd.Stage.Open(str(path))
        names = [prim.GetName() for prim in stage.GetPrimAtPath("/border_collie/Crowd").GetChildren()]
        assert names == [f"hopper_{agent:03d}" for agent in range(4) if not expected(frame)[agent]]
        assert len(names) == expected_names
        assert nvidia_issues(path) == []


def test_nothing_is_said_of_those_who_stay(tmp_path: Path) -> None:
    path = write_stage(synthetic_recording(), tmp_path / "herd.usda", "rig", also=("points",))
    text = path.read_text(encoding="utf-8")
    assert "visibility" not in text
    assert "invisibleIds" not in text


@pytest.mark.usefixtures("gl")
def test_pictures_do_not_show_them(recording: Recording, tmp_path: Path) -> None:
    """A picture in which two have been taken away is that of a run in which there were only the other two."""
    made = cast("Any", recording)
    stay = [0, 2]
    members = made.casts[0]
    fewer = replace(
        made,
        casts=(replace(members, agent_count=2, colors=members.colors[stay]),),
        agent_count=2,
        **{name: getattr(made, name)[:, stay] for name in ("link_poses", "velocities", "phases", "fallen", "frozen")},
    )

    def picture(run: Any, name: str) -> np.ndarray:
        still = render_still(run, tmp_path / name, time=23 / 30, size=(240, 160), camera=ABOVE)
        return np.asarray(Image.open(still)).astype(int)

    all_there = picture(replace(made, phase_names=(*PHASE_NAMES, "dancing")), "all.png")
    without = picture(made, "without.png")
    alone = picture(fewer, "alone.png")
    # The layers that keep shadows apart, by fractions of a millimetre, depend on who is in the list; nothing else does.
    assert (np.abs(without - alone).max(axis=2) > 8).sum() <= 4
    assert (np.abs(all_there - without).max(axis=2) > 60).sum() > 20


def test_cameras_do_not_wait_for_them() -> None:
    places = np.array([[[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [100.0, 0.0, 0.0]]])
    framed = places_to_frame(places, np.array([[False, False, True]]))
    np.testing.assert_array_equal(framed[0, 2], [1.0, 0.0, 1.0])
    np.testing.assert_array_equal(framed[0, :2], places[0, :2])
    np.testing.assert_array_equal(places_to_frame(places, np.ones((1, 3), bool)), places)
