"""What is wrong with a calibration or its frames, told by detections: conventions, single cameras, steps in time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...kernels.arrays import Array, Floats
from ...scene import Camera
from .rays import SURE, Meeting, Sighting, meet

OPENGL = np.diag([1.0, -1, -1, 1])
BETTER = 0.4  # share of the error that is left, below which another reading is right
AGREES = 0.02  # of a picture's diagonal: a convention that fits leaves less
FINEST = 8.0  # px: no detector is finer
OFF = 3.0  # times the others' error, and
LEAST = 0.004  # of a picture's diagonal, from which a camera is said to disagree
EXPLAINS = 1.0  # times the spread that is left: an offset that explains a camera's error
SHIFTS = 30  # frames that a camera may be out of step
SHORTEST = 6  # frames: of fewer, no step in time is told
COMPARED = 40  # detections that a shift is told by, at least
SHIFT_BETTER = 0.75
SURELY = 2.0  # standard deviations, by which more detections than half come nearer
FEW = 8  # cameras
MOVED = 1.0  # px a frame: below, nothing tells a step in time
CENTRE = 0.2  # of a picture's side: a principal point farther from the middle belongs to another picture
OUTSIDE = 0.3  # share of the detections that lie off their pictures
CORNER = 2.0  # px: detections that all lie nearer to the first pixel are shares of the picture
APART = 1e-9  # of their distance from the origin, which is rounding: cameras that are nearer to one another stand in one place


def _same(camera: Camera) -> Camera:
    return camera


def _inverted(camera: Camera) -> Camera:
    return replace(camera, T_camera_world=np.linalg.inv(camera.T_camera_world))


def _opengl(camera: Camera) -> Camera:
    return replace(camera, T_camera_world=OPENGL @ camera.T_camera_world)


def _opengl_inverted(camera: Camera) -> Camera:
    return replace(camera, T_camera_world=OPENGL @ np.linalg.inv(camera.T_camera_world))


CONVENTIONS: dict[
    str, tuple[Callable[[Camera], Camera], bool]
] = {  # a reading, and whether pictures are mirrored besides
    "": (_same, False),
    "camera to world: T_camera_world is to be its inverse": (_inverted, False),
    "OpenGL's axes (y up, z backwards): multiply T_camera_world from the left by diag(1, -1, -1, 1)": (_opengl, False),
    "camera to world with OpenGL's axes: invert T_camera_world, then multiply from the left by diag(1, -1, -1, 1)": (
        _opengl_inverted,
        False,
    ),
    "pictures that are mirrored, left for right": (_same, True),
}


@dataclass(frozen=True)
class Finding:
    """What one check found: `serious` where registering would be wasted."""

    text: str
    serious: bool = True


def read_as(sighting: Sighting, convention: str, only: int | None = None) -> Sighting:
    """The sighting with all cameras, or one, read another way."""
    change, mirror = CONVENTIONS[convention]
    cameras, uv = list(sighting.cameras), sighting.uv.copy()
    for i in range(len(cameras)) if only is None else [only]:
        cameras[i] = change(cameras[i])
        if mirror:
            uv[i, ..., 0] = cameras[i].width - uv[i, ..., 0]
    return replace(sighting, cameras=tuple(cameras), uv=uv)


def convention_of(sighting: Sighting) -> tuple[str, dict[str, float]]:
    """The reading of all cameras that fits the detections clearly better than what is written ("" where that does), and the
    median errors [px] of each."""
    errors = {name: meet(read_as(sighting, name)).typical() for name in CONVENTIONS}
    best = min(errors, key=lambda name: errors[name])
    clear = errors[best] < min(BETTER * errors[""], agrees(sighting))
    return (best if clear else ""), errors


def agrees(sighting: Sighting) -> float:
    """Error [px] that cameras, keypoints and conventions leave which fit one another."""
    return max(AGREES * diagonal(sighting), FINEST)


def diagonal(sighting: Sighting) -> float:
    return float(np.mean([np.hypot(*camera.size) for camera in sighting.cameras]))


def in_one_place(cameras: Iterable[Camera]) -> list[Finding]:
    """Of several cameras between which no distance is, so that nothing is seen in depth."""
    centres = np.array([camera.centre for camera in cameras])
    if len(centres) < 2 or np.ptp(centres, axis=0).max() > APART * np.abs(centres).max():
        return []
    text = "cameras.json: all cameras stand in one place"
    return [Finding(f"{text}: are their translations left out, or T_camera_world transposed?")]


def off_centre(cameras: Iterable[Camera]) -> list[Finding]:
    """Cameras whose principal points lie far from the middles of their pictures."""
    found = []
    for camera in cameras:
        at, size = camera.K[:2, 2], np.array([camera.width, camera.height])
        if (np.abs(at - size / 2) > CENTRE * size).any():
            text = f"{camera.name}: its principal point ({at[0]:.0f}, {at[1]:.0f}) is far from the middle of {size[0]} x {size[1]} pixels"
            found.append(Finding(f"{text}: is K of pictures of another size, or were these cut?", serious=False))
    return found


def off_pictures(sighting: Sighting) -> list[Finding]:
    """Of detections that do not meet, that many lie off their pictures, or all within their first pixels."""
    sure = sighting.weight > SURE
    size = np.array([[camera.width, camera.height] for camera in sighting.cameras])[:, None, None]
    if not sure.any():
        return []
    if (np.abs(sighting.uv[sure]) < CORNER).all():
        return [
            Finding("keypoints: all lie within two pixels of a corner: are they shares of the picture? expected pixels")
        ]
    outside = float(((sighting.uv < 0) | (sighting.uv > size)).any(-1)[sure].mean())
    if outside <= OUTSIDE:
        return []
    return [
        Finding(
            f"keypoints: {100 * outside:.0f} % lie off their pictures: were they found in pictures of another size?"
        )
    ]


def steps(sighting: Sighting) -> tuple[dict[int, int], Sighting]:
    """{camera: frames that it runs ahead} of cameras that are out of step, told by moving detections, the surest first; and
    the sighting with them put in step."""
    found: dict[int, int] = {}
    T = sighting.uv.shape[1]
    reach = min(SHIFTS, T // 3)
    if len(sighting.cameras) < 3 or T < SHORTEST or _motion(sighting) < MOVED:
        return found, sighting
    for _ in range(len(sighting.cameras) // 2):
        gains = {i: _step(sighting, i, reach, points) for i, points in _of_others(sighting) if i not in found}
        i = min(gains, key=lambda k: gains[k][1])
        shift, share = gains[i]
        if shift == 0 or share > SHIFT_BETTER:
            break
        found[i] = shift
        sighting = sighting.shifted(i, shift)
    return found, sighting


def _of_others(sighting: Sighting) -> Iterator[tuple[int, Floats]]:
    """(camera, points by the others); of many cameras by all, where one has little say."""
    C = len(sighting.cameras)
    whole = meet(sighting).points if C > FEW else None
    for i in range(C):
        yield i, meet(sighting.only([k for k in range(C) if k != i])).points if whole is None else whole


def _motion(sighting: Sighting) -> float:
    """How far detections move a frame, the 75th percentile [px]."""
    both = (sighting.weight[:, 1:] > 0) & (sighting.weight[:, :-1] > 0)
    moved = np.linalg.norm(np.diff(sighting.uv, axis=1), axis=-1)[both]
    return float(np.percentile(moved, 75)) if len(moved) else 0.0


def _step(sighting: Sighting, i: int, reach: int, points: Floats) -> tuple[int, float]:
    """(shift, share of the error that is left) of camera i against points (T,K,3); each shift is compared with none on the
    detections that both have, most of which it must bring nearer."""
    at, depth = sighting.cameras[i].project(np.nan_to_num(points))
    known = np.isfinite(points).all(-1) & (depth > 0)
    now, found = _off(sighting, i, at, known), (0, 1.0)
    for shift in sorted(range(-reach, reach + 1), key=abs):
        then = _off(sighting.shifted(i, shift), i, at, known)
        both = np.isfinite(now) & np.isfinite(then)
        n = int(both.sum())
        if n < COMPARED or (then < now)[both].sum() < (n + SURELY * np.sqrt(n)) / 2:
            continue
        share = float(np.median(then[both])) / max(float(np.median(now[both])), 1e-9)
        found = min(found, (shift, share), key=lambda told: told[1])
    return found


def _off(sighting: Sighting, i: int, at: Floats, known: Array) -> Floats:
    """Distances (T,K) [px] of camera i's detections from `at` (T,K,2); NaN where either is unknown."""
    return np.where(known & (sighting.weight[i] > SURE), np.linalg.norm(sighting.uv[i] - at, axis=-1), np.nan)


