"""Ways to spoil a captured frame or its start, so that registration goes wrong as it does on real data."""

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from toile.config import changed
from toile.io.run import open_run
from toile.scene import Mesh, Tracked
from toile.stages.dress import Dresser
from toile.stages.track import Tracker

# Each takes (prepared, frame, draw) and gives (frame, start or None, prepared): the frame as it is registered, the pose
# that it starts from, and what prepares it.


def nothing(prepared, frame, draw):
    return frame, None, prepared


def noise(prepared, frame, draw, sigma):
    """White noise on the scan's vertices [m]."""
    scan = frame.scan
    return (
        replace(frame, scan=_moved(scan, scan.vertices + sigma * draw.standard_normal(scan.vertices.shape))),
        None,
        prepared,
    )


def floor(prepared, frame, draw):
    """A square of floor, 1.4 m wide, under the feet."""
    up = "xyz".index(prepared.capture.scene.up)
    side, at = np.linspace(-0.7, 0.7, 60), frame.scan.vertices
    a, b = (i for i in range(3) if i != up)
    P = np.zeros((len(side) ** 2, 3))
    P[:, a], P[:, b] = (g.ravel() + c for g, c in zip(np.meshgrid(side, side), at[:, [a, b]].mean(0)))
    P[:, up] = at[:, up].min() - 0.003
    i = np.arange(len(P)).reshape(len(side), -1)
    q = np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]], -1).reshape(-1, 4)
    return _beside(frame, P, np.concatenate([q[:, :3], q[:, [0, 2, 3]]])), None, prepared


def second_person(prepared, frame, draw):
    """The same person once more, 0.7 m beside."""
    return _beside(frame, frame.scan.vertices + _horizontal(prepared, draw, 0.7), frame.scan.faces), None, prepared


def holes(prepared, frame, draw, share):
    """Round holes of 6 cm until a share of the scan's faces is gone."""
    scan = frame.scan
    middle = scan.vertices[scan.faces].mean(1)
    kept = np.ones(len(middle), bool)
    while kept.mean() > 1 - share:
        at = middle[draw.choice(np.flatnonzero(kept))]
        kept &= np.linalg.norm(middle - at, axis=1) > 0.06
    return _cut(frame, kept), None, prepared


def cut(prepared, frame, draw, part):
    """A part of the scan is missing: above or below the middle, or all on one side of the trunk."""
    scan = frame.scan
    middle, up = scan.vertices[scan.faces].mean(1), "xyz".index(prepared.capture.scene.up)
    low, high = np.percentile(middle[:, up], [1, 99])
    if part == "top":
        kept = middle[:, up] < low + 0.6 * (high - low)
    elif part == "bottom":
        kept = middle[:, up] > low + 0.5 * (high - low)
    else:
        across = _horizontal(prepared, draw, 1.0)
        side = (middle - middle.mean(0)) @ across
        kept = side < np.percentile(side, 70)
    return _cut(frame, kept), None, prepared


def moved_scan(prepared, frame, draw, way):
    """The scan lies beside the person whom the pictures show."""
    return (
        replace(frame, scan=_moved(frame.scan, frame.scan.vertices + _horizontal(prepared, draw, way))),
        None,
        prepared,
    )


def turned_scan(prepared, frame, draw, degrees):
    """The scan is turned about the up axis against the pictures, and there are no keypoints."""
    turn, middle = _about_up(prepared, np.radians(degrees)), frame.scan.vertices.mean(0)
    scan = _moved(frame.scan, (frame.scan.vertices - middle) @ turn.as_matrix().T + middle)
    return replace(frame, scan=scan, keypoints=None), None, prepared


def scaled_scan(prepared, frame, draw, factor):
    """The scan is of another size than the person that was prepared."""
    middle = frame.scan.vertices.mean(0)
    return replace(frame, scan=_moved(frame.scan, (frame.scan.vertices - middle) * factor + middle)), None, prepared


def wrong_start(prepared, frame, draw, degrees=0.0, way=0.0, limbs=0.0):
    """A start that is turned, moved, or of other limbs, without keypoints: a frame that got lost."""
    good = unspoilt(prepared, frame.number)
    r, root = good.rotations.copy(), good.rotations[0]
    r[0] = (_about_up(prepared, np.radians(degrees)) * Rotation.from_rotvec(root)).as_rotvec()
    big = [
        i
        for i, role in enumerate(prepared.model.joint_roles)
        if role.startswith(("upperarm01", "upperleg01", "lowerarm01"))
    ]
    r[big] += limbs * draw.standard_normal((len(big), 3))
    start = replace(good, rotations=r, translation=good.translation + _horizontal(prepared, draw, way))
    return replace(frame, keypoints=None), start, prepared


