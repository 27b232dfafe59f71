"""nricp at the edges of what it may be given. Each row is marked beforehand: SOLVED rows must give the clean problem's
answer, SAID rows must end as "no_overlap" with V all NaN, REFUSED rows must raise an InputError that names what is wrong."""

import numpy as np
import pytest
import scipy.sparse as sp
import trimesh

from toile.kernels import InputError, NricpSolver, NricpTracker, SurfaceIndex, nricp

from .ugly import HOLES, UGLY, seam

INT32 = np.int32


def egg(subdivisions):
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    d = np.array(sphere.vertices)
    return d * [0.3, 0.4, 0.6] * (1 + 0.15 * np.sin(4 * d[:, :1] + 1) * np.cos(3 * d[:, 1:2])), np.array(
        sphere.faces, INT32
    )


def bend(V):
    return V + 0.04 * np.c_[V[:, 2] ** 2, 0.5 * np.sin(2 * V[:, 2]), -V[:, 0] * V[:, 2]]


V, F = egg(3)
SCAN_V, SCAN_F = egg(4)
SCAN_V = bend(SCAN_V)
TRUTH = bend(V)  # 20 mm from V; the scan lies 5.7 mm from V


@pytest.fixture(scope="module")
def clean():
    """The answer of each preset to the clean problem."""
    answers = {preset: nricp(V, F, SCAN_V, SCAN_F, preset=preset).V for preset in ("draft", "standard", "fine")}
    for x in answers.values():
        assert np.linalg.norm(x - TRUTH, axis=1).mean() < 8e-3 and miss(x) < 5e-4
    return answers


def miss(x):
    """Mean distance to the clean scan [m]."""
    return SurfaceIndex(SCAN_V, SCAN_F).closest(x)[3].mean()


def assert_solved(x, clean, mean=1e-3, most=2.5e-3):
    """x[:642] is the clean answer to the sliding that another tessellation of the same surface leaves free."""
    assert np.isfinite(x).all()
    apart = np.linalg.norm(x[: len(V)] - clean, axis=1)
    assert apart.mean() < mean and apart.max() < most
    assert miss(x[: len(V)]) < miss(clean) + 1e-4


@pytest.mark.parametrize("preset", ["draft", "standard", "fine"])
@pytest.mark.parametrize("spoil", UGLY)
def test_nricp_solved_on_an_ugly_scan(spoil, preset, clean):
    result = nricp(V, F, *spoil(SCAN_V, SCAN_F), preset=preset)
    assert result.stop != "no_overlap"
    assert_solved(result.V, clean[preset], mean=1.2e-3)


@pytest.mark.parametrize("preset", ["draft", "standard", "fine"])
@pytest.mark.parametrize("spoil", HOLES)
def test_nricp_solved_on_a_scan_full_of_holes(spoil, preset, clean):
    result = nricp(V, F, *spoil(SCAN_V, SCAN_F), preset=preset)
    assert result.stop != "no_overlap"
    error = np.linalg.norm(result.V - TRUTH, axis=1)
    assert error.mean() < 8e-3 and error.max() < 16e-3  # the clean answers' bound: sliding that the egg leaves free
    assert miss(result.V) < miss(clean[preset]) + 2e-4


@pytest.mark.parametrize("spoil", UGLY)
def test_nricp_solved_with_an_ugly_template(spoil, clean):
    ugly_V, ugly_F = spoil(V, F)
    result = nricp(ugly_V, ugly_F, SCAN_V, SCAN_F)
    assert result.stop != "no_overlap" and len(result.V) == len(result.matched) == len(ugly_V)
    assert_solved(result.V, clean["standard"])


@pytest.mark.parametrize("spoil", UGLY)
def test_nricp_solved_when_both_are_ugly(spoil, clean):
    assert_solved(nricp(*spoil(V, F), *spoil(SCAN_V, SCAN_F)).V, clean["standard"], mean=1.2e-3, most=3e-3)


@pytest.fixture(scope="module")
def followed():
    """What a tracker makes of the clean scan after one of the template as it is."""
    return tracked(V, F, SCAN_V, SCAN_F)


def tracked(template_V, template_F, scan_V, scan_F):
    tracker = NricpTracker(template_V, template_F)
    assert tracker.next(template_V, template_F).stop != "no_overlap"
    result = tracker.next(scan_V, scan_F)
    return None if result.stop == "no_overlap" else result.V


