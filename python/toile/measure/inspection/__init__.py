"""What is wrong with a capture, found before hours are spent: what `toile inspect` does.

Only what can be told in seconds is looked at: all keypoints, and the pictures of a few frames.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...frame_numbers import evenly
from ...io.body import model_in_capture
from ...io.capture import KINDS, Capture, open_capture
from ...io.keypoints import read_keypoints
from ...kernels.arrays import Floats
from ...scene import Camera, Frame, Points3D
from ..evidence import UNSEEN
from .aside import displaced
from .body import FACING, check_bones, check_names, check_sides, check_units, check_up, stature, upward
from .cameras import (
    CONVENTIONS,
    Finding,
    agrees,
    convention_of,
    in_one_place,
    off_centre,
    off_pictures,
    offsets,
    read_as,
    steps,
    strangers,
)
from .colours import blue_faces
from .detections import at_origin, blind
from .doubts import asked, doubted
from .exposure import exposures
from .files import (
    bare,
    gaps,
    hollow,
    labels_seen,
    lacking,
    looks,
    profiled,
    repeated,
    uneven,
    unpadded,
    unread,
    upended,
)
from .fractions import fractions
from .late import out_of_step, pictures_out_of_step
from .masks import COVERED, centroids, coverage, without_specks
from .order import leaps, out_of_order
from .others import somebody_else
from .outlines import exchanged
from .rays import SURE, Meeting, Sighting, epipolar, meet
from .readings import misread
from .scans import astray, inside_out, short
from .sides import exchanged_sides

SAMPLED = 5  # frames whose pictures are read
LABELLED = 2  # frames besides, where few have label images and none of those has one
SHOWN = (*KINDS, "scan.ply")
READ = 200  # frames whose keypoints are read, in a row
DETECTIONS = 60_000  # that checks of all cameras look at
ENOUGH = 8  # of the body's keypoints, to leave hands and face alone
SIGMA = 0.01  # m, of points where keypoints meet
CULPRIT = 0.05  # by how much a hull without a camera covers the others better


@dataclass
class Inspection:
    """Findings, the serious first, and what the page shows."""

    capture: Capture | None
    findings: list[Finding] = field(default_factory=list)
    facts: dict[str, float | None] = field(default_factory=dict)
    frames: list[Frame] = field(default_factory=list)
    sighting: Sighting | None = None
    meeting: Meeting | None = None
    first: int = 0  # number of the sighting's first frame
    lines: Floats | None = None  # (C,C) epipolar errors [px]
    labels: dict[str, dict[str, int]] = field(default_factory=dict)
    hulls: dict[str, tuple[float, float]] = field(default_factory=dict)
    doubted: list[Frame] = field(default_factory=list)  # frames whose labels were looked at

    @property
    def wasted(self) -> bool:
        """Whether registering would be."""
        return any(finding.serious for finding in self.findings)


def inspect(path: Path) -> Inspection:
    """Looks at a capture folder. What keeps it from being opened is a finding, too."""
    found = Inspection(None, unpadded(path))
    try:
        found.capture = capture = open_capture(path)
    except UserError as error:
        found.findings.append(Finding(str(error)))
        return found
    found.findings += [Finding(warning, serious=False) for warning in capture.warnings]
    found.findings += gaps(capture.frames) + hollow(capture) + uneven(capture) + lacking(capture)
    found.findings += upended(capture) + unread(capture) + profiled(capture) + bare(capture) + repeated(capture)
    found.findings += off_centre(capture.cameras.values())
    found.facts |= {"frames": len(capture.frames), "cameras": len(capture.cameras)}
    _look(found, capture)
    _detections(found, capture)
    if not found.wasted:  # by cameras that are wrong nothing is told of scans and labels
        said = misread(capture.cameras, found.frames)  # which explains why scans lie elsewhere
        late = [] if said else out_of_step(capture, found.frames)  # of another moment, which explains it too
        aside = [] if said or late else displaced(capture.cameras, found.frames)
        found.findings += said or late + (aside or astray(capture.cameras, found.frames))
        found.findings += pictures_out_of_step(capture, found.frames)
        found.findings += [] if found.facts.get("stature m") else short(found.frames)
        _doubts(found, capture)
    found.findings.sort(key=lambda finding: not finding.serious)
    once: dict[str, Finding] = {}
    for finding in found.findings:
        once.setdefault(finding.text, finding)
    found.findings = list(once.values())
    return found


def _look(found: Inspection, capture: Capture) -> None:
    """The pictures, masks, labels and scans of a few frames."""
    shown = [n for n in capture.frames if any((capture.folder(n) / what).exists() for what in SHOWN)] or capture.frames
    if len(shown) < len(capture.frames):
        found.facts["frames by keypoints alone"] = len(capture.frames) - len(shown)
    pick = evenly(shown, SAMPLED)
    if capture.scene.garments and not capture.scene.segmenter and not any(map(capture.labelled, pick)):
        pick = sorted({*pick, *evenly([n for n in shown if capture.labelled(n)], LABELLED)})
    for number in pick:
        try:
            found.frames.append(capture.pictures(number))
        except UserError as error:
            found.findings.append(Finding(str(error)))
            continue
        if os.path.lexists(capture.folder(number) / "scan.ply"):
            try:
                scan = capture.frame(number).scan
                found.frames[-1] = replace(found.frames[-1], scan=scan)
            except UserError as error:
                found.findings.append(Finding(str(error)))
    found.findings += looks(found.frames) + blue_faces(capture, found.frames)
    found.frames = [without_specks(frame) for frame in found.frames]
    found.findings += exchanged(found.frames) + inside_out(found.frames)
    try:
        found.frames = asked(capture, found.frames)
    except UserError as error:
        found.findings.append(Finding(str(error)))
    found.labels, said = labels_seen(capture, found.frames)
    found.findings += exposures(found.frames) + said


def _detections(found: Inspection, capture: Capture) -> None:
    """Cameras against keypoints, or where fewer than two cameras see any against the middles of masks."""
    given, found.first = _sighting(found, capture)
    of_masks = given is None
    if given is None:
        masks = [frame.silhouettes for frame in found.frames]
        given = centroids(capture.cameras, [frame for frame in masks if len(frame) > 1])
    sighting = given.only(given.seeing)
    if len(sighting.cameras) < 2:
        return
    if together := in_one_place(sighting.cameras):
        found.findings += together
        return
    if not of_masks:  # first, as exchanged sides look like another calibration, or like another order of frames
        said, sighting = exchanged_sides(sighting, found.first, capture.scene.fps)
        found.findings += said
    what = "middles of masks" if of_masks else "keypoints"
    convention, errors = convention_of(sighting.thinned(DETECTIONS))
    if convention:
        text = f"cameras.json: {what} {_apart_by(errors[''])}; they miss by {errors[convention]:.1f} px if it is {convention}"
        found.findings.append(Finding(text))
        sighting = read_as(sighting, convention)
    elif errors[""] > agrees(sighting) and (elsewhere := off_pictures(sighting)):
        found.findings += elsewhere
        return
    elif errors[""] > agrees(sighting):
        text = f"cameras.json: {what} {_apart_by(errors[''])}, and no usual convention mends it"
        found.findings.append(Finding(f"{text}: is it the calibration of these cameras?"))
    if not of_masks:
        sighting, shifts = _in_step(found, sighting)
        said, sighting = somebody_else(sighting, found.first, shifts)
        found.findings += said
        _apart(found, sighting)
    found.sighting, found.meeting, found.lines = sighting, meet(sighting), epipolar(sighting)
    found.facts["error px"] = found.meeting.typical()
    if not of_masks:
        _person(found, capture, found.meeting)
    read, _ = CONVENTIONS[convention]
    _hulls(found, {camera.name: read(camera) for camera in given.cameras})


def _doubts(found: Inspection, capture: Capture) -> None:
    """Whether the labels can be right."""
    told = doubted(capture, found.frames, dict(_points(found, capture)))
    found.findings += told.findings
    found.facts |= told.facts
    found.doubted = told.frames


def _points(found: Inspection, capture: Capture) -> Iterator[tuple[int, Points3D]]:
    """Keypoints in space of the frames that were looked at, where they have some."""
    for frame in found.frames:
        try:
            own = capture.points3d(frame.number)
        except UserError as error:
            found.findings.append(Finding(str(error)))
            continue
        if own is not None:
            yield frame.number, own
        elif found.sighting is not None and found.meeting is not None and found.sighting.names != ("middle",):
            t = frame.number - found.first
            if 0 <= t < len(found.meeting.points):
                points = found.meeting.points[t]
                views = (found.sighting.weight[:, t] > SURE).sum(0)
                yield frame.number, Points3D(found.sighting.names, points, np.full(len(points), SIGMA), views)


def _apart_by(error: float) -> str:
    return f"miss one another by {error:.0f} px" if np.isfinite(error) else "meet behind the cameras"


def _sighting(found: Inspection, capture: Capture) -> tuple[Sighting | None, int]:
    """Keypoints of the frames in a row, absent frames without weight."""
    numbers = [n for n in capture.frames if os.path.lexists(capture.folder(n) / "keypoints.json")]
    numbers = [n for n in numbers if n < numbers[0] + READ]
    read: dict[int, Any] = {}
    for number in numbers:
        try:
            read[number] = read_keypoints(capture.folder(number) / "keypoints.json", capture.cameras)
        except UserError as error:
            found.findings.append(Finding(str(error), serious=False))
    if not read:
        return None, 0
    names = list(dict.fromkeys(name for keypoints in read.values() for name in keypoints.names))
    model = model_in_capture(capture.root, capture.scene.body_model, capture.scene.up)
    strange = check_names(names, model.keypoint_names)
    found.findings += [strange] if strange else []
    if not any((rows[:, 2] > UNSEEN).any() for keypoints in read.values() for rows in keypoints.points.values()):
        found.findings.append(Finding("keypoints: none is seen: all have a confidence of 0, or nearly", serious=False))
        return None, 0
    body = [name for name in names if name.startswith("body.") or name in FACING]
    names = body if len(body) >= ENOUGH else names
    cameras = [name for name in capture.cameras if any(name in keypoints.points for keypoints in read.values())]
    first = min(read)
    uv = np.zeros((len(cameras), max(read) - first + 1, len(names), 2))
    weight = np.zeros(uv.shape[:3])
    for number, keypoints in read.items():
        rows = [k for k, name in enumerate(keypoints.names) if name in names]
        at = [names.index(keypoints.names[k]) for k in rows]
        for i, camera in enumerate(cameras):
            if camera in keypoints.points:
                uv[i, number - first, at] = keypoints.points[camera][rows, :2]
                weight[i, number - first, at] = keypoints.points[camera][rows, 2]
    found.findings += at_origin(cameras, uv, weight) + blind(cameras, weight)
    weight[(uv == 0).all(-1)] = 0
    sighting = Sighting(tuple(capture.cameras[name] for name in cameras), tuple(names), uv, weight)
    return (sighting, first) if len(sighting.seeing) > 1 else (None, 0)


def _in_step(found: Inspection, sighting: Sighting) -> tuple[Sighting, dict[int, int]]:
    """The sighting put in step, and {camera: frames by which its pictures were taken from later ones}."""
    shifts = steps(sighting.thinned(DETECTIONS))[0]
    for i, shift in shifts.items():
        sighting = sighting.shifted(i, shift)
        name, way = sighting.cameras[i].name, "behind" if shift > 0 else "ahead of"
        text = f"{name}: out of step, its pictures are {abs(shift)} frames {way} the others'"
        found.findings.append(Finding(f"{text}; import with --offset {name}={shift}"))
    for i, step in fractions(sighting.thinned(DETECTIONS)).items():
        way = "behind" if step > 0 else "ahead of"
        text = f"{sighting.cameras[i].name}: out of step by parts of a frame, its pictures are {abs(step):.1f} frames {way} the others'"
        found.findings.append(Finding(f"{text}: no offset mends it, but a common trigger does", serious=False))
    return sighting, shifts


def _apart(found: Inspection, sighting: Sighting) -> None:
    """Cameras that disagree with the others, and such whose detections are all off to one side."""
    sighting = sighting.thinned(DETECTIONS)
    meeting = meet(sighting)
    aside = offsets(sighting, meeting)
    for i, reading in strangers(sighting, meeting).items():
        if not reading and i in aside:
            continue
        off = meeting.typical(i)
        text = f"{sighting.cameras[i].name}: its keypoints miss those of the others by {off:.0f} px"
        text = f"{text}; they would not if it is {reading}" if reading else text
        found.findings.append(Finding(text, serious=off > agrees(sighting)))
        aside.pop(i, None)
    for i, (u, v) in aside.items():
        text = f"{sighting.cameras[i].name}: its keypoints lie ({u:+.0f}, {v:+.0f}) px off as a whole"
        found.findings.append(Finding(f"{text}: principal point, a crop, or a lean of the camera", serious=False))


def _person(found: Inspection, capture: Capture, meeting: Meeting) -> None:
    assert found.sighting is not None
    tall = stature(found.sighting.names, meeting.points)
    found.facts["stature m"] = tall if np.isfinite(tall) else None
    units, order = check_units(tall, capture.scene.units), out_of_order(meeting.points)
    if not order and not (units and units.serious):  # by another unit everybody leaps
        order = leaps(meeting.points, found.first, capture.scene.fps)
    found.findings += order
    checks = [units]
    checks.append(check_up(upward(found.sighting.names, meeting.points), capture.scene.up))
    checks += [check(found.sighting.names, meeting.points) for check in (check_sides, check_bones)]
    found.findings += [finding for finding in checks if finding is not None]


def _hulls(found: Inspection, cameras: dict[str, Camera]) -> None:
    for frame in found.frames:
        masks = {name: mask for name, mask in frame.silhouettes.items() if name in cameras}
        found.hulls = coverage(cameras, masks)
        if found.hulls:
            break
    if not found.hulls:
        return
    whole = float(np.mean([share for share, _ in found.hulls.values()]))
    found.facts["hull covers %"] = 100 * whole
    if whole >= COVERED:
        return
    name = max(found.hulls, key=lambda n: found.hulls[n][1])
    best = found.hulls[name][1]
    others = float(np.median([rest for n, (_, rest) in found.hulls.items() if n != name]))
    text = f"masks: what all cameras see together covers {100 * whole:.0f} % of them"
    if best > others + CULPRIT:
        found.findings.append(Finding(f"{text}, {100 * best:.0f} % without {name}: its mask or its calibration is off"))
    else:
        found.findings.append(Finding(f"{text}: masks of other things, or another calibration", serious=False))
