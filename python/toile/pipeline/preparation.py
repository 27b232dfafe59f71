"""What all frames of a run need, made once from sampled frames and kept in RUN/prepared: the person, the labels' colours,
each garment's template."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path

import numpy as np

from ..config import Config
from ..io.body import model_in_capture
from ..io.capture import Capture
from ..io.files import identity_of, load_record, save_record
from ..io.holdout import apart
from ..io.image import read_rgba
from ..io.status import Status
from ..measure.inspection.aside import displaced
from ..measure.inspection.body import STANDING, check_up, upward
from ..measure.inspection.doubts import doubted_on
from ..measure.inspection.late import out_of_step
from ..measure.inspection.outlines import exchanged
from ..measure.inspection.readings import misread, scanned, with_outlines
from ..measure.inspection.scans import inside_out
from ..prints.aligner import PrintAligner
from ..prints.lengths import true_lengths
from ..scene import BodyModel, GarmentTemplate, InnerShape, Person, Segmented
from ..stages import dress, inner, motion, prints, segment, track
from ..surface.curves import Curve
from ..vision.colours import ColourModel
from ..vision.limb_colours import LimbCloth, parts_of
from ..vision.thin_pictures import thin_cameras
from ..vision.threads import parallel_map
from .identity import Identities
from .samples import as_labels_see, samples_of
from .template import Worn, template_from_scan, template_on_body

COLOURS = {"colours": ColourModel, "cloth": LimbCloth}  # records of a SegmentModel
LARGE = 1 << 22  # pixels of a frame above which what its thinned pictures say is gathered twice, not kept


@dataclass
class PreparedRun:
    """What the stages of every frame need; each process loads its own."""

    capture: Capture
    config: Config
    model: BodyModel
    person: Person
    folder: Path  # RUN/prepared
    tracker: track.Tracker
    identities: Identities
    colours: segment.SegmentModel | None = None  # these where the scene names a garment
    templates: tuple[GarmentTemplate, ...] = ()
    dressers: tuple[dress.Dresser, ...] = ()

    @cached_property
    def aligner(self) -> PrintAligner:
        """Slides printed garments."""
        printed = [garment.name for garment in self.capture.scene.garments if garment.prints]
        meshes = {
            name: mesh for name, mesh in self.capture.templates.items() if name not in self.config.template_from_scan
        }
        own = {t.name: t for t in self.templates if t.name in printed}
        lengths = {name: true_lengths(meshes.get(name), t.rest, t.faces) for name, t in own.items()}
        cameras, settings = self.capture.cameras, self.config.prints
        drawn = {
            name: path for name, path in self.capture.textures.items() if name in meshes and meshes[name].uv is not None
        }
        textures = {name: read_rgba(path)[..., :3] for name, path in drawn.items()}
        return prints.prepare(self.model, self.person, self.templates, lengths, cameras, settings, textures)

    @cached_property
    def smoother(self) -> motion.Smoother:
        """Smooths consecutive frames."""
        return motion.Smoother(self.model, self.person, self.templates, self.config.motion, self.capture.scene.fps)

    @cached_property
    def fusion(self) -> inner.Fusion:
        """Fuses the body's shape of every frame."""
        return inner.Fusion(self.model, self.person, self.templates, self.config.inner)

    @cached_property
    def inner(self) -> inner.InnerLayer:
        """Solves the inner layer, once the body's shape is fused."""
        shape = load_record(self.folder / "inner.npz", InnerShape)
        return inner.InnerLayer(self.model, self.person, shape, self.templates, self.config.inner)


def prepare(capture, run, config, identities, progress=lambda *_: None) -> PreparedRun:
    """Makes what RUN/prepared does not hold as `identities` ask for it, and loads it."""
    progress("prepare", 0, 1)
    folder = run / "prepared"
    model = model_in_capture(capture.root, capture.scene.body_model, capture.scene.up)
    fitted = cache(lambda: _fitted(model, samples_of(capture, run, config, identities), config.track))

    def found():
        samples, person, tracked, unfit = fitted()
        of_scans = _said_of_scans(model, person, capture.scene.up, samples, tracked)
        of_masks = _said_of_masks(capture, config, [frame for frame, _ in samples])
        _say(Status.of(run), "prepare", [*unfit, *of_scans, *of_masks])
        return person

    person = kept(folder / "person.npz", Person, found, identities.stages["person"])
    prepared = PreparedRun(
        capture, config, model, person, folder, track.Tracker(model, person, config.track), identities
    )
    if capture.scene.garments:

        def tracked():
            samples, _, found, _ = fitted()
            return [(as_labels_see(frame, config), one) for (frame, _), one in zip(samples, found)]

        _prepare_garments(prepared, tracked, Status.of(run))
    progress("prepare", 1, 1)
    return prepared


