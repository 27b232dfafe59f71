"""The last passes, made again of what the first pass left, are those of the run."""

import json

import numpy as np
import zarr

from bench.last_passes import Watched, last_passes
from toile.io.run_folder import read_config


def test_they_give_the_runs_own_bits_over_its_own_frames(sample_run, tmp_path):
    frames = read_config(sample_run)["frames"]
    assert last_passes(sample_run, tmp_path, frames) > 0
    ours, theirs = (
        zarr.open(tmp_path / "registered.zarr", mode="r"),
        zarr.open(sample_run / "registered.zarr", mode="r"),
    )
    arrays = [name for name, item in theirs.members(max_depth=None) if hasattr(item, "shape")]
    names = [name for name in arrays if name != "identity" and not name.startswith("diagnostics/seconds")]
    assert len(names) > 5
    for name in names:
        assert np.array_equal(ours[name][:], theirs[name][:], equal_nan=True), name


def test_more_frames_than_the_run_has_come_again_and_every_pass_is_told(sample_run, tmp_path, capsys):
    frames = read_config(sample_run)["frames"]
    watched = Watched()
    last_passes(sample_run, tmp_path, [frames[0], *frames, *frames], watched)
    watched.told()
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {"flicker", "smooth"} <= {line["pass"] for line in told} and all(line["MB"] >= 0 for line in told)
