"""The resumable runner alone, on frames whose results are numbers."""

import json
import multiprocessing
import os
import re
import signal
import time
from functools import partial

import numpy as np
import pytest

from toile import kernels
from toile.errors import UserError
from toile.io.files import write_text
from toile.io.status import Status
from toile.pipeline.blocks import BlockJob, FrameFolders, blocks, check_shares, frame_numbers_of, run_job
from toile.pipeline.workers import Workers

FRAMES = (47, 48, 49, 50, 51, 53, 99, 100)


def prepare(start, progress=None):
    if progress:
        progress("prepare", 1, 1)
    return start


def make(start, number, previous, results):
    """Its number, and the one before it whose results it had."""
    if number in start["bad"]:
        raise UserError(f"frame {number} is bad\nand more")
    before = None if previous is None else json.loads((results.folder(previous) / "made.json").read_text())["number"]
    write_text(results.folder(number) / "made.json", json.dumps({"number": number, "before": before}))


def make_or_die(start, number, previous, results):
    """Frame 50 ends its worker, as often as `deaths`, once frame 51 is under way beside it where it may be."""
    if number == 50 and len(list(start["graves"].iterdir())) < start["deaths"]:
        (start["graves"] / f"{time.time_ns()}").touch()
        time.sleep(0.1)
        os.kill(os.getpid(), signal.SIGKILL)
    make(start, number, previous, results)


def job_in(folder, bad=(), reach=1):
    results = FrameFolders(folder / "frames", Status.of(folder), "make")
    return BlockJob(folder, results, prepare, ({"bad": list(bad)},), make, reach, "make")


def dying_job_in(folder, deaths):
    (folder / "graves").mkdir(parents=True)
    start = {"bad": [], "graves": folder / "graves", "deaths": deaths}
    results = FrameFolders(folder / "frames", Status.of(folder), "make")
    return BlockJob(folder, results, prepare, (start,), make_or_die, 1, "make")


def complete(job, prepared, pool):
    write_text(job.folder / "whole.json", json.dumps(prepared["bad"]))


def run(job, frames=FRAMES, **options):
    run_job(job, frames, (job.folder / "whole.json").exists, partial(complete, job), **options)
    return {
        number: json.loads((job.results.folder(number) / "made.json").read_text())["before"]
        for number in frames
        if job.results.whole(number)
    }


def test_blocks_are_cut_at_multiples_of_50():
    assert blocks(FRAMES) == [(47, 48, 49), (50, 51, 53, 99), (100,)]
    assert blocks(FRAMES, range(49, 53)) == [(47, 48), (49,), (50, 51), (53, 99), (100,)]


def test_temporal_state_crosses_neither_a_cut_nor_a_gap(tmp_path):
    assert run(job_in(tmp_path)) == {47: None, 48: 47, 49: 48, 50: None, 51: 50, 53: None, 99: None, 100: None}


def test_it_reaches_as_far_back_as_the_job_says_over_failed_frames(tmp_path):
    job = job_in(tmp_path, bad=[48], reach=10)
    assert run(job) == {47: None, 49: 47, 50: None, 51: 50, 53: 51, 99: None, 100: None}
    assert job.results.reason(48) == "frames/000048: frame 48 is bad" and job.results.reason(47) is None
    (line,) = job.results.status.lines()
    assert line.pop("time") > 0 and line == {
        "frame": 48,
        "stage": "make",
        "seconds": 0.0,
        "ok": False,
        "reason": "frames/000048: frame 48 is bad",
    }


def test_a_job_that_was_stopped_makes_only_what_is_missing(tmp_path, monkeypatch):
    def stop(stage, done, total):
        if (stage, done) == ("make", 4):
            raise KeyboardInterrupt

    whole, job = run(job_in(tmp_path / "whole")), job_in(tmp_path / "stopped")
    with pytest.raises(KeyboardInterrupt):
        run(job, progress=stop)
    kept = [path for path in (tmp_path / "stopped").rglob("made.json") if path.with_name("whole").exists()]
    times = [path.stat().st_mtime_ns for path in kept]
    assert 0 < len(kept) < len(FRAMES) and run(job) == whole
    assert [path.stat().st_mtime_ns for path in kept] == times and (tmp_path / "stopped" / "whole.json").exists()


def removing(job, stage, done, total):
    """Progress that takes the job's folder away after its third frame."""
    if (stage, done) == ("make", 3):
        job.folder.rename(job.folder.with_name("aside"))


def complete_and_remove(job, prepared, pool):
    complete(job, prepared, pool)
    job.folder.rename(job.folder.with_name("aside"))


def test_a_job_whose_folder_is_removed_meanwhile_ends_with_an_error_and_makes_no_more_frames(tmp_path):
    job = job_in(tmp_path / "job")
    with pytest.raises(UserError, match="job: was removed or replaced while it was worked at"):
        run(job, progress=partial(removing, job))
    assert len(list((tmp_path / "job" / "frames").iterdir())) < len(FRAMES) - 3


