"""At most one person holds the handlebars, and who does is settled without races."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from echelon.errors import InputError
from echelon.play.web.people import People, Person


@pytest.fixture
def three() -> People:
    people = People()
    for number, name in ((1, "Anna"), (2, "Ben"), (3, "Cleo")):
        people.greet(number, name, viewer=10 + number)
    return people


def test_nobody_rides_at_first(three: People) -> None:
    assert three.rider is None
    assert three.everybody()[1] == Person(2, "Ben", 12, riding=False)
    assert all(three.may_direct(number) for number in (1, 2, 3))
    assert not three.may_direct(4)


def test_the_first_to_take_them_holds_them(three: People) -> None:
    assert three.take(2)
    assert not three.take(1)
    assert not three.take(2)
    assert [one.riding for one in three.everybody()] == [False, True, False]
    assert three.may_direct(2)
    assert not three.may_direct(1)


def test_only_the_holder_passes_them_on_and_only_to_somebody(three: People) -> None:
    assert not three.pass_on(1, to=2)
    three.take(1)
    assert not three.pass_on(2, to=3)
    assert not three.pass_on(1, to=1)
    assert not three.pass_on(1, to=9)
    assert three.pass_on(1, to=3)
    assert three.rider == 3


def test_whoever_leaves_leaves_them_free(three: People) -> None:
    three.take(2)
    assert not three.let_go(1)
    assert not three.farewell(1)
    assert three.rider == 2
    assert three.farewell(2)
    assert three.rider is None
    assert [one.id for one in three.everybody()] == [3]
    assert not three.farewell(2)
    assert three.take(3)
    assert three.let_go(3)


def test_a_stranger_takes_nothing(three: People) -> None:
    assert not three.take(7)
    assert three.rider is None


def test_nobody_speaks_for_the_page_of_another(three: People) -> None:
    with pytest.raises(InputError, match="viewer = 11, but that is the page of somebody else"):
        three.greet(2, "Ben", viewer=11)
    three.greet(2, "Benedikt", viewer=12)
    assert three.everybody()[1].name == "Benedikt"
    three.greet(2, "Ben", viewer=20)
    three.greet(4, "Dora", viewer=12)
    assert 4 in three


@given(st.lists(st.tuples(st.sampled_from("gftpl"), st.integers(1, 4), st.integers(1, 4)), max_size=60))
def test_never_two_and_never_somebody_gone(steps: list[tuple[str, int, int]]) -> None:
    people = People()
    for what, who, other in steps:
        before = people.rider
        if what == "g":
            people.greet(who, "x", viewer=who)
        elif what == "f":
            people.farewell(who)
        elif what == "t":
            people.take(who)
        elif what == "p":
            people.pass_on(who, to=other)
        else:
            people.let_go(who)
        riders = [one.id for one in people.everybody() if one.riding]
        assert riders == ([people.rider] if people.rider is not None else [])
        if before is not None and people.rider != before:
            assert who == before
