"""Scans from pictures against the truth: `python -m bench.stereo CAPTURE [--quality standard] [--frame 0] [--noise 0]
[--views 0] [--threads 1]` measures a studio capture; `python -m bench.stereo DATA/middlebury_temple --picture OUT.png` shows the
temple beside itself.

CPU seconds a view (depth maps; the whole scan), peak memory of the process, distances of the scan's vertices to the true
outer surface, and completeness: the share of samples of that surface, seen by three cameras, that have the scan within 2, 5
and 10 mm; of all, and by what they show. `hands` are skin from the wrists on, `print` those places of garments whose picture has
contrast. `sha256` is that of the scan: `--threads` must not change it. `--views 8` takes every n-th camera, eight in all.
"""

import argparse
import hashlib
import json
import resource
import time
from pathlib import Path

import numpy as np

from toile import kernels, open_capture
from toile.config import changed, read_set
from toile.config.stereo import scan_preset
from toile.measure.truth import open_truth
from toile.pipeline.threads import one_blas_thread
from toile.scene import Camera, Mesh
from toile.stages.stereo import scan

SAMPLES = 60_000
SEEN_BY = 3  # cameras
MIN_COSINE = 0.2  # between a sample's normal and the view of a camera that sees it
TOLERANCE = 0.003  # m behind the nearest surface that still counts as seen
WITHIN = (0.002, 0.005, 0.010)  # m
HAND = ("wrist", "finger", "metacarpal")  # names of its joints begin so
WINDOW = 7  # px, a side
LUMA = (0.299, 0.587, 0.114)  # of red, green, blue (BT.601)
CONTRAST = 10.0  # of 255, standard deviation within a window: that much is a print


def measure(path, number, settings, noise=0.0, views=0):
    """One frame of a studio capture -> figures in mm, %, s, MB. `noise`: more noise of the pictures, of 255; `views`: so many of
    the cameras, 0: all."""
    capture = open_capture(path)
    frame = capture.pictures(number)
    images = noisy({name: frame.images[name] for name in some(list(frame.images), views)}, noise)
    begin = time.process_time()
    found = scan(images, frame.masks, capture.cameras, settings)
    spent = time.process_time() - begin
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    surface, kind = outer_surface(capture, number)
    face, *_, distance = surface.index.closest(found.scan.vertices)
    off = {name: 1000 * distance[kind[face] == name] for name in sorted(set(kind[face]))}
    garments = np.isin(kind[face], [g.label for g in capture.scene.garments])
    printed = garments & (contrast(found.scan, frame.images, capture.cameras) > CONTRAST)
    off |= {"all": 1000 * distance, "print": 1000 * distance[printed]}
    points, of = seen_samples(surface, kind, capture.cameras)
    missed = found.scan.index.closest(points)[3]
    missing = {"all": missed} | {name: missed[of == name] for name in sorted(set(of))}
    missing["hands"] = missed[(of == "skin") & on_hands(points, *open_truth(capture).joints(number))]
    return {
        "cpu_s_a_view": spent / len(images),
        "peak_mb": peak,
        "error_mm": {name: quantiles(values) for name, values in off.items() if len(values)},
        "within_percent": {
            name: [100 * float((m < w).mean()) for w in WITHIN] for name, m in missing.items() if len(m)
        },
        "depth_percent": 100 * found.depth,
        "holes_percent": {name: 100 * share for name, share in found.holes.items()},
        "vertices": len(found.scan.vertices),
        "sha256": hashlib.sha256(found.scan.vertices.tobytes() + found.scan.faces.tobytes()).hexdigest()[:16],
    }


