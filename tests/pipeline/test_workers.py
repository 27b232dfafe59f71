"""Workers: what they yield and when, workers that are lost, and those of a scheduler that runs elsewhere."""

import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import dask
import pytest

from tests.support.processes import PATIENCE, hears_ctrl_c, wait_until
from toile import kernels
from toile.errors import UserError
from toile.pipeline.threads import kernel_threads
from toile.pipeline.workers import LIVES, Workers, check_workers

ITEMS = list(range(5))


def prepare(tenfold):
    return {"factor": 10 if tenfold else 1, "process": os.getpid(), "thread": threading.get_ident()}


def steps(prepared, item):
    for k in range(3):
        yield prepared["factor"] * item + k


def expected():
    return sorted(10 * item + k for item in ITEMS for k in range(3))


@pytest.fixture(scope="module")
def pool():
    with Workers(2, prepare, True) as pool:
        yield pool


@pytest.fixture(scope="module")
def running():
    """A scheduler with one worker of two threads, in this process."""
    from distributed import LocalCluster

    options = dict(n_workers=1, threads_per_worker=2, processes=False, protocol="tcp", dashboard_address=None)
    with LocalCluster(**options) as cluster:
        yield cluster


def test_workers_yield_what_this_process_yields(pool):
    assert sorted(pool.each(steps, ITEMS)) == expected() == sorted(Workers(1, prepare, True).each(steps, ITEMS))


def large(prepared, item):
    yield bytes(1_000_000)
    yield bytes([item])


def test_large_values_come_whole_and_in_their_order(pool):
    found = list(pool.each(large, [1, 2]))
    assert sorted(map(len, found)) == [1, 1, 1_000_000, 1_000_000]
    assert {found[i + 1] for i, value in enumerate(found) if len(value) > 1} == {b"\1", b"\2"}


def held(folder, prepared, item):
    """Goes on once what it has yielded was seen."""
    yield item
    wait_until((folder / f"seen{item}").exists)
    yield item


def test_what_is_yielded_comes_while_its_item_goes_on(pool, tmp_path):
    for item in pool.each(partial(held, tmp_path), [1, 2]):
        (tmp_path / f"seen{item}").touch()


def where(folder, prepared, item):
    """Goes on once two workers have begun, however late one of them is."""
    (folder / f"{os.getpid()}-{threading.get_ident()}").touch()
    wait_until(lambda: len(list(folder.iterdir())) > 1)
    yield prepared["process"], prepared["thread"], os.getpid(), threading.get_ident(), kernels.threads()


