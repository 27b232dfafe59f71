"""Meshes written and read again."""

import struct

import numpy as np
import pytest

import toile
from toile.errors import UserError
from toile.io.mesh import read_mesh, write_mesh
from toile.kernels import InputError
from toile.scene import Mesh

V = np.array([[0, 0, 0], [1.25, 0, 0], [0, 1, -3.0000001], [1, 1, 0.5]])
F = np.array([[0, 1, 2], [2, 1, 3]], np.int32)
UV = np.array([[0, 0], [1, 0], [0, 0.25], [1, 1], [0.5, 0.5]])
FACE_UV = np.array([[0, 1, 2], [4, 1, 3]], np.int32)


def test_an_obj_comes_back_with_its_uvs(tmp_path):
    write_mesh(tmp_path / "m.obj", Mesh(V, F, UV, FACE_UV))
    mesh = toile.read_mesh(tmp_path / "m.obj")
    assert np.array_equal(mesh.vertices, V) and np.array_equal(mesh.uv, UV)
    assert np.array_equal(mesh.faces, F) and np.array_equal(mesh.face_uv, FACE_UV)


def test_an_obj_without_uvs_has_none(tmp_path):
    toile.write_mesh(tmp_path / "new" / "m.OBJ", Mesh(V, F))
    mesh = read_mesh(tmp_path / "new" / "m.OBJ")
    assert mesh.uv is None and np.array_equal(mesh.vertices, V) and np.array_equal(mesh.faces, F)


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"


@pytest.mark.parametrize(
    "written",
    [
        "\ufeff" + SQUARE,
        SQUARE.replace("\n", "\r\n"),
        SQUARE.replace("\n", "\r"),
        SQUARE.replace("\n", " # said\n"),
        SQUARE.replace(" ", "\t"),
        SQUARE.replace(" 0\n", " 0 255 0 0\n"),
        SQUARE.replace("1 2 3 4", "-4// -3// -2// -1//"),
        f"# ü\no a\n{SQUARE}usemtl b\nl 1 2\np 1\n",
        "# from C:\\models\\\n" + SQUARE.replace("2 3 4", "2 \\\n 3\\\n 4"),
    ],
    ids=["mark of its bytes", "of Windows", "of old Macs", "comments", "tabs", "colours", "from the end", "lines and points", "carried on"],
)  # fmt: skip
def test_an_obj_is_the_same_in_every_dialect(tmp_path, written):
    (tmp_path / "m.obj").write_bytes(written.encode())
    mesh = read_mesh(tmp_path / "m.obj")
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]] and mesh.faces.tolist() == [
        [0, 1, 2],
        [0, 2, 3],
    ]


def test_a_ply_comes_back_in_its_order_as_float32(tmp_path):
    write_mesh(tmp_path / "m.ply", Mesh(V, F))
    mesh = read_mesh(tmp_path / "m.ply")
    assert np.array_equal(mesh.vertices, V.astype(np.float32)) and np.array_equal(mesh.faces, F)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_triangles_of_an_stl_share_the_vertices_at_one_place_in_its_order(tmp_path, kind):
    import trimesh

    trimesh.Trimesh(V, F, process=False).export(tmp_path / "m.stl", file_type=kind)
    mesh = read_mesh(tmp_path / "m.stl")
    np.testing.assert_allclose(mesh.vertices, V, atol=1e-6)
    assert mesh.faces.tolist() == F.tolist()


def test_a_ply_far_from_the_origin_keeps_what_float32_would_round_away(tmp_path):
    far = V + [4.5e5, 5.4e6, 0]
    write_mesh(tmp_path / "m.ply", Mesh(far, F, confidence=np.ones(4)))
    assert np.array_equal(read_mesh(tmp_path / "m.ply").vertices, far)


@pytest.mark.parametrize("unit", [1e-3, 1e-9, 1e-200, 1.0, 1e6])
def test_an_obj_of_any_unit_keeps_a_millionth_of_its_extent(tmp_path, unit):
    V = unit * np.array([[0.1234567, 0, 0], [1, 0, 0.7654321], [0, 1.7, 0]])
    write_mesh(tmp_path / "a.obj", Mesh(V, np.array([[0, 1, 2]])))
    assert np.abs(read_mesh(tmp_path / "a.obj").vertices - V).max() < 1e-6 * unit


@pytest.mark.parametrize("ending", ["ply", "obj"])
def test_a_cloud_of_points_is_called_so(tmp_path, ending):
    import trimesh

    trimesh.PointCloud(V).export(tmp_path / f"cloud.{ending}")
    with pytest.raises(
        UserError, match=rf"cloud\.{ending}: the mesh has 4 vertices and 0 faces: a cloud of points, expected"
    ):
        read_mesh(tmp_path / f"cloud.{ending}")


