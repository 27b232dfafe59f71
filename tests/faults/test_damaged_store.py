"""A chunk of a finished run that is cut, changed or gone: it is named, and the frame is made again with the same bits."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.support.stored import arrays, cut, flip, lose
from toile.config import preset
from toile.errors import UserError
from toile.io.run import open_run
from toile.measure.evaluate import evaluate
from toile.pipeline.run import register

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
CONFIG = preset("draft").model_copy(update={"preparation_frames": 1})
FRAMES = (0, 3)  # no temporal state between them


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    run = tmp_path_factory.mktemp("damaged") / "run"
    assert register(SAMPLE, run, CONFIG, FRAMES).ok == FRAMES
    return run


@pytest.mark.parametrize("key", ["track/vertices", "labels", "garment/tshirt/vertices"])
@pytest.mark.parametrize("harm, frames", [(flip, [3]), (cut, [0, 3]), (lose, [0, 3])])
def test_damage_is_found_and_its_frames_named(whole, tmp_path, harm, frames, key):
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    harm(run, key, 1)
    opened = open_run(run)
    assert list(opened.damaged(FRAMES)) == frames and f"{key}: frame 3: " in opened.damaged([3])[3]


@pytest.mark.parametrize("harm, frames", [(flip, [3]), (cut, [0, 3])])
def test_damaged_frames_are_made_again_to_the_same_bits(whole, tmp_path, harm, frames):
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    harm(run, "inner/vertices", 1)
    with pytest.raises(UserError, match=f"inner/vertices: frame {frames[0]}: cannot be read"):
        evaluate(run)
    outcome = register(SAMPLE, run, CONFIG, FRAMES)
    assert outcome.ok == FRAMES and len(outcome.notes) == len(frames)
    assert all(f"frame {n}" in line and "made again" in line for n, line in zip(frames, outcome.notes))
    once, twice = arrays(whole), arrays(run)
    for name in (n for n in once if not n.startswith("diagnostics/seconds/")):
        assert np.array_equal(once[name], twice[name], equal_nan=once[name].dtype.kind == "f"), name
