"""Bodies from SD/FAST system descriptions, and back.

SD/FAST was the program that wrote the equations of motion for the papers Echelon follows; its input files are the form
in which those bodies were published. A description is free text: words, ``=`` and numbers, spread over lines as one
likes, case ignored, comments from ``#`` or ``!`` to the end of the line::

    gravity = 0 0 -9.80665

    body = trunk  inb = $ground  joint = free
      mass = 30   inertia = 1.2 1.1 0.4
      bodytojoint = 0 0 0   inbtojoint = 0 0 1
      pin = 1 0 0   pin = 0 1 0   pin = 0 0 1

    body = thigh  inb = trunk  joint = ujoint  jname = hip
      mass = 8   inertia = 0.12  0.001 0      # a whole matrix; ? stands for "as on the other side of the diagonal"
                           ?     0.12  0
                           ?     ?     0.02
      bodytojoint = 0 0 0.2   inbtojoint = 0 0.1 -0.2
      pin = 0 1 0   pin = 1 0 0

How it is read
--------------
* SD/FAST puts a body's origin at its centre of mass, Echelon a link's at its inboard joint. With ``b`` for a body and
  ``p`` for its parent: ``com(b) = -bodytojoint(b)``, ``position(b) = inbtojoint(b) - bodytojoint(p)``. Axes are the
  same: in the reference pose all frames are parallel to the world's. Inertia is the matrix itself, about the centre of
  mass, so off-diagonal numbers are not negated.
* The first body may leave out ``inb`` and ``joint``: it is then free. ``pin`` axes are made unit length; a free
  joint's only name axes for coordinates, and Echelon's are the world's. A joint without ``jname`` has its body's name.
* Gravity that points another way than -z turns the whole system so that it points along -z.
* ``0.5?`` is 0.5 (SD/FAST lets a program change it later); a lone ``?`` off the inertia's diagonal has no value.
* ``prescribed`` marks joints whose motion a program may impose. It takes away no coordinate, and here joints are
  driven by torques, so it is read and left out.
* User constraints (``constraints = 12`` of the published bodies) are places for a program's own equations, there the
  feet on the ground. Echelon makes those forces by contact, so they are read and left out.
* ``language``, ``prefix``, ``single``, ``double``, ``grounded``, ``stabvel`` and ``stabpos`` steer SD/FAST itself.

Closed loops, the constraints gear, screw, distance, perpendicular and coordinate, and the joints weld, planar,
cylinder, bushing and bearing are refused: Echelon's bodies are trees of the joints in `echelon.warp_kernels.model`.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np

from echelon.errors import InputError
from echelon.warp_kernels.model import AXIS_COUNT, Joint, JointKind, Link, Matrix3, Model, ModelError, Vec3

LARGEST_NUMBER = 1e30  # beyond it products overflow, and no body is made of such numbers

JOINT_KINDS: dict[str, JointKind] = {
    "pin": "pin",
    "1d": "pin",
    "ujoint": "universal",
    "u-joint": "universal",
    "u": "universal",
    "universal": "universal",
    "2d": "universal",
    "gimbal": "gimbal",
    "3d": "gimbal",
    "ball": "ball",
    "slider": "slider",
    "sliding": "slider",
    "free": "free",
    "sixdof": "free",
    "6d": "free",
}
# fmt: off
UNSUPPORTED_JOINTS = ("weld", "planar", "cylinder", "cylindrical", "bushing", "bearing",
                      "rplanar", "rsixdof", "rfree", "rbushing", "rbearing")
# fmt: on

_SYNONYMS = {
    "inb": "inboard",
    "btj": "bodytojoint",
    "itj": "inbtojoint",
    "inboardtojoint": "inbtojoint",
    "pins": "pin",
    "inbpin": "pin",
    "inboardpin": "pin",
}
_BODY_KEYS = ("inboard", "joint", "jname", "mass", "inertia", "bodytojoint", "inbtojoint", "pin", "prescribed")
_SYSTEM_KEYS = ("gravity", "language", "prefix", "single", "double", "grounded", "stabvel", "stabpos")
_CONSTRAINT_KEYS = ("constraint", "constraints", "type")
_LOOP_KEYS = ("bodypin", "bodyref", "inbref", "inboardref")
_EXPLICIT_CONSTRAINT_KEYS = ("point", "vector", "scalar")
_BARE_KEYS = ("prescribed", "single", "double", "grounded")
_KEYS = frozenset(
    ("body", *_BODY_KEYS, *_SYSTEM_KEYS, *_CONSTRAINT_KEYS, *_LOOP_KEYS, *_EXPLICIT_CONSTRAINT_KEYS, *_SYNONYMS)
)
_GROUND = "$ground"
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?\??")
_NAME = re.compile(r"[^\s=#!?0-9+.-][^\s=#!]*")


# ---- the public face -------------------------------------------------------------------------------------------------
def read_sdfast(path: str | Path) -> Model:
    """Read a body from a file with an SD/FAST system description; its name is the file's, without the ending.

    Raises InputError with one line naming file, line, key and value when the file cannot be read or is no such tree.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8", errors="replace")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path}: cannot be read: {reason}") from None
    return parse_sdfast(text, source=str(path), name=path.stem)


