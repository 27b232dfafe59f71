"""The pipeline's templates of a capture's garments, from the source that its options name, with their maps to the truth."""

from __future__ import annotations

import shutil

from ..io.mesh import write_mesh
from ..scene import Mesh
from .patterns import map_template, other_template
from .template import make_template


def write_templates(part, stage):
    """Writes templates/NAME.obj of every garment of the capture `part`, whose frames are there; the MappedTemplates by
    name, None where there is no map: a foreign garment."""
    sequence, mean, source = stage.sequence, stage.table.model.v_template, stage.options.template
    settled = source == "settled" or not stage.amounts.templates
    if sequence.settled:
        (part / "templates").mkdir(exist_ok=True)
    path = lambda s: part / "templates" / f"{s.name}.obj"
    made, sources = {}, dict(stage.options.garments)
    for s in sequence.settled:
        draped = sequence.draped(s)
        if settled:
            made[s.name] = make_template(s.flat, s.faces, draped, stage.body.rest, mean)
        elif source in ("other", "scan"):
            mesh = other_template(s.name, sources[s.name], s.cloth_rest, s.faces, draped, stage.body)
            made[s.name] = map_template(mesh, draped, s.faces, stage.body.rest, mean)[0]
        else:
            made[s.name] = None
            shutil.copyfile(source, path(s))
            continue
        write_mesh(path(s), made[s.name].mesh)
    if source == "scan" and not settled and sequence.settled:
        for s, mesh in zip(sequence.settled, cut_from_scan(part, sequence.settled, stage.options)):
            write_mesh(path(s), mesh)
            made[s.name] = map_template(mesh, sequence.draped(s), s.faces, stage.body.rest, mean)[0]
    return made


def cut_from_scan(part, settled, options):
    """What `toile template` makes of each garment from a run over the first frame."""
    from ..io.run import open_run
    from ..pipeline.run import register
    from ..pipeline.template import template_of_run

    run = part / "work" / "first"
    shutil.rmtree(run, ignore_errors=True)
    register(part, run, frames=options.pictured[:1])
    made = [template_of_run(open_run(run), s.name, s.name) for s in settled]
    return [Mesh(t.rest, t.faces, t.uv, t.face_uv) for t in made]
