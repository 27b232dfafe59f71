"""What is there and what is not: frames, gaps, pictures and labels by camera."""

from __future__ import annotations

import filecmp
import re
from collections import Counter
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...frame_numbers import frame_ranges
from ...io.capture import ALONE, KINDS, Capture, pictures_in
from ...io.image import colour_profile, turned
from ...io.mesh import KINDS as MESHES
from .cameras import Finding
from .exposure import DARK
from .masks import hardly

MANY = 4  # numbers in a message
COMPARED = 200  # frames whose files are held against those of the frame before
BLURRED = 0.15  # of the other frames' sharpness, of one camera


def unpadded(root: Path) -> list[Finding]:
    """Folders of frames whose numbers have not six digits are not read."""
    frames = root / "frames"
    names = sorted(p.name for p in frames.iterdir() if p.is_dir()) if frames.is_dir() else []
    odd = [name for name in names if re.search(r"\d", name) and not re.fullmatch(r"\d{6}", name)]
    if not odd:
        return []
    last = odd[-1]
    digits = re.findall(r"\d+", last)[-1]
    text, wanted = f"frames: {len(odd)} folders such as frames/{last} are not read", f"{int(digits):06d}"
    there = f", which is there too: which of them is frame {int(digits)}?" if wanted in names else ""
    text += f"; six digits: frames/{wanted}{there}" if len(digits) <= 6 else "; numbers have six digits, no more"
    return [Finding(text, serious=len(odd) * 2 > len(names))]


def gaps(numbers: tuple[int, ...]) -> list[Finding]:
    """Frame numbers that are missing between the first and the last, at the usual step."""
    if len(numbers) < 3:
        return []
    step = Counter(np.diff(numbers).tolist()).most_common(1)[0][0]
    missing = sorted(set(range(numbers[0], numbers[-1] + 1, step)) - set(numbers))
    if not missing:
        return []
    return [Finding(f"frames: {len(missing)} numbers are missing: {frame_ranges(missing, MANY)}", serious=False)]


def hollow(capture: Capture) -> list[Finding]:
    """Frames whose folders hold nothing that is read, all of which fail."""
    empty = [number for number in capture.frames if not capture.inputs(number)]
    if not empty:
        return []
    return [Finding(f"frames: {len(empty)} hold nothing that is read: {frame_ranges(empty, MANY)}", serious=False)]


def uneven(capture: Capture) -> list[Finding]:
    """Cameras that lack pictures, masks or labels in some frames where they have them in others, and cameras without any."""
    found, pictured = [], set()
    for kind in KINDS:
        there: dict[str, list[int]] = {}
        for number in capture.frames:
            folder = capture.folder(number) / kind
            for path in pictures_in(folder) if folder.is_dir() else ():
                there.setdefault(path.stem, []).append(number)
        pictured |= set(there) if kind == "images" else set()
        frames = sorted({number for numbers in there.values() for number in numbers})
        for name in sorted(there):
            missing = sorted(set(frames) - set(there[name]))
            if missing:
                found.append(
                    Finding(f"{name}: no {kind} in {len(missing)} frames: {frame_ranges(missing, MANY)}", serious=False)
                )
    idle = [name for name in capture.cameras if name not in pictured]
    if pictured and idle:
        found.append(Finding(f"cameras without a picture: {', '.join(idle[:MANY])}{'...' * (len(idle) > MANY)}", False))
    return found


def lacking(capture: Capture) -> list[Finding]:
    """Frames with pictures that have no mask at all, or no scan, where other such frames have one. Labels of few frames are enough."""
    inputs = {number: capture.inputs(number) for number in capture.frames}
    holds = lambda number, kind: any(path.parent.name == kind for path in inputs[number])
    pictured = [number for number in capture.frames if holds(number, "images")]
    scanned = [number for number in pictured if capture.folder(number) / "scan.ply" in inputs[number]]
    found = []
    for what, there in (("masks", [number for number in pictured if holds(number, "masks")]), ("scan", scanned)):
        missing = sorted(set(pictured) - set(there))
        if there and missing:
            text = f"frames: {len(missing)} with pictures have no {what}, as others have: {frame_ranges(missing, MANY)}"
            found.append(Finding(text, serious=False))
    return found


