"""What workers cost beside the work: `python -m bench.cluster overhead | load | ceiling | store RUN`. Stages are replaced by sleeps.

overhead  one job by this process, and by 2 and 4 workers of this machine: seconds until the first frame is told, to end,
          and CPU seconds a frame
load      a scheduler with many workers, threads of this process, and as many frames as a long take has
ceiling   what two processes that share nothing but the machine could gain at most
store     files and bytes of --frames frames like those of a finished run
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from statistics import median

from toile.io.layout import layout_of
from toile.io.run import open_run
from toile.io.status import Status
from toile.kernels import biharmonic, set_threads
from toile.pipeline.blocks import BLOCK, BlockJob, FrameFolders, run_job

from .kernel_problems import patch

ROUNDS = 3


def prepare(seconds, progress=None):
    return seconds


def sleep(seconds, number, previous, results):
    results.folder(number).mkdir(parents=True, exist_ok=True)
    time.sleep(seconds)


def asleep(frames, seconds, **options):
    """{what: seconds} of a job of these frames that sleeps."""
    told, done = [], []
    with tempfile.TemporaryDirectory() as folder:
        results = FrameFolders(Path(folder) / "frames", Status.of(folder), "sleep")
        job = BlockJob(Path(folder), results, prepare, (seconds,), sleep, 1, "sleep")
        start, used = time.perf_counter(), cpu()
        run_job(
            job,
            range(frames),
            lambda: False,
            lambda *_: done.append(time.perf_counter()),
            progress=lambda *_: told.append(time.perf_counter()),
            **options,
        )
        end, used = time.perf_counter(), cpu() - used
    assert len(told) == frames and done
    return {
        "first_s": told[0] - start - seconds,
        "work_s": told[-1] - told[0],
        "close_s": end - done[0],
        "cpu_s": used,
    }


def overhead(frames, seconds):
    """A job by this process, and by 2 and 4 workers; what a frame costs is told from jobs of two lengths."""
    table = {}
    for workers in (1, 2, 4):
        few, many = (asleep(count, seconds, workers=workers) for count in (frames // 5, frames))
        a_frame = (many["cpu_s"] - few["cpu_s"]) / (frames - frames // 5)
        table[workers] = many | {
            "cpu_ms_a_frame": 1e3 * a_frame,
            "cpu_s_to_start_and_end": many["cpu_s"] - a_frame * frames,
            "ideal_s": seconds * frames / workers,
        }
    return table


def load(frames, workers, seconds):
    """One scheduler, its workers and the client in this process."""
    import logging

    import dask
    from distributed import LocalCluster

    options = dict(threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=None, memory_limit=0)
    start = time.perf_counter()
    dask.config.set({"distributed.comm.timeouts.tcp": "300s"})
    with LocalCluster(n_workers=workers, silence_logs=logging.CRITICAL + 1, **options) as cluster:
        started = time.perf_counter() - start
        found = asleep(frames, seconds, scheduler=cluster.scheduler_address)
    blocks = -(-frames // BLOCK)
    ideal = seconds * BLOCK * -(-blocks // workers)
    return found | {
        "start_workers_s": started,
        "ideal_s": ideal,
        "cpu_ms_a_frame": 1e3 * found["cpu_s"] / frames,
        "frames_a_second": frames / found["work_s"],
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def ceiling(seconds):
    """CPU seconds that a sparse factorisation takes by one process alone, and by each of two at once."""
    rounds = []
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for _ in range(ROUNDS):
            alone = pool.submit(factorise, seconds).result()
            both = [pool.submit(factorise, seconds) for _ in range(2)]
            rounds.append((alone, sum(one.result() for one in both) / 2))
    alone, beside = map(median, zip(*rounds))
    return {"cpu_s_alone": alone, "cpu_s_beside_another": beside, "speed_up_at_most": 2 * alone / beside}


def factorise(seconds):
    """CPU seconds of a deformation of 20,000 vertices by one thread; over and over for so many seconds."""
    set_threads(1)
    problem = patch(20_000)
    done, end, used = 0, time.perf_counter() + seconds, time.process_time()
    while time.perf_counter() < end or not done:
        biharmonic(**problem)
        done += 1
    return (time.process_time() - used) / done


def store(run, frames):
    """Files and bytes that `frames` frames like those of a run would take, and what every worker reads before its first."""
    opened, size = open_run(run), lambda paths: sum(path.stat().st_size for path in paths)
    count = len(opened.frames)
    layout = layout_of([*opened.garments], "face" in opened.group)
    framed = [opened.array(key) for key, (stored, _) in layout.items() if stored.per_frame]
    notes = [path for folder in ("diagnostics", "inputs") for path in Path(run, folder).glob("[0-9]*.json")]
    stored = sum(-(-frames // (array.shards or array.chunks)[0]) for array in framed)
    prepared = [path for path in Path(run, "prepared").rglob("*") if path.is_file()]
    return {
        "frames": count,
        "megabytes_a_frame": (opened.framed_bytes() + size(notes)) / count / 1e6,
        "files_of_the_store": stored,
        "files_beside_it": round(len(notes) / count * frames),
        "gigabytes": (opened.framed_bytes() + size(notes)) / count * frames / 1e9,
        "prepared_megabytes": size(prepared) / 1e6,
    }


def cpu():
    """CPU seconds of this process and of those that it has ended."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["overhead", "load", "ceiling", "store"])
    parser.add_argument("run", nargs="?")
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--workers", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=0.05, help="that a frame sleeps, or a process computes")
    asked = parser.parse_args()
    if asked.what == "overhead":
        found = overhead(asked.frames, asked.seconds)
    elif asked.what == "load":
        found = load(asked.frames, asked.workers, asked.seconds)
    elif asked.what == "ceiling":
        found = ceiling(asked.seconds)
    else:
        found = store(asked.run, asked.frames)
    print(json.dumps(found, indent=1, default=float))


if __name__ == "__main__":
    main()
