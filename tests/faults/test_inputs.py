"""Changed inputs are noticed and named; a poisoned frame is that frame's failure, and no other's."""

import errno
import json
import os
import shutil
from pathlib import Path

import pytest

from toile.config import preset
from toile.pipeline import run as pipeline
from toile.stages import track

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
CONFIG = preset("draft").model_copy(update={"preparation_frames": 1})
FRAMES = (0, 1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """(capture, run) of two frames of the bundled capture without its garment; the path holds `frames` and `truth`."""
    folder = tmp_path_factory.mktemp("inputs") / "frames" / "truth"
    shutil.copytree(SAMPLE, folder / "capture", ignore=shutil.ignore_patterns("truth", "00000[2-5]"))
    text = (SAMPLE / "scene.toml").read_text()
    start, end = text.index("[[garment]]"), text.index("[cameras]")
    (folder / "capture" / "scene.toml").write_text(text[:start] + text[end:])
    assert pipeline.register(folder / "capture", folder / "run", CONFIG, FRAMES).ok == FRAMES
    return folder / "capture", folder / "run"


@pytest.fixture
def copied(whole):
    """The capture and the run at the places that the run knows; the capture is put back afterwards."""
    capture, run = whole
    kept = capture.with_name("kept")
    shutil.copytree(capture, kept)
    yield capture, run
    shutil.rmtree(capture)
    kept.rename(capture)


def again(capture, run, **options):
    return pipeline.register(capture, run, CONFIG, FRAMES, **options)


def flip(path, at=-1):
    """Another byte; the size stays."""
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(bytes(data))


def noted(run, name):
    return json.loads((run / "inputs" / f"{name}.json").read_text())


def test_what_is_read_is_noted_wherever_the_capture_lies(whole):
    capture, run = whole
    assert set(noted(run, "scene")["facts"]["cameras"]) == {f"cam{i:02d}" for i in range(8)}
    files = noted(run, "000001")["files"]
    assert "frames/000001/scan.ply" in files and "frames/000001/labels/cam00.png" in files
    size, _, digest = files["frames/000001/scan.ply"]
    assert size == (capture / "frames" / "000001" / "scan.ply").stat().st_size and len(digest) == 64


def test_a_file_that_was_only_touched_is_the_same_whatever_the_clock_says(copied):
    capture, run = copied
    for time in (1, 4e9):
        os.utime(capture / "frames" / "000001" / "scan.ply", (time, time))
        assert not again(capture, run).notes and not again(capture, run, verify=True).notes


def test_a_change_behind_an_old_time_is_noticed_by_verify(copied, tmp_path):
    capture, run = copied[0], Path(shutil.copytree(copied[1], tmp_path / "run"))
    labels = capture / "frames" / "000001" / "labels" / "cam03.png"
    time = noted(run, "000001")["files"]["frames/000001/labels/cam03.png"][1]
    flip(labels)
    os.utime(labels, ns=(time, time))
    assert not again(capture, run).notes
    outcome = again(capture, run, verify=True)
    assert outcome.notes == ("files have changed of frame 1: made again",)


def test_a_poisoned_frame_fails_alone_and_is_given_again_once_it_is_mended(copied, tmp_path):
    capture, _ = copied
    keypoints, run = capture / "frames" / "000001" / "keypoints.json", tmp_path / "run"
    before = keypoints.read_text()
    keypoints.write_text("[" * 100_000)
    for _ in range(2):
        outcome = again(capture, run)
        assert outcome.ok == (0,) and "frames/000001/keypoints.json: not JSON: nested too deeply" in outcome.failed[1]
    keypoints.write_text(before)
    outcome = again(capture, run)
    assert outcome.ok == FRAMES and outcome.notes == ("files have changed of frame 1: made again",)


def test_any_exception_in_a_frame_is_that_frames(copied, tmp_path, monkeypatch):
    capture, _ = copied
    follow = track.Tracker.track

    def fragile(self, frame, *rest):
        return 1 / 0 if frame.number == 1 else follow(self, frame, *rest)

    monkeypatch.setattr(track.Tracker, "track", fragile)
    outcome = again(capture, tmp_path / "run")
    assert outcome.ok == (0,) and outcome.failed == {1: "frames/000001: ZeroDivisionError: division by zero"}


def test_a_full_disk_is_no_frames_fault(copied, tmp_path, monkeypatch):
    capture, _ = copied
    save = pipeline.save_record

    def full(path, record, *identity):
        if path.name == "track.npz":
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        save(path, record, *identity)

    monkeypatch.setattr(pipeline, "save_record", full)
    with pytest.raises(OSError, match="No space left"):
        again(capture, tmp_path / "run")
    monkeypatch.undo()
    assert again(capture, tmp_path / "run").ok == FRAMES
