"""A person of two nested tubes and three joints, and batches of it: as small as an avatar can be."""

import numpy as np
import torch

from toile.avatar.model.avatar import Avatar
from toile.avatar.settings import AvatarSettings, DataSettings, NetworkSettings
from toile.scene import Camera, Garment, Scene
from toile.surface.layers import Layer

JOINTS = np.array([[0.0, 0, 0], [0, 0, 0.2], [0, 0, 0.4]])
PARENTS = np.array([-1, 0, 1])
SIZE = (32, 24)  # of the pictures
FACE = np.array([[0.05, -0.1, 0.5], [-0.05, -0.1, 0.5]])  # in the frame of joint 2, 0.1 m above it
LABELS = {"body": -1, "surface": -1, "shirt": 3, "jacket": 4}


def tube(name, kind, radius, low=0.0, high=0.6, around=12, along=9):
    """A layer: an open tube about the z axis, its UV chart a square; skinned by height, moved by 1 cm of noise."""
    a, z = np.meshgrid(np.arange(around) / around * 2 * np.pi, np.linspace(low, high, along))
    rest = np.stack([radius * np.cos(a), radius * np.sin(a), z], -1).reshape(-1, 3)
    u, v = np.meshgrid(0.1 + 0.8 * np.arange(around + 1) / around, 0.1 + 0.8 * np.linspace(0, 1, along))
    i, j = (x.ravel() for x in np.meshgrid(np.arange(along - 1), np.arange(around), indexing="ij"))

    def quads(width):
        corner = [i * width + j, i * width + (j + 1) % width, (i + 1) * width + (j + 1) % width, (i + 1) * width + j]
        return np.concatenate([np.stack([corner[k] for k in t], 1) for t in ((0, 1, 2), (0, 2, 3))]).astype(np.int32)

    pull = np.exp(-(((rest[:, 2:] - JOINTS[:, 2]) / 0.08) ** 2))
    return Layer(
        name=name,
        kind=kind,
        rest=rest + np.random.default_rng(1).normal(0, 0.002, rest.shape),
        faces=quads(around),
        uv=np.stack([u, v], -1).reshape(-1, 2),
        face_uv=quads(around + 1),
        skin_idx=np.tile(np.arange(3, dtype=np.int32), (len(rest), 1)),
        skin_val=pull / pull.sum(1, keepdims=True),
        label=LABELS[name],
        loops={},
    )


BODY = tube("body", "body", 0.10)
SHIRT = tube("shirt", "garment", 0.12, 0.1, 0.5)
JACKET = tube("jacket", "garment", 0.14, 0.1, 0.5)
SURFACE = tube("surface", "surface", 0.12)


def settings(**network):
    sizes = dict(latent=4, width=16, least_width=4, shadow_width=2, ao_rays=4, ao_size=16)
    return AvatarSettings(
        data=DataSettings(geometry_size=16, texture_size=32, image=SIZE), network=NetworkSettings(**(sizes | network))
    )


def cameras(n):
    """n cameras 2 m away, looking at the tubes' middle; x right, y down, z forward."""
    made = []
    for k in range(n):
        c, s = np.cos(k), np.sin(k)
        T = np.eye(4)
        T[:3, :3] = np.array([[c, s, 0], [0, 0, -1], [-s, c, 0]])
        T[:3, 3] = [0, 0.3, 2.0]
        K = np.array([[90.0, 0, 12], [0, 90, 16], [0, 0, 1]])
        made.append(Camera(f"cam{k}", SIZE[1], SIZE[0], K, np.zeros(5), T))
    return made


def scene(layers, view_dependent=True):
    garments = tuple(Garment(x.name, f"{x.name}.obj", x.name) for x in layers if x.kind == "garment")
    labels = {"skin": 1, "shirt": 3, "jacket": 4}
    return Scene("tubes", 30, "m", "z", "anny", labels, garments, face_keypoints=True, view_dependent=view_dependent)


def avatar(layers=(BODY, SHIRT), views=3, face=True, seed=0, options=None, view_dependent=True, poses=None, **light):
    torch.manual_seed(seed)
    options = options or settings()
    size = options.data.texture_size
    rng = np.random.default_rng(0)
    return Avatar(
        options,
        layers,
        JOINTS,
        PARENTS,
        cameras(views),
        scene(layers, view_dependent),
        {x.name: rng.uniform(0.3, 0.7, (3, size, size)) for x in layers},
        {x.name: np.ones((size, size), dtype=bool) for x in layers},
        FACE - [0, 0, 0.4] if face else None,
        2 if face else None,
        poses,
        **light,
    )


def awake(model, size=0.3, seed=5):
    """Moves every parameter off its start, as training would."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for p in model.parameters():
            p += size * torch.randn(p.shape, generator=generator) * p.abs().mean().clamp(min=0.1)
    return model


def batch(model, samples=2, seed=0):
    """Random poses, noisy registrations and random pictures of every layer of `model`."""
    g = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(shape, generator=g)

    def uniform(*shape):
        return torch.rand(shape, generator=g)

    size = model.settings.data.texture_size
    camera = torch.arange(samples) % len(model.cameras)
    chosen = [model.cameras[i] for i in camera]
    made = dict(
        frame=torch.arange(samples),
        camera=camera,
        rotations=0.3 * normal(samples, 3, 3),
        translation=0.02 * normal(samples, 3),
        face=torch.as_tensor(FACE - [0, 0, 0.4]).float() + 0.01 * normal(samples, 2, 3),
        face_seen=torch.ones(samples, 2),
        K=torch.as_tensor(np.stack([c.K for c in chosen])).float(),
        T_camera_world=torch.as_tensor(np.stack([c.T_camera_world for c in chosen])).float(),
        image=uniform(samples, 3, *SIZE),
        mask=(uniform(samples, *SIZE) < 0.7).float(),
        labels=torch.where(uniform(samples, *SIZE) < 0.5, 3, 1),
    )
    transforms = model.skeleton(made["rotations"], made["translation"])
    for layer in model.layers:
        name, n = layer.name, len(layer.rest)
        moved = torch.as_tensor(layer.rest).float() + 0.01 * normal(samples, n, 3)
        made[f"vertices.{name}"] = model.model(name).skin.pose(moved, *transforms)
        made[f"confidence.{name}"] = torch.ones(samples, n)
        for kind, weight in (("texture", "texel_weight"), ("mean_texture", "mean_weight")):
            made[f"{kind}.{name}"] = uniform(samples, 3, size, size)
            made[f"{weight}.{name}"] = (uniform(samples, 1, size, size) < 0.8).float()
    return made


def decoded(model, b, **changes):
    """{layer: Decoded} of a batch with some of it changed, by the means of its codes."""
    b = b | changes
    return model.decode(b, model.means(model.encode(b)))