def some(names, count):
    """Every n-th of the names, `count` in all; 0: all."""
    return names[:: max(len(names) // count, 1)][:count] if count else names


def quantiles(values):
    return {"median": np.median(values), "p95": np.quantile(values, 0.95), "max": values.max()}


def on_hands(points, joints, names):
    """Is the joint nearest to each point (n,3) one of a hand?"""
    from scipy.spatial import cKDTree

    return np.array([name.startswith(HAND) for name in names])[cKDTree(joints).query(points)[1]]


def contrast(mesh, images, cameras):
    """Standard deviation of grey about each vertex, in the picture of the camera that it faces most (n,)."""
    from scipy.ndimage import uniform_filter

    facing = [np.einsum("nc,nc->n", mesh.normals, unit(cameras[n].centre - mesh.vertices)) for n in images]
    best, found = np.argmax(facing, 0), np.zeros(len(mesh.vertices))
    for c, (name, image) in enumerate(images.items()):
        grey, camera = image.astype(float) @ LUMA, cameras[name]
        variance = uniform_filter(grey * grey, WINDOW) - uniform_filter(grey, WINDOW) ** 2
        mine = np.flatnonzero(best == c)
        u, v = np.clip(camera.project(mesh.vertices[mine])[0].astype(int), 0, [camera.width - 1, camera.height - 1]).T
        found[mine] = np.sqrt(np.maximum(variance[v, u], 0))
    return found


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def noisy(images, sigma):
    rng = np.random.default_rng(0)
    add = lambda image: np.clip(np.rint(image + rng.normal(0, sigma, image.shape)), 0, 255).astype(np.uint8)
    return {name: add(image) for name, image in images.items()} if sigma else images


def outer_surface(capture, number):
    """Mesh of the true body and garments without what lies under them, and what each face shows, a label's name (m,)."""
    garments = {g.name: capture.scene.labels[g.label] for g in capture.scene.garments}
    V, F, label = open_truth(capture).outer(number, garments, bare=True)
    names = {label: name for name, label in capture.scene.labels.items()}
    return Mesh(V, F), np.array([names.get(int(i), "other") for i in label])


def seen_samples(surface, kind, cameras, least=SEEN_BY):
    """Points (n,3) of the surface, even by area, that at least so many cameras see, and what they show (n,)."""
    rng = np.random.default_rng(0)
    area = kernels.face_areas(surface.vertices, surface.faces)
    face = rng.choice(len(area), SAMPLES, p=area / area.sum())
    bary = rng.dirichlet(np.ones(3), SAMPLES)
    points = np.einsum("nc,ncd->nd", bary, surface.vertices[surface.faces[face]])
    normals, count = surface.face_normals[face], np.zeros(SAMPLES, int)
    for camera in cameras.values():
        depth = kernels.raster(camera.to_camera(surface.vertices), surface.faces, camera.K, camera.size).depth
        uv = camera.K, camera.distortion, camera.T_camera_world
        count += kernels.visibility(points, normals, *uv, depth, TOLERANCE, MIN_COSINE)[1] > 0
    seen = count >= least
    return points[seen], kind[face][seen]


def temple(folder):
    """Pictures, masks (what is not black) and cameras of Middlebury's templeSparseRing, tenths of a metre as they are."""
    from PIL import Image
    from scipy.ndimage import binary_closing, binary_fill_holes

    images, masks, cameras = {}, {}, {}
    for line in (folder / "templeSR_par.txt").read_text().splitlines()[1:]:
        name, *numbers = line.split()
        K, R, t = np.array(numbers[:9], float), np.array(numbers[9:18], float), np.array(numbers[18:21], float)
        images[name] = np.array(Image.open(folder / name).convert("RGB"))
        masks[name] = binary_fill_holes(binary_closing(images[name].max(2) > 25, iterations=3))
        T, K = np.eye(4), K.reshape(3, 3)
        T[:3, :3], T[:3, 3] = R.reshape(3, 3), t
        K[:2, 2] += 0.5  # there pixel (0,0) has its centre at (0,0)
        height, width = masks[name].shape
        cameras[name] = Camera(name, width, height, K, np.zeros(5), T)
    return images, masks, cameras


def show_temple(folder, out, settings):
    """The temple from one of its cameras beside that picture."""
    from PIL import Image

    images, masks, cameras = temple(folder)
    begin = time.process_time()
    found = scan(images, masks, cameras, settings)
    print(
        f"{(time.process_time() - begin) / len(images):.2f} CPU s a view; {found.depth:.3f} have a depth, {found.holes}"
    )
    rows = [np.hstack([images[name], shaded(found.scan, cameras[name])]) for name in list(images)[:16:5][:2]]
    Image.fromarray(np.vstack(rows)).save(out)


def shaded(mesh, camera):
    """(H,W,3) uint8: a mesh lit from its camera."""
    seen = kernels.raster(camera.to_camera(mesh.vertices), mesh.faces, camera.K, camera.size)
    normal = mesh.face_normals[seen.face] @ camera.T_camera_world[:3, :3].T
    light = np.clip(normal @ np.array([-0.3, -0.4, -0.87]), 0, 1)
    grey = np.where(seen.face >= 0, 40 + 200 * light, 0).astype(np.uint8)
    return np.repeat(grey[..., None], 3, 2)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", type=Path)
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--frame", type=int, default=0)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--views", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--set", action="append", default=[])
    given = parser.parse_args()
    settings = changed(scan_preset(given.quality), read_set(given.set)).stereo
    one_blas_thread()
    kernels.set_threads(given.threads)
    if given.picture:
        show_temple(given.path, given.picture, settings)
    else:
        print(json.dumps(measure(given.path, given.frame, settings, given.noise, given.views), indent=1, default=float))


if __name__ == "__main__":
    main()
