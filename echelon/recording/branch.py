"""Going on from the middle of a recording as another one: the first part is copied, the rest is still to happen."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from echelon.errors import InputError
from echelon.recording.layout import MANIFEST, replace_file
from echelon.recording.manifest import manifest_text, read_manifest
from echelon.recording.place import check_place
from echelon.recording.reader import Recording


def branch(source: Recording, path: str | Path, frame: int) -> None:
    """Make a recording that is interrupted after the last whole chunk before a frame, but otherwise is another.

    `RecordingWriter.reopen` goes on with it as with any that was interrupted: it simulates the last of these chunks
    again and compares, then everything is open. Where not one chunk is whole before the frame, it begins anew.

    Args:
        source: The recording; it stays as it is.
        path: Folder to make; a recording that is there is replaced.
        frame: Number of the frame from which on things are to happen otherwise.

    Raises:
        InputError: There is no such frame, or the folder cannot be made, or is the source.
    """
    target = Path(path)
    if not 0 <= frame <= source.frame_count:
        raise InputError(f"{source.path}: frame {frame}: must be from 0 to {source.frame_count}")
    if target.exists() and target.resolve() == source.path.resolve():
        raise InputError(f"{target}: is what is to be gone on from; name another folder")
    check_place(target)
    chunks = frame // source.chunk_frames
    frames = chunks * source.chunk_frames
    events = int(np.searchsorted(source.events["frame"], frames)) if chunks else 0
    manifest = read_manifest(source.path)
    begun = replace(manifest, status="running", frame_count=frames, chunk_count=chunks, event_count=events, summary={})
    state = manifest.state if chunks else ()
    text = manifest_text(
        replace(begun, state=state).constant_text(),
        frame_count=frames,
        chunk_count=chunks,
        event_count=events,
        state=state,
    )
    beside = target.with_name(f".{target.name}.part")
    try:
        shutil.rmtree(beside, ignore_errors=True)
        shutil.copytree(source.path, beside, ignore=_but(chunks, -(-events // manifest.event_rows)))
        replace_file(beside / MANIFEST, text.encode())
        if target.exists():
            shutil.rmtree(target)
        os.replace(beside, target)
    except OSError as error:
        shutil.rmtree(beside, ignore_errors=True)
        raise InputError(f"{target}: cannot be written ({error.strerror or error})") from None


def _but(chunks: int, event_chunks: int) -> Callable[[str, list[str]], set[str]]:
    """What `shutil.copytree` is to leave out: chunks that do not count any more, the manifest, and locks."""

    def ignored(folder: str, names: list[str]) -> set[str]:
        count = event_chunks if os.path.basename(folder) == "events" else chunks
        return {name for name in names if not _kept(name, count)}

    return ignored


def _kept(name: str, count: int) -> bool:
    parts = name.split(".")
    if parts[0] == "c" and len(parts) > 1 and parts[1].isdigit():
        return int(parts[1]) < count
    return name == "zarr.json" or "." not in name
