"""Pictures, masks and labels may exist for some cameras and some frames only."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zarr

from toile.config import changed, preset
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.pipeline.run import register
from toile.pipeline.samples import points_of

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


@pytest.fixture
def capture(tmp_path):
    """The first two frames of the bundled capture."""
    skipped = shutil.ignore_patterns("truth", "00000[2-5]")
    return Path(shutil.copytree(SAMPLE, tmp_path / "capture", ignore=skipped))


def test_a_frame_has_what_its_folders_have(capture):
    first = capture / "frames" / "000000"
    (first / "labels" / "cam03.png").unlink()
    (first / "images" / "cam05.jpg").unlink()
    shutil.rmtree(first / "masks")
    opened = open_capture(capture)
    frame, whole = opened.pictures(0), opened.pictures(1)
    names = set(opened.cameras)
    assert set(frame.labels) == names - {"cam03"} and set(frame.images) == names - {"cam05"} and not frame.masks
    assert set(whole.labels) == set(whole.images) == set(whole.masks) == names
    assert set(opened.pictured(0)) == names - {"cam05"} and opened.pictured(1) == tuple(opened.cameras)


def test_two_files_for_one_camera_are_refused(capture):
    folder = capture / "frames" / "000000" / "images"
    shutil.copyfile(folder / "cam05.jpg", folder / "cam05.png")
    with pytest.raises(UserError, match="cam05.png: cam05.jpg is there too"):
        open_capture(capture).pictures(0)


def test_registering_without_some_labels_finds_the_same_garment(capture, sample_run, tmp_path):
    for number, gone in (("000000", "labels/cam03.png"), ("000001", "images/cam05.jpg"), ("000001", "masks/cam01.png")):
        (capture / "frames" / number / gone).unlink()
    shutil.rmtree(capture / "frames" / "000001" / "labels")
    assert register(capture, tmp_path / "run", preset("draft"), (0, 1)).ok == (0, 1)
    with_all, without = (zarr.open_group(str(p / "registered.zarr"), mode="r") for p in (sample_run, tmp_path / "run"))
    for row, bound in ((0, 0.008), (1, 0.015)):  # [m]; the second has no labels but those of its neighbour
        moved = with_all["garment/tshirt/vertices"][row] - without["garment/tshirt/vertices"][row]
        assert np.median(np.linalg.norm(moved, axis=1)) < bound


def test_keypoints_of_one_camera_are_no_points_in_space(capture):
    """Not points of which none is known: the first pose is searched by the scan then."""
    opened = open_capture(capture)
    frame = opened.frame(0)
    assert np.isfinite(points_of(opened, preset("draft"), frame).points).any()
    alone = replace(frame, keypoints=replace(frame.keypoints, points={"cam00": frame.keypoints.points["cam00"]}))
    assert points_of(opened, preset("draft"), alone) is None


def test_a_frame_with_neither_scan_nor_keypoints_fails_alone(capture, tmp_path):
    """It is among the frames that the preparation samples, too."""
    for name in ("scan.ply", "keypoints.json"):
        (capture / "frames" / "000001" / name).unlink()
    outcome = register(capture, tmp_path / "run", changed(preset("draft"), {"make_scans": False}), (0, 1))
    assert outcome.ok == (0,) and set(outcome.failed) == {1}
