"""A network of keypoints in an ONNX file, of one person in a crop (top-down): SimCC (Li et al. 2022, as RTMPose, RTMW and
DWPose give it) or heatmaps (as ViTPose and Sapiens give them, refined after Zhang et al. 2020, DARK)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...io.image import read_image
from ...scene import Camera, Keypoints
from ..networks import open_network, run_network
from ..threads import parallel_map
from . import Detection
from .description import Description, describe

BLUR = 2.0  # sigma of the Gaussian that a peak is refined under [cells of the map]
SURE = 0.3  # confidence of points that draw the second crop
ROUNDS = 2  # the whole picture, or the mask's box; then the box of what was found in it
FEW = 4  # points that draw no box


class Network:
    """`Network(path).detect(folders, cameras)`, see toile.vision.detectors. Where a mask lies beside the pictures
    (../masks/CAMERA.png) its box is the first crop. UserError: no ONNX file, or one that gives no keypoints of a person."""

    at_once = 1

    def __init__(self, path: Path):
        self.path, self.session = path, open_network(path)
        self.about: Description = describe(path, self.session.get_inputs(), self.session.get_outputs())

    def __reduce__(self) -> tuple[type[Network], tuple[Path]]:
        return Network, (self.path.absolute(),)  # each process opens its own

    def detect(self, folders: Sequence[Path], cameras: Mapping[str, Camera]) -> Iterator[Detection]:
        for folder in folders:
            paths = [path for path in sorted(folder.iterdir()) if path.suffix.lower() in (".png", ".jpg", ".jpeg")]
            paths = [path for path in paths if path.stem in cameras]
            rows = parallel_map(lambda path: self._seen(path, cameras[path.stem]), paths)
            yield Detection(Keypoints(tuple(self.about.rows), {path.stem: r for path, r in zip(paths, rows)}))

    def _seen(self, path: Path, camera: Camera) -> Any:
        return self.keypoints(read_image(path, camera.size, "RGB"), _box_beside(path.parent, path.stem, camera))

    def keypoints(self, picture: Any, box: Any = None) -> Any:
        """Rows (k,3) of u, v [px] and confidence, of the person in a box (4,) [px: left, top, right, bottom]."""
        height, width = picture.shape[:2]
        whole = np.array([0.0, 0.0, width, height])
        rows = np.zeros((len(self.about.rows), 3))
        for _ in range(ROUNDS if box is None else 1):
            rows = self._in_box(picture, whole if box is None else box)
            sure = rows[rows[:, 2] > SURE, :2]
            if len(sure) < FEW:
                break
            box = np.concatenate([sure.min(0), sure.max(0)])
        inside = (rows[:, :2] >= 0).all(1) & (rows[:, 0] < width) & (rows[:, 1] < height)
        return rows * np.column_stack([np.ones((len(rows), 2)), inside])

    def _in_box(self, picture: Any, box: Any) -> Any:
        crop, scale, corner = cropped(picture, box, self.about)
        outputs = run_network(self.path, self.session, crop)
        found = dict(zip((out.name for out in self.session.get_outputs()), outputs))
        if self.about.kind == "simcc":
            x, y = (found.get(f"simcc_{axis}", outputs[i])[0] for i, axis in enumerate("xy"))
            at, peak = simcc_peaks(x, y, self.about)
        else:
            at, peak = heatmap_peaks(outputs[0][0], self.about)
        rows = np.column_stack([scale * at + corner, np.clip(peak / self.about.full_score, 0, 1)])
        return rows[list(self.about.rows.values())]


def cropped(picture: Any, box: Any, about: Description) -> Any:
    """The normalised crop (3,H,W) around a box, its scale [picture's px a px of the crop] and what to add: a point of the
    crop, counted from its first pixel's centre, lies at scale * point + corner."""
    import cv2

    height, width = about.size
    extent = np.maximum(about.padding * (np.asarray(box[2:]) - box[:2]), 1.0)
    scale = max(extent[0] / width, extent[1] / height)  # the box grows to the input's shape
    centre = (np.asarray(box[:2]) + box[2:]) / 2
    corner = centre - scale * np.array([width, height]) / 2
    M = np.array([[scale, 0, corner[0] - 0.5], [0, scale, corner[1] - 0.5]])  # OpenCV counts from pixels' centres
    crop = cv2.warpAffine(picture, M, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    crop = crop if about.channels == "rgb" else crop[..., ::-1]
    return ((crop - np.array(about.mean)) / about.std).transpose(2, 0, 1), scale, corner


def simcc_peaks(x: Any, y: Any, about: Description) -> Any:
    """Points (K,2) [px of the crop] and peaks (K,) of two classifications along the axes (K, bins)."""
    height, width = about.size
    at = np.column_stack([x.argmax(1) * (width / x.shape[1]), y.argmax(1) * (height / y.shape[1])])
    peaks = np.stack([x.max(1), y.max(1)])
    return at, peaks.min(0) if about.score == "min" else peaks.mean(0)


def heatmap_peaks(maps: Any, about: Description) -> Any:
    """Points (K,2) [px of the crop] and peaks (K,) of heatmaps (K,h,w), by one Newton step on the logarithm of the blurred map
    (Zhang et al. 2020, eq. 9)."""
    from scipy.ndimage import gaussian_filter

    K, h, w = maps.shape
    maps = np.asarray(maps, np.float64)
    row, column = np.divmod(maps.reshape(K, -1).argmax(1), w)
    at, k = np.column_stack([column, row]).astype(float), np.arange(K)
    log = np.log(np.maximum(gaussian_filter(maps, (0, BLUR, BLUR), mode="nearest"), 1e-10))
    log = np.pad(log, ((0, 0), (1, 1), (1, 1)), mode="edge")
    value = lambda dx, dy: log[k, row + 1 + dy, column + 1 + dx]
    gradient = np.stack([value(1, 0) - value(-1, 0), value(0, 1) - value(0, -1)], 1) / 2
    cross = (value(1, 1) - value(1, -1) - value(-1, 1) + value(-1, -1)) / 4
    xx, yy = value(1, 0) - 2 * value(0, 0) + value(-1, 0), value(0, 1) - 2 * value(0, 0) + value(0, -1)
    determinant = xx * yy - cross**2
    step = np.stack([yy * gradient[:, 0] - cross * gradient[:, 1], xx * gradient[:, 1] - cross * gradient[:, 0]], 1)
    step = -step / np.where(np.abs(determinant) > 1e-12, determinant, np.inf)[:, None]
    inside = (row > 0) & (row < h - 1) & (column > 0) & (column < w - 1) & (np.abs(step) < 1).all(1)
    at += np.where(inside[:, None], step, 0)
    height, width = about.size
    scale = np.array([(width - 1) / (w - 1), (height - 1) / (h - 1)] if about.unbiased else [width / w, height / h])
    return at * scale, maps[k, row, column]


def _box_beside(folder: Path, name: str, camera: Camera) -> Any:
    path = folder.parent / "masks" / f"{name}.png"
    if not path.exists():
        return None
    rows, columns = np.nonzero(read_image(path, camera.size, "L") > 127)
    return np.array([columns.min(), rows.min(), columns.max() + 1.0, rows.max() + 1.0]) if len(rows) else None
