"""untangle and the intersection checks at the edges of what they may be given: each row is solved or refused."""

import numpy as np
import pytest

from toile import kernels

NO_FACE = np.empty((0, 3), dtype=np.int32)


def ball(radius=0.2, subdivisions=3):
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32)


def shell():
    """Cloth 8 mm inside of a ball of radius 0.2, turned so that no vertex lies evenly between faces, and the ball."""
    from scipy.spatial.transform import Rotation

    body_V, body_F = ball()
    V, F = ball(0.192)
    return V @ Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix().T, F, body_V, body_F


def needles(V, F):
    """Every tenth face split at a point within 1e-9 of its first corner: needles, and the same surface."""
    split = F[::10]
    tips = V[split[:, 0]] + 1e-9 * (V[split].mean(1) - V[split[:, 0]])
    new = len(V) + np.arange(len(split))
    fans = [np.column_stack([split[:, c], split[:, (c + 1) % 3], new]) for c in range(3)]
    return np.vstack([V, tips]), np.vstack([np.delete(F, np.s_[::10], axis=0), *fans]).astype(np.int32)


def zero_area(V, F):
    """Extra faces on edges and points."""
    return V, np.vstack([F, np.stack([F[:20, 0], F[:20, 1], F[:20, 1]], 1), np.stack([F[20:40, 0]] * 3, 1)]).astype(
        np.int32
    )


def duplicates(V, F):
    """Faces given twice, and faces again on coincident copies of their vertices."""
    copies = F[:30].ravel()
    return np.vstack([V, V[copies]]), np.vstack([F, F[50:80], len(V) + np.arange(len(copies)).reshape(-1, 3)]).astype(
        np.int32
    )


def isolated(V, F):
    """Vertices that no face uses, one of them far away."""
    return np.vstack([V, [[1e6, 0, 0], [0.3, 0.3, 0.3]]]), F


def non_manifold(V, F):
    """A fin on every fiftieth edge, outwards."""
    edges = kernels.unique_edges(F)[::50]
    tips = 1.05 * (V[edges[:, 0]] + V[edges[:, 1]]) / 2
    return np.vstack([V, tips]), np.vstack([F, np.column_stack([edges, len(V) + np.arange(len(tips))])]).astype(
        np.int32
    )


def components(V, F):
    """A second, far part."""
    return np.vstack([V, V + [5.0, 0, 0]]), np.vstack([F, F + len(V)]).astype(np.int32)


def assert_solved(result, F, body_V, body_F):
    assert result.stop == "clear" and np.isfinite(result.V).all()
    assert len(kernels.intersecting_pairs(result.V, F, body_V, body_F)) == 0
    assert (kernels.signed_distance(result.V[np.unique(F)], body_V, body_F) > 0).all()


@pytest.mark.parametrize("spoil", [needles, zero_area, duplicates, isolated, non_manifold, components])
def test_ugly_cloth_is_solved(spoil):
    V, F, body_V, body_F = shell()
    V, F = spoil(V, F)
    result = kernels.untangle(V, F, body_V, body_F)
    assert_solved(result, F, body_V, body_F)


@pytest.mark.parametrize("spoil", [needles, zero_area, duplicates, isolated, components])
def test_an_ugly_body_is_solved(spoil):
    V, F, body_V, body_F = shell()
    body_V, body_F = spoil(body_V, body_F)
    result = kernels.untangle(V, F, body_V, body_F)
    assert result.stop == "clear"
    assert len(kernels.intersecting_pairs(result.V, F, body_V, body_F)) == 0
    assert (np.linalg.norm(result.V, axis=1) > 0.195).all()


