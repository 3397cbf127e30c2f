"""A tuned script's text: nothing changes but the numbers."""

from __future__ import annotations

import tomllib

import pytest

from echelon.errors import InputError
from echelon.tuning.tuned_script import with_values

TEXT = """\
# A comment.
body = "male"
name = "x"

[parameters]
plain = 0.5   # half
short = -5e-1
table = { about = "value = 3, they say", value = 1e-3, spread = 0.01 }
dotted.value = 2
dotted.least = 1

[parameters.own]
least = 1
value = +3.0  # three

[tuned]
body = "old"
seed = 4

[[row]]
name = "r"
body = "kept"
"""


def test_every_way_to_write_a_parameter() -> None:
    values = {"plain": 0.25, "short": 1e-07, "table": -4.5, "dotted": 2.125, "own": 33.0}
    data = TEXT.replace('about = "value = 3, they say", ', "")
    written = with_values(data, values, "female", {"seed": 5, "body": "new"})
    there = tomllib.loads(written)
    found = {name: p["value"] if isinstance(p, dict) else p for name, p in there["parameters"].items()}
    assert found == values
    assert there["body"] == "female"
    assert there["tuned"] == {"seed": 5, "body": "new"}
    assert there["row"] == tomllib.loads(data)["row"]
    for kept in ("# A comment.", "plain = 0.25   # half", "value = 33.0  # three", "spread = 0.01 }"):
        assert kept in written
    assert with_values(written, values, "female", {"seed": 5, "body": "new"}) == written


def test_what_cannot_be_replaced_is_refused_rather_than_spoilt() -> None:
    with pytest.raises(InputError, match=r"x.toml: parameters\.table stands where its value cannot be replaced"):
        with_values(TEXT, {"table": 2.0}, "male", {}, "x.toml")
    with pytest.raises(InputError, match=r"parameters\.a stands where"):
        with_values("parameters = { a = 1.0 }\n", {"a": 2.0}, "male", {})
