"""A trial before a long job: which frames, what the job takes, what held-out cameras and the template's loops say."""

import json
import multiprocessing
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.synthetic_run import copy_capture, true_run
from toile.config import preset
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.layout import FAILED, OK
from toile.io.run import open_run
from toile.pipeline.commands.tune import tune as tune_command
from toile.pipeline.tuning import tune
from toile.pipeline.tuning.fit import LoopFit, diagnosis
from toile.pipeline.tuning.forecast import in_one_process, on_workers
from toile.pipeline.tuning.heldout import agreement, witnesses
from toile.pipeline.tuning.trial import Cost, Trial, alone, first_at_each_place, sampled, tried
from toile.pipeline.tuning.tune import failures

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


def trial(frames, begin=3.0, follow=1.0):
    """A trial of frames whose first pass takes as long as their stages say, and 0.5 s each in the last ones, which begin with
    2 s for all of them; on a core and a half."""
    begun = alone(frames)
    stages = {n: {"track": begin if n in begun else follow, "inner": 9.0} for n in frames}
    wall = sum(of["track"] for of in stages.values())
    last = Cost(2 + 0.5 * len(frames), 3 + 0.75 * len(frames))
    costs = Cost(10.0, 15.0), Cost(wall, 1.5 * wall), last, Cost(0.5, 0.75)
    return Trial("draft", Path("run"), tuple(frames), *costs, 10**9, 2e5, 1e6, 5 * 10**6, stages)


def test_frames_are_tried_at_places_over_the_whole_sequence_with_those_after_them():
    found = sampled(range(100, 1100))
    assert len(found) == 17 and found[:6] == (100, 101, 102, 103, 104, 349) and found[-3:] == (1097, 1098, 1099)
    assert sampled(range(7)) == tuple(range(7)) and sampled([5]) == (5,)
    assert first_at_each_place(found) == (100, 349, 598, 848, 1097) == tuple(n for n in found if n - 1 not in found)
    assert first_at_each_place((5,)) == (5,)


def test_frames_begin_alone_at_blocks_and_after_gaps():
    assert alone([48, 49, 50, 51, 60, 61, 63]) == {48, 50, 60, 63}


def test_a_job_of_the_trials_own_frames_takes_what_the_trial_took():
    frames = (0, 1, 2, 100, 101, 102, 200, 201, 202, 300, 301, 302, 397, 398, 399)
    found = in_one_process(trial(frames), frames)
    assert found.seconds == pytest.approx(10 + (5 * 3 + 10 * 1) + 2 + 0.5 * 15)
    assert found.disk == 5 * 10**6 + 15 * 10**6 and found.passing == 15 * 2 * 10**5 and found.memory == 10**9


def test_frames_that_follow_one_another_cost_less_than_those_that_begin():
    whole = in_one_process(trial(sampled(range(400))), range(400))
    assert whole.seconds == pytest.approx(10 + 8 * 3 + 392 * 1 + 2 + 0.5 * 400)
    apart = in_one_process(trial(sampled(range(400))), range(0, 2000, 5))
    assert apart.seconds == pytest.approx(10 + 400 * 3 + 2 + 0.5 * 400)


def test_workers_take_whole_blocks():
    tried = trial(sampled(range(200)))
    one, two, four, eight = (on_workers(tried, range(200), count) for count in (1, 2, 4, 8))
    assert one.seconds - 18 == pytest.approx(2 * (two.seconds - 18)) == pytest.approx(4 * (four.seconds - 18))
    assert eight.seconds == pytest.approx(four.seconds) and eight.memory == 8 * one.memory
    assert on_workers(tried, range(150), 2).seconds - 18 == pytest.approx(
        2 / 3 * (on_workers(tried, range(150), 1).seconds - 18)
    )


def test_true_layers_agree_with_cameras_that_no_one_showed_them(tmp_path):
    capture = open_capture(copy_capture(tmp_path))
    cameras = witnesses(capture, 0)
    assert len(cameras) == 2 and not set(cameras) & set(capture.without(cameras).cameras)
    run = open_run(true_run(capture.root, tmp_path))
    true = agreement(run, capture, cameras)
    assert true["silhouette"] > 0.97 and true["tshirt"] > 0.8
    moved = capture.cameras[cameras[0]]
    moved.K[0, 2] += 20  # the same layers, 20 pixels beside
    assert agreement(run, capture, cameras[:1])["silhouette"] < true["silhouette"] - 0.1