def _fitted(model, samples, settings):
    """Samples [(Frame, Points3D | None)] that a body fits, the Person that they show, their Tracked, and what is said of those that
    fit none, which fail for themselves. UserError: none fits."""
    said = []
    while True:
        try:
            return samples, *track.prepare(model, samples, settings), said
        except track.Unmatched as error:
            left = [(frame, points) for frame, points in samples if frame.number not in error.numbers]
            if not left:
                raise
            samples, said = left, [*said, f"{error}: the person is made without"]


def kept(path, kind, make, identity, **records):
    """The record of this path, made when it is not there or of something else than `identity` says."""
    if identity_of(path, whole=True) != identity:
        save_record(path, make(), identity)
    return load_record(path, kind, **records)


def _prepare_garments(prepared, tracked, status):
    """The colour models, and of each garment the template as large as this person's, and its Dresser; `tracked()` gives
    the sampled frames [(Frame, Tracked)]."""
    scene, config, model, person = prepared.capture.scene, prepared.config, prepared.model, prepared.person
    paths = [prepared.folder / f"template.{garment.name}.npz" for garment in scene.garments]
    colours = prepared.folder / "colours.npz"
    ids = prepared.identities.stages
    if identity_of(colours, True) != ids["colours"] or any(
        identity_of(path, True) != ids["template"] for path in paths
    ):
        samples = tracked()
        cameras = thin_cameras(prepared.capture.cameras, config.picture_side)
        learn = partial(segment.prepare, scene, cameras, samples, model.f, config.segment, parts_of(model))
        made = kept(colours, segment.SegmentModel, learn, ids["colours"], **COLOURS)
        said = _said(scene, model, cameras, samples, made.cloth, config)
        _say(status, "dress", (*prepared.capture.warnings, *said))
        wanted = samples if config.template_from_scan else dress.fit_samples(samples, config.dress)
        evidenced = parallel_map(partial(_evidenced, prepared, made), wanted)
        for garment, path in zip(scene.garments, paths):
            save_record(path, _template(prepared, garment, evidenced, status), ids["template"])
    prepared.colours = load_record(colours, segment.SegmentModel, **COLOURS)
    prepared.templates = tuple(load_record(path, GarmentTemplate, ("loops",)) for path in paths)
    prepared.dressers = tuple(
        dress.Dresser(model, person, template, config.dress, _over(scene, template.name))
        for template in prepared.templates
    )


def _say(status, stage, texts):
    """What a stage warns of, in place of what it warned of before."""
    status.forget(stage)
    for text in texts:
        status.add(stage=stage, ok=False, warning=text)


def _said_of_scans(model, person, up, samples, tracked):
    """What to warn of sampled frames [(Frame, ...)] that were tracked: scans that look inwards, a body that does not stand up."""
    roles = [f"{joint}.{side}" for joint in STANDING for side in "LR" if model.joint(f"{joint}.{side}") is not None]
    places = [model.joint_transforms(person.J, t.rotations, t.translation)[1] for t in tracked]
    along = upward(tuple(f"body.{role}" for role in roles), np.array(places)[:, [model.joint(role) for role in roles]])
    lies = check_up(along, up)
    return [finding.text for finding in (*inside_out([frame for frame, *_ in samples]), *([lies] if lies else []))]


def _said_of_masks(capture, config, frames):
    """What to warn of the scans of sampled frames, whose pictures are thinned, against masks; none of those held out is read."""
    cameras = thin_cameras(capture.cameras, config.picture_side)
    if not capture.scene.garments:  # whose samples hold no pictures
        frames = [with_outlines(capture, frame, config.picture_side) for frame in scanned(frames)]
    doubts = misread(cameras, frames) or out_of_step(capture, frames, apart(capture.frames, config.holdout))
    doubts = doubts or displaced(cameras, frames)
    return [doubt.text for doubt in doubts]


