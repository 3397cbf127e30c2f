"""A body as data: what is accepted, what is refused, and how it survives plain data, TOML and JSON."""

from __future__ import annotations

import copy
import json
import tomllib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from engine_scenes import ball_body, free_link, mixed_joints
from hypothesis import given, settings
from hypothesis import strategies as st

from echelon.errors import InputError
from echelon.warp_kernels.model import Joint, Link, Model, ModelError, Spring
from echelon.warp_kernels.reference import Body

SPRINGS = (
    Spring("tie", None, (0.0, 0.0, 2.0), "link 1", (0.0, 0.1, 0.0), 100.0, 1.0),
    Spring("cord", "link 1", (0.0, 0.0, 0.0), "link 5", (0.0, 0.0, 0.1), 50.0, 2.0, rest_length=0.3),
)


def whole() -> Body:
    """Every joint there is, springs to a link and to the world, contacts, limits and no limits."""
    body = mixed_joints()
    gimbal = body.links[1]
    joint = replace(gimbal.joint, limits=((-1.0, 1.0), None, (0.0, 0.5)), limit_stiffness=50.0, limit_damping=1.0)
    contacts = tuple(replace(site, link="link 2") for site in ball_body(surface="wall", use="rare").contacts)
    links = (body.links[0], replace(gimbal, joint=joint), *body.links[2:])
    return Body(name="whole", links=links, springs=SPRINGS, contacts=contacts, gravity=3.7)


def plain() -> dict[str, Any]:
    return copy.deepcopy(whole().to_dict())


# ---- there and back --------------------------------------------------------------------------------------------------
def test_plain_data_and_back():
    body = whole()
    again = Body.from_dict(body.to_dict())
    assert again == body
    assert isinstance(again, Body)  # what one asks is what one gets
    assert type(Model.from_dict(body.to_dict())) is Model
    assert again.parents == body.parents


def test_json_and_back():
    body = whole()
    assert Body.from_dict(json.loads(json.dumps(body.to_dict()))) == body


def test_plain_data_has_no_null_so_that_toml_can_hold_it():
    def check(value: Any) -> None:
        assert value is not None
        for entry in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
            check(entry)

    check(whole().to_dict())


def test_toml():
    text = """
    name = "hung"
    [[links]]
    name = "bob"
    mass = 2.0
    [links.joint]
    name = "arm"
    kind = "universal"
    axes = [[1, 0, 0], [0, 1, 0]]
    limits = [[], [-1, 1]]
    limit_stiffness = 9
    [[springs]]
    name = "tie"
    link_a = ""
    position_a = [0, 0, 1]
    link_b = "bob"
    position_b = [0, 0, 0]
    stiffness = 10
    damping = 1
    """
    body = Body.from_dict(tomllib.loads(text))
    assert body.springs[0].link_a is None
    assert body.springs[0].link_b == "bob"
    assert body.links[0].joint.limits == (None, (-1.0, 1.0))
    assert body.links[0].parent is None
    assert body.gravity == 9.80665


def test_names_and_counts_follow_the_joints():
    body = whole()
    assert body.q_count == 7 + 3 + 4 + 2 + 1 + 1 == len(body.coordinate_names) == len(body.q_reference)
    assert body.u_count == 6 + 3 + 3 + 2 + 1 + 1 == len(body.speed_names)
    assert body.coordinate_names[:7] == tuple(f"joint 0.{c}" for c in ("x", "y", "z", "qx", "qy", "qz", "qw"))
    assert body.speed_names[6:12] == ("joint 1.1", "joint 1.2", "joint 1.3", "joint 2.wx", "joint 2.wy", "joint 2.wz")
    assert body.coordinate_names[-1] == "joint 5"
    assert [body.q_start(i) for i in range(6)] == [0, 7, 10, 14, 16, 17]
    assert [body.u_start(i) for i in range(6)] == [0, 6, 9, 12, 14, 15]
    np.testing.assert_array_equal(body.normalized(body.q_reference), body.q_reference)
    with pytest.raises(ModelError, match="no link 'tail'; links are link 0, "):
        body.link_index("tail")


# ---- what is refused -------------------------------------------------------------------------------------------------
def refusal(data: Any) -> str:
    """The one line that says why this cannot be a body."""
    with pytest.raises(ModelError) as caught:
        Body.from_dict(data)
    message = str(caught.value)
    assert isinstance(caught.value, InputError)
    assert len(message.splitlines()) == 1
    return message


