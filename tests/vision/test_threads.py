"""Work spread over threads: the order stays, kernels inside have one thread each, errors come out."""

import pytest

from toile import kernels
from toile.vision.threads import parallel_map


@pytest.fixture(autouse=True)
def two_threads():
    before = kernels.threads()
    kernels.set_threads(2)
    yield
    kernels.set_threads(before)


def test_results_come_in_the_order_of_the_items():
    assert parallel_map(lambda x: x * x, range(50)) == [x * x for x in range(50)]


def test_kernels_inside_have_one_thread_each_and_work_within_work_ends():
    assert parallel_map(lambda _: kernels.threads(), range(8)) == [1] * 8
    assert parallel_map(lambda _: parallel_map(lambda x: x, range(3)), range(8)) == [[0, 1, 2]] * 8
    assert kernels.threads() == 2


def test_an_error_comes_out():
    with pytest.raises(ValueError, match="item 3"):
        parallel_map(lambda x: x if x < 3 else (_ for _ in ()).throw(ValueError(f"item {x}")), range(5))