@pytest.mark.parametrize("spoil", UGLY)
def test_a_tracker_follows_to_an_ugly_scan_with_an_ugly_template(spoil, followed):
    assert np.linalg.norm(followed - TRUTH, axis=1).mean() < 8e-3
    assert_solved(tracked(*spoil(V, F), *spoil(SCAN_V, SCAN_F)), followed, mean=1.5e-3, most=4e-3)


@pytest.mark.parametrize("scale, offset", [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e6)])
def test_a_tracker_follows_in_any_unit_and_far_from_the_origin(scale, offset, followed):
    x = tracked(scale * V + offset, F, scale * SCAN_V + offset, SCAN_F)
    assert_solved((x - offset) / scale, followed, mean=1e-4)


def test_a_tracker_says_that_a_scan_is_out_of_reach_and_refuses_what_is_none():
    assert tracked(V, F, SCAN_V + 100, SCAN_F) is None
    with pytest.raises(InputError, match="scan_V.7. is not finite"):
        tracked(V, F, np.where(np.arange(len(SCAN_V))[:, None] == 7, np.nan, SCAN_V), SCAN_F)
    with pytest.raises(InputError, match="scan_F is empty"):
        tracked(V, F, SCAN_V, SCAN_F[:0])


def test_nricp_keeps_seams_closed_and_serves_loops_and_landmarks_on_either_side():
    seam_V, seam_F = seam(V, F)
    used = np.unique(seam_F)
    twin = np.array([v for v in used if v < len(V) and v + len(V) in used])
    W = sp.csr_matrix(
        (np.ones(4), (np.arange(4), [twin[0], twin[9] + len(V), twin[20], twin[31] + len(V)])), shape=(4, 2 * len(V))
    )
    marks = np.array([twin[0], twin[9], twin[20], twin[31]])
    x = nricp(seam_V, seam_F, SCAN_V, SCAN_F, landmarks=(W, TRUTH[marks], 1e-3)).V
    assert np.array_equal(x[twin], x[twin + len(V)])
    assert np.linalg.norm(x[marks] - TRUTH[marks], axis=1).max() < 1e-3


# --- units and places -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("scale", [1e-25, 1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e25])
def test_nricp_solved_in_any_unit(scale, clean):
    result = nricp(scale * V, F, scale * SCAN_V, SCAN_F)
    assert_solved(result.V / scale, clean["standard"], mean=1e-4)
    assert result.rms / scale == pytest.approx(nricp(V, F, SCAN_V, SCAN_F).rms, rel=1e-2)


@pytest.mark.parametrize("offset", [1e3, 1e6])
def test_nricp_solved_far_from_the_origin(offset, clean):
    away = np.array([offset, -offset, offset])
    assert_solved(nricp(V + away, F, SCAN_V + away, SCAN_F).V - away, clean["standard"], mean=1e-4)


def test_nricp_solved_in_any_order_of_vertices(clean):
    order = np.random.default_rng(0).permutation(len(V))
    rank = np.argsort(order).astype(INT32)
    assert_solved(nricp(V[order], rank[F], SCAN_V, SCAN_F).V[rank], clean["standard"], mean=2e-3, most=5e-3)


# --- sizes ------------------------------------------------------------------------------------------------------------
def test_nricp_solved_on_4_vertices():
    T = 0.3 * np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], INT32)
    np.testing.assert_allclose(nricp(T, faces, T + 0.02, faces).V, T + 0.02, atol=1e-9)


@pytest.mark.slow
def test_nricp_solved_on_1_000_000_vertices():
    n = 1000
    a, b = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(n) / n)
    r = 1 + (0.4 + 0.05 * np.cos(3 * a)) * np.cos(b)
    torus = 0.5 * np.stack([r * np.cos(a), 0.8 * r * np.sin(a), (0.4 + 0.05 * np.cos(3 * a)) * np.sin(b)], -1).reshape(
        -1, 3
    )
    at = np.arange(n * n).reshape(n, n)
    right, down = np.roll(at, -1, 1), np.roll(at, -1, 0)
    across = np.roll(down, -1, 1)
    faces = (
        np.concatenate([np.stack([at, right, across], -1), np.stack([at, across, down], -1)])
        .reshape(-1, 3)
        .astype(INT32)
    )
    moved = bend(torus)
    result = nricp(torus, faces, moved, faces)
    assert result.matched.mean() > 0.9
    assert (
        SurfaceIndex(moved, faces).closest(result.V)[3].mean()
        < 0.1 * SurfaceIndex(moved, faces).closest(torus)[3].mean()
    )


