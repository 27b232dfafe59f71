"""Which face does each pixel see? Buffers without gradient: the core's `raster` on the CPU, a scatter-min elsewhere."""

import numpy as np
import torch

from ...kernels import InputError, raster

NEAR = 0.01  # what lies nearer to the camera's plane is cut away [m]
SUBPIXEL = 4096  # corners are snapped to 1/4096 px, so that shared edges neither crack nor double
GUARD = 2**17  # [px] image positions are cut to it, so that edge functions fit 64 bits
CANDIDATES = 2**22  # (face, pixel) pairs looked at together: bounds the memory


def rasterise(vertices, faces, K, size):
    """vertices (n,3) in the camera's frame, faces (m,3) -> face (H,W) int64, -1 where empty; depth (H,W) float64 [m].

    Depth is inf where empty. Both sides of a face are seen; equal depths go to the lower face index.
    InputError: as of `kernels.raster`.
    """
    if vertices.device.type != "cpu":
        return rasterise_by_scatter(vertices, faces, K, size)
    result = raster(vertices.detach().numpy(), faces.numpy(), K.numpy().astype(np.float64), size, near_plane=NEAR)
    return torch.tensor(result.face).long(), torch.tensor(result.depth)


def rasterise_apart(meshes, K, size):
    """Meshes (vertices (n,3), faces (m,3)) by themselves: [(face, depth)] as `rasterise` gives them."""
    if meshes[0][0].device.type == "cpu":
        return [rasterise(*mesh, K, size) for mesh in meshes]
    return rasterise_apart_by_scatter(meshes, K, size)


def rasterise_apart_by_scatter(meshes, K, size):
    """The same on any device, all meshes at once."""
    height, width = size
    vertices, faces = zip(*meshes)
    first, starts = (np.cumsum([0, *map(len, parts)]).tolist() for parts in (vertices, faces))
    picture = torch.cat([torch.full((len(part),), k, device=part.device) for k, part in enumerate(faces)])
    together = torch.cat(vertices), torch.cat([part + n for part, n in zip(faces, first)])
    face, depth = rasterise_by_scatter(*together, K, size, picture, len(meshes))
    faces = [torch.where(one < 0, -1, one - start) for one, start in zip(face.view(-1, height, width), starts)]
    return list(zip(faces, depth.view(-1, height, width)))


