"""Time against error: all presets and all peers that are installed, on one family of problems, in one run.

python -m bench.tradeoff [OUT] [--quick] [--seeds 101,102,103] [--problems FOLDER] [--only WORDS] [--timeout SECONDS]

OUT gets rows.jsonl as the run goes (given again it goes on where it stood), then rows.csv, summary.json, tradeoff.png,
and pipeline.png, the whole pipeline's qualities as bench.front measured them.
Problems are written to OUT/problems unless --problems names a folder that has them.
"""

import argparse
import csv
import json
import os
import platform
import time
from importlib import metadata
from pathlib import Path

import numpy as np

from .contenders import methods
from .front import FRONT, panels
from .kernel_problems import score_biharmonic, score_mrf, score_untangle
from .measure import THREADS, frame_files, run
from .metrics import score
from .plan import HELD_OUT, Plan
from .summary import summarise

PACKAGES = (
    "toile",
    "trimesh",
    "open3d",
    "open3d-cpu",
    "libigl",
    "PyMaxflow",
    "gco-wrapper",
    "pycpd",
    "probreg",
    "numpy",
    "scipy",
)
SCORES = {"biharmonic": score_biharmonic, "mrf": score_mrf, "untangle": score_untangle}


def installed(say):
    """The methods whose module is there; says which are not."""
    there = [m for m in methods() if m.installed()]
    for module in sorted({m.module for m in methods()} - {m.module for m in there}):
        say(f"skipped: {module} is not installed")
    return there


def evaluate(problem, method, result):
    """Scores of a result."""
    if problem.kernel == "sequence":
        return sequence_score(problem, method, result)
    with np.load(problem.path) as file:
        arrays = {k: file[k] for k in file.files}
    if not np.isfinite(result).all():
        return dict(error=f"{int((~np.isfinite(result)).any(-1).sum())} vertices are not finite")
    return score(result, arrays) if problem.kernel == "register" else SCORES[problem.kernel](result, arrays)


def sequence_score(problem, method, results):
    """Means over the frames, and the worst of them."""
    with np.load(problem.path / "template.npz") as file:
        template = {k: file[k] for k in file.files}
    frames = []
    for path, V in zip(frame_files(problem.path, method), results, strict=True):
        with np.load(path) as file:
            frames.append(score(V, template | {"gt_v": file["gt_v"]}))
    worst = {f"worst_{k}": max(f[k] for f in frames) for k in ("mean", "max", "hand_max", "flips", "degenerate", "nan")}
    return {k: float(np.mean([f[k] for f in frames])) for k in frames[0]} | worst | {"frames": len(frames)}


def measure_all(problems, there, rows_path, first_seed, timeout, say):
    """Appends a row for every problem and method that has none yet."""
    rows = [json.loads(line) for line in rows_path.read_text().splitlines()] if rows_path.exists() else []
    done = {(r["kernel"], r["problem"], r["seed"], r["method"]) for r in rows}
    with open(rows_path, "a") as out:
        for problem in problems:
            for method in there:
                key = (problem.kernel, problem.name, problem.seed, method.name)
                if key in done or not problem.given_to(method, first_seed):
                    continue
                row = dict(zip(("kernel", "problem", "seed", "method"), key))
                row |= dict(panel=problem.panel, ours=method.ours, oracle=method.oracle)
                figures, result = run(method, problem.path, timeout)
                row |= figures | ({} if result is None else evaluate(problem, method, result))
                out.write(json.dumps(row) + "\n")
                out.flush()
                rows.append(row)
                say(line(row))
    return rows


def line(row):
    """One row in words."""
    where = f"{row['seed'] or ''} {row['problem']:18s} {row['method']:30s}"
    if "solve_s" not in row:
        return f"{where} {row['error']}"
    scores = ("mean", "hand_max", "surf", "error", "energy", "pairs", "worst_mm")
    shown = [f"{k} {row[k]:.3g}" if isinstance(row[k], float | int) else row[k] for k in scores if k in row]
    return f"{where} {row['prepare_s']:.3f} + {row['solve_s']:.3f} s, {row['peak_mb']:.0f} MB: {', '.join(shown)}"


def write_csv(path, rows):
    names = list(dict.fromkeys(k for row in rows for k in row))
    with open(path, "w", newline="") as out:
        table = csv.DictWriter(out, names)
        table.writeheader()
        table.writerows(rows)


def machine():
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    here = dict(threads=THREADS, cores=os.cpu_count(), machine=platform.machine(), python=platform.python_version())
    return here | dict(packages=versions)


def main():
    parse = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parse.add_argument("out", type=Path, nargs="?", default=Path("tradeoff"))
    parse.add_argument("--quick", action="store_true", help="minutes: one seed, noise1, no slow peer")
    parse.add_argument("--seeds", default="")
    parse.add_argument("--problems", type=Path)
    parse.add_argument("--only", default="", help="problems whose name holds one of these words, separated by commas")
    parse.add_argument("--front", type=Path, default=FRONT, help="the pipeline's qualities, as bench.front wrote them")
    parse.add_argument("--timeout", type=float, default=400.0, help="of one method on one problem [s]")
    a = parse.parse_args()
    start = time.time()
    say = lambda text: print(f"{time.time() - start:6.0f} s  {text}", flush=True)
    seeds = tuple(int(s) for s in a.seeds.split(",")) if a.seeds else HELD_OUT[: 1 if a.quick else 3]
    a.out.mkdir(parents=True, exist_ok=True)
    plan = Plan(a.problems or a.out / "problems", a.quick, seeds)
    problems = [p for p in plan.write(say) if any(word in p.name for word in a.only.split(","))]
    there = [m for m in installed(say) if not (a.quick and m.slow)]
    rows = measure_all(problems, there, a.out / "rows.jsonl", seeds[0], a.timeout, say)
    write_csv(a.out / "rows.csv", rows)
    summary = dict(machine=machine(), seeds=seeds, panels=summarise(rows))
    (a.out / "summary.json").write_text(json.dumps(summary, indent=1))
    from .picture import draw

    draw(summary["panels"], a.out / "tradeoff.png")
    draw(panels(json.loads(a.front.read_text())), a.out / "pipeline.png")
    say(f"{a.out}/rows.csv, summary.json, tradeoff.png, pipeline.png")


if __name__ == "__main__":
    main()
