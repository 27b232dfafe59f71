"""What `toile register` makes of captures at the edges of what it may be given: solved, said, refused, or silently wrong.

    python -m bench.pipeline_extremes OUT [--rows NAME ...]      # goes on where it stood; the table in Markdown to stdout

Every row says beforehand what must come of it. Each is a process of its own, two or three frames as a draft, of the bundled
capture. *solved*: the answer is right; *said*: a frame is doubtful, wrong or failed, or a warning that the capture as it is
does not give; *refused*: one line and exit code 1."""

import argparse
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

from . import pipeline_captures as make

TIMEOUT = 900  # s of a row
FRAMES = (0, 1)
RIGHT, WRONG = 1.5, 3.0  # times the errors of the capture as it is, with 2 mm of grace: right within, wrong beyond
SIZES = {
    "surface": "the tracked surface to the true one",
    "cloth": "the shirt to the true shirt",
    "loops": "its openings",
}


CUT = {"template_from_scan": ["tshirt"]}


def same(capture):
    pass


ROWS = {  # name: (what must come of it, how the capture is changed, frames, more settings)
    "as it is": ("solved", same),
    "1 camera": ("solved", make.only(1)),
    "2 cameras": ("solved", make.only(2)),
    "3 cameras": ("solved", make.only(3)),
    "60 cameras": ("solved", make.sixty),
    "pictures of 64 px": ("solved", make.pictures_of(64)),
    "pictures of 4096 px, 4 cameras": ("solved", lambda c: (make.only(4)(c), make.pictures_of(4096)(c)), (0,)),
    "scans of 500 faces": ("said", make.decimated(500)),
    "scans of 2,000,000 faces and more": ("solved", make.two_million, (0,)),
    "50 % holes": ("solved", make.holes),
    "5 mm noise": ("solved", make.noise),
    "scan 30 cm beside the person": ("said", make.beside),
    "30 % wrong labels": ("solved", make.wrong_labels),
    "no keypoints": ("solved", make.no_keypoints),
    "40 % of keypoints outliers": ("solved", make.outliers),
    "lying": ("solved", make.turned("x", 90)),
    "upside down": ("solved", make.turned("x", 180)),
    "seen from behind": ("solved", make.turned("z", 180)),
    "arms crossed": ("said", make.posed(make.CROSSED)),
    "curled up": ("said", make.posed(make.CURLED, 1.0)),
    "hands in pockets": ("said", make.posed(make.POCKETS, hidden=("hand_left", "hand_right"))),
    "two people in the scan": ("said", make.second_person),
    "a frame out of step": ("said", make.out_of_step, (0, 1, 2)),
    "1 frame": ("solved", same, (0,)),
    "frames missing": ("said", make.missing, (0, 2, 3)),
    "template 17 % too large": ("solved", make.moved(lambda V: 1.17 * V)),
    "template 17 % too small": ("solved", make.moved(lambda V: V / 1.17)),
    "template inside out": ("said", make.inside_out),
    "template mirrored": ("said", make.moved(lambda V: V * [-1, 1, 1])),
    "template in millimetres": ("said", make.moved(lambda V: 1000 * V)),
    "template with y up": ("said", make.moved(lambda V: V[:, [0, 2, 1]] * [1, 1, -1])),
    "template of 300 vertices": ("solved", make.remeshed(0.06)),
    "template of 100,000 vertices": ("solved", make.remeshed(0.0031), (0,)),
    "template cut from the scan": ("solved", same, FRAMES, CUT),
    "garment leaves the picture": ("solved", make.cropped),
    "garment named, not worn": ("refused", make.not_worn),
    "garment worn, not named": ("solved", make.not_named),
    "garment half taken off": ("said", make.posed({}, bare=lambda V: V[:, 0] > 0.03)),
    "one-piece, a shirt's template": ("refused", make.posed({}, also=(4,))),
    "one-piece, cut from the scan": ("solved", make.posed({}, also=(4,)), FRAMES, CUT),
    "jacket, a shirt's template": ("refused", make.posed({}, bare=make.front)),
    "jacket, cut from the scan": ("solved", make.posed({}, bare=make.front), FRAMES, CUT),
    "hood, a shirt's template": ("said", make.posed({}, also=(2,))),
    "hood, cut from the scan": ("solved", make.posed({}, also=(2,)), FRAMES, CUT),
    "dress, a shirt's template": ("refused", make.posed({}, skirt=0.5)),
    "dress, cut from the scan": ("said", make.posed({}, skirt=0.5), FRAMES, CUT),
    "a button on the shirt": ("solved", make.with_button),
}  # fmt: skip


def one(name, folder):
    """What came of a row: {"refused"} or verdicts, warnings, errors [mm], seconds."""
    from toile.errors import UserError
    from toile.kernels import InputError
    from toile.measure.evaluate import evaluate
    from toile.pipeline.run import register

    _, change, *more = ROWS[name]
    capture = make.bundled(folder / "capture")
    change(capture)
    frames, settings = (more[0] if more else FRAMES), (more[1] if len(more) > 1 else {})
    start = time.process_time()
    try:
        outcome = register(capture, folder / "run", quality="draft", preparation_frames=3, frames=frames, **settings)
    except (UserError, InputError) as error:
        return {"refused": str(error).replace(str(folder), "")}
    seconds = time.process_time() - start
    measured = evaluate(folder / "run")["all"]
    shirt, evidence = measured["garment"].get("tshirt", {}), measured["evidence"]
    return {
        "ok": len(outcome.ok), "doubtful": outcome.doubtful, "wrong": outcome.wrong, "failed": outcome.failed,
        "warnings": list(outcome.warnings), "seconds": seconds,
        "errors": {
            "surface": surface_error(folder / "run"), "joints": measured["joint_mm"], "cloth": shirt.get("surface_mm"),
            "loops": shirt.get("boundary_all_mm"), "to scan": evidence["surface_to_scan_mm"]["mean"],
        },
    }  # fmt: skip


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


def said(found, clean):
    """What was said of the row that is not said of the capture as it is."""
    words = [f"{len(found[kind])} {kind}" for kind in ("doubtful", "wrong", "failed") if found[kind]]
    more = [
        w for w in found["warnings"] if w.split(": ", 1)[-1] not in {v.split(": ", 1)[-1] for v in clean["warnings"]}
    ]
    return words, more


def row(name, found, clean):
    must = ROWS[name][0]
    if "crashed" in found:
        return f"| {name} | {must} | **crashed** ({' '.join(found['crashed'])[:80]}) | | |"
    if "refused" in found:
        return f"| {name} | {must} | refused | {found['refused'][:160].replace('|', '/')} | |"
    how, (words, warnings) = quality(found, clean), said(found, clean)
    silent = how == "wrong" and not words and not warnings
    short = must == "said" and how != "right" and not words and not warnings
    came = f"**silently {how}**" if silent or short else f"{how}, said" if words or warnings else how
    told = "; ".join([*words, *(w[:110] for w in warnings[:1])]).replace("|", "/")
    errors = ", ".join(f"{found['errors'][n]:.1f}" if found["errors"].get(n) is not None else "-" for n in SIZES)
    return f"| {name} | {must} | {came} | {told} | {errors} |"


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