def parse_sdfast(text: str, *, source: str = "SD/FAST description", name: str = "body") -> Model:
    """Build a body from the text of an SD/FAST system description.

    Args:
        text: The description; see this module's text for what is understood.
        source: What to call it in messages, usually the file.
        name: Name of the body.

    Raises:
        InputError: One line naming source, line, key, value and what is allowed.
    """
    return _Parser(text, source).model(name)


def describe_sdfast(model: Model) -> str:
    """Write a body as an SD/FAST system description that `parse_sdfast` reads back, numbers to 15 digits.

    Links, joints, masses and gravity are written. What SD/FAST has no words for is not: joint limits, springs, contact
    sites, visuals. Raises InputError when a name cannot be an SD/FAST name.
    """
    _check_names(model)
    lines = [f"# {model.name}", "", f"gravity = {_numbers((0.0, 0.0, -model.gravity))}"]
    coms = {link.name: np.array(link.com) for link in model.links}
    for link in model.links:
        joint = link.joint
        parent_com = coms[link.parent] if link.parent is not None else np.zeros(3)
        kind = "ujoint" if joint.kind == "universal" else joint.kind
        axes = np.eye(3) if joint.kind == "free" else joint.axes
        lines += ["", f"body = {link.name}  inb = {link.parent or _GROUND}  joint = {kind}  jname = {joint.name}"]
        lines += [f"  mass = {_numbers((link.mass,))}"]
        lines += [f"  inertia = {row}" if i == 0 else f"            {row}" for i, row in enumerate(_inertia_rows(link))]
        lines += [f"  bodytojoint = {_numbers(0.0 - coms[link.name])}"]
        # Both are some decimals of a metre; their sum is rounded where the binary of one no longer holds the other's.
        lines += [f"  inbtojoint = {_numbers(np.round(np.array(joint.position) - parent_com, 14))}"]
        lines += [f"  pin = {_numbers(axis)}" for axis in axes]
    return "\n".join(lines) + "\n"


# ---- reading ---------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Token:
    text: str
    line: int


@dataclass
class _Paragraph:
    """What the file says about one body; `lines` holds where each key stands."""

    name: str
    line: int
    inboard: str | None = None
    kind: JointKind | None = None
    joint_name: str | None = None
    mass: float = 0.0
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    body_to_joint: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inboard_to_joint: np.ndarray = field(default_factory=lambda: np.zeros(3))
    pins: list[np.ndarray] = field(default_factory=list)
    lines: dict[str, int] = field(default_factory=dict)


