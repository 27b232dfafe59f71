"""What `toile register` makes of captures at the edges of what it may be given: solved, said, refused, or silently wrong.

    python -m bench.pipeline_extremes OUT [--rows NAME ...]      # goes on where it stood; the table in Markdown to stdout

Every row says beforehand what must come of it. Each is a process of its own, two or three frames as a draft, of the bundled
capture. *solved*: the answer is right, or else a verdict says that it is not; *said*: it is right, or what is wrong is said in
the words that the row names; *refused*: one line and exit code 1, in such words."""

import argparse
import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from . import pipeline_captures as make
from .posed_captures import CROSSED, CURLED, POCKETS, front, posed

TIMEOUT = 900  # s of a row
FRAMES = (0, 1)
RIGHT, WRONG = 1.5, 3.0  # times the errors of the capture as it is, with 2 mm of grace: right within, wrong beyond
SIZES = {
    "surface": "the tracked surface to the true one",
    "cloth": "the shirt to the true shirt",
    "loops": "its openings",
}


CUT = {"template_from_scan": ["tshirt"]}


@dataclass(frozen=True)
class Row:
    """`must` come of it: solved, said or refused; `change` of the capture. `words`: a regular expression that one of what
    is said, or the refusal, must match to be counted; verdicts read "frame 1 wrong: ...", and so do failed frames."""

    must: str
    change: Callable
    words: str = ""
    frames: tuple = FRAMES
    settings: dict = field(default_factory=dict)


def same(capture):
    pass


def solved(change, frames=FRAMES, settings=None):
    return Row("solved", change, JUDGED, frames, settings or {})


def said(words, change, frames=FRAMES, settings=None):
    return Row("said", change, words, frames, settings or {})


def refused(words, change):
    return Row("refused", change, words)


JUDGED = "^frame . (doubtful|wrong|failed)"  # what no warning alone answers
POSE = "^frame . (doubtful|wrong)"
OTHER = "another (cut|kind)|one opening"  # a template of another garment

ROWS = {
    "as it is": solved(same),
    "1 camera": solved(make.only(1)),
    "2 cameras": solved(make.only(2)),
    "3 cameras": solved(make.only(3)),
    "60 cameras": solved(make.sixty),
    "pictures of 64 px": said("a pixel is .* wide", make.pictures_of(64)),
    "pictures of 4096 px, 4 cameras": solved(make.four_of_4096, (0,)),
    "scans of 500 faces": said(f"{POSE}.*scan|scan.*triangles", make.decimated(500)),
    "scans of 2,000,000 faces and more": solved(make.two_million, (0,)),
    "50 % holes": solved(make.holes),
    "5 mm noise": solved(make.noise),
    "scan 30 cm beside the person": said("keypoints", make.beside),
    "30 % wrong labels": solved(make.wrong_labels),
    "no keypoints": solved(make.no_keypoints),
    "40 % of keypoints outliers": solved(make.outliers),
    "lying": solved(make.turned("x", 90)),
    "upside down": solved(make.turned("x", 180)),
    "seen from behind": solved(make.turned("z", 180)),
    "arms crossed": said(POSE, posed(CROSSED)),
    "curled up": said(POSE, posed(CURLED, 1.0)),
    "hands in pockets": said(POSE, posed(POCKETS, hidden=("hand_left", "hand_right"))),
    "two people in the scan": said(POSE, make.second_person),
    "a frame out of step": said("^frame 1 (doubtful|wrong).*(keypoints|silhouette)", make.out_of_step, (0, 1, 2)),
    "1 frame": solved(same, (0,)),
    "frames missing": said("^frame 2 failed.*(scan|keypoints)", make.missing, (0, 2, 3)),
    "template 17 % too large": solved(make.moved(lambda V: 1.17 * V)),
    "template 17 % too small": solved(make.moved(lambda V: V / 1.17)),
    "template inside out": said("inwards", make.inside_out),
    "template mirrored": said("mirrored", make.moved(lambda V: V * [-1, 1, 1])),
    "template in millimetres": said("scaled by 0.001", make.moved(lambda V: 1000 * V)),
    "template with y up": said("axes", make.moved(lambda V: V[:, [0, 2, 1]] * [1, 1, -1])),
    "template of 300 vertices": solved(make.remeshed(0.06)),
    "template of 100,000 vertices": solved(make.remeshed(0.0031), (0,)),
    "template cut from the scan": solved(same, settings=CUT),
    "garment leaves the picture": solved(make.cropped),
    "garment named, not worn": refused("coat.*worn", make.not_worn),
    "garment worn, not named": solved(make.not_named),
    "garment half taken off": said(OTHER, posed({}, bare=lambda V: V[:, 0] > 0.03)),
    "one-piece, a shirt's template": refused(OTHER, posed({}, also=(4,))),
    "one-piece, cut from the scan": solved(posed({}, also=(4,)), settings=CUT),
    "jacket, a shirt's template": refused(OTHER, posed({}, bare=front)),
    "jacket, cut from the scan": solved(posed({}, bare=front), settings=CUT),
    "hood, a shirt's template": said("loop neck", posed({}, also=(2,))),
    "hood, cut from the scan": solved(posed({}, also=(2,)), settings=CUT),
    "dress, a shirt's template": refused(OTHER, posed({}, skirt=0.5)),
    "dress, cut from the scan": said(f"{POSE}|loop hem", posed({}, skirt=0.5), settings=CUT),
    "a button on the shirt": solved(make.with_button),
}


