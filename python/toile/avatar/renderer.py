"""Differentiable rendering of textured layers: a face-id buffer without gradient, everything else recomputed in torch.

Inside a face: the ray d of a pixel meets it at z d = sum_k w_k v_k with sum_k w_k = 1; differentiating this gives the
gradients of the weights w and of the depth z. Silhouettes and occlusion edges: between adjacent pixels a and b whose
faces share no vertex, 0.5 (g_a + g_b) (I_a - I_b) goes to the screen position of the nearer one's surface point.
Both reach the vertices as one 3-vector a pixel, dealt out by w.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch.autograd.function import Function, once_differentiable
from torch.nn.functional import grid_sample

from ..kernels import InputError
from .rasterise import NEAR, rasterise

EDGE_ON = 1e-3  # sine of the angle between ray and face; below it a face has colour but no interior gradient


@dataclass
class Surface:
    """One layer to draw; layers share no vertex."""

    vertices: torch.Tensor  # (n,3) world [m]
    faces: torch.Tensor  # (m,3) int64
    uv: torch.Tensor  # (t,2), v up
    face_uv: torch.Tensor  # (m,3) int64
    texture: torch.Tensor  # (C,T,T); texel (r, c) has its centre at u = (c + .5)/T, v = 1 - (r + .5)/T


@dataclass
class Rendered:
    """What one camera sees; faces are counted through all layers in turn."""

    image: torch.Tensor  # (C,H,W)
    mask: torch.Tensor  # (H,W) 1 where any layer is, else 0; its gradient is that of the silhouette
    face: torch.Tensor  # (H,W) int64, -1 where empty
    layer: torch.Tensor  # (H,W) int64, -1 where empty
    depth: torch.Tensor  # [m], inf where empty: (L,H,W) of each layer alone, or (1,H,W) of the nearest (no layer_depth)


def render(surfaces, K, T_camera_world, size, background=0.0, layer_depth=False) -> Rendered:
    """Draws surfaces into one pinhole camera; differentiable in their vertices and textures and in the background.

    K (3,3) and T_camera_world (4,4): OpenCV camera; pixel (row i, column j) has its centre at (j + .5, i + .5).
    size: (height, width) [px]; background: a number, (C,) or (C,H,W). Always float32, also under autocast.

    Both sides of a face are seen. What lies nearer than rasterise.NEAR is cut away; a face that crosses that plane
    keeps the gradients of its visible rest. A face seen edge-on (EDGE_ON) or without area has no gradient through its
    interior. Between a layer and emptiness depth has no gradient: that is the mask's. None reaches uv and the camera.
    InputError: no surface, no vertices or faces, NaN or infinity, an index out of range, a bad K or size.
    """
    if not surfaces:
        raise InputError("render: surfaces is empty")
    with torch.autocast(surfaces[0].vertices.device.type, enabled=False):
        return _render(surfaces, K.float(), T_camera_world.float(), size, background, layer_depth)


def _render(surfaces, K, T_camera_world, size, background, layer_depth):
    vertices = torch.cat([s.vertices.float() for s in surfaces]) @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    parts = vertices.detach().split([len(s.vertices) for s in surfaces])
    buffers = [rasterise(part, s.faces, K, size) for part, s in zip(parts, surfaces)]
    layer = _nearest([depth for _, depth in buffers])
    drawn = [face >= 0 if layer_depth else layer == k for k, (face, _) in enumerate(buffers)]
    pixels = [mask.view(-1).nonzero().squeeze(1) for mask in drawn]
    face = torch.cat([f.view(-1)[p] + n for (f, _), p, n in zip(buffers, pixels, _offsets(s.faces for s in surfaces))])
    points = _Points.at(vertices, _joined(surfaces, "faces", "vertices")[face], torch.cat(pixels), K, size)

    shown = [layer.view(-1)[p] == k for k, p in enumerate(pixels)]
    chosen = torch.cat(shown).nonzero().squeeze(1)
    seen, face = (points[chosen], face[chosen]) if layer_depth else (points, face)
    uv = torch.cat([s.uv.float() for s in surfaces])[_joined(surfaces, "face_uv", "uv")[face]]  # (P,3,2)
    uv = (uv * seen.weight[..., None]).sum(1).split([int(s.sum()) for s in shown])
    colour = torch.cat([_look_up(s.texture.float(), part) for s, part in zip(surfaces, uv)], 1)
    if layer_depth:
        ends = torch.tensor([len(p) for p in pixels]).cumsum(0).tolist()
        depth = torch.cat([points[end - len(p) : end].paste_depth() for p, end in zip(pixels, ends)])
    else:
        depth = seen.paste_depth()
    return Rendered(
        image=seen.paste(colour, _background(background, colour, size)),
        mask=seen.paste(torch.ones_like(colour[:1]), colour.new_zeros(1, 1, 1))[0],
        face=torch.full_like(layer, -1).view(-1).index_copy(0, seen.pixel, face).view(size),
        layer=layer,
        depth=depth,
    )


def _offsets(tensors):
    """How many rows stand before each tensor."""
    lengths = [len(t) for t in tensors]
    return [sum(lengths[:k]) for k in range(len(lengths))]


def _joined(surfaces, indices, of):
    """The surfaces' index arrays in one, counted through."""
    starts = _offsets(getattr(s, of) for s in surfaces)
    return torch.cat([getattr(s, indices) + n for s, n in zip(surfaces, starts)])


