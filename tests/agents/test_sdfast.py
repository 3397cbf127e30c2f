"""SD/FAST system descriptions: what is read, what is refused and how, and that writing and reading undo each other."""

from __future__ import annotations

import re
import string
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from echelon.agents.sdfast import describe_sdfast, parse_sdfast, read_sdfast
from echelon.errors import InputError
from echelon.warp_kernels.model import Joint, Link, Model

# In the manner of the published files: the first body is free without saying so, keys in mixed case, the inertia's
# rows torn apart, user constraints at the end.
PUBLISHED_STYLE = """
# creature
gravity = 0.0 0.0 -9.80665000
# with joint ROOT
body = PELVIS
mass = 10.0
inertia = 0.08 0.07 0.10
#printing tree-joint body : CHEST
body = CHEST inboard = PELVIS joint = gimbal
mass = 4.0
inertia = 0.024 0.00004 0.0003
?
0.016 -0.00001
?
?
0.034
bodyToJoint = -0.008 -0.0003 -0.05
inbToJoint = 0.007 -0.0004 0.07
pin = 1.0 0.0 0.0
pin = 0.0 1.0 0.0
pin = 0.0 0.0 1.0
body = THIGH inboard = PELVIS joint = pin
mass = 5.0  inertia = 0.1 0.1 0.02
bodyToJoint = 0 0 0.2  inbToJoint = 0 -0.1 -0.06
pin = 0.0 1.0 0.0
body = SHIN inboard = THIGH joint = pin
mass = 3.0  inertia = 0.05 0.05 0.01
bodyToJoint = 0.01 0 0.19  inbToJoint = -0.012 0 -0.24
pin = 0.0 1.0 0.0
#loop joint section
constraints = 12
"""

EVERY_JOINT = """
Gravity = 0 0 -9.8     ! each joint once, and the other spellings
language = c  prefix = man_  double  stabvel = 0?
body=base inb=$GROUND joint=sixdof jname=root
  mass = 3?  inertia = .3 .2 .1
body=a inb=base joint=u-joint  mass=1 inertia=1 1 1 btj=0 0 .1 itj=0 0 -.1  pins=1 0 0 pin=0 1 0
body=b inb=BASE joint=3d prescribed=0? 1 ?
  mass=1e0 inertia=1 1. 1 bodytojoint=0 0 .1 inboardtojoint=.5 +0 -1E-1 inbpin=1 0 0 pin=0 2 0 pin=0 0 -3
body=c inb=b joint=ball prescribed mass=1 inertia=1 1 1 btj=0 0 .1 itj=0 0 -.1
body=d inb=c joint=sliding mass=1 inertia=1 1 1 btj=0 0 0 itj=0 0 -.1 pin=3 0 4
body=e inb=$ground joint=pin mass=1 inertia=1 1 1 btj=0 0 .1 itj=0 2 -.1 pin=1 1 1
constraint = touch  type = user
"""


# ---- what is read ----------------------------------------------------------------------------------------------------
def test_link_frames_stand_at_the_inboard_joints():
    model = parse_sdfast(PUBLISHED_STYLE, name="creature")
    assert model.name == "creature"
    assert model.link_names == ("PELVIS", "CHEST", "THIGH", "SHIN")
    assert model.parents == (-1, 0, 0, 2)
    assert [link.joint.kind for link in model.links] == ["free", "gimbal", "pin", "pin"]
    chest, thigh, shin = model.links[1:]
    assert chest.com == (0.008, 0.0003, 0.05)
    assert chest.joint.position == (0.007, -0.0004, 0.07)
    assert thigh.com == (0.0, 0.0, -0.2)
    # The thigh's own origin is 0.2 m above its centre of mass, from which the file counts.
    np.testing.assert_allclose(shin.joint.position, (-0.012, 0.0, -0.44), rtol=0, atol=1e-16)
    assert model.gravity == 9.80665
    assert model.mass == 22.0


