"""Scans that a run makes on its way: what `toile reconstruct` writes, once, and only where it is wanted."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.pipeline import test_reconstruct
from tests.pipeline.test_run import arrays, assert_same_bits
from toile.config import changed, preset
from toile.config.stereo import scan_preset
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.run import open_run
from toile.io.status import Status
from toile.pipeline.identity import Identities
from toile.pipeline.plan import plan
from toile.pipeline.reconstruct import MADE, reconstruct
from toile.pipeline.run import register
from toile.pipeline.scanning import kept_in, lacks_scan, load_libraries, make_scan, make_scans

capture = test_reconstruct.capture  # of a ball: frame 0 with masks and keypoints, frame 1 without masks
DRAFT = preset("draft")
OF = Identities(Path("/nowhere"), {"scan": "these settings"})
SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


class Other(Identities):
    def inputs(self, frame):
        return "another"


@pytest.fixture(scope="module")
def run(capture, tmp_path_factory):
    """A run's folder in which the scan of frame 0 was made."""
    folder = tmp_path_factory.mktemp("run")
    make_scan(kept_in(folder, open_capture(capture)), 0, DRAFT, Status.of(folder), OF)
    return folder


def test_what_is_made_on_the_way_is_what_reconstruct_writes(capture, run, tmp_path):
    reconstruct(open_capture(capture), tmp_path / "scans", scan_preset("draft"), [0])
    for name in MADE:
        written = (tmp_path / "scans" / "frames" / "000000" / name).read_bytes()
        assert (run / "scans" / "000000" / name).read_bytes() == written
    there, here = open_capture(tmp_path / "scans").frame(0), kept_in(run, open_capture(capture)).frame(0)
    assert np.array_equal(here.scan.vertices, there.scan.vertices) and here.scan.confidence is not None
    assert np.array_equal(here.points3d.points, there.points3d.points, equal_nan=True)
    assert open_capture(capture).frame(0).scan is None


def test_it_is_made_once_and_again_of_something_else(capture, tmp_path, monkeypatch):
    opened, status, calls = kept_in(tmp_path, open_capture(capture)), Status.of(tmp_path), []
    made = type("Made", (), {"depth": 1.0, "said": "all", "write": lambda self, folder: calls.append(folder)})()
    monkeypatch.setattr("toile.pipeline.scanning.made_of", lambda *_: made)
    for _ in range(2):
        make_scan(opened, 0, DRAFT, status, OF)
    assert len(calls) == 1 and [line["said"] for line in status.lines()] == ["all"]
    make_scan(opened, 0, DRAFT, status, Other(OF.run, OF.stages))
    assert len(calls) == 2


def test_frames_that_bring_a_scan_or_points_in_space_and_those_without_masks_are_left(capture, tmp_path):
    copy = Path(shutil.copytree(capture, tmp_path / "capture"))
    assert lacks_scan(open_capture(copy), 0) and not lacks_scan(open_capture(copy), 1)
    (copy / "frames" / "000000" / "keypoints3d.json").write_text("{}")
    assert not lacks_scan(open_capture(copy), 0)
    make_scan(kept_in(tmp_path, open_capture(copy)), 0, DRAFT, Status.of(tmp_path), OF)
    assert not (tmp_path / "scans").exists()


def test_a_switch_leaves_it_out_and_the_plan_says_what_comes(capture, tmp_path):
    make_scan(
        kept_in(tmp_path, open_capture(capture)), 0, changed(DRAFT, {"make_scans": False}), Status.of(tmp_path), OF
    )
    assert not (tmp_path / "scans").exists()
    step = next(step for step in plan(open_capture(capture)) if step.stage == "stereo")
    assert step.runs and "no scan.ply" in step.why
    given = next(step for step in plan(open_capture(SAMPLE)) if step.stage == "stereo")
    assert not given.runs and given.why == "scan.ply is given"