def test_another_ending_is_refused_and_nothing_is_left(tmp_path):
    with pytest.raises(UserError, match=r"m.stl: expected a file that ends in .obj or .ply"):
        write_mesh(tmp_path / "m.stl", Mesh(V, F))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", [".ply", ".obj"])
@pytest.mark.parametrize("given", [np.ndarray.tolist, np.asfortranarray, lambda a: a.astype(f">{a.dtype.kind}8")])
def test_a_mesh_of_any_numbers_is_the_same_file(tmp_path, ending, given):
    write_mesh(tmp_path / f"a{ending}", Mesh(V, F))
    write_mesh(tmp_path / f"b{ending}", Mesh(given(V), given(F)))
    assert (tmp_path / f"a{ending}").read_bytes() == (tmp_path / f"b{ending}").read_bytes()


@pytest.mark.parametrize(
    ("mesh", "said"),
    [
        (Mesh(np.where(V == 1.25, np.nan, V), F), "m.ply: vertex 1 is not finite"),
        (Mesh(V, F + 1), r"m.ply: face 1 names a vertex that is not there \(4 vertices\)"),
        (Mesh(V, F - 1), "m.ply: face 0 names a vertex"),
        (Mesh(V, F[:0]), "m.ply: the mesh has 4 vertices and 0 faces"),
        (Mesh(V, F, face_labels=[1, 300]), "m.ply: label: expected whole numbers from 0 to 255"),
        (Mesh(V, F, face_labels=[1]), "m.ply: label: 1 values, expected 2, one a face"),
        (Mesh(V, F, confidence=[0.5]), "m.ply: confidence: expected numbers from 0 to 1, one a vertex"),
        (Mesh(V, F.astype(float)), "write_mesh: faces has dtype float64, expected integers"),
        (Mesh(V[:, :2], F), r"write_mesh: vertices has shape \(4, 2\)"),
    ],
)
def test_a_mesh_that_could_not_be_read_again_is_not_written(tmp_path, mesh, said):
    with pytest.raises((UserError, InputError), match=said):
        write_mesh(tmp_path / "m.ply", mesh)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("uv", "face_uv", "said"),
    [
        (UV, FACE_UV + 1, r"m.obj: face 1 names a UV that is not there \(5 UVs\)"),
        (UV, FACE_UV - 1, "m.obj: face 0 names a UV"),
        (np.where(UV == 0.5, np.nan, UV), FACE_UV, "m.obj: UV 4 is not finite"),
        (UV, FACE_UV[:1], "m.obj: face_uv: 1 rows for 2 faces"),
        (UV, None, "m.obj: face_uv: a mesh has both"),
        (None, FACE_UV, "m.obj: uv: a mesh has both"),
        (UV[:, :1], FACE_UV, r"write_mesh: uv has shape \(5, 1\)"),
        (UV, FACE_UV.astype(float), "write_mesh: face_uv has dtype float64, expected integers"),
    ],
)
def test_uvs_that_could_not_be_read_again_are_not_written(tmp_path, uv, face_uv, said):
    with pytest.raises((UserError, InputError), match=said):
        write_mesh(tmp_path / "m.obj", Mesh(V, F, uv, face_uv))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("lines", "element"), [(-1, "face"), (-3, "vertex")])
def test_a_ply_of_text_that_ends_early_is_refused(tmp_path, lines, element):
    header = ["ply", "format ascii 1.0", "element vertex 4", *(f"property float {axis}" for axis in "xyz")]
    header += ["element face 2", "property list uchar int vertex_indices", "end_header"]
    text = header + [" ".join(map(str, v)) for v in V.tolist()] + [f"3 {a} {b} {c}" for a, b, c in F]
    (tmp_path / "m.ply").write_text("\n".join(text))
    assert np.array_equal(read_mesh(tmp_path / "m.ply").faces, F)
    (tmp_path / "m.ply").write_text("\n".join(text[:lines]))
    with pytest.raises(UserError, match=f"m.ply: its header says . of element {element}, it holds"):
        read_mesh(tmp_path / "m.ply")


