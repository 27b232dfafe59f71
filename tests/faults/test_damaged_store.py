"""A chunk of a finished run that is cut, changed or gone: it is named, and the frame is made again with the same bits."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import zarr

from toile.config import preset
from toile.errors import UserError
from toile.io.run import open_run
from toile.measure.evaluate import evaluate
from toile.pipeline.run import register

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
CONFIG = preset("draft").model_copy(update={"preparation_frames": 1})
FRAMES = (0, 3)  # no temporal state between them


def arrays(run):
    group = zarr.open_group(str(run / "registered.zarr"), mode="r")
    return {name: item[...] for name, item in group.members(max_depth=None) if isinstance(item, zarr.Array)}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    run = tmp_path_factory.mktemp("damaged") / "run"
    assert register(SAMPLE, run, CONFIG, FRAMES).ok == FRAMES
    return run


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


DAMAGE = {"cut": cut, "changed": flip, "gone": Path.unlink}


@pytest.mark.parametrize("key", ["track/vertices", "labels", "garment/tshirt/vertices"])
@pytest.mark.parametrize("kind", DAMAGE)
def test_a_damaged_chunk_is_found_and_its_frame_named(whole, tmp_path, kind, key):
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    chunk = run / "registered.zarr" / key / "c" / "1" / "0"
    DAMAGE[kind](chunk / "0" if chunk.is_dir() else chunk)
    opened = open_run(run)
    assert not opened.damaged([0]) and list(opened.damaged(FRAMES)) == [3]
    assert f"{key}: frame 3: " in opened.damaged([3])[3]


def test_a_damaged_frame_is_made_again_and_the_others_are_not_touched(whole, tmp_path):
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    chunk = run / "registered.zarr" / "inner" / "vertices" / "c" / "1" / "0" / "0"
    cut(chunk)
    with pytest.raises(UserError, match="inner/vertices: frame 3: cannot be read"):
        evaluate(run)
    others = {p: p.stat().st_mtime_ns for p in run.glob("registered.zarr/**/c/0/0/0")}
    outcome = register(SAMPLE, run, CONFIG, FRAMES)
    assert outcome.ok == FRAMES and any("frame 3" in line and "made again" in line for line in outcome.notes)
    assert {p: p.stat().st_mtime_ns for p in others} == others
    once, twice = arrays(whole), arrays(run)
    for name in (n for n in once if not n.startswith("diagnostics/seconds/")):
        assert np.array_equal(once[name], twice[name], equal_nan=once[name].dtype.kind == "f"), name
