"""Are the verdicts of `toile register` to be trusted? Frames whose truth is known, right and wrong, against their verdicts.

    python -m bench.verdicts collect OUT CAPTURE...     # registers, spoils, measures; goes on where it was stopped
    python -m bench.verdicts table OUT                  # counts by verdict: all, and by spoiling

Each capture (of `toile studio`) is registered once at draft. Then frames of it are given again to the same person and
templates, each spoilt in one way (bench/spoiling.py), by all stages. How far off a frame is:

- body: the mean over the outside vertices of how far the part that they belong to (those of one bone) lies from its true
  place, centroid to centroid, so that slip along the skin and twist of a limb, which no scan shows, do not count;
- body surface: the mean of the outside vertices to the true body;
- garment: the mean of its vertices to the true garment, and that of the vertices of its loops to their true borders.

The largest of these counts. A frame beyond 15 mm is wrong, one within 10 mm right; between them it is neither. The table's
second row counts the worst single loop too, either way: its vertices to its true border and that border's to the loop.
"""

import argparse
import json
import traceback
from functools import partial
from pathlib import Path

import numpy as np

from bench.spoiling import OF_GARMENTS, SPOILINGS, instead, unsearched
from toile.config import preset
from toile.frame_numbers import evenly
from toile.io.capture import open_capture
from toile.io.layout import VERDICTS
from toile.kernels import SurfaceIndex
from toile.measure.glimpse import glimpse
from toile.measure.truth import open_truth
from toile.measure.verdicts import judge, verdict
from toile.pipeline import preparation, samples
from toile.pipeline.manifest import request_of
from toile.pipeline.run import register

WRONG_MM, RIGHT_MM = 15.0, 10.0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    collecting = commands.add_parser("collect")
    collecting.add_argument("out", type=Path)
    collecting.add_argument("captures", type=Path, nargs="+")
    collecting.add_argument("--frames", type=int, default=4, help="of a capture, each spoilt in every way")
    collecting.add_argument("--quality", default="draft")
    collecting.add_argument("--bare", action="store_true", help="as a scene without garments: the tracked layer alone")
    collecting.add_argument(
        "--only", default="", help="spoilings whose names begin so, separated by commas; default all"
    )
    tabling = commands.add_parser("table")
    tabling.add_argument("out", type=Path)
    tabling.add_argument("--captures", help="names, separated by commas; default all")
    args = parser.parse_args()
    if args.command == "collect":
        for capture in args.captures:
            collect(capture, args.out, args.frames, args.quality, args.bare, args.only.split(","))
    else:
        for line in table(rows_of(args.out, args.captures and args.captures.split(","))):
            print(line)


def collect(capture, out, count, quality, bare, only):
    """Appends a line a frame and spoiling to OUT/CAPTURE.jsonl: {"frame", "spoiling", "errors", "measures"}."""
    out.mkdir(parents=True, exist_ok=True)
    run, config = out / f"run_{capture.name}", preset(quality)
    opened = open_capture(capture)
    frames = opened.frames
    register(capture, run, config, frames)
    sample = partial(samples.sampled_frames, opened, config.preparation_frames)
    asked = request_of(run, opened, config, frames, frames, sample)
    prepared = preparation.prepare(opened, run, config, asked.identities)
    prepared = unsearched(prepared)
    truth = open_truth(prepared.capture, [t.name for t in prepared.templates])
    labels = {t.name: t.label for t in prepared.templates}
    if bare:
        prepared = instead(prepared, templates=(), dressers=())
    file = out / f"{capture.name}{'.bare' if bare else ''}.jsonl"
    done = {(row["frame"], row["spoiling"]) for row in lines(file)}
    for number in evenly(frames, count):
        frame = prepared.capture.frame(number)
        for name, spoil in SPOILINGS.items():
            if (number, name) in done or (bare and name in OF_GARMENTS) or not name.startswith(tuple(only)):
                continue
            row = {"frame": number, "spoiling": name}
            try:
                row |= measured(prepared, truth, labels, frame, spoil)
            except Exception as error:
                row |= {"failed": f"{type(error).__name__}: {error}"}
                if type(error).__name__ not in ("UserError", "InputError", "SolveError"):
                    traceback.print_exc()
            with open(file, "a") as text:
                text.write(json.dumps(row) + "\n")


