"""The intersection checks at the edges of what they may be given: *solved* rows give the clean answer, *refused* rows name what
is wrong. (untangle's file holds more of them, after a solve.)"""

import numpy as np
import pytest

from toile.kernels import (
    InputError,
    SurfaceIndex,
    intersecting_pairs,
    self_intersections,
    signed_distance,
    winding_number,
)

from . import ugly
from .test_nricp import put
from .test_untangle import ball

A, F = ball(0.2)
B = A @ np.diag([1.3, 0.8, 0.9]) + [0.031, 0.017, -0.012]
POINTS = np.random.default_rng(0).uniform(-0.35, 0.35, (400, 3))


@pytest.mark.parametrize("scale", [1e-25, 1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e25])
def test_intersect_solved_in_any_unit(scale):
    s = 2.0 ** np.round(np.log2(scale))  # exact, so that the predicates see the same triangles
    np.testing.assert_array_equal(intersecting_pairs(s * A, F, s * B, F), intersecting_pairs(A, F, B, F))
    np.testing.assert_allclose(signed_distance(s * POINTS, s * A, F) / s, signed_distance(POINTS, A, F), atol=1e-9)
    np.testing.assert_allclose(winding_number(s * POINTS, s * A, F), winding_number(POINTS, A, F), atol=1e-9)


@pytest.mark.parametrize("offset", [1e3, 1e6])
def test_intersect_solved_far_from_the_origin(offset):
    far = [x + offset for x in (POINTS, A)]
    np.testing.assert_allclose(signed_distance(*far, F), signed_distance(POINTS, A, F), atol=1e-8)
    np.testing.assert_allclose(winding_number(*far, F), winding_number(POINTS, A, F), atol=1e-4)


@pytest.mark.parametrize("spoil", [ugly.zero_area, ugly.all_faces_twice, ugly.some_faces_twice, ugly.isolated, ugly.soup, ugly.seam,
                                   ugly.flipped, ugly.needles, ugly.both_sides])  # fmt: skip
def test_intersect_pairs_solved_on_ugly_meshes(spoil):
    """Vertices of B that take part, whatever the numbering of the faces of A."""
    touched = lambda V, G: np.unique(intersecting_pairs(V, G, B, F)[:, 1])
    np.testing.assert_array_equal(touched(*spoil(A, F)), touched(A, F))


@pytest.mark.parametrize("spoil", [ugly.zero_area, ugly.isolated, ugly.flipped, ugly.needles,
                                   ugly.all_faces_twice, ugly.both_sides])  # fmt: skip
def test_signed_distance_solved_on_ugly_meshes(spoil):
    np.testing.assert_allclose(signed_distance(POINTS, *spoil(A, F)), signed_distance(POINTS, A, F), atol=1e-8)


def test_closest_points_solved_from_anywhere():
    index = SurfaceIndex(A, F)
    far = np.array([[1e6, 0, 0], [1e15, 1e15, 0], [1e20, -1e20, 1e20], [0, 5e29, 0]])
    face, point, _, distance = index.closest(far)
    for p, q, d in zip(far, point, distance):
        best = ((p / np.linalg.norm(p)) @ A.T).max()
        assert (p / np.linalg.norm(p)) @ q > best - 1e-3 - 1e-15 * np.linalg.norm(p)  # ties, as far as doubles can tell
        assert d == pytest.approx(np.linalg.norm(p), rel=1e-6)
    assert (face >= 0).all()
    assert not index.occluded(far, -far / np.linalg.norm(far, axis=1, keepdims=True))[1:].any()  # beyond float32: never


def test_signed_distance_solved_from_anywhere():
    far = np.array([[1e20, 0, 0], [0, 5e30, 0], [0, 0, -1e49]])
    np.testing.assert_allclose(signed_distance(far, A, F), np.linalg.norm(far, axis=1), rtol=1e-6)


def test_closest_points_solved_beside_a_vertex_that_no_face_uses():
    V, G = ugly.isolated(A, F)
    np.testing.assert_allclose(SurfaceIndex(V, G).closest(POINTS)[3], SurfaceIndex(A, F).closest(POINTS)[3], atol=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_intersect_refuses_what_is_not_finite(value):
    cases = {
        r"intersecting_pairs: V1\[3\]": lambda: intersecting_pairs(put(A, 3, 0, value), F, B, F),
        r"intersecting_pairs: V2\[4\]": lambda: intersecting_pairs(A, F, put(B, 4, 0, value), F),
        r"self_intersections: V\[5\]": lambda: self_intersections(put(A, 5, 2, value), F),
        r"signed_distance: points\[6\]": lambda: signed_distance(put(POINTS, 6, 1, value), A, F),
        r"winding_number: points\[6\]": lambda: winding_number(put(POINTS, 6, 1, value), A, F),
    }
    for message, case in cases.items():
        with pytest.raises(InputError, match=message + " is not finite"):
            case()
