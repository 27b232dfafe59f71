"""A run with a garment, killed at any landing of a file on disk once the store is there: it goes on with the same bits.

Every file of a run lands whole by `os.replace`, the store's chunks too, so landings are the instants at which a kill leaves
another state behind."""

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support.stored import arrays

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
FRAMES = (0, 3)  # no temporal state between them
PROGRAM = """
import os, signal, sys
from pathlib import Path
from toile.config import preset
from toile.pipeline.run import register

capture, run, kill_at, log = sys.argv[1:]
landings, replace = [], os.replace

def land(source, target, **options):
    landings.append(str(target))
    if len(landings) == int(kill_at):
        os.kill(os.getpid(), signal.SIGKILL)
    replace(source, target, **options)
    Path(log).write_text("\\n".join(landings))

os.replace = land
register(capture, run, preset("draft").model_copy(update={"preparation_frames": 1}), FRAMES)
""".replace("FRAMES", str(FRAMES))


def register(run, kill_at=0):
    """Registers in a process of its own, killed before its n-th landing (never for 0); the targets that landed before."""
    log = run.with_name(f"{run.name}.log")
    done = subprocess.run([sys.executable, "-c", PROGRAM, SAMPLE, run, str(kill_at), log], timeout=600)
    assert done.returncode == (-signal.SIGKILL if kill_at else 0)
    return log.read_text().splitlines() if log.exists() else []


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The run, and how many files landed before the store did and in all."""
    run = tmp_path_factory.mktemp("kills") / "run"
    landings = register(run)
    store = next(i for i, target in enumerate(landings, 1) if target.endswith("/registered.zarr"))
    return run, store, len(landings)


@pytest.fixture(scope="module")
def with_store(undisturbed, tmp_path_factory):
    """A run killed as soon as its store is there, and how many landings it lacks."""
    run, store, landings = undisturbed
    killed = tmp_path_factory.mktemp("kills") / "killed"
    register(killed, store + 1)
    assert (killed / "registered.zarr").exists() and not np.any(arrays(killed)["done"])
    return killed, landings - store


@pytest.mark.slow(seconds=15)
@pytest.mark.parametrize("share", [0.1, 0.4, 0.5, 0.6, 0.9, 1.0], ids="{:.0%}".format)
def test_a_run_killed_during_its_last_pass_goes_on_with_the_same_bits(undisturbed, with_store, tmp_path, share):
    run, left = Path(shutil.copytree(with_store[0], tmp_path / "run")), with_store[1]
    register(run, max(int(share * left), 1))
    before = arrays(run)
    assert share == 1 or "diagnostics/track/skeleton_rms_m" not in before or not before["done"].all()
    register(run)
    once, twice = arrays(undisturbed[0]), arrays(run)
    assert once.keys() == twice.keys() and twice["done"].tolist() == [1] * len(FRAMES)
    for name in (n for n in once if not n.startswith("diagnostics/seconds/")):
        assert np.array_equal(once[name], twice[name], equal_nan=once[name].dtype.kind == "f"), name
    assert not list((run / "work").glob("*.zarr"))


@pytest.mark.slow(seconds=120)
@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.8, 0.95], ids=lambda share: f"{share:.0%}")
def test_a_run_killed_before_its_store_is_there_goes_on_with_the_same_bits(undisturbed, tmp_path, share):
    run, store, _ = undisturbed
    register(tmp_path / "run", max(int(share * store), 1))
    assert not (tmp_path / "run" / "registered.zarr").exists()
    register(tmp_path / "run")
    once, twice = arrays(run), arrays(tmp_path / "run")
    for name in (n for n in once if not n.startswith("diagnostics/seconds/")):
        assert np.array_equal(once[name], twice[name], equal_nan=once[name].dtype.kind == "f"), name
