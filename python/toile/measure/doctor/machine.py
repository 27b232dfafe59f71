"""What is installed, and what the machine has."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

from packaging.requirements import Requirement

from ... import kernels
from ...io.memory import machine_memory, memory_limit

PROGRAMS = {"chromium": "pages are tested in it", "blender": "Alembic", "node": "the glTF validator of the tests"}
WAIT = 20.0  # s for a program to say its version
GIB = 2**30


def packages() -> Iterator[tuple[str, str, str]]:
    """(name, version or "", the extra that asks for it, "" for all) of what toile's metadata asks for on this system."""
    try:
        asked = importlib.metadata.requires("toile") or ()
    except importlib.metadata.PackageNotFoundError:
        return  # run from the source tree
    for line in asked:
        need = Requirement(line)
        asks = re.search(r"extra == ['\"]([^'\"]+)", line)
        extra = asks[1] if asks else ""
        another_system = need.marker is not None and not need.marker.evaluate({"extra": extra})
        if need.name != "toile" and not another_system:  # an extra may be another one by name
            yield need.name, version_of(need.name), extra


def version_of(package: str) -> str:
    """Its version, "" where it is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def machine() -> dict[str, str]:
    """What the machine has, in words."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return {
        "system": platform.platform(),
        "python": platform.python_version(),
        "processor": processor(),
        "cores": f"{cores}, kernels use {kernels.threads()} threads",
        "memory": memory(),
        "disk": f"{shutil.disk_usage('.').free / GIB:.0f} GiB free here",
        "GPU": graphics(),
    }


def processor() -> str:
    """Its name, and whether it has the instructions that the core may be built for."""
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    name = re.search(r"model name\s*: (.*)", text)
    flags = set(re.search(r"flags\s*: (.*)", text)[1].split()) if "flags" in text else set()
    return f"{name[1] if name else platform.machine()}{', AVX2' if 'avx2' in flags else ''}"


def memory() -> str:
    """Free and all, and what this process is held to where that is less."""
    size, limit = machine_memory(), memory_limit()
    if "MemTotal" not in size:
        return "unknown"
    held = f", this process is held to {limit / GIB:.1f}" if limit is not None else ""
    return f"{size['MemAvailable'] / GIB:.1f} of {size['MemTotal'] / GIB:.1f} GiB free{held}"


def graphics() -> str:
    """NVIDIA's cards by their driver's program; torch is not asked, it takes seconds to load."""
    cards = said(["nvidia-smi", "--query-gpu=name,memory.total", "--format=csv,noheader"])
    return "; ".join(cards.splitlines()) or "none that NVIDIA's driver knows"


def programs() -> dict[str, str]:
    """{program: its version, "" where it is not installed}."""
    return {name: next(iter(said([name, "--version"]).splitlines()), "") for name in PROGRAMS}


def said(command: list[str]) -> str:
    """What a program prints, "" where it is not there or fails."""
    if shutil.which(command[0]) is None:
        return ""
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=WAIT).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
