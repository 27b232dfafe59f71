"""Garment templates cut from tracked surfaces along their labels: by `toile template` of a run, and within a run for the
garments that `template_from_scan` names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from .. import kernels
from ..config import Config, PlacementSettings
from ..errors import UserError
from ..io.capture import Capture
from ..io.files import output_file
from ..io.mesh import write_mesh
from ..io.run import Run, open_run
from ..scene import BodyModel, Garment, GarmentTemplate, Mesh, Person, Scene, Segmented, Tracked
from ..stages.template import REACH, make_template, worn_region
from ..surface.placing import check_near_body, off_body, place_template
from ..surface.transfer import move_with_body

Sample = tuple[Tracked, Segmented]
UNDER = 0.1  # a part of the body over which a template lies no higher is under it [m]
RIM = 0.04  # so near to its openings cloth may lie another way [m]
OTHER = 0.12  # share of the body under a template from which another label on it is named


def template_of_run(run: Run, name: str, label: str) -> GarmentTemplate:
    """The template of a garment `name` worn where the tracked surface has a label of the run's scene, in the body model's
    own rest pose, where `dress.prepare` expects it. UserError: no such label, or no region of it with an opening."""
    ids = run.scene.labels
    if run.labels is None:
        raise UserError(f"{run.path}: labels: the run has none, its scene names no garment")
    if label not in ids:
        raise UserError(f"--label {label}: the run knows {', '.join(ids)}")
    return _cut(run.body_model, person_of(run), name, ids[label], run.labels[run.rows()])


def template_from_scan(model: BodyModel, worn: Worn, garment: Garment, label: int) -> Mesh:
    """The template of a garment as the sampled frames' tracked surfaces show it, in the body model's own rest pose."""
    try:
        made = _cut(model, worn.person, garment.name, label, worn.labels)
    except UserError as error:
        raise UserError(f"template_from_scan {garment.name}: {error}") from None
    return Mesh(made.rest, made.faces, made.uv, made.face_uv)


@dataclass(frozen=True)
class Worn:
    """The person's rest surface as sampled frames show it clothed, and its labels (T,n); `names` {label id: name}, `by`: the
    network that gave them, if one did."""

    person: Person
    labels: np.ndarray
    names: Mapping[int, str] = field(default_factory=dict)
    by: str = ""

    @staticmethod
    def of(model: BodyModel, person: Person, samples: Iterable[Sample], scene: Scene) -> Worn:
        """The median of the tracked surfaces, unposed."""
        poses, labels = [], []
        for tracked, segmented in samples:
            poses.append(model.unskin(tracked.vertices, person.J, tracked.rotations, tracked.translation))
            labels.append(segmented.vertices)
        clothed = replace(person, rest=np.median(poses, axis=0)) if poses else person
        names = {number: name for name, number in scene.labels.items()}
        return Worn(clothed, np.array(labels), names, scene.segmenter)

    def region(self, model: BodyModel, garment: Garment, label: int) -> Mesh:
        """Where the body model at rest carries a garment. UserError: nowhere."""
        try:
            V, F = worn_region(model, self.person, garment.name, label, self.labels)
        except UserError as error:
            raise UserError(f"garment {garment.name}: {error}: is it worn?") from None
        return Mesh(move_with_body(V, self.person.rest, model.v_template, REACH), F)


def template_on_body(
    model: BodyModel,
    worn: Worn,
    garment: Garment,
    label: int,
    mesh: Mesh,
    settings: PlacementSettings,
    covered: bool = False,
) -> tuple[Mesh, list[str]]:
    """A capture's template as it lies on the body model at rest, and what was changed of it; see surface/placing.py. One
    that is worn under another, `covered`, shows only a part: it must lie on the body as it is. UserError: it cannot be laid,
    with what speaks against the labels, which may be at fault as well."""
    if covered:
        check_near_body(model, garment.name, mesh, settings)
        return mesh, []
    region, other = worn.region(model, garment, label), _labelled_otherwise(model, worn, mesh, label)
    by = f" by the network '{worn.by}'" if worn.by else ""
    try:
        placed, words = place_template(model, garment.name, mesh, region, settings)
    except UserError as error:
        covers, large = (kernels.face_areas(of.vertices, of.faces).sum() for of in (region, mesh))
        against = f"the labels{by} are wrong: they give the garment {covers:.2f} m2 of the body, its template has {large:.2f} m2"
        raise UserError(f"{error}; or {against}{f', {other}' if other else ''}: see toile inspect") from None
    if other and off_body(model, mesh) <= 2 * settings.lies:  # where one of other axes lay tells nothing
        words.append(
            f"garment {garment.name}: {other}: the labels{by} are wrong, or it is of another cut: see toile inspect"
        )
    return placed, words


def _labelled_otherwise(model: BodyModel, worn: Worn, mesh: Mesh, label: int) -> str:
    """In words, what else than `label` much of the body carries where a template lies on it as it is; "" where nothing does."""
    V, F = model.v_template, model.skin_faces
    outwards = kernels.vertex_normals(V, F)
    under = kernels.SurfaceIndex(mesh.vertices, mesh.faces).occluded(V, outwards, 0.0, UNDER)
    loops = kernels.boundary_loops(mesh.faces)
    if len(loops):
        under &= cKDTree(mesh.vertices[np.concatenate(loops)]).query(V)[0] > RIM
    area = under * np.bincount(F.ravel(), np.repeat(kernels.face_areas(V, F) / 3, 3), minlength=len(V))
    ids = np.array(sorted(worn.names))
    shares = np.array([(worn.labels == i).mean(0) @ area for i in ids]) / max(area.sum(), 1e-12)
    said = [f"{100 * x:.0f} % '{worn.names[i]}'" for i, x in zip(ids, shares) if i != label and x > OTHER]
    return f"where the template lies the body is labelled {' and '.join(said)}" if said else ""


def check_templates(capture: Capture, config: Config) -> None:
    """UserError where a garment of the scene has neither a template nor is one to be cut from the scans."""
    names, asked = [garment.name for garment in capture.scene.garments], config.template_from_scan
    for name in asked:
        if name not in names:
            raise UserError(f"template_from_scan {name}: the scene names {', '.join(names) or 'no garment'}")
    for i, garment in enumerate(capture.scene.garments):
        if not garment.template and garment.name not in asked:
            advice = f"name a file, or have it cut with --template-from-scan {garment.name}"
            raise UserError(f"{capture.root / 'scene.toml'}: garment.{i}.template: missing: {advice}")


def _cut(model, person, name, label_id, vertex_labels):
    """The template in the body model's own rest pose."""
    template = make_template(model, person, name, label_id, vertex_labels)
    return replace(template, rest=move_with_body(template.rest, person.rest, model.v_template, REACH))


def person_of(run: Run) -> Person:
    """The Person of a run: its rest surface is the median over the registered frames, unposed."""
    model, shape, J = run.body_model, run.shape, run.rest_joints
    unposed = [model.unskin(run.track.vertices[row], J, *run.pose.at(run.frames[row])) for row in run.rows()]
    return Person(shape, np.median(unposed, axis=0) if unposed else model.rest(shape)[0], J)


def write_template(run: Path, out: Path, name: str, label: str) -> str:
    """Writes the template as OBJ with its UVs. Returns a line that says what was made."""
    run, out = open_run(run), output_file(out)
    made = template_of_run(run, name, label)
    write_mesh(out, Mesh(made.rest, made.faces, made.uv, made.face_uv))
    loops = ", ".join(f"{n} ({len(loop)} vertices)" for n, loop in zip(made.loop_names, made.loops))
    return f"{out}: {name} from {run.path}: {len(made.rest)} vertices, {len(made.faces)} faces, loops {loops}"
