"""Fingerprints: what they tell apart, and what not."""

from __future__ import annotations

from dataclasses import replace

from echelon.agents.fingerprint import fingerprint, misfit
from echelon.agents.gymnasts.gymnast import Gymnast, gymnast
from echelon.agents.gymnasts.script import parse_script
from echelon.warp_kernels.reference import Body

MALE = gymnast("male")
HERE = fingerprint(MALE)


def of(body: Body) -> Gymnast:
    return Gymnast(body, "other", MALE.gain)


def test_what_numbers_depend_on_is_told_apart() -> None:
    body = MALE.body
    heavy = replace(body, links=(replace(body.links[0], mass=body.links[0].mass * 1.001), *body.links[1:]))
    soft = replace(body, contacts=(replace(body.contacts[0], stiffness=6e4), *body.contacts[1:]))
    changed = {
        "body": fingerprint(of(heavy)),
        "contact": fingerprint(of(soft)),
        "servos": fingerprint(Gymnast(body, "other", 1.01 * MALE.gain)),
        "step": fingerprint(MALE, steps_per_second=2400, tick=8),
    }
    for name, other in changed.items():
        differing = [key for key, value in other.plain().items() if value != HERE.plain()[key]]
        assert differing == [name]


def test_what_makes_no_difference_is_not() -> None:
    body = MALE.body
    bare = replace(body, name="somebody", links=tuple(replace(link, visuals=()) for link in body.links))
    assert fingerprint(of(bare)) == HERE
    # The last digits of a scaled body.
    almost = replace(body, links=(replace(body.links[0], mass=body.links[0].mass * (1.0 + 1e-15)), *body.links[1:]))
    assert fingerprint(of(almost)) == HERE
    assert fingerprint(gymnast("male", name="again")) == HERE


def test_a_script_says_in_one_line_that_it_does_not_fit() -> None:
    tuned = "\n".join(f'{name} = "{value}"' for name, value in HERE.plain().items())
    script = parse_script(f'[[row]]\nname = "r"\n[tuned]\n{tuned}\n', "x.toml")
    assert misfit(script, HERE) == ""
    assert misfit(parse_script('[[row]]\nname = "r"', "x.toml"), HERE) == ""
    line = misfit(script, fingerprint(gymnast("male", height=1.70, mass=65.0), steps_per_second=2400, tick=8))
    assert line.startswith(f"x.toml: was tuned for another body {HERE.body}, not ")
    assert "another step 1/1200 s, tick of 4, semi-implicit, not 1/2400 s, tick of 8, semi-implicit" in line
    assert "\n" not in line
