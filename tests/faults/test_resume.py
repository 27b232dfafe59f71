"""A run is gone on with whatever has changed: only what depends on it is made again, and what stands stays readable."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import zarr

from tests.support.stored import arrays
from toile import cli
from toile.config import changed, preset
from toile.config.stages import Config
from toile.errors import UserError
from toile.io.run import open_run
from toile.io.status import Status
from toile.pipeline import preparation
from toile.pipeline import run as pipeline
from toile.pipeline.identity import STAGES
from toile.stages import dress, inner, segment, track

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
CONFIG = preset("draft").model_copy(update={"preparation_frames": 1})
FRAMES = (0, 2)  # no temporal state between them


def assert_same_bits(once, twice, but=()):
    assert once.keys() == twice.keys()
    for name in (n for n in once if not n.startswith("diagnostics/seconds/") and n not in but):
        assert np.array_equal(once[name], twice[name], equal_nan=once[name].dtype.kind == "f"), name


def copied(folder, name="capture"):
    return Path(shutil.copytree(SAMPLE, folder / name, ignore=shutil.ignore_patterns("truth", "00000[3-5]")))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """(capture, run) of two frames of the bundled capture, which has a third."""
    folder = tmp_path_factory.mktemp("resume")
    capture = copied(folder)
    assert pipeline.register(capture, folder / "run", CONFIG, FRAMES).ok == FRAMES
    return capture, folder / "run"


@pytest.fixture
def both(whole, tmp_path):
    """Copies of them, side by side, so that they were moved together."""
    return tuple(Path(shutil.copytree(path, tmp_path / path.name)) for path in whole)


@pytest.fixture
def made(monkeypatch):
    """What is made while a test runs, in order: (stage, frame), and the preparation's parts."""
    found = []

    def watch(owner, name, say):
        call = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *a, **k: (found.append(say(*a)), call(*a, **k))[1])

    watch(track.Tracker, "track", lambda self, frame, *_: ("track", frame.number))
    watch(segment, "segment", lambda *_: "segment")
    watch(dress.Dresser, "dress", lambda self, frame, *_: ("dress", frame.number))
    watch(inner.InnerLayer, "body", lambda *_: "inner")
    watch(inner.Fusion, "shape", lambda *_: "fused")
    watch(preparation.track, "prepare", lambda *_: "person")
    watch(segment, "prepare", lambda *_: "colours")
    watch(dress, "prepare", lambda *_: "template")
    return found


def test_every_setting_belongs_to_a_stage():
    named = {name for stage in STAGES.values() for name in stage.settings}
    assert named == set(Config.model_fields) - {"quality"}


def test_nothing_is_made_again_for_what_changes_nothing(both, made):
    capture, run = both
    shutil.rmtree(run / "work")  # that may go
    (capture / ".DS_Store").touch()
    (capture / "frames" / "000000" / "._cam00.png").touch()
    (capture / "frames" / "000000" / "images" / "._cam00.png").touch()
    (capture / "notes.txt").write_text("a good day")
    text = (capture / "scene.toml").read_text()
    (capture / "scene.toml").write_text(f"# a remark\n{text}")
    config = (run / "config.toml").read_text()
    (run / "config.toml").write_text(config.replace('numpy = "', 'numpy = "0.'))
    before = {path: path.stat().st_mtime_ns for path in (run / "registered.zarr").rglob("*") if path.is_file()}
    outcome = pipeline.register(capture, run, CONFIG, FRAMES)
    assert outcome.ok == FRAMES and not outcome.notes and not made
    assert before == {path: path.stat().st_mtime_ns for path in before}


def test_a_run_may_lie_in_its_capture(whole, tmp_path, made):
    capture = copied(tmp_path)
    shutil.copytree(whole[1], capture / "run")
    assert not pipeline.register(capture, capture / "run", CONFIG, FRAMES).notes and not made


def test_what_is_not_given_stays_as_it_was_asked(both, made):
    capture, run = both
    assert pipeline.register(capture, run).ok == FRAMES and not made


def test_another_version_of_toile_makes_everything_again_and_says_so(both, made, monkeypatch):
    capture, run = both
    monkeypatch.setattr("toile.__version__", "99")
    outcome = pipeline.register(capture, run)
    assert outcome.ok == FRAMES and "-> 99; made again: person, " in outcome.notes[0] and "person" in made


