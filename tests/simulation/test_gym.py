"""Gymnasts in shots: who does what, when, with which body; what a recording keeps; which captures failed."""

from __future__ import annotations

import filecmp
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.measures import MEASURES
from echelon.agents.gymnasts.script import parse_script
from echelon.errors import InputError
from echelon.recording import Recording, layout
from echelon.scenario import Scenario
from echelon.simulation import Simulation, resume, simulate
from echelon.simulation.captures import missed_captures
from echelon.simulation.casts import casts_of
from echelon.simulation.roles import after_waiting, roles_of, with_scripts

SINK = """
name = "sink"
title = "Down a little, and up"
[parameters]
depth = { value = 0.06, spread = 0.01 }
wait = { value = 0.3, spread = 0.05 }
[[row]]
name = "down"
phase = "crouch"
duration = 0.4
legs = { length = "leg - depth" }
settings = { balance = 1.0 }
next = [{ to = "up", when = { row_age = ["wait", inf] } }]
[[row]]
name = "up"
legs = { length = "leg - 0.02" }
settings = { balance = 1.0 }
capture = { com_height = [2.0, inf], foot_force = [0.0, inf] }
"""


def troupe(**performance: Any) -> dict[str, Any]:
    """A scenario of seven gymnasts who sink or stand."""
    return {
        "name": "troupe",
        "seconds": 1.5,
        "crowd": {"count": 7, "start_pattern": "line", "start_jitter": 0.0},
        "world": {"ground": "mat", "half_length": 6.0, "half_width": 12.0},
        "performance": {
            "maneuver": ["sink", "stand"],
            "variation": 1.0,
            "delay_spread": 0.5,
            "casts": [{"character": "gymnast-male", "share": 3}, {"character": "gymnast-female", "share": 4}],
            "scripts": [{"name": "sink", "text": SINK}],
            **performance,
        },
    }


def plan(**performance: Any) -> Scenario:
    return with_scripts(Scenario.from_dict(troupe(**performance)))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return simulate(plan(), recording=tmp_path_factory.mktemp("gym") / "troupe.recording", threads=1)


# ---- who does what -------------------------------------------------------------------------------------------------
def test_maneuvers_are_dealt_in_turn_within_each_cast() -> None:
    scenario = plan()
    casts = casts_of(scenario)
    assert [(cast.name, cast.first, cast.count) for cast in casts] == [("gymnast-male", 0, 3), ("gymnast-female", 3, 4)]
    maneuvers = [role.maneuver for role in roles_of(scenario, casts).each]
    assert maneuvers == ["sink", "stand", "sink", "sink", "stand", "sink", "stand"]


def test_individuals_differ_by_their_number_alone() -> None:
    def values(count: int) -> list[tuple[float, dict[str, float]]]:
        scenario = Scenario.from_dict({**troupe(casts=[]), "crowd": {"character": "gymnast-male", "count": count}})
        scenario = with_scripts(scenario)
        return [(role.delay, dict(role.values)) for role in roles_of(scenario, casts_of(scenario)).each]

    few, many = values(3), values(9)
    assert many[:3] == few
    assert len({delay for delay, _ in many}) == 9
    depths = [found["depth"] for _, found in many if found]
    assert len(set(depths)) == len(depths)
    assert all(abs(depth - 0.06) <= 0.01 for depth in depths)


def test_parameters_are_numbers_or_ranges_and_those_of_a_cast_go_first() -> None:
    scenario = plan(
        variation=0.0,
        parameters={"depth": [0.04, 0.08], "wait": 0.2},
        maneuver="sink",
        casts=[{"character": "gymnast-male"}, {"character": "gymnast-female", "parameters": {"wait": 0.7}}],
    )
    casts = casts_of(scenario)
    roles = roles_of(scenario, casts).each
    assert [role.values["wait"] for role in roles] == [0.2] * casts[0].count + [0.7] * casts[1].count
    depths = [role.values["depth"] for role in roles]
    assert all(0.04 <= depth <= 0.08 for depth in depths)
    assert max(depths) - min(depths) > 0.01