def test_beside_faces_without_area_between_sound_ones_cloth_moves_as_without_them():
    body_V, body_F = ball()
    rng = np.random.default_rng(0)
    a, b, c = body_F.T
    t = rng.uniform(0.2, 0.8, (len(a), 1))
    cut = body_V[a] + t * (body_V[b] - body_V[a])  # on an edge to rounding: two sound faces and one of no area
    m = len(body_V) + np.arange(len(a))
    split_F = np.concatenate([np.stack(f, 1) for f in ((a, b, m), (a, m, c), (m, b, c))])
    at = body_V[a] + rng.uniform(0.05, 0.95, (len(a), 1)) * (body_V[b] - body_V[a])
    corners = np.array([[0, 0, 0], [1e-5, 0, 0], [0, 1e-5, 0]])
    V = (1.003 * at[:, None] + corners).reshape(-1, 3)
    F = np.arange(len(V)).reshape(-1, 3)
    plain = kernels.untangle(V, F, body_V, body_F)
    split = kernels.untangle(V, F, np.concatenate([body_V, cut]), split_F)
    assert plain.stop == split.stop == "clear"
    assert np.abs(split.V - plain.V).max() < 1e-3


@pytest.mark.parametrize("scale", [1e-25, 1e-6, 1e-3, 1e3, 1e6, 1e25])
def test_units_from_micrometres_to_kilometres_are_solved_alike(scale):
    V, F, body_V, body_F = shell()
    plain = kernels.untangle(V, F, body_V, body_F)
    lengths = dict(margin=0.002 * scale, spread=0.03 * scale, max_depth=0.05 * scale)
    result = kernels.untangle(V * scale, F, body_V * scale, body_F, **lengths)
    assert_solved(result, F, body_V * scale, body_F)
    assert np.abs(result.V / scale - plain.V).max() < 1e-4


@pytest.mark.parametrize(
    "scale, message", [(1e-100, "the faces of body_V span less"), (1e200, r"cloth_V\[0\] lies beyond")]
)
def test_sizes_whose_powers_leave_the_range_of_doubles_are_refused(scale, message):
    V, F, body_V, body_F = shell()
    lengths = dict(margin=0.002 * scale, spread=0.03 * scale, max_depth=0.05 * scale)
    with pytest.raises(kernels.InputError, match="untangle: " + message):
        kernels.untangle(V * scale, F, body_V * scale, body_F, **lengths)


def test_a_body_without_extent_is_refused():
    V, F, body_V, body_F = shell()
    with pytest.raises(kernels.InputError, match="untangle: the faces of body_V span less"):
        kernels.untangle(V, F, 0 * body_V, body_F)


@pytest.mark.parametrize("offset", [1e3, 1e6])
def test_coordinates_far_from_the_origin_are_solved(offset):
    V, F, body_V, body_F = shell()
    away = np.array([offset, -offset, offset])
    result = kernels.untangle(V + away, F, body_V + away, body_F)
    assert_solved(result, F, body_V + away, body_F)


def test_a_body_turned_inside_out_is_solved():
    V, F, body_V, body_F = shell()
    result = kernels.untangle(V, F, body_V, body_F[:, ::-1])
    assert result.stop == "clear" and np.abs(result.V - kernels.untangle(V, F, body_V, body_F).V).max() < 1e-9


def test_a_body_full_of_holes_is_solved():
    V, F, body_V, body_F = shell()
    holes = body_F[np.random.default_rng(0).random(len(body_F)) > 0.05]
    result = kernels.untangle(V, F, body_V, holes)
    assert result.stop == "clear"
    assert len(kernels.intersecting_pairs(result.V, F, body_V, holes)) == 0


def test_a_body_far_away_leaves_the_cloth_alone():
    V, F, body_V, body_F = shell()
    result = kernels.untangle(V, F, body_V + [1e5, 0, 0], body_F)
    assert np.array_equal(result.V, V) and result.iterations == 0


def test_four_vertices_are_solved():
    V = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    F = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], dtype=np.int32)
    sheet = np.array([[-2.0, -2, 0.99], [2, -2, 0.99], [2, 2, 0.99], [-2, 2, 0.99]])  # the edge at z = 1 pokes through
    result = kernels.untangle(sheet, np.array([[0, 1, 2], [0, 2, 3]]), V, F, spread=1.0)
    assert_solved(result, np.array([[0, 1, 2], [0, 2, 3]]), V, F)


