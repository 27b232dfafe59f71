"""Non-rigid registration."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import scipy.sparse as sp
import trimesh
from scipy.spatial.transform import Rotation

from toile import kernels
from toile.io.body import load_body_model
from toile.kernels import InputError, NricpSolver, nricp


def bumpy(subdivisions, turn=0.0):
    """A distinctive closed surface about 1 m across, on an icosphere turned by `turn` [rad]: same shape, other vertices."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    c, s = np.cos(turn), np.sin(turn)
    d = sphere.vertices @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    radius = 1 + 0.2 * np.sin(4 * d[:, :1] + 1) * np.cos(3 * d[:, 1:2]) + 0.15 * np.sin(5 * d[:, 2:] + 2 * d[:, :1])
    return 0.5 * d * radius * [0.6, 0.8, 1.2], np.array(sphere.faces, dtype=np.int32)


def bend(V, amount=0.04):
    """A smooth bend and twist [m]."""
    x, y, z = V.T
    return np.stack([x + amount * z**2, y + 0.5 * amount * np.sin(2 * z), z - amount * x * z], axis=1)


def surface_distance(V, scan_V, scan_F):
    return kernels.SurfaceIndex(scan_V, scan_F).closest(V)[3]


@pytest.fixture(scope="module")
def problem():
    V, F = bumpy(4)
    scan_V, scan_F = bumpy(5, turn=0.4)
    return V, F, bend(scan_V), scan_F


@pytest.fixture(scope="module")
def solved(problem):
    return nricp(*problem)


def test_nricp_recovers_a_known_bend(problem, solved):
    V, F, scan_V, scan_F = problem
    diagonal = np.linalg.norm(np.ptp(V, axis=0))
    true_V, true_F = bumpy(7)  # finer than the scan's flat faces
    assert (
        surface_distance(solved.V, bend(true_V), true_F).mean() < 1e-4 * diagonal
    )  # the shape; sliding is bounded below
    before, after = (np.linalg.norm(x - bend(V), axis=1).mean() for x in (V, solved.V))
    assert after < 0.35 * before
    assert np.isfinite(solved.V).all() and solved.rms < 2e-4 * diagonal and solved.matched.mean() > 0.9


@pytest.mark.parametrize("preset", ["draft", "standard", "fine"])
def test_nricp_is_the_same_to_the_bit_for_any_number_of_threads(problem, threads, preset):
    results = []
    for count in (1, 2, 3, 8):
        threads(count)
        results.append(nricp(*problem, preset=preset).V)
    assert all(np.array_equal(results[0], other) for other in results[1:])


@pytest.mark.parametrize("scale, offset", [(1000.0, 0), (1e-3, 0), (1, 1e5)])
def test_nricp_does_not_depend_on_units_and_origin(problem, solved, scale, offset):
    V, F, scan_V, scan_F = problem
    there = nricp(scale * V + offset, F, scale * scan_V + offset, scan_F).V
    difference = np.linalg.norm((there - offset) / scale - solved.V, axis=1)
    assert difference.mean() < 2e-5 and difference.max() < 5e-4  # last bits choose between equally close faces


def test_nricp_turns_with_its_input(problem, solved):
    V, F, scan_V, scan_F = problem
    R = trimesh.transformations.rotation_matrix(1.0, [1, 2, 3])[:3, :3]
    turned = nricp(V @ R.T, F, scan_V @ R.T, scan_F).V
    assert np.linalg.norm(turned @ R - solved.V, axis=1).mean() < 1e-3


def test_nricp_serves_frames_with_the_analyses_of_its_template(problem):
    V, F, scan_V, scan_F = problem
    solver = NricpSolver(V, F, iterations=[3, 2, 1])
    graphs = solver.analyses
    first = solver.solve(scan_V, scan_F)
    analyses, once = solver.analyses, solver.factorisations
    second = solver.solve(scan_V, scan_F)
    assert analyses == graphs == 4  # three levels of nodes, and the fine steps
    assert solver.analyses == analyses and solver.factorisations - once == once - 1
    assert 3 <= once - 1 <= 3 + 2 + 1  # one a step; a level that has settled leaves some out
    assert np.array_equal(first.V, second.V)


def test_nricp_solver_shared_by_two_threads_answers_as_one(problem):
    V, F, scan_V, scan_F = problem
    solver = NricpSolver(V, F, preset="draft")
    scans = [scan_V, scan_V + [0.01, 0, 0], scan_V + [0, 0.02, 0], scan_V * 1.02]
    alone = [solver.solve(scan, scan_F).V for scan in scans]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda scan: solver.solve(scan, scan_F).V, scans))
    assert all(np.array_equal(a, b) for a, b in zip(alone, together))


def test_nricp_flags_a_scan_out_of_reach(problem):
    V, F, scan_V, scan_F = problem
    result = nricp(V, F, scan_V + 50, scan_F)
    assert result.stop == "no_overlap" and np.isnan(result.V).all() and not result.matched.any()


