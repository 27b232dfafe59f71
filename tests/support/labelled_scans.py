"""The bundled capture as data of labelled scans are: what its pictures show is gone, its scans carry labels of their own."""

import shutil
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from toile import kernels
from toile.io.capture import open_capture
from toile.measure.truth import open_truth

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
WRONG, BLOB = 0.05, (0.02, 0.05)  # share of the area that carries wrong labels; radii of the blobs [m]


def write_labelled_scan(path, V, F, labels):
    """A binary PLY with the property `label` (uchar), one a face or one a vertex, whichever there are."""
    mesh = trimesh.Trimesh(V, F, process=False)
    attributes = mesh.face_attributes if len(labels) == len(F) else mesh.vertex_attributes
    attributes["label"] = np.asarray(labels, np.uint8)
    mesh.export(path)


def true_labels(truth, scene, number, points):
    """Label ids of the nearest points of the true outer surface."""
    garments = {g.name: scene.labels[g.label] for g in scene.garments}
    V, F, label = truth.outer(number, garments, bare=True)
    return label[kernels.SurfaceIndex(V, F).closest(points)[0]].astype(np.uint8)


def with_blobs(V, F, labels, ids, rng):
    """Labels (m,) of which a share of WRONG by area is overwritten, a ball of faces at a time."""
    centres, area = V[F].mean(1), kernels.face_areas(V, F)
    tree, labels, wrong = cKDTree(centres), labels.copy(), np.zeros(len(F), bool)
    while area[wrong].sum() < WRONG * area.sum():
        ball = tree.query_ball_point(centres[rng.integers(len(F))], rng.uniform(*BLOB))
        labels[ball] = rng.choice(ids)
        wrong[ball] = True
    return labels


def labelled_capture(folder, pictures=False, cameras=False, seed=0):
    """A copy of the bundled capture whose scans carry labels, wrong in blobs; `pictures` keeps pictures, masks and label
    images, `cameras` the cameras and the keypoints."""
    shutil.copytree(SAMPLE, folder)
    capture, rng = open_capture(SAMPLE), np.random.default_rng(seed)
    truth = open_truth(capture)
    for number in capture.frames:
        frame, scan = folder / "frames" / f"{number:06d}", capture.frame(number).scan
        labels = true_labels(truth, capture.scene, number, scan.vertices[scan.faces].mean(1))
        labels = with_blobs(scan.vertices, scan.faces, labels, list(capture.scene.labels.values()), rng)
        write_labelled_scan(frame / "scan.ply", scan.vertices, scan.faces, labels)
        for kind in () if pictures else ("images", "masks", "labels"):
            shutil.rmtree(frame / kind)
        if not (cameras or pictures):
            (frame / "keypoints.json").unlink()
    if not (cameras or pictures):
        (folder / "cameras.json").unlink()
    return folder
