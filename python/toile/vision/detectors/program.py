"""Any program as a detector: it reads folders of pictures and writes keypoints.json and masks."""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from ...errors import UserError
from ...io.image import read_image
from ...io.keypoints import read_keypoints
from ...scene import Camera
from . import Detection

TOLD = 200  # characters of what a program said last
ITS_OWN = Path(__file__).with_name("holistic.py")


class Program:
    """Runs `COMMAND PICTURES OUT [PICTURES OUT ...]`, without a shell, for up to `at_once` instants a call.

    PICTURES is a folder with one picture a camera, named by the camera; OUT is an empty folder in which the program writes
    keypoints.json (see docs/formats/capture.md) and, if it can, masks/CAMERA.png, in pixels of the pictures as they are stored,
    not turned as their headers (EXIF) may ask. UserError: the command cannot be run, ends with another exit code than 0, or
    leaves files that are none.
    """

    at_once = 16

    def __init__(self, command: str):
        try:
            self.words = shlex.split(command)
        except ValueError as error:
            raise UserError(f"--detector: {error}") from None
        if not self.words:
            raise UserError("--detector: no command")

    def detect(self, folders: Sequence[Path], cameras: Mapping[str, Camera]) -> Iterator[Detection]:
        """A Detection for each folder of pictures, in their order."""
        for first in range(0, len(folders), self.at_once):
            some = folders[first : first + self.at_once]
            with tempfile.TemporaryDirectory(prefix="toile-detect-") as scratch:
                outs = [Path(scratch) / f"{i:06d}" for i in range(len(some))]
                for out in outs:
                    out.mkdir()
                self._run([str(path.resolve()) for pair in zip(some, outs) for path in pair])
                for folder, out in zip(some, outs):
                    yield self._left(folder, out, cameras)

    def _run(self, folders: Sequence[str]) -> None:
        try:
            done = subprocess.run(
                [*self.words, *folders], capture_output=True, text=True, errors="replace", check=False
            )
        except OSError as error:
            raise UserError(f"--detector: '{self.words[0]}' cannot be run: {error.strerror}") from None
        if done.returncode:
            last = ((done.stderr.strip() or done.stdout.strip()).splitlines() or ["it says nothing"])[-1]
            raise UserError(f"--detector: '{self.words[0]}' ended with exit code {done.returncode}: {last[:TOLD]}")

    def _left(self, folder: Path, out: Path, cameras: Mapping[str, Camera]) -> Detection:
        """What it left in OUT of a folder of pictures, which is what an error calls by name: OUT is gone then."""
        try:
            return _read(out, cameras)
        except UserError as error:
            said = str(error).replace(f"{out}/", "")
            raise UserError(f"--detector: what '{self.words[0]}' left of {folder}: {said}") from None


def its_own(python: Path) -> Program:
    """The detector that comes along, run by the Python of an environment that holds mediapipe."""
    return Program(shlex.join([str(python), str(ITS_OWN)]))


def default_python() -> Path | None:
    """The Python that `make detector` sets up beside this environment, if it did."""
    found = Path(sys.prefix).parent / ".venv-detector" / "bin" / "python"
    return found if found.exists() else None


def _read(out: Path, cameras: Mapping[str, Camera]) -> Detection:
    keypoints = read_keypoints(out / "keypoints.json", dict(cameras))
    files = {path.stem: path for path in sorted((out / "masks").glob("*.png"))}
    strange = sorted(set(files) - set(cameras))
    if strange:
        raise UserError(f"{files[strange[0]]}: no camera '{strange[0]}' in cameras.json")
    return Detection(keypoints, {name: read_image(path, cameras[name].size, "L") > 127 for name, path in files.items()})
