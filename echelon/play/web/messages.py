"""What a page may say, and nothing else: JSON text in, one frozen dataclass out.

A page is somebody else's program. Each message is therefore held against an exact form: every key is there, none is
unknown, every value is of its type and within its bounds. Whatever is not raises InputError with one line that the
connection is closed with.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from echelon.errors import InputError
from echelon.settings import shown

LARGEST = 2048  # bytes of one message
LONGEST_NAME = 24  # characters
LARGEST_WHOLE = 2**31 - 1  # of seeds, frames and the numbers of people

View = Literal["saddle", "follow", "free"]


# ---- about the person ----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Hello:
    """Who is there: a name to show, and the number under which viser knows the same page."""

    viewer: int
    name: str


@dataclass(frozen=True)
class Take:
    """Takes the handlebars if nobody holds them."""


@dataclass(frozen=True)
class Pass:
    """The holder hands the handlebars to the person numbered ``to``."""

    to: int


@dataclass(frozen=True)
class Leave:
    """The holder lets go of the handlebars."""


@dataclass(frozen=True)
class Ping:
    """Asks for an answer at once; ``at`` is the page's own clock [ms] and comes back as it is."""

    at: float


# ---- commands: what reaches the loop -------------------------------------------------------------------------------
@dataclass(frozen=True)
class Ride:
    """What hands and feet do, as shares of the most: pedal and brake 0 to 1, steering -1 (right) to 1 (left)."""

    pedal: float
    brake: float
    steer: float
    lean: bool


@dataclass(frozen=True)
class LetGo:
    """The rider fell silent, let go of the handlebars or is gone: nobody pedals, brakes or steers. No page sends it."""


@dataclass(frozen=True)
class Gear:
    """One gear up (1) or down (-1)."""

    step: int


@dataclass(frozen=True)
class ChangeView:
    """From where a person looks."""

    view: View


@dataclass(frozen=True)
class Look:
    """Where a person looks from the saddle: yaw (left positive) and pitch (up positive) from straight ahead [rad]."""

    yaw: float
    pitch: float


@dataclass(frozen=True)
class Pause:
    """Holds the world, or lets it go on."""

    paused: bool


@dataclass(frozen=True)
class Slow:
    """Slow motion: simulated seconds a second of wall clock, up to 1."""

    rate: float


@dataclass(frozen=True)
class Restart:
    """Begins anew, with another seed or number of characters where they are given."""

    seed: int | None
    agents: int | None


@dataclass(frozen=True)
class Save:
    """Asks for the name under which the take is kept."""


@dataclass(frozen=True)
class Seek:
    """Replay: goes to a frame."""

    frame: int


@dataclass(frozen=True)
class Play:
    """Replay: runs or stands."""

    playing: bool


@dataclass(frozen=True)
class Rate:
    """Replay: recorded seconds a second of wall clock, backwards where negative."""

    rate: float


Command = Ride | LetGo | Gear | ChangeView | Look | Pause | Slow | Restart | Save | Seek | Play | Rate
Message = Hello | Take | Pass | Leave | Ping | Command

REPLAY_ONLY = (Seek, Play, Rate)
RIDING_ONLY = (Ride, Gear, Take, Pass)
LIVE_ONLY = (*RIDING_ONLY, Slow, Restart, Save, Pause)


# ---- the forms -----------------------------------------------------------------------------------------------------
Check = tuple[Callable[[Any], bool], str]
"""Whether a value will do, and in words what would."""


def _number(low: float, high: float) -> Check:
    def within(value: Any) -> bool:
        # the bounds first: a whole number of a thousand digits compares, but does not turn into a float
        return type(value) in (int, float) and low <= value <= high

    return within, f"a number from {low:g} to {high:g}"


def _whole(low: int, high: int) -> Check:
    return (lambda value: type(value) is int and low <= value <= high), f"a whole number from {low} to {high}"


def _or_nothing(check: Check) -> Check:
    return (lambda value: value is None or check[0](value)), f"null or {check[1]}"