# --- stiffness, landmarks, labels -------------------------------------------------------------------------------------
def rigid_rest(x):
    """What the best rigid motion of V leaves of x [m]."""
    a, b = V - V.mean(0), x - x.mean(0)
    U, _, Wt = np.linalg.svd(a.T @ b)
    R = U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Wt))]) @ Wt
    return np.linalg.norm(a @ R - b, axis=1).max()


@pytest.mark.parametrize("stiffness", [1e4, 1e7, 1e9, 1e12])
def test_nricp_solved_with_stiffness_that_leaves_a_rigid_motion(stiffness):
    hard = dict(stiffness_start=[stiffness] * 3, stiffness_end=[stiffness] * 3, fine_iterations=0)
    x = nricp(V, F, SCAN_V, SCAN_F, **hard).V
    assert rigid_rest(x) < max(1e-4, 1e-2 / stiffness**0.5)
    none = dict(iterations=[0, 0, 0], fine_iterations=0)
    assert miss(x) < 1.2 * miss(nricp(V, F, SCAN_V, SCAN_F, **none).V)  # rigid steps alone


@pytest.mark.parametrize("stiffness", [1e-8, 1e-4, 1e-2])
def test_nricp_solved_with_stiffness_that_leaves_each_node_to_itself(stiffness, clean):
    soft = dict(stiffness_start=[stiffness] * 3, stiffness_end=[stiffness] * 3)
    x = nricp(V, F, SCAN_V, SCAN_F, **soft).V
    assert miss(x) < miss(clean["standard"]) and np.linalg.norm(x - V, axis=1).max() < 0.1


@pytest.mark.parametrize("sigma", [1e-300, 1e-12, 1e-6, 1e-3, 1.0, 1e12, 1e300])
def test_nricp_solved_with_landmarks_from_exact_to_void(sigma, clean):
    ids = np.arange(0, len(V), 60)
    W = sp.csr_matrix((np.ones(len(ids)), (np.arange(len(ids)), ids)), shape=(len(ids), len(V)))
    x = nricp(V, F, SCAN_V, SCAN_F, landmarks=(W, TRUTH[ids], sigma)).V
    if sigma <= 1e-3:
        assert np.linalg.norm(x[ids] - TRUTH[ids], axis=1).max() < 1e-3
        assert np.linalg.norm(x - TRUTH, axis=1).mean() < 0.5 * np.linalg.norm(clean["standard"] - TRUTH, axis=1).mean()
    else:
        assert_solved(x, clean["standard"], mean=1e-4)


@pytest.mark.parametrize("labels", [1, 2, 64])
def test_nricp_solved_with_1_to_64_labels(labels, clean):
    """Half of the labels are the egg's; the others a second egg, shifted, which must not be seen."""
    wanted = np.arange(0, labels, 2)
    rng = np.random.default_rng(0)
    both_V, both_F = np.vstack([SCAN_V, SCAN_V + 0.05]), np.vstack([SCAN_F, SCAN_F + len(SCAN_V)])
    other = rng.choice(np.setdiff1d(np.arange(labels), wanted), len(SCAN_F)) if labels > 1 else np.full(len(SCAN_F), 7)
    given = np.concatenate([rng.choice(wanted, len(SCAN_F)), other])
    result = NricpSolver(V, F, labels=wanted.tolist()).solve(both_V, both_F, scan_labels=given)
    assert_solved(result.V, clean["standard"])


# --- said: an answer is not to be had ---------------------------------------------------------------------------------
def nine_tenths_missing():
    return SCAN_V, SCAN_F[np.random.default_rng(0).random(len(SCAN_F)) > 0.9]


SAID = {
    "far": lambda: (SCAN_V + 100, SCAN_F),
    "1e6 m away": lambda: (SCAN_V + 1e6, SCAN_F),
    "beside, just out of reach": lambda: (SCAN_V + 3, SCAN_F),
    "in millimetres": lambda: (1e3 * SCAN_V, SCAN_F),
    "in kilometres": lambda: (1e-3 * SCAN_V, SCAN_F),
    "single faces that share no vertex": nine_tenths_missing,
    "all faces on points": lambda: (SCAN_V, np.repeat(SCAN_F[:, :1], 3, axis=1)),
    "all vertices in one place": lambda: (0 * SCAN_V, SCAN_F),
}


@pytest.mark.parametrize("scan", SAID.values(), ids=SAID)
def test_nricp_says_that_nothing_overlaps(scan):
    result = nricp(V, F, *scan())
    assert result.stop == "no_overlap" and np.isnan(result.V).all() and result.matched.max() == 0