def test_a_question_mark_in_the_inertia_means_by_symmetry():
    inertia = parse_sdfast(PUBLISHED_STYLE).links[1].inertia
    assert inertia == ((0.024, 0.00004, 0.0003), (0.00004, 0.016, -0.00001), (0.0003, -0.00001, 0.034))
    lower = PUBLISHED_STYLE.replace("0.00004 0.0003\n?\n0.016 -0.00001\n?\n?", "? ? 0.00004 0.016 ? 0.0003 -0.00001")
    assert parse_sdfast(lower).links[1].inertia == inertia


def test_every_joint_and_every_spelling():
    model = parse_sdfast(EVERY_JOINT)
    kinds = [link.joint.kind for link in model.links]
    assert kinds == ["free", "universal", "gimbal", "ball", "slider", "pin"]
    assert model.parents == (-1, 0, 0, 2, 3, -1)
    assert model.links[0].joint.name == "root"
    assert model.links[0].mass == 3.0
    assert model.links[2].joint.axes == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0))
    assert model.links[2].joint.position == (0.5, 0.0, -0.1)
    np.testing.assert_allclose(model.links[4].joint.axes, [(0.6, 0.0, 0.8)], rtol=1e-15)
    np.testing.assert_allclose(model.links[5].joint.axes, [(3**-0.5,) * 3], rtol=1e-15)


def test_a_body_may_stand_on_one_line_or_on_many():
    words = PUBLISHED_STYLE.split("# with joint ROOT")[1].split()
    flat = " ".join(re.sub(r"#.*", "", PUBLISHED_STYLE).split())
    torn = "\n".join(re.sub(r"#.*", "", PUBLISHED_STYLE).replace("=", " = ").split())
    assert words  # the marker above is in the text
    assert parse_sdfast(flat) == parse_sdfast(torn) == parse_sdfast(PUBLISHED_STYLE.replace("\n", "\r\n"))
    assert parse_sdfast(flat) == parse_sdfast(PUBLISHED_STYLE)


@pytest.mark.parametrize("gravity", ["0 -9.8 0", "0 9.8 0", "9.8 0 0", "-9.8 0 0", "0 0 9.8", "1 2 3", "-3 0.5 0.1"])
def test_gravity_another_way_turns_the_whole_system(gravity: str):
    upright = parse_sdfast(PUBLISHED_STYLE)
    turned = parse_sdfast(PUBLISHED_STYLE.replace("0.0 0.0 -9.80665000", gravity))
    down = np.array([float(word) for word in gravity.split()])
    assert turned.gravity == pytest.approx(float(np.linalg.norm(down)), rel=1e-15)
    for before, after in zip(upright.links, turned.links, strict=True):
        # What gravity sees of each link stays: arms along it, lengths, moments about it.
        direction = down / np.linalg.norm(down)
        for old, new in ((before.com, after.com), (before.joint.position, after.joint.position)):
            assert np.dot(new, (0.0, 0.0, -1.0)) == pytest.approx(float(np.dot(old, direction)), abs=1e-15)
            assert np.linalg.norm(new) == pytest.approx(float(np.linalg.norm(old)), abs=1e-15)
        old_inertia, new_inertia = np.array(before.inertia), np.array(after.inertia)
        assert new_inertia[2, 2] == pytest.approx(direction @ old_inertia @ direction, rel=1e-12)
        np.testing.assert_allclose(np.linalg.eigvalsh(new_inertia), np.linalg.eigvalsh(old_inertia), rtol=1e-12)
        # And handedness: a mirrored system would pass all of the above.
        old_triple = np.cross(before.com, before.joint.position) @ down / np.linalg.norm(down)
        new_triple = np.cross(after.com, after.joint.position) @ (0.0, 0.0, -1.0)
        assert new_triple == pytest.approx(float(old_triple), abs=1e-15)


