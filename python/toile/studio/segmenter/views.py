"""What is fixed about a picture of a person: which class, which place on skin or cloth, and which way it faces, a pixel.

    python -m toile.studio.segmenter.views OUT.npz [--subjects fitted logo ...] [--captures CAPTURE ...] [--count 1500] [--seed 7]

CAPTURES are studio captures of these subjects whose people are shown too: their cloth was simulated.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ... import kernels
from ..body import PHENOTYPES
from ..cameras import look_at
from ..surface import vertex_normals
from . import CLASSES
from .people import body_class, people

SIZE = 256  # px
A_PERSON = 3  # views of each person as it stands
SAMPLES = 2  # a pixel and direction
HEIGHTS = (0.5, 1.25)  # of the person, in heights of the picture
DISTANCE = (1.8, 7.0)  # m
ELEVATION = (-15, 50)  # degrees
ROLL = 12.0  # degrees, standard deviation
AIM = 0.22  # m, standard deviation of where the camera looks from the person's middle, times the picture's span


def main():
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--subjects", nargs="+", choices=PHENOTYPES, default=list(PHENOTYPES))
    parser.add_argument("--captures", type=Path, nargs="*", default=[])
    parser.add_argument("--count", type=int, default=1500)
    parser.add_argument("--seed", type=int, default=7)
    asked = parser.parse_args()
    rng = np.random.default_rng(asked.seed)
    views = many_views(people(asked.subjects, asked.captures, rng), asked.count, rng)
    np.savez(asked.out, **dict(zip(PersonView.__dataclass_fields__, views)))


@dataclass(frozen=True)
class PersonView:
    """`classes` (S,S) uint8; `cover` (S,S) uint8, the person's share of the pixel; `place` (S,S,3) float16 [m]; `normal`
    (S,S,3) int8 [1/127] in the camera's frame, towards it."""

    classes: np.ndarray
    cover: np.ndarray
    place: np.ndarray
    normal: np.ndarray


def view(person, size, rng):
    """A PersonView of a person by a camera drawn at random."""
    V, F = person.vertices, person.faces
    T, K = camera(V, size, rng)
    P = V @ T[:3, :3].T + T[:3, 3]
    big = np.diag([SAMPLES, SAMPLES, 1.0]) @ K
    seen = kernels.raster(P, F, big, (size * SAMPLES, size * SAMPLES), barycentric=True, near_plane=0.05)
    face, bary = np.asarray(seen.face), np.asarray(seen.barycentric)
    on = face >= 0
    corners, b = F[face[on]], bary[on]
    at = lambda values: np.einsum("pc,pcd->pd", b, values[corners])
    place, normal = at(person.place), at(vertex_normals(V, F)) @ T[:3, :3].T
    layer = person.layer[face[on]]
    label = np.zeros(len(layer), np.uint8)
    body, n = layer == 0, len(person.part)
    part = np.einsum("pc,pcd->pd", b[body], person.part[corners[body].clip(0, n - 1)])
    label[body] = body_class(place[body], part, person.painted)
    for i, kind in person.classes.items():
        label[layer == i] = kind
    normal *= np.where(normal[:, 2:] > 0, -1, 1)  # cloth is seen from both sides
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return gathered(on, label, place, normal, size)


def many_views(dressed, count, rng):
    """The fields of `count` PersonViews, or a few more, of people one after the other, stacked."""
    views = []
    while len(views) < count:
        person = next(dressed)
        views += [view(person, SIZE, rng) for _ in range(A_PERSON)]
    return [np.stack([getattr(seen, name) for seen in views]) for name in PersonView.__dataclass_fields__]


def read_views(paths):
    """The fields of the PersonViews in some files, stacked."""
    fields = []
    for path in paths:
        with np.load(path) as found:
            fields.append([found[name] for name in PersonView.__dataclass_fields__])
    return [np.concatenate(field) for field in zip(*fields)]


def gathered(on, label, place, normal, size):
    """The samples (p,) of the pixels `on` as a PersonView: the label most of them have, place and normal of one of them."""
    row, column = np.nonzero(on)
    cell = (row // SAMPLES) * size + column // SAMPLES
    votes = np.bincount(cell * len(CLASSES) + label, minlength=size * size * len(CLASSES)).reshape(-1, len(CLASSES))
    cover, classes = votes.sum(1), votes.argmax(1).astype(np.uint8)
    own = label == classes[cell]
    places, normals = np.zeros((size * size, 3), np.float16), np.zeros((size * size, 3), np.int8)
    places[cell[own]], normals[cell[own]] = place[own], np.rint(127 * normal[own])
    classes[2 * cover < SAMPLES**2] = 0
    square = lambda values: values.reshape(size, size, *values.shape[1:])
    return PersonView(
        square(classes), square((255 * cover // SAMPLES**2).astype(np.uint8)), square(places), square(normals)
    )


def camera(V, size, rng):
    """T_camera_world (4,4) and K (3,3) of a camera that shows a person with these vertices, or a part of it."""
    low, high = V.min(0), V.max(0)
    middle, tall = 0.5 * (low + high), float(np.linalg.norm(high - low))
    share = np.exp(rng.uniform(*np.log(HEIGHTS)))
    span = tall / share
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.triangular(ELEVATION[0], 5, ELEVATION[1]))
    away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    aim = middle + AIM * min(span, tall) * rng.standard_normal(3) * [0.7, 0.7, 1]
    distance = max(rng.uniform(*DISTANCE), 0.8 * tall)
    T = look_at(aim + distance * away, aim)
    roll = np.radians(ROLL * rng.standard_normal())
    turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    T[:3] = turn @ T[:3]
    focal = size * distance / span
    return T, np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])


if __name__ == "__main__":
    main()
