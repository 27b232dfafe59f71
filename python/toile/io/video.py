"""H.264 films, by PyAV."""

from __future__ import annotations

import os
from fractions import Fraction
from pathlib import Path

import numpy as np

from .files import called

QUALITY = "18"  # x264's constant rate factor: visually lossless
SAME_BITS = {"threads": "1", "x264-params": "mbtree=0"}  # by AVX-512 x264's macroblock tree gives others
FINEST = 1001  # the largest denominator of a rate: that of 30000/1001, and of the slowest


class VideoWriter:
    """Writes RGB pictures (H,W,3) uint8 in a row as an .mp4 at `fps`, at least 1/1001; odd sides lose their last row or column.

    A context manager: the file stands under its name only once all is written, and not at all where an exception ends it.
    """

    def __init__(self, path, fps):
        self.path, self.fps = Path(path), fps
        self.part = self.path.with_name(f".{self.path.stem}.{os.getpid()}.part.mp4")
        self.container = self.stream = None

    def __enter__(self):
        import av

        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.container = av.open(str(self.part), "w")
        return self

    def add(self, picture):
        import av

        picture = np.ascontiguousarray(picture[: len(picture) & ~1, : picture.shape[1] & ~1])
        if self.stream is None:
            rate = max(Fraction(self.fps).limit_denominator(FINEST), Fraction(1, FINEST))
            self.stream = self.container.add_stream("libx264", rate=rate)
            self.stream.height, self.stream.width = picture.shape[:2]
            self.stream.pix_fmt = "yuv420p"  # what every player shows
            self.stream.options = {"crf": QUALITY} | SAME_BITS
        with called(self.part, self.path):
            self.container.mux(self.stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))

    def __exit__(self, kind, *_):
        whole = kind is None and self.stream is not None
        try:
            with called(self.part, self.path):
                if whole:
                    self.container.mux(self.stream.encode())
                self.container.close()
            if whole:
                os.replace(self.part, self.path)
        finally:
            self.part.unlink(missing_ok=True)
