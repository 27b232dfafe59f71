"""`toile template`: a garment template cut from the tracked surface of a run, along its labels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..io.files import output_file
from ..io.mesh import write_mesh
from ..io.run import Run, open_run
from ..scene import GarmentTemplate, Mesh, Person
from ..stages.template import make_template
from ..surface.transfer import move_with_body

REACH = 0.04  # over which the way from the person to the model's mean body is averaged [m]


def template_of_run(run: Run, name: str, label: str) -> GarmentTemplate:
    """The template of a garment `name` worn where the tracked surface has a label of the run's scene, in the body model's
    own rest pose, where `dress.prepare` expects it. UserError: no such label, or no region of it with an opening."""
    ids = run.scene.labels
    if label not in ids:
        raise UserError(f"--label {label}: the run knows {', '.join(ids)}")
    if run.labels is None:
        raise UserError(f"{run.path}: labels: the run has none, its scene names no garment")
    person = person_of(run)
    template = make_template(run.body_model, person, name, ids[label], run.labels[run.rows()])
    return replace(template, rest=move_with_body(template.rest, person.rest, run.body_model.v_template, REACH))


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