def soup(rng, kind, points, faces):
    """Random faces over random points, repeated corners included: on a lattice, in a plane, on a line, or anywhere."""
    V = rng.normal(size=(points, 3))
    if kind == "lattice":
        V = np.round(V)
    elif kind == "plane":
        V[:, 2] = 0
    elif kind == "line":
        V[:, 1:] = 0
    return V, rng.integers(0, points, (faces, 3)).astype(np.int32)


@pytest.mark.parametrize("kind", ["anywhere", "lattice", "plane", "line"])
def test_soups_end_finite_with_their_pairs_counted_exactly(kind):
    rng, answered = np.random.default_rng(7), 0
    for _ in range(100):
        V, F = soup(rng, kind, *rng.integers(3, 40, 2))
        body_V, body_F = soup(rng, rng.choice(["anywhere", "lattice", "plane"]), *rng.integers(4, 40, 2))
        scale = 10.0 ** rng.integers(-8, 8)
        lengths = dict(
            margin=scale * 0.1 ** rng.integers(1, 4), spread=scale * 0.1 ** rng.integers(0, 3), max_depth=scale
        )
        V, body_V = V * scale, body_V * scale + rng.choice([0, 0, 1e3]) * scale
        try:
            result = kernels.untangle(V, F, body_V, body_F, max_iterations=8, **lengths)
        except kernels.InputError as error:
            assert "around no volume" in str(error)
            continue
        answered += 1
        pairs = kernels.intersecting_pairs(result.V, F, body_V, body_F)
        assert np.isfinite(result.V).all() and np.array_equal(pairs, result.pairs_left)
        assert result.stop != "clear" or len(pairs) == 0
    assert answered > 80


def test_a_face_with_a_repeated_corner_is_a_segment_to_the_closest_point():
    V = np.array([[0.0, 0, 0], [4, 0, 0], [0, 9, 9]])
    for face in ([0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 1, 1], [1, 0, 1], [1, 1, 0]):
        assert kernels.signed_distance(np.array([[3.0, 2, 0]]), V, np.array([face], dtype=np.int32)) == pytest.approx(
            2.0
        )


@pytest.mark.parametrize("depth", [1e-9, 0.1, 0.19])
def test_touching_and_very_deep_cloth_is_solved(depth):
    body_V, body_F = ball()
    V, F = ball(0.2 - depth)
    assert_solved(kernels.untangle(V, F, body_V, body_F), F, body_V, body_F)


@pytest.mark.parametrize(
    "options", [{"margin": 1e-6}, {"margin": 0.05}, {"spread": 1e-5}, {"spread": 1e4}, {"relative_tolerance": 1e-6}]
)
def test_options_at_their_ends_are_solved(options):
    V, F, body_V, body_F = shell()
    assert_solved(kernels.untangle(V, F, body_V, body_F, **options), F, body_V, body_F)


@pytest.mark.slow
def test_a_million_vertices_are_solved():
    body_V, body_F = ball(0.2, 5)
    V, F = ball(0.199, 8)  # 655362 vertices
    V, F = np.vstack([V, V + [1.0, 0, 0]]), np.vstack([F, F + len(V)]).astype(np.int32)
    assert kernels.untangle(V, F, body_V, body_F).stop == "clear"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_no_numbers_are_refused_with_their_row(value):
    V, F, body_V, body_F = shell()
    bad = body_V.copy()
    bad[17, 1] = value
    with pytest.raises(kernels.InputError, match=r"untangle: body_V\[17\] is not finite"):
        kernels.untangle(V, F, bad, body_F)
    with pytest.raises(kernels.InputError, match=r"untangle: cloth_V\[17\] is not finite"):
        kernels.untangle(bad, body_F, V, F)
    with pytest.raises(kernels.InputError, match=r"self_intersections: V\[17\] is not finite"):
        kernels.self_intersections(bad, body_F)
    for name in ("margin", "spread", "max_depth", "relative_tolerance"):
        with pytest.raises(kernels.InputError, match=f"untangle: {name} is"):
            kernels.untangle(V, F, body_V, body_F, **{name: value})


