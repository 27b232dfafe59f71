"""Label images whose errors stay where they are: patches of a wrong label on the surface, the same in all views and frames."""

import numpy as np
from scipy.spatial import cKDTree

from toile import kernels
from toile.measure.truth import Truth
from toile.studio.labels import BLOB_RADIUS
from toile.studio.pictures import distorted


class WrongPatches:
    """Of a studio capture's outer surface: `share` of its seen pixels in the first frame are wrong."""

    def __init__(self, capture, share, seed=0):
        self.capture, self.truth = capture, Truth(capture.root / "truth" / "truth.zarr", capture)
        self.garments = {garment.name: capture.scene.labels[garment.label] for garment in capture.scene.garments}
        number = capture.frames[0]
        self.first = self.truth.outer(number, self.garments)[0]
        seen = [self._seen(camera, number) for camera in capture.cameras.values()]
        points, true = (np.concatenate(part) for part in zip(*((points, true) for _, points, true in seen)))
        rng = np.random.default_rng(seed)
        pick = rng.choice(len(points), min(60_000, len(points)), replace=False)
        points, true, ids = points[pick], true[pick], np.unique(true)
        self.tree, label = cKDTree(points), true.copy()
        while (label != true).mean() < share:
            centre = points[rng.integers(len(points))]
            label[self.tree.query_ball_point(centre, rng.uniform(*BLOB_RADIUS))] = rng.choice(ids)
        self.label = np.where(label != true, label, 0).astype(np.uint8)

    def images(self, number, cameras):
        """{camera: (H,W) uint8} with the errors, of a frame, and the share of wrong pixels of the person."""
        images, wrong, count = {}, 0, 0
        for name in cameras:
            on, points, true = self._seen(self.capture.cameras[name], number)
            other = self.label[self.tree.query(points)[1]]
            images[name] = np.zeros(on.shape, np.uint8)
            images[name][on] = np.where(other > 0, other, true)
            wrong, count = wrong + int(((other > 0) & (other != true)).sum()), count + len(true)
        return images, wrong / count

    def _seen(self, camera, number):
        """Pixels (H,W) of the person, and of each its place (p,3) in the first frame and its true label (p,)."""
        V, F, label = self.truth.outer(number, self.garments)
        seen = kernels.raster(distorted(camera, V), F, camera.K, camera.size, barycentric=True)
        face, bary = np.asarray(seen.face), np.asarray(seen.barycentric)
        on = face >= 0
        return on, np.einsum("pc,pcd->pd", bary[on], self.first[F[face[on]]]), label[face[on]]


def iou_by_label(capture, truth, frame, segmented):
    """Intersection over union {label: share} by area of the scan's faces."""
    scan = frame.scan
    V, F, label = truth.outer(frame.number, {"tshirt": capture.scene.labels["tshirt"]}, bare=True)
    true = label[kernels.SurfaceIndex(V, F).closest(scan.vertices[scan.faces].mean(1))[0]]
    area, given = kernels.face_areas(scan.vertices, scan.faces), segmented.scan_faces
    each = {name: (true == id, given == id) for name, id in capture.scene.labels.items()}
    return {name: float(area[a & b].sum() / area[a | b].sum()) for name, (a, b) in each.items()}
