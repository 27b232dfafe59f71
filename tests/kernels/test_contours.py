"""Contours: where a picture of a mesh jumps, and its gradient."""

import numpy as np
import pytest

from toile.kernels import Contours, InputError, face_neighbours, raster

K = np.array([[60.0, 0, 31], [0, 55.0, 25], [0, 0, 1]])
SIZE = (48, 64)
NEAR = 0.01


def seen(V, F, size=SIZE, near=NEAR, K=K):
    """The buffers of a mesh, and its contours."""
    view = raster(V, F, K, size, near_plane=near)
    return view, Contours(view.face, view.depth, V, F, face_neighbours(F), K, near)


def two_sheets():
    """A tilted square before a larger one, each with a centre vertex."""
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 0.1]])
    fan = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    front = 0.43 * corners + [0.013, 0.021, 1.7] + 0.2 * corners[:, :1] * [0, 0.3, 1]
    return np.concatenate([front, 0.8 * corners + [0.2, 0.1, 3]]), np.concatenate([fan, fan + 5])


def ball(rings, radius=0.4, distance=2.0):
    """A closed sphere of 2 rings^2 vertices about, its poles at left and right."""
    angle, turn = np.linspace(0, np.pi, rings + 1)[1:-1], np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False)
    ring = [
        np.stack([np.full(2 * rings, np.cos(a)), np.sin(a) * np.cos(turn), np.sin(a) * np.sin(turn)], 1) for a in angle
    ]
    V = np.concatenate([*ring, [[1.0, 0, 0], [-1, 0, 0]]])
    n, faces = 2 * rings, []
    for r in range(len(ring) - 1):
        for k in range(n):
            a, b, c, d = r * n + k, r * n + (k + 1) % n, (r + 1) * n + k, (r + 1) * n + (k + 1) % n
            faces += [[a, b, c], [b, d, c]]
    for k in range(n):
        faces += [
            [len(V) - 2, (k + 1) % n, k],
            [len(V) - 1, (len(ring) - 1) * n + k, (len(ring) - 1) * n + (k + 1) % n],
        ]
    return radius * V + [0.011, -0.017, distance], np.array(faces)


def screen(V):
    return (V @ K.T)[:, :2] / V[:, 2:]


def end_of_surface(face, start, step, V, F, neighbours):
    """Oracle, on exact-enough numbers: along the segment start..start + step on the screen, where the surface of `face`
    ends or turns back: (edge, point), None where it goes on."""
    xy, at = screen(V), 0.0
    side = np.array([-step[1], step[0]])
    came = None
    for _ in range(200):
        ways = []
        for k in range(3):
            i, j = F[face, (k + 1) % 3], F[face, (k + 2) % 3]
            di, dj = (xy[i] - start) @ side, (xy[j] - start) @ side
            if (di >= 0) == (dj >= 0) or {i, j} == came:
                continue
            share = di / (di - dj)
            ways.append((((1 - share) * xy[i] + share * xy[j] - start) @ step, i, j, k))
        if not ways:
            return None
        at, i, j, k = max(ways)
        if at > 1:
            return None
        beyond = neighbours[face, k]
        if beyond < 0:
            return {i, j}, start + at * step
        o = next(v for v in F[beyond] if v not in (i, j))
        area = [np.linalg.det(np.stack([xy[j] - xy[i], xy[v] - xy[i]])) for v in (F[face, k], o)]
        if area[0] * area[1] > 0:
            return {i, j}, start + at * step
        face, came = beyond, {i, j}
    return None


def by_hand(view, V, F):
    """{(a, b): (edge, point on the image)} by the oracle."""
    neighbours, found = face_neighbours(F), {}
    height, width = view.face.shape
    for r in range(height):
        for c in range(width):
            for dr, dc in ((0, 1), (1, 0)):
                if r + dr >= height or c + dc >= width:
                    continue
                p, q = view.face[r, c], view.face[r + dr, c + dc]
                if p == q or (p >= 0 and q >= 0 and set(F[p]) & set(F[q])):
                    continue
                step, start = np.array([dc, dr], float), np.array([c + 0.5, r + 0.5])
                ends = [
                    None if p < 0 else end_of_surface(p, start, step, V, F, neighbours),
                    None if q < 0 else end_of_surface(q, start + step, -step, V, F, neighbours),
                ]
                if view.depth[r + dr, c + dc] < view.depth[r, c]:
                    ends.reverse()
                end = ends[0] or ends[1]
                if end:
                    found[r * width + c, (r + dr) * width + c + dc] = end
    return found


