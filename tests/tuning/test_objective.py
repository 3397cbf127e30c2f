"""Objectives: formulas, moments, shapes, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from echelon.agents.characters import character_named
from echelon.agents.gymnasts.formulas import formula
from echelon.agents.gymnasts.gymnast import Gymnast
from echelon.agents.gymnasts.script import parse_script
from echelon.errors import InputError
from echelon.tuning.judging import Watched, cost, costs, successes
from echelon.tuning.objective import Condition, Objective, Stage, Term, load_objective, objective_names, parse_objective

STAGE = '[[stage]]\nname = "s"\ntune = ["bend"]\n'
TERM = '[[stage.term]]\nvalue = "knee"\n'


def test_formulas() -> None:
    numbers = {"vz": np.array([3.0, -1.0]), "h": 1.0}
    assert formula("x", "h + vz*vz/(2*10)").value(numbers) == pytest.approx([1.45, 1.05])
    assert formula("x", "-max(vz, 0, h)").value(numbers) == pytest.approx([-3.0, -1.0])
    assert formula("x", "sqrt(vz) + abs(-vz) + min(vz, pi)").value(numbers) == pytest.approx([3**0.5 + 6.0, 0.0])
    assert formula("x", "h + vz * vz - abs(com_x)").names == ("com_x", "h", "vz")
    assert np.isinf(formula("x", "vz / (h - 1)").value(numbers)).all()
    for text in (
        "",
        "1 +",
        "__import__('os')",
        "a.b",
        "x if y else z",
        "max(1)",
        "'text'",
        "x[0]",
        "lambda: 1",
        "2**9",
    ):
        with pytest.raises(InputError, match=r"row\.value = .*is no formula"):
            formula("row.value", text)


def watched() -> Watched:
    """Three gymnasts in four frames: one goes through a, b, c; one stays in a; one is in b at once and stays."""
    rows = np.array([[0, 0, 1], [1, 0, 1], [1, 0, 1], [2, 0, 1]])
    height = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [9.0, 1.0, 7.0], [0.5, 0.0, np.nan]])
    return Watched({"height": height}, {"mass": 2.0, "deep": np.array([1.0, 2.0, 3.0])}, rows, ("a", "b", "c"), 4)


@pytest.mark.parametrize(
    ("term", "values"),
    [
        (Term("height"), [0.5, 0.0, np.nan]),
        (Term("height", at="arrival", row="b"), [4.0, np.nan, 3.0]),
        (Term("height", at="leaving", row="b"), [9.0, np.nan, np.nan]),
        (Term("height", at="leaving", row="a"), [1.0, np.nan, np.nan]),
        (Term("height", at="time", time=0.5), [4.0, 5.0, 6.0]),
        (Term("height", at="time", time=2.0), [np.nan] * 3),
        (Term("height", at="most"), [9.0, 5.0, 7.0]),
        (Term("height", at="least", row="a"), [1.0, 0.0, np.nan]),
        (Term("height", at="mean", row="b"), [6.5, np.nan, 16.0 / 3.0]),
        (Term("mass * deep"), [2.0, 4.0, 6.0]),
        (Term("mass * deep", at="most"), [2.0, 4.0, 6.0]),
    ],
)
def test_moments(term: Term, values: list[float]) -> None:
    assert watched().value(term) == pytest.approx(values, nan_ok=True)


def test_shapes() -> None:
    values = np.array([1.0, 3.0, np.nan])
    big = 1e12
    assert cost(Term("x", target=1.0, scale=2.0, limit=big), values) == pytest.approx([0.0, 1.0, big])
    assert cost(Term("x", most=2.0, scale=0.5, weight=3.0, limit=big, missing=7.0), values) == pytest.approx(
        [0, 12, 21]
    )
    assert cost(Term("x", least=2.0, most=2.5, limit=big, missing=0.0), values) == pytest.approx([1.0, 0.25, 0.0])
    assert cost(Term("x", scale=0.5, limit=big, missing=5.0), values) == pytest.approx([2.0, 6.0, 5.0])
    # Bounded, smoothly and in order.
    steep = cost(Term("x", target=0.0, limit=10.0), np.array([0.1, 3.0, 100.0, 1000.0]))
    assert steep[0] == pytest.approx(0.01, rel=2e-3)
    assert (np.diff(steep) > 0.0).all()
    assert steep[-1] < 10.0


def test_what_varies_costs() -> None:
    # Three copies of one candidate, of heights 0.5, 0 and one that is nowhere; then each a candidate of its own.
    term = Term("height", target=0.25, spread=0.5, limit=1e12, missing=7.0, weight=2.0)
    shape = 2.0 * 0.25**2
    assert costs([term], watched(), 3)[0] == pytest.approx([shape + 0.5, shape + 0.5, 14.5])
    assert costs([term], watched(), 1)[0] == pytest.approx([shape, shape, 14.0])


def test_sums_and_successes() -> None:
    terms = [Term("height", at="arrival", row="b", target=4.0, missing=50.0), Term("mass")]
    assert costs(terms, watched())[0] == pytest.approx([0.0, 50.0, 1.0 / 1.01])
    conditions = [Condition("height", at="most", least=6.0), Condition("deep", most=2.0)]
    assert successes(conditions, watched()).tolist() == [True, False, False]
    assert successes([Condition("height", most=9.0)], watched()).tolist() == [True, True, False]
    assert successes([], watched()).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("title = 1", "title"),
        ("", "stage: is missing"),
        (STAGE, r"stage\[0\].term: is missing"),
        (STAGE + TERM + "color = 1", r"stage\[0\].term\[0\].color: unknown key"),
        (STAGE + TERM + "scale = 0", r"stage\[0\].term\[0\].scale = 0.*must be above 0"),
        (STAGE + TERM + 'at = "noon"', r"term\[0\].at = 'noon': must be one of"),
        (STAGE + TERM + 'at = "arrival"', r"term\[0\].row: is missing"),
        (STAGE + TERM + 'row = "a"', r"term\[0\].row = 'a': is not for at = 'end'"),
        (STAGE + TERM + 'at = "time"', r"term\[0\].time: is missing"),
        (STAGE + TERM + "time = 2.0", r"time = 2: is only for at = 'time'"),
        (STAGE + TERM + "target = 1\nmost = 2", r"a term has a target, or bounds, not both"),
        (STAGE + TERM + "least = 3\nmost = 2", r"least = 3: must be at most 2"),
        (STAGE + '[[stage.term]]\nvalue = "1 +"', r"stage\[0\].term\[0\].value = '1 \+': is no formula"),
        (STAGE + "failures = 1", r"stage\[0\].success: is missing"),
        (STAGE + "sigma = 2\n" + TERM, r"stage\[0\].sigma = 2.*at most 1"),
        (STAGE.replace('["bend"]', "[]") + TERM, r"stage\[0\].tune = \[\]: must name parameters"),
        (STAGE + TERM + '[[stage.success]]\nvalue = "fallen"', r"success\[0\].most: is missing"),
        ("stage = 3", "stage"),
        ("[[stage", "is not TOML"),
        ('source = "x"\n' + STAGE + TERM, "source: unknown key"),
    ],
)
def test_bad_objectives_are_one_line(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        parse_objective(text, "o.toml")
    assert str(caught.value).startswith("o.toml: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[[stage]]\nname = "s"\ntune = ["bent"]\n' + TERM,
            r"stage\[0\].tune: .* has no parameter 'bent'; did you mean 'bend'",
        ),
        ('[[stage]]\nname = "s"\ntune = ["free"]\n' + TERM, "needs `least` and `most`"),
        (STAGE + TERM.replace("knee", "kneee"), "'kneee' is unknown; did you mean 'knee'"),
        (STAGE + TERM + 'at = "arrival"\nrow = "stend"', "has no such row; did you mean 'stand'"),
    ],
)
def test_objectives_about_something_else_are_refused(text: str, message: str) -> None:
    script = parse_script(
        '[parameters]\nbend = { value = 0.8, least = 0.7, most = 0.9 }\nfree = 1.0\n[[row]]\nname = "stand"', "s.toml"
    )
    character = character_named("gymnast-male")
    assert isinstance(character, Gymnast)
    with pytest.raises(InputError, match=message):
        parse_objective(text, "o.toml").check(script, character)


def test_all_means_every_parameter_with_bounds() -> None:
    script = parse_script('[parameters]\na = { value = 1, least = 0, most = 2 }\nb = 1\n[[row]]\nname = "r"', "s.toml")
    objective = parse_objective(STAGE.replace('["bend"]', '"all"') + TERM, "o.toml")
    assert objective.stage[0].tuned(script) == ("a",)
    assert Objective(stage=(Stage("s", term=(Term("knee"),)),)).stage[0].tuned(script) == ("a",)


def test_those_that_ship_fit_their_scripts() -> None:
    from echelon.agents.gymnasts.script import load_script

    for name in objective_names():
        objective = load_objective(name)
        script = load_script(objective.script)
        character = character_named(f"gymnast-{script.body}")
        assert isinstance(character, Gymnast)
        objective.check(script, character)
        assert objective.script == name
