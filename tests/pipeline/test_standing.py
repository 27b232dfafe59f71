"""How a run stands, while processes work at it and after."""

import json

import pytest
import tomli_w
import zarr

from tests.support.synthetic_run import copy_capture, true_run
from toile.config import from_options, preset
from toile.errors import UserError
from toile.io.status import Status
from toile.pipeline.blocks import FrameFolders
from toile.pipeline.commands.standing import words
from toile.pipeline.standing import standing


@pytest.fixture
def begun(tmp_path):
    """A run of ten frames of which three are through the first pass, 20 s apart, one has failed, and no store is there."""
    run = tmp_path / "run"
    results = FrameFolders(run / "work" / "frames", Status.of(run), "frame")
    for frame in (4, 5, 6, 7):
        results.folder(frame).mkdir(parents=True)
    settings = preset("draft").model_dump(mode="json")
    asked = {"capture": "my capture", "frames": [*range(4, 13), 20], "settings": settings}
    (run / "config.toml").write_text(tomli_w.dumps(asked))
    results.fail(7, UserError("keypoints.json: no keypoint"))
    with open(results.status.path, "a") as file:
        for i, frame in enumerate((4, 5, 6)):
            (results.folder(frame) / "whole").touch()
            line = {"frame": frame, "stage": "track", "seconds": 1.0, "ok": True, "time": 4e9 + 20 * i}
            file.write(json.dumps(line) + "\n")
    return run


def test_a_run_under_way_says_its_pace_and_what_is_left(begun):
    found = standing(begun, now=4e9 + 45)
    assert (found.passed, found.waiting, found.registered) == (3, 6, ())
    assert found.pace == pytest.approx(1 / 20) and found.seconds_left == pytest.approx(120) and found.silence == 5
    first, progress, failed, again = words(begun, found)
    assert first == f"{begun}: 0 of 10 frames registered (0 good, 0 doubtful, 0 wrong), 1 failed"
    assert progress == "  the first pass: 4 of 10 frames, 3 a minute: about 2 min left of it, then the last passes"
    assert failed == "  frame 7: failed: frames/000007: keypoints.json: no keypoint"
    assert again == f"  where it was stopped it goes on with: toile register 'my capture' {begun}"


def test_the_last_passes_are_named_and_who_makes_them(begun):
    results = FrameFolders(begun / "work" / "frames", Status.of(begun), "frame")
    for frame in (*range(8, 13), 20):
        results.folder(frame).mkdir()
        results.end(frame)
    assert standing(begun).last_pass is None
    with results.status.timing(9, stage="fuse"):
        pass
    found = standing(begun)
    assert (found.passed, found.waiting) == (9, 0)
    alone = "one process makes them, with its workers; shards that find it at work wait"
    told = ["the last passes: 1 of 10 frames", f"{alone}; so far: the body under the garments, from all frames"]
    assert [line.strip() for line in words(begun, found)[1:3]] == told


@pytest.mark.parametrize("jump", [-1e8, 1e8])
def test_a_clock_that_jumps_leaves_the_pace_after_it(begun, jump):
    with open(Status.of(begun).path, "a") as file:
        for at in (60, 70, 80):
            file.write(json.dumps({"stage": "track", "ok": True, "time": 4e9 + jump + at}) + "\n")
    found = standing(begun, now=4e9 + jump + 85)
    assert found.pace == pytest.approx(1 / 10) and found.silence == 5


def test_a_line_that_was_cut_takes_no_other_with_it(tmp_path):
    status = Status.of(tmp_path)
    status.add(frame=1, stage="track")
    status.path.write_text(status.path.read_text()[:-9])
    status.add(frame=2, stage="track")
    assert [line["frame"] for line in status.lines()] == [2]


def test_a_run_that_is_being_prepared_says_so(begun):
    Status.of(begun).path.unlink()
    assert "  no frame has ended yet: what all frames need is being made" in words(begun, standing(begun))


def test_a_run_that_has_fallen_silent_is_told(begun):
    lines = words(begun, standing(begun, now=4e9 + 1000))
    assert "  nothing was written for 16 min: is it still running?" in lines


def test_the_command_that_goes_on_has_the_runs_own_settings(begun):
    assert from_options(preset, None, begun / "config.toml", None) == preset("draft")


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """Six frames: the third failed, the fourth is wrong, the fifth doubtful."""
    folder = tmp_path_factory.mktemp("ended")
    run = true_run(copy_capture(folder), folder)
    store = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    store["done"][2], store["verdict"][:] = 2, [0, 0, 2, 2, 1, 0]
    config = (run / "config.toml").read_text()
    (run / "config.toml").write_text(config + f"frames = {store['frames'][:].tolist()}\n")
    for frame, said in {2: {"reason": "no scan"}, 3: {"reasons": ["far off", "no hem"]}}.items():
        (run / "diagnostics" / f"{frame:06d}.json").parent.mkdir(exist_ok=True)
        (run / "diagnostics" / f"{frame:06d}.json").write_text(json.dumps(said))
    return run


def test_a_run_that_has_ended_names_its_bad_frames_and_how_to_give_them_again(ended):
    found = standing(ended)
    assert found.whole and found.registered == (0, 1, 3, 4, 5) and found.seconds_left == 0
    assert (found.failed, found.wrong, list(found.doubtful)) == ({2: "no scan"}, {3: "far off; no hem"}, [4])
    lines = words(ended, found)
    assert lines[0].endswith("5 of 6 frames registered (3 good, 1 doubtful, 1 wrong), 1 failed")
    assert lines[1:3] == ["  frame 2: failed: no scan", "  frame 3: wrong: far off; no hem"]
    assert lines[4].endswith("--retry failed") and lines[5].endswith("--retry wrong")


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(UserError, match="config.toml: the file is missing: the folder holds no run"):
        standing(tmp_path)


def test_lines_carry_the_time_they_were_written(tmp_path):
    status = Status.of(tmp_path)
    status.add(frame=1, stage="track", ok=True)
    (line,) = status.lines()
    assert 1.7e9 < line["time"] < 1e10
