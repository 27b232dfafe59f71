"""Workers, shards, kills and second tries: the same bits whoever did the work, and nothing done twice."""

import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests.support.processes import PATIENCE, hears_ctrl_c, wait_until
from tests.support.stored import arrays
from toile import cli, console
from toile.config import preset
from toile.errors import UserError
from toile.io.layout import WRONG
from toile.io.mesh import read_mesh, write_mesh
from toile.io.run import open_run
from toile.pipeline import run as pipeline
from toile.pipeline.blocks import blocks
from toile.pipeline.standing import standing
from toile.scene import Mesh
from toile.stages import inner

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
CONFIG = preset("draft").model_copy(update={"preparation_frames": 1})
FRAMES = (48, 49, 50, 51)  # two blocks of temporal state


def assert_same_bits(once, twice):
    assert once.keys() == twice.keys()
    for name in (n for n in once if not n.startswith("diagnostics/seconds/")):
        assert np.array_equal(once[name], twice[name], equal_nan=once[name].dtype.kind == "f"), name


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Four frames of the bundled capture without its garment, renumbered so that they lie in two blocks."""
    folder = tmp_path_factory.mktemp("processes") / "capture"
    shutil.copytree(SAMPLE, folder, ignore=shutil.ignore_patterns("truth", "frames"))
    for i, number in enumerate(FRAMES):
        shutil.copytree(SAMPLE / "frames" / f"{i:06d}", folder / "frames" / f"{number:06d}")
    text = (folder / "scene.toml").read_text()
    start, end = text.index("[[garment]]"), text.index("[cameras]")
    (folder / "scene.toml").write_text(text[:start] + text[end:])
    return folder


@pytest.fixture(scope="module")
def undisturbed(capture, tmp_path_factory):
    run = tmp_path_factory.mktemp("processes") / "run"
    assert pipeline.register(capture, run, CONFIG, FRAMES).ok == FRAMES
    return run


def test_blocks_are_cut_at_multiples_of_50():
    assert blocks((48, 49, 50, 99, 100)) == [(48, 49), (50, 99), (100,)]


def test_two_workers_give_the_bits_of_one(capture, undisturbed, tmp_path):
    assert pipeline.register(capture, tmp_path / "run", CONFIG, FRAMES, workers=2).ok == FRAMES
    assert_same_bits(arrays(undisturbed), arrays(tmp_path / "run"))


@pytest.mark.slow(seconds=60)
def test_one_two_and_four_workers_give_the_same_bits_of_four_blocks_with_a_garment(tmp_path):
    capture, numbers = tmp_path / "capture", (49, 50, 51, 100, 101, 150)
    shutil.copytree(SAMPLE, capture, ignore=shutil.ignore_patterns("truth", "frames"))
    for i, number in enumerate(numbers):
        shutil.copytree(SAMPLE / "frames" / f"{i:06d}", capture / "frames" / f"{number:06d}")
    made = []
    for workers in (1, 2, 4):
        assert pipeline.register(capture, tmp_path / f"{workers}", CONFIG, numbers, workers=workers).ok == numbers
        made.append(arrays(tmp_path / f"{workers}"))
    assert_same_bits(made[0], made[1])
    assert_same_bits(made[0], made[2])


def test_two_shards_give_the_bits_of_one_run(capture, undisturbed, tmp_path):
    first = pipeline.register(capture, tmp_path / "run", CONFIG, FRAMES, shard=(2, 2))
    assert first.pending == FRAMES and not first.ok and not (tmp_path / "run" / "registered.zarr").exists()
    assert pipeline.register(capture, tmp_path / "run", CONFIG, FRAMES, shard=(1, 2)).ok == FRAMES
    assert_same_bits(arrays(undisturbed), arrays(tmp_path / "run"))


def test_killed_workers_leave_a_run_that_goes_on_with_the_same_bits(capture, undisturbed, tmp_path):
    code = (
        "from pathlib import Path; from toile import pipeline; from toile.config import preset\n"
        "if __name__ == '__main__':\n"
        "    config = preset('draft').model_copy(update={'preparation_frames': 1})\n"
        f"    pipeline.register(Path({str(capture)!r}), Path({str(tmp_path / 'run')!r}), config, {FRAMES}, workers=2)\n"
    )
    (tmp_path / "program.py").write_text(code)
    child = subprocess.Popen([sys.executable, tmp_path / "program.py"], start_new_session=True)
    wait_until(lambda: any((tmp_path / "run" / "work").glob("frames/*/whole")), child)
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    assert not (tmp_path / "run" / "registered.zarr").exists()
    assert pipeline.register(capture, tmp_path / "run", CONFIG, FRAMES).ok == FRAMES
    assert_same_bits(arrays(undisturbed), arrays(tmp_path / "run"))


@pytest.mark.slow(seconds=60)
def test_a_worker_killed_on_the_way_changes_no_bit_and_ends_no_run(capture, undisturbed, tmp_path):
    """Kill -9 of a worker as soon as it has made a frame, of another in the last pass."""
    run, killed = tmp_path / "run", []

    def kill_one(stage, done, total):
        if (stage, done) in (("track", 1), ("store", 1)):
            workers = [p for p in psutil.Process().children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]
            workers[done - 1].kill()
            killed.append(stage)

    assert pipeline.register(capture, run, CONFIG, FRAMES, kill_one, workers=2).ok == FRAMES
    assert killed == ["track", "store"]
    assert_same_bits(arrays(undisturbed), arrays(run))


def test_two_processes_at_once_on_one_run_both_end_well_with_the_same_bits(capture, undisturbed, tmp_path):
    settings = ["--quality", "draft", "--set", "preparation_frames=1"]
    command = [sys.executable, "-m", "toile", "register", str(capture), str(tmp_path / "run"), *settings]
    both = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=PATIENCE)[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    assert_same_bits(arrays(undisturbed), arrays(tmp_path / "run"))


def test_the_standing_counts_what_was_made_of_the_settings_that_were_asked_last(capture, undisturbed, tmp_path):
    run = Path(shutil.copytree(undisturbed, tmp_path / "run"))
    assert pipeline.register(capture, run, None, **{"track.scan_spacing": 0.015}, shard=(1, 2)).pending == FRAMES
    found = standing(run)
    assert (found.registered, found.passed, found.waiting, found.earlier) == ((), 2, 2, FRAMES)
    assert pipeline.register(capture, run, None, shard=(2, 2)).ok == FRAMES
    found = standing(run)
    assert found.whole and (found.registered, found.earlier) == (FRAMES, ())


@pytest.mark.parametrize("changed", [{"votes": 3}, {"votes": [[1, [2], 3]]}, {"facts": {}}, {"stages": {}}])
def test_a_damaged_note_of_what_was_asked_is_named_and_is_written_anew(capture, undisturbed, tmp_path, changed):
    run = Path(shutil.copytree(undisturbed, tmp_path / "run"))
    path = run / "inputs" / "scene.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))
    with pytest.raises(UserError, match=r"scene\.json: stages, facts, votes: not as they were written"):
        standing(run)
    assert pipeline.register(capture, run, None).ok == FRAMES and standing(run).whole


def test_a_clock_that_jumps_changes_no_bit_and_nothing_is_made_again(capture, undisturbed, tmp_path, monkeypatch):
    """By years, forwards and back, at every look; and files that seem to be written before or long after now."""
    run, years = tmp_path / "run", itertools.cycle([0.0, 30.0, -40.0, 3.0])
    now = time.time
    monkeypatch.setattr(time, "time", lambda: now() + 3e7 * next(years))
    assert pipeline.register(capture, run, CONFIG, FRAMES).ok == FRAMES
    monkeypatch.undo()
    assert_same_bits(arrays(undisturbed), arrays(run))
    for path, year in zip((path for path in run.rglob("*") if path.is_file()), years):
        os.utime(path, (now() + 3e7 * year,) * 2)
    monkeypatch.setattr(pipeline, "first_stages", lambda *_: pytest.fail("made again"))
    outcome = pipeline.register(capture, run, CONFIG, FRAMES)
    assert outcome.ok == FRAMES and not outcome.notes
    found = standing(run)
    assert found.whole and found.silence >= 0 and (found.pace is None or found.pace > 0)


def test_ctrl_c_ends_the_workers_too_and_says_how_to_go_on(capture, tmp_path):
    arguments = ["register", str(capture), str(tmp_path / "run"), "--quality", "draft", "--workers", "2"]
    with open(tmp_path / "said", "w") as said:
        child = subprocess.Popen(
            [sys.executable, "-m", "toile", *arguments], stdout=said, stderr=said, preexec_fn=hears_ctrl_c
        )
        wait_until((tmp_path / "run" / "work").exists, child)
        os.kill(child.pid, signal.SIGINT)  # the workers get none
        assert child.wait(PATIENCE) == 130
    told = (tmp_path / "said").read_text()
    assert told.strip().splitlines()[-1] == f"toile: stopped; go on with: toile {' '.join(arguments)}"
    assert "Traceback" not in told


def test_retry_gives_failed_frames_again_and_no_others(capture, undisturbed, tmp_path, monkeypatch):
    shutil.copytree(capture, tmp_path / "capture")
    scan = tmp_path / "capture" / "frames" / "000050" / "scan.ply"
    whole = scan.read_bytes()
    scan.write_bytes(whole[:300])
    assert list(pipeline.register(tmp_path / "capture", tmp_path / "run", CONFIG, FRAMES).failed) == [50]
    before = arrays(tmp_path / "run")
    scan.write_bytes(whole)
    made, make = [], pipeline.first_stages
    monkeypatch.setattr(
        pipeline, "first_stages", lambda prepared, n, *rest: (made.append(n), make(prepared, n, *rest))[1]
    )
    assert pipeline.register(tmp_path / "capture", tmp_path / "run", CONFIG, FRAMES, retry=True).ok == FRAMES
    after = arrays(tmp_path / "run")
    assert made == [50] and after["done"].tolist() == [1, 1, 1, 1]
    for name in ("track/vertices", "pose/rotations"):
        assert np.array_equal(after[name][[0, 1, 3]], before[name][[0, 1, 3]])
        assert np.array_equal(
            after[name][2], arrays(undisturbed)[name][2]
        )  # the first of its block: no temporal state either way


def test_a_wrong_frame_is_told_ends_with_2_and_is_given_again_where_asked(capture, undisturbed, tmp_path, monkeypatch):
    """Its scan lies 30 cm beside the person whom the cameras see."""
    folder, run = tmp_path / "capture", tmp_path / "run"
    shutil.copytree(capture, folder)
    scan = folder / "frames" / "000050" / "scan.ply"
    whole, mesh = scan.read_bytes(), read_mesh(scan)
    write_mesh(scan, Mesh(mesh.vertices + [0.3, 0, 0], mesh.faces))
    outcome = pipeline.register(folder, run, CONFIG, FRAMES)
    assert outcome.ok == FRAMES and list(outcome.wrong) == [50] and "silhouette" in outcome.wrong[50]
    assert open_run(run).verdict[2] == WRONG
    monkeypatch.setattr(sys, "argv", ["toile", "register", str(folder), str(run), "--config", str(run / "config.toml")])
    with pytest.raises(SystemExit, match="2"):
        cli.main()
    scan.write_bytes(whole)
    made, make = [], pipeline.first_stages
    monkeypatch.setattr(
        pipeline, "first_stages", lambda prepared, n, *rest: (made.append(n), make(prepared, n, *rest))[1]
    )
    assert not pipeline.register(folder, run, CONFIG, FRAMES, retry="wrong").wrong
    assert made == [50] and np.array_equal(arrays(run)["done"], [1, 1, 1, 1])
    assert np.array_equal(arrays(run)["track/vertices"][2], arrays(undisturbed)["track/vertices"][2])


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b", "-1/2", "1/0"])
def test_a_shard_that_is_none_is_refused(text):
    with pytest.raises(UserError, match="--shard"):
        console.shard_of(text)


@pytest.mark.slow(seconds=20)
def test_the_body_is_fused_from_every_frame_with_the_same_bits_for_any_workers(tmp_path, monkeypatch):
    folder = tmp_path / "capture"
    shutil.copytree(SAMPLE, folder, ignore=shutil.ignore_patterns("truth", "frames"))
    for i, number in enumerate(FRAMES):
        shutil.copytree(SAMPLE / "frames" / f"{i:06d}", folder / "frames" / f"{number:06d}")
    gathered, gather = [], inner.Fusion.gather

    def counted(self, guess, frames):
        frames = list(frames)
        gathered.append(len(frames))
        return gather(self, guess, frames)

    monkeypatch.setattr(inner.Fusion, "gather", counted)
    assert pipeline.register(folder, tmp_path / "one", CONFIG, FRAMES).ok == FRAMES
    assert (
        gathered and gathered == [2] * len(gathered) and len(gathered) % 2 == 0
    )  # two blocks of two frames, every pass
    monkeypatch.undo()
    assert pipeline.register(folder, tmp_path / "two", CONFIG, FRAMES, workers=2).ok == FRAMES
    assert_same_bits(arrays(tmp_path / "one"), arrays(tmp_path / "two"))
