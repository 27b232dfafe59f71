"""How many threads numpy's and scipy's BLAS may use."""

import numpy
import scipy.linalg
from threadpoolctl import threadpool_info

FOLDERS = tuple(f"/{module.__name__}" for module in (numpy, scipy))


def most_blas_threads():
    """The larger of numpy's and scipy's numbers; other packages bring a BLAS of their own, which toile does not call."""
    assert scipy.linalg
    ours = [pool for pool in threadpool_info() if any(folder in pool["filepath"] for folder in FOLDERS)]
    return max(pool["num_threads"] for pool in ours)
