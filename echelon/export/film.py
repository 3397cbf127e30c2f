"""Pictures into an .mp4 that plays everywhere: H.264 (MPEG-4 part 2 where there is no x264), yuv420p, BT.709."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import numpy as np
from av.codec.context import Flags
from av.video.reformatter import ColorRange, Colorspace

X264_QUALITY = 20  # constant rate factor: smaller is better and larger


class FilmWriter:
    """Encodes one picture after the other. The same pictures give the same bytes."""

    def __init__(self, path: Path, size: tuple[int, int], frames_per_second: Fraction) -> None:
        """
        Args:
            path: Of the file; written at once, so give a temporary name.
            size: Width and height, both even [pixels].
            frames_per_second: Of the film.
        """
        # Bit-exact: no version strings, no dates.
        self._container = av.open(
            str(path), "w", format="mp4", options={"movflags": "+faststart", "fflags": "+bitexact"}
        )
        codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
        stream = self._container.add_stream(codec, rate=frames_per_second)
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.flags |= Flags.bitexact
        context.colorspace, context.color_range = Colorspace.ITU709, ColorRange.MPEG
        context.color_primaries = context.color_trc = 1  # BT.709
        if codec == "libx264":
            stream.options = {"preset": "veryfast", "crf": str(X264_QUALITY)}
        else:
            context.bit_rate = int(0.15 * size[0] * size[1] * frames_per_second)
        self._stream = stream

    def __enter__(self) -> FilmWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            self._container.mux(self._stream.encode(None))
        self._container.close()

    def add(self, picture: np.ndarray) -> None:
        """Append a picture: RGB, uint8, shape [height, width, 3]."""
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        frame = frame.reformat(
            format="yuv420p", dst_colorspace=Colorspace.ITU709, src_color_range=ColorRange.JPEG,
            dst_color_range=ColorRange.MPEG,
        )  # fmt: skip
        self._container.mux(self._stream.encode(frame))
