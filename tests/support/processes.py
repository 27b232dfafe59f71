"""Child processes that are waited for and stopped."""

import signal
import time

PATIENCE = 600  # s; long, since the machine may have much else to do


def hears_ctrl_c():
    """Before a child's program starts: Ctrl-C ends it, also where the tests run in a shell's background, which ignores it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def wait_until(condition, child=None):
    """Returns once `condition()` holds; fails where the process `child` ends before."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert child is None or child.poll() is None, "the process ended before what was waited for"
        assert time.monotonic() < end, f"what was waited for did not come in {PATIENCE} s"
        time.sleep(0.02)
