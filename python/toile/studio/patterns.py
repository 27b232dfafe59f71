"""Garment templates that were never the true garment: cut from the model's mean body where the garment is worn, by
another tessellation, a size off by different factors; and the map from any template to the truth.
"""

from __future__ import annotations

import numpy as np

from ..io.body import load_body_model
from ..scene import Mesh
from ..surface.loops import loop_length
from ..surface.operators import smooth_on
from ..surface.transfer import move_with_body, unwrap
from . import cut
from .body import TruthBody, skin_component
from .garment import named_loops
from .remeshing import remesh
from .surface import barycentric, border_edges, open_loops, vertex_normals
from .template import EDGE, REACH, REMESHING, MappedTemplate

WIDER, SHORTER = 1.06, 0.97  # girths and lengths of the template over those of the true garment
CLEAR = 0.006  # m that the template keeps from the mean body
LOOSEST = 0.08  # m, most that it stands off
ROUNDS = 4  # of finding how far the openings stand off
LAYING, EVENING = 8, 6  # rounds of laying the template on the truth, umbrella steps between them
STRETCHED = 0.1  # m that a hem is let down before its triangles are made anew
UNFOLDING = 3  # rounds of smoothing that take the wrinkles from the truth before the template is laid on it


def mean_body():
    """The model's mean body as one of the studio's."""
    model = load_body_model("anny")
    V, n = model.v_template, len(model.v_template)
    none = np.zeros((0, n, 3)), np.zeros(0, np.int64), np.zeros(0)
    neutral = V - [0, 0, V[:, 2].min()]
    return TruthBody(model, neutral, skin_component(model.f, n), {}, None, np.zeros((n, 3)), *none)


def other_template(name, source, cloth_rest, F, draped, body):
    """A template of the garment `name` from `source` (cloth at rest `cloth_rest` (G,3), F, worn as `draped` on `body` at
    rest) in the mean body's rest pose: the skin under it, cut SHORTER; each opening as far off as makes it WIDER."""
    mean = mean_body()
    if source == "cut":
        fields, drop = 2 * [cut.CUTS[name].field(body)], cut.CUTS[name].drop
    else:
        fields = [shirt_worn(draped, F, body, shorter) for shorter in (SHORTER, 1.0)]
        drop = max(0.0, cut.lowest(body) - hem_of(draped, F, SHORTER))
    V, T = cut.cut_skin(mean, fields[0], EDGE)
    skin_V, skin_T = cut.cut_skin(body, fields[1], EDGE)
    V = stood_off(V, T, *wanted_girths(V, T, skin_V, skin_T, cloth_rest, draped, F), drop, mean)
    if source == "cut":
        top = V[:, 2].max()
        V = cut.outside(V + (SHORTER - 1) * (V - top) * [0, 0, 1], mean.rest, mean.skin_faces, CLEAR)
    if drop > STRETCHED:
        V, T = remesh(V, T, EDGE, **REMESHING)
    uv, face_uv = unwrap(V, T)
    return Mesh(V, T, uv, face_uv)


def shirt_worn(draped, F, body, shorter):
    """Per body vertex, positive where a shirt is worn: metres to its openings, hem and sleeves drawn up by `shorter`."""
    loops = named_loops(draped, F)
    sleeves = [
        shorter * cut.along_arm(body, draped[loops[name]], side)[0].mean()
        for name, side in (("sleeve_left", "L"), ("sleeve_right", "R"))
    ]
    up = float(((draped[loops["neck"]] - body.J[body.model.joint("neck01")]) @ cut.NECKLINE).mean())
    return cut.shirt_field(body, max(cut.lowest(body), hem_of(draped, F, shorter)), up, sleeves)


def hem_of(draped, F, shorter):
    """Height of the hem [m] of a shirt whose length is `shorter` of the true one's."""
    loops = named_loops(draped, F)
    neck, hem = (draped[loops[n], 2].mean() for n in ("neck", "hem"))
    return float(neck - shorter * (neck - hem))


def wanted_girths(V, T, skin_V, skin_T, cloth_rest, draped, F):
    """The open loops of the cut V, T on the mean body, and the length of each (l,) [m]: WIDER than the girth there with the
    ease of the true garment, which is longer than the true body's skin (skin_V, skin_T) by so much."""
    true = {tuple(skin): theirs for skin, theirs in pairs_of_loops(skin_V, skin_T, draped, F)}
    loops, lengths = [], []
    for mine, skin in pairs_of_loops(V, T, skin_V, skin_T):
        loops.append(mine)
        ease = loop_length(cloth_rest[true[tuple(skin)]]) - loop_length(skin_V[skin])
        lengths.append(WIDER * (loop_length(V[mine]) + ease))
    return loops, np.array(lengths)


