"""What lies in a study's folder is made once: by a function, by a command of toile, or by training."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

from .results import read, write_json


def once(path, make, say):
    """The JSON at `path`, made once: what `make` gives, with the seconds that it took, of stopped attempts too."""
    if path.exists():
        return read(path)
    begun, before = time.time(), path.with_suffix(".seconds")
    path.parent.mkdir(parents=True, exist_ok=True)
    spent = float(before.read_text()) if before.exists() else 0.0
    try:
        made = make()
    finally:
        seconds = spent + time.time() - begun
        before.write_text(str(seconds))
    write_json(path, {"seconds": seconds, "machine": machine()} | made)
    before.unlink()
    say(f"{path}: {seconds:.0f} s")
    return read(path)


def link(path, target):
    """A symbolic link to `target`, by the way from one to the other, so that OUT may be moved; what is there stays."""
    if not path.exists():
        path.symlink_to(os.path.relpath(target.resolve(), path.parent.resolve()))


def finished(folder):
    """Whether a trained avatar is there; one that is, is taken as it is."""
    return (folder / "avatar.json").exists() and read(folder / "avatar.json")["steps"] is not None


def training_seconds(folder):
    """What the trainings below a folder have taken until their last checkpoints, stopped attempts included."""
    from safetensors import safe_open

    spent = 0.0
    for place in {path.parent for path in Path(folder).rglob("checkpoints/*.safetensors")}:
        with safe_open(max(place.glob("*.safetensors")), framework="pt") as file:
            spent += json.loads(file.metadata()["json"])["spent"]
    return spent


def facts_seed(folder):
    return read(folder / "avatar.json")["settings"]["seed"]


def toile(*arguments):
    """A command of `toile` in a process of its own; single frames may fail."""
    finished_well(started(*arguments))


def started(*arguments, threads=None):
    """The Popen of a command of `toile`, of so many threads."""
    command = [sys.executable, "-c", "from toile.cli import main; main()", *map(str, arguments)]
    limits = {} if threads is None else {"OMP_NUM_THREADS": str(threads)}
    return subprocess.Popen(command, env=os.environ | limits)


def finished_well(command):
    """Waits for a Popen of `toile`. SystemExit: it failed, but for single frames."""
    if command.wait() not in (0, 2):
        raise SystemExit(f"toile {command.args[3]} {command.args[4]}: exit code {command.returncode}")


def threads():
    import torch

    return torch.get_num_threads()


def machine():
    import torch

    device = torch.cuda.get_device_name() if torch.cuda.is_available() else f"CPU, {threads()} threads"
    return {"device": device, "torch": torch.__version__, "architecture": platform.machine()}


def studio_options(capture):
    """What the studio was asked for, if it made the capture."""
    path = Path(capture) / "studio.json"
    return read(path)["options"] if path.exists() else None