@pytest.mark.parametrize(
    "written",
    [
        "OFF\n4 2 0\n{v}\n{f}",
        "# by hand\nOFF 4 2 0\n\n{v}\n{f} # the last\n",
        "CNOFF\n4 2\n{coloured}\n{tinted}\n",
        "\ufeffOFF\r\n4 2 5\r\n{v}\r\n{f}",
    ],
    ids=["plain", "commented", "with colours and normals", "of windows"],
)
def test_an_off_is_the_same_in_every_dialect(tmp_path, written):
    places, corners = [" ".join(map(str, v)) for v in V.tolist()], [f"3 {a} {b} {c}" for a, b, c in F]
    lines = {"v": places, "f": corners, "coloured": [f"{v} 0 0 1 9 9 9 255" for v in places]}
    lines |= {"tinted": [f"{face} 0.5 0.5 0.5" for face in corners]}
    (tmp_path / "m.off").write_text(written.format(**{name: "\n".join(of) for name, of in lines.items()}), newline="")
    mesh = read_mesh(tmp_path / "m.off")
    assert np.array_equal(mesh.vertices, V) and np.array_equal(mesh.faces, F)


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "its header says 3 vertices and 2 faces, 4 lines follow"),
        ("OFF\n3 1 0\n0 0 0\n1 0\n0 1 0\n3 0 1 2\n", "line 4: expected a vertex, '1 0' is none"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n4 0 1 2\n", "line 6: expected a face, '4 0 1 2' is none"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", r"face 0 names a vertex that is not there \(3 vertices\)"),
        ("4OFF\n3 1 0\n", "expected OFF, COFF, NOFF or the like as its first word"),
        ("OFF BINARY\n", "expected the numbers of vertices and of faces, as text, after OFF"),
        ("", "expected OFF, COFF"),
    ],
)
def test_an_off_that_is_cut_or_of_another_kind_is_refused_by_its_line(tmp_path, written, said):
    (tmp_path / "m.off").write_text(written)
    with pytest.raises(UserError, match=rf"m\.off: {said}"):
        read_mesh(tmp_path / "m.off")


def polygons(path, faces, order="<", corner="i", vertex="float", count="B"):
    """A binary PLY of eight vertices of a cube, with labels, and polygons; a value before and one behind each polygon's corners."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], np.float64)
    real, kinds = {"float": "f", "double": "d"}[vertex], {"B": "uchar", "I": "uint", "i": "int", "h": "short"}
    header = ["ply", f"format binary_{'little' if order == '<' else 'big'}_endian 1.0", "element vertex 8"]
    header += [f"property {vertex} {axis}" for axis in "zyx"] + ["property uchar label", f"element face {len(faces)}"]
    header += [
        "property uchar flags",
        f"property list {kinds[count]} {kinds[corner]} vertex_indices",
        "property float area",
    ]
    data = b"".join(struct.pack(f"{order}3{real}B", *v[::-1], 1 + i % 2) for i, v in enumerate(corners))
    for face in faces:
        data += struct.pack(f"{order}B{count}{len(face)}{corner}f", 0, len(face), *face, 1.0)
    path.write_bytes("\n".join([*header, "end_header\n"]).encode() + data)
    return corners


POLYGONS = {  # and the triangles that they are
    "quads and triangles": ([[0, 1, 3, 2], [4, 6, 7], [0, 4, 5]], [[0, 1, 3], [0, 3, 2], [4, 6, 7], [0, 4, 5]]),
    "as long as quads alone": (
        [[0, 1, 3, 2], [4, 6, 7], [0, 4, 5, 1, 2]],
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [0, 4, 5], [0, 5, 1], [0, 1, 2]],
    ),
}


@pytest.mark.parametrize(
    "kinds", [{}, {"order": ">", "vertex": "double", "corner": "h", "count": "I"}], ids=["little", "big"]
)
@pytest.mark.parametrize("name", POLYGONS)
def test_a_binary_ply_of_unlike_polygons_is_their_triangles_in_their_order(tmp_path, name, kinds):
    faces, triangles = POLYGONS[name]
    corners = polygons(tmp_path / "m.ply", faces, **kinds)
    mesh = read_mesh(tmp_path / "m.ply")
    assert np.array_equal(mesh.vertices, corners) and mesh.faces.tolist() == triangles
    assert mesh.face_labels.tolist() == [1 + (b if b % 2 == c % 2 else a) % 2 for a, b, c in triangles]


def test_a_binary_ply_of_unlike_polygons_that_is_cut_or_goes_on_is_refused(tmp_path):
    polygons(tmp_path / "m.ply", POLYGONS["quads and triangles"][0])
    whole = (tmp_path / "m.ply").read_bytes()
    for data, said in (
        (whole[:-9], "ends in the middle of its 3 of element face"),
        (whole + b"\0", "1 bytes follow what its header"),
    ):
        (tmp_path / "m.ply").write_bytes(data)
        with pytest.raises(UserError, match=rf"m\.ply: {said}"):
            read_mesh(tmp_path / "m.ply")


def test_strips_of_triangles_are_refused_by_what_they_are(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    (tmp_path / "m.ply").write_text(header + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(UserError, match=r"m\.ply: element tristrips: strips of triangles are not read"):
        read_mesh(tmp_path / "m.ply")