def test_frames_that_a_trial_could_not_register_are_told_with_why():
    why = {2: {"reason": "labels/cam02.png: cannot be read"}}
    run = SimpleNamespace(
        done=np.array([OK, OK, FAILED]), frames=np.array([0, 1, 2]), diagnostics=SimpleNamespace(at=why.get)
    )
    assert list(failures(run)) == ["frame 2 failed: labels/cam02.png: cannot be read"]


def test_few_cameras_are_all_shown():
    capture = open_capture(SAMPLE)
    assert witnesses(capture.without(tuple(capture.cameras)[:4]), 0) == ()


def test_what_a_left_out_camera_has_is_not_read():
    capture = open_capture(SAMPLE)
    name = next(iter(capture.cameras))
    frame, all_of_it = capture.without((name,)).frame(0), capture.frame(0)
    assert name in all_of_it.images and name in all_of_it.keypoints.points
    assert name not in {*frame.images, *frame.labels, *frame.masks, *frame.keypoints.points}
    assert frame.images.keys() | {name} == all_of_it.images.keys()


def fits(**ratios):
    return [LoopFit(name, ratio, 0.9, 2.0) for name, ratio in ratios.items()]


def test_a_template_that_fits_is_said_nothing_of():
    assert diagnosis(fits(hem=1.05, neck=0.97, sleeve=1.0)) == []


def test_a_larger_size_is_told_from_another_cut():
    assert "another size of the same cut" in diagnosis(fits(hem=1.3, neck=1.28, sleeve=1.33))[0]
    size, *loops = diagnosis(fits(hem=1.3, neck=1.28, sleeve=1.9))
    assert "not the same cut" in size and len(loops) == 1 and loops[0].startswith("loop sleeve is 1.90")
    assert diagnosis(fits(hem=1.0, neck=1.02, sleeve=0.6)) == [
        "loop sleeve is 0.60 times as long as the template's, the others 1.00: another cut"
    ]


def test_a_loop_that_no_frame_shows_is_named():
    tucked = [LoopFit("hem", None, 0.02, None), *fits(neck=1.0, sleeve=1.0)]
    assert diagnosis(tucked) == ["loop hem is not seen: missing, tucked in or covered"]


def test_a_folder_that_holds_something_is_not_touched(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("x")
    with pytest.raises(UserError, match="mine: it is there already"):
        tune(open_capture(SAMPLE), tmp_path / "mine", (0, 1))
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["notes.txt"]


def test_a_trial_whose_process_is_ended_from_outside_says_so(tmp_path):
    def end():
        while not (begun := multiprocessing.active_children()):
            time.sleep(0.01)
        begun[0].kill()

    threading.Thread(target=end).start()
    with pytest.raises(
        UserError, match="run: the process that registered was ended from outside, for want of memory perh"
    ):
        tried(open_capture(SAMPLE), tmp_path / "run", preset("draft"), (0,))


def test_an_error_of_a_trial_is_that_of_registering(tmp_path):
    with pytest.raises(UserError, match="frames: no frame 99"):
        tried(open_capture(SAMPLE), tmp_path / "run", preset("draft"), (99,))
    assert not multiprocessing.active_children()


@pytest.mark.slow(seconds=90)
def test_the_command_tries_a_quality_and_leaves_a_page_and_its_figures(tmp_path, capsys):
    out = tmp_path / "trial"
    tune_command(SAMPLE, out, quality=["draft"], workers=[4])
    said, beside = capsys.readouterr()
    told = json.loads((out / "tune.json").read_text())
    assert told["frames"] == [0, 1, 2, 3, 4, 5] and told["template"] == {"tshirt": []}
    here, four = told["qualities"]["draft"]["jobs"]
    assert here["workers"] == 1 and four["workers"] == 4 and 0 < four["seconds"] and here["disk"] > 10**6
    assert told["qualities"]["draft"]["heldout"]["silhouette"] > 0.95
    page = (out / "tune.html").read_text()
    assert "The template fits" in page and page.count("<img") >= 10
    assert "tshirt: the template fits" in said and beside.splitlines()[-1].startswith("next: toile register ")
