"""Locks between processes: one waits for another, file systems without flock have another way, or it is said."""

import errno
import fcntl
import os
import subprocess
import sys

import pytest

from toile.errors import UserError
from toile.io.locks import abandoned, at_work, locked

HOLDS = """
import sys
from pathlib import Path
from toile.io.locks import at_work, locked

with (locked if sys.argv[1] == "locked" else lambda folder: at_work(folder, False, ""))(Path(sys.argv[2])):
    print("held", flush=True)
    sys.stdin.read()
"""


def holder(kind, folder):
    """Another process, once it holds its lock."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDS, kind, folder], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "held\n"
    return process


def record_holder(folder):
    """The same by a POSIX record lock."""
    code = "import fcntl, sys\nfile = open(sys.argv[1], 'w')\nfcntl.lockf(file, fcntl.LOCK_EX)\nprint('held', flush=True)\nsys.stdin.read()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, folder / ".lock"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "held\n"
    return process


def missing(*_):
    raise OSError(errno.ENOLCK, "No locks available")


def test_who_wants_something_else_is_refused_while_others_work_and_who_wants_the_same_is_not(tmp_path):
    with holder("at_work", tmp_path) as other:
        with at_work(tmp_path, False, "refused"):
            pass
        with (
            pytest.raises(UserError, match="busy with something else"),
            at_work(tmp_path, True, "busy with something else"),
        ):
            pytest.fail("not refused")
        other.kill()
    with at_work(tmp_path, True, "refused"):  # a killed process lets go
        pass


@pytest.mark.parametrize("flock", [True, False])
def test_who_waits_for_another_process_is_told_so_and_goes_on_when_that_ends(tmp_path, monkeypatch, flock):
    with locked(tmp_path, lambda: pytest.fail("nobody holds it")):
        pass
    other = holder("locked", tmp_path) if flock else record_holder(tmp_path)
    if not flock:
        monkeypatch.setattr(fcntl, "flock", missing)
    told = []

    def waits():
        told.append(other.poll())
        other.kill()

    with locked(tmp_path, waits):
        assert told == [None]
    other.communicate()


def test_without_flock_record_locks_hold_and_without_either_it_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr(fcntl, "flock", missing)
    with locked(tmp_path), at_work(tmp_path, True, "refused"):
        tried = "import fcntl, sys; fcntl.lockf(open(sys.argv[1], 'w'), fcntl.LOCK_EX | fcntl.LOCK_NB)"
        done = subprocess.run([sys.executable, "-c", tried, tmp_path / ".lock"], capture_output=True, text=True)
        assert "BlockingIOError" in done.stderr
    monkeypatch.setattr(fcntl, "lockf", missing)
    with pytest.raises(UserError, match=r"\.lock: this file system has no locks"), locked(tmp_path):
        pytest.fail("nothing was held")


def test_locks_are_held_on_nfs_which_shares_what_may_be_read_and_gives_alone_what_may_be_written(tmp_path, monkeypatch):
    flock = fcntl.flock

    def as_nfs(file, kind):
        mode = fcntl.fcntl(file, fcntl.F_GETFL) & os.O_ACCMODE
        if mode == (os.O_WRONLY if kind & fcntl.LOCK_SH else os.O_RDONLY):
            raise OSError(errno.EBADF, "Bad file descriptor")
        flock(file, kind)

    monkeypatch.setattr(fcntl, "flock", as_nfs)
    with locked(tmp_path), at_work(tmp_path, False, "refused"):
        assert not abandoned(tmp_path)
    with at_work(tmp_path, True, "refused"):
        pass
    assert abandoned(tmp_path)


def test_a_folder_is_abandoned_when_those_who_worked_there_are_gone(tmp_path, monkeypatch):
    assert not abandoned(tmp_path)  # nobody was
    with holder("at_work", tmp_path) as other:
        assert not abandoned(tmp_path)
        other.kill()
    assert abandoned(tmp_path)
    monkeypatch.setattr(fcntl, "flock", missing)
    assert not abandoned(tmp_path)  # nobody knows
