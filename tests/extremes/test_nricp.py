"""nricp at the edges of what it may be given: each row is solved or refused."""

import numpy as np
import pytest
import trimesh

from toile.kernels import InputError, SurfaceIndex, nricp


def egg(subdivisions):
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    d = np.array(sphere.vertices)
    return d * [0.3, 0.4, 0.6] * (1 + 0.15 * np.sin(4 * d[:, :1] + 1) * np.cos(3 * d[:, 1:2])), np.array(sphere.faces, np.int32)


def bend(V):
    return V + 0.04 * np.c_[V[:, 2] ** 2, 0.5 * np.sin(2 * V[:, 2]), -V[:, 0] * V[:, 2]]


@pytest.fixture(scope="module")
def problem():
    (V, F), (scan_V, scan_F) = egg(3), egg(4)
    return V, F, bend(scan_V), scan_F


def miss(x, problem):
    """Mean distance to the scan [m]; the start's is 5.7 mm."""
    return SurfaceIndex(*problem[2:]).closest(x)[3].mean()


def test_nricp_does_not_depend_on_the_order_of_vertices(problem):
    V, F, scan_V, scan_F = problem
    order = np.random.default_rng(0).permutation(len(V))
    rank = np.argsort(order).astype(np.int32)
    moved = nricp(V[order], rank[F], scan_V, scan_F).V[rank] - nricp(V, F, scan_V, scan_F).V
    assert np.linalg.norm(moved, axis=1).mean() < 2e-3  # other nodes: the sliding differs, not the surface


@pytest.mark.parametrize("what", ["isolated", "duplicate", "two components", "degenerate scan faces"])
def test_nricp_solves_untidy_meshes(problem, what):
    V, F, scan_V, scan_F = problem
    if what == "isolated":
        V = np.vstack([V, [[90.0, 0, 0]]])
    elif what == "duplicate":
        F = F.copy()
        F[0, 0], V = len(V), np.vstack([V, V[F[0, :1]]])
    elif what == "two components":
        V, F = np.vstack([V, 0.1 * V]), np.vstack([F, F + len(V)])
    else:
        scan_F = np.vstack([scan_F, np.repeat(scan_F[:50, :1], 3, axis=1)])
    result = nricp(V, F, scan_V, scan_F)
    assert np.isfinite(result.V).all() and miss(result.V[:642], problem) < 5e-4


def test_nricp_solved_1000_km_from_the_origin(problem):
    V, F, scan_V, scan_F = problem
    result = nricp(V + 1e6, F, scan_V + 1e6, scan_F)
    assert miss(result.V - 1e6, problem) < 5e-4


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nricp_refuses_what_is_not_finite(problem, value):
    V, F, scan_V, scan_F = problem
    broken = V.copy()
    broken[4, 2] = value
    with pytest.raises(InputError, match=r"V\[4\]"):
        nricp(broken, F, scan_V, scan_F)
