"""Contact between characters in whole runs: events, the summary, going on from a state, and turning it off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from echelon.errors import InputError
from echelon.recording import EVENT_NAMES, Recording
from echelon.scenario import Scenario
from echelon.simulation import Simulation, simulate
from echelon.simulation.scene import SceneFrames
from echelon.warp_kernels.frame import ChunkArrays


def crowded(**crowd: object) -> Scenario:
    """Nine robots who stand close together and want to go anywhere."""
    data = {
        "name": "crowded",
        "seconds": 4.0,
        "crowd": {"count": 9, "start_spacing": 0.85, "start_jitter": 0.05, **crowd},
        "herd": {"mode": "random", "change": 1.5, "period": 0.5, "max_speed": 1.5},
        "world": {"ground": "plane"},
    }
    return Scenario.from_dict(data)


def run(scenario: Scenario, folder: Path) -> Recording:
    """The recording of a scenario, on one thread."""
    return simulate(scenario, recording=folder / "run.recording", threads=1)


def test_contacts_are_events_and_counted(tmp_path: Path):
    recording = run(crowded(), tmp_path)
    kind = EVENT_NAMES.index("contact")
    found = recording.events[recording.events["kind"] == kind]
    assert recording.summary["contacts"] == len(found) > 10
    assert len(np.unique(found["agent"])) > 5


def test_contact_can_be_turned_off(tmp_path: Path):
    recording = run(crowded(contact=False), tmp_path)
    assert recording.summary["contacts"] == 0


def test_a_run_goes_on_from_a_state_in_the_middle_of_a_crush_to_the_same_bits():
    whole, part = (Simulation(crowded(), threads=1) for _ in range(2))
    advance(whole, 90)
    advance(part, 55)
    later = Simulation(crowded(), threads=1)
    later.load_state(part.state(), part.frame)
    advance(later, 35)
    assert later.state_hash() == whole.state_hash()
    for simulation in (whole, part, later):
        simulation.close()


def advance(simulation: Simulation, frames: int) -> None:
    """Frames that nobody records."""
    engine = simulation.engine
    engine.bind(ChunkArrays.allocate(1, engine.agent_count, engine.character))
    for _ in range(frames):
        simulation.advance(0, SceneFrames.allocate(1, simulation.scene, engine.agent_count))


@pytest.mark.parametrize(("key", "value"), [("restitution", 1.2), ("friction", -0.1)])
def test_what_a_contact_cannot_be_is_said_in_a_line(key: str, value: float):
    with pytest.raises(InputError, match=f"crowd.{key}") as caught:
        crowded(**{key: value})
    assert "\n" not in str(caught.value)
