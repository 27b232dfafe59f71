"""Differentiable rendering of textured layers: a face-id buffer without gradient, everything else recomputed in torch.

Inside a face: the ray d of a pixel meets it at z d = sum_k w_k v_k with sum_k w_k = 1; differentiating this gives the
gradients of the weights w and of the depth z. Silhouettes and occlusion edges: between adjacent pixels a and b whose
faces share no vertex, 0.5 (g_a + g_b) (I_a - I_b) goes to the screen position of the nearer one's surface point.
Both reach the vertices as one 3-vector a pixel, dealt out by w.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch.autograd.function import Function, once_differentiable
from torch.nn.functional import grid_sample
from torch.utils.weak import WeakIdKeyDictionary

from ...kernels import Contours, InputError, face_neighbours, paint, raster
from .rasterise import NEAR, rasterise, rasterise_apart

_int32, _neighbours = WeakIdKeyDictionary(), WeakIdKeyDictionary()  # of tensors of faces, which rarely change
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
        scene = _Scene(surfaces, K.float(), T_camera_world.float(), size)
        if not layer_depth and not torch.is_grad_enabled():
            return _painted(scene, background)
        return _render(scene, background, layer_depth)


def _render(scene, background, layer_depth):
    surfaces, views = scene.surfaces, scene.views() if layer_depth else [scene.view()] * len(scene.surfaces)
    front, shown = _front(scene, views) if layer_depth else (views[0], scene.shown(views[0]))
    pixels, colours, depths, own_depths = [], [], [], []
    for k, (surface, view) in enumerate(zip(surfaces, views)):
        pixel = _where(view.own >= 0 if layer_depth else shown[k])
        uv, z = scene.interpolate(k, view.face.view(-1)[pixel] - scene.first_face[k], pixel)
        if layer_depth:
            own_depths.append(view.paste(pixel, z[None], torch.inf))
            seen = _where(shown[k].view(-1)[pixel])
            pixel, uv, z = pixel[seen], uv.index_select(1, seen), z.index_select(0, seen)
        pixels.append(pixel)
        colours.append(_look_up(surface.texture.float(), uv))
        depths.append(z[None])
    pixel, colour, z = torch.cat(pixels), torch.cat(colours, 1), torch.cat(depths, 1)
    image, mask = front.pictured(pixel, colour, background)
    return Rendered(
        image=image,
        mask=mask,
        face=front.face,
        layer=sum((mask.long() * (k + 1) for k, mask in enumerate(shown)), torch.tensor(-1, device=pixel.device)),
        depth=torch.cat(own_depths) if layer_depth else front.paste(pixel, z, torch.inf),
    )


def _painted(scene, background):
    """The same picture without gradients: all layers at once by the core's loops, to rounding. For an accelerator too, which waits for
    hundreds of operations to be issued while the core draws."""
    surfaces, device = scene.surfaces, scene.vertices.device
    first_uv, first_face = _starts([s.uv for s in surfaces]), scene.first_face
    V, K, F = scene.points, scene.K.double().cpu().numpy(), scene.faces
    face_uv = np.concatenate([_indices(s.face_uv, len(s.uv)) + n for s, n in zip(surfaces, first_uv)])
    uv = torch.cat([s.uv for s in surfaces]).double().cpu().numpy()
    textures = [s.texture.detach().float().permute(1, 2, 0).contiguous().cpu().numpy() for s in surfaces]
    seen = raster(V, F, K, scene.size, near_plane=NEAR)
    image = torch.from_numpy(paint(seen.face, V, F, uv, face_uv, K, textures, first_face, EDGE_ON)).to(device)
    face = torch.tensor(seen.face, device=device)
    covered = face >= 0
    if torch.is_tensor(background) or background:
        background = torch.as_tensor(background, dtype=image.dtype, device=device)
        image = torch.where(covered, image, background[:, None, None] if background.ndim == 1 else background)
    layer = sum(((face >= n).long() for n in first_face), torch.tensor(-1, device=device))
    depth = torch.tensor(seen.depth, dtype=torch.float32, device=device)[None]
    return Rendered(image, covered.float(), face.long(), layer, depth)


def _indices(faces, count):
    """int32 of a tensor of indices below `count`, made once."""
    if faces not in _int32:
        _int32[faces] = faces.cpu().numpy().astype(np.int32)
    found = _int32[faces]
    if found.size and not (found.min() >= 0 and found.max() < count):
        raise InputError(f"render: a face has an index out of 0..{count - 1}")
    return found


def _beyond(faces):
    """The faces beyond the edges of a tensor of faces, made once."""
    if faces not in _neighbours:
        _neighbours[faces] = face_neighbours(faces.cpu().numpy())
    return _neighbours[faces]


def _where(mask):
    return mask.view(-1).nonzero().squeeze(1)


def _front(scene, views):
    """The view of all layers together, and where each is the nearest (H,W); of equal ones the first."""
    face, depth, shown = views[0].face, views[0].depth, [views[0].own >= 0]
    for view in views[1:]:
        nearer = view.depth < depth
        face, depth = torch.where(nearer, view.own + view.first, face), torch.minimum(depth, view.depth)
        shown = [mask & ~nearer for mask in shown] + [nearer]
    return _View(scene, face, depth), shown


def _look_up(texture, uv):
    """Bilinear: texture (C,T,T) at uv (2,P) -> (C,P); beyond the outermost texel centres the texture is constant."""
    if uv.shape[1] == 0:
        return texture.flatten(1)[:, :0]
    grid = torch.stack([2 * uv[0] - 1, 1 - 2 * uv[1]], 1)[None, None]
    return grid_sample(texture[None], grid, padding_mode="border", align_corners=False)[0, :, 0]


class _Scene:
    """All surfaces as one mesh in the camera's frame, its vertices and faces counted through."""

    def __init__(self, surfaces, K, T_camera_world, size):
        self.surfaces, self.K, self.size = surfaces, K, size
        world = torch.cat([s.vertices.float() for s in surfaces])
        self.vertices = _InCamera.apply(world, T_camera_world[:3, :3], T_camera_world[:3, 3])
        self.first_vertex = _starts([s.vertices for s in surfaces])
        self.first_face = _starts([s.faces for s in surfaces])

    @cached_property
    def points(self):
        """The vertices as the core takes them."""
        return self.vertices.detach().cpu().double().numpy()

    @cached_property
    def faces(self):
        """(m,3) int32."""
        return np.concatenate(
            [_indices(s.faces, len(s.vertices)) + n for s, n in zip(self.surfaces, self.first_vertex)]
        )

    @cached_property
    def neighbours(self):
        """(m,3) int32, -1 for none."""
        parts = [_beyond(s.faces) for s in self.surfaces]
        return np.concatenate([np.where(part < 0, -1, part + n) for part, n in zip(parts, self.first_face)])

    def view(self):
        """All surfaces at once."""
        faces = torch.cat([s.faces + n for s, n in zip(self.surfaces, self.first_vertex)])
        return _View(self, *rasterise(self.vertices.detach(), faces, self.K, self.size))

    def shown(self, view):
        """[(H,W)], where each surface is seen in `view`."""
        ends = [*self.first_face[1:], self.first_face[-1] + len(self.surfaces[-1].faces)]
        return [(view.face >= a) & (view.face < b) for a, b in zip(self.first_face, ends)]

    def views(self):
        """Each surface by itself."""
        vertices = self.vertices.detach().split([len(s.vertices) for s in self.surfaces])
        meshes = list(zip(vertices, (s.faces for s in self.surfaces)))
        buffers = rasterise_apart(meshes, self.K, self.size)
        return [_View(self, face, depth, n) for (face, depth), n in zip(buffers, self.first_face)]

    def interpolate(self, k, face, pixel):
        """UV (2,P) and depth (P,) [m] of the points that pixels (P,) see on faces (P,) of surface k."""
        surface, K, width = self.surfaces[k], self.K, self.size[1]
        seen = torch.zeros(len(surface.faces), dtype=torch.bool, device=face.device)
        seen[face] = True
        place, seen = (seen.cumsum(0) - 1)[face], _where(seen)
        y = (pixel.div(width, rounding_mode="floor") + 0.5 - K[1, 2]) / K[1, 1]
        x = (pixel % width + 0.5 - K[0, 2] - K[0, 1] * y) / K[0, 0]
        corners, uv = surface.faces[seen] + self.first_vertex[k], surface.uv.float()[surface.face_uv[seen]]
        return _Interpolate.apply(self.vertices, corners, uv, place, x, y)


