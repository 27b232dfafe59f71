"""What `inspect` says of scans: which way they look, where, when and how large they are."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toile.io.capture import open_capture
from toile.measure.inspection.late import out_of_step
from toile.measure.inspection.scans import astray, inside_out, short

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


@pytest.fixture(scope="module")
def scanned():
    """A capture and one of its frames, with a scan."""
    capture = open_capture(SAMPLE)
    return capture, capture.frame(0)


def rescanned(frame, vertices=None, faces=None):
    scan = frame.scan
    vertices, faces = scan.vertices if vertices is None else vertices, scan.faces if faces is None else faces
    return replace(frame, scan=replace(scan, vertices=vertices, faces=np.ascontiguousarray(faces), face_labels=None))


def test_a_scan_that_looks_inwards_is_named(scanned):
    frame = scanned[1]
    F, odd = frame.scan.faces, np.arange(len(frame.scan.faces)) % 2 == 0
    assert inside_out([frame]) == []
    (all_of_it,) = inside_out([frame, rescanned(frame, faces=F[:, ::-1])])
    assert "of its faces look inwards: turn them" in all_of_it.text and all_of_it.serious
    (half,) = inside_out([rescanned(frame, faces=np.where(odd[:, None], F, F[:, ::-1]))])
    assert "of its faces look inwards: make them look one way" in half.text and not half.serious
    front = F[(frame.scan.vertices[F][:, :, 1] < np.median(frame.scan.vertices[:, 1])).all(1)]
    assert inside_out([rescanned(frame, faces=front)]) == []


ELSEWHERE = {
    "aside": lambda V: V + [0.05, 0, 0],
    "larger": lambda V: 1.05 * V,
    "turned": lambda V: V @ Rotation.from_euler("z", 20, degrees=True).as_matrix().T,
    "mirrored": lambda V: V * [-1, 1, 1],
    "beside most pictures": lambda V: V + [0, 1.5, 0],
    "in no picture": lambda V: V + [1000, 0, 0],
}


@pytest.mark.parametrize("way", ELSEWHERE)
def test_a_scan_that_lies_elsewhere_than_the_masks_is_named(scanned, way):
    capture, frame = scanned
    (found,) = astray(capture.cameras, [frame, rescanned(frame, ELSEWHERE[way](frame.scan.vertices))])
    assert "scan.ply of frame 0: it covers" in found.text and "in the same units and axes" in found.text


@pytest.mark.parametrize("step", (-2, -1, 0, 1, 2))
def test_scans_of_another_moment_than_the_pictures_are_said_with_how_far(step):
    capture = open_capture(SAMPLE)
    frames = [
        replace(capture.pictures(n), scan=capture.scan(n + step)) for n in capture.frames if n + step in capture.frames
    ]
    said = [finding.text for finding in out_of_step(capture, frames)]
    many = f"{abs(step)} frame{'s' if abs(step) > 1 else ''}"
    assert len(said) == (step != 0)
    assert all(f"masks of {many} {'later' if step > 0 else 'earlier'} better" in text for text in said)
    assert out_of_step(capture, [replace(frame, scan=None) for frame in frames]) == []


def test_whether_scans_are_late_is_told_without_masks_of_frames_that_may_not_be_read(monkeypatch):
    capture, read = open_capture(SAMPLE), []
    frames = [replace(capture.pictures(n), scan=capture.scan(n + 1)) for n in (0, 1, 2)]
    files = type(capture).picture_files
    monkeypatch.setattr(type(capture), "picture_files", lambda self, n, kind: read.append(n) or files(self, n, kind))
    assert len(out_of_step(capture, frames, (0, 1, 2, 3))) == 1 and set(read) <= {0, 1, 2, 3}


def test_a_scan_with_a_floor_a_hole_or_another_person_is_not_called_elsewhere(scanned):
    capture, frame = scanned
    V, F = frame.scan.vertices, frame.scan.faces
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 80), np.linspace(-1, 1, 80)))
    floor = rescanned(frame, np.vstack([V, np.c_[x, y, 0 * x]]))
    hole = rescanned(frame, faces=F[(V[F][:, :, 2] > 0.9).all(1)])
    second = rescanned(frame, np.vstack([V, V + [0.9, 0, 0]]), np.vstack([F, F + len(V)]))
    for one in (frame, floor, hole, second):
        assert astray(capture.cameras, [one]) == []


def test_scans_that_are_all_shorter_than_a_person_are_said(scanned):
    frame = scanned[1]
    small, smaller = (rescanned(frame, k * frame.scan.vertices) for k in (0.45, 0.4))
    assert short([frame, small]) == short([]) == []
    (found,) = short([small, smaller])
    assert "longer than 0." in found.text and "in metres" in found.text and not found.serious