def keypoints(prepared, frame, draw, swap=False, pixels=0.0, share=0.0, scan=True):
    """Left and right swapped in every view, a bias a joint and view [px], a share of them anywhere; with or without a scan."""
    found = frame.keypoints
    names = list(found.names)
    other = {"left": "right", "right": "left"}
    mirror = []
    for name in names:
        for a, b in other.items():
            if a in name:
                name = name.replace(a, b)
                break
        mirror.append(names.index(name) if name in names else names.index(names[len(mirror)]))
    points = {}
    for camera, at in found.points.items():
        at = at[mirror].copy() if swap else at.copy()
        at[:, :2] += pixels * draw.standard_normal((len(at), 2))
        lost = draw.random(len(at)) < share
        at[lost, :2] = draw.uniform(0, 512, (lost.sum(), 2))
        points[camera] = at
    frame = replace(frame, keypoints=replace(found, points=points))
    return (frame if scan else replace(frame, scan=None)), None, prepared


def wrong_labels(prepared, frame, draw, share):
    """Patches of the person get another label, the same in every picture, until a share of the pictures' labels is wrong."""
    ids = np.array(list(prepared.capture.scene.labels.values()))
    scan, cameras = frame.scan, prepared.capture.cameras
    labels = {name: image.copy() for name, image in frame.labels.items()}
    total = sum((image > 0).sum() for image in labels.values())
    wrong = 0
    for _ in range(200):
        at, radius, label = scan.vertices[draw.integers(len(scan.vertices))], draw.uniform(0.06, 0.15), draw.choice(ids)
        for name, image in labels.items():
            uv, depth = cameras[name].project(at)
            y, x = np.ogrid[: image.shape[0], : image.shape[1]]
            disc = (x - uv[0]) ** 2 + (y - uv[1]) ** 2 < (radius * cameras[name].K[0, 0] / depth) ** 2
            change = disc & (image > 0) & (image != label) & (image == frame.labels[name])
            image[change] = label
            wrong += change.sum()
        if wrong > share * total:
            break
    return replace(frame, labels=labels), None, prepared


def empty_mask(prepared, frame, draw):
    """The mask of one camera, any, is empty, as where a segmenter found nobody."""
    name = draw.choice(sorted(frame.masks))
    return replace(frame, masks={**frame.masks, name: np.zeros_like(frame.masks[name])}), None, prepared


def labels_apart(prepared, frame, draw, pixels):
    """Label pictures that lie pixels lower than the picture: of another moment, or another crop."""
    labels = {name: np.roll(image, pixels, 0) for name, image in frame.labels.items()}
    return replace(frame, labels=labels), None, prepared


def template(prepared, frame, draw, factor=1.0, lower=0.0):
    """The garment's template is of another size, or was made lower on the body [m], after its preparation."""
    down = lower * np.eye(3)["xyz".index(prepared.capture.scene.up)]
    rests = [(t.rest - t.rest.mean(0)) * factor + t.rest.mean(0) - down for t in prepared.templates]
    return frame, None, _with_rests(prepared, rests)


def short_end(prepared, frame, draw, way, reach=0.12):
    """One end of the garment's template, any, is shorter [m]: what lies within `reach` [m] of its loop is drawn in."""
    rests = []
    for t in prepared.templates:
        loop = t.rest[t.loops[draw.integers(len(t.loops))]]
        share = np.clip(1 - cKDTree(loop).query(t.rest)[0] / reach, 0, 1)[:, None]
        inwards = t.rest[share[:, 0] > 0].mean(0) - loop.mean(0)
        rests.append(t.rest + way * share * inwards / np.linalg.norm(inwards))
    return frame, None, _with_rests(prepared, rests)


def _with_rests(prepared, rests):
    """The same with templates of other rest shapes."""
    settings = prepared.config.dress
    changed_ones = [replace(t, rest=rest) for t, rest in zip(prepared.templates, rests)]
    dressers = tuple(
        Dresser(prepared.model, prepared.person, t, settings, d.over) for t, d in zip(changed_ones, prepared.dressers)
    )
    return instead(prepared, templates=tuple(changed_ones), dressers=dressers)


