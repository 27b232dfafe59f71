"""Each kind of bad input gives one line that names the file and the field, exit code 1, and nothing half-written."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from toile import cli, console
from toile.io.mesh import read_mesh, write_mesh
from toile.scene import Mesh

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


@pytest.fixture
def capture(tmp_path):
    shutil.copytree(SAMPLE, tmp_path / "capture")
    return tmp_path / "capture"


def frames(capture):
    return sorted((capture / "frames").iterdir())


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def missing_camera(capture):
    data = json.loads((capture / "cameras.json").read_text())
    gone = data["cameras"].pop(2)["name"]
    (capture / "cameras.json").write_text(json.dumps(data))
    return [gone, "cameras.json"]


def other_size(capture):
    for frame in frames(capture):
        path = sorted((frame / "images").iterdir())[0]
        Image.open(path).resize((100, 50)).save(path)
    return ["images", "100 x 50"]


def scan_with_nan(capture):
    for frame in frames(capture):
        path = frame / "scan.ply"
        write_mesh(path, read_mesh(path))
        data = bytearray(path.read_bytes())
        x = data.index(b"end_header\n") + len(b"end_header\n") + 7 * 12  # of vertex 7, three float32 each
        data[x : x + 4] = np.float32(np.nan).tobytes()
        path.write_bytes(data)
    return ["scan.ply", "vertex 7"]


def closed_template(capture):
    path = capture / "templates" / "tshirt.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    return ["tshirt.obj", "open loops"]


def label_that_nothing_carries(capture):
    edit(capture / "scene.toml", "shoes = 5", "shoes = 5\ncape = 9")
    edit(capture / "scene.toml", 'label = "tshirt"', 'label = "cape"')
    return ["scene.toml", "labels.cape"]


def prints_without_pictures(capture):
    edit(capture / "scene.toml", 'label = "tshirt"', 'label = "tshirt"\nprints = true')
    for frame in frames(capture):
        shutil.rmtree(frame / "images")
    return ["scene.toml", "garment.0.prints", "frame 000000 has no images"]


def unknown_label(capture):
    edit(capture / "scene.toml", 'label = "tshirt"', 'label = "cape"')
    return ["scene.toml", "garment.0.label"]


def unknown_key(capture):
    edit(capture / "scene.toml", "fps = 30", "fps = 30\nframes_per_second = 30")
    return ["scene.toml", "scene.frames_per_second"]


def millimetres_too_small(capture):
    edit(capture / "scene.toml", 'units = "m"', 'units = "mm"')
    return ["scan.ply", "units"]


def kilometres(capture):
    for frame in frames(capture):
        mesh = read_mesh(frame / "scan.ply")
        write_mesh(frame / "scan.ply", Mesh(mesh.vertices * 1000, mesh.faces))
    return ["scan.ply", "units"]


def path_that_leaves(capture):
    edit(capture / "scene.toml", "templates/tshirt.obj", "../outside.obj")
    return ["scene.toml", "garment.0.template"]


CASES = [
    missing_camera, other_size, scan_with_nan, closed_template, label_that_nothing_carries, prints_without_pictures,
    unknown_label, unknown_key,
    millimetres_too_small, kilometres, path_that_leaves,
]  # fmt: skip


@pytest.mark.parametrize("damage", CASES, ids=lambda case: case.__name__)
def test_bad_input_is_refused_in_one_line(capture, tmp_path, monkeypatch, capsys, damage):
    expected = damage(capture)
    monkeypatch.setattr("sys.argv", ["toile", "register", str(capture), str(tmp_path / "run")])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    message = capsys.readouterr().err.strip()
    assert stop.value.code == 1
    assert len(message.splitlines()) == 1
    for part in expected:
        assert part in message
    assert not (tmp_path / "run").exists()


def test_frame_lists_are_inclusive_ranges():
    assert console.frame_numbers("1-3,7", range(10)) == (1, 2, 3, 7)
    assert console.frame_numbers("0-9", range(10), step=4) == (0, 4, 8)
    assert console.frame_numbers(None, range(3)) == (0, 1, 2)
