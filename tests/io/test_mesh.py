"""Meshes written and read again."""

import numpy as np
import pytest

import toile
from toile.errors import UserError
from toile.io.mesh import read_mesh, write_mesh
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


def test_a_ply_comes_back_in_its_order_as_float32(tmp_path):
    write_mesh(tmp_path / "m.ply", Mesh(V, F))
    mesh = read_mesh(tmp_path / "m.ply")
    assert np.array_equal(mesh.vertices, V.astype(np.float32)) and np.array_equal(mesh.faces, F)


def test_a_ply_far_from_the_origin_keeps_what_float32_would_round_away(tmp_path):
    far = V + [4.5e5, 5.4e6, 0]
    write_mesh(tmp_path / "m.ply", Mesh(far, F, confidence=np.ones(4)))
    assert np.array_equal(read_mesh(tmp_path / "m.ply").vertices, far)


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
