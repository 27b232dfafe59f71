"""Surfaces that the avatar's tests draw: a posed body, a sheet with folds, bumpy spheres; and random smooth fields."""

import numpy as np
import torch

from toile.avatar.render.renderer import Surface
from toile.io.body import load_body_model

FRONT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # z up, facing -y -> OpenCV camera in front of the person


IDENTITY = torch.eye(4)
FIELD = 1.9  # what the camera sees at the origin's depth [m]


def camera(size, field=FIELD, distance=3.0):
    """K and T_camera_world of a square camera `distance` in front of the origin; the world's axes are its own."""
    f = size * distance / field
    K = torch.tensor([[f, 0, size / 2], [0, f, size / 2], [0, 0, 1]])
    T = torch.eye(4)
    T[2, 3] = distance
    return K, T


def smooth_field(seed, wavelength, channels=3, waves=6):
    """A random function of points (n,3) -> (n,channels): a sum of plane waves no shorter than `wavelength` [m]."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(waves, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    k = 2 * np.pi / wavelength * direction * rng.uniform(0.2, 1, (waves, 1))
    phase, amplitude = rng.uniform(0, 2 * np.pi, waves), rng.normal(size=(waves, channels)) / np.sqrt(waves)
    return lambda points: np.sin(np.asarray(points) @ k.T + phase) @ amplitude


def surface(V, F, seed, size=64):
    """A Surface with smooth colours: its UVs are a chart of x and y, its texture a smooth random picture."""
    uv = 0.5 + V[:, :2] / 2.2
    j, i = np.meshgrid((np.arange(size) + 0.5) / size, 1 - (np.arange(size) + 0.5) / size)
    picture = 0.5 + 0.25 * smooth_field(seed, 0.35)(np.stack([j, i, 0 * i], -1))
    tensor = lambda x: torch.tensor(x, dtype=torch.float32)
    faces = torch.tensor(np.asarray(F, dtype=np.int64))
    return Surface(tensor(V), faces, tensor(uv), faces, tensor(picture).permute(2, 0, 1).contiguous())


def body(seed=0):
    """anny with bent arms, centred, in the camera's axes."""
    model = load_body_model("anny")
    rng = np.random.default_rng(seed)
    rotations = rng.normal(0, 0.1, (len(model.parents), 3))
    V = model.skin(np.asarray(model.v_template), np.asarray(model.J), rotations, np.zeros(3))
    return (V - (V.min(0) + V.max(0)) / 2) @ FRONT.T, np.asarray(model.f)


def sheet(n=40, centre=(0.03, -0.25, -0.25), extent=(0.5, 0.6), turn=0.0, seed=5):
    """A wavy cloth sheet in front of the chest, large enough to leave the silhouette at the sides.

    Turned in the picture's plane by `turn` [rad]: a border along a column of pixels has one phase of aliasing only.
    """
    a, b = np.meshgrid(np.linspace(-0.5, 0.5, n + 1), np.linspace(-0.5, 0.5, n + 1))
    x, y, (c, s) = a * extent[0], b * extent[1], (np.cos(turn), np.sin(turn))
    V = np.stack([c * x - s * y, s * x + c * y, 0 * a], -1).reshape(-1, 3) + centre
    V[:, 2] += 0.02 * smooth_field(seed, 0.15, 1)(V)[:, 0]
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    return V, np.r_[np.c_[i, i + n + 1, i + n + 2], np.c_[i, i + n + 2, i + 1]]


def sphere(radius=0.3, centre=(0, 0, 0), n=48, bumps=0.0, seed=0):
    """A (bumpy) sphere of 2 n (n/2 - 1) faces."""
    theta, phi = np.linspace(0, np.pi, n // 2 + 1)[1:-1], np.arange(n) * 2 * np.pi / n
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    ring = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1)
    V = np.r_[[[0, 1, 0]], ring.reshape(-1, 3), [[0, -1, 0]]]
    i, last = np.arange(n), len(V) - 1
    j = (i + 1) % n
    F = [np.c_[0 * i, 1 + j, 1 + i], np.c_[last + 0 * i, last - n + i, last - n + j]]
    for k in range(len(theta) - 1):
        a, b = 1 + k * n, 1 + (k + 1) * n
        F += [np.c_[a + i, a + j, b + i], np.c_[a + j, b + j, b + i]]
    V = V * (1 + bumps * smooth_field(seed, 0.9, 1)(V))
    return V * radius + centre, np.concatenate(F)


def wall(depth=0.5, half=2.0):
    """Two triangles behind everything, so that every pixel has a finite depth."""
    V = [[-half, -half, depth], [half, -half, depth], [half, half, depth], [-half, half, depth]]
    return np.array(V), np.array([[0, 1, 2], [0, 2, 3]])


def f32(values):
    if torch.is_tensor(values):
        return values.float()
    return torch.tensor(np.asarray(values), dtype=torch.float32)


def scene(*meshes):
    return [surface(V, F, seed) for seed, (V, F) in enumerate(meshes)]


def spheres():
    return scene(sphere(bumps=0.2), sphere(0.2, (0.2, 0.1, -0.4), bumps=0.2, seed=1))


def body_and_cloth():
    return scene(body(), sheet(turn=0.3))


def of_vertices(surfaces):
    return [s.vertices.requires_grad_() for s in surfaces]


def pictures(seed, size):
    """Two smooth random pictures (3,size,size) between 0 and 1: weights and target of a loss."""
    i, j = np.mgrid[:size, :size] / size
    fields = (smooth_field(s, 0.3)(np.stack([j, i, 0 * i], -1)) for s in (seed, seed + 1))
    return [f32(0.5 + 0.4 * f).permute(2, 0, 1) for f in fields]