def test_joints_without_a_name_have_their_bodys():
    model = parse_sdfast(EVERY_JOINT.replace("jname=root", "jname=A"))
    assert [link.joint.name for link in model.links] == ["A", "a_joint", "b", "c", "d", "e"]


def test_without_gravity_there_is_none():
    assert parse_sdfast(re.sub("gravity = .*", "", PUBLISHED_STYLE)).gravity == 0.0


def test_a_file_gives_its_name_to_the_body(tmp_path: Path):
    path = tmp_path / "walker.sd"
    path.write_text(PUBLISHED_STYLE)
    assert read_sdfast(path) == parse_sdfast(PUBLISHED_STYLE, name="walker")


# ---- writing ---------------------------------------------------------------------------------------------------------
def _dynamics(model: Model) -> list[tuple[object, ...]]:
    return [(link.name, link.parent, link.joint.name, link.joint.kind) for link in model.links]


def assert_same_dynamics(one: Model, other: Model, atol: float = 1e-14) -> None:
    """Same tree, joints and inertias, but for visuals, sites and rounding."""
    assert _dynamics(one) == _dynamics(other)
    assert one.gravity == pytest.approx(other.gravity, rel=1e-14)
    for a, b in zip(one.links, other.links, strict=True):
        assert a.mass == pytest.approx(b.mass, rel=1e-14)
        np.testing.assert_allclose(a.com, b.com, rtol=1e-14, atol=atol)
        np.testing.assert_allclose(a.inertia, b.inertia, rtol=1e-14, atol=atol)
        np.testing.assert_allclose(a.joint.position, b.joint.position, rtol=1e-14, atol=atol)
        np.testing.assert_allclose(a.joint.axes, b.joint.axes, rtol=1e-14, atol=atol)


@pytest.mark.parametrize("text", [PUBLISHED_STYLE, EVERY_JOINT])
def test_what_is_written_is_read_back(text: str):
    model = parse_sdfast(text)
    assert_same_dynamics(parse_sdfast(describe_sdfast(model)), model)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_random_trees_survive_writing_and_reading(seed: int):
    model = random_tree(np.random.default_rng(seed))
    assert_same_dynamics(parse_sdfast(describe_sdfast(model)), model)


def random_tree(rng: np.random.Generator) -> Model:
    """A tree of one to eight links with any joints, oblique axes and full inertias."""
    axis_count = {"free": 0, "ball": 0, "pin": 1, "universal": 2, "gimbal": 3, "slider": 1}
    links: list[Link] = []
    for index in range(int(rng.integers(1, 9))):
        parent = None if index == 0 else int(rng.integers(-1, index))
        root = parent is None or parent < 0
        kind = str(rng.choice(list(axis_count) if root else list(axis_count)[1:]))
        axes = rng.normal(size=(axis_count[kind], 3))
        points = rng.normal(size=(6, 3))
        inertia = sum(np.eye(3) * (p @ p) - np.outer(p, p) for p in points)
        links.append(
            Link(
                name=f"link{index}",
                parent=None if root else f"link{parent}",
                joint=Joint(
                    name=f"joint{index}",
                    kind=kind,  # type: ignore[arg-type]
                    position=tuple(rng.normal(size=3).tolist()),
                    axes=tuple(tuple((axis / np.linalg.norm(axis)).tolist()) for axis in axes),
                ),
                mass=float(rng.uniform(0.1, 10.0)),
                com=tuple(rng.normal(size=3).tolist()),
                inertia=tuple(tuple(row) for row in np.asarray(inertia).tolist()),  # type: ignore[arg-type]
            )
        )
    return Model(name="random", links=tuple(links), gravity=float(rng.uniform(0.0, 20.0)))


@pytest.mark.parametrize("name", ["two words", "9lives", "a=b", "why!", "#1", "$ground", "", "-x", "bell\x07"])
def test_a_name_that_sdfast_cannot_read_is_not_written(name: str):
    model = parse_sdfast(PUBLISHED_STYLE)
    links = (replace(model.links[0], name=name),)
    with pytest.raises(InputError, match="link"):
        describe_sdfast(Model(name="odd", links=links))


