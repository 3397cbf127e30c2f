"""How a command becomes part of the `echelon` command, and the options that several share."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

import typer

from echelon.cli.running import Failure

_Function = TypeVar("_Function", bound=Callable[..., None])

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing unless something goes wrong.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, and nothing else.")]


def command(app: typer.Typer, name: str, examples: str) -> Callable[[_Function], _Function]:
    """Register a command; an interruption that it does not explain itself becomes a line.

    Args:
        app: What it belongs to.
        name: As it is called.
        examples: Lines that its help ends with.
    """

    def register(function: _Function) -> _Function:
        @functools.wraps(function)
        def guarded(*args: Any, **options: Any) -> None:
            try:
                function(*args, **options)
            except KeyboardInterrupt:
                raise Failure("interrupted") from None

        app.command(name, epilog=f"\b\nExamples:\n{examples}")(guarded)
        return function

    return register
