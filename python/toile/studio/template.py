"""The pipeline's garment template: the truth garment remeshed and a size off, with a map back to the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene import Mesh
from ..surface.transfer import move_with_body, unwrap
from .remeshing import remesh
from .surface import barycentric, border_edges, open_loops

EDGE = 0.0118  # m: about 6k vertices on a shirt
REMESHING = {"iterations": 6, "crease": 40.0}  # another connectivity
SIZE_OFF = 1.03  # the template is this much larger than the shirt worn
REACH = 0.03  # m: of the body-to-body displacement that carries the shirt to the model's mean body


@dataclass(frozen=True)
class MappedTemplate:
    mesh: Mesh  # in the body model's rest pose
    map_face: np.ndarray  # (g,) face of the truth garment under each template vertex
    map_bary: np.ndarray  # (g,3)


def make_template(flat, F, draped, truth_rest, mean_rest, edge=EDGE):
    """Remeshes the flat garment, takes positions from `draped` (on the truth body in rest pose, without translation),
    carries them to the mean body and scales them by SIZE_OFF about their middle."""
    V, T = remesh(flat, F, edge, **REMESHING)
    face, bary = map_to(V, T, flat, F)
    at = np.einsum("gc,gcd->gd", bary, draped[F[face]])
    at = move_with_body(at, truth_rest, mean_rest, REACH)
    middle = 0.5 * (at.min(0) + at.max(0))
    uv, face_uv = unwrap(V, T)
    return MappedTemplate(Mesh(middle + SIZE_OFF * (at - middle), T, uv, face_uv), face, bary)


def map_to(V, T, truth_V, truth_F):
    """Face and barycentric coordinates on the truth of each vertex; border vertices map to the border."""
    import igl

    _, face, closest = igl.point_mesh_squared_distance(V, truth_V, truth_F.astype(np.int64))[:3]
    bary = barycentric(closest, truth_V[truth_F[face]])
    border = np.concatenate(open_loops(T))
    edges, owner = border_edges(truth_F)
    a, b = truth_V[edges[:, 0]], truth_V[edges[:, 1]]
    for v in border:
        t = np.clip(((V[v] - a) * (b - a)).sum(1) / np.maximum(((b - a) ** 2).sum(1), 1e-20), 0, 1)
        e = int(np.linalg.norm(a + t[:, None] * (b - a) - V[v], axis=1).argmin())
        corners = truth_F[owner[e]]
        face[v] = owner[e]
        bary[v] = (1 - t[e]) * (corners == edges[e, 0]) + t[e] * (corners == edges[e, 1])
    return face.astype(np.int32), bary