def test_a_parameter_that_no_maneuver_has_is_refused_with_the_nearest() -> None:
    scenario = plan(parameters={"dept": 0.05})
    with pytest.raises(InputError, match=r"performance\.parameters\.dept: .*did you mean 'depth'"):
        roles_of(scenario, casts_of(scenario))


def test_a_maneuver_that_is_not_there_is_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'stand'"):
        plan(maneuver="stadn")


def test_shares_deal_out_the_whole_crowd() -> None:
    shares = [{"character": "gymnast-male", "share": share, "height": 1.7 + 0.1 * share} for share in (1, 1, 1)]
    casts = casts_of(plan(casts=shares))
    assert [cast.count for cast in casts] == [3, 2, 2]
    assert [cast.name for cast in casts] == ["gymnast-male", "gymnast-male-2", "gymnast-male-3"]
    assert casts[0].character is casts[1].character  # traced and compiled once


def test_bodies_are_of_the_size_and_burden_that_is_asked_for() -> None:
    (cast,) = casts_of(plan(casts=[{"character": "gymnast-female", "height": 1.7, "mass": 60, "backpack": 4}]))
    assert cast.character.body.mass == pytest.approx(64.0)


def test_waiting_comes_before_the_first_row_and_leads_there_once() -> None:
    script = parse_script(SINK, "sink")
    body = casts_of(plan())[0].character.body
    table = script.table(body)
    waiting = after_waiting(table, table[1], 0.4)
    at = Gymnast.script.transition_place
    assert len(waiting) == 3
    assert waiting[0, at] == 1.0
    assert waiting[0, at + 1] == MEASURES.index("row_age")
    assert waiting[0, at + 2] == pytest.approx(0.4)
    assert waiting[1, at] == 2.0  # what led to the second row leads to the third
    assert waiting[2, at] == -1.0


# ---- in a recording ------------------------------------------------------------------------------------------------
def test_everybody_begins_when_it_is_due(recorded: Recording) -> None:
    scenario = Scenario.from_dict(recorded.scenario)
    roles = roles_of(scenario, casts_of(scenario))
    rows = recorded.measures[:, :, recorded.measure_names.index("row")] % roles.tables[0].shape[1]
    for agent, role in enumerate(roles.each):
        begun = int(np.argmax(rows[1:, agent] >= 1.0)) + 1
        assert begun / 30.0 == pytest.approx(role.delay, abs=1.0 / 30.0 + 0.005)


def test_bodies_stand_where_the_line_is_and_face_the_heading(tmp_path: Path) -> None:
    turned = Scenario.from_dict({**troupe(heading=0.5 * math.pi, maneuver="stand"), "seconds": 0.1})
    recording = simulate(turned, recording=tmp_path / "turned.recording", threads=1)
    places = recording.link_poses[0, :, 0, :2]
    assert np.ptp(places[:, 1]) < 1e-6  # the line lies across the heading, along x
    assert np.ptp(places[:, 0]) == pytest.approx(6 * 2.5)
    pelvis = recording.link_poses[0, :, 0, 3:]
    assert np.allclose(pelvis, [0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)], atol=1e-6)


def test_a_recording_has_all_casts_and_their_individuals(recorded: Recording) -> None:
    assert [(cast.name, cast.first_agent, cast.agent_count) for cast in recorded.casts] == [
        ("gymnast-male", 0, 3),
        ("gymnast-female", 3, 4),
    ]
    heights = recorded.link_poses[0, :, 0, 2]
    assert heights[:3].min() > heights[3:].max()  # he is taller than she is
    assert recorded.summary["balanced"] == 7
    assert recorded.summary["maneuvers"]["sink"]["performers"] == 4