def offsets(sighting: Sighting, meeting: Meeting) -> dict[int, Floats]:
    """{camera: median offset (2,) [px]} of cameras whose detections lie aside of where the others say, as a whole."""
    found = {}
    for i, camera in enumerate(sighting.cameras):
        residual = meeting.residual[i][np.isfinite(meeting.residual[i]).all(-1)]
        if len(residual) >= 10:
            middle = np.median(residual, axis=0)
            spread = np.median(np.linalg.norm(residual - middle, axis=1))
            if np.linalg.norm(middle) > max(LEAST * np.hypot(*camera.size), EXPLAINS * spread):
                found[i] = middle
    return found


def strangers(sighting: Sighting, meeting: Meeting) -> dict[int, str]:
    """{camera: the reading that fits, "" for none} of cameras that disagree with the others."""
    told = ~np.isnan(meeting.error).all(axis=(1, 2))
    errors = np.array([meeting.typical(i) if told[i] else np.nan for i in range(len(told))])
    found: dict[int, str] = {}
    for i in (i for i in np.argsort(-errors) if told[i]):  # a camera that saw nothing disagrees with nobody
        if errors[i] < max(OFF * np.nanmin(errors), LEAST * diagonal(sighting)):
            break  # the best of the others is not so much better
        keep = [k for k in range(len(errors)) if k != i and k not in found]
        if len(keep) < 2 or not np.isfinite(errors).any():
            break
        rest = meet(sighting.only(keep)).typical() if len(keep) > 2 else float(np.median(errors[keep]))
        if errors[i] < max(OFF * rest, LEAST * diagonal(sighting)) or not np.isfinite(rest):
            continue
        readings = {
            name: meet(read_as(sighting, name, int(i)).only([*keep, int(i)])).typical(len(keep)) for name in CONVENTIONS
        }
        best = min(readings, key=lambda name: readings[name])
        found[int(i)] = best if readings[best] < BETTER * readings[""] else ""
    return found