def _one_of(*options: Any) -> Check:
    words = ", ".join(json.dumps(option) for option in options)
    return (lambda value: any(type(value) is type(option) and value == option for option in options)), f"one of {words}"


def _is_name(value: Any) -> bool:
    return (
        isinstance(value, str) and len(value) <= LONGEST_NAME and value.isprintable() and value == value.strip() != ""
    )


SWITCH: Check = (lambda value: isinstance(value, bool), "true or false")
NAME: Check = (_is_name, f"1 to {LONGEST_NAME} printable characters without spaces around them")
RATE: Check = (
    lambda value: type(value) in (int, float) and -8 <= value <= 8 and abs(value) >= 0.01,
    "a number from -8 to 8, at least 0.01 from 0",
)

FORMS: Mapping[str, tuple[type, Mapping[str, Check]]] = {
    "hello": (Hello, {"viewer": _whole(0, LARGEST_WHOLE), "name": NAME}),
    "take": (Take, {}),
    "pass": (Pass, {"to": _whole(0, LARGEST_WHOLE)}),
    "leave": (Leave, {}),
    "ping": (Ping, {"at": _number(-1e15, 1e15)}),
    "ride": (Ride, {"pedal": _number(0, 1), "brake": _number(0, 1), "steer": _number(-1, 1), "lean": SWITCH}),
    "gear": (Gear, {"step": _one_of(1, -1)}),
    "view": (ChangeView, {"view": _one_of("saddle", "follow", "free")}),
    "look": (Look, {"yaw": _number(-math.pi, math.pi), "pitch": _number(-1.5, 1.5)}),
    "pause": (Pause, {"paused": SWITCH}),
    "slow": (Slow, {"rate": _number(0.05, 1)}),
    "restart": (
        Restart,
        {"seed": _or_nothing(_whole(0, LARGEST_WHOLE)), "agents": _or_nothing(_whole(1, 100_000))},
    ),
    "save": (Save, {}),
    "seek": (Seek, {"frame": _whole(0, LARGEST_WHOLE)}),
    "play": (Play, {"playing": SWITCH}),
    "rate": (Rate, {"rate": RATE}),
}


def read_message(text: str | bytes) -> Message:
    """The message that a page sent.

    Args:
        text: One JSON object, UTF-8, at most LARGEST bytes.

    Raises:
        InputError: Too long, not JSON, of an unknown kind, a key missing, unknown or twice, a value of the wrong type
            or out of its bounds.
    """
    size = len(text) if isinstance(text, bytes) else len(text.encode("utf-8", "surrogatepass"))
    if size > LARGEST:
        raise InputError(f"message of {size} bytes: at most {LARGEST} are allowed")
    try:
        data = json.loads(text, object_pairs_hook=_without_twins, parse_constant=_no_constant)
    except InputError:
        raise
    except (ValueError, RecursionError):
        raise InputError(f"message {shown(text)}: must be JSON") from None
    if not isinstance(data, dict):
        raise InputError(f"message {shown(text)}: must be a JSON object")
    kind = data.pop("kind", None)
    if not isinstance(kind, str) or kind not in FORMS:
        raise InputError(f"message kind = {shown(kind)}: must be one of {', '.join(FORMS)}")
    form, checks = FORMS[kind]
    for key in data:
        if key not in checks:
            raise InputError(f"message {kind}: unknown key {shown(key)}; known are {', '.join(checks) or 'none'}")
    for key, (fits, allowed) in checks.items():
        if key not in data:
            raise InputError(f"message {kind}: {key} is missing, allowed is {allowed}")
        if not fits(data[key]):
            raise InputError(f"message {kind}: {key} = {shown(data[key])}, allowed is {allowed}")
    return form(**data)


def _without_twins(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object's keys, each at most once: of twins two readers may believe different ones."""
    data = dict(pairs)
    if len(data) != len(pairs):
        raise InputError("message: a key stands in it twice")
    return data


def _no_constant(word: str) -> float:
    raise InputError(f"message: {word} is not a number in JSON")
