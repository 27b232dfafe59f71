"""python -m tests.fuzz: random ugly arguments into every array-taking function of toile.kernels.

Each call must return finite results of the right shape or raise InputError, SolveError or TypeError: never crash,
hang, or raise anything else. Cases run in worker processes; what breaks the law is written to --out as
ENTRY-SEED.txt (what happened) and ENTRY-SEED.pickle (the arguments), and can be run again with --seed.
"""

import argparse
import importlib.util
import os
import pickle
import select
import subprocess
import sys
import time
import traceback
from pathlib import Path

BATCH = 500  # cases a worker process


def main():
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("entries", nargs="*", help="all when none is named")
    parser.add_argument("--seconds", type=float, default=60, help="in all, shared by the entries")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--seed", type=int, help="run this one case here, and show what happens")
    parser.add_argument("--core", type=Path, help="folder of another build of the compiled module, a sanitized one")
    parser.add_argument("--limit", type=float, default=30, help="seconds that one call may take")
    parser.add_argument("--out", type=Path, default=Path("fuzz"))
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker or options.seed is not None:
        load_core(options.core)
        return worker(options)
    from .entries import ENTRIES

    names = options.entries or list(ENTRIES)
    findings = 0
    for name in names:
        findings += fuzz(name, options.seconds / len(names), options)
    return 1 if findings else 0


def load_core(folder):
    """The compiled module of `folder` in place of the installed one."""
    if folder is None:
        return
    (path,) = folder.glob("_core*.so")
    spec = importlib.util.spec_from_file_location("toile._core", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules["toile._core"] = module  # where `toile.kernels` will find it


def worker(options):
    """Runs cases from the first seed on; says each seed before it starts and how it ended."""
    import warnings

    from .draw import Draw
    from .entries import ENTRIES
    from .laws import LAWFUL

    warnings.simplefilter("ignore")
    draw, run = ENTRIES[options.entries[0]]
    seeds = [options.seed] if options.seed is not None else range(options.first, options.first + BATCH)
    for seed in seeds:
        arguments = draw(Draw(seed))
        print("start", seed, flush=True)
        try:
            run(**arguments)
            print("end", "solved", flush=True)
        except LAWFUL as error:
            print("end", "refused", flush=True)
            if options.seed is not None:
                print(type(error).__name__, error)
        except Exception:
            print("end", "broken", repr(traceback.format_exc()), flush=True)
            if options.seed is not None:
                traceback.print_exc()


def start_worker(name, first, options):
    command = [sys.executable, "-m", "tests.fuzz", name, "--worker", "--first", str(first)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1"}
    if options.core:
        runtime = subprocess.run(
            ["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True
        ).stdout.strip()
        # libstdc++ beside it, or its exceptions are not intercepted
        cxx = subprocess.run(
            ["gcc", "-print-file-name=libstdc++.so"], capture_output=True, text=True, check=True
        ).stdout.strip()
        environment["LD_PRELOAD"] = f"{runtime} {cxx}"
        command += ["--core", str(options.core)]
    errors = (options.out / f"{name}.stderr").open("wb")
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, env=environment), errors


def fuzz(name, seconds, options):
    """One entry for some seconds; the number of findings."""
    options.out.mkdir(exist_ok=True)
    end, first = time.monotonic() + seconds, options.first
    counts = {"solved": 0, "refused": 0}
    kinds = {}
    while time.monotonic() < end:
        process, errors = start_worker(name, first, options)
        seed, trouble = watch(process, end, options.limit, counts, lambda s, what: note(name, s, what, kinds, options))
        errors.close()
        if trouble:
            stderr = (options.out / f"{name}.stderr").read_text(errors="replace")[-6000:]
            note(name, seed, f"{trouble}\n{stderr}", kinds, options)
        first = first + BATCH if seed is None else seed + 1
    (options.out / f"{name}.stderr").unlink()
    found = sum(map(len, kinds.values()))
    print(
        f"{name}: {counts['solved']} solved, {counts['refused']} refused, {found} broke the law in {len(kinds)} ways",
        flush=True,
    )
    for kind, seeds in kinds.items():
        print(f"    {kind}: seeds {seeds[:8]}", flush=True)
    return found


def watch(process, end, limit, counts, broken):
    """Follows one worker. -> (seed, trouble): the last seed begun and why it did not end, or (None, None)."""
    seed, busy, last = None, False, time.monotonic()
    pending = b""
    while True:
        ready, _, _ = select.select([process.stdout], [], [], 1)
        now = time.monotonic()
        if ready:
            block = os.read(process.stdout.fileno(), 65536)
            pending += block
            *lines, pending = pending.split(b"\n")
            for line in lines:
                word, _, rest = line.decode().partition(" ")
                last = now
                if word == "start":
                    seed, busy = int(rest), True
                elif word == "end":
                    busy = False
                    if rest.startswith("broken"):
                        broken(seed, rest[7:])
                    else:
                        counts[rest] += 1
            if not block:
                code = process.wait()
                if code == 1 and not busy:
                    raise RuntimeError("the fuzzer itself failed to draw a case: see the last lines of its stderr")
                return (None, None) if code == 0 else (seed, f"worker ended with {code}")
        if busy and now - last > limit:
            process.kill()
            process.wait()
            return seed, f"no answer in {limit} s"
        if now > end and not busy:
            process.kill()
            process.wait()
            return None, None


def note(name, seed, what, kinds, options):
    """Keeps a finding's text and arguments; the same kind three times is enough."""
    from .draw import Draw
    from .entries import ENTRIES

    kind = next(
        (line for line in what.split("\n") if "ERROR: AddressSanitizer" in line or "runtime error" in line), None
    )
    kind = kind or what.strip("'\"").replace("\\n", "\n").strip().split("\n")[-1 if what[:1] in "'\"" else 0]
    kind = kind.split(" on address")[0][:150]
    seeds = kinds.setdefault(kind, [])
    seeds.append(seed)
    if len(seeds) > 3 or seed is None:
        return
    base = options.out / f"{name}-{seed}"
    base.with_suffix(".txt").write_text(what.replace("\\n", "\n"))
    with base.with_suffix(".pickle").open("wb") as file:
        try:
            pickle.dump(ENTRIES[name][0](Draw(seed)), file)
        except Exception:
            traceback.print_exc()


if __name__ == "__main__":
    sys.exit(main())
