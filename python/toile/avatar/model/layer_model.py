"""One layer of an avatar: its surface, fixed, and the networks that decode its shape and its texture.

A layer of kind "body" is driven by pose and face, a "garment" by its code alone, and the single-layer baseline's only
layer, a "surface", by all three. All geometry is unposed until linear blend skinning poses it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import nn

from ...surface.uv import UvMap
from ..render.renderer import Surface
from .light import irradiance, irradiance_basis
from .networks import COLOUR_IN, LayerNetworks, resize
from .operators import Facing
from .remainder import manifold_harmonics
from .skinning import Skin
from .uv import TexelValues, UvSampler

GEOMETRY_IN = 0.01  # displacement that the encoder reads as 1 [m]
GEOMETRY_OUT, COLOUR_OUT = 0.1, 0.5  # displacement [m] and colour of 1 in a head's map: small steps of Adam do
HEAD_REACH = 0.12  # vertices that facial keypoints drive lie this near to one of them [m]
MASK_HOPS = 2  # a joint acts on what it skins, and on what joints this near to it in the skeleton skin


@dataclass
class Decoded:
    """One layer of a batch."""

    unposed: torch.Tensor  # (B,n,3) [m]
    vertices: torch.Tensor  # (B,n,3) posed, in the world [m]
    mean_texture: torch.Tensor | None = None  # (B,3,T,T) of no view and no light in particular; an edit's may be finer
    texture: torch.Tensor | None = None  # (B,3,T,T) as this sample's camera sees it in this pose's light, before shadow
    shadow: torch.Tensor | None = None  # (B,1,T,T) quasi-shadow

    @property
    def shaded(self):
        """The texture to draw (B,3,T,T)."""
        return self.texture if self.shadow is None else self.texture * resize(self.shadow, self.texture.shape[-1])


class LayerModel(nn.Module):
    """One layer: its fixed surface (buffers, rebuilt from the assets) and its networks (the saved state)."""

    def __init__(self, layer, sizes, mean_texture, valid, parents, face=None, mean_light=None):
        """`mean_light` (3,s,s): E' of light.py, None where light is not told from what it falls on."""
        super().__init__()
        self.name, self.kind, self.label, self.sizes = layer.name, layer.kind, layer.label, sizes
        geometry_map = UvMap(layer, sizes.geometry)
        if sizes.joints:
            sizes = replace(sizes, mask=joint_masks(layer, geometry_map, parents, sizes.start))
        if sizes.face_points:
            sizes = replace(sizes, head=head_mask(layer, geometry_map, face, sizes.start))
        self.networks = LayerNetworks(sizes)
        fixed = dict(
            rest=torch.as_tensor(np.asarray(layer.rest, dtype=np.float32)),
            faces=torch.as_tensor(np.asarray(layer.faces, dtype=np.int64)),
            uv=torch.as_tensor(np.asarray(layer.uv, dtype=np.float32)),
            face_uv=torch.as_tensor(np.asarray(layer.face_uv, dtype=np.int64)),
            mean_texture=torch.as_tensor(mean_texture, dtype=torch.float32),
            valid=torch.as_tensor(valid, dtype=torch.float32)[None],
        )
        for key, value in fixed.items():
            self.register_buffer(key, value.clone(), persistent=False)
        coarse = resize(self.mean_texture[None], sizes.view_size) if sizes.view else None
        self.register_buffer("coarse_texture", coarse, persistent=False)
        modes = np.zeros((0, *layer.rest.shape)) if layer.modes is None else layer.modes
        self.register_buffer("modes", torch.as_tensor(modes, dtype=torch.float32).flatten(1), persistent=False)
        self.register_buffer("mean_ao", torch.zeros(len(layer.rest)))
        self.skin, self.sampler = Skin(layer), UvSampler(layer, sizes.geometry)
        self.geometry_texels = TexelValues(geometry_map, layer.faces)
        self.facing = Facing(layer.faces) if sizes.view or mean_light is not None else None
        self.view_texels = TexelValues(UvMap(layer, sizes.view_size), layer.faces) if sizes.view else None
        self.shadow_texels = TexelValues(UvMap(layer, sizes.occlusion), layer.faces)
        known = None if mean_light is None else torch.as_tensor(mean_light, dtype=torch.float32)
        self.register_buffer("mean_light", known, persistent=False)
        self.light_texels = None if known is None else TexelValues(UvMap(layer, known.shape[-1]), layer.faces)
        self.edits = None  # edits.LayerEdits
        self._harmonics = None  # made where they are asked for

    def encode(self, unposed, texture, weight, lit=None):
        """Code (mean, logvar), each (B,Z), Z = modes + latent: of unposed vertices (B,n,3), texture (B,3,T,T), its weights
        (B,1,T,T) and how it was `lit`."""
        shape = self.geometry_texels((unposed - self.rest) / GEOMETRY_IN)
        seen = (weight > 0) & (self.valid > 0)
        texture = texture if lit is None else texture / resize(lit, self.texels)
        colour = torch.where(seen, texture - self.mean_texture, 0.0) / COLOUR_IN
        mean, logvar = self.networks.encoder(shape, resize(colour, self.sizes.texture))
        return torch.cat([self.amplitudes(unposed), mean], 1), logvar

    @property
    def texels(self):
        """T, along a side of the texture."""
        return self.mean_texture.shape[-1]

    @property
    def code_size(self):
        """Z, numbers of the code."""
        return len(self.modes) + self.sizes.latent

    @property
    def harmonics(self):
        """(n,R) displacements of the remainder, and the vertices' masses (n,1)."""
        device = self.rest.device
        if self._harmonics is None:
            H, mass = manifold_harmonics(
                self.rest.cpu().double().numpy(), self.faces.cpu().numpy(), self.sizes.remainder
            )
            self._harmonics = tuple(torch.as_tensor(x, dtype=torch.float32) for x in (H, mass[:, None]))
        if self._harmonics[0].device != device:
            self._harmonics = tuple(x.to(device) for x in self._harmonics)
        return self._harmonics

    def remainder(self, left):
        """(B,3R) [m^2]: what of displacements (B,n,3) that a code leaves is smooth."""
        H, mass = self.harmonics
        return torch.einsum("nr,bnx->brx", H * mass, left).flatten(1)

    def amplitudes(self, unposed):
        """Of the principal modes (B,M) in vertices (B,n,3): 1 = a standard deviation over the training frames."""
        with torch.autocast(unposed.device.type, enabled=False):
            return (unposed - self.rest).flatten(1) @ (self.modes / self.modes.square().sum(1, keepdim=True)).T

    def features(self, pose, face, z):
        """What drives the decoders, see `LayerNetworks.features`: of a code with a remainder the code alone."""
        return self.networks.features(pose, face, None if z is None else z[:, : self.code_size])

    def lit(self, normals, light):
        """How much more light than on their mean falls on the texels (B,3,s,s), of normals (B,n,3) and `Avatar.light`; None
        where that is not known."""
        if light is None or self.mean_light is None:
            return None
        with torch.autocast(normals.device.type, enabled=False):
            more = self.light_texels(
                irradiance(irradiance_basis(normals), light) - 1
            ).contiguous()  # as the mean: planes
            return (1 + more) / self.mean_light

    def decode(self, pose, face, z, transforms, centre, texture=True, light=None):
        """Pose features (B,K,C), face (B,q,3) and code (B,Z), or code and remainder (B,Z + 3R), posed by `transforms`, seen
        from centre (B,3) and lit by `light` (8,3), see `lit`."""
        features = self.features(pose, face, z)
        unposed = self.decode_shape(features, z)
        with torch.autocast(features.device.type, enabled=False):
            decoded = Decoded(unposed, self.skin.pose(unposed, *transforms))
        if not texture:
            return decoded
        residual = self.networks.texture(features)
        decoded.mean_texture = decoded.texture = self._coloured(self.mean_texture, residual)
        normals = None if self.facing is None else self.facing.normals(decoded.vertices)
        if self.networks.view is not None:
            cosine = self.view_texels(self.facing(decoded.vertices, centre, normals))
            seen = self.networks.view_residual(self._coloured(self.coarse_texture[0], residual), cosine)
            decoded.texture = self._coloured(decoded.mean_texture, seen)
        if self.edits is not None:
            decoded.mean_texture, decoded.texture = self.edits(decoded.mean_texture, decoded.texture)
        lit = self.lit(normals, light)
        if lit is not None:
            decoded.texture = decoded.texture * resize(lit, decoded.texture.shape[-1])
        return decoded

    def decode_shape(self, features, z):
        """Unposed vertices (B,n,3), float32, of what the networks decode of their features, of the code's amplitudes, and of the
        remainder where z has one."""
        displacement = self.networks.geometry(features)
        with torch.autocast(features.device.type, enabled=False):
            unposed = self.rest + GEOMETRY_OUT * self.sampler(displacement)
            if len(self.modes):
                unposed = unposed + (z[:, : len(self.modes)] @ self.modes).reshape(unposed.shape)
            if z is not None and z.shape[1] > self.code_size:
                left = z[:, self.code_size :].reshape(len(z), -1, 3)
                unposed = unposed + torch.einsum("nr,brx->bnx", self.harmonics[0], left)
        return unposed

    @staticmethod
    def _coloured(mean, residual):
        """Textures (3,T,T) or (B,3,T,T) with a residual (B,3,s,s) of them."""
        return torch.add(mean, resize(residual, mean.shape[-1]), alpha=COLOUR_OUT)

    def quasi_shadow(self, occlusion):
        """Quasi-shadow (B,1,T,T) of ambient occlusion (B,n): 1 = as its mean; None where settings ask for none."""
        if self.networks.shadow is None:
            return None
        maps = self.shadow_texels((occlusion - self.mean_ao)[..., None])
        return resize(self.networks.shadow(maps), self.texels)

    def surfaces(self, decoded):
        """[Surface], the samples of a batch as the renderer takes them."""
        return [
            Surface(vertices, self.faces, self.uv, self.face_uv, texture)
            for vertices, texture in zip(decoded.vertices.unbind(), decoded.shaded.unbind(), strict=True)
        ]


