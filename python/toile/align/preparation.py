"""What the frames of an alignment are matched with: one reference print a garment, and the solvers."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..errors import UserError
from ..io.files import load_record, save_record
from ..io.holdout import apart
from ..io.run import Run
from ..pipeline.printing import references
from ..prints.aligner import PrintAligner, PrintedLayer, Target
from ..prints.lengths import true_lengths
from ..prints.reference import Reference
from ..scene import GarmentTemplate
from ..surface.layering import Layering
from ..surface.layers import Layer, read_layers
from .surfaces import garments_at, layers_at, pictures


@dataclass(frozen=True)
class PreparedAlignment:
    """What the frames are matched with."""

    run: Run
    layers: list[Layer]
    aligner: PrintAligner
    targets: dict[str, Target]
    layering: Layering

    def views(self, number):
        """What the pictures of a frame show of every garment."""
        return self.aligner.views(pictures(self.run, number), *layers_at(self.run, self.layers, number))


def prepare(run, out, settings, span, progress=lambda *_: None) -> PreparedAlignment:
    """Makes the references that OUT/reference does not hold yet, of frames that are not held out, and loads all."""
    paths = {name: out / "reference" / f"{name}.npz" for name in run.garments}
    layers = _layers(run, paths, span)
    aligner = PrintAligner([_printed(run, layer) for layer in layers], run.capture.cameras, settings)
    prepared = PreparedAlignment(run, layers, aligner, {}, _layering(run.body_model, layers, settings.margin))
    if any(not path.exists() for path in paths.values()):
        read = lambda number: (prepared.views(number), garments_at(run, number))
        for name, reference in references(aligner, apart(run.pictured, span), read, progress).items():
            save_record(paths[name], reference)
    loaded = {name: load_record(path, Reference) for name, path in paths.items()}
    return replace(prepared, targets=aligner.targets(loaded))


def _layers(run, paths, span):
    """The run's [Layer], at the rest shapes of those references that are there."""
    rests = {name: load_record(path, Reference).rest for name, path in paths.items() if path.exists()}
    layers = read_layers(run, apart(run.ok, span))
    return [replace(layer, rest=rests[layer.name]) if layer.name in rests else layer for layer in layers]


def _layering(body, layers, margin):
    sizes = [(layer.name, layer.faces, len(layer.rest)) for layer in layers if layer.kind == "garment"]
    return Layering(body.skin_faces, len(body.v_template), sizes, margin)


def _printed(run, layer):
    """A Layer of the run as a PrintedLayer; all garments slide."""
    template = _template(run, layer) if layer.kind == "garment" else None
    return PrintedLayer(layer.name, layer.label, layer.rest, layer.faces, tuple(layer.loops.values()), template)


def _template(run, layer):
    """Vertices (g,3) of the template, whose lengths the cloth keeps; where the run cut one from the capture, the run's own."""
    path, mesh = run.path / "prepared" / f"template.{layer.name}.npz", run.capture.templates.get(layer.name)
    fitted = load_record(path, GarmentTemplate, ("loops",)).rest if path.exists() else None
    cut = layer.name in run.config.get("settings", {}).get("template_from_scan", ())
    template = true_lengths(None if cut else mesh, fitted, layer.faces)
    if template is None:
        raise UserError(f"{run.capture.root}: the template of {layer.name} is not the one that {run.path} registered")
    return template
