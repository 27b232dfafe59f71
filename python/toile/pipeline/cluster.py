"""Workers of dask.distributed: processes that are started here, or those of a scheduler that runs elsewhere.

dask decides which worker takes which task and starts lost ones again. Each worker prepares what its tasks need once, when
the first one comes; what tasks yield comes back as events of the scheduler, while they go on.
"""

from __future__ import annotations

import logging
import os
import pickle
import queue
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import cloudpickle
import dask
from distributed import Client, LocalCluster, get_worker
from distributed.client import FutureCancelledError
from distributed.comm import get_address_host_port
from distributed.deploy.cluster import Cluster as DaskCluster
from distributed.diagnostics.plugin import WorkerPlugin
from distributed.scheduler import KilledWorker

from .. import __version__, kernels
from ..errors import UserError, first_line
from ..io.bounded import read_json
from .threads import one_blas_thread

BEGUN, ENDED = -1, -2  # in place of a value's
SMALL = 1024  # bytes of a value that is sent while its task goes on
UNSEEN = 10  # workers lost before a task was heard of
WAIT = 30.0  # s for a scheduler to answer
PARTING = 5.0  # s for farewells to ended workers
SILENCE = 20.0  # s without news, after which workers that are gone are asked for anew
PATIENT = {"distributed.comm.timeouts.tcp": "300s"}  # a machine with too much to do is not a dead one
LOCAL = PATIENT | {
    "distributed.worker.profile.enabled": False,
    "distributed.nanny.pre-spawn-environ": {},  # dask would tell libraries to use one thread
    "distributed.scheduler.http.routes": [],  # what a browser would be told of the run
    "distributed.worker.http.routes": [],
    "distributed.scheduler.worker-saturation": 1.0,  # what waits for a worker is not lost with it
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.admin.tick.interval": "1s",  # not 50 times a second, in each process
    "distributed.admin.system-monitor.interval": "10s",
}


