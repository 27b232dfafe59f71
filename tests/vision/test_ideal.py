"""A reduced camera sees each point where the pictures' pixels that became one saw it."""

import numpy as np

from tests.support.rig import ring_of_cameras
from toile.vision.ideal import ideal, reduced


def test_a_reduced_camera_sees_points_at_the_same_places_of_its_larger_pixels():
    camera = ring_of_cameras(1, distortion=(0.0,) * 5).popitem()[1]
    v, u = np.mgrid[: camera.height, : camera.width]
    image, mask = np.repeat((v % 4 * 20 + u % 2 * 7)[..., None], 3, 2).astype(np.uint8), u > 5
    fine = ideal(camera, image, mask, 3)
    small, picture, inside = reduced(*fine, 2)
    points = np.random.default_rng(0).normal(0, 0.2, (50, 3))
    assert np.abs(2 * small.project(points)[0] - fine[0].project(points)[0]).max() < 1e-9
    assert picture.shape[:2] == inside.shape == (small.height, small.width) == (fine[0].height // 2, fine[0].width // 2)
    assert (picture[3, 4] == np.rint(fine[1][6:8, 8:10].mean((0, 1)))).all()
    four = fine[2][: 2 * small.height, : 2 * small.width].reshape(small.height, 2, -1, 2).sum((1, 3))
    assert (inside == (four >= 2)).all() and 0 < inside.mean() < 1


def test_a_reduction_of_one_changes_nothing():
    camera = ring_of_cameras(1, distortion=(0.0,) * 5).popitem()[1]
    image = np.random.default_rng(0).integers(0, 255, (camera.height, camera.width, 3)).astype(np.uint8)
    same = reduced(camera, image, image[..., 0] > 9, 1)
    assert (same[0].K == camera.K).all() and (same[1] == image).all() and (same[2] == (image[..., 0] > 9)).all()
