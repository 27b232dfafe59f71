"""The last passes alone, over any number of frames: `python -m bench.last_passes RUN --frames 2000`.

The frames of a finished run, as its first pass has left them in RUN/work, come again and again by links, under as many
numbers; smoothing, the body under the garments, the inner layer and the store are made of them anew, in a temporary folder.
A line is printed for every tenth of a pass: the most resident memory [MB] of this process from then on, and its processor
seconds until the next line. At the end: what the passes take for all frames together, and what a frame adds."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import tempfile
import time
from pathlib import Path

from toile import kernels
from toile.config import preset
from toile.io.bounded import read_json
from toile.io.capture import open_capture
from toile.io.run_folder import capture_folder, read_config
from toile.io.status import Status
from toile.pipeline.blocks import FrameFolders
from toile.pipeline.identity import Identities
from toile.pipeline.manifest import config_of
from toile.pipeline.outcome import RunStores
from toile.pipeline.preparation import prepare
from toile.pipeline.run import last_stages
from toile.pipeline.tuning.trial import growing
from toile.pipeline.workers import Workers

MADE_LAST = shutil.ignore_patterns("inner.npz", "strengths.npz")  # of what is prepared


def last_passes(run, folder, sources, progress=lambda *_: None):
    """Makes the last passes of frames 0, 1, ... in a folder, each of the run's frame of `sources`; processor seconds."""
    asked = read_config(run)["settings"]["quality"]  # where an older version had other settings
    capture, config = open_capture(capture_folder(run)), config_of(run) or preset(asked)
    shutil.copytree(run / "prepared", folder / "prepared", ignore=MADE_LAST)
    (folder / "work" / "frames").mkdir(parents=True)
    for number, source in enumerate(sources):
        os.symlink(run / "work" / "frames" / f"{source:06d}", folder / "work" / "frames" / f"{number:06d}")
    identities = Identities(folder, read_json(run / "inputs" / "scene.json", dict)["stages"])
    stored = RunStores(folder, tuple(range(len(sources))), identities)
    results = FrameFolders(folder / "work" / "frames", Status.of(folder), "frame")
    with Workers(1, prepare, capture, folder, config, identities) as pool:
        prepared, start = pool.prepared(), time.process_time()
        last_stages(stored, results, progress, True, None, prepared, pool)
    return time.process_time() - start


class Watched:
    """Progress that prints what each tenth of a pass has taken."""

    def __init__(self):
        self.at, self.most, self.since = ("start", 0), 0.0, time.process_time()

    def __call__(self, stage, done, total):
        self.most = max(self.most, resident())
        now = stage, done * 10 // total * total // 10
        if now != self.at:
            self.told()
            self.at, self.most, self.since = now, resident(), time.process_time()

    def told(self):
        seconds = round(time.process_time() - self.since, 2)
        print(
            json.dumps({"pass": self.at[0], "frames": self.at[1], "MB": round(self.most, 1), "cpu_s": seconds}),
            flush=True,
        )


def resident():
    """MB that this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    kernels.set_threads(options.threads)
    run, watched = options.run.resolve(), Watched()
    frames = read_config(run)["frames"]
    with tempfile.TemporaryDirectory() as folder:
        sources = [frames[i % len(frames)] for i in range(options.frames)]
        seconds = last_passes(run, Path(folder), sources, watched)
        watched.told()
        each = growing(Status.of(folder).lines(), options.frames).cpu
    once = seconds - each * options.frames
    print(json.dumps({"cpu_s": seconds, "cpu_s_for_all_frames_once": once, "cpu_s_a_frame": each}))


if __name__ == "__main__":
    main()
