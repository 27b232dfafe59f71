"""cheapest_path against every path there is."""

import itertools

import numpy as np
import pytest

from toile import kernels


@pytest.mark.parametrize("seed", range(5))
def test_no_path_is_cheaper(seed):
    rng = np.random.default_rng(seed)
    cost, step = rng.normal(size=(5, 4)), rng.random((4, 4))

    def price(path):
        return cost[np.arange(5), path].sum() + sum(step[a, b] for a, b in itertools.pairwise(path))

    found = kernels.cheapest_path(cost, step)
    assert price(found) == pytest.approx(min(price(p) for p in itertools.product(range(4), repeat=5)), abs=1e-12)


def test_one_row_is_its_cheapest_entry_and_free_steps_take_each_row_s():
    cost = np.random.default_rng(0).normal(size=(20, 7))
    assert kernels.cheapest_path(cost[:1], np.zeros((7, 7))) == cost[0].argmin()
    assert np.array_equal(kernels.cheapest_path(cost, np.zeros((7, 7))), cost.argmin(1))


def test_what_does_not_fit_is_refused():
    for cost, step, said in (
        (np.zeros((0, 3)), np.zeros((3, 3)), "empty"),
        (np.zeros((2, 3)), np.zeros((2, 2)), "step"),
    ):
        with pytest.raises(kernels.InputError, match=said):
            kernels.cheapest_path(cost, step)
    with pytest.raises(kernels.InputError, match="cost"):
        kernels.cheapest_path(np.full((2, 3), np.nan), np.zeros((3, 3)))