def test_a_moved_capture_is_known_again_and_another_one_is_refused_by_what_differs(both, tmp_path, made):
    capture, run = both
    capture.rename(tmp_path / "elsewhere")
    config = (run / "config.toml").read_text()
    (run / "config.toml").write_text(config.replace('capture = "', 'capture = "/gone'))
    with pytest.raises(UserError, match="the capture is gone; where it was moved: toile register WHERE"):
        open_run(run).capture  # noqa: B018
    assert not pipeline.register(tmp_path / "elsewhere", run).notes and not made
    assert open_run(run).capture.root.samefile(tmp_path / "elsewhere")
    other = Path(shutil.copytree(tmp_path / "elsewhere", tmp_path / "other"))
    text = (other / "scene.toml").read_text()
    (other / "scene.toml").write_text(text.replace("fps = 30", "fps = 25"))
    with pytest.raises(UserError, match="time.fps differs from what .* is it another capture"):
        pipeline.register(other, run)
    assert pipeline.register(tmp_path / "elsewhere", run).ok == FRAMES and not made


def said(monkeypatch, capsys, *arguments):
    """(exit code, stderr) of `toile ARGUMENTS`."""
    monkeypatch.setattr(sys, "argv", ["toile", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return ended.value.code, capsys.readouterr().err


def test_every_command_names_one_way_to_a_moved_capture(both, tmp_path, made, monkeypatch, capsys):
    capture, run = both
    aligned, out, there = tmp_path / "aligned", tmp_path / "out", tmp_path / "far" / "there"
    config = (run / "config.toml").read_text().replace('capture = "', 'capture = "/gone')
    (run / "config.toml").write_text(config)
    shutil.copytree(run, aligned)
    (aligned / "config.toml").write_text(f"{config}\n[align]\nrun = {json.dumps(str(run))}\n")
    there.parent.mkdir()
    capture.rename(there)
    for path in (run, aligned):
        for command in (["evaluate", path], ["report", path], ["align", path, out], ["train", path, out]):
            code, words = said(monkeypatch, capsys, *command)
            assert (
                code == 1 and f"the capture is gone; where it was moved: toile register WHERE {path} --moved" in words
            )
    for path in (run, aligned):
        assert said(monkeypatch, capsys, "register", there, path, "--moved")[0] == 0
        assert open_run(path).capture.root.samefile(there)
        assert said(monkeypatch, capsys, "evaluate", path)[0] == 0
    assert not made and not out.exists()
    other = Path(shutil.copytree(there, tmp_path / "other"))
    (other / "frames" / "000002" / "scan.ply").unlink()
    code, words = said(monkeypatch, capsys, "register", other, aligned, "--moved")
    assert code == 1 and "frames/000002/scan.ply differs" in words and open_run(aligned).capture.root.samefile(there)


@pytest.mark.parametrize(
    ("setting", "again"),
    [
        ({"verdict.loop_mm": [1.0, 2.0]}, {"inner"}),
        ({"inner.tolerance": 2e-3}, {"fused", "inner"}),
        ({"dress.contact": 0.01}, {"template", "dress", "fused", "inner"}),
    ],
    ids=["verdict", "inner", "dress"],
)
def test_a_changed_setting_redoes_what_depends_on_it(both, made, setting, again):
    capture, run = both
    outcome = pipeline.register(capture, run, **setting)
    parts = {part if isinstance(part, str) else part[0] for part in made} - {"person", "segment"}
    assert outcome.ok == FRAMES and parts == again
    assert next(iter(setting)) in outcome.notes[0] and "made again: " in outcome.notes[0]
    assert ("segment" in made) == ("template" in again)  # of the frames that the template is made of, and no others
    assert not any(part[0] == "track" for part in made)


def test_a_changed_setting_gives_the_bits_of_a_new_run(both, tmp_path):
    capture, run = both
    config = changed(CONFIG, {"dress.contact": 0.01})
    pipeline.register(capture, run, config, FRAMES)
    pipeline.register(capture, tmp_path / "new", config, FRAMES)
    assert_same_bits(arrays(tmp_path / "new"), arrays(run))


def test_what_stands_is_readable_until_what_takes_its_place_is_whole(both, monkeypatch):
    capture, run = both
    before = arrays(run)
    monkeypatch.setattr(pipeline, "_finish", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        pipeline.register(capture, run, **{"track.skeleton.surface_samples": 1500})
    assert_same_bits(before, arrays(run))
    monkeypatch.undo()
    assert pipeline.register(capture, run).ok == FRAMES
    after = arrays(run)
    assert not np.array_equal(before["track/vertices"], after["track/vertices"])
    assert not list((run / "work").glob("*.zarr"))


def test_a_run_is_extended_and_what_stands_is_not_touched(both, made):
    capture, run = both
    before = arrays(run)
    outcome = pipeline.register(capture, run, frames=(1,))
    assert outcome.ok == (0, 1, 2) and [part for part in made if part[0] == "track"] == [("track", 1)]
    assert not {"person", "template", "fused"} & set(made) and "1 frames more" in outcome.notes[0]
    after = arrays(run)
    assert after["frames"].tolist() == [0, 1, 2] and (after["done"] == 1).all()
    for name, array in before.items():
        if len(array) == 2 and not name.startswith("diagnostics/") and name != "frames":
            assert np.array_equal(after[name][[0, 2]], array, equal_nan=array.dtype.kind == "f"), name


def test_a_repaired_frame_is_noticed_and_made_again_alone(both, tmp_path, made):
    capture, _ = both
    scan, run = capture / "frames" / "000002" / "scan.ply", tmp_path / "new"
    whole = scan.read_bytes()
    scan.write_bytes(whole[:300])
    assert list(pipeline.register(capture, run, CONFIG, FRAMES).failed) == [2]
    assert not open_run(run).damaged(FRAMES)
    scan.write_bytes(whole)
    made.clear()
    outcome = pipeline.register(capture, run)
    assert outcome.ok == FRAMES and outcome.notes == ("files have changed of frame 2: made again",)
    assert [part for part in made if part[0] in ("track", "dress")] == [("track", 2), ("dress", 2)]
    assert not {"person", "template", "fused"} & set(made)


@pytest.mark.slow(seconds=25)
def test_the_preparation_is_made_again_when_the_frames_that_it_lacked_are_back(both, tmp_path, made):
    capture, run = both[0], tmp_path / "new"
    config = preset("draft").model_copy(update={"preparation_frames": 2})
    scan = capture / "frames" / "000002" / "scan.ply"
    whole = scan.read_bytes()
    scan.write_bytes(whole[:300])
    pipeline.register(capture, run, config, FRAMES)
    Status.of(run).add(stage="dress", ok=False, warning="no sampled frame shows loop neck")
    scan.write_bytes(whole)
    made.clear()
    outcome = pipeline.register(capture, run)
    assert {"person", "colours", "template", "fused"} <= set(made) and not outcome.warnings
    pipeline.register(capture, tmp_path / "undisturbed", config, FRAMES)
    assert_same_bits(arrays(tmp_path / "undisturbed"), arrays(run))


def test_a_vote_is_heard_in_the_frames_that_it_names_and_redoes_no_other(both, made):
    capture, run = both
    vote = [{"label": "tshirt", "vertices": [5], "prefer": True, "frames": [2]}]
    (capture / "votes.json").write_text(json.dumps(vote))
    pipeline.register(capture, run)
    assert [part for part in made if part[0] in ("track", "dress")] == [("dress", 2)] and made.count("inner") == 1


def test_frames_are_given_again_by_their_numbers_or_as_the_worst(both, made):
    capture, run = both
    pipeline.register(capture, run, retry=(2,))
    assert [part for part in made if part[0] == "track"] == [("track", 2)]
    made.clear()
    pipeline.register(capture, run, retry="worst:1")
    assert len([part for part in made if part[0] == "track"]) == 1
    for retry in ("worst:0", "worst:x", "best", (7,)):
        with pytest.raises(UserError, match="retry"):
            pipeline.register(capture, run, retry=retry)


def test_a_frame_that_takes_too_long_fails_and_is_given_again(both, tmp_path):
    capture = both[0]
    outcome = pipeline.register(capture, tmp_path / "new", CONFIG, (0,), frame_limit=1e-3)
    assert list(outcome.failed) == [0] and "--frame-limit 0.001" in outcome.failed[0]
    assert pipeline.register(capture, tmp_path / "new", retry="failed").ok == (0,)


def test_a_run_of_an_older_version_and_an_aligned_one_are_refused_by_name(both):
    capture, run = both
    del zarr.open_group(str(run / "registered.zarr"), mode="r+")["identity"]
    with pytest.raises(UserError, match="registered by an older version"):
        pipeline.register(capture, run)
    config = (run / "config.toml").read_text()
    (run / "config.toml").write_text(f"{config}\n[align]\ntoile = '1'\n")
    with pytest.raises(UserError, match="an aligned run"):
        pipeline.register(capture, run)
