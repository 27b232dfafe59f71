"""A run of as many frames as wanted out of a short one: its frames again and again, by links, with evidence of their own."""

import json
import os
import shutil

import numpy as np
import zarr

from toile.io.run import open_run
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
    """The arrays of `opened`, their chunks of a frame again and again."""
    source, count, rows = opened.path / "registered.zarr", len(state), opened.rows().tolist()
    shutil.copytree(source, store, ignore=shutil.ignore_patterns("diagnostics"))
    for path in store.rglob("zarr.json"):
        facts = json.loads(path.read_text())
        if facts["node_type"] == "group" or path.parent.name in ("frames", "done", "verdict"):
            continue
        if facts["shape"][0] != len(opened.frames) or facts["chunk_grid"]["configuration"]["chunk_shape"][0] != 1:
            continue
        path.write_text(json.dumps(facts | {"shape": [count, *facts["shape"][1:]]}))
        for row in range(len(opened.frames), count):
            chunk = path.parent / "c" / str(rows[row % len(rows)])
            shutil.copytree(chunk, chunk.with_name(str(row)), copy_function=os.link)
    group = zarr.open_group(str(store), mode="r+")
    for key, values in {
        "frames": np.arange(count),
        "done": np.where(state == 3, 2, 1),
        "verdict": np.minimum(state, 2),
    }.items():
        kind = group[key].dtype
        del group[key]
        group.create_array(key, data=values.astype(kind), chunks=(count,))
