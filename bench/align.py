"""Measures a run before and after `toile align` against a studio capture's truth: python -m bench.align RUN RUN2 [--json].

interior: vertices 3 cm and more from the garment's loops. correspondence_mm: to their true places. slip_mm: the same without
what each vertex errs by on average over the frames, in the tangent frames of the true garment, along its surface and off it;
no picture can tell a mistake that all frames share. shared_mm: that mistake. jitter_mm: mean length of the second difference
over time of the error, over consecutive frames of the run. boundary_mm is a mean over the loops' vertices; boundary_curve_mm
is one over their length, which does not change when vertices only spread along the same curve.
"""

import argparse
import json

import numpy as np
from scipy.spatial import cKDTree

from toile import kernels
from toile.io.run import open_run
from toile.measure.motion import tangents
from toile.measure.truth import mean_measures, open_truth
from toile.surface.operators import distance_to_polyline

INTERIOR = 0.03  # from the loops [m]


def measure(run, truth, name):
    garment, skin = run.garments[name], run.body_model.skin_faces
    frames, loops, F = [n for n in run.ok if n in truth], garment.loops, garment.faces
    parts, errors, pairs = [], [], 0
    for number in frames:
        V = garment.at(number)
        measures, error = truth.garment_errors(name, loops, V, garment.faces, number)
        place = truth.places(name, number)
        parts.append(measures | {"boundary_curve_mm": curves(truth, name, loops, V, number)})
        errors.append((error, np.einsum("gi,gai->ga", error, tangents(place, F))))
        pairs += len(kernels.intersecting_pairs(V, F, run.inner.at(number), skin))
    interior = cKDTree(place[np.concatenate(list(loops.values()))]).query(place)[0] > INTERIOR
    world, local = (1e3 * np.array(e)[:, interior] for e in zip(*errors))
    steps = [np.linalg.norm(world[i - 1] - 2 * world[i] + world[i + 1], axis=1).mean() for i in consecutive(frames)]
    shared = local.mean(0)
    mean = mean_measures(parts)
    return {
        "interior": {
            "correspondence_mm": float(np.linalg.norm(world, axis=2).mean()),
            "slip_mm": float(np.linalg.norm(local - shared, axis=2).mean()),
            "shared_mm": float(np.linalg.norm(shared, axis=1).mean()),
            "jitter_mm": float(np.mean(steps)) if steps else None,
        },
        "correspondence_mm": mean["correspondence_mm"],
        "boundary_mm": float(np.mean(list(mean["boundary_mm"].values()))),
        "boundary_curve_mm": float(np.mean(list(mean["boundary_curve_mm"].values()))),
        "surface_mm": mean["surface_mm"],
        "intersections": pairs / len(frames),
        "frames": len(frames),
    }


def curves(truth, name, loops, V, number):
    """Mean distance [mm] by loop of four points an edge, weighted by its length, to the true border that is its own."""
    T, F = truth.garment(name, number)
    borders, place, found = [T[loop] for loop in kernels.boundary_loops(F)], truth.places(name, number), {}
    for loop, at in loops.items():
        own = min(borders, key=lambda loop: distance_to_polyline(place[at], loop).mean())
        step = np.roll(V[at], -1, 0) - V[at]
        distance = np.mean([distance_to_polyline(V[at] + s * step, own) for s in (0.125, 0.375, 0.625, 0.875)], axis=0)
        found[loop] = float(1e3 * np.average(distance, weights=np.linalg.norm(step, axis=1)))
    return found


def consecutive(frames):
    step = min(np.diff(frames), default=1)
    return [i for i in range(1, len(frames) - 1) if frames[i + 1] - frames[i] == frames[i] - frames[i - 1] == step]


def compare(before, after):
    before, after = open_run(before), open_run(after)
    capture = before.capture
    names = [g.name for g in capture.scene.garments]
    truth = open_truth(capture, names)
    if truth is None:
        raise SystemExit(f"{capture.root}: no truth to measure against")
    result = {name: {"before": measure(before, truth, name), "after": measure(after, truth, name)} for name in names}
    for name, found in result.items():
        path = after.path / "alignment.json"
        if path.exists():
            found["prints"] = json.loads(path.read_text())[name]
    return result


def lines(found):
    flat = [{}, {}]
    for out, side in zip(flat, ("before", "after")):
        for key, value in found[side].items():
            out |= {f"interior {k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
    for key, value in flat[0].items():
        after = flat[1][key]
        change = f"{100 * (after / value - 1):+6.1f} %" if value and after is not None else ""
        yield f"  {key:<28} {value if value is None else round(value, 3)!s:>10} {after if after is None else round(after, 3)!s:>10} {change:>10}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before"), parser.add_argument("after"), parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    result = compare(arguments.before, arguments.after)
    if arguments.json:
        print(json.dumps(result))
    else:
        for name, found in result.items():
            print("\n".join([name, *lines(found)]))
