"""What is said of labels that can hardly be right: the network of the scene is asked about a few pictures, then masks, colours
and templates are held against what it, or anyone else, gave."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np

from ...frame_numbers import evenly
from ...io.body import model_in_capture
from ...io.capture import Capture
from ...kernels.arrays import Floats
from ...scene import BodyModel, Camera, Frame, Points3D, Scene
from ...vision.limb_colours import REFERENCE, SEEN_BARE, WORN, cover_of, odd_parts, surely_covered
from ...vision.segmenters.asked import labelled
from ...vision.thin_pictures import thin_cameras, thin_pictures
from .cameras import Finding
from .clothed import Clothed, Reading, bare, clothed, read_labels
from .labels import alike, between_others, off_masks, on_template, skin_colours

FRAMES, VIEWS = 2, 8  # that are looked at
SIDE = 768  # px, longer side, to which a run's pictures are thinned for this
KINDS = ("images", "masks", "labels", "certainty")
OFF = 0.15  # share of a label image that lies off the mask
OWN = 0.7  # of a template's seen area carries the garment's label
ALIKE, PICTURES = 0.85, 3  # colours of both sides of a border that pictures do not show, and how many pictures must
HARDLY = 0.005  # share of what label images show
BETWEEN, PLACES = 0.15, 200  # of a border's places, whose ids lie between their neighbours', and how many there must be
UNSURE, DOUBTED = 0.5, 0.15  # certainty of an unsure pixel, and share of the person's pixels

Posed = list[tuple[Frame, Clothed, Reading]]


@dataclass
class Doubts:
    """What was found of labels, the frames that were looked at with no more than the pictures of these cameras, and figures
    for the page."""

    findings: list[Finding] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    facts: dict[str, float | None] = field(default_factory=dict)


def asked(capture: Capture, frames: Sequence[Frame]) -> list[Frame]:
    """`frames`, some with labels of the scene's network: FRAMES of them, in VIEWS of those pictures that have no label image.
    UserError: the network cannot serve."""
    found = list(frames)
    for i in evenly(range(len(frames)), FRAMES) if capture.scene.segmenter else ():
        missing = [name for name in frames[i].images if name not in frames[i].labels]
        told = labelled(capture, _only(frames[i], evenly(missing, VIEWS))) if missing else frames[i]
        found[i] = replace(frames[i], labels=frames[i].labels | told.labels, certainty=told.certainty)
    return found


def doubted(capture: Capture, frames: Sequence[Frame], points: Mapping[int, Points3D]) -> Doubts:
    """Doubts about the labels of some frames; `points` are keypoints in space by the frame's number. Nothing of a scene
    without garments, which asks for no labels."""
    looked = _looked_at(capture.scene, frames)
    if not looked:
        return Doubts()
    scene, model = capture.scene, model_in_capture(capture.root, capture.scene.body_model, capture.scene.up)
    posed = list(_posed(capture, model, looked, points))
    found = [*_of_labels(scene, model, looked, posed, ahead=True), *_of_templates(scene, posed)]
    unsure = _unsure(looked)
    return Doubts(found, looked, {} if np.isnan(unsure) else {"labels unsure %": 100 * unsure})


def doubted_on(
    scene: Scene, model: BodyModel, cameras: Mapping[str, Camera], samples: Sequence[tuple[Frame, Floats]]
) -> list[Finding]:
    """Doubts about the labels of frames whose body is known, (Frame, its vertices (n,3) [m]); of templates nothing is asked.
    Nothing of frames without label images."""
    bodies, cameras = {frame.number: V for frame, V in samples}, thin_cameras(cameras, SIDE)
    looked = [thin_pictures(frame, SIDE) for frame in _looked_at(scene, [frame for frame, _ in samples])]
    made = [bare(model, bodies[frame.number]) for frame in looked]
    posed = [(frame, body, read_labels(cameras, frame.labels, body)) for frame, body in zip(looked, made)]
    return list(_of_labels(scene, model, looked, posed, ahead=False)) if looked else []


def _looked_at(scene: Scene, frames: Sequence[Frame]) -> list[Frame]:
    """FRAMES of those that show labels, with VIEWS of the pictures that do; none where no garment asks for labels."""
    told = [frame for frame in frames if any(image.any() for image in frame.labels.values())]
    shown = lambda frame: [name for name, image in frame.labels.items() if image.any()]
    return [_only(frame, evenly(shown(frame), VIEWS)) for frame in evenly(told, FRAMES)] if scene.garments else []


def _only(frame: Frame, names: Sequence[str]) -> Frame:
    """A frame with the pictures of these cameras alone."""
    return replace(frame, **{kind: {n: of for n, of in getattr(frame, kind).items() if n in names} for kind in KINDS})


def _posed(
    capture: Capture, model: BodyModel, frames: Sequence[Frame], points: Mapping[int, Points3D]
) -> Iterator[tuple[Frame, Clothed, Reading]]:
    """Of the frames whose keypoints pose the body, it and what the label images say of it."""
    for frame in frames:
        made = clothed(capture, model, frame, points[frame.number]) if frame.number in points else None
        if made is not None:
            yield frame, made, read_labels(capture.cameras, frame.labels, made)


def _of_labels(scene: Scene, model: BodyModel, looked: Sequence[Frame], posed: Posed, ahead: bool) -> Iterator[Finding]:
    """All that is said of labels, but for templates; `ahead` of a registration, which will tell a network's legs again."""
    yield from _of_garments(scene, looked)
    yield from _of_masks(looked)
    yield from _of_scaling(looked)
    yield from _of_borders(scene, looked)
    yield from _of_skin(scene, model, posed, ahead)
    unsure = _unsure(looked)
    if unsure > DOUBTED:
        text = f"labels: the network is unsure of {100 * unsure:.0f} % of the person's pixels"
        yield Finding(text, serious=False)


