"""visibility and bilinear: points before a camera, and what its picture says there."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toile import kernels
from toile.scene import Camera

NO_NUMBER = [np.nan, np.inf]


def camera(seed=0, size=(48, 64)):
    """A tilted camera with every distortion, four metres before the origin."""
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(rng.normal(0, 0.2, 3)).as_matrix(), [0.1, -0.2, 4]
    K = np.array([[60.0, 0.3, 33], [0, 58, 25], [0, 0, 1]])
    return Camera("a", size[1], size[0], K, rng.normal(0, 0.02, 5), T)


def scene(n=500, seed=1):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3))
    return rng.normal(0, 1.2, (n, 3)), normals / np.linalg.norm(normals, axis=1, keepdims=True)


def see(c, points, normals, depth, tolerance=0.01, min_cosine=0.2):
    return kernels.visibility(points, normals, c.K, c.distortion, c.T_camera_world, depth, tolerance, min_cosine)


def test_pixels_and_clearance_are_those_of_the_camera():
    c, (points, normals) = camera(), scene()
    depth = np.random.default_rng(2).uniform(3, 5, c.size)
    uv, weight, clearance = see(c, points, normals, depth)
    expected, z = c.project(points)
    assert np.abs(uv - expected).max() < 1e-9
    inside = (z > 0) & (expected >= 0).all(1) & (expected < [c.width, c.height]).all(1)
    assert 50 < inside.sum() < len(points) and (clearance[~inside] == -np.inf).all()
    column, row = expected[inside].astype(int).T
    assert np.abs(clearance[inside] - (depth[row, column] - z[inside])).max() < 1e-12
    assert (weight[~inside] == 0).all()


def test_an_undistorted_view_shows_points_where_the_lens_does():
    c, (points, _) = camera(), scene()
    moved = kernels.undistorted_view(points, c.K, c.distortion, c.T_camera_world)
    expected, z = c.project(points)
    assert np.abs(moved[:, 2] - z).max() < 1e-12
    pixels = (moved / moved[:, 2:]) @ c.K.T
    front = z > 0.1
    assert front.mean() > 0.9 and np.abs(pixels[:, :2] - expected)[front].max() < 1e-9
    behind = kernels.undistorted_view([c.centre * 2], c.K, c.distortion, c.T_camera_world)
    assert behind[0, 2] < 0 and np.isfinite(behind).all()


def test_visible_is_what_faces_the_camera_and_lies_before_the_surface():
    c = camera()
    points = c.centre + np.outer([3.9, 4.0, 4.02, 4.1], (-c.centre) / np.linalg.norm(c.centre))
    towards = np.tile(c.centre / np.linalg.norm(c.centre), (4, 1))
    z = c.to_camera(points)[1, 2]
    depth = np.full(c.size, z)
    assert np.allclose(see(c, points, towards, depth, 0.03)[1], [1, 1, 1, 0])
    assert np.allclose(see(c, points, -towards, depth, 0.03)[1], 0)
    assert np.allclose(see(c, points, towards, np.full(c.size, np.inf), 0.03)[1], 0)  # the picture shows no surface
    axis = np.cross(towards[0], [0, 0, 1])
    aslant = towards @ Rotation.from_rotvec(axis / np.linalg.norm(axis)).as_matrix().T  # by one radian
    assert np.allclose(see(c, points[:2], aslant[:2], depth)[1], np.cos(1.0))
    assert np.allclose(see(c, points[:2], aslant[:2], depth, min_cosine=0.6)[1], 0)


def test_a_linear_picture_is_read_exactly_and_goes_on_beyond_its_border():
    row, column = np.mgrid[0:30, 0:40]
    image = np.stack([column + 0.5, row + 0.5, np.ones((30, 40))], 2)
    uv = np.random.default_rng(0).uniform([0.5, 0.5], [39.5, 29.5], (200, 2))
    assert np.abs(kernels.bilinear(image, uv)[:, :2] - uv).max() < 2e-3  # the last pixel is cut by 0.001
    assert kernels.bilinear(image, uv).dtype == np.float32
    far = kernels.bilinear(image, np.array([[-9.0, 3.5], [99, 3.5], [5, -1e9], [5, 1e9]]))
    assert np.abs(far[:, :2] - [[0.5, 3.5], [39.5, 3.5], [5, 0.5], [5, 29.5]]).max() < 2e-3
    assert (
        np.allclose(far[:, 2], 1)
        and np.isfinite(kernels.bilinear(image, np.array([[np.nan, 1.0], [np.inf, -np.inf]]))).all()
    )


def test_threads_do_not_change_a_bit(threads):
    c, (points, normals) = camera(), scene(5000)
    depth, image = np.random.default_rng(2).uniform(3, 5, c.size), np.random.default_rng(3).random((48, 64, 7))
    answers = []
    for n in (1, 2, 3, 8):
        threads(n)
        uv, weight, clearance = see(c, points, normals, depth)
        answers.append((uv, weight, clearance, kernels.bilinear(image, uv)))
    for other in answers[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(answers[0], other))


@pytest.mark.parametrize("value", NO_NUMBER)
def test_bad_input_is_refused_by_name(value):
    c, (points, normals) = camera(), scene(10)
    depth, bad = np.ones(c.size), points.copy()
    bad[4, 1] = value
    with pytest.raises(kernels.InputError, match=r"visibility: points\[4\] is not finite"):
        see(c, bad, normals, depth)
    with pytest.raises(kernels.InputError, match="visibility: normals has 9 rows, points 10"):
        see(c, points, normals[:9], depth)
    with pytest.raises(kernels.InputError, match="visibility: tolerance is"):
        see(c, points, normals, depth, tolerance=value)
    with pytest.raises(kernels.InputError, match="visibility: min_cosine is"):
        see(c, points, normals, depth, min_cosine=0.0)
    with pytest.raises(kernels.InputError, match=r"visibility: depth has shape \(48,\)"):
        see(c, points, normals, depth[:, 0])
    with pytest.raises(kernels.InputError, match="bilinear: the picture is 1 x 9 pixels"):
        kernels.bilinear(np.zeros((1, 9, 3)), np.zeros((2, 2)))
    with pytest.raises(kernels.InputError, match=r"bilinear: image has shape \(9, 9\)"):
        kernels.bilinear(np.zeros((9, 9)), np.zeros((2, 2)))
    with pytest.raises(kernels.InputError, match="bilinear: image is not an array"):
        kernels.bilinear([[[1.0]], [[1.0], [2.0]]], np.zeros((2, 2)))
    with pytest.raises(kernels.InputError, match=r"bilinear: uv has shape \(2, 3\)"):
        kernels.bilinear(np.zeros((9, 9, 1)), np.zeros((2, 3)))


def labels_of(seed, size=(40, 56)):
    """Patches of labels 0 to 4."""
    rng = np.random.default_rng(seed)
    return np.kron(rng.integers(0, 5, (size[0] // 8, size[1] // 8)), np.ones((8, 8))).astype(np.uint8)


@pytest.mark.parametrize("blur", [0.8, 3.0, 15.0])
def test_soft_labels_are_opencvs_blur_of_each_indicator(blur):
    import cv2

    labels, ids = labels_of(3), np.array([1, 2, 4], np.uint8)
    soft = kernels.soft_labels(labels, ids, blur)
    side = 2 * round(4 * blur) + 1
    expected = cv2.GaussianBlur((labels[..., None] == ids).astype(np.float64), (side, side), blur)
    assert soft.shape == (*labels.shape, 3) and np.abs(soft - expected).max() < 1e-6


@pytest.mark.parametrize("ids", [[1, 300], np.array([1, 300]), np.array([1, -1]), np.array([1.0, 2.5])])
def test_a_label_id_that_no_picture_holds_is_refused_and_not_taken_for_another(ids):
    for kernel, call in (
        ("soft_labels", lambda: kernels.soft_labels(labels_of(0), ids, 1.0)),
        (
            "evidence_picture",
            lambda: kernels.evidence_picture(labels_of(0), ids, labels_of(0) < 0, None, None, 1.0, 1.0),
        ),
    ):
        with pytest.raises(kernels.InputError, match=f"^{kernel}: ids"):
            call()


def test_an_evidence_picture_lays_its_channels_side_by_side():
    labels, ids, rng = labels_of(4), np.array([1, 2, 3], np.uint8), np.random.default_rng(4)
    clear, rgb = rng.random(labels.shape) < 0.5, rng.integers(0, 256, (*labels.shape, 3)).astype(np.uint8)
    likelihood = rng.normal(size=(clear.sum(), 3)).astype(np.float32)
    picture = kernels.evidence_picture(labels, ids, clear, likelihood, rgb, 2.0, 1.0)
    assert picture.shape == (*labels.shape, 10)
    np.testing.assert_array_equal(picture[clear, :3], likelihood)
    assert not picture[~clear, :3].any()
    np.testing.assert_array_equal(picture[..., 3:6], kernels.soft_labels(labels, ids, 2.0))
    np.testing.assert_array_equal(picture[..., 6:9], rgb.astype(np.float32) / np.float32(255))
    np.testing.assert_array_equal(picture[..., 9:], kernels.soft_labels(labels, [0], 1.0))
    bare = kernels.evidence_picture(labels, ids, np.zeros_like(clear), None, None, 2.0, 1.0)
    assert not bare[..., :3].any() and not bare[..., 6:9].any()
    np.testing.assert_array_equal(bare[..., 3:6], picture[..., 3:6])


@pytest.mark.parametrize(
    "change, named",
    [
        ({"labels": labels_of(0).astype(int)}, "labels"),
        ({"labels": labels_of(0)[:0]}, "labels"),
        ({"ids": []}, "ids"),
        ({"blur": 0.0}, "blur"),
        ({"empty_blur": np.nan}, "blur"),
        ({"clear": np.ones((3, 4), bool)}, "clear"),
        ({"likelihood": np.zeros((2, 3))}, "likelihood"),
        ({"rgb": np.zeros((2, 2, 3), np.uint8)}, "rgb"),
    ],
)
def test_an_evidence_picture_names_the_argument_that_is_wrong(change, named):
    labels = labels_of(0)
    sound = {"labels": labels, "ids": [1, 2, 3], "clear": np.ones(labels.shape, bool), "blur": 2.0, "empty_blur": 1.0}
    likelihood, rgb = np.zeros((labels.size, 3)), np.zeros((*labels.shape, 3), np.uint8)
    with pytest.raises(kernels.InputError, match=named):
        kernels.evidence_picture(**sound | {"likelihood": likelihood, "rgb": rgb} | change)


@pytest.mark.parametrize("lens", [[-0.3, 0, 0, 0, 0], [-0.3, 0, 0.004, -0.003, 0], [-0.28, 0.09, 0, 0, -0.01]])
def test_what_a_lens_folds_back_into_the_picture_is_seen_in_none(lens):
    K, T, size = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), np.eye(4), (480, 640)
    r = np.linspace(0, 9, 901)
    turn = r[np.flatnonzero(np.diff(r * (1 + lens[0] * r**2 + lens[1] * r**4 + lens[4] * r**6)) < 0)[0]]
    for angle in np.linspace(0, 6, 13):
        points = np.stack([r * np.cos(angle), r * np.sin(angle), np.ones_like(r)], 1)
        weight = kernels.visibility(points, -points, K, lens, T, np.ones(size), 0.01, 0.1)[1]
        moved = kernels.undistorted_view(points, K, lens, T)
        assert (weight[r > turn + 0.02] == 0).all() and (weight[r < 0.4] > 0).all()
        out = np.linalg.norm(moved[:, :2], axis=1)
        assert (np.maximum.accumulate(out) - out).max() < 4e-4  # what the tangential terms may take back
        pixels = (moved @ K.T)[r > turn + 0.3, :2]
        assert ((pixels < 0) | (pixels >= [640, 480])).any(1).all()
