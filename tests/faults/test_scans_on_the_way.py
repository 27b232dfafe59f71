"""A run that makes its scans on the way, killed about their landings or made by shards: the bits of an undisturbed one.

Each frame lies in a block of its own, as shards take whole blocks; the preparation makes the first one's scan, the pass the
other's."""

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.pipeline.test_run import arrays, assert_same_bits

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
FRAMES = ("000000", "000050")
PROGRAM = """
import os, signal, sys
from toile.config import preset
from toile.pipeline.run import register

capture, run, shard, kill_at, after = sys.argv[1:]
replace = os.replace

def land(source, target, **options):
    doomed = kill_at and str(target).endswith(kill_at)
    if not doomed or int(after):
        replace(source, target, **options)
    if doomed:
        os.kill(os.getpid(), signal.SIGKILL)

os.replace = land
config = preset("draft").model_copy(update={"preparation_frames": 1})
register(capture, run, config, shard=(int(shard), 2) if int(shard) else (1, 1))
"""


def register(capture, run, shard=0, kill_at="", after=False):
    """In a process of its own, killed at the landing of a file or folder whose path ends so, just before it or `after`."""
    given = [str(capture), str(run), str(shard), kill_at, str(int(after))]
    done = subprocess.run([sys.executable, "-c", PROGRAM, *given], timeout=1200)
    assert done.returncode == (-signal.SIGKILL if kill_at else 0)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """(capture of pictures alone, without garments; its run)."""
    folder = tmp_path_factory.mktemp("scans")
    capture = Path(shutil.copytree(SAMPLE, folder / "capture", ignore=shutil.ignore_patterns("frames", "truth")))
    for source, name in zip(("000000", "000003"), FRAMES):
        shutil.copytree(
            SAMPLE / "frames" / source, capture / "frames" / name, ignore=shutil.ignore_patterns("scan.ply")
        )
    scene = (capture / "scene.toml").read_text()
    start, end = scene.index("[[garment]]"), scene.index("[cameras]")
    (capture / "scene.toml").write_text(scene[:start] + scene[end:])
    register(capture, folder / "run")
    return capture, folder / "run"


def assert_same_run(once, twice):
    assert_same_bits(arrays(once), arrays(twice))
    for name in FRAMES:
        for path in (once / "scans" / name).iterdir():
            assert path.read_bytes() == (twice / "scans" / name / path.name).read_bytes(), path.name
    assert sorted(p.name for p in (twice / "scans").iterdir()) == sorted(FRAMES)


@pytest.mark.slow(seconds=60)
@pytest.mark.parametrize("after", [False, True], ids=["before it lands", "after"])
@pytest.mark.parametrize("frame", FRAMES)
def test_a_run_killed_at_a_scan_goes_on_with_the_same_bits(undisturbed, tmp_path, frame, after):
    capture, once = undisturbed
    register(capture, tmp_path / "run", kill_at=f"scans/{frame}", after=after)
    assert (tmp_path / "run" / "scans" / frame / "scan.ply").exists() == after
    register(capture, tmp_path / "run")
    assert_same_run(once, tmp_path / "run")


@pytest.mark.slow(seconds=60)
def test_shards_one_of_them_killed_at_its_scan_make_the_same_bits(undisturbed, tmp_path):
    capture, once = undisturbed
    register(capture, tmp_path / "run", shard=2, kill_at=f"scans/{FRAMES[1]}")
    register(capture, tmp_path / "run", shard=1)
    register(capture, tmp_path / "run", shard=2)
    assert_same_run(once, tmp_path / "run")
