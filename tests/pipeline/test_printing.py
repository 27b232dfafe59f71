"""`prints = true`: garments slide within `register` itself, along their surfaces alone, with the same bits whoever does it."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import zarr

from toile.config import preset
from toile.config.changes import changed
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


def printed(capture, numbers, bare=()):
    """The bundled capture's four frames under other numbers, its garment printed; `bare` frames have no pictures."""
    shutil.copytree(SAMPLE, capture, ignore=shutil.ignore_patterns("truth", "frames"))
    for i, number in enumerate(numbers):
        skip = shutil.ignore_patterns("images") if number in bare else None
        shutil.copytree(SAMPLE / "frames" / f"{i:06d}", capture / "frames" / f"{number:06d}", ignore=skip)
    scene = (capture / "scene.toml").read_text()
    (capture / "scene.toml").write_text(scene.replace('\nlabel = "tshirt"', '\nlabel = "tshirt"\nprints = true'))
    return capture


@pytest.fixture(scope="module")
def printed_run(tmp_path_factory):
    """The frames of `sample_run`, registered with prints."""
    root = tmp_path_factory.mktemp("prints")
    assert register(printed(root / "capture", range(4)), root / "run", CONFIG).ok == (0, 1, 2, 3)
    return root / "run"


@pytest.fixture(scope="module")
def two_blocks(tmp_path_factory):
    """A capture whose frames lie in two blocks, 49 without pictures, and its run."""
    root = tmp_path_factory.mktemp("prints")
    assert register(printed(root / "capture", FRAMES, bare=(49,)), root / "run", CONFIG).ok == FRAMES
    return root / "capture", root / "run"


def arrays(run):
    """All of the store but the seconds."""
    members = zarr.open_group(str(run / "registered.zarr"), mode="r").members(max_depth=None)
    return {n: item[...] for n, item in members if isinstance(item, zarr.Array) and "seconds" not in n}


def assert_same_bits(once, twice):
    assert once.keys() == twice.keys()
    for name in once:
        assert np.array_equal(once[name], twice[name], equal_nan=once[name].dtype.kind == "f"), name


def test_prints_move_garments_along_their_surfaces_and_nothing_else(sample_run, printed_run):
    before, after = arrays(sample_run), arrays(printed_run)
    for name in ("track/vertices", "pose/rotations", "labels"):
        assert np.array_equal(before[name], after[name])
    faces = open_run(sample_run).garments["tshirt"].faces
    for V, W in zip(*(a["garment/tshirt/vertices"] for a in (before, after))):
        step, off = np.linalg.norm(V - W, axis=1), SurfaceIndex(V, faces).closest(W)[3]
        assert step.mean() > 5e-4 and step.max() < 0.08
        assert np.median(off) < 2e-4 and off.mean() < 0.2 * step.mean()


def test_only_a_scene_that_asks_for_prints_pays_for_them(sample_run, printed_run):
    for run, frames in ((sample_run, []), (printed_run, [0, 1, 2, 3])):
        made = [line["frame"] for line in Status.of(run).lines() if line["stage"] == "prints"]
        assert sorted(made) == frames
        assert (run / "prepared" / "print.tshirt.npz").exists() == bool(frames)
        steps = {step.stage: step for step in plan(open_run(run).capture)}
        assert steps["prints"].runs == bool(frames)


@pytest.mark.slow(seconds=60)
def test_two_workers_slide_to_the_same_bits(two_blocks, tmp_path):
    capture, run = two_blocks
    register(capture, tmp_path / "run", CONFIG, workers=2)
    assert_same_bits(arrays(run), arrays(tmp_path / "run"))


@pytest.mark.slow(seconds=60)
def test_a_run_stopped_while_garments_slide_goes_on_with_the_same_bits(two_blocks, tmp_path):
    capture, run = two_blocks

    def stop(stage, done, total):
        if stage == "prints" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        register(capture, tmp_path / "run", CONFIG, progress=stop)
    register(capture, tmp_path / "run", CONFIG)
    assert_same_bits(arrays(run), arrays(tmp_path / "run"))


@pytest.mark.slow(seconds=30)
def test_a_frame_without_pictures_slides_as_its_neighbours(two_blocks):
    slides = [open_run(two_blocks[1]).diagnostics.at(number)["dress tshirt"]["slide_mm"] for number in FRAMES]
    assert min(slides) > 0.5 and abs(slides[1] - slides[0]) < 0.5 * slides[0]
