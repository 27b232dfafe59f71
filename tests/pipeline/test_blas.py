"""The number of BLAS threads is no matter: what numpy and scipy compute for a run, one thread computes."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import zarr
from threadpoolctl import threadpool_limits

from tests.support.blas import most_blas_threads
from toile.align.settings import AlignSettings
from toile.pipeline.run import register
from toile.pipeline.threads import one_blas_thread
from toile.prints.smoothing import over_time

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


@pytest.mark.parametrize("count", [1, 2, 8])
def test_dense_solves_give_the_same_bits_for_any_number_of_blas_threads(count):
    frames = range(120)
    slides = [np.random.default_rng(n).normal(size=(2000, 2)) for n in frames]

    def smooth():
        with one_blas_thread():
            return over_time(frames, slides, frames, 30.0, AlignSettings())

    with threadpool_limits(3, "blas"):
        once = smooth()
    with threadpool_limits(count, "blas"):
        assert np.array_equal(smooth(), once)
        assert most_blas_threads() == count  # the caller's number is put back


def test_blas_is_let_go_when_the_last_of_two_threads_that_hold_it_has_ended():
    """The first to end gave the other its caller's number, and the last one put back 1. threadpoolctl lets no thread set it
    beside one that has, as the main one here."""
    with threadpool_limits(3, "blas"):
        with ThreadPoolExecutor(2) as pool:
            first, second = (pool.submit(one_blas_thread).result() for _ in range(2))
            pool.submit(first.__exit__, None, None, None).result()
            assert most_blas_threads() == 1
            pool.submit(second.__exit__, None, None, None).result()
        assert most_blas_threads() == 3


def test_registration_holds_blas_to_one_thread(tmp_path):
    class Seen(Exception):
        pass

    def progress(*_):
        raise Seen(most_blas_threads())

    with threadpool_limits(8, "blas"), pytest.raises(Seen, match="^1$"):
        register(SAMPLE, tmp_path / "run", frames=(0,), progress=progress)


@pytest.mark.slow
def test_register_and_align_give_the_same_bits_with_1_and_8_blas_threads(tmp_path):
    quick = dict(lattice_spacing=0.012, blurs=(0.024, 0.012), blur_steps=(2, 1), anchor_frames=2, sample_frames=1)
    program = f"""
import sys
from pathlib import Path
from threadpoolctl import threadpool_limits
from toile.align.run import align
from toile.align.settings import AlignSettings
from toile.config import preset
from toile.pipeline.run import register
threads, out = int(sys.argv[1]), Path(sys.argv[2])
import scipy.linalg
threadpool_limits(threads, "blas")  # OPENBLAS_NUM_THREADS cannot ask for more than there are processors
assert register(Path({str(SAMPLE)!r}), out / "run", preset("draft"), (0, 1)).ok == (0, 1)
assert align(out / "run", out / "aligned", AlignSettings(**{quick!r})).whole
"""
    for threads in ("1", "8"):
        command = [sys.executable, "-c", program, threads, str(tmp_path / threads)]
        subprocess.run(command, check=True, timeout=550, env=dict(os.environ, OPENBLAS_NUM_THREADS=threads))
    for run in ("run", "aligned"):
        once, twice = (arrays(tmp_path / threads / run / "registered.zarr") for threads in ("1", "8"))
        assert once.keys() == twice.keys() and once
        for name, array in once.items():
            assert np.array_equal(array, twice[name], equal_nan=array.dtype.kind == "f"), f"{run}: {name}"


def arrays(path):
    """All arrays of a run but its timings."""
    members = zarr.open_group(str(path), mode="r").members(max_depth=None)
    return {
        name: item[...] for name, item in members if isinstance(item, zarr.Array) and not name.startswith("diagnostics")
    }
