"""Layers onto disk: written beside their place under another name, then renamed; no half of one is ever seen."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import os
from pathlib import Path

from pxr import Sdf, Tf

from echelon.errors import InputError

FILE_FORMATS = {".usd": "usdc", ".usdc": "usdc", ".usda": "usda"}


def checked_stage_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a stage could be written there; raises InputError in one line that says why not.

    Checked before the work begins, so that a run of minutes does not end in a misspelt folder.
    """
    target = Path(path)
    if target.suffix.lower() not in FILE_FORMATS:
        raise InputError(f"stage {str(target)!r}: suffix {target.suffix!r} is not one of {', '.join(FILE_FORMATS)}")
    if target.is_dir():
        raise InputError(f"stage {str(target)!r}: is a folder, not a file")
    if not target.parent.is_dir():
        raise InputError(f"stage {str(target)!r}: there is no folder {str(target.parent)!r}")
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"stage {str(target)!r}: folder {str(target.parent)!r} cannot be written to")
    return target


def save_layer(layer: Sdf.Layer, path: Path) -> Path:
    """Write a layer in the format that the path's suffix asks for: crate for .usd and .usdc, text for .usda.

    Returns:
        The path. A layer of that path that is open in this process is read again.

    Raises:
        InputError: The file cannot be written; what stood there before still does.
    """
    target = checked_stage_path(path)
    beside = target.with_name(f".{target.stem}.{os.getpid()}.partial{target.suffix}")
    try:
        _export(layer, beside, target)
        os.replace(beside, target)
    except OSError as error:
        raise InputError(f"stage {str(target)!r}: cannot be written: {error.strerror}") from None
    finally:
        beside.unlink(missing_ok=True)
    opened = Sdf.Layer.Find(str(target.resolve()))
    if opened:
        opened.Reload(True)
    return target


def _export(layer: Sdf.Layer, beside: Path, target: Path) -> None:
    beside.touch()  # USD's own failure to open a file does not say why; the operating system's does
    try:
        written = layer.Export(str(beside), args={"format": FILE_FORMATS[target.suffix.lower()]})
    except Tf.ErrorException as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise InputError(f"stage {str(target)!r}: cannot be written: {reason}") from None
    if not written:
        raise InputError(f"stage {str(target)!r}: cannot be written")
