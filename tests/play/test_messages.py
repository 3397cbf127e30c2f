"""A page may say what the forms allow, and nothing else."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from echelon.errors import InputError
from echelon.play.web.inbox import CAPACITY, Inbox
from echelon.play.web.messages import (
    FORMS,
    LARGEST,
    ChangeView,
    Gear,
    Hello,
    LetGo,
    Look,
    Pass,
    Pause,
    Ping,
    Restart,
    Ride,
    Save,
    Seek,
    Slow,
    Take,
    read_message,
)

RIDE = {"kind": "ride", "pedal": 1, "brake": 0, "steer": -0.25, "lean": False}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"kind":"hello","viewer":3,"name":"Anna B."}', Hello(3, "Anna B.")),
        (json.dumps(RIDE), Ride(1, 0, -0.25, False)),
        ('{"kind":"gear","step":-1}', Gear(-1)),
        ('{"kind":"view","view":"saddle"}', ChangeView("saddle")),
        ('{"kind":"look","yaw":-3.14159,"pitch":1.5}', Look(-3.14159, 1.5)),
        ('{"kind":"take"}', Take()),
        ('{"kind":"pass","to":2}', Pass(2)),
        ('{"kind":"pause","paused":true}', Pause(True)),
        ('{"kind":"slow","rate":0.1}', Slow(0.1)),
        ('{"kind":"restart","seed":null,"agents":40}', Restart(None, 40)),
        ('{"kind":"save"}', Save()),
        ('{"kind":"seek","frame":0}', Seek(0)),
        ('{"at":12.5,"kind":"ping"}', Ping(12.5)),
    ],
)
def test_reads_what_is_right(text: str, message: object) -> None:
    assert read_message(text) == message
    assert read_message(text.encode()) == message


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"pedal": 1.01}, "pedal = 1.01, allowed is a number from 0 to 1"),
        ({"pedal": True}, "pedal = True"),
        ({"pedal": "1"}, "pedal = '1'"),
        ({"pedal": None}, "pedal = None"),
        ({"steer": -2}, "steer = -2"),
        ({"steer": 10**400}, "steer = 1000"),
        ({"lean": 0}, "lean = 0, allowed is true or false"),
        ({"extra": 1}, "unknown key 'extra'; known are pedal, brake, steer, lean"),
        ({"kind": "fly"}, "must be one of hello"),
        ({"kind": ["ride"]}, "message kind"),
        ({"kind": "gear"}, "unknown key"),
    ],
)
def test_refuses_a_wrong_value(change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        read_message(json.dumps({**RIDE, **change}))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    "text",
    [
        "",
        "ride",
        "[]",
        "3",
        "null",
        '{"kind":"ride","pedal":1,"brake":0,"steer":0}',
        '{"kind":"ride","pedal":NaN,"brake":0,"steer":0,"lean":false}',
        '{"kind":"ride","pedal":1e999,"brake":0,"steer":0,"lean":false}',
        '{"kind":"gear","step":1,"step":-1}',
        '{"kind":"gear","step":0}',
        '{"kind":"gear","step":1.0}',
        '{"kind":"rate","rate":0}',
        '{"kind":"rate","rate":-9}',
        '{"kind":"seek","frame":-1}',
        '{"kind":"seek","frame":1.5}',
        '{"kind":"hello","viewer":0,"name":""}',
        '{"kind":"hello","viewer":0,"name":" "}',
        '{"kind":"hello","viewer":0,"name":"a\\u202eb"}',
        '{"kind":"hello","viewer":0,"name":"a\\nb"}',
        '{"kind":"hello","viewer":0,"name":"\\ud800"}',
        json.dumps({"kind": "hello", "viewer": 0, "name": "a" * 25}),
        "[" * 2000,
        '{"kind":"take","pad":"' + "a" * LARGEST + '"}',
        '{"kind":"pass","to":' + "9" * 2000 + "}",
    ],
)
def test_refuses_in_one_line(text: str) -> None:
    with pytest.raises(InputError) as caught:
        read_message(text)
    assert "\n" not in str(caught.value)


@given(
    st.dictionaries(
        st.sampled_from(["kind", *RIDE, "step", "view"]),
        st.one_of(st.sampled_from([*FORMS]), st.floats(), st.none(), st.booleans(), st.integers()),
    )
)
def test_whatever_comes_is_read_or_refused(data: dict[str, Any]) -> None:
    try:
        message = read_message(json.dumps(data))
    except InputError:
        return
    assert isinstance(message, FORMS[data["kind"]][0])


@given(st.binary(max_size=200))
def test_bytes_are_read_or_refused(data: bytes) -> None:
    with pytest.raises(InputError):
        read_message(data)


# ---- the box between front and loop --------------------------------------------------------------------------------
def test_the_newest_ride_takes_the_place_of_the_older() -> None:
    inbox = Inbox()
    old, new = Ride(1, 0, 0, False), Ride(0, 1, 0, False)
    inbox.put(1, old)
    inbox.put(1, Gear(1))
    inbox.put(2, old)
    inbox.put(1, new)
    assert inbox.take() == [(1, Gear(1)), (2, old), (1, new)]
    assert inbox.take() == []


def test_letting_go_ends_a_ride_that_waits() -> None:
    inbox = Inbox()
    inbox.put(1, Ride(1, 0, 0, False))
    inbox.put(1, LetGo())
    assert inbox.take() == [(1, LetGo())]


def test_a_loop_that_stands_still_costs_no_memory() -> None:
    inbox = Inbox()
    kept = [inbox.put(1, Gear(1)) for _ in range(3 * CAPACITY)]
    for number in range(1000):
        inbox.put(1, Look(number / 1000, 0))
    waiting = inbox.take()
    assert kept.count(True) == CAPACITY
    assert len(waiting) == CAPACITY + 1
    assert waiting[-1] == (1, Look(0.999, 0))
    assert inbox.put(1, Gear(1))


def test_who_is_gone_looks_nowhere() -> None:
    inbox = Inbox()
    inbox.put(1, Look(1, 0))
    inbox.put(1, Pause(True))
    inbox.put(2, Look(0.5, 0))
    inbox.put(1, Save())
    inbox.forget(1)
    assert inbox.take() == [(2, Look(0.5, 0)), (1, Save())]
