"""Alembic through Blender: the clip as USD, which Blender reads and writes as Alembic."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from ...errors import UserError
from .clip import Clip
from .usd import write_usd

SCRIPT = Path(__file__).with_name("in_blender.py")
LINE = 300  # characters of what Blender says that are shown


def write_alembic(clip: Clip, path: Path, progress: Callable[..., None]) -> list[str]:
    """Writes .abc, y up and in metres, as Blender does. UserError: there is no Blender."""
    command, middle = blender(), path.with_suffix(".usdc")
    write_usd(clip, middle, "points", progress)
    asked = [str(middle), str(path), str(clip.fps), str(clip.frames[0]), str(clip.frames[-1])]
    done = subprocess.run([*command, *asked], capture_output=True, text=True, errors="replace")
    for left in (middle, path.with_name(f"{path.stem}_textures")):
        shutil.rmtree(left) if left.is_dir() else left.unlink(missing_ok=True)
    if done.returncode or not path.exists():
        said = (done.stderr.strip() or done.stdout.strip()).splitlines() or ["it said nothing"]
        raise UserError(f"--format abc: Blender failed: {said[-1][:LINE]}")
    return []


def blender() -> list[str]:
    """The command that runs SCRIPT: the program `blender`, or a Python beside this environment that has its module."""
    program, python = shutil.which("blender"), Path(sys.prefix).parent / ".venv-blender" / "bin" / "python"
    if program is not None:
        return [program, "--background", "--factory-startup", "--python-exit-code", "1", "--python", str(SCRIPT), "--"]
    if python.exists():
        return [str(python), str(SCRIPT), "--"]
    raise UserError("--format abc: needs Blender: no program blender, and no .venv-blender with its Python module bpy")
