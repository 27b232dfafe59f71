"""The demo: registers the bundled capture, and a frame of sixteen cameras from its pictures and labels alone, prints what it
measured against the truth, trains a small avatar for about a minute, and writes demo/report.html with what the avatar shows
of a frame that it never saw. It ends with 1 where an error is beyond its bound."""

import shutil
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from toile.avatar.measure.evaluation import evaluate_avatar
from toile.avatar.measure.report import section
from toile.avatar.settings import preset as avatar_preset
from toile.avatar.train.make import Request, make_avatar
from toile.config import preset
from toile.console import progress_bars
from toile.measure.evaluate import evaluate
from toile.measure.page import flatten
from toile.measure.report import write_report
from toile.pipeline.run import register

ROOT = Path(__file__).parents[1]
MINUTES = 1.0  # of training
BOUNDS = {  # of each measure with scans, and of the frame from pictures alone
    "joint_mm": (10, 15),
    "track_to_scan_mm": (1.5, 1.5),
    "surface_mm": (2, 5),
    "boundary_mm": (8, 8),
    "boundary_all_mm": (4, 5),
    "hidden_mm": (10, 15),
    "visible_mm": (2, 8),
}
WITH_SCANS, FROM_PICTURES = ({name: both[k] for name, both in BOUNDS.items()} for k in (0, 1))
HELD_OUT = (5, 5)  # first and last frame that is kept apart: no other frame is made with it, nor is the avatar
LEAST = {"label_iou tshirt": 0.95}


def bound_of(name, bounds):
    """(below, above) that a measure has to lie between, None where it has no bound."""
    return next((bound for key, bound in bounds.items() if key in name.split()), None), LEAST.get(name)


def registered(capture, run, bounds, title, **settings):
    """Registers a bundled capture and prints what `evaluate` finds; -> names of the measures that are beyond their bound."""
    with progress_bars() as progress:
        register(ROOT / "data_samples" / capture, run, preset("standard"), progress=progress, **settings)
    table, beyond = Table("measure", "value", "bound", title=title), []
    for name, value in flatten(evaluate(run)["all"]).items():
        if value is None:
            continue
        most, least = bound_of(name, bounds)
        if (most is not None and value >= most) or (least is not None and value <= least):
            beyond.append(f"{capture}: {name} is {value:.3f}")
        bound = f"< {most}" if most is not None else f"> {least}" if least is not None else ""
        table.add_row(name, f"{value:.3f}" if isinstance(value, float) else str(value), bound)
    Console().print(table)
    return beyond


def main():
    out = ROOT / "demo"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    title = "The bundled capture against its truth"
    beyond = registered("tshirt-talk", out / "run", WITH_SCANS, title, holdout=HELD_OUT)
    title = "A frame of sixteen cameras, from its pictures and labels alone"
    beyond += registered("tshirt-pictures", out / "pictures", FROM_PICTURES, title)
    print(write_report(out / "run", out / "report.html", avatar(out / "run", out / "avatar")))
    for line in beyond:
        print(f"beyond its bound: {line}")
    return 1 if beyond else 0


def avatar(run, folder):
    """Trains a draft avatar on all frames but the last and returns the report's section about it."""
    with progress_bars() as progress:
        stages = lambda stage, done, total, note="": progress(stage, done, total)
        make_avatar(Request(run, avatar_preset("draft"), MINUTES, progress=stages), folder)
    result = evaluate_avatar(folder)
    found = result["all"]["layered"]
    print(
        f"avatar, frame {result['per_frame'][0]['frame']} held out: SSIM {found['ssim']:.3f}, PSNR {found['psnr']:.1f} dB"
    )
    return section(folder, result)


if __name__ == "__main__":
    sys.exit(main())
