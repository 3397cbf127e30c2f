"""Value clips: the motion of a long run in files of its own, a stretch of frames each, beside the stage.

::

    race.usd             everything but the crowd's motion, and where that is found
    race.clips/
        manifest.usda    which attributes the clips hold
        000000.usdc      frames 0 to 1800 of all agents
        001800.usdc      frames 1800 to 3600
        ...

A clip is made, written and forgotten before the next one is read, so that memory is bounded however long the run is;
programs that read the stage open a clip when they come to its frames. Time codes in a clip are those of the stage.
Every clip ends with the frame that the next one begins with: values are interpolated within a clip, never between two.

Clips are weaker than what stands beside them and stronger than what that refers to. They are set on the crowd itself,
whose agents stand in a variant: the defaults that are authored there, for readers that know nothing else, give way.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pxr import Sdf, Usd, Vt

from echelon.errors import InputError

MANIFEST = "manifest.usda"
SUFFIX = ".usdc"


@dataclass(frozen=True)
class Stretch:
    """The frames of one clip.

    Attributes:
        first: Its first frame, from which on it counts.
        last: Its last frame: the one that the next clip begins with.
    """

    first: int
    last: int

    @property
    def file_name(self) -> str:
        return f"{self.first:06d}{SUFFIX}"


def stretches(frame_count: int, clip_frames: int) -> tuple[Stretch, ...]:
    """How a run is cut into clips; all last ``clip_frames`` frames but the last, which has what is left."""
    starts = range(0, max(frame_count - 1, 1), clip_frames)
    return tuple(Stretch(first, min(first + clip_frames, frame_count - 1)) for first in starts)


def clips_folder(stage: Path) -> Path:
    """Where the clips of a stage are."""
    return stage.with_suffix(".clips")


def clip_path(representation: str) -> Sdf.Path:
    """Where the crowd stands in clips and manifest."""
    return Sdf.Path.absoluteRootPath.AppendChild(representation)


def check_clips_folder(stage: Path) -> None:
    """Raises InputError where something else is in the place of the clips, which would be lost."""
    folder = clips_folder(stage)
    if not folder.exists():
        return
    names = {entry.name for entry in folder.iterdir()} if folder.is_dir() else {""}
    if not all(name == MANIFEST or name.endswith(SUFFIX) for name in names):
        raise InputError(f"stage {str(stage)!r}: {folder.name!r} beside it holds other things, the clips go there")


def add_to_manifest(manifest: Sdf.Layer, clip: Sdf.Layer) -> None:
    """Declare in a manifest every attribute that a clip holds."""

    def declare(path: Sdf.Path) -> None:
        if not path.IsPropertyPath() or manifest.GetAttributeAtPath(path):
            return
        held = clip.GetAttributeAtPath(path)
        owner = Sdf.CreatePrimInLayer(manifest, path.GetPrimPath())
        Sdf.AttributeSpec(owner, path.name, held.typeName)

    clip.Traverse(Sdf.Path.absoluteRootPath, declare)


def author_clip_sets(crowd: Usd.Prim, stage: Path, clips: Sequence[Stretch], names: Sequence[str]) -> None:
    """Tell the crowd where its motion is, a clip set for each representation."""
    folder = clips_folder(stage).name
    last = float(clips[-1].last)
    api = Usd.ClipsAPI(crowd)
    for name in names:
        api.SetClipPrimPath(str(clip_path(name)), name)
        api.SetClipManifestAssetPath(Sdf.AssetPath(f"./{folder}/{MANIFEST}"), name)
        api.SetClipAssetPaths([Sdf.AssetPath(f"./{folder}/{clip.file_name}") for clip in clips], name)
        api.SetClipActive(Vt.Vec2dArray([(float(clip.first), float(i)) for i, clip in enumerate(clips)]), name)
        api.SetClipTimes(Vt.Vec2dArray([(0.0, 0.0), (last, last)]), name)


@contextmanager
def replacing_clips(stage: Path) -> Iterator[Path]:
    """A temporary folder for the clips of a stage, put in their place when all went well, and removed when not."""
    folder = clips_folder(stage)
    beside = folder.with_name(f".{folder.name}.{os.getpid()}.partial")
    old = folder.with_name(f".{folder.name}.{os.getpid()}.old")
    try:
        beside.mkdir()
        yield beside
        if folder.exists():
            os.replace(folder, old)
        os.replace(beside, folder)
    except OSError as error:
        raise InputError(f"stage {str(stage)!r}: clips cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(beside, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def remove_clips(stage: Path) -> None:
    """Remove the clips of a stage that has none any more."""
    shutil.rmtree(clips_folder(stage), ignore_errors=True)
