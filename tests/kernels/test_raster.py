"""Laws of `raster`: exact coverage, depth of the plane, no cracks, the same bits for any number of threads."""

import numpy as np
import pytest

from toile.kernels import InputError, raster

K = np.array([[50.0, 0.0, 20.5], [0.0, 45.0, 14.25], [0.0, 0.0, 1.0]])
SIZE = (30, 40)
UNIT = np.eye(3)  # with z = 1 the image position is (x, y) itself


def random_soup(n, seed, near=0.5, far=4.0):
    rng = np.random.default_rng(seed)
    z = rng.uniform(near, far, (n, 3))
    u, v = rng.uniform(-10, 50, (n, 3)), rng.uniform(-10, 40, (n, 3))
    V = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], -1).reshape(-1, 3)
    return V, np.arange(3 * n).reshape(-1, 3)


def traced(V, F, size, near=1e-9):
    """Plain reference: every ray against every face; also the least normalised barycentric, to spot rays on edges."""
    i, j = np.mgrid[: size[0], : size[1]]
    D = np.stack([j + 0.5, i + 0.5, np.ones(size)], -1) @ np.linalg.inv(K).T
    face, depth, closeness = np.full(size, -1), np.full(size, np.inf), np.full(size, np.inf)
    for f, (a, b, c) in enumerate(V[F]):
        w = np.stack([D @ np.cross(b, c), D @ np.cross(c, a), D @ np.cross(a, b)], -1)
        with np.errstate(all="ignore"):
            z = np.dot(a, np.cross(b, c)) / w.sum(-1)
            w = w / w.sum(-1, keepdims=True)
        closeness = np.minimum(closeness, np.abs(w).min(-1))
        hit = (w > 0).all(-1) & (z > near) & (z < depth)
        face[hit], depth[hit] = f, z[hit]
    return face, depth, closeness


def quads(nu, nv, V):
    a = (np.arange(nv)[:, None] * (nu + 1) + np.arange(nu)).ravel()
    return np.concatenate([np.c_[a, a + 1, a + nu + 2], np.c_[a, a + nu + 2, a + nu + 1]]), V


def cover_counts(V, F, size, camera=K):
    """How many of the faces cover each pixel, each drawn alone."""
    return sum((raster(V, F[f : f + 1], camera, size).face == 0).astype(int) for f in range(len(F)))


def test_raster_pixel_centres_lie_at_one_half():
    V = np.array([[1.4, 2.4, 1], [1.6, 2.4, 1], [1.6, 2.6, 1], [1.4, 2.6, 1]])  # a small square around (1.5, 2.5)
    face = raster(V, [[0, 1, 2], [0, 2, 3]], UNIT, (5, 4)).face
    assert np.argwhere(face >= 0).tolist() == [[2, 1]]


def test_raster_top_left_edges_own_their_centres():
    V = np.array([[0.5, 0.5, 1], [2.5, 0.5, 1], [2.5, 2.5, 1], [0.5, 2.5, 1]])
    for F in ([[0, 1, 2], [0, 2, 3]], [[0, 2, 1], [0, 3, 2]]):
        covered = raster(V, F, UNIT, (4, 4)).face >= 0
        assert np.argwhere(covered).tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]]


def test_raster_agrees_with_ray_tracing_of_every_pixel():
    V, F = random_soup(40, seed=1)
    result = raster(V, F, K, SIZE)
    face, depth, closeness = traced(V, F, SIZE)
    sure = closeness > 2e-3
    assert sure.mean() > 0.7 and (face >= 0).mean() > 0.5
    assert (result.face == face)[sure].all()
    seen = sure & (face >= 0)
    np.testing.assert_allclose(result.depth[seen], depth[seen], rtol=1e-12)
    assert np.isinf(result.depth[result.face < 0]).all()
    assert result.face.dtype == np.int32 and result.depth.dtype == np.float64 and result.barycentric is None


def test_raster_clips_faces_that_cross_the_near_plane_and_the_camera():
    V, F = random_soup(30, seed=2, near=-2.0, far=3.0)
    result = raster(V, F, K, SIZE, near_plane=0.05)
    face, depth, closeness = traced(V, F, SIZE, near=0.05)
    sure = (closeness > 2e-3) & (np.abs(depth - 0.05) > 1e-3)
    assert (face >= 0).mean() > 0.3
    assert (result.face == face)[sure].mean() > 0.999
    both = sure & (face >= 0) & (result.face == face)
    np.testing.assert_allclose(result.depth[both], depth[both], rtol=1e-10)


@pytest.mark.parametrize("grid", ["on pixel centres", "random"])
def test_raster_shared_edges_neither_crack_nor_double(grid):
    n = 6
    u, v = np.meshgrid(np.linspace(2.5, 26.5, n + 1), np.linspace(2.5, 20.5, n + 1))
    z = np.ones_like(u)
    if grid == "random":
        rng = np.random.default_rng(3)
        inner = (slice(1, -1), slice(1, -1))
        u[inner] += rng.uniform(-1.4, 1.4, u[inner].shape)
        v[inner] += rng.uniform(-1.2, 1.2, v[inner].shape)
        z = rng.uniform(0.5, 3, u.shape)
    F, V = quads(n, n, np.stack([u * z, v * z, z], -1).reshape(-1, 3))
    counts = cover_counts(V, F, (24, 30), UNIT)
    expected = np.zeros((24, 30), int)
    expected[2:20, 2:26] = (
        1  # centres on the left and top border belong to the sheet, on the right and bottom they do not
    )
    assert (counts == expected).all()


