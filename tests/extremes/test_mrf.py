"""mrf at the edges of what it may be given. Each row is marked beforehand by its name: *solved* rows must reach the energy of
dynamic programming or of the clean problem, *refused* rows must name what is wrong."""

import numpy as np
import pytest

from toile.kernels import InputError, mrf


def chain(n):
    return np.c_[np.arange(n - 1), np.arange(1, n)]


def best_of_chain(unary, weights, pairwise):
    """The least energy of a chain, by dynamic programming."""
    cost = unary[0]
    for u, w in zip(unary[1:], weights):
        cost = u + (cost[:, None] + w * pairwise).min(0)
    return cost.min()


@pytest.mark.parametrize("labels", [1, 2, 5, 64])
def test_mrf_solved_with_1_to_64_labels(labels):
    rng = np.random.default_rng(labels)
    unary, weights = rng.uniform(0, 1, (200, labels)), rng.uniform(0, 1, 199)
    pairwise = 1.0 - np.eye(labels)
    best = best_of_chain(unary, weights, pairwise)
    assert best - 1e-9 <= mrf(unary, chain(200), weights).energy <= 1.1 * best
    if labels <= 2:
        assert mrf(unary, chain(200), weights).energy == pytest.approx(best)


@pytest.mark.parametrize("cost", [1e3, 1e15, 1e300])
def test_mrf_solved_with_probabilities_of_0_and_1(cost):
    """Every second node is certain; what is between them must still be weighed to the last digit."""
    rng = np.random.default_rng(1)
    unary, weights = rng.uniform(0, 1, (300, 2)), rng.uniform(0, 1, 299)
    truth = rng.integers(0, 2, 300)
    unary[::2] = np.where(np.arange(2) == truth[::2, None], 0, cost)
    result = mrf(unary, chain(300), weights)
    np.testing.assert_array_equal(result.labels[::2], truth[::2])
    assert result.energy == pytest.approx(best_of_chain(unary, weights, 1.0 - np.eye(2)), rel=1e-12)


@pytest.mark.parametrize("scale", [1e-250, 1e-8, 1e12, 1e250])
def test_mrf_solved_in_any_unit_of_energy(scale):
    rng = np.random.default_rng(2)
    unary, weights = rng.uniform(0, 1, (100, 2)), rng.uniform(0, 1, 99)
    best = best_of_chain(unary, weights, 1.0 - np.eye(2))
    assert mrf(scale * unary, chain(100), scale * weights).energy / scale == pytest.approx(best, rel=1e-9)


def test_mrf_solved_with_weights_from_1e_minus_8_to_1e12():
    rng = np.random.default_rng(3)
    unary = rng.uniform(0, 1, (60, 2))
    weights = 10.0 ** rng.uniform(-8, 12, 59)
    best = best_of_chain(unary, weights, 1.0 - np.eye(2))
    assert best - 1e-9 <= mrf(unary, chain(60), weights).energy <= best + 59 * 2.0**-45 * weights.max()


def test_mrf_solved_when_all_labels_cost_the_same():
    result = mrf(np.zeros((50, 3)), chain(50), np.ones(49))
    assert result.energy == 0 and result.stop == "converged"


def test_mrf_solved_with_one_node_and_with_isolated_nodes():
    assert mrf([[3.0, 1.0, 2.0]], [], []).labels.tolist() == [1]
    assert mrf([[3.0, 1], [0, 1], [5, 0]], [[0, 2]], [10.0]).labels.tolist() == [1, 0, 1]


def test_mrf_solved_with_a_hub_of_100000_edges():
    n = 100_001
    unary = np.random.default_rng(4).uniform(0, 1, (n, 2))
    edges, weights = np.c_[np.zeros(n - 1, int), np.arange(1, n)], np.full(n - 1, 0.3)
    sides = [unary[0, h] + np.minimum(unary[1:] + 0.3 * (np.arange(2) != h), np.inf).min(1).sum() for h in (0, 1)]
    assert mrf(unary, edges, weights).energy == pytest.approx(min(sides), rel=1e-12)


@pytest.mark.slow
def test_mrf_solved_on_1_000_000_nodes():
    n = 1_000_000
    rng = np.random.default_rng(5)
    unary, weights = rng.uniform(0, 1, (n, 2)), rng.uniform(0, 1, n - 1)
    result = mrf(unary, chain(n), weights)
    assert result.energy == pytest.approx(best_of_chain(unary, weights, 1.0 - np.eye(2)), rel=1e-9)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_mrf_refuses_what_is_not_finite(value):
    unary, weights = np.zeros((20, 3)), np.ones(19)
    bad = unary.copy()
    bad[7, 2] = value
    with pytest.raises(InputError, match=r"unary\[7\] is not finite"):
        mrf(bad, chain(20), weights)
    weights[11] = value
    with pytest.raises(InputError, match=r"weights\[11\] is not finite"):
        mrf(unary, chain(20), weights)


def test_mrf_refuses_weights_whose_sum_overflows_or_vanishes():
    with pytest.raises(InputError, match="weights of one node sum to infinity"):
        mrf(np.zeros((3, 2)), chain(3), [1.7e308, 1.7e308])
    with pytest.raises(InputError, match="less than 1e-280"):
        mrf(np.zeros((3, 2)), chain(3), [1e-300, 1e-300])