def _nearest(depths):
    """(H,W) int64: the layer nearest in each pixel, the lower one where equal, -1 where none is."""
    layer, least = torch.full(depths[0].shape, -1, device=depths[0].device), torch.full_like(depths[0], torch.inf)
    for k, depth in enumerate(depths):
        nearer = depth < least
        layer[nearer], least = k, torch.minimum(depth, least)
    return layer


def _background(background, colour, size):
    """As (C,H,W), without copies."""
    background = torch.as_tensor(background, dtype=colour.dtype, device=colour.device)
    return (background[:, None, None] if background.ndim == 1 else background).expand(len(colour), *size)


def _look_up(texture, uv):
    """Bilinear: texture (C,T,T) at uv (P,2) -> (C,P); beyond the outermost texel centres the texture is constant."""
    if len(uv) == 0:
        return texture.flatten(1)[:, :0]
    grid = torch.stack([2 * uv[:, 0] - 1, 1 - 2 * uv[:, 1]], 1)[None, None]
    return grid_sample(texture[None], grid, padding_mode="border", align_corners=False)[0, :, 0]


class _Points:
    """Surface points that pixels see, at most one a pixel: P of them."""

    def __init__(self, pixel, corners, weight, z, position, size):
        self.pixel = pixel  # (P,) row * W + column
        self.corners = corners  # (P,3) vertices of the face
        self.weight = weight  # (P,3) of the corners
        self.z = z  # (P,) [m]
        self.position = position  # (P,2) on the screen [px]: the pixel's centre, with the gradient of the surface point
        self.size = size

    @classmethod
    def at(cls, vertices, corners, pixel, K, size):
        column, row = pixel % size[1], pixel.div(size[1], rounding_mode="floor")
        centre = torch.stack([column, row], 1) + 0.5
        return cls(pixel, corners, *_Interpolate.apply(vertices, corners, centre, K), size)

    def __getitem__(self, i):
        fields = (self.pixel, self.corners, self.weight, self.z, self.position)
        return _Points(*(field[i] for field in fields), self.size)

    def paste(self, values, background):
        """values (C,P) put over background (C,H,W) -> (C,H,W)."""
        return _Paste.apply(values, self.position, background, self)

    def paste_depth(self):
        return self.paste(self.z[None], self.z.new_full((1, 1, 1), torch.inf))

    @cached_property
    def edges(self):
        """Micro-edges, horizontal and vertical: the pixels a (E,) and b (E,) to its right or below, the nearer's point (E,)."""
        height, width = self.size
        point = torch.full((height * width,), -1, device=self.pixel.device)
        point[self.pixel] = torch.arange(len(self.pixel), device=point.device)
        corners = torch.cat([self.corners, self.corners.new_full((1, 3), -1)])  # point -1 is emptiness
        z = torch.cat([self.z.detach(), self.z.new_full((1,), torch.inf)])
        index = torch.arange(height * width, device=point.device).view(height, width)
        return [
            _micro_edges(a.reshape(-1), a.reshape(-1) + step, point, corners, z)
            for a, step in ((index[:, :-1], 1), (index[:-1], width))
        ]


