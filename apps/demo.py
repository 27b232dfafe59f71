"""The demo: registers the bundled capture, prints what it measured against the truth, writes demo/report.html."""

import shutil
from pathlib import Path

from rich.console import Console
from rich.table import Table

from toile.cli import progress_bars
from toile.config import preset
from toile.evaluate import evaluate, flatten
from toile.pipeline import register
from toile.report import write_report

ROOT = Path(__file__).parents[1]
GOALS = {"joint_mm": 10, "track_to_scan_mm": 1.5, "surface_mm": 2, "boundary_mm": 4, "hidden_mm": 10, "visible_mm": 2}


def goal(name):
    """The bound that a measure is held against, where it has one."""
    if name == "label_iou tshirt":
        return "> 0.95"
    return next((f"< {bound}" for key, bound in GOALS.items() if key in name), "")


def main():
    out = ROOT / "demo"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    with progress_bars() as progress:
        register(ROOT / "data_samples" / "tshirt-talk", out / "run", preset("standard"), progress=progress)
    table = Table("measure", "value", "goal", title="The bundled capture against its truth")
    for name, value in flatten(evaluate(out / "run")["all"]).items():
        if value is not None:
            table.add_row(name, f"{value:.3f}" if isinstance(value, float) else str(value), goal(name))
    Console().print(table)
    print(write_report(out / "run", out / "report.html"))


if __name__ == "__main__":
    main()
