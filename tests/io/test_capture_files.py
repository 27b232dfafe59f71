"""Files of a capture: what is read is what was written, in metres, in file order."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from toile.errors import UserError
from toile.io.camera import read_cameras
from toile.io.capture import open_capture
from toile.io.files import load_record, save_record
from toile.io.keypoints import read_keypoints
from toile.io.mesh import read_mesh, write_mesh
from toile.scene import Mesh

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


def test_obj_keeps_vertices_and_uvs_in_topologies_of_their_own(tmp_path):
    path = tmp_path / "seam.obj"
    path.write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt .5 .5\nf 1/1 2/2 3/3 4/4\nf -4/5 -2/3 -1/4\n"
    )
    mesh = read_mesh(path)
    assert mesh.vertices.shape == (4, 3) and mesh.uv.shape == (5, 2)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 2, 3]]
    assert mesh.face_uv.tolist() == [[0, 1, 2], [0, 2, 3], [4, 2, 3]]


def test_ply_keeps_the_order_of_vertices_and_duplicates(tmp_path):
    V = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0]], dtype=np.float64)
    F = np.array([[3, 1, 2], [0, 1, 2]])
    write_mesh(tmp_path / "m.ply", Mesh(V, F))
    mesh = read_mesh(tmp_path / "m.ply")
    assert np.array_equal(mesh.vertices, V) and np.array_equal(mesh.faces, F)


def test_face_that_names_a_missing_vertex_is_refused(tmp_path):
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    with pytest.raises(UserError, match="m.obj: line 4: the face names a vertex"):
        read_mesh(tmp_path / "m.obj")


@pytest.mark.parametrize("number", ["0", 0.0, None, [0]])
def test_a_frame_by_another_thing_than_a_whole_number_is_refused(number):
    capture = open_capture(SAMPLE)
    with pytest.raises(UserError, match="frames: .*: expected the number of a frame, a whole number"):
        capture.frame(number)
    assert capture.scan(np.int32(0)) is not None


@pytest.mark.parametrize("name", ["cam00.jpg", "cam00.png"])
def test_labels_in_jpeg_are_refused_by_name_whatever_their_ending(tmp_path, name):
    from PIL import Image

    capture = tmp_path / "lossy"
    shutil.copytree(SAMPLE, capture, ignore=shutil.ignore_patterns("truth", "00000[1-5]"))
    labels = capture / "frames" / "000000" / "labels" / "cam00.png"
    image = Image.open(labels).convert("L")
    labels.unlink()
    image.save(labels.with_name(name), format="JPEG", quality=100)
    with pytest.raises(UserError, match=rf"labels/{name}: a JPEG, which changes label ids"):
        open_capture(capture).pictures(0)


def test_a_palette_of_a_mask_is_read_by_its_colours_and_of_labels_by_its_indices(tmp_path):
    from PIL import Image

    capture = tmp_path / "indexed"
    shutil.copytree(SAMPLE, capture, ignore=shutil.ignore_patterns("truth", "00000[1-5]"))
    before = open_capture(capture).pictures(0)
    for kind, colours in (("masks", [0, 0, 0, 200, 0, 0]), ("labels", list(range(30)))):
        for path in (capture / "frames" / "000000" / kind).iterdir():
            ids = np.asarray(Image.open(path))
            indexed = Image.fromarray((ids > 127).astype(np.uint8) if kind == "masks" else ids).convert("P")
            indexed.putpalette(colours)
            indexed.save(path)
    after = open_capture(capture).pictures(0)
    for kind in ("masks", "labels"):
        then, now = getattr(before, kind), getattr(after, kind)
        assert all(then[camera].any() and np.array_equal(then[camera], now[camera]) for camera in then)


def test_centimetres_are_the_same_capture_in_metres(tmp_path):
    capture = tmp_path / "cm"
    shutil.copytree(SAMPLE, capture, ignore=shutil.ignore_patterns("truth", "00000[1-5]"))
    text = (capture / "scene.toml").read_text()
    (capture / "scene.toml").write_text(text.replace('units = "m"', 'units = "cm"'))
    cameras = json.loads((capture / "cameras.json").read_text())
    for camera in cameras["cameras"]:
        for row in camera["T_camera_world"][:3]:
            row[3] *= 100
    (capture / "cameras.json").write_text(json.dumps(cameras))
    scan = read_mesh(capture / "frames" / "000000" / "scan.ply")
    write_mesh(capture / "frames" / "000000" / "scan.ply", Mesh(scan.vertices * 100, scan.faces))
    there, here = open_capture(capture), open_capture(SAMPLE)
    name = next(iter(here.cameras))
    point = here.frame(0).scan.vertices[::1000]
    assert np.allclose(there.frame(0).scan.vertices[::1000], point, atol=1e-6)
    assert np.allclose(there.cameras[name].project(point)[0], here.cameras[name].project(point)[0], atol=1e-6)


@pytest.mark.parametrize(
    "field, spoilt, said",
    [
        ("T_camera_world", lambda T: np.transpose(T).tolist(), "its last row is not 0 0 0 1: is it transposed"),
        ("K", lambda K: np.transpose(K).tolist(), r"K \(cam\d+\): expected \[\[fx, s, cx\]"),
        ("K", lambda K: (2 * np.array(K)).tolist(), r"K \(cam\d+\): expected \[\[fx, s, cx\]"),
    ],
)
def test_matrices_of_other_layouts_are_refused(tmp_path, field, spoilt, said):
    data = json.loads((SAMPLE / "cameras.json").read_text())
    data["cameras"][2][field] = spoilt(data["cameras"][2][field])
    (tmp_path / "cameras.json").write_text(json.dumps(data))
    with pytest.raises(UserError, match=rf"cameras\.json: cameras\.2\..*{said}"):
        read_cameras(tmp_path / "cameras.json")


@pytest.mark.parametrize(
    "names, rows, said",
    [
        ("ab", [[1, 2, 0.5], [3, 4, 87]], r"points\.c\[1\]: its confidence is 87, expected 0 to 1"),
        ("ab", [[1, 2, 0.5], [3, 4, -1]], r"points\.c\[1\]: its confidence is -1, expected 0 to 1"),
        ("aa", [[1, 2, 0.5], [3, 4, 0.5]], "names: a stands there twice"),
        ("ab", [1, 2, 0.5, 3, 4, 0.5], r"points\.c has 6 rows, names 2"),
        ("abc", [[1, 2, 3, 4, 5, 6, 0.1, 0.1, 0.1], [], []], r"points\.c\[0\]: expected \[u, v, confidence\]"),
        ("ab", [[1, 2, 0.5], None], r"points\.c\[1\]: expected \[u, v, confidence\]"),
        ("ab", [[1, 2, 0.5], ["3", 4, 0.5]], r"points\.c\[1\]: expected \[u, v, confidence\]"),
        ("ab", [[1, 2, 0.5], [3, 4, float("nan")]], r"points\.c\[1\] is not finite"),
        ("ab", {"a": [1, 2, 0.5]}, r"points\.c: expected \[\[u, v, confidence\], \.\.\.\]"),
    ],
)
def test_keypoints_that_are_no_rows_of_numbers_say_no_share_or_a_name_twice_are_refused(tmp_path, names, rows, said):
    path = tmp_path / "keypoints.json"
    path.write_text(json.dumps({"names": list(names), "points": {"c": rows}}))
    with pytest.raises(UserError, match=f"keypoints.json: {said}"):
        read_keypoints(path, {"c": None})


@dataclass(frozen=True)
class Part:
    values: np.ndarray


@dataclass(frozen=True)
class Record:
    array: np.ndarray
    name: str
    numbers: dict
    loops: tuple
    part: Part | None
    nothing: np.ndarray | None = None


def test_records_come_back_to_the_bit(tmp_path):
    record = Record(np.array([0.1, np.nan]), "x", {"a": 0.1}, (np.arange(3), np.arange(2)), Part(np.pi * np.arange(3)))
    save_record(tmp_path / "r.npz", record)
    back = load_record(tmp_path / "r.npz", Record, ("loops",), part=Part)
    assert back.array.tobytes() == record.array.tobytes() and back.name == "x" and back.numbers == {"a": 0.1}
    assert [l.tolist() for l in back.loops] == [[0, 1, 2], [0, 1]] and back.nothing is None
    assert back.part.values.tobytes() == record.part.values.tobytes()
