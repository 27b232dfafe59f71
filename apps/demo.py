"""The demo: registers the bundled capture, prints what it measured against the truth, trains a small avatar for about a
minute, and writes demo/report.html with what the avatar shows of a frame that it never saw."""

import shutil
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
BOUNDS = {"joint_mm": 10, "track_to_scan_mm": 1.5, "surface_mm": 2, "boundary_mm": 4, "hidden_mm": 10, "visible_mm": 2}


def bound_of(name):
    """The bound that a measure is held against, where it has one."""
    if name == "label_iou tshirt":
        return "> 0.95"
    return next((f"< {bound}" for key, bound in BOUNDS.items() if key in name.split()), "")


def main():
    out = ROOT / "demo"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    with progress_bars() as progress:
        register(ROOT / "data_samples" / "tshirt-talk", out / "run", preset("standard"), progress=progress)
    table = Table("measure", "value", "bound", title="The bundled capture against its truth")
    for name, value in flatten(evaluate(out / "run")["all"]).items():
        if value is not None:
            table.add_row(name, f"{value:.3f}" if isinstance(value, float) else str(value), bound_of(name))
    Console().print(table)
    print(write_report(out / "run", out / "report.html", avatar(out / "run", out / "avatar")))


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
    main()
