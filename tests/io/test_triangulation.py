"""Polygons of files become triangles that cover them, whichever corner they begin with."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toile.io.mesh import read_mesh
from toile.io.triangulation import triangles_of

SHAPES = {  # counter-clockwise, with their areas
    "an L": ([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], 3.0),
    "a dart": ([[0, 0], [2, -1], [0, 2], [-2, -1]], 4.0),
    "a comb": ([[0, 0], [5, 0], [5, 3], [4, 3], [4, 1], [3, 1], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]], 11.0),
    "an L with corners on its sides": ([[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0, 1]], 3.0),
}  # fmt: skip
MESHES = {
    "obj": ("", "v {:.7f} {:.7f} {:.7f}", "f", 1),
    "ply": (
        "ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n", "{:.7f} {:.7f} {:.7f}", "{n}", 0,
    ),
    "off": ("OFF\n{n} 1 0\n", "{:.7f} {:.7f} {:.7f}", "{n}", 0),
}  # fmt: skip


def twice_areas(V, F):
    """(m,3), along the triangles' normals."""
    return np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]])


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("ending", MESHES)
def test_triangles_of_a_concave_polygon_cover_it_and_nothing_beside(tmp_path, name, ending):
    shape, area = SHAPES[name]
    R, (head, vertex, face, base) = Rotation.from_rotvec([0.4, 1.1, -2.0]), MESHES[ending]
    V, n = R.apply(np.pad(np.array(shape, float), ((0, 0), (0, 1)))), len(shape)
    for start in range(n):
        corners = " ".join(str((start + i) % n + base) for i in range(n))
        lines = [vertex.format(*v) for v in V] + [f"{face} {corners}".format(n=n)]
        (tmp_path / f"m.{ending}").write_text(head.format(n=n) + "\n".join(lines) + "\n")
        mesh = read_mesh(tmp_path / f"m.{ending}")
        along = twice_areas(mesh.vertices, mesh.faces) @ R.apply([0, 0, 1])
        assert len(along) == n - 2 and (along > 0).all() and abs(along.sum() / 2 - area) < 1e-5


def test_uvs_of_a_concave_polygon_stay_with_their_corners(tmp_path):
    shape = SHAPES["an L"][0]
    lines = [f"v {x} {y} 0\nvt {x / 2} {y / 2}" for x, y in shape] + ["f 4/4 5/5 6/6 1/1 2/2 3/3"]
    (tmp_path / "m.obj").write_text("\n".join(lines) + "\n")
    mesh = read_mesh(tmp_path / "m.obj")
    assert np.array_equal(2 * mesh.uv[mesh.face_uv], mesh.vertices[mesh.faces][..., :2])


def test_triangles_of_random_polygons_cover_them_and_those_of_convex_ones_are_fans():
    rng = np.random.default_rng(3)
    for n in (3, 4, 5, 9, 30):
        angles = np.sort(rng.uniform(0, 2 * np.pi, (n, 40)), axis=0)
        circle = np.stack([np.cos(angles), np.sin(angles), 0 * angles], 2)  # (n,40,3)
        fan = np.stack([np.zeros(n - 2, int), np.arange(1, n - 1), np.arange(2, n)], 1)
        for star in (False, True):
            V = (circle * (rng.uniform(0.05, 1, (n, 40, 1)) if star else 1)).transpose(1, 0, 2)
            V = V[(np.diff(angles, axis=0, append=angles[:1] + 2 * np.pi) < np.pi).all(0)]  # the middle lies within
            faces = triangles_of(V.reshape(-1, 3), np.arange(n * len(V)), [n] * len(V)).reshape(len(V), -1, 3)
            for k, (polygon, found) in enumerate(zip(V, faces - n * np.arange(len(V))[:, None, None])):
                own = twice_areas(polygon, found)[:, 2]
                assert np.isclose(np.abs(own).sum(), np.cross(polygon, np.roll(polygon, -1, 0))[:, 2].sum()), (n, k)
                assert star or np.array_equal(found, fan)


@pytest.mark.parametrize("n", [100, 1000, 3000])
def test_triangles_of_a_polygon_of_many_corners_that_point_inwards_by_little_cover_it(n):
    angle = 2 * np.pi * np.arange(n) / n
    radius = 1 + 0.3 * np.sin(9 * angle)
    V = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], 1)
    own = twice_areas(V, triangles_of(V, np.arange(n), [n]))[:, 2]
    assert np.isclose(np.abs(own).sum(), np.cross(V, np.roll(V, -1, 0))[:, 2].sum())


def test_polygons_that_cross_themselves_or_have_no_area_are_as_many_triangles_as_others():
    V = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0], [np.nan, 0, 0]])
    assert triangles_of(V, [0, 1, 2, 3], [4]).shape == (2, 3)
    assert triangles_of(V[:1], [0, 0, 0, 0, 0], [5]).tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]]
    assert triangles_of(V, [0, 1, 2, 4, 99, 0, 1], [5, 2]).shape == (3, 3)
