"""Templates as exporters leave them: cleaned with a word of what was dropped, or refused by file and line."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.mesh import read_mesh
from toile.io.template import read_template, texture_files

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"


def written(tmp_path, text):
    (tmp_path / "shirt.obj").write_text(text)
    return tmp_path / "shirt.obj"


def test_an_unreferenced_vertex_is_left_out_with_a_warning_and_the_rest_keeps_its_order(tmp_path):
    clean = read_template(written(tmp_path, SQUARE), "shirt")
    lines = SQUARE.splitlines()
    stray = [lines[0], "v 9 9 9", *lines[1:8], "f 1/1 3/2 4/3", "f 1/1 4/3 5/4"]
    found = read_template(written(tmp_path, "\n".join(stray)), "shirt")
    assert np.array_equal(found.mesh.vertices, clean.mesh.vertices)
    assert np.array_equal(found.mesh.faces, clean.mesh.faces)
    assert np.array_equal(found.mesh.face_uv, clean.mesh.face_uv)
    assert found.kept.tolist() == [0, 2, 3, 4] and clean.kept.tolist() == [0, 1, 2, 3]
    assert clean.warnings == () and len(found.warnings) == 1
    assert "shirt.obj" in found.warnings[0] and "vertex 1 " in found.warnings[0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("vt 1 1\n", "vt nan 1\n", "line 7: a UV that is not finite"),
        ("vt 1 1\n", "vt 1 1.5\n", r"UV 2 is \(1, 1.5\)"),
        ("v 1 1 0\n", "v 1 inf 0\n", "line 3: a vertex that is not finite"),
        ("f 1/1 3/3 4/4", "f 1/1 3/3 4/9", "line 10: the face names a UV"),
        ("f 1/1 3/3 4/4", "f 1/1 3/3 8/4", "line 10: the face names a vertex"),
        ("f 1/1 3/3 4/4", "f 1/1 3/3 0/4", "line 10"),
        ("f 1/1 3/3 4/4", "f 1/1 3/3 -9/4", "line 10"),
        ("f 1/1 3/3 4/4", "f 1/1 3/3 3/4", "face 1 names a vertex twice"),
        ("f 1/1 3/3 4/4", "v 0 0 0\nv 1 1 0\nf 5/1 6/3 4/4", "vertices 0 and 4 lie at one place"),
    ],
)
def test_a_template_that_cannot_be_mended_is_refused_by_line(tmp_path, old, new, message):
    assert old in SQUARE
    with pytest.raises(UserError, match=f"shirt.obj: {message}"):
        read_template(written(tmp_path, SQUARE.replace(old, new)), "shirt")


def tube(rings=6, around=12):
    """An open tube of two triangles a cell, its faces all outwards, as OBJ."""
    angle = 2 * np.pi * np.arange(around) / around
    V = [(np.cos(t), np.sin(t), z) for z in range(rings) for t in angle]
    i, j = np.arange(rings - 1)[:, None] * around, np.arange(around)
    a, b, c, d = (x.ravel() for x in (i + j, i + (j + 1) % around, i + around + (j + 1) % around, i + around + j))
    return np.array(V), np.concatenate([np.c_[a, b, c], np.c_[a, c, d]])


def obj(V, F):
    return "\n".join([*("v {} {} {}".format(*v) for v in V), *("f {} {} {}".format(*f) for f in F + 1)])


def test_faces_that_look_against_their_neighbours_are_turned_back_with_a_warning(tmp_path):
    V, F = tube()
    few = np.array([3, 17, 18, 40])
    spoilt = F.copy()
    spoilt[few] = spoilt[few][:, ::-1]
    found = read_template(written(tmp_path, obj(V, spoilt)), "shirt")
    assert {tuple(np.roll(f, -f.argmin())) for f in found.mesh.faces} == {tuple(np.roll(f, -f.argmin())) for f in F}
    assert len(found.warnings) == 1
    assert "4 faces of garment 'shirt' are turned against their neighbours (3, 17, 18 and 1 more)" in found.warnings[0]


def test_faces_that_all_look_one_way_or_stand_twice_are_left_as_they_are(tmp_path):
    V, F = tube()
    for faces in (F, F[:, ::-1], np.vstack([F, F[:1]])):
        found = read_template(written(tmp_path, obj(V, faces)), "shirt")
        assert np.array_equal(found.mesh.faces, faces) and found.warnings == ()


def test_edges_of_three_faces_and_loose_parts_are_said_by_the_vertices_of_the_file(tmp_path):
    V, F = tube()
    fin = read_template(written(tmp_path, obj([*V, (3, 0, 2)], np.vstack([F, [[14, 26, 72]]]))), "shirt")
    assert len(fin.warnings) == 1 and "the edge from vertex 14 to 26 belongs to 3 faces:" in fin.warnings[0]
    label = [*V, (9, 9, 9), (3, 0, 2), (3, 1, 2), (3, 0, 3)]  # one vertex of no face before it
    loose = read_template(written(tmp_path, obj(label, np.vstack([F, [[73, 74, 75]]]))), "shirt")
    assert "2 parts that do not hang together, the least of 1 faces at vertex 73: is each" in loose.warnings[-1]


def test_a_surface_with_one_side_alone_is_refused(tmp_path):
    V, _ = tube(2, 6)
    low, high = np.append(np.arange(6), 6), np.append(np.arange(6, 12), 0)  # the last cell joins the first upside down
    strip = np.concatenate([np.c_[low[:-1], low[1:], high[1:]], np.c_[low[:-1], high[1:], high[:-1]]])
    with pytest.raises(UserError, match=r"shirt\.obj: face \d+ belongs to a surface that has one side alone"):
        read_template(written(tmp_path, obj(V, strip)), "shirt")


def test_a_uv_that_an_exporter_rounded_out_of_the_square_lies_on_its_border(tmp_path):
    found = read_template(written(tmp_path, SQUARE.replace("vt 1 1\n", "vt 1.00001 1\n")), "shirt")
    assert found.mesh.uv.max() == 1


def test_a_scan_keeps_its_unreferenced_vertices(tmp_path):
    assert len(read_mesh(written(tmp_path, SQUARE + "v 5 5 5\n")).vertices) == 5


def textured(tmp_path, material="map_Kd -s 1 1 1 cloth.png", name="shirt.mtl"):
    """An OBJ that names a material file of that line."""
    (tmp_path / "shirt.mtl").write_text(f"newmtl cloth\n{material}\n")
    (tmp_path / "cloth.png").write_bytes(b"")
    return written(tmp_path, f"mtllib {name}\n{SQUARE}")


def test_a_template_s_texture_is_the_picture_that_its_material_names(tmp_path):
    path = textured(tmp_path)
    assert texture_files(tmp_path, path) == (tmp_path / "shirt.mtl", tmp_path / "cloth.png")
    assert texture_files(tmp_path, textured(tmp_path, r"map_Kd .\cloth.png")) == (
        tmp_path / "shirt.mtl",
        tmp_path / "cloth.png",
    )
    assert texture_files(tmp_path, textured(tmp_path, "Kd 1 0 0")) == ()
    assert texture_files(tmp_path, textured(tmp_path, name="lost.mtl")) == ()
    assert texture_files(tmp_path, written(tmp_path, SQUARE)) == ()


def test_a_texture_that_uvs_do_not_reach_or_whose_material_is_lost_is_said(tmp_path):
    capture = shutil.copytree(SAMPLE, tmp_path / "capture", ignore=shutil.ignore_patterns("truth", "00000[1-5]"))
    scene = capture / "scene.toml"
    scene.write_text(scene.read_text().replace('label = "tshirt"', 'label = "tshirt"\nprints = true'))
    template = capture / "templates" / "tshirt.obj"
    textured(template.parent)
    template.write_text(f"mtllib shirt.mtl\n{template.read_text()}")
    assert open_capture(capture).warnings == ()
    lines = template.read_text().splitlines()
    last = [word.split("/")[0] for word in lines.pop().split()]
    template.write_text("\n".join([*lines, " ".join(last)]) + "\n")
    (warning,) = open_capture(capture).warnings
    assert (
        warning == f"{template}: corners of faces of garment 'tshirt' have no UV: cloth.png is not taken for its print"
    )
    (template.parent / "shirt.mtl").unlink()
    (warning,) = open_capture(capture).warnings
    assert warning == f"{template}: mtllib: no file 'shirt.mtl': no picture is taken for the print of garment 'tshirt'"


@pytest.mark.parametrize(
    ("material", "name", "message"),
    [
        ("map_Kd lost.png", "shirt.mtl", "shirt.mtl: map_Kd: no file 'lost.png'"),
        ("map_Kd ../../etc/passwd", "shirt.mtl", "shirt.mtl: map_Kd: '../../etc/passwd' leaves the capture"),
        ("map_Kd cloth.png", "/etc/passwd", "shirt.obj: mtllib: '/etc/passwd' leaves the capture"),
        ("map_Kd clo\x00th.png", "shirt.mtl", "leaves the capture"),
    ],
)
def test_a_texture_outside_the_capture_or_lost_is_refused(tmp_path, material, name, message):
    with pytest.raises(UserError, match=message):
        texture_files(tmp_path, textured(tmp_path, material, name))
