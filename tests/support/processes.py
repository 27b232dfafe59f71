"""Child processes that are stopped."""

import signal


def hears_ctrl_c():
    """Before a child's program starts: Ctrl-C ends it, also where the tests run in a shell's background, which ignores it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