def upended(capture: Capture) -> list[Finding]:
    """Cameras whose pictures other programs turn as their headers ask, as the first frame with pictures tells; here they are not turned."""
    such = _cameras_of(path for path in _first_pictures(capture) if _asked(turned, path))
    text = f"{such}: their pictures ask to be turned (EXIF), and are read as they are stored: does the calibration mean them so?"
    return [Finding(text, serious=False)] if such else []


def profiled(capture: Capture) -> list[Finding]:
    """Cameras whose pictures are in other colours than sRGB, as the first frame with pictures tells; a line a colour space."""
    spaces: dict[str, list[Path]] = {}
    for path in _first_pictures(capture):
        if space := _asked(colour_profile, path):
            spaces.setdefault(space, []).append(path)
    text = "their pictures are in colours of '{}', and are read as if in sRGB: save them in sRGB"
    return [Finding(f"{_cameras_of(paths)}: {text.format(space)}", serious=False) for space, paths in spaces.items()]


def _first_pictures(capture: Capture) -> list[Path]:
    """The pictures of the capture's cameras in the first frame that has some."""
    folders = (folder for number in capture.frames if (folder := capture.folder(number) / "images").is_dir())
    folder = next(folders, None)
    return [path for path in pictures_in(folder) if path.stem in capture.cameras] if folder else []


def _cameras_of(paths: Iterable[Path]) -> str:
    """Names of the cameras of pictures, for a message."""
    names = [path.stem for path in paths]
    return f"{', '.join(names[:MANY])}{'...' * (len(names) > MANY)}"


def _asked(ask: Callable[[Path], Any], path: Path) -> Any:
    try:
        return ask(path)
    except UserError:  # told where pictures are looked at
        return None


def unread(capture: Capture) -> list[Finding]:
    """What lies in frames' folders and is not read, a line a sort: folders by name, files by ending."""
    sorts: dict[tuple[str, str], list[Path]] = {}
    for number in capture.frames:
        for path in capture.unread(number):
            inside = path.parent.name if path.parent.name in KINDS else ""
            sort = re.sub(r"\d+", "0", path.name) if path.is_dir() else path.suffix.lower()
            sorts.setdefault((inside, sort), []).append(path)
    found = []
    for first, *more in sorts.values():
        text = f"{first.relative_to(capture.root).as_posix()}{f' and {len(more)} more' if more else ''}"
        wanted = _expected(first)
        instead = f"{wanted} is" if (first.parent / wanted).exists() else f"expected {wanted}"
        found.append(Finding(f"{text}: not read, {instead}", serious=False))
    return found


def _expected(path: Path) -> str:
    """What would be read in the place of a file or folder."""
    if path.parent.name in KINDS:
        return "CAM.png or CAM.jpg"
    if path.is_dir():
        return next(iter(get_close_matches(path.name.lower(), KINDS, 1)), ", ".join(KINDS))
    if path.suffix.lower() in MESHES:
        return "scan.ply"
    alike = [name for name in ALONE if Path(name).suffix == path.suffix.lower()]
    return ", ".join(alike or (*KINDS, *ALONE))


def bare(capture: Capture) -> list[Finding]:
    """Captures of pictures alone, of which nothing shows where the person is."""
    shown = ("scan.ply", "keypoints.json", "keypoints3d.json", "masks")
    if any((capture.folder(number) / name).exists() for number in capture.frames for name in shown):
        return []
    return [
        Finding(
            "frames: no scans, keypoints or masks in any: toile detect finds the last two in pictures", serious=False
        )
    ]


def repeated(capture: Capture) -> list[Finding]:
    """Cameras and scans of which a frame has the same bits as the one before it, as where a recorder stood still."""
    before: dict[str, Path] = {}
    same: dict[str, list[int]] = {}
    numbers = capture.frames[:COMPARED]
    for number in numbers:
        try:
            files = dict(capture.picture_files(number, "images"))
        except UserError:
            continue  # which reading it tells
        scan = capture.folder(number) / "scan.ply"
        files |= {"scans": scan} if scan.is_file() else {}
        for name, path in files.items():
            if name in before and _same_bits(before[name], path):
                same.setdefault(name, []).append(number)
            before[name] = path
    found = []
    for name, at in same.items():
        text = f"{name}: in {len(at)} of {len(numbers)} frames the same to the bit as in the frame before, first in {at[0]}"
        found.append(Finding(f"{text}: did it stand still?", serious=False))
    return found