def test_empty_meshes_and_indices_out_of_range_are_refused():
    V, F, body_V, body_F = shell()
    with pytest.raises(kernels.InputError, match="untangle: cloth_F is empty"):
        kernels.untangle(V, NO_FACE, body_V, body_F)
    with pytest.raises(kernels.InputError, match="untangle: body_V is empty"):
        kernels.untangle(V, F, np.empty((0, 3)), body_F)
    for index in (-1, len(body_V), 2**31 - 1):
        bad = body_F.copy()
        bad[9, 0] = index
        with pytest.raises(kernels.InputError, match=rf"untangle: body_F\[9\] holds vertex {index}"):
            kernels.untangle(V, F, body_V, bad)
        with pytest.raises(kernels.InputError, match=rf"signed_distance: F\[9\] holds vertex {index}"):
            kernels.signed_distance(V, body_V, bad)


def test_a_body_whose_faces_are_all_listed_twice_is_solved_alike():
    from .ugly import all_faces_twice, some_faces_twice

    V, F, body_V, body_F = shell()
    clean = kernels.untangle(V, F, body_V, body_F).V
    for spoil in (all_faces_twice, some_faces_twice):
        result = kernels.untangle(V, F, *spoil(body_V, body_F))
        assert result.stop == "clear" and np.abs(result.V - clean).max() < 1e-3


def test_a_body_of_faces_and_their_reverses_is_solved_alike():
    from .ugly import both_sides, some_faces_twice

    V, F, body_V, body_F = shell()
    clean = kernels.untangle(V, F, body_V, body_F)
    for spoilt_V, spoilt_F in (both_sides(body_V, body_F), both_sides(*some_faces_twice(body_V, body_F))):
        result = kernels.untangle(V, F, spoilt_V, spoilt_F)
        assert_solved(result, F, body_V, body_F)
        assert np.array_equal(result.V, clean.V)
        assert result.intersections_before == len(kernels.intersecting_pairs(V, F, spoilt_V, spoilt_F))


def test_pairs_left_name_every_listing_of_a_face():
    from .ugly import both_sides

    V, F, body_V, body_F = shell()
    V = V + 0.009 * np.random.default_rng(0).normal(size=V.shape)
    result = kernels.untangle(V, F, *both_sides(body_V, body_F), max_iterations=1)
    assert result.intersections_left > 0
    assert np.array_equal(result.pairs_left, kernels.intersecting_pairs(result.V, F, *both_sides(body_V, body_F)))


def test_a_body_around_no_volume_is_refused():
    """Reverses on vertices of their own, so that every winding cancels; and a flat ball."""
    V, F, body_V, body_F = shell()
    lined = np.vstack([body_V, body_V]), np.vstack([body_F, body_F[:, ::-1] + len(body_V)])
    for bad in (lined, (body_V * [1, 1, 0], body_F)):
        with pytest.raises(
            kernels.InputError, match="untangle: body_V and body_F close on themselves around no volume"
        ):
            kernels.untangle(V, F, *bad)


@pytest.mark.parametrize("shift", [0.0, 0.01])
def test_no_rounding_chooses_between_faces_at_one_distance(shift):
    """A ball in a ball: each vertex lies evenly between faces, until a step lands it between others."""
    from scipy.spatial.transform import Rotation

    body_V, body_F = ball()
    V, F = ball(0.1)
    V = V + [shift, 0, 0]
    here = kernels.untangle(V, F, body_V, body_F)
    for seed in range(5):
        R, t = Rotation.random(random_state=seed).as_matrix(), np.random.default_rng(seed).normal(size=3)
        there = kernels.untangle(V @ R.T + t, F, body_V @ R.T + t, body_F)
        assert there.iterations == here.iterations and np.abs((there.V - t) @ R - here.V).max() < 1e-10


@pytest.mark.parametrize("spoil", ["fins", "faces turned about"])
def test_a_body_that_cannot_be_cleared_is_said(spoil):
    """Fins that stick out of the body through the cloth; a tenth of the faces that look inwards."""
    from .ugly import tenth_flipped

    V, F, body_V, body_F = shell()
    result = kernels.untangle(V, F, *(non_manifold if spoil == "fins" else tenth_flipped)(body_V, body_F))
    assert result.stop != "clear" and result.reason and result.intersections_left > 0
    assert np.isfinite(result.V).all()