def put(*path: str | int, value: Any) -> Callable[[dict[str, Any]], None]:
    def edit(data: dict[str, Any]) -> None:
        at: Any = data
        for step in path[:-1]:
            at = at[step]
        at[path[-1]] = value

    return edit


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        # not a list where one belongs
        (("links",), 3, "links: 3 is not a list"),
        (("links",), "link", "links: 'link' is not a list"),
        (("links",), {"a": 1}, "is not a list"),
        (("springs",), 1, "springs: 1 is not a list"),
        (("contacts",), 2.5, "contacts: 2.5 is not a list"),
        (("links", 0, "visuals"), 7, "visuals: 7 is not a list"),
        (("links", 0, "inertia"), 1, "inertia: 1 is not a list"),
        (("links", 0, "inertia", 1), 1, "inertia: 1 is not a list"),
        (("links", 0, "com"), 0, "com: 0 is not a list"),
        (("links", 0, "com"), "abc", "com: 'abc' is not a list"),
        (("links", 1, "joint", "axes"), 1, "axes: 1 is not a list"),
        (("links", 1, "joint", "axes", 0), 1, "axes: 1 is not a list"),
        (("links", 1, "joint", "limits"), 1, "limits: 1 is not a list"),
        (("links", 1, "joint", "limits", 0), 1, "limits: 1 is not a list"),
        (("springs", 0, "position_a"), 4, "position_a: 4 is not a list"),
        # not a table, not a string, not a number
        (("links", 0), 5, "a link is a table, found 5"),
        (("links", 0, "joint"), "free", "joint: expected a table"),
        (("springs", 0), 5, "expected a table"),
        (("contacts", 0), [1], "expected a table"),
        (("name",), 5, "name is not a string"),
        (("links", 0, "name"), 5, "name is not a string"),
        (("links", 0, "name"), ["a"], "name is not a string"),
        (("links", 0, "name"), True, "name is not a string"),
        (("links", 1, "parent"), 0, "parent: 0 is not a string"),
        (("links", 1, "joint", "name"), 5, "name: 5 is not a string"),
        (("links", 1, "joint", "kind"), 5, "kind: 5 is not a string"),
        (("springs", 1, "link_a"), 5, "link_a: 5 is not a string"),
        (("contacts", 0, "link"), 5, "link: 5 is not a string"),
        (("contacts", 0, "use"), 5, "use: 5 is not a string"),
        (("links", 0, "mass"), "5", "mass: '5' is not a finite number"),
        (("links", 0, "mass"), True, "mass: True is not a finite number"),
        (("links", 0, "mass"), float("nan"), "mass: nan is not a finite number"),
        (("gravity",), float("inf"), "gravity: inf is not a finite number"),
        (("springs", 0, "stiffness"), None, "stiffness: None is not a finite number"),
        # of the wrong length
        (("links", 0, "com"), [1, 2], "com: expected 3 numbers, found 2"),
        (("links", 0, "inertia"), [[1, 0, 0]], "expected three rows of three numbers"),
        (("links", 1, "joint", "axes", 0), [1, 0], "axes are lists of 3 numbers"),
        (("links", 1, "joint", "limits", 0), [1], "limits lists of 2"),
        (("contacts", 0, "radii"), [1, 2], "radii: expected 3 numbers, found 2"),
        # unknown and missing
        (("links", 0, "wheels"), 4, "unknown key 'wheels'"),
        (("springs", 0, "colour"), 4, "unknown key 'colour'"),
        (("parents",), [], "unknown key 'parents'"),
        (("contacts", 0, "surface"), "water", "surface 'water' is not"),
        (("contacts", 0, "integration"), "magic", "integration 'magic' is not implicit or explicit"),
        (("contacts", 0, "use"), "often", "use 'often' is not usual or rare"),
        (("contacts", 0, "link"), "tail", "link 'tail' is missing"),
        (("contacts", 0, "link"), "", "link '' is missing"),
        (("springs", 0, "link_b"), "tail", "link 'tail' is missing"),
        (("links", 1, "joint", "kind"), "hinge", "joint kind 'hinge' is not one of"),
        # what mechanics cannot do
        (("links", 0, "mass"), -1.0, "mass is -1.0 kg, must not be negative"),
        (("links", 5, "mass"), 0.0, "neither it nor what hangs on it has mass"),
        (("links", 0, "inertia", 0, 1), 0.5, "inertia is not symmetric"),
        (("links", 0, "inertia"), [[-1, 0, 0], [0, 1, 0], [0, 0, 1]], "negative principal moment"),
        (("links", 1, "joint", "axes", 0), [1, 1, 0], "is not a unit vector"),
        (("links", 1, "joint", "limits", 0), [1, -1], "lower < upper"),
        (("links", 1, "joint", "kind"), "pin", "a pin joint has 1 axes, not 3"),
        (("links", 1, "joint", "limit_stiffness"), -1, "limit_stiffness is -1.0, must not be negative"),
        (("springs", 0, "damping"), -2, "damping is -2.0, must not be negative"),
        (("contacts", 0, "friction"), -0.1, "friction is -0.1, must not be negative"),
        (("contacts", 0, "radii"), [0.1, -0.1, 0.1], "must not be negative"),
        (("links", 1, "parent"), "link 4", "stands after it, or they form a loop"),
        (("links", 1, "parent"), "nobody", "parent 'nobody' is missing"),
        (("links", 1, "name"), "link 0", "this name is used twice"),
        (("links", 1, "joint", "name"), "joint 0", "joint name 'joint 0' is used twice"),
        (("links",), [], "needs at least one link"),
    ],
)
def test_what_cannot_be_a_body_is_refused_in_one_line(path: tuple[str | int, ...], value: Any, message: str):
    data = plain()
    put(*path, value=value)(data)
    assert message in refusal(data)


