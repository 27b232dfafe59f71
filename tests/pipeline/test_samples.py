"""What is held of the frames that the preparation is made of: with many cameras of many pixels they fill a memory."""

import errno
import mmap
import shutil
import tempfile
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from toile.config import preset
from toile.io.capture import Capture, open_capture
from toile.pipeline import preparation, samples
from toile.pipeline.identity import Identities
from toile.pipeline.manifest import request_of
from toile.stages import segment

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
CONFIG = preset("draft").model_copy(update={"preparation_frames": 4, "picture_side": 180})
FRAMES = (0, 1, 2, 3)
SCAN = Identities(Path("run"), {"scan": "same"}, FRAMES)


class Alive:
    """How many of the things that a function returns were there at once, at most."""

    def __init__(self, function):
        self.function, self.refs, self.most = function, [], 0

    def __call__(self, *arguments):
        made = self.function(*arguments)
        for one in made.values() if isinstance(made, dict) else [made]:
            self.refs.append(weakref.ref(one))
        self.refs = [ref for ref in self.refs if ref() is not None]
        self.most = max(self.most, len(self.refs))
        return made


def in_a_file(array):
    while isinstance(array, np.ndarray):
        array = array.base
    return isinstance(array, mmap.mmap)


def test_pictures_of_sampled_frames_wait_in_files_and_are_what_labels_see(tmp_path):
    capture = open_capture(SAMPLE)
    for frame, _ in samples.samples_of(capture, tmp_path, CONFIG, SCAN):
        whole = samples.as_labels_see(samples.frame_of(capture, CONFIG, frame.number), CONFIG)
        for name in samples.PICTURES:
            kept, expected = getattr(frame, name), getattr(whole, name)
            assert kept.keys() == expected.keys() and all(map(in_a_file, kept.values()))
            for camera, picture in expected.items():
                assert kept[camera].dtype == picture.dtype and np.array_equal(kept[camera], picture), (name, camera)
    assert list((tmp_path / "prepared").iterdir()) == []


def test_frames_of_keypoints_alone_are_sampled_only_where_no_other_has_more(tmp_path):
    for number in range(12):
        frame = tmp_path / "frames" / f"{number:06d}"
        shutil.copytree(SAMPLE / "frames" / "000000", frame) if number % 4 == 0 else frame.mkdir(parents=True)
        shutil.copy(SAMPLE / "frames" / "000000" / "keypoints.json", frame)
    for file in ("scene.toml", "cameras.json"):
        shutil.copy(SAMPLE / file, tmp_path)
    shutil.copytree(SAMPLE / "templates", tmp_path / "templates")
    capture = open_capture(tmp_path)
    assert list(samples.sampled_frames(capture, 3, range(12))) == [0, 4, 8]
    assert list(samples.sampled_frames(capture, 2, (1, 2, 3))) == [1, 3]


def test_no_two_pictures_are_held_whole(tmp_path, monkeypatch, threads):
    threads(1)
    alive = Alive(Capture.picture)
    monkeypatch.setattr(Capture, "picture", lambda *arguments: alive(*arguments))
    samples.samples_of(open_capture(SAMPLE), tmp_path, CONFIG, SCAN)
    assert alive.most <= 2  # the one before lives until the next is read


def test_a_scene_without_garments_keeps_no_picture(tmp_path):
    capture = open_capture(SAMPLE)
    bare = replace(capture, scene=replace(capture.scene, garments=()))
    for frame, _ in samples.samples_of(bare, tmp_path, CONFIG, SCAN):
        assert not any(getattr(frame, name) for name in samples.PICTURES) and frame.scan is not None


def test_a_full_disk_is_no_sampled_frames_fault(tmp_path, monkeypatch):
    def full(**_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", full)
    with pytest.raises(OSError, match="No space left"):
        samples.samples_of(open_capture(SAMPLE), tmp_path, CONFIG, SCAN)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Four frames of the bundled capture; the labels of one camera are missing, so that they are told by the others."""
    folder = tmp_path_factory.mktemp("samples") / "capture"
    shutil.copytree(SAMPLE, folder, ignore=shutil.ignore_patterns("truth", "00000[45]"))
    for number in FRAMES:
        (folder / "frames" / f"{number:06d}" / "labels" / "cam02.png").unlink()
    return open_capture(folder)


def prepared(capture, run):
    """The files of RUN/prepared."""
    asked = request_of(run, capture, CONFIG, FRAMES, FRAMES, lambda frames: FRAMES)
    preparation.prepare(capture, run, CONFIG, asked.identities)
    return {path.name: path.read_bytes() for path in (run / "prepared").glob("*.npz")}


def test_views_of_one_frame_are_there_at_once_and_evidence_gathered_twice_gives_the_same_bits(
    capture, tmp_path, monkeypatch, threads
):
    threads(1)
    kept, views, evidence = prepared(capture, tmp_path / "a"), Alive(segment.depth_views), Alive(segment.evidence)
    monkeypatch.setattr(segment, "depth_views", views)
    monkeypatch.setattr(segment, "evidence", evidence)
    monkeypatch.setattr(preparation, "LARGE", 0)
    assert prepared(capture, tmp_path / "b") == kept
    assert views.most <= 2 * len(capture.cameras) and evidence.most <= 2
    assert len(kept) == 3
