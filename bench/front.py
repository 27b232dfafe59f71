"""Seconds a frame and errors of `toile register` at each quality.   python -m bench.front [CAPTURE OUT] [--frames N]

Without arguments on the bundled capture, to docs/measurements/front.json, which `make tradeoff` draws; else on N frames of a
capture that has truth, to the file OUT. Two threads."""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from toile import kernels
from toile.config import QUALITIES, preset
from toile.io.capture import open_capture
from toile.measure.evaluate import evaluate
from toile.pipeline import run as pipeline

from .summary import mark_front

ROOT = Path(__file__).parents[1]
SAMPLE = ROOT / "data_samples" / "tshirt-talk"
FRONT = ROOT / "docs" / "measurements" / "front.json"
PANELS = {  # of the picture: the errors, and what they are called there
    "surface_mm": "garment's surface", "boundary_mm": "openings", "hidden_mm": "body under garments",
    "correspondence_mm": "correspondence",
}  # fmt: skip


def errors(measured):
    """The figures of `evaluate` that tell qualities apart."""
    garment = next(iter(measured["garment"].values()))
    return {
        "track_to_scan_mm": measured["track_to_scan_mm"],
        "boundary_mm": float(np.mean(list(garment["boundary_mm"].values()))),
        "surface_mm": garment["surface_mm"],
        "hidden_mm": measured["inner"]["hidden_mm"],
        "correspondence_mm": garment["correspondence_mm"],
    }


def panels(table):
    """The qualities of a front as panels of `bench.picture.draw`: seconds a frame, all stages, against each error."""
    out = {}
    for error, title in PANELS.items():
        points = [
            dict(method=q, ours=True, oracle=False, failed=0, on_front=False)
            | dict(seconds=sum(table[q]["seconds"].values()), error=table[q]["errors"].get(error))
            for q in QUALITIES
            if q in table
        ]
        mark_front([p for p in points if p["error"] is not None])
        out[f"register: {title}"] = dict(kernel="register", error="mean error [mm]", points=points)
    return out


def main():
    parse = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parse.add_argument("capture", type=Path, nargs="?", default=SAMPLE)
    parse.add_argument("out", type=Path, nargs="?", default=FRONT)
    parse.add_argument("--frames", type=int, default=None, help="the first so many; all by default")
    a = parse.parse_args()
    if (a.capture == SAMPLE) != (a.out == FRONT):
        parse.error("a capture of your own needs a file of its own")
    kernels.set_threads(2)
    capture = open_capture(a.capture)
    frames, table = capture.frames[: a.frames], {}
    with tempfile.TemporaryDirectory() as folder:
        for quality in QUALITIES:
            run = Path(folder) / quality
            pipeline.register(a.capture, run, preset(quality), frames)
            measured = evaluate(run)["all"]
            table[quality] = {"seconds": measured["seconds"], "errors": errors(measured)}
    text = json.dumps(table, indent=1)
    a.out.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