def joint_masks(layer, texels, parents, size):
    """Where each joint may act, (K,size,size): skinning weights of the joint and of those within MASK_HOPS of it."""
    joints = len(parents)
    near = np.eye(joints)
    for k, p in enumerate(parents):
        if p >= 0:
            near[k, p] = near[p, k] = 1
    near = np.linalg.matrix_power(near, MASK_HOPS) > 0
    near[0] = True  # the root's tilt acts everywhere
    weights = np.zeros((len(layer.rest), joints))
    np.add.at(weights, (np.arange(len(weights))[:, None], layer.skin_idx), layer.skin_val)
    return shrunk(np.minimum(weights @ near.T, 1), texels, size)


def head_mask(layer, texels, face, size):
    """Where facial keypoints (q,3), placed on the rest pose, may act: (size,size), 1 near them, 0 beyond HEAD_REACH."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(face).query(layer.rest)
    return shrunk(np.clip(2 - 2 * distance / HEAD_REACH, 0, 1)[:, None], texels, size)[0]


def shrunk(values, texels, size):
    """Vertex values (n,C) as a map (C,size,size), each texel the mean over what is valid of it."""
    maps, step = texels.texels(values).transpose(2, 0, 1), texels.size // size

    def pooled(x):
        return x.reshape(*x.shape[:-2], size, step, size, step).sum((-3, -1))

    return torch.as_tensor(pooled(maps) / np.maximum(pooled(texels.valid.astype(float)), 1), dtype=torch.float32)
