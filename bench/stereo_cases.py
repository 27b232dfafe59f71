"""Scans from bad pictures against the truth: `python -m bench.stereo_cases [data_samples/tshirt-pictures] [--quality standard]`.

Each case spoils the pictures or the calibration of a studio capture; masks stay the true ones. A row says what the scan's
vertices are off from the true outer surface, and the share of samples of that surface, seen by three of the cameras (by both
where there are two), that have the scan within 2, 5 and 10 mm.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from bench.stereo import SEEN_BY, WITHIN, outer_surface, quantiles, seen_samples
from toile import kernels, open_capture
from toile.config.stereo import scan_preset
from toile.errors import UserError
from toile.stages.stereo import scan

GAMMA = 2.2  # of the pictures: value = 255 light^(1/GAMMA)
FRAME = 0

# Each takes ({camera: picture}, {camera: Camera}) and gives both, spoiled.


def nothing(images, cameras):
    return images, cameras


def two_neighbours(images, cameras):
    names = list(images)[:2]
    return {name: images[name] for name in names}, {name: cameras[name] for name in names}


def exposed(images, cameras, stops):
    """Every second camera takes 2^stops of the light; what is brighter than white is white."""
    factor = 2.0 ** (stops / GAMMA)
    expose = lambda image: np.clip(np.rint(image * factor), 0, 255).astype(np.uint8)
    return {n: expose(image) if c % 2 else image for c, (n, image) in enumerate(images.items())}, cameras


def miscalibrated(images, cameras, pixels):
    """Every camera's principal point is so far off, each in a direction of its own."""
    angles, moved = np.random.default_rng(0).uniform(0, 2 * np.pi, len(cameras)), {}
    for angle, (name, camera) in zip(angles, cameras.items()):
        K = np.array(camera.K)
        K[:2, 2] += pixels * np.array([np.cos(angle), np.sin(angle)])
        moved[name] = replace(camera, K=K)
    return images, moved


def blurred(images, cameras, pixels):
    """All that is seen moves sideways by so many pixels while the shutter is open."""
    blur = lambda image: uniform_filter1d((image / 255.0) ** GAMMA, pixels, axis=1) ** (1 / GAMMA)
    return {n: np.rint(255 * blur(image)).astype(np.uint8) for n, image in images.items()}, cameras


CASES = {
    "as it is": (nothing,),
    "two neighbouring cameras": (two_neighbours,),
    "every second camera 2 stops darker": (exposed, -2),
    "every second camera 2 stops brighter": (exposed, 2),
    "calibration off by 2 px": (miscalibrated, 2),
    "motion blur of 8 px": (blurred, 8),
}


def row(path, spoil, *amount, settings):
    """Figures of a case, as text, or the message where it is refused."""
    capture = open_capture(path)
    frame = capture.pictures(FRAME)
    names = [name for name in capture.cameras if name in frame.images]
    images = {name: frame.images[name] for name in names}
    images, cameras = spoil(images, {name: capture.cameras[name] for name in names}, *amount)
    try:
        found = scan(images, frame.masks, cameras, settings)
    except UserError as error:
        return f"refused: {error}"
    surface, kind = outer_surface(capture, FRAME)
    off = quantiles(1000 * surface.index.closest(found.scan.vertices)[3])
    true = {name: capture.cameras[name] for name in cameras}
    missed = found.scan.index.closest(seen_samples(surface, kind, true, min(SEEN_BY, len(true)))[0])[3]
    within = " / ".join(f"{100 * (missed < limit).mean():.0f}" for limit in WITHIN)
    holes = ", ".join(f"{name} {100 * share:.0f}" for name, share in found.holes.items() if share > 0.005)
    return f"{off['median']:.2f} / {off['p95']:.1f} / {off['max']:.0f} | {within} | {100 * found.depth:.0f} | {holes}"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", type=Path, nargs="?", default=Path("data_samples/tshirt-pictures"))
    parser.add_argument("--quality", default="standard")
    given = parser.parse_args()
    kernels.set_threads(1)
    settings = scan_preset(given.quality).stereo
    print("| | error median / p95 / max mm | within 2 / 5 / 10 mm % | depth % | holes % |\n|---|---|---|---|---|")
    for name, (spoil, *amount) in CASES.items():
        print(f"| {name} | {row(given.path, spoil, *amount, settings=settings)} |", flush=True)


if __name__ == "__main__":
    main()
