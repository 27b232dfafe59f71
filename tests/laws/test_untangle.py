"""Laws of untangle on a shell around an egg: it moves and scales with its input, and no order counts."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from toile.kernels import intersecting_pairs, untangle, vertex_normals

from .motions import egg, examples, rigid, seeds, shuffled, similar

DEPTHS, DEEP = st.floats(0, 0.012), st.floats(0, 0.05)


def problem(seed, depth):
    """The lower half of an egg's shell, pushed in by up to `depth` [m]."""
    V, F = egg(2)
    rng = np.random.default_rng(seed)
    push = 0.004 - depth * (0.5 + 0.5 * np.sin(V @ rng.normal(0, 5, 3)))
    cloth = V + push[:, None] * vertex_normals(V, F) + rng.normal(0, 5e-4, V.shape)
    return cloth, F[(V[F][:, :, 2] < 0.2).all(1)], V, F


@examples(10)
@given(seeds, DEEP, similar)
def test_untangle_moves_and_scales_with_its_input(seed, depth, motion):
    cloth, cloth_F, V, F = problem(seed, depth)
    s = motion.scale
    there = untangle(motion(cloth), cloth_F, motion(V), F, margin=0.002 * s, spread=0.03 * s, max_depth=0.05 * s)
    here = untangle(cloth, cloth_F, V, F)
    assert there.stop == here.stop and np.abs(motion.back(there.V) - here.V).max() < 1e-9


@examples(10)
@given(seeds, DEPTHS, seeds)
def test_untangle_knows_no_order_of_cloth_and_body(seed, depth, other):
    cloth, cloth_F, V, F = problem(seed, depth)
    W, G, order = shuffled(cloth, cloth_F, other)
    B, H, _ = shuffled(V, F, other + 1)
    there, here = untangle(W, G, B, H), untangle(cloth, cloth_F, V, F)
    assert there.stop == here.stop and np.abs(there.V - here.V[order]).mean() < 5e-4


@examples(10)
@given(seeds, DEPTHS, rigid)
def test_untangle_leaves_nothing_inside_and_hardly_moves_what_is_clear(seed, depth, motion):
    cloth, cloth_F, V, F = problem(seed, depth)
    result = untangle(motion(cloth), cloth_F, motion(V), F)
    assert result.stop == "clear" and len(intersecting_pairs(result.V, cloth_F, motion(V), F)) == 0
    again = untangle(result.V, cloth_F, motion(V), F)
    assert again.stop == "clear" and np.abs(again.V - result.V).max() < 1e-3
