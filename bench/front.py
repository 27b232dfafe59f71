"""Seconds a frame and errors of `toile register` at each quality, on the bundled capture.   python -m bench.front

Writes python/toile/assets/front.json, which `toile register --budget` reads. Two threads; the calibration that compares
machines is timed between the runs."""

import json
import tempfile
from pathlib import Path

import numpy as np

from toile import kernels
from toile.config import QUALITIES, preset
from toile.io.capture import open_capture
from toile.measure.evaluate import evaluate
from toile.pipeline import run as pipeline
from toile.pipeline.budget import calibration, workload

ROOT = Path(__file__).parents[1]
SAMPLE = ROOT / "data_samples" / "tshirt-talk"


def errors(measured):
    """The figures of `evaluate` that tell qualities apart."""
    garment = next(iter(measured["garment"].values()))
    return {
        "track_to_scan_mm": measured["track_to_scan_mm"],
        "boundary_mm": float(np.mean(list(garment["boundary_mm"].values()))),
        "surface_mm": garment["surface_mm"],
        "hidden_mm": measured["inner"]["hidden_mm"],
    }


def main():
    kernels.set_threads(2)
    capture = open_capture(SAMPLE)
    table, times = {}, [calibration()]
    with tempfile.TemporaryDirectory() as folder:
        for quality in QUALITIES:
            run = Path(folder) / quality
            pipeline.register(SAMPLE, run, preset(quality), capture.frames)
            measured = evaluate(run)["all"]
            table[quality] = {"seconds": measured["seconds"], "errors": errors(measured)}
            times.append(calibration())
    table["reference"] = {"calibration": float(np.median(times)), **workload(capture, capture.frames)}
    text = json.dumps(table, indent=1)
    (ROOT / "python" / "toile" / "assets" / "front.json").write_text(text + "\n", encoding="utf-8")
    print(text, times)


if __name__ == "__main__":
    main()
