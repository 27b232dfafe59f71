"""How much memory a call takes at most."""

import ctypes
import gc
import threading
from pathlib import Path

EVERY = 0.002  # s


def peak_mb(call):
    """Most memory [MB] that this process is seen to hold during the call, beyond what it held before it. Looked at every 2 ms: the kernel's own
    peak (VmHWM) cannot be begun anew everywhere. What earlier calls freed is given back first, or the call would take that. Linux: proc(5)."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    before, peak, over = _held(), [], threading.Event()

    def watch():
        while not over.wait(EVERY):
            peak.append(_held())

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        call()
    finally:
        over.set()
        watcher.join()
    return max(peak, default=before) - before


def _held():
    return int(Path("/proc/self/status").read_text().split("VmRSS:")[1].split()[0]) / 1024
