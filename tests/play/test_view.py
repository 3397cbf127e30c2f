"""What a page is sent: everything that stands still once, everybody who moves in few and small messages."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="the page is viser's: install echelon[play]")

import viser

from echelon.export.light import lit
from echelon.export.picture_source import drawn_cast
from echelon.play.drawing.browser_light import before_tone_mapping, linear_of_display, shown_as_is, tone_mapped
from echelon.play.drawing.glb import ColoredMesh, glb
from echelon.play.drawing.moving import AWAY
from echelon.play.drawing.quiet_server import close_server, open_server
from echelon.play.drawing.shadows import outline, shadow_places
from echelon.play.drawing.view import View
from echelon.recording import Recording
from tests.export.road_ride import ride_recording
from tests.export.synthetic import synthetic_recording
from tests.play.viser_client import Message, ViserClient

LIMIT = 1.0e6  # [bytes/s] to each client


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    made = open_server()
    yield made
    close_server(made)


def view_of(server: viser.ViserServer, recording: Any) -> View:
    return View(
        server,
        casts=recording.casts,
        actors=recording.actors,
        world=recording.world,
        frame_rate=recording.frame_rate,
    )


def show(view: View, recording: Recording, frame: int, removed: np.ndarray | None = None, **more: Any) -> None:
    view.show(recording.link_poses[frame], recording.actor_poses[frame], removed, **more)


def positions(messages: list[Message], name: str) -> np.ndarray:
    """Where a batch or a thing has been put last, shape [n, 3]."""
    found = np.empty((0, 3))
    for message in messages:
        if message.get("name") != name:
            continue
        if "batched_positions" in message.get("updates", {}):
            found = message["updates"]["batched_positions"].reshape(-1, 3)
        elif message["type"] == "SetPositionMessage":
            found = np.array([message["position"]])
    return found


# ---- colours and meshes --------------------------------------------------------------------------------------------
def test_colors_survive_the_pages_tone_mapping() -> None:
    linear = np.random.default_rng(1).uniform(0.02, 0.7, (200, 3))
    linear = 0.5 * (linear + linear.mean(axis=1, keepdims=True))  # not so pure that the curve cannot give them
    np.testing.assert_allclose(tone_mapped(before_tone_mapping(linear)), linear, atol=1e-6)
    grass = lit(np.array([[0.105, 0.235, 0.055]]), np.array([[0.0, 0.0, 1.0]], np.float32))
    np.testing.assert_allclose(tone_mapped(shown_as_is(grass)), linear_of_display(grass.astype(float)), atol=1e-6)
    # Without it grass would be a good deal brighter.
    assert tone_mapped(linear_of_display(grass)).sum() > 1.15 * linear_of_display(grass).sum()


def test_a_mesh_is_what_gltf_says() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]])
    colors = np.array([[2.0, 0.5, 0.0, 1.0], [0.0, 1.0, 0.0, 0.5], [0.1, 0.1, 0.1, 0.0]])
    data = glb([ColoredMesh(points, np.array([[0, 1, 2]]), colors)], shaded=False, see_through=True)
    assert data[:4] == b"glTF"
    assert int.from_bytes(data[8:12], "little") == len(data)
    size = int.from_bytes(data[12:16], "little")
    document, rest = json.loads(data[20 : 20 + size]), data[20 + size :]
    assert int.from_bytes(rest[:4], "little") == len(rest) - 8 == document["buffers"][0]["byteLength"]
    attributes = document["meshes"][0]["primitives"][0]["attributes"]

    def read(accessor: int, kind: str, columns: int) -> np.ndarray:
        view = document["bufferViews"][document["accessors"][accessor]["bufferView"]]
        content = rest[8 + view["byteOffset"] : 8 + view["byteOffset"] + view["byteLength"]]
        return np.frombuffer(content, kind).reshape(-1, columns)

    np.testing.assert_array_equal(read(attributes["POSITION"], "<f4", 3), points.astype(np.float32))
    brightest = document["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"][0]
    stored = read(attributes["COLOR_0"], "<u2", 4) / 65535.0 * [brightest, brightest, brightest, 1.0]
    np.testing.assert_allclose(stored, colors, atol=2e-5 * brightest)
    assert document["materials"][0]["alphaMode"] == "BLEND"
    assert "KHR_materials_unlit" in document["materials"][0]["extensions"]


# ---- the stream ----------------------------------------------------------------------------------------------------
def test_a_herd_of_105_is_less_than_a_megabyte_a_second(server: viser.ViserServer) -> None:
    recording = synthetic_recording(agent_count=105, frame_count=16)
    view = view_of(server, recording)
    show(view, recording, 0)
    with ViserClient(server) as client:
        client.messages()
        assert client.bytes_received < 2.0e6  # to begin with
        client.bytes_received = 0
        for frame in range(1, 16):
            show(view, recording, frame)
            time.sleep(1.0 / 45.0)  # long enough for the frame to be sent, or a later one would replace it
        batches = client.batches(0.4)
    assert len(batches) >= 15, "frames were left out: nothing has been measured"
    assert client.bytes_received / 15 * 30 < LIMIT
    # A frame is one batch of messages, so that a page never shows half of it.
    moving = [batch for batch in batches if any("batched_positions" in m.get("updates", {}) for m in batch)]
    assert all(len({m["name"] for m in batch}) == len({m["name"] for m in moving[0]}) for batch in moving)


def test_who_has_not_moved_is_not_sent(server: viser.ViserServer) -> None:
    recording = synthetic_recording(agent_count=20)
    view = view_of(server, recording)
    show(view, recording, 3)
    with ViserClient(server) as client:
        client.messages()
        client.bytes_received = 0
        show(view, recording, 3)
        assert client.messages() == []
        assert client.bytes_received == 0


def test_everybody_is_where_the_recording_says(server: viser.ViserServer) -> None:
    recording = synthetic_recording(agent_count=4)
    view = view_of(server, recording)
    with ViserClient(server) as client:
        show(view, recording, 5)
        sent = client.messages()
        for link in range(3):
            for part in ("alike", "own"):
                found = positions(sent, f"/crowd/0/{link}/{part}")
                if len(found):
                    np.testing.assert_allclose(found, recording.link_poses[5][:, link, :3], atol=1e-5)
        assert len(positions(sent, "/crowd/0/0/own")) == 4
        np.testing.assert_allclose(positions(sent, "/actors/0")[0], recording.actor_poses[5][0, :3], atol=1e-5)


def test_who_is_removed_is_out_of_sight(server: viser.ViserServer) -> None:
    recording = synthetic_recording(agent_count=4)
    view = view_of(server, recording)
    gone = np.array([False, True, False, False])
    with ViserClient(server) as client:
        show(view, recording, 5, gone)
        sent = client.messages()
    for name in ("/crowd/0/0/own", "/crowd/0/0/alike", "/shadows/0"):
        np.testing.assert_array_equal(positions(sent, name)[:, 2] == AWAY[2], gone)


def test_another_crowd_after_a_restart(server: viser.ViserServer) -> None:
    recording, larger = synthetic_recording(agent_count=4), synthetic_recording(agent_count=7)
    view = view_of(server, recording)
    show(view, recording, 5)
    view.clear()
    with pytest.raises(RuntimeError, match="cast"):
        show(view, recording, 5)
    with ViserClient(server) as client:
        assert not [message for message in client.messages() if message["type"].startswith("Batched")]
        view.cast(larger.casts, larger.actors)
        show(view, larger, 2)
        assert len(positions(client.messages(), "/crowd/0/0/own")) == 7


def test_the_world_moves_past_where_asked(server: viser.ViserServer) -> None:
    recording = synthetic_recording(agent_count=4)
    view = view_of(server, recording)
    around = np.array([3.0, -2.0, 0.0])
    with ViserClient(server) as client:
        show(view, recording, 5, around=around)
        sent = client.messages()
    expected = recording.link_poses[5][:, 0, :3] - around
    np.testing.assert_allclose(positions(sent, "/crowd/0/0/own"), expected, atol=1e-5)
    np.testing.assert_allclose(positions(sent, "/world")[0], -around)
    assert np.abs(positions(sent, "/shadows/0")[:, 2]).max() < 0.1


# ---- shadows -------------------------------------------------------------------------------------------------------
def test_a_shadow_moves_away_from_the_sun_as_its_body_rises() -> None:
    recording = synthetic_recording(agent_count=2)
    poses = np.array(recording.link_poses[0][0])
    body = outline(drawn_cast(recording.casts[0]).links, poses)
    assert body.is_round
    low, high = poses[None, 0].copy(), poses[None, 0].copy()
    high[:, 2] += 1.0
    plane = np.array([[0.0, 0.0, 1.0, 0.0]])
    before, after = shadow_places(body, low, plane)[0], shadow_places(body, high, plane)[0]
    # The sun is 49 degrees high, towards -x.
    np.testing.assert_allclose(after - before, [0.74 / 0.88, 0.24 / 0.88, 0.0], atol=1e-9)


# ---- a road --------------------------------------------------------------------------------------------------------
def test_a_road_has_its_houses_trees_and_paint(server: viser.ViserServer) -> None:
    recording = ride_recording(riders=3)
    view = view_of(server, recording)
    show(view, recording, 4)
    with ViserClient(server) as client:
        messages = client.messages(1.0)
        size = client.bytes_received
    names = {message.get("name", "") for message in messages}
    assert {"/world/ground", "/world/paint", "/world/around"} <= names
    assert any(name.startswith("/world/house/") for name in names)
    assert any(name.startswith("/world/broadleaf/") for name in names)
    assert size < 3.0e6
    assert view.is_road
    # Shadows lie on the road, 22 m up, where the riders are.
    near = recording.link_poses[4][:, 0, 2]
    shadows = [m for m in messages if m.get("name") == "/shadows/0" and "batched_positions" in m.get("updates", {})]
    heights = shadows[-1]["updates"]["batched_positions"].reshape(-1, 3)[:, 2]
    np.testing.assert_allclose(heights, near, atol=0.2)