def _of_garments(scene: Scene, frames: Sequence[Frame]) -> Iterator[Finding]:
    """Garments whose label is hardly anywhere; of one that is nowhere `labels_seen` says so."""
    images = [image for frame in frames for image in frame.labels.values()]
    person = sum(int((image > 0).sum()) for image in images)
    for garment in scene.garments:
        share = sum(int((image == scene.labels[garment.label]).sum()) for image in images) / person
        if 0 < share < HARDLY:
            text = f"garment {garment.name}: its label is on {100 * share:.2g} % of what the label images show"
            yield Finding(f"{text}: is it labelled otherwise?", serious=False)


def _of_masks(frames: Sequence[Frame]) -> Iterator[Finding]:
    """Label images that show somebody elsewhere than the masks do."""
    shares: dict[str, list[float]] = {}
    for name, share in (pair for frame in frames for pair in off_masks(frame)):
        shares.setdefault(name, []).append(share)
    odd = {name: median(of) for name, of in shares.items() if median(of) > OFF}
    if odd:
        text = f"{', '.join(odd)}: {100 * median(odd.values()):.0f} % of what the label images show lies off the masks"
        yield Finding(f"{text}: are they of other cameras or frames, or mirrored?", serious=False)


def _of_scaling(frames: Sequence[Frame]) -> Iterator[Finding]:
    """Label images whose ids were interpolated."""
    told: dict[str, list[tuple[int, int]]] = {}
    for name, image in (pair for frame in frames for pair in frame.labels.items()):
        told.setdefault(name, []).append(between_others(image))
    counts = {name: np.sum(of, axis=0) for name, of in told.items()}
    odd = {name: between / places for name, (places, between) in counts.items() if places >= PLACES}
    odd = {name: share for name, share in odd.items() if share > BETWEEN}
    if odd:
        text = f"{', '.join(odd)}: at {100 * median(odd.values()):.0f} % of the borders of their label images lie seams of ids between"
        ask = "were they scaled by interpolation? Ids ask for the nearest pixel"
        yield Finding(f"{text} those of both sides: {ask}", serious=False)


