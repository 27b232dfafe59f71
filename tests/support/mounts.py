"""File systems of a test's own; only root may mount them, and the test is skipped for others."""

import subprocess
from contextlib import contextmanager

import pytest


def mount(*arguments):
    """`mount ARGUMENTS`; the test is skipped where that is not allowed."""
    done = subprocess.run(["mount", *map(str, arguments)], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"nothing may be mounted here: {done.stderr.strip()}")


@contextmanager
def mounted(folder, *arguments):
    """`mount ARGUMENTS FOLDER` while it lasts."""
    folder.mkdir(exist_ok=True)
    mount(*arguments, folder)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


def resized(folder, kib):
    """A tmpfs gets another size [KiB]."""
    mount("-o", f"remount,size={kib}k", folder)


def read_only(folder):
    """A folder that is bound to itself takes no file any more."""
    mount("-o", "remount,ro,bind", folder)
