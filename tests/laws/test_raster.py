"""Laws of raster on random soups: no unit, no order of vertices, and the picture moves with the principal point."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from toile.kernels import raster

from .motions import examples, seeds

K = np.array([[40.0, 0, 24.5], [0, 42, 17.25], [0, 0, 1]])
SIZE = (36, 48)


def soup(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 60))
    V = rng.uniform([-1, -1, -0.2], [1, 1, 3], (n, 3))
    return V, rng.integers(0, n, (int(rng.integers(1, 60)), 3))


@examples(40)
@given(seeds, st.integers(-20, 20))
def test_raster_knows_no_unit(seed, power):
    V, F = soup(seed)
    here, there = raster(V, F, K, SIZE), raster(2.0**power * V, F, K, SIZE, near_plane=2.0**power * 1e-9)
    assert np.array_equal(here.face, there.face) and np.array_equal(2.0**power * here.depth, there.depth)


@examples(40)
@given(seeds, seeds)
def test_raster_knows_no_order_of_vertices_and_faces(seed, other):
    V, F = soup(seed)
    rng = np.random.default_rng(other)
    order, turn = rng.permutation(len(V)), rng.permutation(len(F))
    here, there = raster(V, F, K, SIZE), raster(V[order], np.argsort(order)[F[turn]], K, SIZE)
    seen = here.face >= 0
    assert np.array_equal(seen, there.face >= 0) and np.allclose(here.depth, there.depth, rtol=1e-9)
    apart = np.abs(V[F[here.face[seen]]].mean(1) - V[F[turn[there.face[seen]]]].mean(1)).max(1) > 1e-12
    assert apart.sum() <= 0.01 * apart.size  # on a shared edge two faces are equally near: the lower number wins


@examples(40)
@given(seeds, st.integers(-30, 30), st.integers(-30, 30))
def test_raster_moves_with_the_principal_point(seed, right, down):
    V, F = soup(seed)
    moved = K.copy()
    moved[:2, 2] += [right, down]
    whole = raster(V, F, K + [[0, 0, 40], [0, 0, 40], [0, 0, 0]], (120, 130))
    part = raster(V, F, moved, SIZE)
    window = (slice(40 - down, 40 - down + SIZE[0]), slice(40 - right, 40 - right + SIZE[1]))
    assert (part.face == whole.face[window]).mean() > 0.995  # centres on an edge may round to its other side