def test_nricp_fits_scans_with_faces_turned_inside_out(problem, solved):
    V, F, scan_V, scan_F = problem
    assert np.abs(nricp(V, F, scan_V, scan_F[:, ::-1]).V - solved.V).max() < 1e-3


def test_nricp_bridges_holes_smoothly(problem):
    V, F, scan_V, scan_F = problem
    kept = scan_F[np.linalg.norm(scan_V[scan_F].mean(1) - scan_V[scan_V[:, 2].argmax()], axis=1) > 0.12]
    result = nricp(V, F, scan_V, kept)
    hidden = np.linalg.norm(V - V[V[:, 2].argmax()], axis=1) < 0.08
    assert surface_distance(result.V, scan_V, scan_F)[hidden].max() < 0.01
    assert result.matched[hidden].max() < result.matched.mean()


def test_nricp_keeps_an_inner_component_in_its_place(problem):
    V, F, scan_V, scan_F = problem
    inner = 0.1 * V + V[0] * 0.8
    both_V, both_F = np.vstack([V, inner]), np.vstack([F, F + len(V)])
    moved = nricp(both_V, both_F, scan_V, scan_F).V[len(V) :]
    assert np.linalg.norm(moved - bend(inner), axis=1).mean() < 0.02
    lengths = np.linalg.norm(np.ptp(moved, axis=0)) / np.linalg.norm(np.ptp(inner, axis=0))
    assert 0.85 < lengths < 1.15


def test_nricp_landmarks_pull(problem):
    V, F, scan_V, scan_F = problem
    chosen = np.array([3, 700, 1500, 2400])
    W = sp.csr_matrix((np.ones(4), (np.arange(4), chosen)), shape=(4, len(V)))
    target = bend(V)[chosen]
    with_marks = nricp(V, F, scan_V, scan_F, landmarks=(W, target, 0.0005)).V
    without = nricp(V, F, scan_V, scan_F).V
    error = lambda x: np.linalg.norm(x[chosen] - target, axis=1).max()
    assert error(with_marks) < 0.003 and error(with_marks) < 0.5 * error(without)


def tube(around=60, along=40, radius=0.2, height=0.6):
    angle, z = np.meshgrid(2 * np.pi * np.arange(around) / around, np.linspace(0, height, along))
    V = np.stack([radius * np.cos(angle), 0.7 * radius * np.sin(angle), z], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(along - 1))
    a, b = (j * around + i).ravel(), (j * around + (i + 1) % around).ravel()
    return V, np.vstack([np.c_[a, b, b + around], np.c_[a, b + around, a + around]]).astype(np.int32)


def test_nricp_boundary_loops_reach_their_curves():
    V, F = tube()
    long_V, long_F = tube(around=50, along=60, height=0.8)
    loops = [np.arange(60), np.arange(60) + 39 * 60]
    curves = [V[loops[0]] + [0, 0, 0.01], V[loops[1]] + [0, 0, 0.015]]
    shifted = long_V - [0, 0, 0.1]
    solve = NricpSolver(V, F, large_motion=False).solve
    free, bound = solve(shifted, long_F), solve(shifted, long_F, boundary=list(zip(loops, curves)))
    miss = lambda r: max(np.abs(r.V[l, 2] - c[:, 2]).mean() for l, c in zip(loops, curves))
    assert miss(bound) < 0.002 < miss(free)


def test_nricp_borders_reach_the_borders_of_the_scan_but_not_holes():
    V, F = tube()
    scan_V, scan_F = tube(around=120, along=120)
    bent = lambda x: x * [1, 1, 0.88] + np.c_[0.1 * x[:, 2] ** 2, 0 * x[:, 1], 0.01 + 0 * x[:, 2]]
    high, low = V[:, 2] == V[:, 2].max(), V[:, 2] == 0
    hole = np.linalg.norm(scan_V[scan_F].mean(1) - [0.2, 0, 0.53], axis=1) < 0.05  # 2 cm below the upper border
    for kept in (scan_F, scan_F[~hole]):
        result = nricp(V, F, bent(scan_V), kept)
        error = np.abs(result.V - bent(V))[:, 2]
        assert error[high | low].mean() < 0.001 and error[high | low].max() < 0.003
        assert result.matched[high | low].mean() > 0.8


def test_nricp_without_border_weight_lets_a_template_end_beyond_a_scan_that_is_cut_short():
    V, F = tube()
    scan_V, scan_F = tube(around=120, along=120)
    cut = scan_F[scan_V[scan_F][:, :, 2].mean(1) < 0.9 * V[:, 2].max()]
    high = V[:, 2] == V[:, 2].max()
    end = lambda **options: nricp(V, F, scan_V, cut, start=V, large_motion=False, **options).V[high, 2]
    assert np.abs(end(border_weight=0) - V[high, 2]).max() < 0.002 < 0.02 < (V[high, 2] - end()).min()