@pytest.mark.parametrize("data", [None, 5, "body", [1, 2]])
def test_a_body_is_a_table(data: Any):
    assert "body: expected a table" in refusal(data)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        (("links", 0, "name"), "name is missing"),
        (("links", 0, "joint"), "joint is missing"),
        (("links", 0, "mass"), "mass is missing"),
        (("links", 1, "joint", "kind"), "missing"),
        (("springs", 0, "stiffness"), "missing"),
        (("contacts", 0, "position"), "missing"),
    ],
)
def test_what_is_missing_is_named(path: tuple[str | int, ...], message: str):
    data = plain()
    at: Any = data
    for step in path[:-1]:
        at = at[step]
    del at[path[-1]]
    found = refusal(data)
    assert message in found
    assert str(path[-1]) in found


def test_a_free_joint_belongs_to_a_root():
    one = free_link(1.0, ((1, 0, 0), (0, 1, 0), (0, 0, 1)), ()).links[0]
    with pytest.raises(ModelError, match="a free joint belongs to a root"):
        Body(name="two", links=(one, replace(one, name="other", parent="link", joint=Joint("again", "free"))))


def test_a_massless_link_may_carry_others():
    empty = Link("gimbal", None, Joint("first", "pin", axes=((1.0, 0.0, 0.0),)), 0.0)
    bob = Link("bob", "gimbal", Joint("second", "pin", axes=((0.0, 1.0, 0.0),)), 1.0, com=(0.0, 0.0, -1.0))
    body = Body(name="two axes", links=(empty, bob))
    universal = Joint("both", "universal", axes=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    other = Body(name="one joint", links=(replace(bob, parent=None, joint=universal),))
    q, u, tau = np.array([[0.3, -0.4]]), np.array([[1.0, 2.0]]), np.array([[0.5, -0.5]])
    np.testing.assert_allclose(body.forward_dynamics(q, u, tau), other.forward_dynamics(q, u, tau), rtol=1e-12)


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.floats(allow_nan=True, allow_infinity=True),
    st.text(max_size=4),
    st.lists(st.floats(-2, 2), max_size=4),
    st.dictionaries(st.sampled_from(["name", "mass", "x"]), st.integers(0, 2), max_size=2),
)


def places(value: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Every place in nested tables and lists."""
    found = [path] if path else []
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, entry in entries:
        found += places(entry, (*path, key))
    return found


PLACES = places(plain())


@given(edits=st.lists(st.tuples(st.sampled_from(PLACES), JUNK), min_size=1, max_size=2))
@settings(max_examples=300, deadline=None)
def test_junk_anywhere_gives_a_body_or_one_line(edits: list[tuple[tuple[str | int, ...], Any]]):
    data = plain()
    for path, value in edits:
        try:
            put(*path, value=value)(data)
        except (KeyError, IndexError, TypeError):
            continue  # the edit before it has taken this place away
    made = body_or_message(data)
    if isinstance(made, str):
        assert len(made.splitlines()) == 1
    else:
        assert np.all(np.isfinite(made.q_reference))
        assert Body.from_dict(made.to_dict()) == made


def body_or_message(data: Any) -> Body | str:
    try:
        return Body.from_dict(data)
    except ModelError as error:
        return str(error)
