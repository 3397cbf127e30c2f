"""Picture files: names checked before any work is done, and contents that appear whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from echelon.errors import InputError


def checked_path(path: str | Path, suffixes: tuple[str, ...]) -> Path:
    """The path as one that can be written; raises InputError where its ending or its folder is wrong."""
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise InputError(f"{path}: ends in {path.suffix!r}, must end in {' or '.join(suffixes)}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder, must be a file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {str(path.parent)!r} does not exist")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: the folder {str(path.parent)!r} cannot be written to")
    return path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary name beside `path`, renamed to it when all went well and removed when not."""
    beside = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield beside
        os.replace(beside, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        beside.unlink(missing_ok=True)
