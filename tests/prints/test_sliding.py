"""Places of slides: on the sheet that they started from."""

import numpy as np

from toile import kernels
from toile.prints.sliding import SlidingSurface


def two_tubes(gap=0.002, around=24, along=12, radius=0.05):
    """A tube that bends back along itself, as a sleeve hangs along the trunk: V, F; the legs `gap` [m] apart."""
    bend = radius + gap / 2
    t = np.concatenate(
        [
            np.linspace(-0.3, 0, along),
            np.pi * bend * np.linspace(0.1, 0.9, 9),
            np.pi * bend + np.linspace(0, 0.3, along),
        ]
    )
    angle = np.clip(t / bend, 0, np.pi)
    middle = np.stack(
        [
            bend * (1 - np.cos(angle)),
            np.where(t < 0, t, np.where(angle < np.pi, bend * np.sin(angle), np.pi * bend - t)),
        ],
        1,
    )
    a = np.arange(around) / around * 2 * np.pi
    outward = np.stack([-np.cos(angle), np.sin(angle)], 1)
    x, z = ((middle[:, None] + radius * np.cos(a)[None, :, None] * outward[:, None])[..., k] for k in (0, 1))
    V = np.stack([x, np.broadcast_to(radius * np.sin(a), x.shape), z], -1).reshape(-1, 3)
    i, j = (k.ravel() for k in np.meshgrid(np.arange(len(t) - 1), np.arange(around), indexing="ij"))
    corner = [i * around + j, i * around + (j + 1) % around, (i + 1) * around + (j + 1) % around, (i + 1) * around + j]
    return V, np.concatenate([np.stack([corner[k] for k in c], 1) for c in ((0, 1, 2), (0, 2, 3))]).astype(np.int32)


def test_no_slide_leaves_its_sheet_however_near_another_one_lies():
    V, F = two_tubes()
    surface = SlidingSurface(V, F, kernels.boundary_loops(F), 0.01)
    d = np.tile([0.02, 0.025], (len(V), 1))
    face, bary = surface.slid(d)
    assert np.linalg.norm(surface.points_at(V, face, bary) - V, axis=1).max() < 1.2 * np.linalg.norm(d[0])
    leg = lambda faces: np.sign(F[faces].mean(1) - len(V) / 2)
    straight = np.abs(np.arange(len(V)) - len(V) / 2) > len(V) / 4  # vertices that do not come near the bend
    assert np.array_equal(leg(face)[straight], leg(surface.own_face)[straight])
    nearest = surface.index.closest(V + surface.vectors(d))[0]
    assert (leg(nearest) != leg(face))[straight].any()  # the nearest places of all are the other leg's
