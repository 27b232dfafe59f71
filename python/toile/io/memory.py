"""The memory that is left to this process."""

from __future__ import annotations

import re
from pathlib import Path

MEMINFO = Path("/proc/meminfo")
GROUP = Path("/sys/fs/cgroup")  # what a container is held to


def machine_memory() -> dict[str, int]:
    """Bytes by the kernel's names, `MemTotal` and `MemAvailable` among them; empty where it tells nothing."""
    text = MEMINFO.read_text() if MEMINFO.exists() else ""
    return {name: 1024 * int(kib) for name, kib in re.findall(r"(\w+):\s+(\d+) kB", text)}


def memory_limit() -> int | None:
    """Bytes that this process is held to, None where it is held to nothing."""
    return _number(GROUP / "memory.max")


def free_memory() -> int | None:
    """Bytes that this process may still take; None where nothing tells."""
    left, limit, held = machine_memory().get("MemAvailable"), memory_limit(), _number(GROUP / "memory.current")
    if limit is None or held is None:
        return left
    within = max(limit - held + _cached(), 0)
    return within if left is None else min(left, within)


def _cached() -> int:
    """Bytes of files that the container holds and gives back when it needs the room."""
    text = (GROUP / "memory.stat").read_text() if (GROUP / "memory.stat").exists() else ""
    return sum(map(int, re.findall(r"^(?:in)?active_file (\d+)$", text, re.MULTILINE)))


def _number(path: Path) -> int | None:
    text = path.read_text().strip() if path.exists() else ""
    return int(text) if text.isdecimal() else None
