"""What `inspect` says of scans: which way they look, where, when and how large they are."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from trimesh.remesh import subdivide

from tests.support.rig import ring_of_cameras
from toile.io.body import load_body_model
from toile.io.capture import Capture, open_capture
from toile.measure.inspection import readings
from toile.measure.inspection.aside import displaced
from toile.measure.inspection.late import out_of_step, pictures_out_of_step
from toile.measure.inspection.readings import misread
from toile.measure.inspection.scans import astray, inside_out, short
from toile.scene import Frame, Mesh
from toile.vision.visibility import DepthView

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


@pytest.mark.parametrize("kind", ("images", "labels"))
@pytest.mark.parametrize("step", (-2, -1, 0, 1))
def test_images_and_label_images_of_another_moment_than_the_masks_are_said(kind, step):
    capture = open_capture(SAMPLE)
    frames = [capture.pictures(number) for number in capture.frames]
    moved = [
        replace(f, **{kind: getattr(frames[f.number + step], kind)}) for f in frames if f.number + step in range(6)
    ]
    said = [finding.text for finding in pictures_out_of_step(capture, moved)]
    many = f"{abs(step)} frame{'s' if abs(step) > 1 else ''}"
    what = "label images" if kind == "labels" else kind
    when, late = ("later", "early") if step > 0 else ("earlier", "late")
    text = f"{what}: the masks of {many} {when} fit them better than their own: are they {many} {late}?"
    assert said == [text] * (step != 0)
    assert pictures_out_of_step(capture, [replace(frame, images={}, labels={}) for frame in moved]) == []


@pytest.mark.parametrize("step", (-1, 1))
def test_a_camera_whose_masks_are_of_another_moment_is_said_with_its_offset(step, monkeypatch):
    capture, files = open_capture(SAMPLE), Capture.picture_files

    def late(self, number, kind):
        return files(self, number, kind) | {"cam02": files(self, int(np.clip(number - step, 0, 5)), kind)["cam02"]}

    monkeypatch.setattr(Capture, "picture_files", late)
    (said,) = (finding.text for finding in out_of_step(capture, [capture.frame(n) for n in capture.frames]))
    way = "late" if step > 0 else "ahead"
    assert said.startswith("cam02: its masks of 1 frame") and f"is it 1 frame {way}?" in said
    assert said.endswith(f"--offset cam02={step}")


def test_a_camera_that_sees_nobody_does_not_hide_that_scans_are_late_nor_put_it_upon_the_others(monkeypatch):
    capture, read = open_capture(SAMPLE), Capture.picture
    frames = [replace(capture.pictures(n), scan=capture.scan(n + 1)) for n in (0, 1, 2, 3)]
    monkeypatch.setattr(
        Capture, "picture", lambda self, kind, name, path: read(self, kind, name, path) * (name != "cam00")
    )
    (said,) = (finding.text for finding in out_of_step(capture, frames))
    assert said.startswith("scans: they fit the masks of 1 frame later better")


def test_an_offset_is_counted_in_frame_numbers_where_only_every_fifth_was_taken(tmp_path):
    capture = tmp_path / "fifths"
    shutil.copytree(SAMPLE, capture, ignore=shutil.ignore_patterns("truth", "images", "labels", "keypoints.json"))
    for folder in sorted((capture / "frames").iterdir(), reverse=True):
        before = SAMPLE / "frames" / f"{max(int(folder.name) - 1, 0):06d}" / "masks" / "cam02.png"
        shutil.copy(before, folder / "masks" / "cam02.png")
        folder.rename(folder.with_name(f"{5 * int(folder.name):06d}"))
    late = open_capture(capture)
    (said,) = (finding.text for finding in out_of_step(late, [late.frame(n) for n in late.frames]))
    assert said.startswith("cam02: its masks of 5 frames later") and said.endswith("--offset cam02=5")


def test_whether_scans_are_late_is_told_without_masks_of_frames_that_may_not_be_read(monkeypatch):
    capture, read = open_capture(SAMPLE), []
    frames = [replace(capture.pictures(n), scan=capture.scan(n + 1)) for n in (0, 1, 2)]
    files = type(capture).picture_files
    monkeypatch.setattr(type(capture), "picture_files", lambda self, n, kind: read.append(n) or files(self, n, kind))
    assert len(out_of_step(capture, frames, (0, 1, 2, 3))) == 1 and set(read) <= {0, 1, 2, 3}


@pytest.mark.parametrize("by", [(0.03, 0, 0), (0, 0, -0.03), (0.017, -0.017, 0.017)])
@pytest.mark.parametrize("kind", ("masks", "label images"))
def test_scans_that_lie_aside_are_said_with_how_far_and_which_way(scanned, by, kind):
    capture, frame = scanned
    frame = frame if kind == "masks" else replace(frame, masks={})
    (said,) = displaced(capture.cameras, [rescanned(frame, frame.scan.vertices + by)])
    far, where = re.fullmatch(
        r"scans: they lie (.*) cm aside of the .*, by \((.*)\) cm along x, y and z: .*", said.text
    ).groups()
    assert kind in said.text and not said.serious and 2.4 < float(far) < 3.2
    assert np.allclose([float(value) for value in where.split(", ")], np.multiply(by, 100), atol=0.5)


@pytest.mark.parametrize("pixels", (-7, 10))
def test_masks_that_are_wider_or_narrower_than_the_scans_all_around_are_said(scanned, pixels):
    capture, frame = scanned
    change, box = cv2.dilate if pixels > 0 else cv2.erode, np.ones((2 * abs(pixels) + 1,) * 2, np.uint8)
    masks = {name: change(mask.astype(np.uint8), box) > 0 for name, mask in frame.masks.items()}
    (said,) = displaced(capture.cameras, [replace(frame, masks=masks)])
    assert (
        f"masks: they are {'wider' if pixels > 0 else 'narrower'} than the scans by" in said.text and not said.serious
    )
    assert displaced(capture.cameras, [frame, replace(frame, masks=masks)]) == []


@pytest.mark.parametrize("kind", ("masks", "label images"))
@pytest.mark.parametrize(
    "name, how", [("cam03", "mirrored"), ("cam00", "mirrored"), ("cam05", "of cam01"), ("cam06", "wide")]
)
def test_a_single_camera_whose_masks_do_not_fit_the_scans_is_named(scanned, kind, name, how):
    capture, frame = scanned
    shown = frame.masks if kind == "masks" else {n: labels > 0 for n, labels in frame.labels.items()}
    wide = cv2.dilate(shown[name].astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    other = {"mirrored": shown[name][:, ::-1].copy(), "of cam01": shown["cam01"], "wide": wide}[how]
    odd = {"masks": shown | {name: other}} if kind == "masks" else {"labels": shown | {name: other}, "masks": {}}
    (said,) = displaced(capture.cameras, [replace(frame, **odd)])
    assert said.text.startswith(f"{name}: the outlines of its {kind} run ") and not said.serious


def test_a_scan_with_a_floor_a_hole_or_another_person_is_not_called_elsewhere(scanned):
    capture, frame = scanned
    V, F = frame.scan.vertices, frame.scan.faces
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 80), np.linspace(-1, 1, 80)))
    corner = np.flatnonzero((np.arange(6400) % 80 < 79) & (np.arange(6400) < 6320))[:, None] + len(V)
    floor = rescanned(
        frame, np.vstack([V, np.c_[x, y, 0 * x]]), np.vstack([F, corner + [0, 1, 80], corner + [1, 81, 80]])
    )
    hole = rescanned(frame, faces=F[(V[F][:, :, 2] > 0.9).all(1)])
    second = rescanned(frame, np.vstack([V, V + [0.9, 0, 0]]), np.vstack([F, F + len(V)]))
    for one in (frame, floor, hole, second):
        assert (
            astray(capture.cameras, [one]) == misread(capture.cameras, [one]) == displaced(capture.cameras, [one]) == []
        )


@pytest.mark.parametrize("way", sorted(ELSEWHERE.keys() - {"aside"}))
def test_scans_that_are_elsewhere_otherwise_than_aside_are_not_called_aside(scanned, way):
    capture, frame = scanned
    assert displaced(capture.cameras, [rescanned(frame, ELSEWHERE[way](frame.scan.vertices))]) == []


@pytest.mark.parametrize("factor, words", [(1.03, "larger"), (0.97, "smaller")])
def test_scans_of_another_scale_than_the_cameras_are_said_and_not_to_lie_aside(scanned, factor, words):
    capture, frame = scanned
    (said,) = displaced(capture.cameras, [rescanned(frame, factor * frame.scan.vertices)])
    told = re.fullmatch(rf"scans: they are (.*) % {words} than the masks show: .*", said.text)
    assert 2.2 < float(told[1]) < 3.2 and not said.serious


def test_a_scan_from_the_front_is_not_called_aside(scanned):
    capture, frame = scanned
    V, F = frame.scan.vertices, frame.scan.faces
    assert displaced(capture.cameras, [rescanned(frame, faces=F[(V[F][:, :, 1] < np.median(V[:, 1])).all(1)])]) == []


@pytest.mark.parametrize("axis, share", [(0, 0), (0, 1), (1, 1)], ids=["x about 0", "x about the person", "y"])
@pytest.mark.parametrize("kind", ("masks", "label images"))
def test_mirrored_scans_are_told_from_others_that_lie_elsewhere(scanned, axis, share, kind):
    capture, frame = scanned
    V = frame.scan.vertices.copy()
    V[:, axis] = 2 * share * np.median(V[:, axis]) - V[:, axis]
    frame = frame if kind == "masks" else replace(frame, masks={})
    (found,) = misread(capture.cameras, [rescanned(frame, V, frame.scan.faces[:, ::-1])])
    assert f"mirrored along {'xy'[axis]} they fit the {kind} better" in found.text and found.serious
    for way in ELSEWHERE.keys() - {"mirrored"}:
        assert misread(capture.cameras, [rescanned(frame, ELSEWHERE[way](frame.scan.vertices))]) == []


@pytest.mark.parametrize("share", [0, 1], ids=["about 0", "about the person"])
@pytest.mark.parametrize("kind", ("masks", "label images"))
def test_a_scan_turned_by_half_a_turn_is_told_from_a_mirrored_one(scanned, share, kind):
    capture, frame = scanned
    V = frame.scan.vertices.copy()
    V[:, :2] = 2 * share * np.median(V[:, :2], axis=0) - V[:, :2]
    frame = frame if kind == "masks" else replace(frame, masks={})
    (found,) = misread(capture.cameras, [rescanned(frame, V)])
    assert found.text.startswith(f"scans: turned by 180 degrees about z they fit the {kind} better") and found.serious


def test_of_a_pose_that_is_its_own_mirror_image_both_are_said():
    cameras, body = ring_of_cameras(4), load_body_model()
    V = body.v_template
    masks = {name: DepthView(camera, V, body.skin_faces).face >= 0 for name, camera in cameras.items()}
    (found,) = misread(cameras, [Frame(0, Mesh(V * [-1, -1, 1], body.skin_faces), masks=masks)])
    assert "mirrored along y" in found.text and " or " in found.text and "turned by 180 degrees about z" in found.text


def test_scans_of_many_faces_are_told_mirrored_by_fewer(scanned, monkeypatch):
    capture, frame = scanned
    V, F = subdivide(*subdivide(frame.scan.vertices * [-1, 1, 1], frame.scan.faces[:, ::-1]))
    shown = []
    monkeypatch.setattr(readings, "DepthView", lambda camera, V, F: shown.append(len(F)) or DepthView(camera, V, F))
    (found,) = misread(capture.cameras, [rescanned(frame, V, F.astype(np.int32))])
    assert "mirrored along x" in found.text and len(F) > readings.DENSE > max(shown)


@pytest.mark.parametrize("k", (-0.3, -0.2, 0.2))
def test_lenses_whose_distortion_was_left_out_are_told_from_masks_that_are_wide_or_narrow(scanned, k):
    import cv2

    capture, frame = scanned
    bent = {name: replace(c, distortion=c.distortion + [k, 0, 0, 0, 0]) for name, c in capture.cameras.items()}
    masks = {name: DepthView(c, frame.scan.vertices, frame.scan.faces).face >= 0 for name, c in bent.items()}
    (found,) = misread(capture.cameras, [replace(frame, masks=masks)])
    assert f"distortion is {k:+.1f} more than in cameras.json" in found.text and not found.serious
    assert misread(bent, [replace(frame, masks=masks)]) == []
    for change in (cv2.erode, cv2.dilate):
        other = {name: change(mask.astype(np.uint8), np.ones((7, 7))) > 0 for name, mask in frame.masks.items()}
        assert misread(capture.cameras, [replace(frame, masks=other)]) == []


def test_scans_that_are_all_shorter_than_a_person_are_said(scanned):
    frame = scanned[1]
    small, smaller = (rescanned(frame, k * frame.scan.vertices) for k in (0.45, 0.4))
    assert short([frame, small]) == short([]) == []
    (found,) = short([small, smaller])
    assert "longer than 0." in found.text and "in metres" in found.text and not found.serious