def test_the_recording_keeps_the_text_of_every_maneuver(recorded: Recording, tmp_path: Path) -> None:
    texts = {script["name"]: script["text"] for script in recorded.scenario["performance"]["scripts"]}
    assert texts["sink"] == SINK
    assert "stand" in texts
    again = simulate(Scenario.from_dict(recorded.scenario), recording=tmp_path / "again.recording", threads=1)
    assert again.summary["state_hash"] == recorded.summary["state_hash"]


def test_a_maneuver_in_a_file_may_change_after_the_run(tmp_path: Path) -> None:
    (tmp_path / "sink.toml").write_text(SINK, "utf-8")
    (tmp_path / "shot.toml").write_text(
        'seconds = 0.5\n[crowd]\ncharacter = "gymnast-male"\ncount = 1\n[performance]\nmaneuver = "sink.toml"\n',
        "utf-8",
    )
    recording = simulate(Scenario.load(tmp_path / "shot.toml"), recording=tmp_path / "shot.recording", threads=1)
    (tmp_path / "sink.toml").unlink()
    again = Scenario.from_dict(recording.scenario)
    assert simulate(again, recording=tmp_path / "again.recording", threads=1).summary == recording.summary


def test_captures_that_failed_are_told_with_what_was_measured(recorded: Recording) -> None:
    found = missed_captures(recorded)
    sinking = [agent for agent, done in enumerate(recorded.summary["performers"]) if done["maneuver"] == "sink"]
    assert sorted(missed.agent for missed in found) == sinking
    heights = recorded.measures[:, :, recorded.measure_names.index("com_height")]
    for missed in found:
        assert (missed.from_row, missed.to_row, missed.measure) == ("down", "up", "com_height")
        assert (missed.least, missed.most) == (2.0, np.inf)
        # On arrival, within the frame that it is told of.
        frame = round(missed.time * 30.0)
        around = np.sort(heights[frame - 1 : frame + 1, missed.agent])
        assert around[0] - 1e-4 <= missed.measured <= around[1] + 1e-4
        assert "com_height was" in str(missed)
        assert "at least 2" in str(missed)


def test_other_crowds_have_no_captures(tmp_path: Path) -> None:
    puck = Scenario.from_dict({"name": "p", "seconds": 0.1, "crowd": {"character": "point-mass", "count": 1}})
    recording = simulate(puck, recording=tmp_path / "p.recording", threads=1)
    with pytest.raises(InputError, match="nobody in this recording follows a script"):
        missed_captures(recording)


def test_a_troupe_that_was_interrupted_goes_on_to_the_same_bytes(
    recorded: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layout, "_CHUNK_SECONDS", 1)
    whole = simulate(plan(), recording=tmp_path / "whole.recording", threads=1)
    advance = Simulation.advance

    def killed(self: Simulation, *arguments: Any) -> None:
        if self.frame == 35:
            raise KeyboardInterrupt
        advance(self, *arguments)

    monkeypatch.setattr(Simulation, "advance", killed)
    with pytest.raises(KeyboardInterrupt):
        simulate(plan(), recording=tmp_path / "part.recording", threads=1)
    monkeypatch.setattr(Simulation, "advance", advance)
    part = resume(tmp_path / "part.recording", threads=1)
    assert part.summary["state_hash"] == recorded.summary["state_hash"]
    for file in sorted(path for path in whole.path.rglob("*") if path.is_file()):
        assert filecmp.cmp(file, part.path / file.relative_to(whole.path), shallow=False), file


