"""A registration killed with SIGKILL at random instants, again and again: `python -m tests.faults.random_kills --workers 2`.

A life is one `toile register` of the same command. It is killed at an age that is drawn uniformly from the time that an
undisturbed run takes, or ends before. The next life goes on where it was; of a run that has ended the bits are compared,
and the next life begins anew. Every second kill takes the whole process group, as where the power fails; the others take the
first process alone, whose workers then still write for a moment while the next life begins."""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import psutil
import zarr

from toile.io.run_writer import RunWriter

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
NUMBERS = (47, 48, 49, 50, 51, 52)  # two blocks, in each of them frames with temporal state
PASSES = ("start", "preparation", "first pass", "smoothing and fusing", "last pass", "end")
LONGEST = 600.0  # s that a life may take


def capture_in(folder: Path) -> Path:
    """Frames of the bundled capture, a garment and all, under NUMBERS."""
    capture = folder / "capture"
    shutil.copytree(SAMPLE, capture, ignore=shutil.ignore_patterns("truth", "frames"))
    for i, number in enumerate(NUMBERS):
        shutil.copytree(SAMPLE / "frames" / f"{i:06d}", capture / "frames" / f"{number:06d}")
    return capture


def command(capture: Path, run: Path, workers: int) -> list[str]:
    settings = ["--quality", "draft", "--set", "preparation_frames=1", "--workers", str(workers)]
    return [sys.executable, "-m", "toile", "register", str(capture), str(run), *settings]


def live(capture: Path, run: Path, workers: int, age: float | None = None, group: bool = False) -> tuple[bool, int]:
    """One life: was it killed, and its process group. AssertionError: it ended of itself otherwise than well."""
    log = run.with_name("said.txt")
    with open(log, "w") as said:
        child = subprocess.Popen(command(capture, run, workers), stdout=said, stderr=said, start_new_session=True)
    try:
        status = child.wait(LONGEST if age is None else age)
    except subprocess.TimeoutExpired:
        assert age is not None, f"a life did not end:\n{log.read_text()}"
        (os.killpg if group else os.kill)(child.pid, signal.SIGKILL)
        status = child.wait()
    assert status in (0, -signal.SIGKILL) and "Traceback" not in log.read_text(), log.read_text()
    return status != 0, child.pid


def reached(run: Path) -> str:
    """Which of PASSES a killed run was in, by its files."""
    whole = len(list(run.glob("work/frames/*/whole")))
    if not (run / "config.toml").exists():
        return "start"
    if not list(run.glob("prepared/template.*.npz")):
        return "preparation"
    if whole < len(NUMBERS):
        return "first pass"
    if not (run / "registered.zarr").exists():
        return "smoothing and fusing"
    return "end" if RunWriter.of(run).whole else "last pass"


def differing(once: Path, twice: Path) -> list[str]:
    """The arrays of two runs that differ in a bit; how many seconds a stage took is not compared."""
    first, second = (_arrays(run) for run in (once, twice))
    named = sorted(first.keys() | second.keys())
    return [name for name in named if not _same(first.get(name), second.get(name))]


def _arrays(run):
    group = zarr.open_group(str(run / "registered.zarr"), mode="r")
    items = {name: item for name, item in group.members(max_depth=None) if isinstance(item, zarr.Array)}
    return {name: item[...] for name, item in items.items() if not name.startswith("diagnostics/seconds/")}


def _same(a, b):
    return a is not None and b is not None and a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def left_behind(groups: list[int], patience: float = 120.0) -> list[int]:
    """Processes of these groups that have not ended after `patience` seconds."""
    deadline = time.monotonic() + patience
    while (found := [pid for pid in psutil.pids() if _group(pid) in groups]) and time.monotonic() < deadline:
        time.sleep(0.1)
    return found


def _group(pid):
    try:
        return None if psutil.Process(pid).status() == psutil.STATUS_ZOMBIE else os.getpgid(pid)
    except (psutil.NoSuchProcess, ProcessLookupError):
        return None


def kill_at_random(folder: Path, kills: int, workers: int, seed: int = 0, tell=lambda line: None) -> dict:
    """Kills so often and lets the last run end; returns the counts. AssertionError: a life ended badly, or bits differ."""
    draw, capture, calm, run = random.Random(seed), capture_in(folder), folder / "calm", folder / "run"
    began = time.monotonic()
    live(capture, calm, workers)
    span, count, ended, groups, where = time.monotonic() - began, 0, 0, [], Counter()
    while count < kills or run.exists():
        age = draw.uniform(0, span) if count < kills else None
        killed, group = live(capture, run, workers, age, group=count % 2 == 0)
        groups.append(group)
        if killed:
            count += 1
            where[reached(run)] += 1
            tell(f"kill {count}: after {age:.1f} s, {reached(run)}")
            continue
        ended += 1
        differ = differing(calm, run)
        assert not differ, f"{run}: other bits after kill {count}: {differ}"
        assert not list((run / "work").glob("*.zarr"))
        shutil.rmtree(run)
    assert set(_arrays(calm)["done"].tolist()) == {1}
    assert not left_behind(groups)
    return {"kills": count, "lives": len(groups), "ended": ended, "seconds": span, "in": {n: where[n] for n in PASSES}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(kill_at_random(Path(folder), **vars(options), tell=lambda line: print(line, flush=True))))


if __name__ == "__main__":
    main()