def test_nricp_scan_labels_restrict_the_target():
    V, F = tube()
    near, far = V * [1.03, 1.03, 1], V * [1.08, 1.08, 1]
    scan_V, scan_F = np.vstack([near, far]), np.vstack([F, F + len(V)])
    labels = np.repeat([1, 3], len(F))
    radius = lambda r: np.linalg.norm(r.V[600:1800, :2] / [0.2, 0.14], axis=1).mean()
    for label, expected in ((1, 1.03), (3, 1.08)):
        solver = NricpSolver(V, F, large_motion=False, labels=[label])
        assert abs(radius(solver.solve(scan_V, scan_F, scan_labels=labels)) - expected) < 0.003
    assert NricpSolver(V, F, labels=[9]).solve(scan_V, scan_F, scan_labels=labels).stop == "no_overlap"


def test_nricp_starts_where_it_is_told(problem):
    V, F, scan_V, scan_F = problem
    stays = lambda rebase: NricpSolver(V, F, large_motion=False, rebase=rebase).solve(scan_V, scan_F, start=bend(V)).V
    error = lambda x: np.linalg.norm(x - bend(V), axis=1).mean()
    assert error(stays(True)) < 0.001  # the start is the rest shape: nothing pulls back
    assert error(stays(True)) < error(stays(False)) < 0.004


def test_nricp_refuses_bad_input_by_name(problem):
    V, F, scan_V, scan_F = problem
    broken = scan_V.copy()
    broken[7, 1] = np.nan
    solver = NricpSolver(V, F, preset="draft")
    W = sp.csr_matrix(([1.0], ([0], [0])), shape=(1, len(V)))
    cases = [
        (r"scan_V\[7\]", lambda: solver.solve(broken, scan_F)),
        ("scan_F", lambda: solver.solve(scan_V, scan_F + len(scan_V))),
        ("scan_F is empty", lambda: solver.solve(scan_V, scan_F[:0])),
        ("start has 3 rows", lambda: solver.solve(scan_V, scan_F, start=V[:3])),
        (r"landmarks W\[0\]", lambda: solver.solve(scan_V, scan_F, landmarks=(2 * W, V[:1], 0.01))),
        (r"sigma\[0\]", lambda: solver.solve(scan_V, scan_F, landmarks=(W, V[:1], 0.0))),
        (r"boundary\[0\] vertices", lambda: solver.solve(scan_V, scan_F, boundary=[([len(V)], V[:5])])),
        ("scan_labels", lambda: solver.solve(scan_V, scan_F, scan_labels=np.zeros(3, int))),
        ("preset", lambda: NricpSolver(V, F, preset="best")),
        ("F is empty", lambda: NricpSolver(V, F[:0])),
        (r"relative_radii", lambda: NricpSolver(V, F, relative_radii=[])),
    ]
    for message, call in cases:
        with pytest.raises(InputError, match=message):
            call()
    with pytest.raises(TypeError, match="stifness"):
        NricpSolver(V, F, stifness=1)


def posed(body, turns):
    """The body's vertices with joints turned: {joint name: rotation vector [degree]}."""
    turn = np.tile(np.eye(4), (len(body.parents), 1, 1))
    for k, name in enumerate(body.joint_names):
        R = Rotation.from_rotvec(np.deg2rad(turns.get(name, [0, 0, 0]))).as_matrix()
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = R, body.J[k] - R @ body.J[k]
        turn[k] = (turn[body.parents[k]] if k else np.eye(4)) @ own
    skin = np.einsum("nb,nbij->nij", body.weights_val, turn[body.weights_idx])
    return np.einsum("nij,nj->ni", skin[:, :3, :3], body.v_template) + skin[:, :3, 3]


def test_nricp_follows_a_large_pose_from_twelve_landmarks_in_passes():
    body = load_body_model("anny")
    V, F = body.v_template, body.f
    truth = posed(
        body,
        {
            "upperarm01.L": [0, -70, 0],
            "lowerarm01.L": [-60, 0, 0],
            "upperleg01.R": [-60, 0, 0],
            "lowerleg01.R": [70, 0, 0],
        },
    )
    scan_V, scan_F = trimesh.remesh.subdivide(truth, F)
    chosen = [V[:, 2].argmax()]
    while len(chosen) < 12:
        chosen.append(np.linalg.norm(V[:, None] - V[chosen], axis=2).min(1).argmax())
    W = sp.csr_matrix((np.ones(12), (np.arange(12), chosen)), shape=(12, len(V)))
    marks = truth[chosen] + 0.005 * np.random.default_rng(0).normal(size=(12, 3))
    once, thrice = (nricp(V, F, scan_V, scan_F, landmarks=(W, marks, 0.005), passes=p).V for p in (1, 3))
    error = lambda x: np.linalg.norm(x - truth, axis=1).mean()
    assert error(V) > 0.1 and error(thrice) < 0.005 and error(thrice) < error(once)


def test_nricp_reads_the_noise_of_a_scan(problem):
    """A rough scan is followed less closely: what is left of 3 mm of noise is a small part of it."""
    V, F, scan_V, scan_F = problem
    noisy = scan_V + 0.003 * np.random.default_rng(1).normal(size=scan_V.shape)
    result = nricp(V, F, noisy, scan_F).V
    from_truth = surface_distance(result, scan_V, scan_F)
    assert from_truth.mean() < 0.4 * 0.003