@torch.no_grad()
def rasterise_by_scatter(vertices, faces, K, size, picture=None, pictures=1):
    """The same in torch, on any device: faces test their bounding boxes' pixels; the least (depth, face) stays. `picture` (m,): into
    which of `pictures`, one below the other, each face is drawn."""
    if not torch.isfinite(vertices).all():
        raise InputError("rasterise: vertices are not finite")
    height, width = size
    K = K.double()
    corners, face = _clip(vertices.double()[faces])
    snapped = _snap(corners, K)
    low = (snapped.amin(1) + SUBPIXEL // 2 - 1).div(SUBPIXEL, rounding_mode="floor").clamp(min=0)
    high = (snapped.amax(1) - SUBPIXEL // 2).div(SUBPIXEL, rounding_mode="floor")
    high = torch.minimum(high, torch.tensor([width - 1, height - 1], device=high.device))
    extent = (high - low + 1).clamp(min=0)  # columns, rows
    area = extent.prod(1)
    edges, plane = _edges(snapped), _inverse_depth(corners, K)
    near, far = corners[..., 2].aminmax(dim=1)
    first_row = None if picture is None else picture[face] * height
    best = torch.full((pictures * height * width,), torch.iinfo(torch.int64).max, device=vertices.device)
    for part in _parts(area):
        count = area[part]
        owner, first = part.repeat_interleave(count), (count.cumsum(0) - count).repeat_interleave(count)
        rank, across = torch.arange(len(owner), device=owner.device) - first, extent[owner, 0]
        column, row = low[owner, 0] + rank % across, low[owner, 1] + rank.div(across, rounding_mode="floor")
        inside = _covers(edges[owner], column, row)
        owner, column, row = owner[inside], column[inside], row[inside]
        centre = torch.stack([column + 0.5, row + 0.5, torch.ones(len(row), device=row.device)], 1)
        z = 1 / (plane[owner] * centre).sum(1)
        z = torch.where(z >= near[owner], torch.minimum(z, far[owner]), near[owner])  # an edge-on plane divides by zero
        key = (z.float().view(torch.int32).long() << 32) | face[owner]  # positive floats order as their bits do
        row = row if first_row is None else row + first_row[owner]
        best.scatter_reduce_(0, row * width + column, key, "amin")
    empty = best == torch.iinfo(torch.int64).max
    depth = (best >> 32).int().view(torch.float32).double()
    face, depth = (best & 0xFFFFFFFF).masked_fill(empty, -1), depth.masked_fill(empty, torch.inf)
    return face.view(-1, width), depth.view(-1, width)


def _clip(corners):
    """Cuts triangles (m,3,3) by z >= NEAR -> (k,3,3) pieces and the face (k,) of each."""
    front = corners[..., 2] >= NEAR
    face = torch.arange(len(corners), device=corners.device)
    if front.all():
        return corners, face
    count = front.sum(1)
    whole, one, two = count == 3, count == 1, count == 2
    odd = torch.where(one[:, None], front, ~front).int().argmax(1)  # the corner alone on its side comes first
    turn = (odd[:, None] + torch.arange(3, device=odd.device)) % 3
    a, b, c = corners.gather(1, turn[..., None].expand(-1, -1, 3)).unbind(1)
    ab, ac = _cut(a, b), _cut(a, c)
    tip, near, far = torch.stack([a, ab, ac], 1), torch.stack([ab, b, c], 1), torch.stack([ab, c, ac], 1)
    return (
        torch.cat([corners[whole], tip[one], near[two], far[two]]),
        torch.cat([face[whole], face[one], face[two], face[two]]),
    )


def _cut(p, q):
    """Where the edge from p to q meets z = NEAR: the same point from either of its faces, as it runs from the front."""
    front, back = torch.where(p[:, 2:] >= q[:, 2:], p, q), torch.where(p[:, 2:] >= q[:, 2:], q, p)
    t = (front[:, 2:] - NEAR) / (front[:, 2:] - back[:, 2:]).clamp(min=1e-300)
    cut = front + t * (back - front)
    return torch.cat([cut[:, :2], torch.full_like(cut[:, 2:], NEAR)], 1)


def _snap(corners, K):
    """Image positions (k,3,2) in units of 1/4096 px."""
    xy = (corners @ K.T)[..., :2] / corners[..., 2:]
    return (xy.clamp(-GUARD, GUARD) * SUBPIXEL + 0.5).floor().long()


def _inverse_depth(corners, K):
    """1/z of each face's plane as a linear function (a, b, c) . (u, v, 1) of the pixel (k,3)."""
    a, b, c = corners.unbind(1)
    normal = torch.linalg.cross(b - a, c - a)
    return normal @ torch.linalg.inv(K) / (normal * a).sum(1, keepdim=True)


def _parts(area):
    """Indices of the faces that have candidates, in runs of at most CANDIDATES (or one face)."""
    some = area.nonzero().squeeze(1)
    run = area[some].cumsum(0).div(CANDIDATES, rounding_mode="floor")
    return [] if len(some) == 0 else some.split(torch.unique_consecutive(run, return_counts=True)[1].tolist())


def _edges(corner):
    """Of triangles (k,3,2) in units of 1/4096 px the lines (k,3,3): a x + b y + c >= 0 on the inner side of each edge, and on it where
    it owns its points by the top-left rule. Exact in integers, of either winding; nothing is inside of a triangle without area."""
    (abx, aby), (acx, acy) = ((corner[:, k] - corner[:, 0]).unbind(1) for k in (1, 2))
    area = abx * acy - aby * acx
    order = torch.tensor([[0, 1, 2], [0, 2, 1]], device=corner.device)[(area < 0).long()]
    p = corner.gather(1, order[..., None].expand(-1, -1, 2))
    dx, dy = (p.roll(-1, 1) - p).unbind(2)
    others = ~((dy < 0) | ((dy == 0) & (dx > 0)))  # y points down: such an edge owns its points
    c = dy * p[..., 0] - dx * p[..., 1] - others.long()
    return torch.stack([-dy, dx, c.masked_fill((area == 0)[:, None], torch.iinfo(torch.int64).min // 2)], 2)


def _covers(edges, column, row):
    """Do triangles cover the centres of their pixels? `edges` (k,3,3) of `_edges`."""
    x, y = column * SUBPIXEL + SUBPIXEL // 2, row * SUBPIXEL + SUBPIXEL // 2
    return (edges[..., 0] * x[:, None] + edges[..., 1] * y[:, None] + edges[..., 2] >= 0).all(1)