def test_a_job_whose_folder_is_removed_as_it_completes_ends_with_an_error(tmp_path):
    job = job_in(tmp_path / "job")
    with pytest.raises(UserError, match="job: was removed or replaced while it was worked at"):
        run_job(job, FRAMES, (job.folder / "whole.json").exists, partial(complete_and_remove, job))


def remove_and_fail(job, *_):
    job.folder.rename(job.folder.with_name("aside"))
    (job.folder / "made.npz").read_bytes()


def test_an_error_after_a_job_s_folder_was_removed_is_told_as_that(tmp_path):
    job = job_in(tmp_path / "job")
    with pytest.raises(UserError, match="job: was removed or replaced while it was worked at"):
        run_job(job, FRAMES, (job.folder / "whole.json").exists, partial(remove_and_fail, job))


def test_the_last_shard_completes_what_all_have_made(tmp_path):
    job = job_in(tmp_path / "shards")
    assert list(run(job, shard=(2, 2))) == [50, 51, 53, 99] and not (tmp_path / "shards" / "whole.json").exists()
    assert run(job, shard=(1, 2)) == run(job_in(tmp_path / "one")) and (tmp_path / "shards" / "whole.json").exists()


def test_the_last_shard_completes_with_all_its_workers_though_few_blocks_are_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr(Workers, "each", lambda pool, function, items, lost: (
        value for item in items for value in function(pool.prepared(), item)
    ))  # fmt: skip
    monkeypatch.setattr(Workers, "start", lambda pool: started.append(pool.count))
    counts, started, job = [], [], job_in(tmp_path)
    share = lambda i: run_job(
        job, FRAMES, lambda: False, lambda _, pool: counts.append(pool.count), workers=8, shard=(i, 3)
    )
    for i in (1, 2, 3):
        share(i)
    assert started == [1, 1, 1] and counts == [3] and len(blocks(FRAMES)) == 3


def test_workers_make_the_same(tmp_path):
    bad = job_in(tmp_path / "two", bad=[49]), job_in(tmp_path / "one", bad=[49])
    assert run(bad[0], workers=2) == run(bad[1])
    assert bad[0].results.reason(49) == bad[1].results.reason(49) == "frames/000049: frame 49 is bad"


def test_a_frame_whose_worker_was_killed_is_made_by_another_to_the_same_end(tmp_path):
    job, told = dying_job_in(tmp_path / "killed", deaths=2), []
    assert run(job, workers=2, progress=lambda *at: told.append(at)) == run(job_in(tmp_path / "undisturbed"))
    assert [done for stage, done, _ in told if stage == "make"] == list(range(1, len(FRAMES) + 1))
    assert (tmp_path / "killed" / "whole.json").exists() and len(list((tmp_path / "killed" / "graves").iterdir())) == 2


def test_a_frame_that_costs_three_workers_fails_and_stops_no_other(tmp_path):
    job = dying_job_in(tmp_path, deaths=99)
    assert run(job, workers=2) == {47: None, 48: 47, 49: 48, 51: None, 53: None, 99: None, 100: None}
    reason = "frames/000050: 3 worker processes were ended from outside over the same work, for want of memory perhaps"
    assert job.results.reason(50) == reason and (tmp_path / "whole.json").exists()
    assert len(list((tmp_path / "graves").iterdir())) == 3


def test_the_cores_of_workers_without_a_block_go_to_threads(tmp_path):
    found, before, others = [], kernels.threads(), set(multiprocessing.active_children())

    def progress(*_):
        found.append((kernels.threads(), len(set(multiprocessing.active_children()) - others)))

    run(job_in(tmp_path / "one"), FRAMES[:3], workers=before + 1, progress=progress)
    assert set(found) == {(before + 1, 0)} and kernels.threads() == before


def test_frames_that_are_not_left_only_cut_the_blocks(tmp_path):
    job = job_in(tmp_path)
    assert run(job, left=lambda: (48, 51)) == {48: None, 51: None}
    assert (tmp_path / "whole.json").exists()


@pytest.mark.parametrize("workers, shard", [(0, (1, 1)), (1, (0, 2)), (1, (3, 2))])
def test_shares_that_are_none_are_refused(workers, shard):
    with pytest.raises(UserError, match=f"workers {workers}" if not workers else re.escape(f"shard {shard}")):
        check_shares(workers, shard)


@pytest.mark.parametrize("frames", [[7, 1, 7], (1, 7), {1: "a", 7: "b"}, np.array([7, 1], np.uint8), iter([1, 7])])
def test_frame_numbers_rise_and_are_pythons_own_whatever_gives_them(frames):
    found = frame_numbers_of("frames", frames)
    assert found == (1, 7) and all(type(number) is int for number in found)