def _micro_edges(a, b, point, corners, z):
    p, q = point[a], point[b]
    some = ((p >= 0) | (q >= 0)).nonzero().squeeze(1)
    a, b, p, q = a[some], b[some], p[some], q[some]
    apart = ~(corners[p][:, :, None] == corners[q][:, None]).flatten(1).any(1)
    a, b, p, q = a[apart], b[apart], p[apart], q[apart]
    return a, b, torch.where(z[p] <= z[q], p, q)


class _Interpolate(Function):
    """Weights, depth and screen position of the points where pixels' rays meet their faces."""

    @staticmethod
    def forward(ctx, vertices, corners, centre, K):
        """vertices (n,3) in the camera's frame, corners (P,3) int64, centre (P,2) -> weight (P,3), z (P,), position (P,2)."""
        v0, v1, v2 = vertices[corners].unbind(1)
        ray = torch.cat([centre, torch.ones_like(centre[:, :1])], 1) @ torch.linalg.inv(K).T
        e1, e2 = v1 - v0, v2 - v0
        # the inverse of (e1, e2, -ray), row by row: of float32's rounding only that of v0 remains
        rows = torch.stack([torch.linalg.cross(ray, e2), torch.linalg.cross(e1, ray), torch.linalg.cross(e1, e2)], 1)
        determinant = (e1 * rows[:, 0]).sum(1)
        steep = determinant.abs() > EDGE_ON * rows[:, 2].norm(dim=1) * ray.norm(dim=1)
        rows = rows * torch.where(steep, 1 / determinant, 0.0)[:, None, None]
        second, third = (rows[:, :2] * (v0[:, 2:] * ray - v0)[:, None]).sum(2).unbind(1)
        weight = torch.stack([1 - second - third, second, third], 1).clamp(min=0)  # < 0 by snapping only
        weight = torch.where(steep[:, None], weight / weight.sum(1, keepdim=True), 1 / 3)
        z = (weight * torch.stack([v0[:, 2], v1[:, 2], v2[:, 2]], 1)).sum(1).clamp(min=NEAR)
        ctx.save_for_backward(corners, ray, K, rows, weight, z)
        ctx.shape = vertices.shape
        return weight, z, centre.clone()

    @staticmethod
    @once_differentiable
    def backward(ctx, g_weight, g_z, g_position):
        corners, ray, K, rows, weight, z = ctx.saved_tensors
        # sum_k w_k dv_k = m moves (w_1, w_2, z) by -rows m, and the screen position by K[:2,:2] (m_xy - m_z ray_xy) / z
        g = torch.stack([g_weight[:, 1] - g_weight[:, 0], g_weight[:, 2] - g_weight[:, 0], g_z], 1)
        g_ray = g_position @ K[:2, :2] / z[:, None]
        force = torch.cat([g_ray, -(g_ray * ray[:, :2]).sum(1, keepdim=True)], 1) - (g[..., None] * rows).sum(1)
        g_vertices = force.new_zeros(ctx.shape)
        g_vertices.index_add_(0, corners.view(-1), (weight[..., None] * force[:, None]).view(-1, 3))
        return g_vertices, None, None, None


class _Paste(Function):
    """Points put over a background; the way back adds the gradient of silhouettes and occlusion edges to the positions."""

    @staticmethod
    def forward(ctx, values, position, background, points):
        image = background.expand(len(values), *points.size).flatten(1).clone()
        image[:, points.pixel] = values
        ctx.save_for_backward(image)
        ctx.points, ctx.background = points, background.shape
        return image.view(-1, *points.size)

    @staticmethod
    @once_differentiable
    def backward(ctx, g):
        (image,), points = ctx.saved_tensors, ctx.points
        g = g.reshape(image.shape)
        g_position = g.new_zeros(2, len(points.pixel))
        for along, (a, b, nearer) in zip(g_position, points.edges):
            step = image[:, a] - image[:, b]
            step = torch.where(step.isfinite(), step, 0.0)  # depth beside emptiness
            along.index_add_(0, nearer, (0.5 * (g[:, a] + g[:, b]) * step).sum(0))
        g_background = None
        if ctx.needs_input_grad[2]:
            g_background = g.index_fill(1, points.pixel, 0.0).view(-1, *points.size).sum_to_size(ctx.background)
        return g[:, points.pixel], g_position.T, g_background, None
