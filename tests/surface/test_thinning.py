"""Laws of thinned scans."""

import numpy as np
import trimesh

from toile import kernels
from toile.scene import Mesh
from toile.surface.thinning import thinned


def ball(radius=0.3, **more):
    mesh = trimesh.creation.icosphere(6, radius)
    return Mesh(np.array(mesh.vertices), np.array(mesh.faces, np.int32), **more)


def test_a_ball_stays_a_closed_ball_of_fewer_faces():
    mesh, spacing = ball(), 0.03
    thin = thinned(mesh, spacing)
    assert len(thin.faces) < 0.2 * len(mesh.faces)
    assert np.abs(np.linalg.norm(thin.vertices, axis=1) - 0.3).max() < spacing**2
    assert kernels.SurfaceIndex(thin.vertices, thin.faces).closest(mesh.vertices)[3].max() < spacing**2 / 0.3
    outwards = np.einsum("mi,mi->m", thin.face_normals, thin.vertices[thin.faces].mean(1))
    area = kernels.face_areas(thin.vertices, thin.faces)
    assert area[outwards < 0].sum() < 0.005 * area.sum() and not kernels.boundary_loops(thin.faces)


def test_sheets_nearer_than_the_spacing_stay_apart():
    x, y = np.meshgrid(np.linspace(0, 1, 101), np.linspace(0, 1, 101))
    grid = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    i = (np.arange(100)[:, None] * 101 + np.arange(100)).ravel()
    up = np.concatenate([np.stack([i, i + 1, i + 102], 1), np.stack([i, i + 102, i + 101], 1)])
    two = Mesh(
        np.concatenate([grid, grid + [0, 0, 0.004]]), np.concatenate([up[:, ::-1], up + len(grid)]).astype(np.int32)
    )
    thin = thinned(two, 0.03)
    assert set(np.round(thin.vertices[:, 2], 9)) == {0.0, 0.004}


def test_labels_and_confidence_go_with_the_faces_and_vertices():
    mesh = ball()
    low = mesh.vertices[mesh.faces].mean(1)[:, 2] < 0
    whole = ball(face_labels=np.where(low, 1, 2).astype(np.uint8), confidence=np.full(len(mesh.vertices), 0.25))
    thin = thinned(whole, 0.03)
    height = thin.vertices[thin.faces].mean(1)[:, 2]
    assert len(thin.face_labels) == len(thin.faces) and (thin.face_labels[height < -0.03] == 1).all()
    assert (thin.face_labels[height > 0.03] == 2).all()
    np.testing.assert_allclose(thin.confidence, 0.25)


def test_no_face_is_listed_twice_and_none_has_a_corner_twice():
    thin = thinned(ball(0.05), 0.03)
    corners = np.sort(thin.faces, axis=1)
    assert (np.diff(corners, axis=1) > 0).all() and len(np.unique(corners, axis=0)) == len(corners)
