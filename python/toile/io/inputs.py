"""What input files were when they were read: sizes, times and contents, so that a change is noticed and named."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any


def files_under(folder: Path) -> list[Path]:
    """Ordinary files in a folder and below, in order."""
    return sorted(p for p in Path(folder).rglob("*") if p.is_file())


def stamps(root: Path, paths: Iterable[Path]) -> dict[str, Any]:
    """{path inside `root`: (bytes, time of the last change [ns])} of files."""
    return {_inside(root, path): (found.st_size, found.st_mtime_ns) for path in paths for found in [path.stat()]}


def contents(path: Path) -> str:
    """sha256 of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest(*values: Any) -> str:
    """A digest of values that JSON can hold."""
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:32]


def differ(root: Path, paths: Iterable[Path], noted: dict[str, Any]) -> bool:
    """Whether files are others than those that were `noted` as {path inside `root`: [bytes, time [ns], sha256]}, or of other contents."""
    found = stamps(root, paths)
    if found.keys() != noted.keys():
        return True
    return any(list(s) != noted[n][:2] and contents(root / n) != noted[n][-1] for n, s in found.items())


def _inside(root: Path, path: Path) -> str:
    return Path(path).relative_to(root).as_posix()