# ---- what is refused -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"performance": {"manuver": "stand"}}, "did you mean 'maneuver'"),
        ({"performance": {"parameters": {"depth": "deep"}}}, "must be a number, or \\[least, most\\]"),
        ({"performance": {"parameters": {"depth": [2, 1]}}}, "the least must not be more than the most"),
        ({"performance": {"maneuver": []}}, "must name at least one maneuver"),
        ({"performance": {"casts": [{"character": "gymnast-mle"}]}}, "did you mean 'gymnast-male'"),
        ({"crowd": {"character": "hopper"}, "performance": {}}, "needs crowd.character to be one of gymnast-male"),
        ({"collie": {}}, "collie: must be left out for a gymnast-male"),
        ({"crowd": {"character": "gymnast-male", "fallen": "stand"}}, "crowd.fallen = 'stand': must be 'lie'"),
        ({"crowd": {"character": "gymnast-male", "start_pattern": "lines"}}, "did you mean 'line'"),
    ],
)
def test_wrong_settings_are_one_line(changes: dict[str, Any], message: str) -> None:
    data = {"name": "x", "crowd": {"character": "gymnast-male", "count": 2}, "world": {"ground": "plane"}, **changes}
    with pytest.raises(InputError, match=message):
        Scenario.from_dict(data)


# ---- dropped ---------------------------------------------------------------------------------------------------------
def dropping(**performance: Any) -> Scenario:
    return Scenario.from_dict(
        {
            "name": "drop",
            "seconds": 2.5,
            "crowd": {"character": "gymnast-male", "positions": [[0.0, 0.0], [0.0, 3.0], [0.0, 6.0]]},
            "world": {"ground": "mat"},
            "performance": {"maneuver": "drop-landing", "drop": 0.5, "drop_spread": 0.4, **performance},
        }
    )


def test_who_is_dropped_falls_from_that_high_and_lands_balanced(tmp_path: Path) -> None:
    recording = simulate(dropping(), recording=tmp_path / "drop", threads=1)
    body = casts_of(dropping())[0].character.body
    feet = [body.link_index(name) for name in ("left_foot", "right_foot")]
    heights = recording.link_poses[:, :, feet, 2].min(axis=2)
    falls = heights[0] - heights[-1]
    assert falls.min() > 0.5
    assert falls.max() < 0.9
    assert np.ptp(falls) > 0.05, "no two fall alike"
    landed = np.argmax(recording.measures[:, :, recording.measure_names.index("foot_force")] > 0.0, axis=0) / 30.0
    np.testing.assert_allclose(landed, np.sqrt(2.0 * falls / 9.81), atol=0.05)
    assert recording.summary["balanced"] == 3


def test_who_is_dropped_on_the_way_goes_where_it_faces() -> None:
    simulation = Simulation(dropping(drop_speed=2.0, heading=0.5), threads=1)
    u = simulation.engine.u
    np.testing.assert_allclose(u[:, :2], [[2.0 * math.cos(0.5), 2.0 * math.sin(0.5)]] * 3, rtol=1e-6)
    assert np.all(u[:, 2:] == 0.0)
    simulation.close()


@pytest.mark.parametrize(
    ("performance", "message"),
    [
        ({"delay": 1.0}, r"performance\.delay = 1: must be 0 for who is dropped"),
        ({"lean": 0.05}, r"performance\.lean = 0.05: must be 0 for who is dropped"),
        ({"drop": 0.0, "drop_spread": 0.0, "drop_speed": 1.0}, r"drop_speed = 1: needs performance\.drop above 0"),
        ({"drop": -1.0}, r"performance\.drop = -1"),
    ],
)
def test_nobody_waits_in_the_air(performance: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        dropping(**performance)


def test_mats_and_limits_are_everybodys() -> None:
    (usual,), (mat,) = casts_of(dropping()), casts_of(dropping(soft_mat=True))
    (limited,) = casts_of(dropping(joint_limits=True, strength_limits=True))
    stiffness = [part.character.body.contacts[0].stiffness for part in (usual, mat, limited)]
    assert stiffness[0] == pytest.approx(4.0 * stiffness[1])
    assert stiffness[2] == stiffness[0]
    assert isinstance(limited.character, Gymnast)
    assert limited.character.strongest is not None
    assert any(link.joint.limits for link in limited.character.body.links)
    assert not any(link.joint.limits for link in usual.character.body.links)
    (again,) = casts_of(dropping(soft_mat=True))
    assert again.character is mat.character
