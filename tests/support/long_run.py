"""A run of as many frames as wanted out of a short one: its frames again and again, by links, with evidence of their own."""

import json
import math
import os
import shutil

import numpy as np
import zarr

from toile.io.run import file_of, open_run
from toile.io.run_folder import write_diagnostics
from toile.io.status import Status


def long_run(short, folder, count, seed=0):
    """Writes RUN of `count` frames and returns it; one in 40 is doubtful, one in 100 wrong, one in 500 failed, of each at least one."""
    opened, run, draw = open_run(short), folder / "run", np.random.default_rng(seed)
    capture = _capture(opened, folder / "capture", count)
    run.mkdir()
    (run / "config.toml").write_text(
        (opened.path / "config.toml")
        .read_text()
        .replace(json.dumps(str(opened.capture.root)), json.dumps(str(capture)))
    )
    state, order = np.zeros(count, int), draw.permutation(count)
    for level, share, first in ((1, 40, 2), (2, 100, 1), (3, 500, 0)):
        state[order[first::3][: -(-count // share)]] = level
    _store(opened, run / "registered.zarr", state)
    status, seconds = Status.of(run), []
    told = [opened.diagnostics.at(number) for number in opened.ok]
    for frame in range(count):
        stages = json.loads(json.dumps(told[frame % len(told)]))
        for name in stages.get("evidence", {}):
            stages["evidence"][name] *= float(np.exp(draw.normal(0, 0.1)))
        stages["reasons"] = [[], ["an opening lies 28 mm from the one that was seen (at most 20 is good)"],
                             ["scan and surface lie 45 mm apart, from whichever side (at most 12 is good)"], []][state[frame]]  # fmt: skip
        write_diagnostics(run, frame, {"reason": "frames/x/scan.ply: truncated"} if state[frame] == 3 else stages)
        lines = [
            {"frame": frame, "stage": stage, "seconds": float(draw.gamma(9, 0.1)), "ok": True}
            for stage in ("track", "segment", "dress", "inner")
        ]
        seconds += [json.dumps(line) for line in lines]
    status.path.write_text("\n".join(seconds) + "\n")
    return run


def _capture(opened, capture, count):
    """The capture without its truth, its frames by links."""
    source = opened.capture.root.resolve()
    capture.mkdir()
    for path in source.iterdir():
        if path.name not in ("frames", "truth"):
            (shutil.copytree if path.is_dir() else shutil.copy)(path, capture / path.name)
    (capture / "frames").mkdir()
    for frame in range(count):
        number = opened.ok[frame % len(opened.ok)]
        os.symlink(source / "frames" / f"{number:06d}", capture / "frames" / f"{frame:06d}")
    return capture


def _store(opened, store, state):
    """The arrays of `opened`, their frames again and again, the same files by links."""
    count, rows = len(state), opened.rows().tolist()
    shutil.copytree(opened.path / "registered.zarr", store, ignore=shutil.ignore_patterns("diagnostics"))
    group = zarr.open_group(str(store), mode="r+")
    for key, array in list(opened.group.members(max_depth=None)):
        if getattr(array, "shards", None) is None or key in ("done", "verdict"):
            continue
        files = math.lcm(array.shards[0], len(rows)) // array.shards[0]  # after which they come again
        first = np.arange(min(files * array.shards[0], count)) % len(rows)
        shape, kept = (count, *array.shape[1:]), {"chunks": array.chunks, "shards": array.shards, "dtype": array.dtype}
        made = group.create_array(
            key, shape=shape, fill_value=array.fill_value, compressors=array.compressors, overwrite=True, **kept
        )
        made[: len(first)] = array[...][np.array(rows)[first]]
        for row in range(files * array.shards[0], count, array.shards[0]):
            path = file_of(store, key, made, row)
            path.parent.mkdir(parents=True, exist_ok=True)
            os.link(file_of(store, key, made, row % (files * array.shards[0])), path)
    for key, values in {
        "frames": np.arange(count),
        "done": np.where(state == 3, 2, 1),
        "verdict": np.minimum(state, 2),
    }.items():
        kind = group[key].dtype
        del group[key]
        group.create_array(key, data=values.astype(kind), chunks=(count,))
