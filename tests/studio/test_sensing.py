"""Label errors, keypoints and scans on a ball, whose truth is known."""

import numpy as np
import pytest

from toile.studio.cameras import make_cameras
from toile.studio.keypoints import noisy, seen_by, swap_pairs
from toile.studio.labels import wrong_labels
from toile.studio.pictures import SyntheticView

RADIUS, CENTRE = 0.6, np.array([0.0, 0.0, 0.92])


def ball_view(camera):
    """A ball, upper half label 3, lower half 4, seen without lens distortion."""
    row, col = np.mgrid[: camera.height, : camera.width] + 0.5
    K = camera.K
    ray = np.stack([(col - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], np.ones_like(row)], -1)
    ray = ray @ camera.T_camera_world[:3, :3]
    o = camera.centre - CENTRE
    a, b, c = (ray**2).sum(-1), ray @ o, o @ o - RADIUS**2
    disc = b * b - a * c
    mask = disc > 0
    t = (-b - np.sqrt(np.where(mask, disc, 0))) / a
    points = (camera.centre + t[..., None] * ray)[mask]
    labels = np.zeros(mask.shape, np.uint8)
    labels[mask] = np.where(points[:, 2] > CENTRE[2], 3, 4)
    depth = np.where(mask, t, np.inf)
    return SyntheticView(np.zeros((*mask.shape, 3), np.uint8), mask, labels, depth, points)


@pytest.fixture(scope="module")
def views():
    cameras = make_cameras(6, 128, np.random.default_rng(0))
    return cameras, [ball_view(c) for c in cameras]


def test_label_errors_cover_the_asked_share_and_never_leave_the_mask(views):
    cameras, v = views
    images, share = wrong_labels(v, cameras, 0.10, np.random.default_rng(1))
    assert 0.10 <= share < 0.115
    for image, view in zip(images, v):
        assert np.array_equal(image > 0, view.mask)


def test_label_errors_agree_between_views(views):
    from scipy.spatial import cKDTree

    cameras, v = views
    images, share = wrong_labels(v, cameras, 0.10, np.random.default_rng(2))
    wrong = [(i != w.labels)[w.mask] for i, w in zip(images, v)]
    near, index = cKDTree(v[1].points).query(v[0].points)
    both = near < 0.008
    agreement = wrong[1][index[both]][wrong[0][both]].mean()
    assert agreement > 4 * share


def test_label_border_moves_by_no_more_than_six_pixels_without_blobs(views, monkeypatch):
    from toile.studio import labels

    cameras, v = views
    monkeypatch.setattr(labels, "MAX_BLOBS", 0)
    images, share = wrong_labels(v, cameras, 0.5, np.random.default_rng(3))
    assert share > 0.01
    row = np.nonzero((images[0] != v[0].labels).any(1))[0]
    border = np.nonzero((v[0].labels[:-1] == 3) & (v[0].labels[1:] == 4))[0]
    assert row.min() >= border.min() - 8 and row.max() <= border.max() + 8


class Table:
    names = ("body.wrist.L", "body.wrist.R", "face.nose_tip")
    thickness = np.array([0.0, 0.0, 0.0])
    pairs = swap_pairs(names)


def test_swap_pairs_match_sides_of_body_face_and_hands():
    names = ("body.wrist.L", "body.wrist.R", "hand_right.tip.R", "hand_left.tip.L", "face.chin")
    assert swap_pairs(names) == [(0, 1), (3, 2)]


def test_keypoints_behind_the_surface_have_confidence_zero(views):
    cameras, v = views
    towards = cameras[0].centre - CENTRE
    side = RADIUS * towards / np.linalg.norm(towards)
    points = np.array([CENTRE + 1.001 * side, CENTRE - 1.001 * side, CENTRE + 1.001 * side])
    out = noisy(Table, cameras[0], v[0].depth, points, 0.0, 0.0, np.random.default_rng(0))
    assert out[0, 2] > 0 and np.all(out[1] == 0)
    assert np.allclose(out[0, :2], cameras[0].project(points[0])[0])


def test_keypoint_noise_and_outliers_have_the_asked_size(views):
    cameras, v = views
    towards = cameras[0].centre - CENTRE
    points = np.repeat((CENTRE + 1.001 * RADIUS * towards / np.linalg.norm(towards))[None], 3, 0)
    points[1] += [0.05, 0, 0]
    uv = seen_by(cameras[0], v[0].depth, points, np.full(3, 0.1))[0]
    rng = np.random.default_rng(4)
    Table.thickness = np.full(3, 0.1)
    off = np.array([noisy(Table, cameras[0], v[0].depth, points, 2.0, 0.05, rng)[:, :2] - uv for _ in range(4000)])
    nose = off[:, 2]
    far = np.linalg.norm(nose, axis=1) > 8
    assert abs(far.mean() - 0.025) < 0.012  # the half of the outliers that is not a swap has no partner here
    assert abs(nose[~far].std() - 2.0) < 0.1


def test_scan_noise_has_the_asked_deviation_and_half_of_it_is_correlated():
    from toile.studio.scans import scan_noise

    rng = np.random.default_rng(0)
    V = rng.uniform(0, 0.5, (4000, 3))
    V = np.concatenate([V, V + 1e-4])
    d = scan_noise(V, 1e-3, rng)
    assert abs(d.std() - 1e-3) < 1e-4
    assert abs(np.corrcoef(d[:4000], d[4000:])[0, 1] - 0.5) < 0.1


def test_scan_of_a_ball_is_another_mesh_within_a_third_of_a_millimetre(monkeypatch):
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("open3d")
    from toile.studio import scans
    from toile.studio.pictures import OuterSurface

    monkeypatch.setattr(scans, "DEPTH", 7)

    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.25)
    outer = OuterSurface(np.asarray(ball.vertices), np.asarray(ball.faces), None, None)
    V, F = scans.scan(outer, 20_000, 0.0, 0.0, np.random.default_rng(0))
    assert abs(len(F) - 20_000) < 400
    assert np.abs(np.linalg.norm(V, axis=1) - 0.25).mean() < 3e-4
    left = scans.cut_holes(V, F, 0.05, np.random.default_rng(0))
    area, kept = (trimesh.Trimesh(V, f, process=False).area for f in (F, left))
    assert 0.05 <= 1 - kept / area < 0.07


def test_cameras_look_at_the_person_and_project_it_into_the_picture():
    cameras = make_cameras(8, 512, np.random.default_rng(0))
    for c in cameras:
        R = c.T_camera_world[:3, :3]
        assert np.allclose(R @ R.T, np.eye(3)) and np.linalg.det(R) > 0
        uv, depth = c.project(np.array([[0, 0, 0.02], [0, 0, 1.9], [-0.7, 0, 1.4], [0.7, 0, 1.4]]))
        assert (depth > 0).all() and (uv > 5).all() and (uv < 507).all()
        assert np.any(c.distortion != 0)