def one(name, folder):
    """What came of a row: {"refused"} or verdicts, warnings, errors [mm], seconds."""
    from toile.errors import UserError
    from toile.kernels import InputError
    from toile.measure.evaluate import evaluate
    from toile.pipeline.run import register

    asked = ROWS[name]
    capture = make.bundled(folder / "capture")
    asked.change(capture)
    start = time.process_time()
    try:
        few = {"quality": "draft", "preparation_frames": 3, "frames": asked.frames}
        outcome = register(capture, folder / "run", **few, **asked.settings)
    except (UserError, InputError) as error:
        return {"refused": str(error).replace(str(folder), "")}
    seconds = time.process_time() - start
    measured = evaluate(folder / "run")["all"]
    shirt, evidence = measured["garment"].get("tshirt", {}), measured["evidence"]
    return {
        "ok": len(outcome.ok), "said": [*outcome.warnings, *verdicts(outcome)], "seconds": seconds,
        "errors": {
            "surface": surface_error(folder / "run"), "joints": measured["joint_mm"], "cloth": shirt.get("surface_mm"),
            "loops": shirt.get("boundary_all_mm"), "to scan": evidence["surface_to_scan_mm"]["mean"],
        },
    }  # fmt: skip


def verdicts(outcome):
    """Of every frame that is not good: what it is, and why."""
    kinds = {kind: getattr(outcome, kind) for kind in ("doubtful", "wrong", "failed")}
    return [f"frame {n} {kind}: {why}" for kind, frames in kinds.items() for n, why in frames.items()]


def surface_error(run):
    """Mean distance of the tracked surface's outside vertices to the true outer surface [mm], the worst frame."""
    from toile import kernels
    from toile.io.run import open_run
    from toile.measure.truth import open_truth

    opened = open_run(run)
    truth, worst = open_truth(opened.capture), 0.0
    for number in opened.ok:
        V, F, _ = truth.outer(number, {"tshirt": make.SHIRT})
        off = kernels.SurfaceIndex(V, F).closest(opened.track.at(number)[~opened.body_model.inside])[3]
        worst = max(worst, 1e3 * off.mean())
    return worst


def in_process(name, out):
    """The row's result, made when OUT does not hold it."""
    path = _path(name, out)
    if not path.exists():
        folder = path.with_suffix("")
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        command = [sys.executable, "-m", "bench.pipeline_extremes", str(folder), "--one", name]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT)
            lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
            found = json.loads(lines[-1]) if lines else {"crashed": done.stderr.strip().splitlines()[-1:]}
        except subprocess.TimeoutExpired:
            found = {"crashed": [f"more than {TIMEOUT} s"]}
        shutil.rmtree(folder)
        path.write_text(json.dumps(found, indent=1))
    return json.loads(path.read_text())


def _path(name, out):
    return out / f"{''.join(c if c.isalnum() else '-' for c in name)}.json"


def quality(found, clean):
    """right, degraded or wrong, by the worst of the errors against those of the capture as it is."""
    factors = []
    for name in SIZES:
        error, base = found["errors"].get(name), clean["errors"][name]
        if error is not None:
            factors.append((error - 2.0) / base)
    if found["ok"] == 0:
        return "nothing registered"
    worst = max(factors, default=0)
    return "right" if worst <= RIGHT else "degraded" if worst <= WRONG else "wrong"


def heard(words, texts):
    """The first of the texts that matches what was to be said."""
    return next((text for text in texts if re.search(words, text)), None)


def row(name, found, clean):
    asked = ROWS[name]
    line = lambda came, told="", errors="": (
        f"| {name} | {asked.must} | {came} | {told.replace('|', '/')[:160]} | {errors} |"
    )
    if "crashed" in found:
        return line(f"**crashed** ({' '.join(found['crashed'])[:80]})")
    if "refused" in found:
        named = asked.must != "solved" and heard(asked.words, [found["refused"]])
        return line("refused" if named else "**refused for another cause**", found["refused"])
    how, told = quality(found, clean), heard(asked.words, found["said"])
    short = how != "right" and not told or asked.must == "refused"
    came = f"**silently {how}**" if short else f"{how}, said" if told else how
    errors = ", ".join(f"{found['errors'][n]:.1f}" if found["errors"].get(n) is not None else "-" for n in SIZES)
    return line(came, told or "", errors)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--one")
    parser.add_argument("--rows", nargs="*", default=list(ROWS))
    parser.add_argument("--table", action="store_true", help="of the rows that OUT holds alone")
    args = parser.parse_args()
    if args.one:
        print(json.dumps(one(args.one, args.out)))
        return
    args.out.mkdir(parents=True, exist_ok=True)
    clean = in_process("as it is", args.out)
    print(f"| capture | must be | came out | what was said | {', '.join(SIZES)} [mm] |\n|---|---|---|---|---|")
    for name in args.rows if not args.table else [name for name in ROWS if _path(name, args.out).exists()]:
        print(row(name, in_process(name, args.out), clean), flush=True)


if __name__ == "__main__":
    main()
