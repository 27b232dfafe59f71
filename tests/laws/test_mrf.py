"""Laws of mrf on random graphs: energies add up, no order and no unit counts, and no single node can do better."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from toile.kernels import mrf

from .motions import examples, seeds


def graph(seed, labels):
    rng = np.random.default_rng(seed)
    n, e = int(rng.integers(2, 40)), int(rng.integers(0, 120))
    edges = rng.integers(0, n, (e, 2))
    edges = edges[edges[:, 0] != edges[:, 1]]
    return rng.normal(0, 3, (n, labels)), edges, rng.random(len(edges))


def metric(seed, labels):
    x = np.random.default_rng(seed).normal(size=(labels, 2))
    return np.linalg.norm(x[:, None] - x[None], axis=2)


def energy(labels, unary, edges, weights, V):
    return unary[np.arange(len(unary)), labels].sum() + (weights * V[labels[edges[:, 0]], labels[edges[:, 1]]]).sum()


@examples(30)
@given(seeds, st.integers(1, 5))
def test_mrf_energy_is_that_of_its_labels_and_no_node_alone_does_better(seed, count):
    unary, edges, weights = graph(seed, count)
    V = metric(seed, count)
    result = mrf(unary, edges, weights, V)
    assert np.isclose(result.energy, energy(result.labels, unary, edges, weights, V))
    for node in range(len(unary)):
        for label in range(count):
            other = result.labels.copy()
            other[node] = label
            assert energy(other, unary, edges, weights, V) >= result.energy - 1e-9


@examples(30)
@given(seeds, seeds)
def test_mrf_of_two_labels_knows_no_order_of_nodes_edges_and_labels(seed, other):
    unary, edges, weights = graph(seed, 2)
    rng = np.random.default_rng(other)
    order, turn = rng.permutation(len(unary)), rng.permutation(len(edges))
    rank = np.argsort(order)
    there = mrf(unary[order][:, ::-1], rank[edges[turn][:, ::-1]], weights[turn])
    here = mrf(unary, edges, weights)
    assert np.isclose(there.energy, here.energy) and np.array_equal(1 - there.labels[rank], here.labels)


@examples(20)
@given(seeds, st.integers(-40, 40), st.integers(2, 5))
def test_mrf_knows_no_unit_of_energy(seed, power, count):
    unary, edges, weights = graph(seed, count)
    here, there = mrf(unary, edges, weights), mrf(2.0**power * unary, edges, 2.0**power * weights)
    assert np.array_equal(here.labels, there.labels) and np.isclose(here.energy * 2.0**power, there.energy, atol=0)