def grid(height, width):
    at = np.arange(height * width).reshape(height, width)
    return np.vstack([np.c_[at[:, :-1].ravel(), at[:, 1:].ravel()], np.c_[at[:-1].ravel(), at[1:].ravel()]])


@pytest.mark.parametrize("labels", [2, 5, 64])
def test_mrf_solved_with_ugly_edges_as_with_clean_ones(labels):
    """Edges turned about, split in two, of weight zero, between far nodes; costs shifted at each node."""
    rng = np.random.default_rng(6)
    edges = grid(15, 20)
    unary, weights = rng.uniform(0, 1, (300, labels)), rng.uniform(0, 0.4, len(edges))
    clean = mrf(unary, edges, weights)
    turned = np.where(rng.random(len(edges))[:, None] < 0.5, edges, edges[:, ::-1])
    void = rng.permutation(300).reshape(-1, 2)
    ugly_edges, ugly_weights = np.vstack([turned, edges, void]), np.r_[weights / 4, 0.75 * weights, np.zeros(len(void))]
    shift = rng.uniform(-1e6, 1e6, 300)
    ugly = mrf(unary + shift[:, None], ugly_edges, ugly_weights)
    if labels == 2:
        assert ugly.energy - shift.sum() == pytest.approx(clean.energy, abs=1e-5)
    x = ugly.labels
    energy = unary[np.arange(300), x].sum() + weights[x[edges[:, 0]] != x[edges[:, 1]]].sum()
    assert energy <= 1.01 * clean.energy


@pytest.mark.parametrize("labels", [2, 5, 64])
def test_mrf_solved_with_all_probabilities_0_or_1(labels):
    """-log of certain votes, clipped as the documentation says: unanimous regions keep their label exactly."""
    truth = np.repeat(np.arange(8) % labels, 50)
    p = np.eye(labels)[truth]
    result = mrf(-np.log(np.maximum(p, 1e-300)), chain(400), np.full(399, 5.0))
    np.testing.assert_array_equal(result.labels, truth)
    assert result.energy == pytest.approx(5.0 * (np.diff(truth) != 0).sum())


@pytest.mark.parametrize("weight", [1e-8, 1e-4, 1e4, 1e7, 1e12])
def test_mrf_solved_with_couplings_from_void_to_rigid(weight):
    unary = np.random.default_rng(7).uniform(0, 1, (200, 5))
    labels = mrf(unary, chain(200), np.full(199, weight)).labels
    free, one = unary.argmin(1), unary.sum(0).argmin()
    np.testing.assert_array_equal(labels, free if weight < 1e-3 else np.full(200, one))


def test_mrf_solved_with_several_components_as_each_by_itself():
    rng = np.random.default_rng(8)
    unary, weights = rng.uniform(0, 1, (90, 2)), rng.uniform(0, 0.5, 29)
    edges = np.vstack([chain(30) + 30 * k for k in range(3)])
    whole = mrf(unary, edges, np.tile(weights, 3)).labels
    for k in range(3):
        np.testing.assert_array_equal(
            whole[30 * k : 30 * k + 30], mrf(unary[30 * k : 30 * k + 30], chain(30), weights).labels
        )


@pytest.mark.slow
def test_mrf_solved_on_1_000_000_nodes_of_a_grid_with_5_labels():
    edges = grid(1000, 1000)
    rng = np.random.default_rng(9)
    truth = (np.arange(1000)[:, None] // 250 + np.arange(1000)[None] // 500).ravel() % 5
    unary = rng.uniform(0, 1, (1_000_000, 5))
    unary[np.arange(1_000_000), truth] -= 0.4
    result = mrf(unary, edges, np.full(len(edges), 0.5))
    assert result.stop == "converged" and (result.labels == truth).mean() > 0.99


REFUSED = {
    "unary is empty": dict(unary=np.zeros((0, 3))),
    "weights has 3 entries": dict(weights=np.ones(3)),
    r"edges\[4\]": dict(edges=np.vstack([chain(20)[:4], [[3, 20]], chain(20)[5:]])),
    r"edges\[4\].*": dict(edges=np.vstack([chain(20)[:4], [[3, 3]], chain(20)[5:]])),
    r"edges\[0\]": dict(edges=np.vstack([[[-1, 2]], chain(20)[1:]])),
    r"weights\[2\] is negative": dict(weights=np.r_[1, 1, -1e-300, np.ones(16)]),
    "pairwise is empty": dict(pairwise=np.zeros((0, 0))),
    r"pairwise\[0, 1\] differs": dict(pairwise=[[0, 1, 1], [2, 0, 1], [1, 1, 0]]),
    "pairwise": dict(pairwise=[[0, 1, 9], [1, 0, 1], [9, 1, 0]]),
    "pairwise.*finite": dict(pairwise=[[0, 1, np.nan], [1, 0, 1], [np.nan, 1, 0]]),
    "start": dict(start=[7] * 20),
    r"prefer\[0\]": dict(prefer=[(20, 0)]),
    r"forbid\[1\]": dict(forbid=[(0, 0), (1, 3)]),
    "vote_cost is negative or not finite": dict(vote_cost=np.nan),
}


@pytest.mark.parametrize("message", REFUSED)
def test_mrf_refuses_by_name_and_index(message):
    given = dict(unary=np.zeros((20, 3)), edges=chain(20), weights=np.ones(19)) | REFUSED[message]
    with pytest.raises(InputError, match="mrf: " + message):
        mrf(**given)