def measured(prepared, truth, labels, frame, spoil):
    """Errors and measures of one frame, registered as it was spoilt."""
    number, draw = frame.number, np.random.default_rng(frame.number)
    frame, start, prepared = spoil(prepared, frame, draw)
    points = samples.points_of(prepared.capture, prepared.config, frame)
    tracked = prepared.tracker.track(frame, points, start)
    if not prepared.templates:
        given = prepared.capture.cameras, prepared.model, prepared.person, tracked, (), prepared.config.verdict
        outer = truth.outer(number, labels)[:2]
        return {"errors": errors(prepared, truth, number, tracked, outer), "measures": judge(glimpse(frame), *given)[0]}
    segmented, evidence = preparation.segmented(prepared, prepared.colours, frame, tracked, None)
    dressed = {
        t.name: dresser.dress(frame, tracked, segmented, evidence)
        for t, dresser in zip(prepared.templates, prepared.dressers)
    }
    layer = prepared.inner.solve(tracked, segmented, dressed)
    worn = [(t, layer.garments[t.name], dressed[t.name]) for t in prepared.templates]
    seen = glimpse(frame, segmented.scan_faces)
    given = seen, prepared.capture.cameras, prepared.model, prepared.person, tracked, worn, prepared.config.verdict
    measures, *_ = judge(*given, layer.intersections_left)
    return {"errors": errors(prepared, truth, number, layer, truth.body(number)), "measures": measures}


def errors(prepared, truth, number, layer, surface):
    """How far off the layers of a frame are [mm]; `surface` (V, F): the true one of the body's layer."""
    model, V = prepared.model, truth.body(number)[0]
    outside = ~model.inside
    bone = model.mover
    size = np.bincount(bone[outside], minlength=len(model.parents))
    shift = np.stack([np.bincount(bone[outside], (layer.vertices - V)[outside, i], len(size)) for i in range(3)], 1)
    found = {
        "body_mm": 1e3 * np.linalg.norm(shift, axis=1).sum() / size.sum(),
        "body_surface_mm": 1e3 * SurfaceIndex(*surface).closest(layer.vertices)[3][outside].mean(),
        "body_places_mm": 1e3 * np.linalg.norm(layer.vertices - V, axis=1)[outside].mean(),
    }
    for t in prepared.templates:
        loops = dict(zip(t.loop_names, t.loops))
        of, _ = truth.garment_errors(t.name, loops, layer.garments[t.name], t.faces, number)
        found |= {f"{t.name}_{name}": of[name] for name in ("surface_mm", "boundary_all_mm", "correspondence_mm")}
        found[f"{t.name}_worst_loop_mm"] = max([*of["boundary_mm"].values(), *of["boundary_missed_mm"].values()])
    return {name: float(value) for name, value in found.items()}


# The table -----------------------------------------------------------------------------------------------------------


def lines(file):
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def rows_of(out, captures=None):
    """All rows of these captures, each with its capture."""
    files = [file for file in sorted(out.glob("*.jsonl")) if captures is None or file.stem in captures]
    return [row | {"capture": file.stem} for file in files for row in lines(file)]


def off(row, aside=("places_mm", "correspondence_mm", "worst_loop_mm")):
    """How far off a frame is [mm]: the largest of what counts."""
    return max(v for name, v in row["errors"].items() if not name.endswith(aside))


def off_by_loops(row):
    """The same with the worst single loop, either way."""
    return off(row, ("places_mm", "correspondence_mm"))


def kind_of(error):
    return "wrong" if error > WRONG_MM else "right" if error < RIGHT_MM else "between"


def table(rows, settings=None):
    """Lines of Markdown: right, wrong and neither by verdict, all and by spoiling."""
    settings = settings or preset("draft").verdict
    counts = {}
    for row in rows:
        said = "failed" if "failed" in row else VERDICTS[verdict(row["measures"], settings)[0]]
        for spoiling, error in (("all", off), ("all, by the worst loop too", off_by_loops), (row["spoiling"], off)):
            kind = "refused" if said == "failed" else kind_of(error(row))
            counts.setdefault(spoiling, {}).setdefault(kind, {}).setdefault(said, 0)
            counts[spoiling][kind][said] += 1
    cell = lambda c: " / ".join(str(c.get(said, 0)) for said in VERDICTS)
    yield "| spoilt by | right: good / doubtful / wrong | 10 to 15 mm | wrong: good / doubtful / wrong | refused |"
    yield "|---|---|---|---|---|"
    for spoiling, by in counts.items():
        kinds = [cell(by.get(kind, {})) for kind in ("right", "between", "wrong")]
        yield f"| {spoiling} | {' | '.join(kinds)} | {by.get('refused', {}).get('failed', 0)} |"


if __name__ == "__main__":
    main()