class _Parser:
    """Reads one description from front to back; every method that finds fault raises InputError."""

    def __init__(self, text: str, source: str) -> None:
        self.source = source
        self.tokens = [
            _Token(word, number)
            for number, line in enumerate(re.split("\r\n|\r|\n", text), start=1)
            for word in re.findall(r"=|[^\s=]+", re.split(r"[#!]", line, maxsplit=1)[0])
        ]
        self.position = 0
        self.gravity: np.ndarray | None = None
        self.bodies: list[_Paragraph] = []
        self.by_name: dict[str, _Paragraph] = {}  # by lower-case name, as SD/FAST compares them
        self.joint_names: set[str] = set()
        self.in_constraints = False

    def model(self, name: str) -> Model:
        while self.position < len(self.tokens):
            self._statement()
        if not self.bodies:
            raise InputError(f"{self.source}: there is no body; write body = NAME, then its mass, inertia and joint")
        self._complete_first_body()
        for body in self.bodies:
            self._check_complete(body)
        turn, strength = _turn_to_minus_z(np.zeros(3) if self.gravity is None else self.gravity)
        links = tuple(self._link(body, turn) for body in self.bodies)
        try:
            return Model(name=name, links=links, gravity=strength)
        except ModelError as error:
            raise InputError(f"{self.source}: {error}") from None

    # ---- statements --------------------------------------------------------------------------------------------------
    def _statement(self) -> None:
        token = self.tokens[self.position]
        self.position += 1
        key = _SYNONYMS.get(token.text.lower(), token.text.lower())
        if key not in _KEYS:
            near = difflib.get_close_matches(key, sorted(_KEYS), n=1)
            hint = f", did you mean {near[0]!r}?" if near else f"; known are {', '.join(sorted(_KEYS))}"
            self._fail(token.line, token.text, None, f"unknown key{hint}")
        if key in _LOOP_KEYS:
            self._fail(token.line, key, None, "belongs to a loop joint; loops are not supported, only trees")
        if key in _EXPLICIT_CONSTRAINT_KEYS:
            self._fail(token.line, key, None, "belongs to an explicit constraint; those are not supported")
        if key not in _BARE_KEYS:
            self._expect_equal(token, key)
        if key == "body":
            self._start_body(token)
        elif key in _BODY_KEYS:
            self._body_statement(token, key)
        elif key in _CONSTRAINT_KEYS:
            self._constraint_statement(token, key)
        elif key == "gravity":
            if self.gravity is not None:
                self._fail(token.line, key, None, "stands twice")
            self.gravity = self._vector(token, key)
        elif key in ("stabvel", "stabpos"):
            self._values(token, key, 1)
        elif key in ("language", "prefix"):
            self._word(token, key)

    def _start_body(self, token: _Token) -> None:
        name = self._name(token, "body")
        if self.in_constraints:
            self._fail(token.line, "body", name, "stands after the constraints; bodies come first")
        if name.lower() == _GROUND:
            self._fail(token.line, "body", name, "is the world itself, not a body's name")
        earlier = self.by_name.get(name.lower())
        if earlier is not None:
            problem = f"stands a second time (first on line {earlier.line}), which closes a loop"
            self._fail(token.line, "body", name, f"{problem}; loops are not supported, write each body once")
        body = _Paragraph(name, token.line)
        self.bodies.append(body)
        self.by_name[name.lower()] = body

    def _body_statement(self, token: _Token, key: str) -> None:
        if not self.bodies or self.in_constraints:
            self._fail(token.line, key, None, "belongs to a body; it stands after body = NAME, before any constraint")
        body = self.bodies[-1]
        if key in body.lines and key != "pin":
            self._fail(token.line, key, None, f"body {body.name!r} has it already, on line {body.lines[key]}")
        body.lines[key] = token.line
        if key == "inboard":
            body.inboard = self._inboard(token, body)
        elif key == "joint":
            body.kind = self._joint_kind(token)
        elif key == "jname":
            body.joint_name = self._name(token, key)
            if body.joint_name.lower() in self.joint_names:
                self._fail(token.line, key, body.joint_name, "is another joint's name already")
            self.joint_names.add(body.joint_name.lower())
        elif key == "mass":
            body.mass = self._values(token, key, 1)[0]
            if body.mass < 0.0:
                self._fail(token.line, key, body.mass, f"of body {body.name!r} must not be negative [kg]")
        elif key == "inertia":
            body.inertia = self._inertia(token, body)
        elif key == "bodytojoint":
            body.body_to_joint = self._vector(token, key)
        elif key == "inbtojoint":
            body.inboard_to_joint = self._vector(token, key)
        elif key == "pin":
            body.pins.append(self._pin(token))
        elif key == "prescribed" and self._next_text() == "=":
            self.position += 1
            for word in self._collect(token, key):
                if word.text not in ("0", "1", "?", "0?", "1?"):
                    self._fail(word.line, key, word.text, "allowed are 0, 1 and ?, one for each axis")

    def _constraint_statement(self, token: _Token, key: str) -> None:
        if not self.bodies:
            self._fail(token.line, key, None, "stands before the bodies; constraints come after them")
        if key == "constraints":
            count = self._values(token, key, 1)[0]
            if not (count >= 1.0 and count.is_integer()):
                self._fail(token.line, key, count, "must be a whole number from 1 on")
        elif key == "constraint":
            self._name(token, key)
        else:
            kind = self._word(token, key)
            if kind.lower() != "user":
                self._fail(token.line, key, kind, "is not supported; allowed is user, which is read and left out")
        self.in_constraints = True

    # ---- values ------------------------------------------------------------------------------------------------------
    def _inboard(self, token: _Token, body: _Paragraph) -> str | None:
        name = self._word(token, "inb")
        if name.lower() == _GROUND:
            return None
        if name.lower() == body.name.lower():
            self._fail(token.line, "inb", name, "is the body itself, a loop; name the body it hangs on, or $ground")
        parent = self.by_name.get(name.lower())
        if parent is None:
            where = self._line_of_body(name)
            below = f"that body stands below, on line {where}, or both form a loop"
            problem = "there is no such body" if where is None else below
            self._fail(token.line, "inb", name, f"{problem}; name a body that stands above {body.name!r}, or $ground")
        return parent.name

    def _line_of_body(self, name: str) -> int | None:
        """Line of a ``body = name`` that has not been read yet."""
        for first, second, third in zip(self.tokens, self.tokens[1:], self.tokens[2:], strict=False):
            if first.text.lower() == "body" and second.text == "=" and third.text.lower() == name.lower():
                return first.line
        return None

    def _joint_kind(self, token: _Token) -> JointKind:
        word = self._word(token, "joint")
        allowed = "allowed are pin, ujoint, gimbal, ball, slider, free"
        if word.lower() in UNSUPPORTED_JOINTS:
            self._fail(token.line, "joint", word, f"is not supported; {allowed}")
        if word.lower() not in JOINT_KINDS:
            self._fail(token.line, "joint", word, f"is no joint; {allowed}")
        return JOINT_KINDS[word.lower()]

    def _inertia(self, token: _Token, body: _Paragraph) -> np.ndarray:
        words = self._collect(token, "inertia")
        shown = " ".join(word.text for word in words)
        values = [math.nan if word.text == "?" else self._number("inertia", word) for word in words]
        if len(words) == 3:
            matrix = np.diag(values)
        elif len(words) == 9:
            matrix = np.array(values).reshape(3, 3)
            matrix = np.where(np.isnan(matrix), matrix.T, matrix)
        else:
            self._fail(token.line, "inertia", shown, f"has {len(words)} numbers; allowed are 3 or 9")
        if np.any(np.isnan(matrix)):
            self._fail(token.line, "inertia", shown, "? needs a number on the other side of the diagonal")
        if not np.array_equal(matrix, matrix.T):
            self._fail(token.line, "inertia", shown, f"of body {body.name!r} is not symmetric")
        if float(np.linalg.eigvalsh(matrix)[0]) < -1e-9 * float(np.abs(matrix).max()):
            self._fail(token.line, "inertia", shown, f"of body {body.name!r} has a negative principal moment")
        return matrix

    def _pin(self, token: _Token) -> np.ndarray:
        axis = self._vector(token, "pin")
        length = math.hypot(*axis)
        if not length > 1.0 / LARGEST_NUMBER:
            self._fail(token.line, "pin", _numbers(axis), "is no direction; its length must not be zero")
        # An axis that is a unit vector already keeps its very bits.
        return axis if abs(length - 1.0) < 1e-12 else axis / length

    def _vector(self, token: _Token, key: str) -> np.ndarray:
        return np.array(self._values(token, key, 3))

    def _values(self, token: _Token, key: str, count: int) -> list[float]:
        words = self._collect(token, key)
        values = [self._number(key, word) for word in words]
        if len(values) != count:
            shown = " ".join(word.text for word in words)
            self._fail(token.line, key, shown, f"has {len(values)} numbers, needs {count}")
        return values

    def _number(self, key: str, word: _Token) -> float:
        if word.text == "?":
            self._fail(word.line, key, word.text, "has no value here; write a number, or one with ? behind it")
        if not _NUMBER.fullmatch(word.text):
            self._fail(word.line, key, word.text, "is not a finite number")
        value = float(word.text.rstrip("?"))
        if abs(value) > LARGEST_NUMBER:
            self._fail(word.line, key, word.text, f"is too large; allowed are numbers up to {LARGEST_NUMBER:g}")
        return value + 0.0  # minus zero becomes zero

    def _collect(self, token: _Token, key: str) -> list[_Token]:
        """The words after ``key =`` up to the next key: the next known word, or any word before an equals sign."""
        words: list[_Token] = []
        while self.position < len(self.tokens):
            word = self.tokens[self.position]
            following = self.tokens[self.position + 1].text if self.position + 1 < len(self.tokens) else ""
            if word.text == "=":
                self._fail(word.line, key, "=", "one equals sign too many")
            if word.text.lower() in _KEYS or following == "=":
                break
            words.append(word)
            self.position += 1
        if not words:
            self._fail(token.line, key, None, "has no value")
        return words

    def _word(self, token: _Token, key: str) -> str:
        text = self._next_text()
        if text in ("", "="):
            self._fail(token.line, key, text or None, "has no value")
        self.position += 1
        return text

    def _name(self, token: _Token, key: str) -> str:
        text = self._word(token, key)
        if not (_NAME.fullmatch(text) and text.isprintable()):
            self._fail(token.line, key, text, "is no name; one must not begin with a digit, sign, point or ?")
        return text

    def _next_text(self) -> str:
        return self.tokens[self.position].text if self.position < len(self.tokens) else ""

    def _expect_equal(self, token: _Token, key: str) -> None:
        if self._next_text() != "=":
            self._fail(token.line, key, None, "an equals sign must follow")
        self.position += 1

    # ---- from paragraphs to links ------------------------------------------------------------------------------------
    def _complete_first_body(self) -> None:
        """What SD/FAST assumes of the first body: it hangs on the ground, freely unless a joint is named."""
        first = self.bodies[0]
        for key in ("inboard", "inbtojoint"):
            first.lines.setdefault(key, first.line)
        if first.kind is None:
            first.kind = "free"
            first.lines["joint"] = first.line

    def _check_complete(self, body: _Paragraph) -> None:
        needed = ["inboard", "joint", "mass", "inertia"]
        if body.kind != "free":
            needed += ["bodytojoint", "inbtojoint"]
        for key in needed:
            if key not in body.lines:
                self._fail(body.line, "body", body.name, f"{key} is missing")
        assert body.kind is not None
        if body.kind == "free" and body.inboard is not None:
            self._fail(body.lines["joint"], "joint", "free", f"body {body.name!r} must then hang on $ground")
        count = AXIS_COUNT[body.kind]
        if body.kind != "free" and len(body.pins) != count:
            problem = f"body {body.name!r} has {len(body.pins)} pins, a {body.kind} joint needs {count}"
            self._fail(body.lines.get("pin", body.line), "pin", None, problem)

    def _link(self, body: _Paragraph, turn: np.ndarray) -> Link:
        assert body.kind is not None
        parent = self.by_name[body.inboard.lower()] if body.inboard is not None else None
        origin = parent.body_to_joint if parent is not None else np.zeros(3)
        axes = [] if body.kind == "free" else body.pins
        unnamed = f"{body.name}_joint" if body.name.lower() in self.joint_names else body.name
        joint = Joint(
            name=body.joint_name or unnamed,
            kind=body.kind,
            position=_vec3(turn @ (body.inboard_to_joint - origin)),
            axes=tuple(_vec3(turn @ axis) for axis in axes),
        )
        return Link(
            name=body.name,
            parent=body.inboard,
            joint=joint,
            mass=body.mass,
            com=_vec3(turn @ -body.body_to_joint),
            inertia=_matrix3(turn @ body.inertia @ turn.T),
        )

    def _fail(self, line: int, key: str, value: object, problem: str) -> NoReturn:
        shown = "" if value is None else f" = {value!r}" if isinstance(value, str) else f" = {value:g}"
        # A key may be any word of a broken file; repr keeps what cannot be printed out of the message.
        key = key if key.isprintable() else repr(key)
        raise InputError(f"{self.source}, line {line}: {key}{shown}: {problem}")


