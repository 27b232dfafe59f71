"""`prints = true`: garments slide within `register` itself, along their surfaces alone, with the same bits whoever does it."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import zarr

from toile.config import preset
from toile.config.changes import changed
from toile.io.capture import open_capture
from toile.io.run import open_run
from toile.io.status import Status
from toile.kernels import SurfaceIndex
from toile.pipeline.plan import plan
from toile.pipeline.run import register

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
FRAMES = (48, 49, 50, 51)  # two blocks; 49 has no pictures
QUICK = {
    "lattice_spacing": 0.012,
    "blurs": (0.024, 0.012),
    "blur_steps": (2, 1),
    "follow_share": 0.5,
    "length_steps": 2,
    "anchor_frames": 2,
    "sample_frames": 1,
    "mean_rounds": 1,
}
CONFIG = changed(preset("draft"), {"prints": QUICK})


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """{prints: a capture}: the bundled one's frames renumbered."""
    made = {}
    for printed in (False, True):
        made[printed] = capture = tmp_path_factory.mktemp("prints") / "capture"
        shutil.copytree(SAMPLE, capture, ignore=shutil.ignore_patterns("truth", "frames"))
        for i, number in enumerate(FRAMES):
            skip = shutil.ignore_patterns("images") if i == 1 else None
            shutil.copytree(SAMPLE / "frames" / f"{i:06d}", capture / "frames" / f"{number:06d}", ignore=skip)
        if printed:
            scene = (capture / "scene.toml").read_text()
            (capture / "scene.toml").write_text(
                scene.replace('\nlabel = "tshirt"', '\nlabel = "tshirt"\nprints = true')
            )
    return made


@pytest.fixture(scope="module")
def runs(captures):
    """{prints: a run}."""
    made = {printed: capture.parent / "run" for printed, capture in captures.items()}
    for printed, run in made.items():
        assert register(captures[printed], run, CONFIG).ok == FRAMES
    return made


def arrays(run):
    """All of the store but the seconds."""
    members = zarr.open_group(str(run / "registered.zarr"), mode="r").members(max_depth=None)
    return {n: item[...] for n, item in members if isinstance(item, zarr.Array) and "seconds" not in n}


def assert_same_bits(once, twice):
    assert once.keys() == twice.keys()
    for name in once:
        assert np.array_equal(once[name], twice[name], equal_nan=once[name].dtype.kind == "f"), name


def test_prints_move_garments_along_their_surfaces_and_nothing_else(runs):
    before, after = arrays(runs[False]), arrays(runs[True])
    for name in ("track/vertices", "pose/rotations", "labels"):
        assert np.array_equal(before[name], after[name])
    run = open_run(runs[False])
    for k in range(len(FRAMES)):  # 49 slides as its neighbours
        V, W = (a["garment/tshirt/vertices"][k] for a in (before, after))
        step, off = np.linalg.norm(V - W, axis=1), SurfaceIndex(V, run.garments["tshirt"].faces).closest(W)[3]
        assert step.mean() > 5e-4 and step.max() < 0.08
        assert np.median(off) < 2e-4 and off.mean() < 0.2 * step.mean()


def test_only_a_scene_that_asks_for_prints_pays_for_them(captures, runs):
    for printed, run in runs.items():
        made = [line["frame"] for line in Status.of(run).lines() if line["stage"] == "prints"]
        assert sorted(made) == (list(FRAMES) if printed else [])
        assert (run / "prepared" / "print.tshirt.npz").exists() == printed
        steps = {step.stage: step for step in plan(open_capture(captures[printed]))}
        assert steps["prints"].runs == printed


def test_two_workers_slide_to_the_same_bits(captures, runs, tmp_path):
    register(captures[True], tmp_path / "run", CONFIG, workers=2)
    assert_same_bits(arrays(runs[True]), arrays(tmp_path / "run"))


def test_a_run_stopped_while_garments_slide_goes_on_with_the_same_bits(captures, runs, tmp_path):
    def stop(stage, done, total):
        if stage == "prints" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        register(captures[True], tmp_path / "run", CONFIG, progress=stop)
    register(captures[True], tmp_path / "run", CONFIG)
    assert_same_bits(arrays(runs[True]), arrays(tmp_path / "run"))