def _same_bits(one: Path, other: Path) -> bool:
    try:
        return filecmp.cmp(one, other, shallow=False)
    except OSError:  # told where files are read
        return False


def labels_seen(capture: Capture, frames: list[Any]) -> tuple[dict[str, dict[str, int]], list[Finding]]:
    """{label: {camera, or "scan": frames that show it}} in some frames, and garments that are seen too little."""
    seen: dict[str, dict[str, int]] = {name: {} for name in capture.scene.labels}
    for frame in frames:
        for camera, image in frame.labels.items():
            ids = set(np.unique(image).tolist())
            for name, label in capture.scene.labels.items():
                seen[name][camera] = seen[name].get(camera, 0) + (label in ids)
        if frame.scan_labels is not None:
            ids = set(np.unique(frame.scan_labels).tolist())
            for name, label in capture.scene.labels.items():
                seen[name]["scan"] = seen[name].get("scan", 0) + (label in ids)
    found: list[Finding] = []
    for garment in capture.scene.garments if frames else ():
        where = {camera: count for camera, count in seen[garment.label].items() if count}
        if not where and capture.scene.segmenter and not any(frame.certainty for frame in frames):
            continue  # the network could not be asked
        if not where:
            many = sum(bool(frame.labels) or frame.scan_labels is not None for frame in frames)
            text = f"garment {garment.name}: its label '{garment.label}' is seen nowhere in {many} frames looked at"
            found.append(Finding(text))
        elif "scan" not in where and len(where) < 2:
            text = f"garment {garment.name}: its label '{garment.label}' is seen by {next(iter(where))} alone"
            found.append(Finding(text, serious=False))
    return seen, found


def looks(frames: list[Any]) -> list[Finding]:
    """Masks that are empty, but for specks, or show the corners, blurred frames."""
    import cv2

    sharp: dict[str, dict[int, float]] = {}
    found = []
    masks = [mask for frame in frames for mask in frame.masks.values()]
    shown = [mask for mask in masks if not hardly(mask)]
    if masks and not shown:
        found.append(Finding("masks: all that were looked at are empty, or nearly: above 127 is the person"))
    cornered = sum(bool(mask[[0, 0, -1, -1], [0, -1, 0, -1]].all()) for mask in shown)
    if 2 * cornered > len(shown):
        text = f"masks: {cornered} of {len(masks)} that were looked at show all corners of the picture"
        found.append(Finding(f"{text}: are they inverted, or full? Above 127 is the person"))
    for frame in frames:
        for name, image in frame.images.items():
            grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
            mask = frame.masks.get(name)
            if grey.mean() < DARK:
                continue
            part = grey[mask] if mask is not None and mask.any() else grey
            sharp.setdefault(name, {})[frame.number] = (
                float(cv2.Laplacian(grey, cv2.CV_32F).var()) / float(part.mean() + 1) ** 2
            )
        empty = [name for name, mask in frame.masks.items() if hardly(mask)]
        if empty and shown:
            most = max(int(frame.masks[name].sum()) for name in empty)
            what = f"a mask that is all but empty, of {most} pixels" if most else "an empty mask"
            found.append(Finding(f"{', '.join(empty[:MANY])}: frame {frame.number} has {what}", serious=False))
        blank = [
            name for name, labels in frame.labels.items() if not labels.any() and frame.masks.get(name, labels).any()
        ]
        if blank:
            text = f"{', '.join(blank[:MANY])}: frame {frame.number} has an empty label image, and a mask that is not"
            found.append(Finding(text, serious=False))
    for name, values in sharp.items():
        usual = float(np.median(list(values.values())))
        for number, value in values.items():
            if len(values) > 2 and value < BLURRED * usual:
                found.append(Finding(f"{name}: frame {number} is blurred, against its other frames", serious=False))
    return found