def _starts(tensors):
    """How many rows stand before each tensor."""
    lengths = [len(t) for t in tensors]
    return [sum(lengths[:k]) for k in range(len(lengths))]


class _View:
    """Buffers without gradient, into which points of the surfaces are put."""

    def __init__(self, scene, own, depth, first=0):
        self.scene = scene
        self.own = own  # (H,W) faces counted from face `first` of the scene, -1 where empty
        self.depth = depth  # (H,W) [m], inf where empty
        self.first = first

    @cached_property
    def face(self):
        return torch.where(self.own < 0, -1, self.own + self.first) if self.first else self.own

    def paste(self, pixel, values, background):
        """values (C,P) of all points, in pixels (P,), over a background: a number, (C,) or (C,H,W) -> (C,H,W)."""
        return _Paste.apply(values, self.scene.vertices, self._spread(background, values), pixel, self)

    def pictured(self, pixel, colour, background):
        """The same of colours (C,P), and the mask (H,W) of all points; contours move both, and are looked for once."""
        background, seen = self._spread(background, colour), torch.ones_like(colour[:1])
        under = torch.cat([background, torch.zeros_like(background[:1])])
        both = _Paste.apply(torch.cat([colour, seen]), self.scene.vertices, under, pixel, self)
        image, mask = both.split([len(colour), 1])
        return image, mask[0]

    def _spread(self, background, values):
        background = torch.as_tensor(background, dtype=values.dtype, device=values.device)
        background = background[:, None, None] if background.ndim == 1 else background
        return background.expand(len(values), *self.own.shape)

    def slope(self, picture, g):
        """Of a loss by the vertices (n,3), by the motion of contours, where it has the slope g (C,H,W) by a picture (C,H,W): by
        the core, on any device."""
        scene, face, depth, g = self.scene, self.face.cpu().numpy(), self.depth.cpu().numpy(), g.cpu().numpy()
        of = (g != 0).any(0)
        found = Contours(face, depth, scene.points, scene.faces, scene.neighbours, scene.K.cpu().numpy(), NEAR, of)
        return found.gradient(picture.cpu().numpy(), g)


