"""Pictures by fewer pixels, against the pixels that they keep."""

import numpy as np
import pytest

from tests.support.rig import ring_of_cameras
from toile.scene import Frame
from toile.vision.thin_pictures import thin_camera, thin_cameras, thin_pictures


@pytest.fixture(scope="module")
def camera():
    return next(iter(ring_of_cameras(1).values()))


@pytest.mark.parametrize("f", [1, 2, 3, 5])
def test_a_pixel_kept_shows_the_same_point(camera, f):
    thin = thin_camera(camera, -(-max(camera.size) // f))
    points = np.random.default_rng(0).uniform(-0.4, 0.4, (50, 3))
    at, depth = camera.project(points)
    again, same = thin.project(points)
    np.testing.assert_allclose(again - 0.5, (at - 0.5 - f // 2) / f, atol=1e-9)  # pixel i has its centre at i + 0.5
    np.testing.assert_array_equal(depth, same)
    v, u = np.mgrid[: camera.height, : camera.width]
    ramp = np.stack([u % 256, v % 256, u * 0 + 7], 2).astype(np.uint8)
    labels = (u // 40 + v // 40).astype(np.uint8)
    given = {"images": {"a": ramp}, "labels": {"a": labels}, "masks": {"a": labels > 5}}
    made = thin_pictures(Frame(0, None, **given), -(-max(camera.size) // f))
    assert made.labels["a"].shape == made.images["a"].shape[:2] == thin.size and max(thin.size) <= -(
        -max(camera.size) // f
    )
    np.testing.assert_array_equal(made.labels["a"], labels[f // 2 :: f, f // 2 :: f])
    np.testing.assert_array_equal(made.masks["a"], made.labels["a"] > 5)
    inner = slice(2, 256 // f - 2)  # a linear ramp is its own mean, but at its ends
    np.testing.assert_array_equal(made.images["a"][inner, inner], ramp[f // 2 :: f, f // 2 :: f][inner, inner])


def test_pictures_that_are_small_enough_stay_the_same_objects(camera):
    image = np.zeros((*camera.size, 3), np.uint8)
    frame = Frame(0, None, images={"a": image}, masks={"a": image[..., 0] > 0})
    assert thin_pictures(frame, max(camera.size)).images["a"] is image
    assert thin_cameras({"a": camera}, max(camera.size))["a"] is camera