def test_nricp_says_that_no_label_is_a_target():
    result = NricpSolver(V, F, labels=[3]).solve(SCAN_V, SCAN_F, scan_labels=np.zeros(len(SCAN_F), int))
    assert result.stop == "no_overlap" and np.isnan(result.V).all()


# --- refused ----------------------------------------------------------------------------------------------------------
def solve(V=V, F=F, scan_V=SCAN_V, scan_F=SCAN_F, options=None, **frame):
    return NricpSolver(V, F, **(options or {})).solve(scan_V, scan_F, **frame)


def put(array, row, column, value):
    array = np.array(array)
    array[row, column] = value
    return array


def marks(value=1.0, P=0.0, sigma=0.01, rows=3):
    W = sp.csr_matrix((np.r_[1.0, 1.0, value], (np.arange(3), [4, 5, 6])), shape=(rows, len(V)))
    return W, put(TRUTH[4:7], 1, 2, P), sigma


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nricp_refuses_what_is_not_finite(value):
    ring = np.arange(5)
    cases = {
        r"V\[4\] is not finite": dict(V=put(V, 4, 2, value)),
        r"scan_V\[77\] is not finite": dict(scan_V=put(SCAN_V, 77, 0, value)),
        r"start\[9\] is not finite": dict(start=put(V, 9, 1, value)),
        r"landmarks P\[1\] is not finite": dict(landmarks=marks(P=value)),
        r"landmarks W": dict(landmarks=marks(value)),
        r"landmarks sigma\[2\] is not positive": dict(landmarks=marks(sigma=[1, 1, value])),
        r"boundary\[1\] polyline\[3\] is not finite": dict(boundary=[(ring, V[:5]), (ring, put(V[:5], 3, 0, value))]),
    }
    for message, case in cases.items():
        with pytest.raises(InputError, match="nricp: " + message):
            solve(**case)
    for name in ("phong", "point_weight", "boundary_weight", "border_weight", "rotation_weight", "min_overlap", "exposure", "fine_noise",
                 "relative_fine_robust", "relative_fine_length"):  # fmt: skip
        with pytest.raises(InputError, match=f"nricp: {name} "):
            solve(options={name: value})
    for name in (
        "relative_radii",
        "stiffness_start",
        "stiffness_end",
        "relative_robust_start",
        "relative_robust_end",
        "reverse",
        "relative_spread",
        "relative_detail",
    ):
        with pytest.raises(InputError, match=rf"nricp: {name}\[1\] "):
            solve(options={name: [0.1, value, 0.1]})


NONE, NO_FACE = np.empty((0, 3)), np.empty((0, 3), INT32)
REFUSED = {
    "V is empty": dict(V=NONE),
    "F is empty": dict(F=NO_FACE),
    "scan_V is empty": dict(scan_V=NONE, scan_F=NO_FACE),
    "scan_F is empty": dict(scan_F=NO_FACE),
    r"F\[5\] holds vertex 642": dict(F=put(F, 5, 1, 642)),
    r"F\[5\] holds vertex -1": dict(F=put(F, 5, 1, -1)),
    r"scan_F\[6\] holds vertex 2147483647": dict(scan_F=put(SCAN_F, 6, 2, 2**31 - 1)),
    r"boundary\[0\] vertices\[1\] is 642": dict(boundary=[([3, 642], V[:5])]),
    "boundary.0. polyline has fewer": dict(boundary=[([3, 4], V[:1])]),
    "scan_labels has 3 entries": dict(scan_labels=[1, 2, 3], options=dict(labels=[1])),
    "landmarks P has 3 rows, W has 4": dict(landmarks=marks(rows=4)),
    r"landmarks W\[2\] is not a convex": dict(landmarks=marks(0.5)),
    r"landmarks sigma\[0\] is not positive": dict(landmarks=marks(sigma=0.0)),
    "the faces F of V have no area": dict(V=0 * V),
    "F has no face of three different": dict(F=np.repeat(F[:, :1], 3, axis=1)),
    r"V\[0\] lies beyond 1e": dict(V=1e100 * V),
    r"scan_V\[3\] lies beyond 1e": dict(scan_V=put(SCAN_V, 3, 0, 1e200)),
    r"stiffness_end\[0\] is not positive": dict(options=dict(stiffness_end=[0, 1, 1])),
    r"relative_robust_end\[2\] lies outside": dict(options=dict(relative_robust_end=[1, 1, 1e300])),
}


@pytest.mark.parametrize("message", REFUSED)
def test_nricp_refuses_by_name_and_index(message):
    with pytest.raises(InputError, match="nricp: " + message):
        solve(**REFUSED[message])
