"""Another engine takes over: Newton's USD importer reads the physics layer.

Runs where Newton is installed with what its importer needs (``pip install newton newton-usd-schemas``), and takes half
a minute the first time, because Newton compiles its kernels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from echelon.export.physics import write_physics
from echelon.recording import Recording
from tests.export.synthetic import hopper_model, joints_model, synthetic_recording

newton: Any = pytest.importorskip("newton", reason="Newton is not installed; see the top of this file")
pytest.importorskip("newton_usd_schemas", reason="newton-usd-schemas, which Newton's importer needs, is not installed")

FRAME = 5
COUNTS = {"free": 6, "ball": 3, "pin": 1, "universal": 2, "gimbal": 3, "slider": 1}


@pytest.fixture(scope="module", params=["hopper", "every joint"])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, Any, Any]:
    model = hopper_model() if request.param == "hopper" else joints_model()
    recording = synthetic_recording(agent_count=2, frame_count=12, falls=(), model=model)
    path = write_physics(recording, tmp_path_factory.mktemp("newton") / "physics.usd", FRAME)
    builder = newton.ModelBuilder()
    resolvers = [newton.usd.SchemaResolverNewton(), newton.usd.SchemaResolverPhysx()]
    found = builder.add_usd(str(path), schema_resolvers=resolvers)
    return recording, builder.finalize(device="cpu"), found


def link_indices(recording: Recording, found: Any, agent: int) -> list[int]:
    folder = f"/border_collie/Crowd/hopper_{agent:03d}"
    return [found["path_body_map"][f"{folder}/{link.name.replace(' ', '_')}"] for link in recording.casts[0].body.links]


def test_masses(case: tuple[Recording, Any, Any]) -> None:
    recording, model, found = case
    masses, coms, tensors = (array.numpy() for array in (model.body_mass, model.body_com, model.body_inertia))
    for agent in range(recording.agent_count):
        for index, link in zip(link_indices(recording, found, agent), recording.casts[0].body.links, strict=True):
            assert np.isclose(masses[index], link.mass)
            assert np.allclose(coms[index], link.com, atol=1e-6)
            assert np.allclose(tensors[index], link.inertia, atol=1e-5)


def test_joints(case: tuple[Recording, Any, Any]) -> None:
    recording, model, _ = case
    links = recording.casts[0].body.links
    assert model.articulation_count == recording.agent_count
    assert model.joint_count == model.body_count == recording.agent_count * len(links)
    assert model.joint_dof_count == recording.agent_count * sum(COUNTS[link.joint.kind] for link in links)
    kinds = {
        "free": newton.JointType.FREE,
        "ball": newton.JointType.BALL,
        "pin": newton.JointType.REVOLUTE,
        "slider": newton.JointType.PRISMATIC,
        "universal": newton.JointType.D6,
        "gimbal": newton.JointType.D6,
    }
    types = sorted(int(kind) for kind in model.joint_type.numpy())
    assert types == sorted(int(kinds[link.joint.kind]) for link in links for _ in range(recording.agent_count))


def test_poses(case: tuple[Recording, Any, Any]) -> None:
    recording, model, found = case
    poses = np.asarray(recording.link_poses)[FRAME]
    placed = model.state().body_q.numpy()
    for agent in range(recording.agent_count):
        for link, index in enumerate(link_indices(recording, found, agent)):
            assert np.allclose(placed[index, :3], poses[agent, link, :3], atol=1e-5)
            turn = Rotation.from_quat(placed[index, 3:]).inv() * Rotation.from_quat(poses[agent, link, 3:])
            assert turn.magnitude() < 1e-5


def test_joint_coordinates_give_the_same_poses(case: tuple[Recording, Any, Any]) -> None:
    """Newton's own kinematics, from the joint states, put every link where the body poses say it is."""
    recording, model, found = case
    state = model.state()
    before, speeds = state.body_q.numpy().copy(), state.body_qd.numpy().copy()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    for agent in range(recording.agent_count):
        for link, index in zip(recording.casts[0].body.links, link_indices(recording, found, agent), strict=True):
            if link.joint.kind == "ball":
                continue  # UsdPhysics has no state for a spherical joint; Newton starts it at zero
            assert np.allclose(state.body_q.numpy()[index], before[index], atol=2e-5), link.name
            assert np.allclose(state.body_qd.numpy()[index], speeds[index], atol=1e-3), link.name
