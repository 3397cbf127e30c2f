"""Where a recording may be made: never over something else, never under another writer."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

from echelon.errors import InputError
from echelon.recording.layout import MANIFEST, event_array
from echelon.recording.manifest import FORMAT, VERSION, Manifest, is_recording, manifest_frame_arrays, manifest_text

try:
    import fcntl
except ImportError:  # not a POSIX system: two writers at once are then not found out
    fcntl = None


def check_place(path: str | Path) -> bool:
    """Whether a recording made at ``path`` replaces another.

    Raises:
        InputError: None can be made there: it is something else, or is being written by another run, or its folder
            does not exist or cannot be written to.
    """
    path = Path(path)
    if not path.name:
        raise InputError(f"{path}: must be the name of a folder to make")
    try:
        if not path.exists():
            parent = path.absolute().parent
            if not parent.is_dir():
                raise InputError(f"{path}: cannot be made; there is no folder {parent}")
            if not os.access(parent, os.W_OK):
                raise InputError(f"{path}: cannot be made; the folder {parent} cannot be written to")
            return False
        if path.is_dir() and not any(path.iterdir()):
            return False
        if not is_recording(path):
            raise InputError(
                f"{path}: exists and is not a recording (or a damaged one); will not be overwritten, remove it or "
                "choose another place"
            )
        taken = lock(path)  # nobody else may be writing it
        if taken is not None:
            os.close(taken)
        return True
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def make_folder(path: Path, manifest: Manifest) -> int | None:
    """Make an empty recording beside ``path``, put it in its place; returns the lock on it."""
    check_place(path)
    if path.is_symlink():
        path = path.resolve()
    beside = path.with_name(f".{path.name}.part")
    old = path.with_name(f".{path.name}.old")
    try:
        exists = path.exists()
        for stale in (beside, old):
            if stale.exists():
                shutil.rmtree(stale)
        beside.mkdir()
        group = {"zarr_format": 3, "node_type": "group", "attributes": {"format": FORMAT, "version": VERSION}}
        (beside / "zarr.json").write_text(json.dumps(group))
        for layout in manifest_frame_arrays(manifest).values():
            (beside / layout.name).mkdir()
            (beside / layout.name / "zarr.json").write_text(json.dumps(layout.metadata(manifest.frame_limit)))
        (beside / "events").mkdir()
        (beside / "events" / "zarr.json").write_text(json.dumps(event_array(manifest.event_rows).metadata(0)))
        (beside / MANIFEST).write_text(manifest_text(manifest.constant_text()))
        held = lock(beside)
        if exists:
            os.replace(path, old)
        os.replace(beside, path)
        if exists:
            shutil.rmtree(old)
        return held
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def lock(path: Path) -> int | None:
    """Keep other writers off a recording for as long as the returned descriptor is open; None where that is unknown."""
    if fcntl is None:
        return None
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise InputError(f"{path}: is being written by another run") from None
    except OSError:  # a file system without locks
        os.close(descriptor)
        return None
    return descriptor
