"""The layered avatar, and the single-layer baseline in the same code: layers joined with skeleton, poses and cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import nn
from torch.nn.functional import avg_pool2d

from ... import kernels
from ..render.renderer import render
from .carried import Carried, Projection
from .layer_model import LayerModel
from .networks import count, reparameterised
from .operators import joint_centroids, uniform_laplacian
from .sizes import layer_sizes, modes_of
from .skinning import Skeleton, rotation_matrices

FACE_SCALE = 0.01  # a usual motion of a facial keypoint [m]


class Avatar(nn.Module):
    """All layers of a person, body first, and the cameras' colours.

    `layers`: what `read_layers` gives, or [surface_layer] for the baseline. `J` (K,3) and `parents` (K,): the skeleton.
    `mean_texture` {name: (3,T,T)} and `valid` {name: (T,T)}. `face_mean` (q,3): mean facial keypoints in the frame of
    joint `head`, None where no face drives the avatar. `poses`: those of the training, as `AvatarData.poses`; networks read none as
    lying beyond them, joint by joint. `light` (8,3) and `mean_light` {name: (3,s,s)}: of light.py, None where light is not told
    from what it falls on. One camera, or a scene that says so: no view branch.
    """

    def __init__(
        self,
        settings,
        layers,
        J,
        parents,
        cameras,
        scene,
        mean_texture,
        valid,
        face_mean=None,
        head=None,
        poses=None,
        light=None,
        mean_light=None,
    ):
        super().__init__()
        self.settings, self.layers, self.cameras, self.scene = settings, list(layers), list(cameras), scene
        self.names = [layer.name for layer in self.layers]
        self.skeleton = Skeleton(np.asarray(J), np.asarray(parents))
        face = None if face_mean is None else np.nan_to_num(np.asarray(face_mean, dtype=np.float64))
        if face is not None:
            self.register_buffer("face_mean", torch.as_tensor(face, dtype=torch.float32), persistent=False)
            face = face if head is None else face + np.asarray(J)[head]
        self.models = nn.ModuleList(
            LayerModel(
                layer,
                layer_sizes(
                    layer.kind, settings, cameras, scene, len(J), 0 if face is None else len(face), modes_of(layer)
                ),
                mean_texture[layer.name],
                valid[layer.name],
                np.asarray(parents),
                face,
                mean_light and mean_light[layer.name],
            )
            for layer in self.layers
        )
        light = None if light is None else torch.as_tensor(light, dtype=torch.float32)
        self.register_buffer("light", light, persistent=False)
        self.register_buffer("up", up_vector(scene.up), persistent=False)
        taught = None if poses is None else pose_features(torch.as_tensor(poses["rotations"]), self.up)
        limits = None if taught is None else torch.stack([taught.amin(0), taught.amax(0)])
        self.register_buffer("pose_range", limits, persistent=False)  # (2,K,9)
        garments = [layer for layer in self.layers if layer.kind == "garment"]
        self.carried = Carried(garments, self.skeleton, self.up, getattr(self, "face_mean", None)) if garments else None
        self.projection = Projection(self.carried.size) if garments and settings.data.window else None
        others = max(len(self.cameras) - 1, 0)
        self.colour_gain = nn.Parameter(torch.zeros(others, 3))  # less 1
        self.colour_bias = nn.Parameter(torch.zeros(others, 3))
        self.laplacian = {x.name: uniform_laplacian(x.faces, len(x.rest)) for x in self.layers}
        self.anchors = {
            x.name: joint_centroids(x.skin_idx, x.skin_val, len(J)) for x in self.layers if x.kind == "surface"
        }
        self.operators = nn.ModuleList([*self.laplacian.values(), *self.anchors.values()])  # so that they move along

    def layer(self, name):
        return self.layers[self.names.index(name)]

    def model(self, name):
        return self.models[self.names.index(name)]

    def transforms(self, batch):
        """The skeleton's (R, t) of a batch's poses, see `Skeleton`."""
        if "transforms" in batch:
            return batch["transforms"]
        with torch.autocast(batch["rotations"].device.type, enabled=False):
            return self.skeleton(batch["rotations"], batch["translation"])

    def unposed(self, batch, name):
        """Registered vertices of a layer (B,n,3), unposed [m]: the target of geometry and Laplacian."""
        if f"unposed.{name}" in batch:
            return batch[f"unposed.{name}"]
        with torch.autocast(batch["rotations"].device.type, enabled=False):
            return self.model(name).skin.unpose(batch[f"vertices.{name}"], *self.transforms(batch))

    def with_unposed(self, batch, names):
        """The batch, and what a step reads of it several times: `transforms`, and `unposed` of these layers."""
        batch = batch | {"transforms": self.transforms(batch)}
        return batch | {f"unposed.{name}": self.unposed(batch, name) for name in names}

    def encode(self, batch, names=None):
        """{layer: (mean, logvar)}, each (B,Z), of the layers that have a code."""
        return {
            model.name: model.encode(
                self.unposed(batch, model.name),
                batch[f"mean_texture.{model.name}"],
                batch[f"mean_weight.{model.name}"],
                self._registered_lit(batch, model),
            )
            for model in self._chosen(names)
            if model.networks.encoder is not None
        }

    def _registered_lit(self, batch, model):
        """How the texels of the batch's own frames were lit, see `LayerModel.lit`."""
        if self.light is None or model.mean_light is None:
            return None
        return model.lit(model.facing.normals(batch[f"vertices.{model.name}"]), self.light)

    @staticmethod
    def sample(codes):
        """{layer: z} drawn from the codes, by torch's global generator."""
        return {name: reparameterised(*code) for name, code in codes.items()}

    @staticmethod
    def means(codes):
        """{layer: z} without noise."""
        return {name: mean for name, (mean, _) in codes.items()}

    def encoded(self, batch):
        """{layer: z} of the batch's own frames, to be decoded: the means of their codes, and what these leave of the shapes."""
        codes = self.means(self.encode(batch))
        left = [name for name in codes if self.model(name).sizes.remainder]
        for name, found in self.decode(batch, codes, left, texture=False).items():
            remainder = self.model(name).remainder(self.unposed(batch, name) - found.unposed)
            codes[name] = torch.cat([codes[name], remainder], 1)
        return codes

    @staticmethod
    def impute(codes):
        """{layer: z'} that say nothing of their samples: each the code of another sample, or of the unit Gaussian."""
        imputed = {}
        for name, (mean, logvar) in codes.items():
            other = reparameterised(mean, logvar).detach().roll(1, 0)
            prior = torch.rand(len(mean), 1, device=mean.device) < (0.5 if len(mean) > 1 else 1.0)
            imputed[name] = torch.where(prior, torch.randn_like(mean), other)
        return imputed

    def decode(self, batch, latents, names=None, texture=True):
        """{layer: Decoded} from pose, face and camera of the batch and the layers' codes; float32 in any autocast."""
        pose = self._as_taught(pose_features(batch["rotations"], self.up))
        view, transforms = batch["T_camera_world"], self.transforms(batch)
        with torch.autocast(view.device.type, enabled=False):
            centre = -(view[:, :3, :3].transpose(1, 2) @ view[:, :3, 3:])[..., 0]
        face = self._face_features(batch["face"], batch["face_seen"]) if hasattr(self, "face_mean") else None
        return {
            model.name: model.decode(
                pose, face, self._code(model, batch, latents), transforms, centre, texture, self.light
            )
            for model in self._chosen(names)
        }

    def unposed_by(self, name, codes):
        """Vertices (B,n,3) of a layer that its codes (B,Z) decide [m]: alone of a garment, of a surface in the pose of rest."""
        model, count = self.model(name), len(codes)
        pose = self._as_taught(codes.new_zeros(count, len(self.skeleton.J), 9))  # of R - 1
        face = codes.new_zeros(count, *self.face_mean.shape) if hasattr(self, "face_mean") else None
        return model.decode_shape(model.features(pose, face, codes), codes)

    def _as_taught(self, features):
        """Features (B,K,9) of poses within the range of the training's: beyond it networks were never taught what to draw."""
        return features if self.pose_range is None else features.clamp(*self.pose_range)

    def _face_features(self, face, seen):
        return (face - self.face_mean) / FACE_SCALE * seen[..., None]

    def _code(self, model, batch, latents):
        """The code of a layer (B,Z): given, or regressed from the batch's window of poses; None of a body."""
        if model.networks.regressor is None:
            return latents.get(model.name)
        return model.networks.regressor(self.projection(self.window_features(batch))).float()

    def window_features(self, batch):
        """What moves the garments, of a batch's windows of poses and faces (B,L,P)."""
        rotations, face, seen = (batch[f"window.{name}"] for name in ("rotations", "face", "face_seen"))
        face = torch.where(seen[..., None] > 0, face, torch.nan).flatten(0, 1) if hasattr(self, "face_mean") else None
        return self.carried(rotations.flatten(0, 1), face).reshape(*rotations.shape[:2], -1)

    @torch.no_grad()
    def ambient_occlusion(self, decoded):
        """{layer: (B,n)} openness of each vertex amid all layers: 1 = nothing above it, or no texel of its shadow reads it."""
        rays, names = self.settings.network.ao_rays, list(decoded)
        vertices = [decoded[name].vertices.detach().double().cpu().numpy() for name in names]
        starts = np.cumsum([0, *(v.shape[1] for v in vertices)])
        faces = np.concatenate([self.layer(n).faces + s for n, s in zip(names, starts.astype(np.int32), strict=False)])
        together = np.concatenate(vertices, axis=1)
        read = np.concatenate([self.model(n).shadow_texels.vertices + s for n, s in zip(names, starts, strict=False)])
        open_sky = np.ones(together.shape[:2])
        for row, v in zip(open_sky, together):
            row[read] = kernels.ambient_occlusion(v, faces, rays=rays, of=read)
        like = decoded[names[0]].vertices
        open_sky = torch.as_tensor(open_sky, dtype=torch.float32, device=like.device)
        return {name: open_sky[:, a:b] for name, a, b in zip(names, starts, starts[1:], strict=False)}

    @torch.no_grad()
    def fit_projection(self, data):
        """Fits the windows' projection to the frames of `data`, where garments are regressed from them."""
        if self.projection is not None:
            windows = [data.pose_window(number) for number in data.frames]
            stacked = {name: torch.stack([w[name] for w in windows]).to(self.up.device) for name in windows[0]}
            self.projection.fit(self.window_features(stacked)[:, -1])

    @torch.no_grad()
    def set_mean_ao(self, mean):
        """Keeps {layer: (n,)}, the mean over the training frames that shadows are relative to."""
        for name, value in mean.items():
            self.model(name).mean_ao.copy_(torch.as_tensor(value))

    def shade(self, decoded, occlusion=None):
        """The same layers with quasi-shadows, from the ambient occlusion of their decoded geometry, detached."""
        if not self.settings.network.shadow:
            return decoded
        occlusion = self.ambient_occlusion(decoded) if occlusion is None else occlusion
        return {
            name: replace(one, shadow=self.model(name).quasi_shadow(occlusion[name])) for name, one in decoded.items()
        }

    def compose(self, decoded, batch, size, layer_depth=False, shadow=True, samples=1):
        """[Rendered], one a sample: all layers drawn together at size (height, width), in the camera's colours.

        `samples` squared a pixel are averaged in image and mask; the other buffers stay as fine as they were drawn.
        """
        if shadow:
            decoded = self.shade(decoded)
        pictures, layers = [], [self.model(name).surfaces(one) for name, one in decoded.items()]
        for b, surfaces in enumerate(zip(*layers, strict=True)):
            K = batch["K"][b] * batch["K"].new_tensor([[samples], [samples], [1]])
            fine = size[0] * samples, size[1] * samples
            seen = render(surfaces, K, batch["T_camera_world"][b], fine, layer_depth=layer_depth)
            image, mask = seen.image, seen.mask
            if samples > 1:
                image, mask = avg_pool2d(image[None], samples)[0], avg_pool2d(mask[None], samples)[0]
            image = self.colour(image[None], batch["camera"][b : b + 1], mask)[0]
            pictures.append(replace(seen, image=image, mask=mask))
        return pictures

    def colour(self, picture, camera, coverage=1.0):
        """gain x picture + bias x coverage, per camera: pictures (B,3,h,w), cameras (B,).

        Camera 0 is the measure of the others, -1 a camera that the avatar was not trained on; both change nothing.
        """
        same = torch.zeros(1, 3, device=picture.device)
        gain = torch.cat([same, self.colour_gain, same])[camera][..., None, None]
        bias = torch.cat([same, self.colour_bias, same])[camera][..., None, None]
        return torch.addcmul(bias * coverage, picture, 1 + gain)

    def parameters_count(self):
        return count(self)

    def describe(self):
        """What avatar.json says of the architecture."""
        return {
            "layers": [
                {
                    "name": model.name,
                    "kind": model.kind,
                    "vertices": len(model.rest),
                    "parts": [part for part, net in model.networks.named_children() if net is not None],
                    "parameters": count(model),
                }
                for model in self.models
            ],
            "cameras": [camera.name for camera in self.cameras],
            "face_points": len(self.face_mean) if hasattr(self, "face_mean") else 0,
            "geometry_size": self.settings.data.geometry_size,
            "texture_size": self.settings.data.texture_size,
            "latent": self.settings.network.latent,
            "modes": {model.name: len(model.modes) for model in self.models},
            "parameters": self.parameters_count(),
        }

    def _chosen(self, names):
        return [model for model in self.models if names is None or model.name in names]


def up_vector(up):
    """The scene's up axis ("z", "-y") as a vector (3,)."""
    return torch.eye(3)["xyz".index(up[-1])] * (-1 if up.startswith("-") else 1)


@torch.no_grad()
def pose_features(rotations, up):
    """Features (B,K,9) of a pose: R - 1 of each joint's local rotation, continuous everywhere.

    The root (joint 0) gives only where up is, seen from it, less the rest pose's: which way the person faces, and where
    it stands, changes nothing of an unposed body.
    """
    with torch.autocast(rotations.device.type, enabled=False):
        R = rotation_matrices(rotations.float())
        features = (R - torch.eye(3, device=R.device)).flatten(2)
        features[:, 0] = 0
        features[:, 0, :3] = R[:, 0].transpose(1, 2) @ up - up
    return features
