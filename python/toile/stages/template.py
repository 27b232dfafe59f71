"""Makes a garment template from a tracked surface: cut along labels, remeshed, unwrapped, skinned."""

from __future__ import annotations

import numpy as np

from .. import kernels
from ..errors import UserError
from ..kernels.arrays import Anything, Floats, Ints
from ..scene import BodyModel, GarmentTemplate, Person
from ..surface.loop_names import name_loops
from ..surface.operators import compact, smooth_on
from ..surface.transfer import move_with_body, transfer_skin, unwrap

EDGE = 0.012  # [m] of a template
OFFSET = 0.003  # [m] of a template outside of the tracked surface
HOLE = 0.01  # [m^2]: smaller islands of other labels are no openings, smaller regions no garment
REACH = 0.04  # [m] over which the way from the person to the model's mean body is averaged
BORDER_STEPS, SKIN_STEPS = 2, 10  # of umbrella smoothing


def make_template(
    model: BodyModel,
    person: Person,
    name: str,
    label_id: int,
    vertex_labels: Anything,
    edge: float = EDGE,
    hole: float = HOLE,
) -> GarmentTemplate:
    """A template of the region that `vertex_labels` ((n,) ids, or (T,n): the majority over frames) give `label_id`
    on the tracked surface: its rest shape cut along the smoothed border, OFFSET outside it, remeshed to edges of
    about `edge` [m]. Islands of other labels smaller than `hole` [m^2] are no openings. Raises UserError where no region or
    no open loop is left."""
    V, F = worn_region(model, person, name, label_id, vertex_labels, hole)
    V = V + OFFSET * kernels.vertex_normals(V, F)
    V, F = kernels.remesh(V, F, edge)
    loops = tuple(kernels.boundary_loops(F))
    if not loops:
        raise UserError(f"labels: the region of {name} (id {label_id}) has no open loop")
    uv, face_uv = unwrap(V, F)
    at_rest = move_with_body(V, person.rest, model.v_template, REACH)
    skin = transfer_skin(model, at_rest, F, SKIN_STEPS)
    return GarmentTemplate(name, int(label_id), V, F, uv, face_uv, skin, loops, name_loops(model, at_rest, loops))


def worn_region(
    model: BodyModel, person: Person, name: str, label_id: int, vertex_labels: Anything, hole: float = HOLE
) -> tuple[Floats, Ints]:
    """The largest part (V, F) of the person's rest surface that carries the label, cut along its smoothed border. UserError:
    none is larger than `hole` [m^2]."""
    share = (np.atleast_2d(vertex_labels) == label_id).mean(0)
    share[_islands(person.rest, model.f, share <= 0.5, hole)] = 1
    V, F = cut(person.rest, model.f, smooth_on(model.f, share, BORDER_STEPS), 0.5)
    V, F = _largest_component(V, F) if len(F) else (V, F)
    if kernels.face_areas(V, F).sum() < hole:
        raise UserError(
            f"labels: no region of the tracked surface over {1e4 * hole:.0f} cm^2 carries {name} (id {label_id})"
        )
    return V, F


def _islands(V, F, other, area):
    """Those of the vertices `other` (n,) whose connected part of the surface is smaller than `area` [m^2]."""
    among = F[other[F].all(1)]
    if len(among) == 0:
        return other
    part = kernels.vertex_components(among, len(V))
    size = np.bincount(part[among[:, 0]], kernels.face_areas(V, among), minlength=part.max() + 1)
    return other & (size[part] < area)


def cut(V: Floats, F: Ints, value: Floats, level: float) -> tuple[Floats, Ints]:
    """The part of a mesh where the piecewise linear `value` (n,) is above `level`; crossed faces are split."""
    high = value > level
    count = high[F].sum(1)
    keep = [F[count == 3]]
    crossed = F[(count == 1) | (count == 2)]
    edges: dict[tuple[int, int], int] = {}  # the new vertex on each crossed edge
    points: list[Floats] = []

    def crossing(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in edges:
            t = (level - value[key[0]]) / (value[key[1]] - value[key[0]])
            edges[key] = len(V) + len(points)
            points.append(V[key[0]] + t * (V[key[1]] - V[key[0]]))
        return edges[key]

    split: list[tuple[int, int, int]] = []
    for face in crossed.tolist():
        one = sum(high[v] for v in face) == 1
        k = next(i for i in range(3) if high[face[i]] == one)
        a, b, c = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
        ab, ca = crossing(a, b), crossing(c, a)
        split += [(a, ab, ca)] if one else [(ab, b, c), (ab, c, ca)]
    keep.append(np.array(split, dtype=np.int32).reshape(-1, 3))
    return compact(np.concatenate([V, np.array(points).reshape(-1, 3)]), np.concatenate(keep))


def _largest_component(V, F):
    part = kernels.vertex_components(F, len(V))[F[:, 0]]
    return compact(V, F[part == np.bincount(part).argmax()])
