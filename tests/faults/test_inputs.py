"""Changed inputs are noticed and named; a poisoned frame is that frame's failure, and no other's."""

import errno
import json
import os
import shutil
from pathlib import Path

import pytest

from toile.config import preset
from toile.errors import UserError
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


def test_scene_files_are_noted_wherever_the_capture_lies(whole):
    capture, run = whole
    assert set(json.loads((run / "inputs" / "scene.json").read_text())) == {"scene.toml", "cameras.json"}
    noted = json.loads((run / "inputs" / "000001.json").read_text())
    assert "frames/000001/scan.ply" in noted and "frames/000001/labels/cam00.png" in noted
    size, _, digest = noted["frames/000001/scan.ply"]
    assert size == (capture / "frames" / "000001" / "scan.ply").stat().st_size and len(digest) == 64


@pytest.mark.parametrize("file", ["cameras.json", "frames/000001/scan.ply", "frames/000000/labels/cam03.png"])
def test_a_changed_file_of_the_same_size_is_named(copied, file):
    capture, run = copied
    if file == "cameras.json":
        (capture / file).write_text((capture / file).read_text().replace(" ", "\n", 1))
    else:
        flip(capture / file)
    with pytest.raises(UserError, match=f"{file}: has changed since"):
        again(capture, run)


def test_a_file_that_is_gone_or_new_is_named(copied):
    capture, run = copied
    (capture / "frames" / "000000" / "masks" / "cam02.png").rename(capture / "frames" / "000000" / "new.png")
    with pytest.raises(UserError, match="masks/cam02.png: is gone since"):
        again(capture, run)


def test_a_file_that_was_only_touched_is_the_same(copied):
    capture, run = copied
    os.utime(capture / "frames" / "000001" / "scan.ply", (1, 1))
    assert again(capture, run).ok == FRAMES and again(capture, run, verify=True).ok == FRAMES


def test_a_change_behind_an_old_time_is_noticed_by_verify(copied):
    capture, run = copied
    scan = capture / "frames" / "000001" / "scan.ply"
    noted = json.loads((run / "inputs" / "000001.json").read_text())["frames/000001/scan.ply"][1]
    flip(scan)
    os.utime(scan, ns=(noted, noted))
    assert again(capture, run).ok == FRAMES
    with pytest.raises(UserError, match="frames/000001/scan.ply: has changed since"):
        again(capture, run, verify=True)


def test_a_poisoned_frame_fails_alone_and_is_given_again_once_it_is_mended(copied, tmp_path):
    capture, _ = copied
    keypoints, run = capture / "frames" / "000001" / "keypoints.json", tmp_path / "run"
    before = keypoints.read_text()
    keypoints.write_text("[" * 100_000)
    for _ in range(2):
        outcome = again(capture, run)
        assert outcome.ok == (0,) and "frames/000001/keypoints.json: not JSON: nested too deeply" in outcome.failed[1]
    keypoints.write_text(before)
    with pytest.raises(UserError, match="keypoints.json: has changed"):
        again(capture, run)
    assert again(capture, run, retry=True).ok == FRAMES


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

    def full(path, record):
        if path.name == "track.npz":
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        save(path, record)

    monkeypatch.setattr(pipeline, "save_record", full)
    with pytest.raises(OSError, match="No space left"):
        again(capture, tmp_path / "run")
    monkeypatch.undo()
    assert again(capture, tmp_path / "run").ok == FRAMES