def test_the_cores_are_shared_and_each_worker_prepares_for_itself(pool, tmp_path):
    found = set(pool.each(partial(where, tmp_path), ITEMS))
    assert len(found) == 2 and os.getpid() not in {process for process, *_ in found}
    assert all((process, thread) == (here, now) for process, thread, here, now, _ in found)
    assert {threads for *_, threads in found} == {max(kernels.threads() // 2, 1)}


def dies(folder, deaths, of, prepared, item):
    """Yields twice; item `of` ends its worker between, as often as `deaths`."""
    yield (item, 0)
    time.sleep(0.1)
    if item == of and len(list(folder.iterdir())) < deaths:
        (folder / f"{time.time_ns()}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    yield (item, 1)


def test_what_a_killed_worker_was_about_is_made_by_another_and_told_once(pool, tmp_path):
    found = list(pool.each(partial(dies, tmp_path, 1, 2), ITEMS))
    assert sorted(found) == [(item, k) for item in ITEMS for k in range(2)] and len(list(tmp_path.iterdir())) == 1


def test_work_that_ends_every_worker_is_given_up_with_a_line(pool, tmp_path):
    with pytest.raises(UserError, match=f"^{LIVES} worker processes were ended from outside .* go on with fewer"):
        list(pool.each(partial(dies, tmp_path, 99, 2), ITEMS))
    assert len(list(tmp_path.iterdir())) == LIVES and sorted(pool.each(steps, ITEMS)) == expected()


def test_processes_start_while_this_one_goes_on_and_share_its_threads(monkeypatch):
    from toile.pipeline import cluster

    gone_on, made = threading.Event(), []

    class Late:
        def __init__(self, count, *_):
            made.append((count, kernels.threads()))
            assert gone_on.wait(300)

        def each(self, function, items, *_):
            yield from items

        def close(self, at_once):
            made.append(at_once)

    monkeypatch.setattr(cluster, "Cluster", Late)
    with kernel_threads(7), Workers(2, prepare, True) as pool:
        pool.start()
        gone_on.set()
        assert list(pool.each(steps, ITEMS)) == ITEMS == list(pool.each(steps, ITEMS))
    assert made == [(2, 7), False]
    with Workers(1, prepare, True) as alone:
        alone.start()
    assert len(made) == 2


def fails(prepared, item):
    yield 0
    raise UserError(f"item {item} is bad")


def test_what_a_worker_raises_is_raised_here(pool):
    with pytest.raises(UserError, match="^item [12] is bad$"):
        list(pool.each(fails, [1, 2]))


def test_a_running_scheduler_does_the_same_and_forgets_it_after(running, tmp_path):
    with Workers(1, prepare, True, scheduler=running.scheduler_address) as pool:
        assert sorted(pool.each(steps, ITEMS)) == expected()
        found = set(pool.each(partial(where, tmp_path), ITEMS))
        (worker,) = running.workers.values()
        assert any(name.startswith("toile-") for name in worker.plugins)
    assert len(found) == 2 and all((process, thread) == (here, now) for process, thread, here, now, _ in found)
    assert not any(name.startswith("toile-") for name in worker.plugins)


STEPS = 10_000


def endless(folder, prepared, item):
    try:
        for k in range(STEPS):
            (folder / "made").write_text(str(k + 1))
            yield k
            time.sleep(0.02)
    finally:
        (folder / "left").touch()


def test_a_running_scheduler_s_workers_stop_where_the_job_is_stopped(running, tmp_path):
    with pytest.raises(KeyboardInterrupt), Workers(1, prepare, True, scheduler=running.scheduler_address) as pool:
        for _ in pool.each(partial(endless, tmp_path), [1]):
            raise KeyboardInterrupt
    wait_until((tmp_path / "left").exists)
    assert int((tmp_path / "made").read_text()) < STEPS


def test_a_scheduler_that_is_not_there_is_told_in_a_line(monkeypatch):
    from toile.pipeline import cluster

    monkeypatch.setattr(cluster, "WAIT", 0.5)
    for there in ("tcp://127.0.0.1:9", "nowhere.json"):
        with pytest.raises(UserError, match=f"^scheduler {there}: (cannot be reached|there is no such file)"):
            list(Workers(1, prepare, True, scheduler=there).each(steps, ITEMS))


def test_a_scheduler_s_address_that_is_none_is_refused_at_once(tmp_path):
    (tmp_path / "other.json").write_text('{"address": 5}')
    (tmp_path / "text.json").write_text("tcp://127.0.0.1:9")
    for there in ("", "nonsense", "tcp://host", "http://host:80", f"{tmp_path}/other.json"):
        with pytest.raises(UserError, match=f"^scheduler {there}: expected tcp://HOST:PORT, or the .json file"):
            list(Workers(1, prepare, True, scheduler=there).each(steps, ITEMS))
    with pytest.raises(UserError, match="text.json: not JSON"):
        list(Workers(1, prepare, True, scheduler=f"{tmp_path}/text.json").each(steps, ITEMS))


def test_workers_and_a_scheduler_are_not_both_given():
    with pytest.raises(UserError, match="scheduler tcp://a:1 is given too"):
        check_workers(2, "tcp://a:1")


PROGRAM = """
import os, signal, sys, time
from pathlib import Path
sys.path.insert(0, {root!r})
from tests.pipeline.test_workers import prepare
from toile.pipeline.threads import kernel_threads
from toile.pipeline.workers import Workers

def work(prepared, item):
    yield os.getpid()
    time.sleep({seconds})

if __name__ == "__main__":
    with Workers(2, prepare, True) as pool:
        for pid in pool.each(work, [1, 2]):
            print(pid, flush=True)
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_workers_end_at_once_with_their_parent_and_say_nothing(tmp_path, how):
    (tmp_path / "program.py").write_text(PROGRAM.format(root=str(Path(__file__).parents[2]), seconds=2 * PATIENCE))
    program, pipe = [sys.executable, tmp_path / "program.py"], subprocess.PIPE
    child = subprocess.Popen(program, stdout=pipe, stderr=pipe, preexec_fn=hears_ctrl_c)
    pids = [int(child.stdout.readline()) for _ in range(2)]
    child.send_signal(how)
    said = child.communicate(timeout=PATIENCE)[1].decode()
    wait_until(lambda: not any(alive(pid) for pid in pids))
    if how == signal.SIGINT:
        assert said.count("Traceback") == 1 and said.endswith("\nKeyboardInterrupt\n")
    else:
        lines = [line for line in said.splitlines() if "resource_tracker" not in line]  # Python's own, of a kill
        assert lines == []


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except OSError:
        return False


def test_workers_that_are_slow_to_start_again_are_waited_for_and_those_given_up_are_asked_for_anew(monkeypatch):
    from toile.pipeline import cluster

    monkeypatch.setattr(cluster, "SILENCE", PATIENCE)
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "1ms"}), Workers(2, prepare, True) as pool:
        assert sorted(pool.each(steps, ITEMS)) == expected()
        own = pool._cluster().own
        nannies = list(own.workers.values())
        for nanny in nannies:
            os.kill(nanny.pid, signal.SIGKILL)
        assert sorted(pool.each(steps, ITEMS)) == expected() and list(own.workers.values()) == nannies
        monkeypatch.setattr(cluster, "SILENCE", 0.5)
        for nanny in nannies:
            wait_until(lambda: nanny.pid)
            nanny.close_gracefully()
            os.kill(nanny.pid, signal.SIGKILL)
        assert sorted(pool.each(steps, ITEMS)) == expected() and not set(own.workers.values()) & set(nannies)
