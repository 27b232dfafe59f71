"""Errors of labels and keypoints that last: a wrong patch is wrong in every picture of it, a joint is always found beside
where it is."""

from __future__ import annotations

import numpy as np

from .keypoints import swap_pairs
from .labels import BLOB_RADIUS, MAX_BLOBS, SHIFT_LENGTH, SHIFT_PX
from .pictures import surface_look
from .surface import smooth_noise

SAMPLES = 150_000  # points on the surface that carry the errors, about 4 mm apart
COVER = 0.10  # m: skin below cloth that is nearer than this along its normal is hidden
GATE_LENGTH = 0.1  # m, over which shifts begin and end
EPISODE = 8  # frames that a hand stays lost or exchanged
SMALL = 0.5  # of the bias, on hands and face


class LastingLabels:
    """Wrong labels as a property of the surface: shifted borders and blobs on the `outer` surface at rest."""

    def __init__(self, outer, look, fraction, pixel, rng):
        """`fraction` of the surface is wrong; `pixel` [m] is what a pixel spans."""
        from scipy.spatial import cKDTree

        points, true = surface_samples(outer, look, rng)
        self.tree = cKDTree(points)
        shift = np.stack([smooth_noise(points, SHIFT_LENGTH, rng, 32) for _ in range(3)], 1)
        shift /= np.maximum(np.linalg.norm(shift, axis=1, keepdims=True), 1e-12)
        low, high = SHIFT_PX
        length = low + (high - low) * (0.5 + 0.5 * np.tanh(smooth_noise(points, SHIFT_LENGTH, rng, 32)))
        moved = true[self.tree.query(points + pixel * length[:, None] * shift)[1]]
        gate, wrong = smooth_noise(points, GATE_LENGTH, rng, 32), moved != true
        if wrong.mean() > fraction:
            wrong &= gate <= np.quantile(gate[wrong], fraction / wrong.mean())
        label = np.where(wrong, moved, true)
        goal, ids = fraction * len(points), np.unique(true)
        for _ in range(MAX_BLOBS):  # of two labels no draws make much more than half wrong
            if (label != true).sum() >= goal or len(ids) < 2:
                break
            centre = points[rng.integers(len(points))]
            label[self.tree.query_ball_point(centre, rng.uniform(*BLOB_RADIUS))] = rng.choice(ids)
        self.wrong = np.where(label != true, label, 0).astype(np.uint8)

    def images(self, views):
        """Label images (one a view) with the errors, and the share of wrong foreground pixels."""
        images, count, total = [], 0, 0
        for view in views:
            image, true = view.labels.copy(), view.labels[view.mask]
            wrong = self.wrong[self.tree.query(view.rest_points)[1]]
            image[view.mask] = np.where(wrong > 0, wrong, true)
            images.append(image)
            count, total = count + int((image[view.mask] != true).sum()), total + len(true)
        return images, count / max(total, 1)


def surface_samples(outer, look, rng):
    """Points (p,3) spread over what is seen of a surface, and their labels (p,)."""
    V, F = outer.vertices, outer.faces
    area = np.linalg.norm(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), axis=1)
    area[: len(outer.body_faces)] *= uncovered(outer)
    face = rng.choice(len(F), SAMPLES, p=area / area.sum())
    bary = rng.dirichlet(np.ones(3), SAMPLES)
    return np.einsum("pc,pcd->pd", bary, V[F[face]]), surface_look(outer, look, face, bary, F, paint=False)[0]


def uncovered(outer):
    """bool (m,): body faces that no garment covers within COVER."""
    if outer.garment is None:
        return np.ones(len(outer.body_faces), bool)
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    triangles = o3d.core.Tensor(outer.garment_faces.astype(np.uint32))
    scene.add_triangles(o3d.core.Tensor(outer.garment.astype(np.float32)), triangles)
    a, b, c = np.moveaxis(outer.body[outer.body_faces], 1, 0)
    n = np.cross(b - a, c - a)
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
    rays = np.concatenate([(a + b + c) / 3, n], 1).astype(np.float32)
    return scene.cast_rays(o3d.core.Tensor(rays), nthreads=1)["t_hit"].numpy() > COVER


class LastingKeypoints:
    """What a detector always gets wrong, a view: `bias[c]` (q,2) [px]; and episodes in which hands are lost."""

    def __init__(self, table, cameras, amounts, seed):
        self.names, self.amounts, self.seed = table.names, amounts, seed
        share = np.where([n.startswith("body.") for n in self.names], 1.0, SMALL)
        rng = np.random.default_rng([seed, 6])
        self.bias = rng.normal(0, amounts.keypoint_bias, (cameras, len(self.names), 2)) * share[:, None]
        self.hands = [np.flatnonzero([n.startswith(h) for n in self.names]) for h in ("hand_left", "hand_right")]
        in_hands = set(np.concatenate(self.hands).tolist())
        self.exchanged = np.array([p for p in swap_pairs(self.names) if p[0] in in_hands], int).reshape(-1, 2)

    def spoil(self, points, camera, number):
        """Rows (q,3) u, v, confidence of view `camera` in frame `number`, spoilt; unseen ones stay 0."""
        points = points.copy()
        rng = np.random.default_rng([self.seed, 7, camera, number // EPISODE])
        points[:, :2] += self.bias[camera] * (points[:, 2:] > 0)
        if rng.uniform() < self.amounts.hand_swaps:
            a, b = self.exchanged.T
            points[np.r_[a, b]] = points[np.r_[b, a]]
        for hand in self.hands:
            if rng.uniform() < self.amounts.hand_drops:
                points[hand] = 0
        return points
