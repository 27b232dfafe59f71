"""Laws of biharmonic on random patches: it moves with its input, is linear, and knows no order."""

import numpy as np
from hypothesis import given

from toile.kernels import biharmonic

from .motions import examples, seeds, sheet, shuffled, similar

RIM = [k for k in range(81) if k // 9 in (0, 1, 7, 8) or k % 9 in (0, 8)]


def problem(seed):
    V, F = sheet(seed=seed)
    return V, F, np.random.default_rng(seed + 1).normal(0, 0.1, (len(RIM), 3))


@examples(12)
@given(seeds, similar)
def test_biharmonic_moves_and_scales_with_its_input(seed, motion):
    V, F, D = problem(seed)
    moved = biharmonic(motion(V), F, RIM, motion.turn(D))
    assert np.abs(moved - motion.turn(biharmonic(V, F, RIM, D))).max() < 1e-7 * motion.scale


@examples(12)
@given(seeds, seeds)
def test_biharmonic_knows_no_order_of_vertices_and_faces(seed, other):
    V, F, D = problem(seed)
    W, G, order = shuffled(V, F, other)
    known = [k for k in range(81) if order[k] in RIM]
    rows = [RIM.index(order[k]) for k in known]
    assert np.abs(biharmonic(W, G, known, D[rows]) - biharmonic(V, F, RIM, D)[order]).max() < 1e-8


@examples(12)
@given(seeds, seeds)
def test_biharmonic_is_linear_and_returns_translations_exactly(seed, other):
    V, F, D = problem(seed)
    E, t = problem(other)[2], np.random.default_rng(other).normal(size=3)
    both = biharmonic(V, F, RIM, 2 * D - 3 * E)
    assert np.abs(both - 2 * biharmonic(V, F, RIM, D) + 3 * biharmonic(V, F, RIM, E)).max() < 1e-8
    assert np.array_equal(biharmonic(V, F, RIM, np.tile(t, (len(RIM), 1))), np.tile(t, (len(V), 1)))
