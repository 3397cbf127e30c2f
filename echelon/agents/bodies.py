"""Bodies by name or from a file.

Characters that are robots build their bodies in Python, beside their control. People are measured, so theirs are
data: they stand beside this file in ``bodies/``, one TOML file each, in the shape of `Model.to_dict`: a ``name``,
``gravity`` along -z [m/s^2], and the arrays of tables ``links``, ``springs`` and ``contacts`` with the fields of the
classes in `echelon.warp_kernels.model`. What is left out takes that class's default; a root link has no ``parent``, an
axis without limits has the empty list.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import fields
from importlib import resources
from pathlib import Path

from echelon.agents.hopper import hopper_model
from echelon.agents.riders.bicycle import Bicycle, racing_bicycle
from echelon.agents.riders.body import RiderParameters, cyclist_model
from echelon.agents.sdfast import read_sdfast
from echelon.errors import InputError
from echelon.warp_kernels.model import Model, ModelError
from echelon.warp_kernels.reference import Body

_BUILT: Mapping[str, Callable[[], Model]] = {
    "hopper": hopper_model,
    "bicycle": lambda: Bicycle(racing_bicycle()).body,
    "cyclist": lambda: cyclist_model(RiderParameters(), racing_bicycle(), fifteen_segments=False),
    "cyclist-1995": lambda: cyclist_model(RiderParameters(), racing_bicycle(), fifteen_segments=True),
}
_MEASURED = resources.files("echelon.agents") / "bodies"


def body_names() -> tuple[str, ...]:
    """Names of the bodies that ship, in alphabetical order."""
    measured = (Path(entry.name).stem for entry in _MEASURED.iterdir() if entry.name.endswith(".toml"))
    return tuple(sorted({*_BUILT, *measured}))


def load_body(name_or_path: str | Path) -> Body:
    """Load a body: one that ships, by name, or a file's.

    Args:
        name_or_path: One of `body_names`, or the path of a ``.toml`` body or of an SD/FAST description (``.sd``).

    Returns:
        The body, to be asked for its mass matrix, forward dynamics, link poses, momentum and energy.

    Raises:
        InputError: One line naming the file and what is wrong in it, or the names that there are.
    """
    if str(name_or_path) in _BUILT:
        return _with_mechanics(_BUILT[str(name_or_path)]())
    if str(name_or_path) in body_names():
        return _from_toml(f"{name_or_path}.toml", (_MEASURED / f"{name_or_path}.toml").read_bytes())
    path = Path(name_or_path)
    match path.suffix.lower():
        case ".sd":
            return _with_mechanics(read_sdfast(path))
        case ".toml":
            try:
                return _from_toml(str(path), path.read_bytes())
            except OSError as error:
                raise InputError(f"{path}: cannot be read: {error.strerror}") from None
            except ValueError as error:
                if isinstance(error, InputError):
                    raise
                raise InputError(f"{str(path)!r}: cannot be read: {error}") from None
    near = difflib.get_close_matches(str(name_or_path), body_names(), n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise InputError(
        f"body {str(name_or_path)!r}: {hint}allowed are {', '.join(body_names())} or the path of a .toml or .sd file"
    )


def _from_toml(source: str, content: bytes) -> Body:
    try:
        data = tomllib.loads(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(f"{source}: byte {error.start} is not UTF-8 text, as TOML must be") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{source}: is not TOML: {' '.join(str(error).split())}") from None
    try:
        return _with_mechanics(Model.from_dict(data))
    except ModelError as error:
        raise InputError(f"{source}: {error}") from None


def _with_mechanics(model: Model) -> Body:
    return Body(**{entry.name: getattr(model, entry.name) for entry in fields(model) if entry.init})
