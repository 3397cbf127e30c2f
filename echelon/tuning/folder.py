"""A tuning's folder: what has been tried, kept after every generation, so that a search goes on after anything.

    state.json             what is tuned, and the worth of every batch of candidates so far
    convergence.png        how the search went

Candidates are not kept: a search that is told the same worths asks for the same candidates again, so going on is the
same search done again without performing anything, until the kept worths run out. A digest of each batch's candidates
tells if it is not the same, because another release of a package searches otherwise.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from echelon.errors import InputError
from echelon.recording.layout import replace_file
from echelon.recording.place import lock

FORMAT, VERSION = "echelon tuning", 1
STATE, PICTURE = "state.json", "convergence.png"


@dataclass(frozen=True)
class Batch:
    """What a batch of candidates was worth.

    Attributes:
        objective: Of each candidate.
        success: Share of successes of each.
        best_terms: Mean cost of each of the stage's terms, of the best candidate.
    """

    objective: tuple[float, ...]
    success: tuple[float, ...]
    best_terms: tuple[float, ...]

    @property
    def best(self) -> int:
        """Index of the best candidate, the first of equals."""
        return min(range(len(self.objective)), key=self.objective.__getitem__)


class TuningFolder:
    """The folder of a tuning that is under way; made by `open`.

    Attributes:
        path: The folder.
        batches: In order, as many as are known.
        went_on: Whether there were any before.
    """

    def __init__(self, path: Path, settings: Mapping[str, Any]) -> None:
        self.path = path
        self.batches: list[Batch] = []
        self.went_on = False
        self._settings = json.loads(json.dumps(settings))
        self._digests: list[str] = []

    @classmethod
    @contextmanager
    def open(cls, path: Path, settings: Mapping[str, Any], resume: bool) -> Iterator[TuningFolder]:
        """Make the folder, or go on with it; nobody else can until the context ends.

        Args:
            path: The folder.
            settings: Plain data: what makes two tunings the same.
            resume: Whether to go on with what is there, rather than begin.

        Raises:
            InputError: There is something already and it is not to be resumed, or the other way round, or it is that
                of another tuning, or in use, or it cannot be written.
        """
        folder = cls(path, settings)
        try:
            if path.exists() and not path.is_dir():
                raise InputError(f"{path}: is a file; must be the name of a folder to make, or of this tuning's")
            begun = (path / STATE).exists()
            if begun and not resume:
                raise InputError(f"{path}: holds a tuning; --resume goes on with it, another --out begins another")
            if resume and not begun:
                raise InputError(f"{path}: holds no tuning to go on with; leave --resume out to begin one")
            if not begun and path.exists() and any(path.iterdir()):
                raise InputError(f"{path}: exists and is not a tuning's; remove it or choose another --out")
            if not path.absolute().parent.is_dir():
                raise InputError(f"{path}: cannot be made; there is no folder {path.absolute().parent}")
            path.mkdir(exist_ok=True)
            held = lock(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from None
        try:
            if begun:
                folder._read()
            else:
                folder._write()
            yield folder
        finally:
            if held is not None:
                os.close(held)

    def _read(self) -> None:
        state = self.path / STATE
        try:
            data = json.loads(state.read_text(encoding="utf-8"))
            known = data["format"] == FORMAT and data["version"] == VERSION
            batches = [
                Batch(tuple(one["objective"]), tuple(one["success"]), tuple(one["best_terms"]))
                for one in data["batches"]
            ]
            digests = [str(one["of"]) for one in data["batches"]]
            there = dict(data["settings"])
        except (OSError, ValueError, KeyError, TypeError):
            known, batches, digests, there = False, [], [], {}
        if not known:
            raise InputError(f"{state}: cannot be read as a tuning's; remove {self.path} or choose another --out")
        different = [name for name, value in self._settings.items() if there.get(name) != value]
        if different:
            raise InputError(
                f"{self.path}: holds another tuning, which differs in {', '.join(different)}; choose another --out"
            )
        self.batches, self._digests = batches, digests
        self.went_on = True

    def _write(self) -> None:
        data = {
            "format": FORMAT,
            "version": VERSION,
            "settings": self._settings,
            "batches": [
                {"of": digest, "objective": batch.objective, "success": batch.success, "best_terms": batch.best_terms}
                for digest, batch in zip(self._digests, self.batches, strict=True)
            ],
        }
        replace_file(self.path / STATE, (json.dumps(data) + "\n").encode())

    def known(self, number: int, candidates: Sequence[Mapping[str, float]]) -> Batch | None:
        """What a batch was worth, None if nobody knows yet.

        Args:
            number: Of the batch, from 0.
            candidates: In it.

        Raises:
            InputError: There is one of that number, of other candidates.
        """
        if number >= len(self.batches):
            return None
        if self._digests[number] != digest(candidates):
            raise InputError(
                f"{self.path / STATE}: batch {number} was of other candidates, as another release of a package asks "
                f"for; remove {self.path} to begin anew"
            )
        return self.batches[number]

    def keep(self, candidates: Sequence[Mapping[str, float]], batch: Batch) -> None:
        """Keep what a batch was worth."""
        self.batches.append(batch)
        self._digests.append(digest(candidates))
        self._write()


def digest(candidates: Sequence[Mapping[str, float]]) -> str:
    """Of candidates, to the last bit."""
    return hashlib.sha256(json.dumps([dict(one) for one in candidates]).encode()).hexdigest()[:16]