class Cluster:
    """`count` processes of this machine, or the workers of `scheduler`; each has what `prepare(*arguments)` gives there."""

    def __init__(self, count: int, scheduler: str | None, prepare: Callable, arguments: Sequence):
        self.own = local_cluster(count) if scheduler is None else None
        self.client = connected(self.own or scheduler or "")
        self.name, self.rounds = f"toile-{self.client.id}", 0
        threads = max(kernels.threads() // count, 1) if self.own else None
        job = Job(self.name, cloudpickle.dumps((prepare, arguments)), threads, __version__)
        self.heard: queue.SimpleQueue = queue.SimpleQueue()
        self.client.subscribe_topic(self.name, lambda event: self.heard.put(("event", *event[1])))
        self.client.register_plugin(job, name=self.name)

    def each(self, function: Callable, items: Sequence, lost: Callable[[Any, int], Any], lives: int) -> Iterator:
        """See `Workers.each`; deaths are counted anew after `lives`."""
        self.rounds += 1
        under_way, current, told_all = {}, list(items), set()
        yielded, begun, unseen = Counter(), Counter(), Counter()

        def submit(i):
            call = cloudpickle.dumps((function, current[i]))
            future = self.client.submit(run_task, self.name, self.rounds, i, call, pure=False, priority=-i)
            under_way[i] = future
            future.add_done_callback(lambda _, of=self.rounds: self.heard.put(("ended", of, i)))

        def again(i):
            unseen[i] += 1
            deaths = lives if unseen[i] >= UNSEEN else begun[i]
            current[i] = lost(current[i], deaths)
            if deaths >= lives:
                begun[i] = unseen[i] = 0
            submit(i)

        try:
            for i in range(len(current)):
                submit(i)
            while under_way:
                what, of, i, *told = self._hear()
                if of != self.rounds or i not in under_way:
                    continue  # of what was stopped
                if what == "ended":
                    future = under_way.pop(i)
                    if future.status == "finished" and i in told_all:
                        continue  # to fetch what is known already would take longer than all else
                    values = self._values(future)
                    if values is None:
                        again(i)
                    else:
                        yield from values[yielded[i] :]
                elif told[0] == BEGUN:
                    begun[i] += 1
                elif told[0] == ENDED:
                    told_all |= {i} if yielded[i] == pickle.loads(told[1]) else set()
                elif told[0] == yielded[i]:
                    yielded[i] += 1
                    yield pickle.loads(told[1])
        finally:
            if self.client.status == "running":  # not where the generator is left to the end of the process
                self.client.cancel(list(under_way.values()))

    def _hear(self):
        """What comes next. dask gives a worker up that dies before its start has ended: in silence it is asked for anew."""
        while True:
            try:
                return self.heard.get(timeout=SILENCE)
            except queue.Empty:
                if self.own is not None:
                    self.own.loop.add_callback(self.own.replace_those_gone)

    def _values(self, future):
        """What a task has yielded; None where its worker was lost."""
        try:
            return future.result()
        except KilledWorker:
            return None
        except FutureCancelledError:
            raise UserError("the scheduler of the workers was lost; the same command goes on") from None

    def close(self, at_once: bool = False) -> None:
        """Ends the workers that were started here, in the midst of what they are about if `at_once`; others are left as they
        were, and stop after the frame in hand."""
        if self.own is None:
            self.client.unregister_worker_plugin(self.name)
        elif at_once:
            for handler in logging.getLogger("distributed").handlers:
                handler.addFilter(lambda _: False)  # ended processes do not answer: no news; dask resets mere levels
            for nanny in self.own.workers.values():
                nanny.close_gracefully()  # dask would start another
                if nanny.pid:
                    os.kill(nanny.pid, signal.SIGKILL)
        for opened in (self.client, self.own):
            if opened is not None:
                with suppress(TimeoutError):  # dask's farewells wait for what has ended, at times
                    opened.close(timeout=PARTING if at_once else 2 * WAIT)


class Processes(LocalCluster):
    """Worker processes, each with a nanny that starts it again where it is lost."""

    def _update_worker_status(self, op: str, msg: Any) -> None:
        """Only notes it: SpecCluster ends a nanny whose process is not back after 15 s, which a busy machine needs for it."""
        DaskCluster._update_worker_status(self, op, msg)

    def replace_those_gone(self) -> None:
        """Starts nannies anew whose process has ended for good. Of the event loop's thread."""
        for name, nanny in list(self.workers.items()):
            if nanny.pid is None:
                self.loop.add_callback(nanny.close)
                del self.workers[name]
        self.scale(len(self.worker_spec))


def local_cluster(count: int) -> Processes:
    """Processes of one task each, which only this process can talk to."""
    with dask.config.set(LOCAL), without_ctrl_c():
        return Processes(
            n_workers=count,
            threads_per_worker=1,
            memory_limit=0,  # dask would end workers that others may not need to be ended
            dashboard_address=None,
            security=True,  # other users of this machine are none of the family
            scheduler_kwargs={"allowed_failures": 0, "dashboard": False, "dashboard_address": "127.0.0.1:0"},
            silence_logs=logging.CRITICAL + 1,
        )


def connected(to: LocalCluster | str) -> Client:
    """A client of the cluster, or of the scheduler at an address or of a scheduler file. UserError: there is none."""
    address = address_of(to) if isinstance(to, str) else to
    try:
        with dask.config.set(PATIENT):
            return Client(address, set_as_default=False, timeout=WAIT)
    except (OSError, ValueError) as error:
        raise UserError(f"scheduler {to}: cannot be reached: {first_line(error)}") from None


def address_of(scheduler: str) -> str:
    """Where a scheduler listens: `scheduler` itself, or what the .json file of that name says. UserError: no address stands there, which
    dask would find out after a minute."""
    address = scheduler
    if scheduler.endswith(".json"):
        if not os.path.exists(scheduler):
            raise UserError(f"scheduler {scheduler}: there is no such file")
        address = str(read_json(scheduler, dict).get("address"))
    try:
        get_address_host_port(address)
    except ValueError as error:
        words = "expected tcp://HOST:PORT, or the .json file of a dask scheduler"
        raise UserError(f"scheduler {scheduler}: {words}: {first_line(error)}") from None
    return address


@contextmanager
def without_ctrl_c() -> Iterator[None]:
    """Threads and processes that begin here do not hear Ctrl-C: it is this process's matter."""
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


class Job(WorkerPlugin):
    """On every worker: what the tasks of one job need, prepared once a thread, when its first task comes. `threads`: of
    the kernels of each task; None: what the worker offers."""

    def __init__(self, name: str, recipe: bytes, threads: int | None, version: str):
        self.name, self.recipe, self.threads, self.version = name, recipe, threads, version

    def setup(self, worker: Any) -> None:
        self.stopped, self.here = False, threading.local()
        self.threads = self.threads or max(kernels.threads() // worker.state.nthreads, 1)

    def teardown(self, worker: Any) -> None:
        self.stopped, self.here = True, threading.local()

    def prepared(self) -> Any:
        """What `prepare(*arguments)` gives here; kernels called from this thread have their threads."""
        if not hasattr(self.here, "prepared"):
            if self.version != __version__:
                raise UserError(f"a worker has toile {__version__}, expected {self.version} as here")
            one_blas_thread()
            prepare, arguments = pickle.loads(self.recipe)
            kernels.set_threads(self.threads)
            self.here.prepared = prepare(*arguments)
        kernels.set_threads(self.threads)
        return self.here.prepared


def run_task(name: str, of: int, i: int, call: bytes) -> list:
    """On a worker: what the generator yields, which is also told as it comes."""
    worker = get_worker()
    job: Job = worker.plugins[name]
    worker.log_event(name, (of, i, BEGUN, b""))
    function, item = pickle.loads(call)
    values = []
    for value in function(job.prepared(), item):
        packed = pickle.dumps(value)
        if len(packed) <= SMALL:
            worker.log_event(name, (of, i, len(values), packed))
        values.append(value)
        if job.stopped:
            break
    worker.log_event(name, (of, i, ENDED, pickle.dumps(len(values))))
    return values