class _InCamera(Function):
    """R v + t of vertices (n,3); not rounded on the way back either, where autocast is on again."""

    @staticmethod
    def forward(ctx, vertices, R, t):
        ctx.save_for_backward(R)
        return torch.addmm(t, vertices, R.T)

    @staticmethod
    @once_differentiable
    def backward(ctx, g):
        with torch.autocast(g.device.type, enabled=False):
            return g @ ctx.saved_tensors[0], None, None


class _Interpolate(Function):
    """UV and depth of the points where pixels' rays meet faces: F faces that are seen, P pixels that see them.

    With V = (v_0 v_1 v_2) and the ray d, z d = V w gives w = z V^-1 d, and sum_k w_k = 1 gives 1/z = c . d with
    c = V^-T 1. Corners moved by dV, with m = dV w, give dz = z c . m and dw = (c . m) w - V^-1 m.
    """

    @staticmethod
    def forward(ctx, vertices, corners, uv, place, x, y):
        """vertices (n,3) in the camera's frame, corners (F,3), uv (F,3,2), place (P,) in F, rays (x, y, 1)."""
        inverse = _inverse(vertices[corners]).flatten(1).T.contiguous().index_select(1, place).view(3, 3, -1)
        uv = uv.flatten(1).T.contiguous().index_select(1, place).view(3, 2, -1)
        weight = (inverse[:, 0] * x + inverse[:, 1] * y + inverse[:, 2]).clamp(min=0)  # < 0 by snapping only
        z = weight.sum(0).reciprocal()
        weight = weight * z
        ctx.save_for_backward(corners, place, inverse, uv, weight, z)
        ctx.shape = vertices.shape
        return (uv * weight[:, None]).sum(0), z

    @staticmethod
    @once_differentiable
    def backward(ctx, g_uv, g_z):
        corners, place, inverse, uv, weight, z = ctx.saved_tensors
        g_weight = (uv * g_uv).sum(1)
        m = (g_z * z + (g_weight * weight).sum(0)) * inverse.sum(0) - (inverse * g_weight[:, None]).sum(0)  # (3,P)
        g_corners = m.new_zeros(9, len(corners))
        g_corners.scatter_add_(1, place.expand(9, -1), (weight[:, None] * m).view(9, -1))
        g_vertices = m.new_zeros(ctx.shape)
        g_vertices.index_add_(0, corners.T.reshape(-1), g_corners.view(3, 3, -1).transpose(1, 2).reshape(-1, 3))
        return g_vertices, None, None, None, None, None


def _inverse(corners):
    """V^-1 of faces (F,3,3), corner by corner; of a face seen edge-on that of a frontal one at its mean depth."""
    v0, v1, v2 = corners.double().unbind(1)  # cross products of nearly parallel vectors
    rows = torch.stack([torch.linalg.cross(v1, v2), torch.linalg.cross(v2, v0), torch.linalg.cross(v0, v1)], 1)
    normal, volume = torch.linalg.cross(v1 - v0, v2 - v0), (v0 * rows[:, 0]).sum(1)
    nearest = corners.norm(dim=2).amin(1)
    edge_on = volume.abs() <= EDGE_ON * normal.norm(dim=1) * nearest
    frontal = torch.zeros_like(rows)
    frontal[..., 2] = 1 / (3 * corners[..., 2].mean(1, keepdim=True).clamp(min=NEAR))
    return torch.where(edge_on[:, None, None], frontal, rows / volume[:, None, None]).float()


class _Paste(Function):
    """Points put over a background; the way back adds the gradients of silhouettes and occlusion edges."""

    @staticmethod
    def forward(ctx, values, vertices, background, pixel, view):
        picture = background.flatten(1).clone()
        picture[:, pixel] = values
        ctx.save_for_backward(picture, vertices, pixel)
        ctx.view = view
        return picture.view(background.shape)

    @staticmethod
    @once_differentiable
    def backward(ctx, g_picture):
        (picture, vertices, pixel), g = ctx.saved_tensors, g_picture.flatten(1)
        g_vertices = g_background = None
        if ctx.needs_input_grad[1] and g.any():  # a layer's own depth rarely has a gradient
            slope = ctx.view.slope(picture.view(g_picture.shape), g_picture)
            g_vertices = torch.from_numpy(slope).to(vertices)
        if ctx.needs_input_grad[2]:
            g_background = g.index_fill(1, pixel, 0.0).view(g_picture.shape)
        return g.index_select(1, pixel), g_vertices, g_background, None, None