def _said(scene, model, cameras, samples, cloth, config):
    """What to warn of labels and pictures of sampled frames [(Frame, Tracked)]."""
    told = lambda frame, tracked: segment.believed(frame, frame.labels, cameras, cloth, tracked, model.f)
    doubts = doubted_on(scene, model, cameras, [(told(frame, tracked), tracked.vertices) for frame, tracked in samples])
    coarse = segment.coarse_pictures(cameras, samples, config.segment)
    taken = cloth and cloth.words(scene)
    doubts = [*exchanged([frame for frame, _ in samples]), *doubts]
    doubted = [*([taken] if taken else []), *(doubt.text for doubt in doubts)]
    return *coarse, *segment.unlabelled_pictures(samples), *doubted


def _template(prepared, garment, evidenced, status):
    """The GarmentTemplate of a garment of the scene; what its preparation warned of goes to the status."""
    capture, over = prepared.capture, _over(prepared.capture.scene, garment.name)
    label, mesh = capture.scene.labels[garment.label], capture.templates.get(garment.name)
    settings, model = prepared.config.dress, prepared.model
    shown, changes = [(tracked, segmented) for _, tracked, segmented, _ in evidenced], []
    worn = Worn.of(model, prepared.person, shown, capture.scene)
    if garment.name in prepared.config.template_from_scan:
        mesh = template_from_scan(model, worn, garment, label)
    elif shown:
        mesh, changes = template_on_body(model, worn, garment, label, mesh, settings.placement, bool(over))
    for change in changes:
        status.add(stage="dress", ok=False, warning=change)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        samples = dress.fit_samples(evidenced, settings)
        template = dress.prepare(model, prepared.person, garment, label, mesh, samples, settings, over)
    for warning in caught:
        status.add(stage="dress", ok=False, warning=str(warning.message))
    return template


def _over(scene, name):
    """Label ids of the garments that are worn over a garment."""
    names = [garment.name for garment in scene.garments]
    return [scene.labels[garment.label] for garment in scene.garments[names.index(name) + 1 :]]


def _evidenced(prepared, colours, sample):
    """A sampled (Frame, Tracked) as `dress.prepare` takes it; evidence of large pictures is gathered again there."""
    fine = {"refine_border": True}
    found, evidence = segmented(prepared, colours, *sample, None, **fine)
    pixels = sum(view.depth.size for view in evidence.views.values())
    return (
        *sample,
        found,
        partial(evidence_of, prepared, colours, *sample, **fine) if pixels > LARGE else lambda: evidence,
    )


def segmented_again(prepared, frame, tracked, path):
    """(Segmented, Evidence) of a frame `as_labels_see` it, whose Segmented lies in a file."""
    found, evidence = load_record(path, Segmented), evidence_of(prepared, prepared.colours, frame, tracked)
    curves = lambda of: [Curve(np.array(curve["points"]), curve["closed"]) for curve in of]
    return replace(found, openings={int(label): curves(of) for label, of in found.openings.items()}), evidence


def segmented(prepared, colours, frame, tracked, previous, **changes):
    """(Segmented, Evidence) of a frame `as_labels_see` it, by the settings of the stage with these changes."""
    capture, faces = prepared.capture, prepared.model.f
    settings = prepared.config.segment.model_copy(update=changes)
    evidence = evidence_of(prepared, colours, frame, tracked, **changes)
    votes = [vote for vote in capture.votes if vote.frames is None or frame.number in vote.frames]
    return segment.segment(capture.scene, evidence, colours, tracked, faces, settings, previous, votes), evidence


def evidence_of(prepared, colours, frame, tracked, **changes):
    """The Evidence of a frame `as_labels_see` it."""
    settings = prepared.config.segment.model_copy(update=changes)
    cameras = thin_cameras(prepared.capture.cameras, prepared.config.picture_side)
    return segment.evidence(frame, cameras, colours, tracked, prepared.model.f, settings)