def _of_borders(scene: Scene, frames: Sequence[Frame]) -> Iterator[Finding]:
    """Borders of garments' labels that the pictures do not show."""
    own = list(dict.fromkeys(garment.label for garment in scene.garments))
    for k, name in enumerate(own):
        for other in (label for label in scene.labels if label not in own[: k + 1]):
            if scene.labels[other] == scene.labels[name]:
                continue
            found = [x for frame in frames for x in alike(frame, scene.labels[name], scene.labels[other])]
            if len(found) >= PICTURES and median(found) >= ALIKE:
                many = sum(x >= ALIKE for x in found)
                text = f"labels: in {many} of {len(found)} pictures nothing is seen of the border between '{name}' and '{other}'"
                yield Finding(f"{text}: it is elsewhere, or both have the same colours", serious=False)


def _of_skin(scene: Scene, model: BodyModel, posed: Posed, ahead: bool) -> Iterator[Finding]:
    """Limbs that are labelled skin, of other colours than the skin of head and hands, or where the scene has trousers."""
    if "skin" not in scene.labels or not posed:
        return
    told = [skin_colours(model, frame, reading, scene.labels["skin"]) for frame, _, reading in posed]
    bare = [part for part in told[0] if part in REFERENCE or np.mean([of[part][0] for of in told]) > WORN]
    odd = odd_parts({part: np.concatenate([of[part][1] for of in told]) for part in bare})
    long, network = surely_covered(scene), all(frame.certainty for frame, _, _ in posed)
    thighs = np.mean([of["upper legs"][0] for of in told]) > (SEEN_BARE if network else WORN)
    asked = odd or (["upper legs"] if long and thighs else [])
    taken = dict.fromkeys(cover_of(scene, part) for part in asked if cover_of(scene, part))
    again = ahead and taken and network
    then = f"; register takes it for '{', '.join(taken)}'" if again else ": is it cloth?"
    if odd:
        text = f"labels: 'skin' on the {' and the '.join(odd)} has other colours than on head and hands{then}"
        yield Finding(text, serious=False)
    elif asked:
        text = f"labels: the upper legs are labelled 'skin', but the scene has '{long}'{then}"
        yield Finding(text, serious=False)


def _of_templates(scene: Scene, posed: Posed) -> Iterator[Finding]:
    """Garments whose label lies on too little of their templates."""
    ids = np.array(sorted(set(scene.labels.values())))
    for i, garment in enumerate(scene.garments):
        over = [scene.labels[worn.label] for worn in scene.garments[i + 1 :] if worn.label != garment.label]
        areas = np.sum([on_template(made, reading, ids, i, over) for _, made, reading in posed], axis=0)
        own = ids == scene.labels[garment.label]
        if not np.sum(areas) > 0 or areas[own][0] >= OWN * areas.sum():
            continue
        other = ids[np.where(own, 0, areas).argmax()]
        name = next(name for name, number in scene.labels.items() if number == other)
        text = f"garment {garment.name}: {100 * areas[own][0] / areas.sum():.0f} % of what is seen of its template carries its label"
        text = f"{text}, {100 * areas[ids == other][0] / areas.sum():.0f} % '{name}'"
        yield Finding(f"{text}: the labels are wrong, or the template is of another cut", serious=False)


def _unsure(frames: Sequence[Frame]) -> float:
    """Share of the person's pixels of which the network is unsure; NaN where it was not asked."""
    pairs = [(frame.labels[name] > 0, sure) for frame in frames for name, sure in frame.certainty.items()]
    person = sum(int(on.sum()) for on, _ in pairs)
    return sum(int((sure[on] < 255 * UNSURE).sum()) for on, sure in pairs) / person if person else float("nan")
