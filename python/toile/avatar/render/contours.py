"""Where does the picture jump? Between adjacent pixels, the point of a mesh's contour that lies between their centres.

From one pixel's point the surface is followed, face by face, towards the other pixel. It may end at a border or turn
back at a fold: there the picture jumps from this surface to what lies behind. A surface that goes on as far as the
other pixel's centre has no contour there, however small its faces are.
"""

from typing import NamedTuple

import torch
from torch.utils.weak import WeakIdKeyDictionary

from .rasterise import NEAR

STEPS = 64  # faces followed within one pixel, at most
_known = WeakIdKeyDictionary()


class Contour(NamedTuple):
    """Between pixels a and b, row * W + column, lies the point (1 - s) v_i + s v_j of the mesh edge (i, j)."""

    a: torch.Tensor  # (E,)
    b: torch.Tensor  # (E,) to the right of a, or below
    i: torch.Tensor  # (E,)
    j: torch.Tensor  # (E,)
    s: torch.Tensor  # (E,)


def contours(face, depth, vertices, faces, neighbours, K):
    """The jumps in a view: (Contour between columns, Contour between rows).

    face (H,W), -1 where empty, and depth (H,W) of the view; vertices (n,3) in the camera's frame, faces and neighbours
    (m,3). Of two surfaces that both end between the pixels the nearer one counts. Where neither ends (they cross, or
    are one) there is no contour. Corners behind the camera count as at NEAR.
    """
    z = vertices[:, 2].clamp(min=NEAR)
    screen = (vertices[:, None] * K[:2]).sum(2) / z[:, None]  # no matrix product: autocast would round it
    columns, rows = _apart(face[:, :-1], face[:, 1:], faces), _apart(face[:-1], face[1:], faces)
    a = torch.cat([columns, rows])  # (E,2) row and column
    b = torch.cat([columns + columns.new_tensor([0, 1]), rows + rows.new_tensor([1, 0])])
    p, q = torch.cat([a, b]), torch.cat([b, a])  # followed both ways
    start, centre, direction = face[p[:, 0], p[:, 1]], p.flip(1) + 0.5, (q - p).flip(1).float()
    found, i, j, s = _follow(start, centre, direction, screen, faces, neighbours)
    s = s * z[i] / (s * z[i] + (1 - s) * z[j])  # perspective
    hit = torch.full_like(p[:, 0], -1).index_copy(0, found, torch.arange(len(found), device=face.device)).view(2, -1)
    a_nearer = depth[a[:, 0], a[:, 1]] <= depth[b[:, 0], b[:, 1]]
    hit = torch.where((hit[1] < 0) | a_nearer & (hit[0] >= 0), hit[0], hit[1])
    a, b = (pixel[:, 0] * face.shape[1] + pixel[:, 1] for pixel in (a, b))
    parts = torch.arange(len(a), device=face.device).split([len(columns), len(rows)])
    return tuple(Contour(a[e], b[e], i[hit[e]], j[hit[e]], s[hit[e]]) for e in (part[hit[part] >= 0] for part in parts))


def _apart(first, second, faces):
    """Where (E,2) faces of neighbouring pixels share no vertex; emptiness has none."""
    pixel = (first != second).nonzero()
    p, q = first[pixel[:, 0], pixel[:, 1]], second[pixel[:, 0], pixel[:, 1]]
    joined = (faces[p][:, :, None] == faces[q][:, None]).flatten(1).any(1) & (p >= 0) & (q >= 0)
    return pixel[~joined]


def _follow(face, origin, direction, screen, faces, neighbours):
    """Along the surface from `origin` (E,2) in `face` (E,), -1 for nowhere, by one pixel in `direction` (E,2).

    -> the numbers of those that meet a contour, and where: mesh edge (i, j) and the share s of j on the screen.
    """

    def placed(vertices):
        """How far ahead and how far aside vertices (E,...) are (E,...,2)."""
        shape = (len(vertices), *[1] * (vertices.ndim - 1))
        (x, y), (dx, dy) = (screen[vertices] - origin.view(*shape, 2)).unbind(-1), direction.view(*shape, 2).unbind(-1)
        return torch.stack([x * dx + y * dy, y * dx - x * dy], -1)

    number = (face >= 0).nonzero().squeeze(1)
    face, origin, direction = face[number], origin[number], direction[number]
    corner = faces[face]
    corner, at = _way_out(corner, placed(corner))
    ends = []
    for _ in range(STEPS):
        (inner, i, j), (at_inner, at_i, at_j) = corner.unbind(1), at.unbind(1)
        s = at_i[:, 1] / (at_i[:, 1] - at_j[:, 1])
        near = torch.lerp(at_i[:, 0], at_j[:, 0], s).abs() <= 1
        own = (faces[face] == inner[:, None]).int().argmax(1)
        beyond = neighbours[face, own]
        outer = torch.where(beyond < 0, inner, faces[beyond].sum(1) - i - j)
        at_outer = placed(outer)
        end = near & ((beyond < 0) | (_turn(at_i, at_j, at_inner) * _turn(at_i, at_j, at_outer) > 0))  # border or fold
        ends.append((number[end], i[end], j[end], s[end]))
        as_i = ((at_i[:, 1] >= 0) == (at_outer[:, 1] >= 0))[:, None]  # which end of the edge does `outer` replace?
        corner = torch.where(as_i, torch.stack([i, outer, j], 1), torch.stack([j, i, outer], 1))
        at = torch.where(as_i[:, None], torch.stack([at_i, at_outer, at_j], 1), torch.stack([at_j, at_i, at_outer], 1))
        on = (near & ~end).nonzero().squeeze(1)
        if len(on) == 0:
            break
        number, corner, at, face, origin, direction = (x[on] for x in (number, corner, at, beyond, origin, direction))
    return [torch.cat(parts) for parts in zip(*ends)]


def _way_out(corner, at):
    """Corners (E,3) and their places turned so that the line leaves the triangle between the last two."""
    reach = []
    for i, j in ((1, 2), (2, 0), (0, 1)):
        (ahead_i, aside_i), (ahead_j, aside_j) = at[:, i].unbind(1), at[:, j].unbind(1)
        crossing = torch.lerp(ahead_i, ahead_j, aside_i / (aside_i - aside_j))
        reach.append(torch.where((aside_i >= 0) != (aside_j >= 0), crossing, -torch.inf))
    turn = (torch.stack(reach, 1).argmax(1, keepdim=True) + torch.arange(3, device=at.device)) % 3
    return corner.gather(1, turn), at.gather(1, turn[..., None].expand(-1, -1, 2))


def _turn(i, j, v):
    """Twice the signed area of screen triangles (E,2)."""
    return (j[:, 0] - i[:, 0]) * (v[:, 1] - i[:, 1]) - (j[:, 1] - i[:, 1]) * (v[:, 0] - i[:, 0])


def neighbours_of(faces):
    """(m,3): the face beyond the edge opposite each corner, -1 where an edge has not exactly two faces."""
    if faces not in _known:
        edge = faces[:, [[1, 2], [2, 0], [0, 1]]].view(-1, 2)
        key, order = (edge.amin(1) * (faces.max() + 1) + edge.amax(1)).sort()
        count = torch.unique_consecutive(key, return_counts=True)[1]
        start = (count.cumsum(0) - count)[count == 2]
        one, other = order[start], order[start + 1]
        result = torch.full((faces.numel(),), -1, device=faces.device)
        result[one], result[other] = other.div(3, rounding_mode="floor"), one.div(3, rounding_mode="floor")
        _known[faces] = result.view(-1, 3)
    return _known[faces]
