"""Scenarios, maneuvers, bodies and recordings in words and as plain data: `echelon list` and `echelon describe`."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from echelon.cli.progress import duration, size
from echelon.errors import InputError
from echelon.recording import Recording
from echelon.scenario import CHARACTERS, Scenario
from echelon.scenario.files import scenario_names
from echelon.settings import shown, suggestion
from echelon.warp_kernels.model import Model


def shipped() -> dict[str, dict[str, str]]:
    """What ships: for "scenarios", "maneuvers", "courses", "bodies", "characters" each name and a line about it."""
    from echelon.agents.bodies import body_names, load_body
    from echelon.agents.gymnasts.script import load_script, maneuver_names
    from echelon.terrain.course import course_names, course_path

    return {
        "scenarios": {name: Scenario.load(name).title for name in scenario_names()},
        "maneuvers": {name: load_script(name).title for name in maneuver_names()},
        "courses": {name: tomllib.loads(course_path(name).read_text("utf-8"))["title"] for name in course_names()},
        "bodies": {name: _body_line(load_body(name)) for name in body_names()},
        "characters": dict(CHARACTERS),
    }


def describe(what: str) -> tuple[dict[str, Any], str]:
    """A scenario, maneuver, body or recording, by name or path: its data, and the same in words.

    Raises:
        InputError: There is no such thing, or it is damaged.
    """
    from echelon.agents.bodies import body_names, load_body
    from echelon.agents.gymnasts.script import maneuver_names

    path = Path(what)
    if what in scenario_names():
        return _describe_scenario(Scenario.load(what))
    if what in body_names() or path.suffix == ".sd" or _holds(path, "links"):
        return _describe_body(load_body(what))
    if what in maneuver_names() or _holds(path, "row"):
        return _describe_maneuver(what)
    if path.suffix == ".toml":
        return _describe_scenario(Scenario.load(what))
    if path.is_dir():
        return _describe_recording(Recording(path))
    known = {*scenario_names(), *maneuver_names(), *body_names()}
    raise InputError(f"{shown(what)}: no such scenario, maneuver, body or recording{suggestion(what, known)}")


def _holds(path: Path, key: str) -> bool:
    """Whether a .toml file has a key: a body has links, a maneuver rows, a scenario neither."""
    if path.suffix != ".toml":
        return False
    try:
        return key in tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False  # as a scenario it gets the message that it deserves


def _describe_scenario(scenario: Scenario) -> tuple[dict[str, Any], str]:
    return scenario.to_dict(), scenario.to_toml().rstrip()


def _describe_maneuver(name: str) -> tuple[dict[str, Any], str]:
    """A maneuver's data, and the text of its file."""
    from echelon.agents.gymnasts.script import parse_script, script_text

    text, source = script_text(name)
    script = parse_script(text, source)
    data = {
        "name": script.name,
        "title": script.title,
        "description": script.description,
        "body": script.body,
        "parameters": {
            name: {"value": entry.value, "spread": entry.spread, "about": entry.about}
            for name, entry in script.parameters.items()
        },
        "rows": list(script.row_names),
        "text": text,
    }
    return data, text.rstrip()


def _body_line(model: Model) -> str:
    return f"{len(model.links)} links, {model.u_count} degrees of freedom, {model.mass:.4g} kg"


def _describe_body(model: Model) -> tuple[dict[str, Any], str]:
    name_width = max(len("link"), *(len(link.name) for link in model.links))
    lines = [f"{model.name}: {_body_line(model)}", "", f"{'link':<{name_width}}  {'mass [kg]':>9}  joint"]
    for link in model.links:
        parent = f" on {link.parent}" if link.parent else ""
        lines.append(f"{link.name:<{name_width}}  {link.mass:>9.4g}  {link.joint.name} ({link.joint.kind}){parent}")
    lines += ["", f"{len(model.contacts)} contact sites: {', '.join(site.name for site in model.contacts) or 'none'}"]
    lines += [f"{len(model.springs)} springs: {', '.join(spring.name for spring in model.springs) or 'none'}"]
    data = {
        "name": model.name,
        "mass": model.mass,
        "link_names": list(model.link_names),
        "coordinate_names": list(model.coordinate_names),
        "speed_names": list(model.speed_names),
        "body": model.to_dict(),
    }
    return data, "\n".join(lines)


def _describe_recording(recording: Recording) -> tuple[dict[str, Any], str]:
    disk = sum(file.stat().st_size for file in recording.path.rglob("*") if file.is_file())
    seconds = max(recording.frame_count - 1, 0) / recording.frame_rate
    kinds = {name: int((recording.events["kind"] == index).sum()) for index, name in enumerate(recording.event_names)}
    data: dict[str, Any] = {
        "path": str(recording.path),
        "status": recording.status,
        "frames": recording.frame_count,
        "frame_rate": recording.frame_rate,
        "seconds": seconds,
        "agents": recording.agent_count,
        "casts": {cast.name: cast.agent_count for cast in recording.casts},
        "actors": {actor.name: actor.kind for actor in recording.actors},
        "events": kinds,
        "bytes": disk,
        "summary": recording.summary,
        "scenario": recording.scenario,
    }
    unfinished = "" if recording.status == "done" else f"; interrupted: go on with echelon resume {recording.path}"
    rows = {
        "scenario": str(recording.scenario.get("name", "")),
        "status": f"{recording.status}{unfinished}",
        "length": f"{recording.frame_count} frames at {recording.frame_rate} a second, {duration(seconds)}",
        "casts": ", ".join(f"{cast.agent_count} {cast.name}" for cast in recording.casts),
        "actors": ", ".join(f"{actor.name} ({actor.kind})" for actor in recording.actors) or "none",
        "events": ", ".join(f"{count} {name}" for name, count in kinds.items() if count) or "none",
        "disk": size(disk),
        **{key.replace("_", " "): str(value) for key, value in recording.summary.items()},
    }
    width = max(len(key) for key in rows)
    return data, "\n".join(f"{key:<{width}}  {value}" for key, value in rows.items())