@pytest.mark.parametrize("mesh", [two_sheets, lambda: ball(9), lambda: ball(40)])
def test_contours_are_those_of_a_plain_walk_over_the_surface(mesh):
    V, F = mesh()
    view, contours = seen(V, F)
    expected = by_hand(view, V, F)
    found = dict(zip(zip(contours.a.tolist(), contours.b.tolist()), range(len(contours.a))))
    assert found.keys() == expected.keys() and len(found) > 40
    points = (1 - contours.share)[:, None] * V[contours.edge[:, 0]] + contours.share[:, None] * V[contours.edge[:, 1]]
    for pair, e in found.items():
        edge, point = expected[pair]
        assert set(contours.edge[e]) == edge
        np.testing.assert_allclose(screen(points)[e], point, atol=1e-9)


def test_the_gradient_of_a_covered_area_is_that_of_its_polygon():
    V, F = np.array([[-0.31, -0.22, 1.0], [0.5, -0.1, 1.6], [0.05, 0.42, 1.3]]), np.array([[0, 1, 2]])
    fine, size = K * [[8], [8], [1]], (384, 512)
    view, contours = seen(V, F, size, K=fine)
    mask = (view.face >= 0)[None].astype(np.float32)
    ours = contours.gradient(mask, np.ones_like(mask))

    def area(V):
        a, b, c = (V @ fine.T)[:, :2] / V[:, 2:]
        return abs((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]) / 2

    step = 1e-6 * np.eye(9).reshape(9, 3, 3)
    true = np.array([area(V + s) - area(V - s) for s in step]).reshape(3, 3) / 2e-6
    np.testing.assert_allclose(ours, true, atol=0.01 * np.abs(true).max())


def test_each_contour_sends_half_the_slopes_times_the_jump_to_its_point():
    V, F = two_sheets()
    view, contours = seen(V, F)
    rng = np.random.default_rng(0)
    picture, g = rng.standard_normal((2, 3, *SIZE)).astype(np.float32)
    expected, flat, slope = np.zeros_like(V), picture.reshape(3, -1), g.reshape(3, -1)
    for a, b, below, (i, j), s in zip(contours.a, contours.b, contours.below, contours.edge, contours.share):
        x, y, z = (1 - s) * V[i] + s * V[j]
        gain = 0.5 * ((slope[:, a] + slope[:, b]).astype(float) * (flat[:, a] - flat[:, b])).sum()
        row = K[int(below)]
        force = gain * np.array([row[0] / z, row[1] / z, -(row[0] * x + row[1] * y) / z**2])
        expected[i] += (1 - s) * force
        expected[j] += s * force
    np.testing.assert_allclose(contours.gradient(picture, g), expected, rtol=1e-5, atol=1e-5)


def test_contours_beside_some_pixels_are_those_of_all_that_touch_one():
    V, F = two_sheets()
    view, everywhere = seen(V, F)
    of = np.random.default_rng(3).random(SIZE) < 0.02
    some = Contours(view.face, view.depth, V, F, face_neighbours(F), K, NEAR, of)
    touching = of.ravel()[everywhere.a] | of.ravel()[everywhere.b]
    assert 0 < touching.sum() < len(touching)
    for part in ("a", "b", "below", "edge", "share"):
        assert np.array_equal(getattr(some, part), getattr(everywhere, part)[touching])
    picture, g = np.random.default_rng(4).normal(size=(2, 3, *SIZE)).astype(np.float32)
    assert np.array_equal(some.gradient(picture, g * of), everywhere.gradient(picture, g * of))


def test_a_jump_that_is_not_finite_counts_as_none():
    V, F = two_sheets()
    view, contours = seen(V, F)
    assert np.isinf(view.depth).any()
    gradient = contours.gradient(view.depth[None], np.ones((1, *SIZE)))
    assert np.isfinite(gradient).all() and gradient.any()


def test_the_same_bits_for_any_number_of_threads(threads):
    V, F = ball(40)
    rng, answers = np.random.default_rng(1), []
    picture, g = rng.standard_normal((2, 3, *SIZE)).astype(np.float32)
    for count in (1, 4):
        threads(count)
        contours = seen(V, F)[1]
        answers.append((contours.a, contours.edge, contours.share, contours.gradient(picture, g)))
    for one, other in zip(*answers):
        assert np.array_equal(one, other)


@pytest.mark.parametrize("name", ["behind", "beside"])
def test_a_mesh_that_is_not_seen_has_no_contour_and_no_gradient(name):
    V, F = two_sheets()
    V = V * [1, 1, -1] if name == "behind" else V + [500, 0, 0]
    contours = seen(V, F)[1]
    assert len(contours.a) == 0 and contours.edge.shape == (0, 2)
    assert not contours.gradient(np.ones((1, *SIZE)), np.ones((1, *SIZE))).any()


