"""Laws of isotropic remeshing: the same surface, sides of one length, borders in place."""

import numpy as np
import pytest
import trimesh

from toile import kernels
from toile.kernels import InputError, SurfaceIndex, boundary_loops, remesh, unique_edges


def sides(V, F):
    E = unique_edges(F)
    return np.linalg.norm(V[E[:, 0]] - V[E[:, 1]], axis=1)


@pytest.fixture(scope="module")
def tube():
    """An open tube of uneven triangles about the z axis: radius 0.1, length 0.6."""
    around, along = np.linspace(0, 2 * np.pi, 40, endpoint=False), np.linspace(0, 1, 16) ** 2 * 0.6
    V = np.array([[0.1 * np.cos(a), 0.1 * np.sin(a), z] for z in along for a in around])
    n = len(around)
    F = [(r * n + k, r * n + (k + 1) % n, (r + 1) * n + k) for r in range(15) for k in range(n)]
    F += [(r * n + (k + 1) % n, (r + 1) * n + (k + 1) % n, (r + 1) * n + k) for r in range(15) for k in range(n)]
    return V, np.array(F)


@pytest.mark.parametrize("edge", [0.02, 0.012])
def test_sides_become_equal_on_the_same_surface(tube, edge):
    V, F = tube
    X, G = remesh(V, F, edge)
    length = sides(X, G) / edge
    assert 0.85 < length.mean() < 1.1 and length.std() < 0.2 and length.max() < 1.6
    assert SurfaceIndex(V, F).closest(X)[3].max() < 1e-6
    assert trimesh.Trimesh(X, G, process=False).area == pytest.approx(
        trimesh.Trimesh(V, F, process=False).area, rel=0.01
    )


def test_borders_stay_on_their_polylines_and_faces_keep_their_side(tube):
    V, F = tube
    X, G = remesh(V, F, 0.012)
    assert len(boundary_loops(G)) == 2
    border = X[kernels.border_vertices(G, len(X))]
    low, high = border[border[:, 2] < 0.3], border[border[:, 2] >= 0.3]
    assert np.abs(low[:, 2]).max() < 1e-9 and np.abs(high[:, 2] - 0.6).max() < 1e-9
    radius = np.linalg.norm(border[:, :2], axis=1)  # on the polygon of 40 sides
    assert radius.max() < 0.1 + 1e-9 and radius.min() > 0.1 * np.cos(np.pi / 40) - 1e-9
    outwards = np.einsum("ij,ij->i", kernels.face_normals(X, G)[:, :2], X[G].mean(1)[:, :2])
    assert (outwards > 0).all()


def test_a_closed_surface_stays_closed_and_creases_stay():
    cube = trimesh.creation.box([0.2, 0.2, 0.2])
    X, G = remesh(cube.vertices, cube.faces, 0.02)
    mesh = trimesh.Trimesh(X, G, process=False)
    assert mesh.is_watertight and mesh.volume == pytest.approx(0.008, rel=1e-6)


def test_scale_place_and_threads_change_nothing(tube, threads):
    V, F = tube
    X, G = remesh(V, F, 0.02)
    large, H = remesh(1024 * V, F, 1024 * 0.02)  # a power of two changes no bit
    assert np.array_equal(G, H) and np.array_equal(large, 1024 * X)
    far, H = remesh(V + [1e3, 0, -1e3], F, 0.02)
    assert len(far) == pytest.approx(len(X), rel=0.02) and sides(far, H).mean() == pytest.approx(
        sides(X, G).mean(), rel=0.01
    )
    for count in (1, 3):
        threads(count)
        again = remesh(V, F, 0.02)
        assert np.array_equal(again[0], X) and np.array_equal(again[1], G)


def test_isolated_vertices_and_repeated_faces_do_not_count(tube):
    V, F = tube
    X, G = remesh(V, F, 0.03)
    Y, H = remesh(np.r_[V, [[9.0, 9, 9]]], np.r_[F, F[:5], [[3, 3, 4]]], 0.03)
    assert np.array_equal(X, Y) and np.array_equal(G, H)


def test_a_side_without_length_shrinks_to_a_point(tube):
    V, F = tube
    corner = np.flatnonzero((F == 100).any(1))[0]
    at = list(F[corner]).index(100)
    x, y, new = (
        F[corner][at - 2],
        F[corner][at - 1],
        len(V),
    )  # face (100, x, y) gets a corner of its own in the same place
    G = np.r_[np.delete(F, corner, 0), [[new, x, y], [x, new, 100], [new, y, 100]]]
    X, H = remesh(np.r_[V, V[[100]]], G, 0.03)
    assert len(boundary_loops(H)) == 2 and sides(X, H).min() > 0.003
    assert SurfaceIndex(V, F).closest(X)[3].max() < 1e-6


SHEET = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize(
    "message, V, F, edge, options",
    [
        ("no surface", SHEET, [[0, 1, 2], [1, 0, 3], [0, 1, 4]], 0.1, {}),  # an edge of three faces
        ("no surface", SHEET, [[0, 1, 2], [1, 2, 3]], 0.1, {}),  # neighbours that run opposite ways
        ("no area", np.zeros((3, 3)) + [[0], [1], [2]], [[0, 1, 2]], 0.1, {}),
        ("10 million", SHEET, [[0, 1, 2]], 1e-5, {}),
        ("10 million", [[0.0, 0, 0], [1e9, 0, 0], [1e9, 1e-9, 0]], [[0, 1, 2]], 0.1, {}),  # a needle
        ("on a line", np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]]), [[0, 1, 2], [0, 3, 1]], 0.1, {}),
        ("edge is", SHEET, [[0, 1, 2]], 0.0, {}),
        ("edge is", SHEET, [[0, 1, 2]], np.nan, {}),
        ("iterations", SHEET, [[0, 1, 2]], 0.1, {"iterations": 0}),
        ("crease_angle", SHEET, [[0, 1, 2]], 0.1, {"crease_angle": 4.0}),
        (r"V\[0\]", SHEET * np.nan, [[0, 1, 2]], 0.1, {}),
    ],
)
def test_what_is_no_surface_or_no_length_is_refused(message, V, F, edge, options):
    with pytest.raises(InputError, match=message):
        remesh(V, F, edge, **options)
