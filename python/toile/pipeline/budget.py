"""Which quality fits a time per frame, from measured runs: `--budget` of the command line."""

import json
import time
from importlib import resources

import numpy as np

from .. import kernels
from ..config import QUALITIES
from ..errors import UserError

# shares of a stage's time on the bundled capture that grow with pixels and with scan faces, the rest with neither:
# from captures of 1.0 and 2.1 M pixels, 19k and 60k faces
_SHARES = {"track": (0, 0.05), "segment": (0.4, 0.05), "dress": (0, 0.05)}


def front():
    """{quality: {"seconds": {stage: s a frame}, "errors": {...} [mm]}, "reference": {...}}: the bundled capture
    registered at each quality, as `python -m bench.front` measured it, with the calibration's time in the same run."""
    return json.loads(resources.files("toile.assets").joinpath("front.json").read_text(encoding="utf-8"))


def calibration():
    """Median time [s] of one small fit, the yardstick between machines."""
    from ..io.body import load_body_model

    body = load_body_model("anny")
    solver = kernels.NricpSolver(body.v_template, body.f, "draft")
    times = []
    for k in range(5):
        start = time.perf_counter()
        solver.solve(body.v_template * (1 + 0.005 * (k + 1)), body.f)
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def workload(capture, numbers):
    """What the time of a frame grows with: pictures' pixels and scan faces, of the first frame."""
    frame = capture.frame(numbers[0])
    faces = 0 if frame.scan is None else len(frame.scan.faces)
    labelled = frame.images if capture.scene.segmenter else frame.labels
    return {"pixels": int(sum(image.shape[0] * image.shape[1] for image in labelled.values())), "faces": faces}


def expected(measured, reference, work, speed):
    """Seconds a frame on this machine for this capture."""
    pixels, faces = (work[k] / reference[k] if work[k] else 1.0 for k in ("pixels", "faces"))

    def scaled(stage, seconds):
        with_pixels, with_faces = _SHARES.get(stage, (0, 0))
        return seconds * (1 + with_pixels * (pixels - 1) + with_faces * (faces - 1))

    return speed * sum(scaled(stage, seconds) for stage, seconds in measured["seconds"].items())


def choose(capture, numbers, seconds):
    """The finest quality whose expected time a frame fits `seconds`, that time, and the errors to expect.

    Raises UserError where even draft would take longer."""
    table, work = front(), workload(capture, numbers)
    speed = calibration() / table["reference"]["calibration"]
    times = {q: expected(table[q], table["reference"], work, speed) for q in QUALITIES}
    fitting = [q for q in QUALITIES if times[q] <= seconds]
    if not fitting:
        raise UserError(f"--budget {seconds}: draft would take about {times['draft']:.2f} s a frame on this machine")
    return fitting[-1], times[fitting[-1]], table[fitting[-1]]["errors"]
