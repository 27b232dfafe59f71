"""Laws of nricp on a bent egg: it moves and scales with its input, and neither order counts."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from toile.kernels import SurfaceIndex, nricp

from .motions import egg, examples, rigid, seeds, shuffled, similar


def problem(amount=0.04):
    (V, F), (W, G) = egg(2), egg(3)
    return V, F, W + amount * np.c_[W[:, 2] ** 2, 0.5 * np.sin(2 * W[:, 2]), -W[:, 0] * W[:, 2]], G


def apart(a, b):
    return np.linalg.norm(a - b, axis=1).mean()


@examples(8)
@given(similar, st.sampled_from(["draft", "standard"]))
def test_nricp_moves_and_scales_with_its_input(motion, preset):
    V, F, scan_V, scan_F = problem()
    there = nricp(motion(V), F, motion(scan_V), scan_F, preset)
    here = nricp(V, F, scan_V, scan_F, preset)
    assert apart(motion.back(there.V), here.V) < 1e-5 and there.iterations == here.iterations


@examples(8)
@given(seeds)
def test_nricp_knows_no_order_of_the_scan(seed):
    V, F, scan_V, scan_F = problem()
    W, G, _ = shuffled(scan_V, scan_F, seed)
    assert apart(nricp(V, F, W, G).V, nricp(V, F, scan_V, scan_F).V) < 1e-5


@examples(8)
@given(seeds)
def test_nricp_reaches_the_surface_in_any_order_of_the_template(seed):
    V, F, scan_V, scan_F = problem()
    W, G, order = shuffled(V, F, seed)
    there, here = nricp(W, G, scan_V, scan_F), nricp(V, F, scan_V, scan_F)
    index = SurfaceIndex(scan_V, scan_F)
    assert abs(index.closest(there.V)[3].mean() - index.closest(here.V)[3].mean()) < 2e-4
    assert apart(there.V, here.V[order]) < 1e-3  # other nodes: the sliding differs


@examples(8)
@given(rigid)
def test_nricp_of_a_small_rigid_motion_is_that_motion(motion):
    """A twentieth of the turn and a hundredth of the shift: what a scan at 30 frames a second shows."""
    from scipy.spatial.transform import Rotation

    V, F = egg(3)
    turn = Rotation.from_matrix(motion.R).as_rotvec() / 20
    moved = V @ Rotation.from_rotvec(turn).as_matrix().T + motion.t / 200
    assert apart(nricp(V, F, moved, F).V, moved) < 4e-3