def test_a_sheet_that_fills_the_picture_has_none():
    V = np.array([[-9.0, -9, 2], [9, -9, 2], [9, 9, 2], [-9, 9, 2]])
    assert len(seen(V, np.array([[0, 1, 2], [0, 2, 3]]))[1].a) == 0


def needles(V, F):
    tips = V[F[:, 0]] + 1e-9 * (V[F].mean(1) - V[F[:, 0]])
    new = len(V) + np.arange(len(F))
    fans = [np.column_stack([F[:, c], F[:, (c + 1) % 3], new]) for c in range(3)]
    return np.vstack([V, tips]), np.vstack(fans)


def degenerate(V, F):
    return V, np.vstack([F, F[:, [1, 0, 2]], np.stack([F[:, 0], F[:, 1], F[:, 1]], 1), np.stack([F[:, 0]] * 3, 1)])


def edge_on(V, F):
    return V * [1e-13, 1, 1], F


def through_the_camera(V, F):
    return V - [0, 0, 2.0], F


def huge(V, F):
    return np.vstack([V, [[1e30, 0, -1e30], [-1e30, 1e20, 1e30]]]), np.vstack([F, [[0, len(V), len(V) + 1]]])


@pytest.mark.parametrize("spoil", [needles, degenerate, edge_on, through_the_camera, huge])
@pytest.mark.parametrize("mesh", [two_sheets, lambda: ball(9)])
def test_ugly_meshes_give_shares_within_their_edges_and_finite_gradients(mesh, spoil):
    V, F = spoil(*mesh())
    contours = seen(V, F)[1]
    assert ((contours.share >= 0) & (contours.share <= 1)).all()
    rng = np.random.default_rng(2)
    assert np.isfinite(contours.gradient(*rng.standard_normal((2, 3, *SIZE)))).all()


@pytest.mark.parametrize(
    "change, words",
    [
        ({"face": np.full(SIZE, 8, np.int32)}, "contours: face has an index"),
        ({"face": np.zeros(3, np.int32)}, r"contours: face has shape \(3,\)"),
        ({"depth": np.ones((3, 4))}, "contours: depth and face differ in shape"),
        ({"V": two_sheets()[0] * np.nan}, "vertices_camera"),
        ({"F": two_sheets()[1] + 9}, "contours: F"),
        ({"neighbours": np.full((8, 3), 8)}, "contours: neighbours has an index"),
        ({"neighbours": np.zeros((2, 3), int)}, "contours: neighbours has 2 rows, F 8"),
        ({"K": np.zeros((3, 3))}, "contours: K is not a camera matrix"),
        ({"near": 0.0}, "contours: near_plane is 0"),
        ({"of": np.ones((3, 4), bool)}, r"contours: of has shape \(3, 4\) of bool, expected \(48, 64\)"),
        ({"of": np.zeros((0, 0), bool)}, r"contours: of has shape \(0, 0\)"),
        ({"of": np.ones(SIZE)}, r"contours: of has shape \(48, 64\) of float64"),
    ],
)
def test_bad_input_is_refused(change, words):
    V, F = two_sheets()
    view = raster(V, F, K, SIZE)
    given = {
        "face": view.face, "depth": view.depth, "V": V, "F": F, "neighbours": face_neighbours(F), "K": K, "near": NEAR,
        "of": None,
    } | change  # fmt: skip
    with pytest.raises(InputError, match=words):
        Contours(*given.values())


def test_pictures_of_another_size_are_refused():
    contours = seen(*two_sheets())[1]
    with pytest.raises(InputError, match=r"contours: g has shape \(1, 3, 4\)"):
        contours.gradient(np.ones((1, *SIZE)), np.ones((1, 3, 4)))
    with pytest.raises(InputError, match="contours: picture and g"):
        contours.gradient(np.ones((1, *SIZE)), np.ones((2, *SIZE)))


def test_neighbours_lie_beyond_edges_of_exactly_two_faces():
    F = np.array([[0, 1, 2], [1, 0, 3], [4, 1, 2], [2, 1, 5], [6, 7, 8]])  # the edge 1-2 has three
    expected = [[-1, -1, 1], [-1, -1, 0], [-1, -1, -1], [-1, -1, -1], [-1, -1, -1]]
    np.testing.assert_array_equal(face_neighbours(F), expected)
    assert face_neighbours(np.zeros((0, 3), int)).shape == (0, 3)
