"""Memory of a long registration: `python -m bench.memory CAPTURE --frames 2000`.

The frames of a short capture come again and again, by links, under as many numbers; one `toile register` makes them all, and
its resident memory (VmRSS, that of its worker processes added) is looked at twice a second. A line is printed for every
tenth of a pass: the most MB from then on, while fewer frames were behind than at the next line."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil


def linked(short: Path, folder: Path, count: int) -> Path:
    """A capture of `count` frames, the frames of a short one by links, and none of its truth."""
    short, long = short.resolve(), folder / "capture"
    shutil.copytree(short, long, ignore=shutil.ignore_patterns("truth", "frames"))
    frames = sorted((short / "frames").iterdir())
    (long / "frames").mkdir()
    for i in range(count):
        os.symlink(frames[i % len(frames)], long / "frames" / f"{i:06d}")
    return long


def resident(process: psutil.Process) -> float:
    """MB of a process and those that it started."""
    total = 0
    for one in (process, *process.children(recursive=True)):
        try:
            total += one.memory_info().rss
        except psutil.NoSuchProcess:
            continue
    return total / 2**20


def watched(command: list[str]) -> list[dict]:
    """[{pass, frames, MB}] of a `toile --verbose register`, a line a tenth of a pass."""
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    now, peaks = ("start", 0), {}

    def look() -> None:
        process = psutil.Process(child.pid)
        while child.poll() is None:
            try:
                peaks[now] = max(peaks.get(now, 0.0), resident(process))
            except psutil.NoSuchProcess:
                return
            time.sleep(0.5)

    looker = threading.Thread(target=look)
    looker.start()
    said = ""
    for line in child.stderr:
        name, _, rest = line.partition(": ")
        words, said = rest.split(), line
        if len(words) >= 3 and words[1] == "of" and words[0].isdecimal():
            done, total = int(words[0]), int(words[2].rstrip(","))
            now = name, done * 10 // total * total // 10
    looker.join()
    if child.wait():
        sys.exit(f"the run ended with {child.returncode}: {said}")
    return [{"pass": name, "frames": frames, "MB": round(most)} for (name, frames), most in peaks.items()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--quality", default="draft")
    parser.add_argument("--set", action="append", default=[], help="a setting of toile, NAME=VALUE")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        capture = linked(options.capture, Path(folder), options.frames)
        asked = ["--quality", options.quality, "--workers", str(options.workers)]
        asked += [word for change in options.set for word in ("--set", change)]
        run = [sys.executable, "-m", "toile", "register", "--verbose", str(capture), str(Path(folder) / "run"), *asked]
        for line in watched(run):
            print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