def stood_off(V, T, loops, lengths, drop, body):
    """V moved off the body so far that its loops have these lengths, harmonically in between, and never less than CLEAR;
    its hem let down by `drop`."""
    import igl

    known = np.concatenate(loops).astype(np.int64)
    N = smooth_on(T, vertex_normals(V, T), 10)
    N /= np.linalg.norm(N, axis=1, keepdims=True)
    off, out = np.zeros(len(loops)), V
    for _ in range(ROUNDS):  # smoothing draws loops together
        off = np.clip(off + (lengths - [loop_length(out[c]) for c in loops]) / (2 * np.pi), CLEAR, LOOSEST)
        values = np.repeat(off, [len(c) for c in loops])[:, None]
        out = cut.hung(V + igl.harmonic(V, T.astype(np.int64), known, values, 1).reshape(-1, 1) * N, drop)
        out = cut.lifted(out, T, (body.rest, body.skin_faces), CLEAR)
    return out


def map_template(mesh, draped, F, truth_rest, mean_rest):
    """Where each template vertex lies on the truth: both on the mean body at rest, the truth's wrinkles smoothed away;
    openings go to openings by arc length, what lies between follows biharmonically and falls onto the nearest point.
    Returns the MappedTemplate and how far points fell [m] (g,)."""
    import igl

    truth = move_with_body(draped, truth_rest, mean_rest, REACH)
    for _ in range(UNFOLDING):
        truth = cut.smoothed(truth, F)
    V, T = mesh.vertices, mesh.faces
    place = {}
    for mine, theirs in pairs_of_loops(V, T, truth, F):
        place |= dict(zip(mine.tolist(), along(V[mine], truth, theirs)))
    known = np.array(sorted(place))
    moved = np.array([place[v][0] for v in known]) - V[known]
    D = igl.harmonic(V, T.astype(np.int64), known.astype(np.int64), moved, 2)
    for k in range(LAYING):  # onto the truth, evened out, onto it again
        square, face, closest = igl.point_mesh_squared_distance(V + D, truth, F.astype(np.int64))[:3]
        if k < LAYING - 1:
            D = evened(T, closest - V, known, moved)
    bary = barycentric(closest, truth[F[face]])
    edges, owner = border_edges(F)
    face_of = {tuple(e): f for e, f in zip(edges.tolist(), owner)}
    for v in known:
        _, a, b, t = place[v]
        f = face_of[(a, b)]
        face[v], bary[v] = f, (1 - t) * (F[f] == a) + t * (F[f] == b)
    return MappedTemplate(mesh, face.astype(np.int32), bary), np.sqrt(square)


def evened(T, D, known, moved):
    """Displacements evened out over the mesh, those of the openings kept."""
    D[known] = moved
    for _ in range(EVENING):
        D = smooth_on(T, D, 1)
        D[known] = moved
    return D


def pairs_of_loops(V, T, other_V, other_F):
    """Open loops of two garments that belong together, by the distances of their middles."""
    from scipy.optimize import linear_sum_assignment

    mine, theirs = open_loops(T), open_loops(other_F)
    middles = [np.array([P[c].mean(0) for c in loops]) for P, loops in ((V, mine), (other_V, theirs))]
    rows, columns = linear_sum_assignment(np.linalg.norm(middles[0][:, None] - middles[1][None], axis=2))
    return [(mine[r], theirs[c]) for r, c in zip(rows, columns)]


def along(points, truth, loop):
    """For a cycle of points (k,3) the places at the same shares of the length of `loop`, turned to where they are nearest:
    (position, edge's ends a and b, share of the edge)."""
    share = lambda P: np.cumsum(np.r_[0, np.linalg.norm(np.roll(P, -1, 0) - P, axis=1)])
    mine, theirs = share(points), share(truth[loop])
    mine, theirs = mine[:-1] / mine[-1], theirs / theirs[-1]

    def at(s):
        s = s % 1.0
        k = np.clip(np.searchsorted(theirs, s, side="right") - 1, 0, len(loop) - 1)
        t = np.clip((s - theirs[k]) / np.maximum(theirs[k + 1] - theirs[k], 1e-12), 0, 1)
        a, b = loop[k], loop[(k + 1) % len(loop)]
        return (1 - t)[:, None] * truth[a] + t[:, None] * truth[b], a, b, t

    centred = points - points.mean(0)
    middle = truth[loop].mean(0)
    shifts = np.linspace(0, 1, 200, endpoint=False)
    cost = [(((at(mine + s)[0] - middle) - centred) ** 2).sum() for s in shifts]
    return list(zip(*at(mine + shifts[int(np.argmin(cost))])))
