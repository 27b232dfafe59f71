"""The pipeline's garment template: the truth garment remeshed and a size off, with a map back to the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene import Mesh
from .surface import barycentric, border_edges, open_loops

EDGE = 0.0118  # m: about 6k vertices on a shirt
SIZE_OFF = 1.03  # the template is this much larger than the shirt worn
SPREAD = 0.03  # m: reach of the body-to-body displacement that carries the shirt to the model's mean body
NEIGHBOURS = 24


@dataclass(frozen=True)
class MappedTemplate:
    mesh: Mesh  # in the body model's rest pose
    map_face: np.ndarray  # (g,) face of the truth garment under each template vertex
    map_bary: np.ndarray  # (g,3)


def make_template(flat, F, draped, truth_rest, mean_rest, edge=EDGE):
    """Remeshes the flat garment, takes positions from `draped` (on the truth body in rest pose, without translation),
    carries them to the mean body and scales them by SIZE_OFF about their middle."""
    V, T = remesh(flat, F, edge)
    face, bary = map_to(V, T, flat, F)
    at = np.einsum("gc,gcd->gd", bary, draped[F[face]])
    at = at + body_shift(at, truth_rest, mean_rest)
    middle = 0.5 * (at.min(0) + at.max(0))
    uv, face_uv = unwrap(V, T)
    return MappedTemplate(Mesh(middle + SIZE_OFF * (at - middle), T, uv, face_uv), face, bary)


def remesh(V, F, edge):
    """Isotropic explicit remeshing by pymeshlab: another connectivity, the open loops kept."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(V, F))
    meshes.meshing_isotropic_explicit_remeshing(iterations=6, targetlen=pymeshlab.PureValue(edge), featuredeg=40.0)
    meshes.meshing_remove_unreferenced_vertices()
    out = meshes.current_mesh()
    return np.asarray(out.vertex_matrix()).copy(), np.asarray(out.face_matrix()).astype(np.int32)


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


def body_shift(points, truth_rest, mean_rest):
    """Displacement (g,3) from the truth body to the mean body, averaged over nearby body vertices."""
    from scipy.spatial import cKDTree

    distance, near = cKDTree(truth_rest).query(points, k=NEIGHBOURS)
    w = np.exp(-0.5 * ((distance - distance[:, :1]) / SPREAD) ** 2)
    return np.einsum("gk,gkd->gd", w / w.sum(1, keepdims=True), (mean_rest - truth_rest)[near])


def unwrap(V, T):
    """UVs (t,2) in the unit square and face_uv (f,3) by xatlas."""
    import xatlas

    origin, faces, uv = xatlas.parametrize(V.astype(np.float32), T.astype(np.uint32))
    if not np.array_equal(origin[faces], T):
        raise RuntimeError("xatlas reordered the faces of the template")
    return uv.astype(np.float64), faces.astype(np.int32)