def test_names_that_differ_only_in_case_are_not_written():
    first = parse_sdfast(PUBLISHED_STYLE).links[0]
    other = replace(first, name="pelvis", joint=replace(first.joint, name="other"))
    with pytest.raises(InputError, match="stands twice"):
        describe_sdfast(Model(name="odd", links=(first, other)))


# ---- what is refused -------------------------------------------------------------------------------------------------
ONE = "body = a mass = 1 inertia = 1 1 1\n"
SECOND = "body = b inb = a joint = pin mass = 1 inertia = 1 1 1 btj = 0 0 1 itj = 0 0 -1 pin = 0 1 0\n"

REFUSED = {
    "loop by a second paragraph": (ONE + SECOND + "body = B inb = a joint = pin", "line 3: body = 'B'", "loop"),
    "loop of two": (ONE + SECOND.replace("inb = a", "inb = c") + SECOND.replace("= b", "= c").replace("= a", "= b"),
                    "line 2: inb = 'c'", "loop"),
    "its own parent": (ONE + SECOND.replace("inb = a", "inb = b"), "line 2: inb = 'b'", "loop"),
    "missing parent": (ONE + SECOND.replace("inb = a", "inb = nobody"), "line 2: inb = 'nobody'", "no such body"),
    "duplicate": (ONE + ONE, "line 2: body = 'a'", "second time"),
    "parent left out": (ONE + SECOND.replace("inb = a", ""), "line 2: body = 'b'", "inboard is missing"),
    "joint left out": (ONE + SECOND.replace("joint = pin", ""), "line 2: body = 'b'", "joint is missing"),
    "missing mass": ("body = a\ninertia = 1 1 1", "line 1: body = 'a'", "mass is missing"),
    "missing inertia": ("body = a\nmass = 1", "line 1: body = 'a'", "inertia is missing"),
    "missing vector": (ONE + SECOND.replace("itj = 0 0 -1", ""), "line 2: body = 'b'", "inbtojoint is missing"),
    "NaN mass": ("body = a\n\nmass = nan inertia = 1 1 1", "line 3: mass = 'nan'", "finite"),
    "NaN vector": (ONE + SECOND.replace("0 0 -1", "0 NaN -1"), "line 2: inbtojoint = 'NaN'", "finite"),
    "infinite": ("gravity = 0 0 -inf\n" + ONE, "line 1: gravity = '-inf'", "finite"),
    "too large": (ONE.replace("mass = 1", "mass = 1e999"), "line 1: mass = '1e999'", "too large"),
    "hexadecimal": (ONE.replace("mass = 1", "mass = 0x10"), "line 1: mass = '0x10'", "finite number"),
    "comma": (ONE.replace("1 1 1", "1, 1, 1"), "line 1: inertia = '1,'", "finite number"),
    "a lone ?": (ONE.replace("mass = 1", "mass = ?"), "line 1: mass = '?'", "no value"),
    "inertia all ?": (ONE.replace("1 1 1", "1 ? ? ? 1 ? ? ? 1"), "line 1: inertia = '1 ? ? ? 1 ? ? ? 1'", "other side"),
    "negative mass": (ONE.replace("mass = 1", "mass = -1"), "line 1: mass = -1", "negative"),
    "six inertias": (ONE.replace("1 1 1", "1 1 1 0 0 0"), "line 1: inertia = '1 1 1 0 0 0'", "3 or 9"),
    "asymmetric": (ONE.replace("1 1 1", "1 .1 0 .2 1 0 0 0 1"), "line 1: inertia", "symmetric"),
    "negative moment": (ONE.replace("1 1 1", "1 1 -1"), "line 1: inertia = '1 1 -1'", "negative principal moment"),
    "unknown key": (ONE + "inertai = 1 1 1", "line 2: inertai", "did you mean 'inertia'?"),
    "unknown word": ("xyzzy\n" + ONE, "line 1: xyzzy", "known are"),
    "stray word": (ONE + "xyzzy", "line 2: inertia = 'xyzzy'", "not a finite number"),
    "key twice": (ONE + "mass = 2", "line 2: mass", "already, on line 1"),
    "gravity twice": ("gravity = 0 0 -9\ngravity = 0 0 -9\n" + ONE, "line 2: gravity", "twice"),
    "no equals sign": (ONE + "body b", "line 2: body", "equals sign must follow"),
    "two equals signs": ("body = a mass = = 1", "line 1: mass = '='", "too many"),
    "no value": ("body = a mass =", "line 1: mass", "no value"),
    "no name": ("body =", "line 1: body", "no value"),
    "number for a name": ("body = 3d", "line 1: body = '3d'", "no name"),
    "two numbers": (ONE + SECOND.replace("0 0 -1", "0 -1"), "line 2: inbtojoint = '0 -1'", "has 2 numbers, needs 3"),
    "four numbers": (ONE + SECOND.replace("0 0 -1", "0 0 -1 2"), "line 2: inbtojoint", "has 4 numbers, needs 3"),
    "no pin": (ONE + SECOND.replace("pin = 0 1 0", ""), "line 2: pin", "0 pins, a pin joint needs 1"),
    "two pins": (ONE + SECOND + "pin = 1 0 0", "line 3: pin", "2 pins, a pin joint needs 1"),
    "no direction": (ONE + SECOND.replace("0 1 0", "0 0 0"), "line 2: pin = '0 0 0'", "no direction"),
    "unknown joint": (ONE + SECOND.replace("pin mass", "hinge mass"), "line 2: joint = 'hinge'", "is no joint"),
    "a second free body": (ONE + SECOND.replace("joint = pin", "joint = free"), "line 2: joint = 'free'", "$ground"),
    "prescribed by 2": (ONE + SECOND + "prescribed = 2", "line 3: prescribed = '2'", "allowed are 0, 1 and ?"),
    "joint name twice": (ONE + "jname = x\n" + SECOND + "jname = X", "line 4: jname = 'X'", "another joint's"),
    "mass before a body": ("mass = 1\n" + ONE, "line 1: mass", "belongs to a body"),
    "mass after constraints": (ONE + "constraints = 2\nmass = 1", "line 3: mass", "before any constraint"),
    "body after constraints": (ONE + "constraints = 2\n" + SECOND, "line 3: body = 'b'", "bodies come first"),
    "constraints first": ("constraints = 2\n" + ONE, "line 1: constraints", "before the bodies"),
    "half a constraint": (ONE + "constraints = 0.5", "line 2: constraints = 0.5", "whole number"),
    "gear": (ONE + "constraint = g type = gear", "line 2: type = 'gear'", "not supported"),
    "point": (ONE + "constraint = g type = user point = a 0 0 0", "line 2: point", "not supported"),
    "loop pin": (ONE + SECOND + "bodypin = 1 0 0", "line 3: bodypin", "not supported"),
    "ground as a body": ("body = $Ground mass = 1", "line 1: body = '$Ground'", "the world itself"),
    "massless": (ONE.replace("mass = 1", "mass = 0"), "link 'a'", "has mass"),
    "nothing": ("# only words\n", "there is no body", "body = NAME"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_in_one_clear_line(case: str):
    text, where, why = REFUSED[case]
    with pytest.raises(InputError) as caught:
        parse_sdfast(text, source="robot.sd")
    message = str(caught.value)
    assert message.startswith("robot.sd")
    assert where in message
    assert why in message
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize(
    "word", ["weld", "planar", "cylinder", "Cylindrical", "BUSHING", "bearing", "rplanar", "rsixdof", "rbearing"]
)
def test_joints_that_echelon_does_not_have(word: str):
    with pytest.raises(
        InputError, match=rf"line 2: joint = '{word}': is not supported; allowed are pin, ujoint, gimbal"
    ):
        parse_sdfast(ONE + SECOND.replace("joint = pin", f"joint = {word}"))


def test_files_that_cannot_be_read(tmp_path: Path):
    for path in (tmp_path, tmp_path / "absent.sd", tmp_path / "nul\0byte.sd"):
        with pytest.raises(InputError, match="cannot be read"):
            read_sdfast(path)
    garbage = tmp_path / "garbage.sd"
    garbage.write_bytes(np.random.default_rng(0).bytes(4000))
    with pytest.raises(InputError):
        read_sdfast(garbage)


# ---- properties ------------------------------------------------------------------------------------------------------
# fmt: off
NASTY_WORDS = [
    "nan", "inf", "-inf", "1e999", "-1e308", "5e-324", "1e30", "-0", "0", "?", "1?", "??", "-?", "=", "==", "#", "!",
    "body", "inb", "joint", "jname", "mass", "inertia", "pin", "btj", "itj", "prescribed", "gravity",
    "constraints", "constraint", "type", "user", "gear", "$ground", "free", "ball", "gimbal", "slider", "weld",
    "PELVIS", "CHEST", "SHIN", "0x1", "1_000", "\u0663", "1e", "1.e5", ".5", ".", "+", "-", "--1",
    "\x00", "\x85", "\u2028", "\ufffd", "\u00e9", "9" * 5000,
]
# fmt: on


@st.composite
def mutated_descriptions(draw: st.DrawFn) -> str:
    """A valid description with a few words or characters replaced, removed, doubled, swapped or put in."""
    words = re.findall(r"\s+|=|[^\s=]+", draw(st.sampled_from([PUBLISHED_STYLE, EVERY_JOINT])))
    for _ in range(draw(st.integers(1, 5))):
        place = draw(st.integers(0, len(words) - 1))
        match draw(st.sampled_from(["replace", "remove", "double", "swap", "insert", "character", "cut"])):
            case "replace":
                words[place] = draw(st.sampled_from(NASTY_WORDS))
            case "remove":
                words[place] = ""
            case "double":
                words.insert(place, f"{words[place]} ")
            case "swap":
                other = draw(st.integers(0, len(words) - 1))
                words[place], words[other] = words[other], words[place]
            case "insert":
                words.insert(place, f" {draw(st.sampled_from(NASTY_WORDS))} ")
            case "character":
                at = draw(st.integers(0, len(words[place])))
                character = draw(st.one_of(st.sampled_from(string.printable), st.characters()))
                words[place] = words[place][:at] + character + words[place][at + 1 :]
            case _:
                words = words[: place + 1]
    return "".join(words)


def assert_body_or_one_line(text: str) -> None:
    result = body_or_message(text)
    if isinstance(result, Model):
        assert result.links
        assert np.all(np.isfinite(result.q_reference))
        assert len(parse_sdfast(describe_sdfast(result)).links) == len(result.links)
    else:
        assert result.startswith("robot.sd")
        assert len(result.splitlines()) == 1


def body_or_message(text: str) -> Model | str:
    try:
        return parse_sdfast(text, source="robot.sd")
    except InputError as error:
        return str(error)


@given(text=mutated_descriptions())
@settings(max_examples=400, deadline=None)
def test_a_broken_description_gives_a_body_or_one_line(text: str):
    assert_body_or_one_line(text)


@given(words=st.lists(st.sampled_from(NASTY_WORDS), max_size=40), separator=st.sampled_from([" ", "\n", " = "]))
@settings(max_examples=200, deadline=None)
def test_a_heap_of_words_gives_a_body_or_one_line(words: list[str], separator: str):
    assert_body_or_one_line(separator.join(words))


@given(text=st.text(max_size=200))
@settings(max_examples=100, deadline=None)
def test_any_text_gives_a_body_or_one_line(text: str):
    assert_body_or_one_line(text)
