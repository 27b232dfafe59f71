"""Which camera and frame a file of somebody's capture belongs to, told by its path.

Known: CAM/000012.jpg, 000012/CAM.jpg, CAM_000012.jpg, 000012_CAM.png, CAM.png (frame 0), and these with words between
(cam01_json/cam01.0012.json, CAM/CAM_rgb000012.jpg, CAM/0012_img.jpg), below a folder that is called after what it holds.
Numbers may be unpadded. Times of day (12-30-05, 20261128_123005) number no frame.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from unicodedata import normalize

from ..errors import UserError
from .mesh import KINDS as MESHES

FOLDERS = {
    "images": ("images", "image", "rgbs", "rgb", "color", "imgs", "pictures", "frames"),
    "masks": ("masks", "mask", "fmask", "silhouettes"),
    "labels": ("labels",),
    "keypoints": ("keypoints", "pose", "openpose"),
    "scans": ("scans", "meshes"),
    "videos": ("videos", "video"),
}
ENDINGS = {
    "images": (".jpg", ".jpeg", ".png"),
    "masks": (".png", ".jpg", ".jpeg"),
    "labels": (".png", ".jpg", ".jpeg"),  # a JPEG is refused by name
    "keypoints": (".json",),
    "scans": MESHES,
    "videos": (".mp4", ".mov", ".avi", ".mkv", ".m4v"),
}
PICTURES = (".tif", ".tiff", ".bmp", ".webp", ".heic", ".avif", ".jp2", ".exr", ".tga", ".dng")  # that are not read
MOST = 1_000_000  # frame numbers have six digits
CLOCK = re.compile(  # hours, minutes and seconds between marks, with a fraction perhaps; or behind a date, where 000012 is a frame
    r"(?<!\d)(?:[01]\d|2[0-3])(?:([-_.:])[0-5]\d\1|h[0-5]\dm)[0-5]\d(?:[.,]\d{3})?(?!\d)"
    r"|(?<!\d)(?:19|20)\d\d([-_]?)(?:0[1-9]|1[0-2])\2(?:[0-2]\d|3[01])(?:[-_T]?(?:0[1-9]|1\d|2[0-3])|T?00)[0-5]\d[0-5]\d(?:[.,]\d{3})?(?!\d)"
)


@dataclass
class Placed:
    """Files of one kind: `files[number][camera]`, and those that belong to no camera."""

    files: dict[int, dict[str, Path]] = field(default_factory=dict)
    strange: list[Path] = field(default_factory=list)


def folder_of(source: Path, kind: str) -> Path | None:
    """The folder in `source` that is called after what it holds, in whatever case; for pictures also `source` itself."""
    there = {
        path.name.lower(): path for path in sorted(source.iterdir()) if path.is_dir()
    }  # "images" takes the place of "Images"
    found = next((there[name] for name in FOLDERS[kind] if name in there), None)
    return source if found is None and kind == "images" else found


def files_of(folder: Path, kind: str, endings: tuple[str, ...] = ()) -> list[Path]:
    """Files of a kind below a folder, in order, or those of other endings; for pictures not those in folders of another kind."""
    endings = endings or ENDINGS[kind]
    others = {name for other in FOLDERS if other != kind for name in FOLDERS[other]}
    found = []
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder).parts
        hidden = any(part.startswith(".") for part in inside)
        if (
            path.suffix.lower() in endings
            and not hidden
            and not others & {part.lower() for part in inside[:-1]}
            and path.is_file()
        ):
            found.append(path)
    return found


def placed(folder: Path, kind: str, cameras: Iterable[str]) -> Placed:
    """Files of a kind below a folder by frame and camera. UserError: two of one frame and camera, a number of seven digits,
    numbers that may be cameras or frames."""
    found, names, paths = Placed(), sorted(cameras, key=len, reverse=True), files_of(folder, kind)
    level = _level(folder, [path.relative_to(folder) for path in paths], names)
    for path in paths:
        camera, number = place(path.relative_to(folder), names, level)
        if camera is None:
            found.strange.append(path)
            continue
        if number >= MOST:
            raise UserError(f"{path}: frame {number}: frame numbers have at most six digits")
        before = found.files.setdefault(number, {}).setdefault(camera, path)
        if before != path:
            hint = ": times of day number no frames" if any(map(CLOCK.search, path.parts)) else ""
            raise UserError(f"{path}: camera '{camera}' has frame {number} in {before.name} too{hint}")
    return found


def place(path: Path, cameras: Iterable[str], level: int = 0) -> tuple[str | None, int]:
    """Camera (None: of no camera) and frame number of a path; `cameras` the longest names first. `level` folders above the
    file its part is the camera's, if it is called so; else the lowest that is."""
    parts = _parts(path)
    whole = [(i, part) for i, part in enumerate(parts) if part in cameras]
    found = whole or [(i, c) for i, part in enumerate(parts) for c in cameras if _within(part, c)]
    if not found:
        return None, 0
    at, camera = next((pair for pair in whole if pair[0] == level), found[0])
    number = camera.isdecimal()  # elsewhere in the path it is a frame's
    name = re.compile(rf"(?<![^\W_]){re.escape(camera)}(?![^\W_])")
    rest = [part if number and i != at else name.sub(" ", part, count=number) for i, part in enumerate(parts)]
    digits = [run for part in reversed(rest) for run in _numbers(part)]
    return camera, int(digits[-1]) if digits else 0


def _numbers(word: str) -> list[str]:
    """Runs of digits that may number a frame."""
    return re.findall(r"\d+", CLOCK.sub(" ", word))


def _parts(path: Path) -> list[str]:
    """The file's name without its ending, then the folders' from within; accents as one character (NFC), which some systems
    write as two."""
    return [normalize("NFC", part) for part in reversed(path.with_suffix("").parts)]


def _level(folder: Path, paths: list[Path], cameras: list[str]) -> int:
    """How many folders above the files the most parts are called as cameras are. UserError: as many in two places, of
    different cameras, as where frames 1 to 4 lie in folders of cameras 1 to 4."""
    counts = Counter(level for path in paths for level, part in enumerate(_parts(path)) if part in cameras)
    most = [level for level in sorted(counts) if counts[level] == max(counts.values())]
    for path in paths:
        named = {part for level, part in enumerate(_parts(path)) if level in most and part in cameras}
        if len(named) > 1:
            raise UserError(
                f"{folder / path}: {' and '.join(sorted(named))} are both cameras: which of them is the frame?"
            )
    return most[0] if most else 0


def _within(part: str, camera: str) -> bool:
    """Whether a camera's name stands in a word, no letter or digit beside it."""
    return re.search(rf"(?<![^\W_]){re.escape(camera)}(?![^\W_])", part) is not None


def numbered(folder: Path, kind: str) -> dict[int, Path]:
    """Files of a kind that belong to a frame alone, such as scans, by the last number in their path."""
    found: dict[int, Path] = {}
    for path in files_of(folder, kind):
        digits = _numbers(str(path.relative_to(folder).with_suffix("")))
        if digits:
            before = found.setdefault(int(digits[-1]), path)
            if before != path:
                raise UserError(f"{path}: frame {int(digits[-1])} is {before.name} too")
    return found
