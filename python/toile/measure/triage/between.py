"""What only a frame's neighbours show: jumps, labels that change, cloth that swims; and what bends the tracked skin."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ... import kernels
from ...kernels.arrays import Bools, Floats, Ints
from ..verdicts import stretch

LEAST_LABEL = 0.005  # a label on a smaller share of the surface is not compared


@dataclass(frozen=True)
class Shape:
    """One frame: the tracked surface (n,3), the body under the garments (n,3), garments {name: (g,3)}, labels (n,)."""

    track: Floats
    inner: Floats | None
    garments: dict[str, Floats]
    labels: Ints | None


class Between:
    """Measures {key: value} of frames by number; keeps the shapes of the last few. Lengths in mm."""

    def __init__(self, run):
        self.run, self.shapes = run, {}
        self.ok = set(run.ok)

    @cached_property
    def outside(self) -> Bools:
        return ~self.run.body_model.inside

    @cached_property
    def rest(self) -> Floats:
        return self.run.body_model.rest(self.run.shape)[0]

    @cached_property
    def under(self) -> dict[str, Ints]:
        """Of each garment, the vertices (g,) of the body that lie nearest in the first frame."""
        first = self.shape(self.run.ok[0])
        return {name: cKDTree(first.inner).query(V)[1] for name, V in first.garments.items()}

    def shape(self, number) -> Shape:
        if number not in self.shapes:
            run = self.run
            inner = run.inner.at(number) if run.inner else None
            cloth = {name: garment.at(number) for name, garment in run.garments.items()}
            labels = run.labels.at(number) if run.labels is not None else None
            self.shapes[number] = Shape(run.track.at(number), inner, cloth, labels)
            while len(self.shapes) > 4:
                del self.shapes[next(iter(self.shapes))]
        return self.shapes[number]

    def measures(self, number) -> dict[str, float]:
        """Of a registered frame; what takes neighbours that are not there is left out."""
        now = self.shape(number)
        faces = self.run.body_model.skin_faces
        out = {"folded": folded(now.track, faces), "stretched": float(np.exp(stretch(now.track, self.rest, faces)))}
        beside = [self.shape(n) for n in (number - 1, number + 1) if n in self.ok]
        for name, V in now.garments.items():
            out[f"{name}.folds"] = float(len(kernels.self_intersections(V, self.run.garments[name].faces)))
        if now.labels is not None and beside:
            alike = labels_alike(now.labels[self.outside], [other.labels[self.outside] for other in beside])
            out |= {} if alike is None else {"labels_alike": alike}
        if len(beside) < 2:
            return out
        before, after = beside
        jump = (now.track - (before.track + after.track) / 2)[self.outside]
        out["jump_p95_mm"] = _p95(jump)
        for name, V in now.garments.items():
            jump = V - (before.garments[name] + after.garments[name]) / 2
            out[f"{name}.jump_p95_mm"] = _p95(jump)
            body = (now.inner - (before.inner + after.inner) / 2)[self.under[name]]
            normals = kernels.vertex_normals(V, self.run.garments[name].faces)
            out[f"{name}.slip_mm"] = 1e3 * float(np.linalg.norm(along(jump - body, normals), axis=1).mean())
        return out


def folded(V, F) -> float:
    """Share of the triangles whose normal is turned against the mean of their corners' normals."""
    around = kernels.vertex_normals(V, F)[F].sum(1)
    return float(((kernels.face_normals(V, F) * around).sum(1) < 0).mean())


def labels_alike(labels, others) -> float | None:
    """Intersection over union of the labels (n,) with those of other frames: of the worst label the mean over the frames;
    None where no label covers LEAST_LABEL."""
    least, found = LEAST_LABEL * len(labels), []
    for label in np.unique(labels):
        here = labels == label
        if here.sum() >= least:
            found.append(np.mean([(here & (o == label)).sum() / (here | (o == label)).sum() for o in others]))
    return float(min(found)) if found else None


def along(way, normals):
    """The part (n,3) of ways (n,3) that lies in the surface of these unit normals."""
    return way - (way * normals).sum(1, keepdims=True) * normals


def _p95(way):
    return 1e3 * float(np.percentile(np.linalg.norm(way, axis=1), 95))
