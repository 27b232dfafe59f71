"""The fuzzer's first cases of every entry, and what it once found: each call answers or refuses, never worse."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from toile import kernels
from toile.kernels import InputError, SolveError

from .bodies import sound_body
from .draw import Draw
from .entries import ENTRIES
from .laws import LAWFUL

V = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
F = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ENTRIES)
def test_ugly_arguments_are_answered_or_refused(name):
    draw, run = ENTRIES[name]
    for seed in range(1_000_000, 1_000_025):
        try:
            run(**draw(Draw(seed)))
        except LAWFUL:
            pass


@pytest.mark.parametrize(
    "values", [[[0, 1, 2], [3, 4]], "mesh", None, V + 1j, np.ma.masked_array(V, V == 1), np.array(V, object)]
)
def test_what_is_no_array_of_numbers_is_refused(values):
    with pytest.raises(InputError, match="face_areas: V "):
        kernels.face_areas(values, F)


def test_coordinates_whose_areas_overflow_are_refused():
    with pytest.raises(InputError, match=r"vertex_normals: V\[1\] lies beyond 1e50"):
        kernels.vertex_normals(V * 1e160, F)


def test_a_needle_beyond_the_range_of_doubles_counts_as_a_face_of_no_area():
    needle = np.array([[0, 0, 0], [1, 0, 0], [1, 1e-320, 0]])
    assert np.isfinite(kernels.cotangent_laplacian(needle, [[0, 1, 2]]).data).all()
    assert np.isfinite(kernels.voronoi_mass(needle, [[0, 1, 2]])).all()


@pytest.mark.parametrize("bad", [-1, 2**31 - 1])
def test_topology_refuses_indices_that_no_vertex_has(bad):
    wrong = F.copy()
    wrong[2, 1] = bad
    for query in (kernels.unique_edges, kernels.boundary_loops, lambda f: kernels.vertex_components(f, 4)):
        with pytest.raises(InputError, match=r"F\[2\]"):
            query(wrong)
    with pytest.raises(InputError, match="n is -1"):
        kernels.vertex_components(F, -1)


def test_closest_points_are_found_from_any_distance():
    index = kernels.SurfaceIndex(1e-9 * V, F)
    far = np.array([[1e40, 2e40, -1e40], [1e12, 0, 0]])
    face, point, _, distance = index.closest(far)
    assert (face >= 0).all() and np.allclose(distance, np.linalg.norm(far, axis=1)) and (np.abs(point) <= 1e-9).all()


def test_rays_from_beyond_the_range_of_float32_miss_and_rays_of_nan_are_refused():
    index = kernels.SurfaceIndex(1e-9 * V, F)
    assert not index.occluded([[1e30, 0, 0]], [[-1.0, 0, 0]]).any()
    with pytest.raises(InputError, match=r"occluded: origins\[0\]"):
        index.occluded([[np.nan, 0, 0]], [[1.0, 0, 0]])


def test_landmarks_of_a_matrix_with_a_broken_structure_are_refused():
    for spoil in ("indices", "indptr"):
        W = sp.csr_matrix(np.eye(1, 4))
        getattr(W, spoil)[-1] = 2**31 - 1
        with pytest.raises(InputError, match="nricp: landmarks W"):
            kernels.nricp(V, F, V, F, landmarks=(W, V[:1], 0.01))


@pytest.mark.parametrize(
    "option",
    [
        "phong",
        "point_weight",
        "boundary_weight",
        "border_weight",
        "rotation_weight",
        "min_overlap",
        "exposure",
        "fine_noise",
    ],
)
@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_nricp_refuses_options_that_are_no_numbers(option, value):
    with pytest.raises(InputError, match=f"nricp: {option}"):
        kernels.NricpSolver(V, F, **{option: value})


def test_a_factor_that_failed_does_not_solve():
    factor = kernels.CholeskyFactor()
    with pytest.raises(SolveError):
        factor.factorize(sp.csc_matrix(-np.eye(3)))
    with pytest.raises(SolveError, match="without a factor"):
        factor.solve(np.ones((3, 1)))
    with pytest.raises(InputError, match="A is not finite"):
        factor.factorize(sp.csc_matrix(np.nan * np.eye(3)))
    repeated = sp.csc_matrix(([1.0, 1.0, 2.0], [0, 0, 1], [0, 2, 3]), shape=(2, 2))  # 2 at (0, 0), in two parts
    assert np.allclose(factor.factorize(repeated).solve(np.ones((2, 1))), 0.5) and repeated.nnz == 3


def test_cloth_behind_an_open_body_of_one_face_is_answered():
    """The probe of a pierced face asked an open body for its winding number."""
    draw, run = ENTRIES["untangle"]
    run(**draw(Draw(388)))


def test_mrf_refuses_costs_whose_sum_overflows():
    with pytest.raises(InputError, match="sum of unary overflows"):
        kernels.mrf(np.full((4, 2), 1e308), np.zeros((0, 2), int), np.zeros(0))
    with pytest.raises(InputError, match="sum of vote_cost overflows"):
        kernels.mrf(np.zeros((4, 2)), np.zeros((0, 2), int), np.zeros(0), prefer=[(0, 1), (0, 0)], vote_cost=1e308)
    with pytest.raises(SolveError, match="energy of the answer"):  # votes cut both edges
        kernels.mrf(np.zeros((4, 2)), [[0, 1], [2, 3]], [1e308, 1e308], prefer=[(0, 0), (1, 1), (2, 0), (3, 1)])


def test_ragged_costs_and_wordy_counts_are_refused():
    with pytest.raises(InputError, match="mrf: pairwise is not an array"):
        kernels.mrf(np.zeros((4, 2)), np.zeros((0, 2), int), np.zeros(0), [[0, 1], [1]])
    with pytest.raises(TypeError):
        kernels.SkeletonSolver(sound_body(), **SIGMAS).solve_shared([], "x")


def test_biharmonic_refuses_an_accuracy_that_asks_for_nothing():
    with pytest.raises(InputError, match="biharmonic: accuracy is inf"):
        kernels.BiharmonicSolver(V, F, [0, 1], accuracy=np.inf)


@pytest.mark.parametrize("option", ["gap", "taper", "length", "reach"])
def test_inner_refuses_lengths_whose_squares_overflow(option):
    with pytest.raises(InputError, match="up to 1e50|beyond 1e50"):
        kernels.InnerSolver(sound_body(), **{option: 1e308})


@pytest.mark.parametrize(
    "name", ["v_template", "f", "weights_idx", "weights_val", "shapedirs", "J_shapedirs", "keypoint_joint"]
)
def test_a_body_model_whose_arrays_do_not_fit_is_refused(name):
    model = sound_body()
    flaws = [np.ravel, lambda a: a[:-1]] if name not in ("f", "keypoint_joint") else [lambda a: a + 10**6]
    for flaw in flaws:
        with pytest.raises(InputError):
            kernels.SkeletonSolver(replace(model, **{name: flaw(getattr(model, name))}), **SIGMAS)


SIGMAS = {"joint_sigma": np.full(4, 0.5), "joint_limit": np.full(4, 2.0)}


def test_skeleton_refuses_weights_that_leave_no_area():
    weights = np.zeros(108)
    weights[0] = 1.0
    model = sound_body()
    flat = replace(model, v_template=model.v_template * [1, 0, 0])
    with pytest.raises(InputError, match="no area"):
        kernels.SkeletonSolver(flat, vertex_weights=weights, **SIGMAS).solve(model.v_template, model.f)
