"""Triangulation on synthetic cameras."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.rig import ring_of_cameras
from tests.support.shapes import tube
from toile.config import ReconstructSettings
from toile.errors import UserError
from toile.io.skeletons import rows_of
from toile.scene import Camera, Frame, Keypoints, Mesh, Points3D
from toile.stages.reconstruct import LIMBS, agreement, check_with_scans, triangulate
from toile.surface.keypoints import mirrored
from toile.surface.operators import compact


def observe(cameras, points, rng, noise=0.0, outliers=0.0, unseen=0.0):
    seen = {}
    for name, camera in cameras.items():
        uv, _ = camera.project(points)
        uv = uv + noise * rng.standard_normal(uv.shape)
        wrong = rng.random(len(points)) < outliers
        uv[wrong] = rng.uniform(0, 512, (wrong.sum(), 2))
        seen[name] = np.column_stack([uv, rng.random(len(points)) >= unseen])
    return Keypoints(tuple(f"body.p{i}" for i in range(len(points))), seen)


def points(rng, k=100):
    return np.column_stack([rng.uniform(-0.5, 0.5, (k, 2)), rng.uniform(0.0, 1.8, k)])


def test_exact_pixels_give_exact_points():
    rng = np.random.default_rng(0)
    X = points(rng)
    result = triangulate(observe(ring_of_cameras(8), X, rng), ring_of_cameras(8), ReconstructSettings())
    np.testing.assert_allclose(result.points, X, atol=1e-8)
    assert (result.views == 8).all()


@pytest.mark.parametrize("outliers", [0.05, 0.2])
def test_noise_and_outliers_leave_points_within_their_stated_sigma(outliers):
    rng = np.random.default_rng(1)
    X, cameras = points(rng, 400), ring_of_cameras(8)
    result = triangulate(observe(cameras, X, rng, 2.0, outliers, unseen=0.1), cameras, ReconstructSettings())
    error = np.linalg.norm(result.points - X, axis=1)
    found = np.isfinite(error)
    assert found.mean() > 0.98
    # 2 px at 2.5 m / 560 px are 9 mm a view, about 6 mm in space from eight views
    assert np.sqrt(np.mean(error[found] ** 2)) < 0.009
    assert np.mean(error[found] < 2.5 * result.sigma[found]) > 0.97
    assert error[found].max() < 0.05


def test_swapped_left_and_right_in_two_views_are_rejected():
    rng = np.random.default_rng(2)
    X, cameras = points(rng, 20), ring_of_cameras(8)
    keypoints = observe(cameras, X, rng, 1.0)
    swap = np.arange(20) ^ 1  # neighbours change places, as left and right do
    for name in ("cam1", "cam4"):
        keypoints.points[name][:] = keypoints.points[name][swap]
    result = triangulate(keypoints, cameras, ReconstructSettings())
    assert np.linalg.norm(result.points - X, axis=1).max() < 0.012
    assert (result.views <= 7).all() and np.median(result.views) == 6


def test_points_that_no_two_views_agree_on_are_nan():
    rng = np.random.default_rng(3)
    X, cameras = points(rng, 30), ring_of_cameras(6)
    keypoints = observe(cameras, X, rng, 1.0)
    for i, seen in enumerate(keypoints.points.values()):
        seen[:10, 2] = i == 0  # one view only
        seen[10:20, 2] = 0
    result = triangulate(keypoints, cameras, ReconstructSettings())
    assert np.isnan(result.points[:20]).all() and np.isfinite(result.points[20:]).all()
    assert np.isinf(result.sigma[:20]).all()


def test_rigid_motion_of_world_moves_points_alike():
    rng = np.random.default_rng(4)
    X, cameras = points(rng, 40), ring_of_cameras(8)
    keypoints = observe(cameras, X, rng, 2.0, 0.1)
    c, s = np.cos(0.7), np.sin(0.7)
    T = np.array([[c, -s, 0, 3], [s, c, 0, -20], [0, 0, 1, 5], [0, 0, 0, 1.0]])
    moved = {
        n: Camera(n, 512, 512, cam.K, cam.distortion, cam.T_camera_world @ np.linalg.inv(T))
        for n, cam in cameras.items()
    }
    a = triangulate(keypoints, cameras, ReconstructSettings()).points
    b = triangulate(keypoints, moved, ReconstructSettings()).points
    np.testing.assert_allclose(b, a @ T[:3, :3].T + T[:3, 3], atol=1e-8)


def test_many_views_draw_pairs_by_seed_and_stay_robust():
    rng = np.random.default_rng(5)
    X, cameras = points(rng, 30), ring_of_cameras(24)
    keypoints = observe(cameras, X, rng, 2.0, 0.2)
    first = triangulate(keypoints, cameras, ReconstructSettings())
    again = triangulate(keypoints, cameras, ReconstructSettings())
    assert np.array_equal(first.points, again.points)
    assert np.linalg.norm(first.points - X, axis=1).max() < 0.015


def test_unknown_camera_is_refused_by_name():
    rng = np.random.default_rng(6)
    cameras = ring_of_cameras(4)
    keypoints = observe(cameras, points(rng, 5), rng)
    del cameras["cam2"]
    with pytest.raises(UserError, match="cam2"):
        triangulate(keypoints, cameras, ReconstructSettings())


def person(rng, cameras, noise=1.0):
    """Detections of a body and its hands, each side 0.2 to 0.5 m from the middle."""
    names = tuple(rows_of("coco_wholebody133"))
    X = points(rng, len(names))
    side = np.array([{"L": 1.0, "R": -1.0}.get(name[-1], 0.0) if "." in name[-2:] else 0.0 for name in names])
    X[:, 0] = np.where(side == 0, 0, side * rng.uniform(0.2, 0.5, len(names)))
    seen = observe(cameras, X, rng, noise).points
    return X, Keypoints(names, seen)


def swapped(keypoints, view, prefixes):
    rows = [i for i, name in enumerate(keypoints.names) if name.startswith(prefixes)]
    other = [keypoints.names.index(mirrored(keypoints.names[i])) for i in rows]
    keypoints.points[view][rows] = keypoints.points[view][other]


@pytest.mark.parametrize("prefixes", ["", *LIMBS])
def test_sides_that_few_views_swap_are_turned_back_and_all_views_count(prefixes):
    cameras = ring_of_cameras(6)
    X, keypoints = person(np.random.default_rng(5), cameras)
    for view in ("cam1", "cam4"):
        swapped(keypoints, view, prefixes)
    result = triangulate(keypoints, cameras, ReconstructSettings())
    assert np.linalg.norm(result.points - X, axis=1).max() < 0.015 and (result.views >= 5).all()
    shares = agreement(keypoints, result, cameras, ReconstructSettings())
    assert set(shares) == set(cameras) and min(shares.values()) > 0.95


def test_hands_held_together_are_left_as_they_are():
    cameras = ring_of_cameras(6)
    rng = np.random.default_rng(6)
    X, keypoints = person(rng, cameras)
    X[:, 0] *= 0.01
    together = observe(cameras, X, rng, 0.5).points
    plain = triangulate(Keypoints(keypoints.names, together), cameras, ReconstructSettings())
    nameless = Keypoints(tuple(f"body.p{i}" for i in range(len(X))), together)
    assert np.array_equal(plain.points, triangulate(nameless, cameras, ReconstructSettings()).points)


def test_a_view_of_somebody_else_agrees_with_no_other():
    cameras = ring_of_cameras(6)
    rng = np.random.default_rng(7)
    X, keypoints = person(rng, cameras)
    keypoints.points["cam2"][:, :2] = observe(cameras, X + [1.0, 0.5, 0], rng).points["cam2"][:, :2]
    shares = agreement(
        keypoints, triangulate(keypoints, cameras, ReconstructSettings()), cameras, ReconstructSettings()
    )
    assert shares.pop("cam2") < 0.1 and min(shares.values()) > 0.95


def standing(scan_moved=(0, 0, 0), scan_above=0.0):
    """A frame with keypoints inside of a pipe 1.8 m long, and a scan of it, of what is above a height, moved."""
    V, F = tube(60, 40, 0.15, 1.8)
    X = V[::20] * [0.7, 0.7, 1]
    shown = F[(V[F][:, :, 2] >= scan_above).all(1)]
    frame = Frame(0, Mesh(*compact(V + scan_moved, shown)))
    return frame, Points3D(tuple(map(str, range(len(X)))), X, np.zeros(len(X)), np.full(len(X), 4))


def test_a_scan_beside_the_keypoints_is_refused_and_one_of_a_part_is_not():
    settings = ReconstructSettings()
    check_with_scans([standing(), standing(scan_above=1.4)], settings)
    with pytest.raises(UserError, match="half of the keypoints lie 0.* m and more from the scan"):
        check_with_scans([standing([0.5, 0, 0]), standing([0, 0.6, 0])], settings)
    frame, points = standing()
    with pytest.raises(UserError, match="same units"):  # cameras in centimetres: the scan is no part of that person
        check_with_scans([(frame, replace(points, points=100 * points.points))], settings)
    check_with_scans([standing([0.5, 0, 0]), standing()], settings)  # one frame alone is judged by itself
