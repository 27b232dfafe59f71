"""Labels that a scan carries itself: property `label` (uchar) of scan.ply, a face or a vertex."""

import shutil
import struct

import numpy as np
import pytest
import trimesh

from tests.support.labelled_scans import SAMPLE, write_labelled_scan
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.mesh import read_mesh

V = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]])
F = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 2]])


def test_labels_of_faces_are_read(tmp_path):
    write_labelled_scan(tmp_path / "scan.ply", V, F, [3, 0, 255])
    labels = read_mesh(tmp_path / "scan.ply").face_labels
    assert labels.dtype == np.uint8 and labels.tolist() == [3, 0, 255]


def test_labels_of_vertices_go_to_faces_by_two_corners_of_three_or_the_first(tmp_path):
    write_labelled_scan(tmp_path / "scan.ply", V, F, [1, 2, 2, 1, 7])
    assert read_mesh(tmp_path / "scan.ply").face_labels.tolist() == [2, 1, 2]
    write_labelled_scan(tmp_path / "scan.ply", V, F, [1, 2, 3, 1, 7])
    assert read_mesh(tmp_path / "scan.ply").face_labels.tolist() == [1, 1, 2]


def test_a_text_file_and_a_scan_without_labels_are_read_too(tmp_path):
    trimesh.Trimesh(V, F, process=False).export(tmp_path / "plain.ply")
    assert read_mesh(tmp_path / "plain.ply").face_labels is None
    rows = [" ".join(map(str, v)) for v in V] + [f"3 {a} {b} {c} {label}" for (a, b, c), label in zip(F, (4, 5, 6))]
    properties = "".join(f"property float {x}\n" for x in "xyz")
    (tmp_path / "text.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 5\n{properties}element face 3\n"
        "property list uchar int vertex_indices\nproperty uchar label\nend_header\n" + "\n".join(rows) + "\n"
    )
    assert read_mesh(tmp_path / "text.ply").face_labels.tolist() == [4, 5, 6]


def written(path, faces, labels, kind):
    """A PLY of V and polygons with labels, as text or in binary."""
    properties = "".join(f"property float {x}\n" for x in "xyz")
    header = f"ply\nformat {kind} 1.0\nelement vertex {len(V)}\n{properties}element face {len(faces)}\n"
    header += "property list uchar int vertex_indices\nproperty uchar label\nend_header\n"
    if kind == "ascii":
        rows = [" ".join(map(str, v)) for v in V]
        rows += [" ".join(map(str, [len(face), *face, label])) for face, label in zip(faces, labels)]
        path.write_text(header + "\n".join(rows) + "\n")
    else:
        rows = [struct.pack(f"<B{len(face)}iB", len(face), *face, label) for face, label in zip(faces, labels)]
        path.write_bytes(header.encode() + V.astype("<f4").tobytes() + b"".join(rows))


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize(
    ("faces", "triangles"),
    [([[0, 1, 2, 3], [3, 2, 4, 1]], [7, 7, 9, 9]), ([[0, 1, 2, 3], [1, 4, 2]], [7, 7, 9]), ([[0, 1, 4, 2, 3], [1, 4, 2]], [7, 7, 7, 9])],
    ids=["quads", "a quad and a triangle", "a pentagon and a triangle"],
)  # fmt: skip
def test_the_triangles_of_a_polygon_carry_its_label(tmp_path, kind, faces, triangles):
    written(tmp_path / "scan.ply", faces, [7, 9], kind)
    mesh = read_mesh(tmp_path / "scan.ply")
    assert mesh.face_labels.tolist() == triangles and len(mesh.faces) == len(triangles)


def test_a_text_of_quads_that_ends_early_is_refused(tmp_path):
    written(tmp_path / "scan.ply", [[0, 1, 2, 3]] * 6, [1] * 6, "ascii")
    lines = (tmp_path / "scan.ply").read_text().splitlines()
    (tmp_path / "scan.ply").write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(UserError, match="scan.ply: its header says 6 of element face, it holds 5"):
        read_mesh(tmp_path / "scan.ply")


def test_labels_that_are_no_ids_are_refused(tmp_path):
    mesh = trimesh.Trimesh(V, F, process=False)
    mesh.face_attributes["label"] = np.array([1, 2, 300], np.int32)
    mesh.export(tmp_path / "scan.ply")
    with pytest.raises(UserError, match="scan.ply: label: expected whole numbers from 0 to 255"):
        read_mesh(tmp_path / "scan.ply")
    mesh.face_attributes["label"] = np.array([1, 2, 0.5], np.float32)
    mesh.export(tmp_path / "scan.ply")
    with pytest.raises(UserError, match="scan.ply: label: expected whole numbers"):
        read_mesh(tmp_path / "scan.ply")


@pytest.fixture
def capture(tmp_path):
    return shutil.copytree(SAMPLE, tmp_path / "capture", ignore=shutil.ignore_patterns("truth", "images", "labels"))


def test_an_id_that_the_scene_does_not_name_is_refused_with_the_scan(capture):
    scan = open_capture(capture).frame(0).scan
    write_labelled_scan(capture / "frames/000000/scan.ply", scan.vertices, scan.faces, np.full(len(scan.faces), 77))
    with pytest.raises(UserError, match=r"000000/scan.ply: label id 77 is not in scene.toml"):
        open_capture(capture).frame(0)


def test_labels_outlive_the_scenes_units(capture):
    scan = open_capture(capture).frame(0).scan
    labels = np.where(scan.vertices[scan.faces][:, :, 2].mean(1) > 1, 3, 0)
    write_labelled_scan(capture / "frames/000000/scan.ply", 1e3 * scan.vertices, scan.faces, labels)
    text = (capture / "scene.toml").read_text().replace('units = "m"', 'units = "mm"')
    (capture / "scene.toml").write_text(text)
    frame = open_capture(capture).frame(0)
    assert np.array_equal(frame.scan_labels, labels)
    assert np.abs(frame.scan.vertices - scan.vertices).max() < 1e-6
