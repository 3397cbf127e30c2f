"""Whether maneuvers fit those who perform them: what `echelon simulate` says before a run."""

from __future__ import annotations

from echelon.agents.fingerprint import fingerprint, misfit
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.scenario import Scenario
from echelon.simulation.casts import casts_of
from echelon.simulation.roles import roles_of, with_scripts


def misfits(scenario: Scenario) -> tuple[str, ...]:
    """A line for each tuned script that was tuned for another body, contact or step than those who follow it have.

    Raises:
        InputError: As `casts_of` and `roles_of`.
    """
    if not scenario.performs:
        return ()
    lines: dict[str, None] = {}
    casts = casts_of(scenario)
    roles = roles_of(with_scripts(scenario), casts)
    for cast in casts:
        character = cast.character
        if not isinstance(character, Gymnast):
            continue
        rate = scenario.frame_rate
        substeps, tick = scenario.engine.stride(rate, character.steps_per_second, character.steps_per_tick)
        here = fingerprint(
            character, steps_per_second=substeps * rate, tick=tick, integrator=scenario.engine.integrator
        )
        scripts = {roles.each[agent].maneuver: roles.each[agent].script for agent in cast.agents}
        lines |= {line: None for script in scripts.values() if (line := misfit(script, here))}
    return tuple(lines)
