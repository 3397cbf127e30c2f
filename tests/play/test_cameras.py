"""Cameras: what each who watches is told about where to look from."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("viser", reason="the page is viser's: install echelon[play]")

import viser

from echelon.play.drawing.cameras import EYE, LEAN_SHARE, Cameras, Looking, overview
from echelon.play.drawing.quiet_server import close_server, open_server
from echelon.play.drawing.view import View
from tests.export.synthetic import synthetic_recording
from tests.play.viser_client import Message, ViserClient

UPRIGHT = np.array([5.0, 2.0, 0.0, 0.0, 0.0, np.sin(0.25), np.cos(0.25)])  # heads 0.5 rad from x towards y
AHEAD = np.array([np.cos(0.5), np.sin(0.5), 0.0])
LEFT = np.array([-np.sin(0.5), np.cos(0.5), 0.0])


@dataclass
class Stage:
    """A server with a view and cameras, and a client that has been taken notice of."""

    server: viser.ViserServer
    cameras: Cameras
    client: ViserClient
    number: int
    first: list[Message]

    def seen(self, looking: Looking, pose: np.ndarray | None, updates: int = 40, **more: np.ndarray) -> list[Message]:
        """What a client is sent in the last of so many frames that look alike."""
        self.cameras.watch(self.number, looking)
        for _ in range(updates):
            self.cameras.update(pose, **more)
        self.client.messages(0.1)
        # The same once more is not sent: a hair farther on.
        self.cameras.update(None if pose is None else pose + [1e-3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], **more)
        return self.client.messages(0.2)


@pytest.fixture
def stage() -> Iterator[Stage]:
    server = open_server()
    recording = synthetic_recording(agent_count=2)
    view = View(
        server, casts=recording.casts, actors=recording.actors, world=recording.world, frame_rate=recording.frame_rate
    )
    cameras = Cameras(server, view)
    with ViserClient(server, announced=True) as client:
        first = client.messages(0.8)
        while not server.get_clients():
            time.sleep(0.01)
            first += client.messages(0.1)
        yield Stage(server, cameras, client, next(iter(server.get_clients())), first)
    close_server(server)


def told(messages: list[Message], kind: str) -> np.ndarray:
    """The last place or direction of a kind."""
    key = "look_at" if kind == "SetCameraLookAtMessage" else "position"
    return np.array([message[key] for message in messages if message["type"] == kind][-1])


def eye_and_target(messages: list[Message]) -> tuple[np.ndarray, np.ndarray]:
    return told(messages, "SetCameraPositionMessage"), told(messages, "SetCameraLookAtMessage")


def test_a_page_is_told_which_client_it_is(stage: Stage) -> None:
    html = [message["props"]["content"] for message in stage.first if message["type"] == "GuiHtmlMessage"]
    assert [int(re.findall(r'id="echelon-viewer" data-viewer="(\d+)"', text)[0]) for text in html] == [stage.number]


def test_the_saddle_is_at_the_eyes_and_looks_ahead(stage: Stage) -> None:
    eye, target = eye_and_target(stage.seen("saddle", UPRIGHT))
    np.testing.assert_allclose(eye - UPRIGHT[:3], EYE[0] * AHEAD + [0.0, 0.0, EYE[2]], atol=2e-3)
    way = (target - eye) / np.linalg.norm(target - eye)
    assert way @ AHEAD > 0.99
    assert -0.2 < way[2] < 0.0


def test_the_bicycle_of_who_rides_comes_with_the_camera(stage: Stage) -> None:
    stage.cameras.watch(stage.number, "saddle")
    stage.cameras.update(UPRIGHT)
    stage.client.messages(0.2)
    stage.cameras.update(UPRIGHT + [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    together = [{message["type"] for message in batch} for batch in stage.client.batches(0.2)]
    assert {"SetPositionMessage", "SetCameraPositionMessage", "SetCameraLookAtMessage"} <= together[0]
    # Who goes away from it sees everybody's again.
    stage.cameras.watch(stage.number, "free")
    stage.cameras.update(UPRIGHT)
    assert "RemoveSceneNodeMessage" in {message["type"] for message in stage.client.messages(0.2)}


def test_the_head_turns_left_and_up_whatever_the_bicycle_does(stage: Stage) -> None:
    stage.cameras.look(stage.number, 0.5 * np.pi, 0.3)
    eye, target = eye_and_target(stage.seen("saddle", UPRIGHT))
    way = (target - eye) / np.linalg.norm(target - eye)
    assert way @ LEFT > 0.95
    assert way[2] > 0.2


def test_the_horizon_shows_a_third_of_the_lean(stage: Stage) -> None:
    lean = 0.3  # to the right: about x, which looks ahead
    turn = Rotation.from_euler("z", 0.5) * Rotation.from_euler("x", lean)
    pose = np.concatenate([UPRIGHT[:3], turn.as_quat()])
    stage.seen("saddle", UPRIGHT, updates=3)
    sent = stage.seen("saddle", pose, updates=60)
    eye = told(sent, "SetCameraPositionMessage")
    assert (eye - pose[:3]) @ LEFT == pytest.approx(-np.sin(lean) * EYE[2], abs=2e-3)
    # Up has not changed in the last frame, so it was sent before: ask for it by leaning a hair more.
    stage.cameras.update(np.concatenate([pose[:3], (turn * Rotation.from_euler("x", 0.01)).as_quat()]))
    up = told(stage.client.messages(0.2), "SetCameraUpDirectionMessage")
    assert np.arctan2(-up @ LEFT, up[2]) == pytest.approx(LEAN_SHARE * lean, abs=0.01)


def test_following_is_from_behind_and_above(stage: Stage) -> None:
    eye, target = eye_and_target(stage.seen("follow", UPRIGHT))
    assert (eye - UPRIGHT[:3]) @ AHEAD < -4.0
    assert eye[2] > 2.0
    assert (target - UPRIGHT[:3]) @ AHEAD > 0.0


def test_a_free_camera_is_placed_once_and_left_alone(stage: Stage) -> None:
    places = np.random.default_rng(4).uniform(-10.0, 10.0, (30, 3)) * [1.0, 1.0, 0.0]
    stage.cameras.watch(stage.number, "free")
    stage.cameras.update(UPRIGHT, places)
    eye, target = eye_and_target(stage.client.messages(0.2))
    assert eye[2] > 5.0
    assert np.linalg.norm(target - np.median(places, axis=0)) < 2.0
    for step in range(5):
        stage.cameras.update(UPRIGHT + [float(step), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], places)
    assert not [message for message in stage.client.messages(0.2) if message["type"].startswith("SetCamera")]


@pytest.mark.parametrize("looking", ["saddle", "follow"])
def test_without_a_rider_the_crowd_is_followed(stage: Stage, looking: Looking) -> None:
    places = np.random.default_rng(5).uniform(-6.0, 6.0, (20, 3)) * [1.0, 1.0, 0.0]
    velocity = np.array([4.0, 0.0, 0.0])
    stage.cameras.watch(stage.number, looking)
    for frame in range(240):
        stage.cameras.update(None, places + frame / 30.0 * velocity)
    stage.client.messages(0.2)
    now = places + 8.0 * velocity
    stage.cameras.update(None, now)
    eye, target = eye_and_target(stage.client.messages(0.2))
    assert np.linalg.norm(target - np.median(now, axis=0)) < 2.0
    # From behind: it has turned into the crowd's direction.
    assert (target - eye)[0] > 3.0 * abs((target - eye)[1])


def test_nobody_minds_a_client_that_is_not_there(stage: Stage) -> None:
    stage.cameras.watch(999, "saddle")
    stage.cameras.look(999, 0.1, 0.1)
    stage.cameras.update(None)
    assert not [message for message in stage.client.messages(0.2) if message["type"].startswith("SetCamera")]


def test_the_overview_sees_everybody() -> None:
    places = np.random.default_rng(6).uniform(-15.0, 15.0, (60, 3)) * [1.0, 1.0, 0.0]
    shot = overview(places)
    ways = places - shot.eye
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    ahead = (shot.target - shot.eye) / np.linalg.norm(shot.target - shot.eye)
    assert np.mean(np.arccos(ways @ ahead) < 0.5 * shot.field_of_view) > 0.9