def out_of_step(prepared, frame, draw):
    """The keypoints and pictures are of another frame, ten later or earlier."""
    frames = prepared.capture.frames
    other = frames[(frames.index(frame.number) + min(10, len(frames) // 2)) % len(frames)]
    return replace(prepared.capture.frame(other), number=frame.number, scan=frame.scan), None, prepared


SPOILINGS = {
    "nothing": nothing,
    "no keypoints": lambda p, f, d: (replace(f, keypoints=None), None, p),
    "scan noise 2 mm": partial(noise, sigma=0.002),
    "floor": floor,
    "30 % holes": partial(holes, share=0.3),
    "60 % holes": partial(holes, share=0.6),
    "keypoints off by 8 px": partial(keypoints, pixels=8.0),
    "keypoints swapped": partial(keypoints, swap=True),
    "40 % keypoints anywhere": partial(keypoints, share=0.4),
    "no scan": partial(keypoints, scan=False),
    "no scan, keypoints off by 15 px": partial(keypoints, pixels=15.0, scan=False),
    "scan 30 cm beside": partial(moved_scan, way=0.3),
    "scan 8 cm beside": partial(moved_scan, way=0.08),
    "scan turned by 60": partial(turned_scan, degrees=60),
    "scan turned by 180": partial(turned_scan, degrees=180),
    "scan 15 % larger": partial(scaled_scan, factor=1.15),
    "scan 12 % smaller": partial(scaled_scan, factor=0.88),
    "scan without top": partial(cut, part="top"),
    "scan without bottom": partial(cut, part="bottom"),
    "scan without a side": partial(cut, part="side"),
    "second person": second_person,
    "out of step": out_of_step,
    "start turned by 45": partial(wrong_start, degrees=45),
    "start turned by 90": partial(wrong_start, degrees=90),
    "start turned by 180": partial(wrong_start, degrees=180),
    "start turned by 270": partial(wrong_start, degrees=270),
    "start 25 cm beside": partial(wrong_start, way=0.25),
    "start of other limbs": partial(wrong_start, limbs=0.6),
    "start of quite other limbs": partial(wrong_start, limbs=1.2),
    "30 % wrong labels": partial(wrong_labels, share=0.3),
    "50 % wrong labels": partial(wrong_labels, share=0.5),
    "labels 40 px lower": partial(labels_apart, pixels=40),
    "an empty mask": empty_mask,
    "template 30 % larger": partial(template, factor=1.3),
    "template 25 % smaller": partial(template, factor=0.75),
    "template 12 cm lower": partial(template, lower=0.12),
    # Little enough to be missed.
    "scan 2 cm beside": partial(moved_scan, way=0.02),
    "scan 4 cm beside": partial(moved_scan, way=0.04),
    "scan turned by 20": partial(turned_scan, degrees=20),
    "scan 6 % larger": partial(scaled_scan, factor=1.06),
    "scan 5 % smaller": partial(scaled_scan, factor=0.95),
    "start of slightly other limbs": partial(wrong_start, limbs=0.3),
    "template 12 % larger": partial(template, factor=1.12),
    "template 10 % smaller": partial(template, factor=0.9),
    "template 6 cm lower": partial(template, lower=0.06),
    "template with an end 5 cm short": partial(short_end, way=0.05),
}


OF_GARMENTS = [name for name in SPOILINGS if "label" in name or "template" in name]  # nothing of them reaches the body


def unspoilt(prepared, number):
    """How the run itself tracked a frame, as a start."""
    run, nothing = open_run(prepared.folder.parent), np.zeros((0, 3))
    return Tracked(run.track.at(number), *run.pose.at(number), nothing, run.track.confidence.at(number), {})


def unsearched(prepared):
    """The same, whose tracker never searches a pose."""
    config = changed(prepared.config, {"track.headings": 0})
    return instead(prepared, config=config, tracker=Tracker(prepared.model, prepared.person, config.track))


def instead(prepared, **fields):
    """A copy with other fields, and with what was already made of the others."""
    other = replace(prepared, **fields)
    if prepared.capture.scene.garments:
        other.__dict__["inner"] = prepared.inner
    return other


def _moved(scan, V):
    return Mesh(V, scan.faces, face_labels=scan.face_labels)


def _cut(frame, kept):
    scan = frame.scan
    labels = None if scan.face_labels is None else scan.face_labels[kept]
    used, F = np.unique(scan.faces[kept], return_inverse=True)
    return replace(frame, scan=Mesh(scan.vertices[used], F.reshape(-1, 3).astype(np.int32), face_labels=labels))


def _beside(frame, V, F):
    """The frame with another mesh in its scan."""
    scan = frame.scan
    faces = np.concatenate([scan.faces, F + len(scan.vertices)]).astype(np.int32)
    labels = None if scan.face_labels is None else np.concatenate([scan.face_labels, np.zeros(len(F), np.uint8)])
    return replace(frame, scan=Mesh(np.concatenate([scan.vertices, V]), faces, face_labels=labels))


def _horizontal(prepared, draw, length):
    """A vector (3,) of this length across the up axis, anywhere."""
    angle, up = draw.uniform(0, 2 * np.pi), "xyz".index(prepared.capture.scene.up)
    way = np.zeros(3)
    way[[i for i in range(3) if i != up]] = length * np.cos(angle), length * np.sin(angle)
    return way


def _about_up(prepared, angle):
    return Rotation.from_rotvec(angle * np.eye(3)["xyz".index(prepared.capture.scene.up)])