def test_pictures_that_show_too_little_leave_a_frame_to_its_keypoints_or_fail_it(capture, tmp_path):
    opened, status = kept_in(tmp_path, open_capture(capture)), Status.of(tmp_path)
    wanting = changed(DRAFT, {"least_depth": 1.0})
    make_scan(opened, 0, wanting, status, OF)
    assert opened.frame(0).scan is None and "registered without a scan" in status.warnings()[0]
    copy = Path(shutil.copytree(capture, tmp_path / "capture"))
    (copy / "frames" / "000000" / "keypoints.json").unlink()
    opened = kept_in(tmp_path / "other", open_capture(copy))
    with pytest.raises(UserError, match="too little to make a scan of: .*have a depth"):
        make_scan(opened, 0, wanting, status, OF)
    assert "too little" in make_scans(opened, [0], wanting, status, OF)[0]
    assert not (tmp_path / "other" / "scans").exists()


def test_the_surface_library_is_loaded_where_a_scan_will_be_made_and_else_not(capture, tmp_path, monkeypatch):
    """By the main thread: a process where another loads it first aborts at its end."""
    loaded, opened = [], kept_in(tmp_path, open_capture(capture))
    monkeypatch.setattr("toile.pipeline.scanning.load_poisson", lambda: loaded.append(True))
    load_libraries(opened, [1], DRAFT)
    load_libraries(opened, [0], changed(DRAFT, {"make_scans": False}))
    assert not loaded
    load_libraries(opened, [0, 1], DRAFT)
    assert loaded


def test_where_no_sampled_frame_gives_a_scan_no_other_is_tried(capture, tmp_path, monkeypatch):
    copy = Path(shutil.copytree(capture, tmp_path / "capture"))
    shutil.copytree(copy / "frames" / "000000", copy / "frames" / "000002")
    opened, status, tried = kept_in(tmp_path, open_capture(copy)), Status.of(tmp_path), []

    def nothing(capture, number, settings):
        tried.append(number)
        raise UserError("no surface is found")

    monkeypatch.setattr("toile.pipeline.scanning.made_of", nothing)
    assert make_scans(opened, [0, 1], DRAFT, status, OF) == {}
    make_scan(opened, 2, DRAFT, status, OF)
    assert tried == [0] and "none is made" in status.warnings()[-1]


@pytest.mark.slow(seconds=60)
def test_registering_pictures_gives_the_bits_of_reconstructing_first(tmp_path):
    skipped = shutil.ignore_patterns("truth", "00000[2-5]", "scan.ply")
    bare = Path(shutil.copytree(SAMPLE, tmp_path / "capture", ignore=skipped))
    reconstruct(open_capture(bare), tmp_path / "scans", scan_preset("draft"), [0, 1])
    assert register(tmp_path / "scans", tmp_path / "after", DRAFT).ok == (0, 1)
    assert register(bare, tmp_path / "run", DRAFT, workers=2).ok == (0, 1)
    after, made = arrays(tmp_path / "after"), arrays(tmp_path / "run")
    assert not np.array_equal(after.pop("identity"), made.pop("identity"))
    assert made.pop("diagnostics/seconds/stereo").all()
    assert_same_bits(after, made)
    assert open_run(tmp_path / "run").capture.frame(1).scan is not None
    lines = [json.loads(line) for line in (tmp_path / "run" / "status.jsonl").read_text().splitlines()]
    assert sorted(line["frame"] for line in lines if line["stage"] == "stereo") == [0, 1]


@pytest.mark.parametrize("free", [None, 10])
def test_where_memory_is_lacking_a_frame_fails_and_is_never_made_without_its_scan(capture, tmp_path, monkeypatch, free):
    monkeypatch.setattr("toile.pipeline.reconstruct.free_memory", lambda: free)
    opened, status = kept_in(tmp_path, open_capture(capture)), Status.of(tmp_path)
    if free is None:  # nothing tells
        make_scan(opened, 0, DRAFT, status, OF)
        assert (tmp_path / "scans" / "000000" / "scan.ply").exists()
        return
    with pytest.raises(
        UserError,
        match=r"stereo.reduction = 2: depth maps of \d+ pictures take .* GiB, 0.0 are free: twice the reduction",
    ):
        make_scan(opened, 0, DRAFT, status, OF)
    assert not (tmp_path / "scans" / "000000").exists()
