"""The files of the chunk that is being simulated: they grow a piece at a time, and count once they are whole.

What has been simulated is on disk a moment later, beside its place, under a name that nobody reads. When the chunk has
come to its end only a last piece is still to be written, so that waiting for it costs next to nothing.
"""

from __future__ import annotations

import os
from contextlib import suppress
from io import FileIO
from pathlib import Path

import google_crc32c
import numpy as np

from echelon.recording.layout import checksum_bytes, checksum_with_zeros


class GrowingFile:
    """One file of a chunk, written beside its place a piece at a time.

    The file is opened for each piece: a large crowd has more files than a process may have open.
    """

    def __init__(self, path: Path, length: int) -> None:
        """
        Args:
            path: Where it comes to stand.
            length: Of its numbers when it is full [bytes]; of what is not there the numbers are zeros.
        """
        self._path = path
        self._beside = path.with_name(path.name + ".part")
        self._length = length
        self._size = 0
        self._checksum = 0

    def create(self) -> None:
        """Make the file, empty, which takes longer than to write a little to it; raises OSError."""
        FileIO(self._beside, "w").close()

    def extend(self, data: np.ndarray) -> None:
        """Add numbers, uint8, shape [bytes]; raises OSError."""
        with FileIO(self._beside, "r+") as file:
            file.seek(self._size)
            _write(file, memoryview(data))  # type: ignore[arg-type]
        self._checksum = google_crc32c.extend(self._checksum, data)  # type: ignore[arg-type]
        self._size += len(data)

    def finish(self) -> None:
        """Put it in its place, with its checksum; raises OSError."""
        found = checksum_with_zeros(self._checksum, self._length - self._size)
        with FileIO(self._beside, "r+") as file:
            file.seek(self._length)  # zeros in between take no space where the system knows how
            _write(file, memoryview(checksum_bytes(found)))
        os.replace(self._beside, self._path)

    def discard(self) -> None:
        """Leave nothing of it beside its place, if the folder lets us: who resumes removes what is left."""
        with suppress(OSError):
            self._beside.unlink(missing_ok=True)


class ComparedFile:
    """One file of a chunk that has been recorded before: what is added must be what is there."""

    def __init__(self, path: Path, length: int) -> None:
        """
        Args:
            path: Where it is.
            length: Of its numbers [bytes].
        """
        self._path = path
        self._length = length
        self._size = 0
        self._checksum = 0
        self.differs = False

    def create(self) -> None:
        """It is there."""

    def extend(self, data: np.ndarray) -> None:
        """Add numbers, uint8, shape [bytes]."""
        self._checksum = google_crc32c.extend(self._checksum, data)  # type: ignore[arg-type]
        self._size += len(data)

    def finish(self) -> None:
        """Find out whether it ``differs``; raises OSError."""
        found = checksum_with_zeros(self._checksum, self._length - self._size)
        with open(self._path, "rb") as stored:
            stored.seek(self._length)
            self.differs = stored.read() != checksum_bytes(found)

    def discard(self) -> None:
        """Leave what is there as it is."""


def _write(file: FileIO, data: memoryview) -> None:
    """All of the data: a disk that is nearly full takes some of it, and says so only when asked again."""
    while len(data):
        data = data[file.write(data) :]
