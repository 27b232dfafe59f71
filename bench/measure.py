"""One method on one problem in a process of its own.   python -m bench.measure KERNEL METHOD PROBLEM OUT.npz

`run` starts such a process and gives what it took: prepare_s and solve_s (medians inside the process, without imports
and files), process_s (the whole process, once), cpu_s, peak_mb. A call that stays under REPEAT_BELOW is repeated.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from importlib import import_module
from pathlib import Path

import numpy as np

THREADS = 2
REPEAT_BELOW, REPEATS = 1.0, 5  # s in all, times
PEER_FRAMES = slice(10, None, 25)  # of a sequence, for methods that take seconds a frame


def run(method, problem, timeout):
    """-> (row, result): figures or an "error", and the result or None. `problem`: a .npz or a sequence's folder."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.npz"
        command = [sys.executable, "-m", "bench.measure", method.kernel, method.name, str(problem), str(out)]
        log = open(Path(folder) / "log", "w+")
        start = time.perf_counter()
        child = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment())
        usage = wait(child, start + timeout)
        seconds = time.perf_counter() - start
        if usage is None:
            return dict(error=f"over {timeout:g} s"), None
        row = dict(cpu_s=usage.ru_utime + usage.ru_stime)
        if not out.exists():
            log.seek(0)
            last = (log.read().strip().splitlines() or ["no output"])[-1]
            return row | dict(error=f"exit {child.returncode}: {last[:200]}"), None
        with np.load(out) as found:
            figures, result = json.loads(str(found["figures"])), found["result"]
    repeated = figures.pop("repeated_s")
    return row | figures | dict(process_s=seconds - repeated), result


def wait(child, deadline):
    """The child's resource usage, or None after killing it at the deadline."""
    while True:
        pid, status, usage = os.wait4(child.pid, os.WNOHANG)
        if pid:
            child.returncode = os.waitstatus_to_exitcode(status)
            return usage
        if time.perf_counter() > deadline:
            child.kill()
            os.wait4(child.pid, 0)
            child.returncode = -9
            return None
        time.sleep(0.01)


def environment():
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "IGL_NUM_THREADS", "NUMBA_NUM_THREADS")
    return os.environ | dict.fromkeys(names, str(THREADS)) | {"OMP_WAIT_POLICY": "passive"}


def timed(call, *arguments):
    """(median seconds, seconds of the repetitions, result of the last call)."""
    times = []
    while not times or (sum(times) < REPEAT_BELOW and len(times) < REPEATS):
        start = time.perf_counter()
        result = call(*arguments)
        times.append(time.perf_counter() - start)
    return float(np.median(times)), sum(times[1:]), result


def one_problem(method, path):
    problem = load(path)
    prepare, again, _ = timed(method.prepare, problem)
    start = time.perf_counter()
    solve, more, result = timed(method.prepare(problem), problem)
    extra = max(0.0, time.perf_counter() - start - solve - more)  # the preparation that `solve` was timed with
    return dict(prepare_s=prepare, solve_s=solve, repeated_s=again + more + extra), result


def sequence(method, folder):
    """Median and slowest seconds a frame, after one preparation; results (T,n,3)."""
    template = load(folder / "template.npz")
    start = time.perf_counter()
    solve = method.prepare(template)
    prepare, times, results, last = time.perf_counter() - start, [], [], None
    for path in frame_files(folder, method):
        frame = dict(template, **load(path), start=last)
        start = time.perf_counter()
        last = solve(frame)
        times.append(time.perf_counter() - start)
        results.append(last)
    figures = dict(prepare_s=prepare, solve_s=float(np.median(times)), worst_s=max(times), repeated_s=0.0)
    return figures, np.array(results)


def peak_mb():
    """Most memory this process held, the interpreter included. (A child's ru_maxrss starts at its parent's size.)"""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def frame_files(folder, method):
    files = sorted(p for p in Path(folder).glob("*.npz") if p.stem.isdigit())
    return files[PEER_FRAMES] if method.slow else files


def load(path):
    """Its arrays, without the truth's surface, which no method needs and the memory figure should not show."""
    with np.load(path) as file:
        return {k: file[k] for k in file.files if k not in ("clean_v", "clean_f", "D")}


def main():
    from .contenders import methods

    kernel, name, problem, out = sys.argv[1:5]
    method = next(m for m in methods() if (m.kernel, m.name) == (kernel, name))
    import_module(method.module)
    path = Path(problem)
    figures, result = (sequence if path.is_dir() else one_problem)(method, path)
    np.savez(out, figures=json.dumps(figures | dict(peak_mb=peak_mb())), result=result)


if __name__ == "__main__":
    main()
