"""Locks between processes on files of a shared folder, where a killed process lets go by itself."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from ..errors import UserError

BUSY = ".busy"  # in a folder: held by those who work there
MISSING = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL}  # what file systems without locks answer


@contextmanager
def locked(folder: Path, waits: Callable[[], object] = lambda: None) -> Iterator[None]:
    """Holds FOLDER/.lock, made when it is not there; waits while another process holds it, after calling `waits`. Where the
    file system has no flock, by POSIX record locks, which most cluster file systems have. UserError: it has neither."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / ".lock", "w") as file:
        _hold(file, waits)
        yield


@contextmanager
def at_work(folder: Path, alone: bool, refusal: str) -> Iterator[None]:
    """Says by FOLDER/.busy that this process works there; processes that want the same may be at work at once. UserError
    `refusal`: `alone`, and another one is at work. Without flock nothing is refused."""
    import fcntl

    # NFS shares a lock of what may be read, and gives one alone of what may be written
    with open(folder / BUSY, "a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB if alone else fcntl.LOCK_SH)
            fcntl.flock(file, fcntl.LOCK_SH)
        except BlockingIOError:
            raise UserError(refusal) from None
        except OSError as error:
            if error.errno not in MISSING:
                raise
        yield


@contextmanager
def staying(folder: Path) -> Iterator[Callable[[], None]]:
    """Gives what raises a UserError once a folder, made when it is not there, is no longer the one that it was, whatever has been made
    under its name since. It is called where an exception ends what is done there, too: that explains it."""
    folder.mkdir(parents=True, exist_ok=True)
    held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)  # while it is open its inode goes to no other

    def check() -> None:
        try:
            same = os.path.samestat(os.fstat(held), os.stat(folder))
        except OSError:
            same = False
        if not same:
            raise UserError(
                f"{folder}: was removed or replaced while it was worked at; what lies there now is not whole"
            )

    try:
        yield check
    except Exception:
        check()
        raise
    finally:
        os.close(held)


def abandoned(folder: Path) -> bool:
    """Whether those who were `at_work` there are gone: FOLDER/.busy is there, and nobody holds it. Without flock nobody knows: False."""
    import fcntl

    try:
        with open(folder / BUSY, "r+") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _hold(file: IO[Any], waits: Callable[[], object]) -> None:
    import fcntl

    for hold in (fcntl.flock, fcntl.lockf):
        try:
            hold(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except (BlockingIOError, PermissionError):  # as POSIX leaves it to lockf
            waits()
            hold(file, fcntl.LOCK_EX)
            return
        except OSError as error:
            if error.errno not in MISSING:
                raise
    raise UserError(
        f"{file.name}: this file system has no locks: mount it with them, or let one process work at a time"
    )