def test_raster_a_floor_through_the_near_plane_has_no_crack():
    x, z = np.meshgrid(np.linspace(-40, 40, 9), np.linspace(-3, 60, 9))
    F, V = quads(8, 8, np.stack([x, np.full_like(x, 0.4), z], -1).reshape(-1, 3))
    counts = cover_counts(V, F, SIZE)
    i, j = np.mgrid[: SIZE[0], : SIZE[1]]
    distance = 0.4 * K[1, 1] / (i + 0.5 - K[1, 2])  # where the ray of row i meets the floor y = 0.4
    inside = (distance > 0) & (distance < 59.9) & (np.abs((j + 0.5 - K[0, 2]) / K[0, 0] * distance) < 39.9)
    assert inside.sum() > 300 and (counts[inside] == 1).all() and counts.max() == 1
    result = raster(V, F, K, SIZE)
    np.testing.assert_allclose(result.depth[inside], distance[inside], rtol=1e-9)


def test_raster_depth_is_perspective_correct_and_barycentrics_give_the_point():
    V = np.array([[-1.0, -0.5, 1.0], [1.2, -0.4, 5.0], [0.0, 0.9, 2.0]])
    result = raster(V, [[0, 1, 2]], K, SIZE, barycentric=True)
    i, j = np.nonzero(result.face == 0)
    assert len(i) > 100
    normal = np.cross(V[1] - V[0], V[2] - V[0])
    ray = np.c_[j + 0.5, i + 0.5, np.ones(len(i))] @ np.linalg.inv(K).T
    np.testing.assert_allclose(result.depth[i, j], normal @ V[0] / (ray @ normal), rtol=1e-12)
    np.testing.assert_allclose(result.barycentric[i, j] @ V, ray * result.depth[i, j, None], atol=1e-3)
    interior = result.barycentric[i, j].min(1) > 1e-3
    np.testing.assert_allclose(
        (result.barycentric[i, j] @ V)[interior], (ray * result.depth[i, j, None])[interior], atol=1e-12
    )
    np.testing.assert_allclose(result.barycentric[i, j].sum(1), 1)
    assert (result.barycentric[result.face < 0] == 0).all()


def test_raster_equal_depths_go_to_the_lower_face():
    V, F = random_soup(20, seed=4)
    F = np.concatenate([F, F[:, [1, 2, 0]], F[:, [0, 2, 1]]])
    assert raster(V, F, K, SIZE).face.max() < 20
    backwards = raster(V, F[::-1], K, SIZE)
    assert backwards.face.max() < 20
    np.testing.assert_array_equal(backwards.depth, raster(V, F, K, SIZE).depth)


def test_raster_faces_behind_the_camera_and_of_no_area_leave_the_image_empty():
    V = np.array([[0, 0, -1], [1, 0, -1], [0, 1, -2], [0, 0, 1], [1, 1, 1], [2, 2, 1]], float)
    result = raster(V, [[0, 1, 2], [3, 4, 5], [3, 3, 4]], K, SIZE)
    assert (result.face == -1).all() and np.isinf(result.depth).all()


def test_raster_bits_do_not_depend_on_threads(threads):
    V, F = random_soup(3000, seed=5, near=-0.2)
    results = []
    for n in (1, 2, 3, 8):
        threads(n)
        r = raster(V, F, K * [[8], [8], [1]], (240, 320), barycentric=True)
        results.append((r.face.tobytes(), r.depth.tobytes(), r.barycentric.tobytes()))
    assert all(r == results[0] for r in results)


@pytest.mark.parametrize("scale", [1e-6, 1e3])
def test_raster_does_not_depend_on_the_unit(scale):
    V, F = random_soup(40, seed=6)
    one, other = raster(V, F, K, SIZE), raster(V * scale, F, K, SIZE)
    assert (one.face == other.face).mean() > 0.999  # a corner may round to the neighbouring 1/4096 px
    same = one.face == other.face
    np.testing.assert_allclose(other.depth[same], one.depth[same] * scale, rtol=1e-9)


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(V=np.array([[0, 0, 1], [np.nan, 0, 1], [0, 1, 1]])), r"vertices_camera\[1\] is not finite"),
        (dict(V=np.zeros((0, 3))), "vertices_camera is empty"),
        (dict(F=np.zeros((0, 3), int)), "F is empty"),
        (dict(F=[[0, 1, 3]]), r"F\[0\] holds vertex 3"),
        (dict(F=[[0.0, 1.0, 2.0]]), "F has dtype"),
        (dict(K=np.diag([0.0, 1, 1])), "focal"),
        (dict(K=np.array([[1, 0, 0], [0, 1, 0], [0, 0, np.inf]])), r"K\[2\] is not finite"),
        (dict(K=np.array([[1, 0, 0], [0, 1, 0], [0, 0, 2.0]])), r"K\[2\]"),
        (dict(size=(0, 5)), r"size is \(0, 5\)"),
        (dict(size=(5, 40000)), r"size is \(5, 40000\)"),
        (dict(size=(5.5, 4)), "size"),
        (dict(near_plane=0.0), "near_plane"),
    ],
)
def test_raster_refuses_bad_input_by_name(change, message):
    arguments = dict(V=np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]), F=[[0, 1, 2]], K=K, size=SIZE) | change
    V, F, camera, size = (arguments.pop(name) for name in ("V", "F", "K", "size"))
    with pytest.raises(InputError, match=message):
        raster(V, F, camera, size, **arguments)


def test_raster_unknown_option_is_a_type_error():
    with pytest.raises(TypeError, match="culling"):
        raster([[0, 0, 1], [1, 0, 1], [0, 1, 1]], [[0, 1, 2]], K, SIZE, culling=True)
