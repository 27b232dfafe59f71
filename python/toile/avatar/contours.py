"""Where does the picture jump? Between adjacent pixels, the point of a mesh's contour that lies between their centres.

From one pixel's point the surface is followed, face by face, towards the other pixel. It may end at a border or turn
back at a fold: there the picture jumps from this surface to what lies behind. A surface that goes on as far as the other
pixel's centre has no contour there, however small its faces are.
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
    (m,3). Of two surfaces the nearer one is followed first. Where neither ends (they cross, or are one) there is no
    contour. Corners behind the camera count as at NEAR.
    """
    z = vertices[:, 2].clamp(min=NEAR)
    screen = (vertices / z[:, None]) @ K[:2].T
    return tuple(_contour(face, depth, screen, z, faces, neighbours, axis) for axis in (0, 1))


def _contour(face, depth, screen, z, faces, neighbours, axis):
    a, step = _apart(face, faces, axis)
    face, depth, width = face.view(-1), depth.view(-1), face.shape[1]
    centre = torch.stack([a % width, a.div(width, rounding_mode="floor")], 1) + 0.5
    a_nearer = depth[a] <= depth[a + step]
    ends, rest = [], torch.arange(len(a), device=a.device)
    for from_a in (a_nearer, ~a_nearer):
        start = torch.where(from_a, face[a], face[a + step])
        rest = rest[start[rest] >= 0]
        from_a, origin = from_a[rest], centre[rest]
        origin[:, axis] += (~from_a).float()
        found, *end = _follow(start[rest], origin, 2 * from_a.long() - 1, axis, screen, faces, neighbours)
        ends.append((rest[found], *end))
        rest = rest[torch.ones_like(rest, dtype=torch.bool).index_fill(0, found, False)]
    pair, i, j, s = (torch.cat(parts) for parts in zip(*ends))
    s = s * z[i] / (s * z[i] + (1 - s) * z[j])  # perspective
    return Contour(a[pair], a[pair] + step, i, j, s)


def _apart(face, faces, axis):
    """Pixels (E,) whose face shares no vertex with that of the next pixel (emptiness has no vertex), and the step there."""
    first, second = (face[:, :-1], face[:, 1:]) if axis == 0 else (face[:-1], face[1:])
    width, step = face.shape[1], (1, face.shape[1])[axis]
    row, column = (first != second).nonzero().unbind(1)
    a = row * width + column
    p, q = face.view(-1)[a], face.view(-1)[a + step]
    joined = (faces[p][:, :, None] == faces[q][:, None]).flatten(1).any(1) & (p >= 0) & (q >= 0)
    return a[~joined], step


def _follow(face, origin, ahead, axis, screen, faces, neighbours):
    """From `origin` (E,2) in `face` (E,) one pixel along an axis, `ahead` (E,) +1 or -1, to the contour if there is one.

    -> the numbers of those that meet one, and where: edge (i, j) and the share s of j on the screen.
    """
    along, across = screen[:, axis], screen[:, 1 - axis]
    i, j, inner, k = _way_out(faces[face], origin, ahead, axis, along, across)
    number = torch.arange(len(face), device=face.device)
    ends = []
    for _ in range(STEPS):
        if len(number) == 0:
            break
        line = origin[number, 1 - axis]
        s = (line - across[i]) / (across[j] - across[i])
        reach = ahead[number] * (along[i] + s * (along[j] - along[i]) - origin[number, axis])
        beyond = neighbours[face, k]
        outer = torch.where(beyond < 0, inner, faces[beyond].sum(1) - i - j)
        turn_inner, turn_outer = (
            (along[j] - along[i]) * (across[v] - across[i]) - (across[j] - across[i]) * (along[v] - along[i])
            for v in (inner, outer)
        )
        near = reach.abs() <= 1
        end = near & ((beyond < 0) | (turn_inner * turn_outer > 0))  # a border, or both faces on one side of their edge
        ends.append((number[end], i[end], j[end], s[end]))
        on = (near & ~end).nonzero().squeeze(1)
        number, i, j, face, outer, line = number[on], i[on], j[on], beyond[on], outer[on], line[on]
        replaces_i = (across[i] >= line) == (across[outer] >= line)
        inner = torch.where(replaces_i, i, j)
        i, j = torch.where(replaces_i, outer, i), torch.where(replaces_i, j, outer)
        k = (faces[face] == inner[:, None]).int().argmax(1)
    ends = ends or [(number, i, j, origin[:, 0])]
    return [torch.cat(parts) for parts in zip(*ends)]


def _way_out(corners, origin, ahead, axis, along, across):
    """Through which edge does the line from `origin` leave a triangle? (i, j, the corner opposite, its place)."""
    upper = across[corners] >= origin[:, 1 - axis, None]
    best, place = torch.full_like(origin[:, 0], -torch.inf), torch.zeros_like(ahead)
    for k in range(3):
        i, j = corners[:, (k + 1) % 3], corners[:, (k + 2) % 3]
        s = (origin[:, 1 - axis] - across[i]) / (across[j] - across[i])
        reach = ahead * (along[i] + s * (along[j] - along[i]) - origin[:, axis])
        later = (upper[:, (k + 1) % 3] != upper[:, (k + 2) % 3]) & (reach > best)
        best, place = torch.where(later, reach, best), torch.where(later, k, place)
    i, j, inner = (corners.gather(1, ((place + t) % 3)[:, None])[:, 0] for t in (1, 2, 0))
    return i, j, inner, place


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
