"""Is a person found in a scan alone, whichever way she faces? Scans of studio captures, turned, against their true bodies.

    python -m bench.pose_search CAPTURE... [--frames 2] [--headings 20,250]

A line a scan and heading: the mean over the body's parts (those of one bone) of how far their middle lies from the true one,
the distance from both sides (surface/two_sided.py), `astray`, and CPU seconds. The quick search alone is measured: the fit of
the preparation, which follows, begins there.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from toile.config import preset
from toile.frame_numbers import evenly
from toile.io.body import model_in_capture
from toile.io.capture import open_capture
from toile.measure.truth import Truth
from toile.surface.pose_search import PoseSearch
from toile.surface.two_sided import TwoSided

MOVED = np.array([0.3, -2.0, 0.5])  # [m]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--frames", type=int, default=2, help="of a capture, evenly spread")
    parser.add_argument("--headings", default="20,250", help="degrees about the up axis, separated by commas")
    args = parser.parse_args()
    print("| capture | frame | heading | parts mm | two-sided mm | astray % | CPU s |\n|---|---|---|---|---|---|---|")
    for path in args.captures:
        opened, truth = open_capture(path), Truth(path / "truth" / "truth.zarr")
        model = model_in_capture(opened.root, opened.scene.body_model, opened.scene.up)
        for number in evenly([n for n in opened.frames if n in truth], args.frames):
            scan, body = opened.frame(number).scan, truth.body(number)[0]
            for degrees in map(float, args.headings.split(",")):
                turn = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)["xyz".index(opened.scene.up)]).as_matrix().T
                turned = replace(scan, vertices=scan.vertices @ turn + MOVED)
                told = searched(model, turned, body @ turn + MOVED)
                print(
                    f"| {path.name} | {number} | {degrees:.0f} | {' | '.join(f'{x:.1f}' for x in told)} |", flush=True
                )


def searched(model, scan, body):
    """(parts [mm], two-sided [mm], astray [%], CPU seconds) of a search in a scan of a true body (n,3)."""
    settings, start = preset("standard").track, time.process_time()
    search = PoseSearch(model, settings.headings, settings.search, settings.skeleton.model_dump())
    (rotations, translation, shape), _ = search.pose(scan)
    seconds = time.process_time() - start
    V = model.skin(*model.rest(shape), rotations, translation)
    distance, astray = TwoSided(scan, search.looks)(V)
    return parts_mm(model, V - body), 1e3 * distance, 100 * astray, seconds


def parts_mm(model, off):
    """Mean over the outside vertices of how far the middle of their part has moved, of moves (n,3)."""
    part = model.mover
    size = np.bincount(part[~model.inside], minlength=len(model.parents))
    sums = np.stack([np.bincount(part[~model.inside], x, len(size)) for x in off[~model.inside].T], 1)
    return 1e3 * np.linalg.norm(sums, axis=1).sum() / size.sum()


if __name__ == "__main__":
    main()