def _turn_to_minus_z(gravity: np.ndarray) -> tuple[np.ndarray, float]:
    """The shortest turn that brings gravity [m/s^2] to -z, shape [3, 3], and its strength [m/s^2]."""
    strength = math.hypot(*gravity)
    if not strength > 1.0 / LARGEST_NUMBER:
        return np.eye(3), 0.0
    x, y, z = gravity / strength
    cosine = -z
    if cosine <= -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0]), strength
    cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
    return np.eye(3) + cross + cross @ cross / (1.0 + cosine), strength


def _vec3(vector: np.ndarray) -> Vec3:
    x, y, z = (float(value) + 0.0 for value in vector)
    return x, y, z


def _matrix3(matrix: np.ndarray) -> Matrix3:
    symmetric = 0.5 * (matrix + matrix.T)
    return _vec3(symmetric[0]), _vec3(symmetric[1]), _vec3(symmetric[2])


# ---- writing ---------------------------------------------------------------------------------------------------------
def _numbers(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{float(value) + 0.0:.15g}" for value in values)


def _inertia_rows(link: Link) -> list[str]:
    inertia = np.array(link.inertia)
    if not np.any(inertia - np.diag(np.diag(inertia))):
        return [_numbers(np.diag(inertia))]
    return [_numbers(inertia[0]), f"? {_numbers(inertia[1, 1:])}", f"? ? {_numbers(inertia[2, 2:])}"]


def _check_names(model: Model) -> None:
    for kind, names in (
        ("link", [link.name for link in model.links]),
        ("joint", [link.joint.name for link in model.links]),
    ):
        seen: set[str] = set()
        for name in names:
            here = f"body {model.name!r}, {kind} {name!r}"
            if not (_NAME.fullmatch(name) and name.isprintable()) or name.lower() == _GROUND:
                raise InputError(f"{here}: no SD/FAST name; write it without spaces, =, # and !, a letter first")
            if name.lower() in seen:
                raise InputError(f"{here}: SD/FAST does not tell upper from lower case, so this name stands twice")
            seen.add(name.lower())
