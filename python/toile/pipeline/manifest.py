"""What a run was asked for, as RUN/config.toml keeps it; only the same request goes on with a run."""

from __future__ import annotations

import hashlib
import tomllib

import numpy as np

from ..errors import UserError
from ..io.files import write_text
from .blocks import locked


def open_run(run, capture, config, frames, retry):
    """Writes config.toml, or checks that it asks for the same; a retry takes frames whose files were mended."""
    import tomli_w

    from .. import __version__

    asked = {
        "capture": str(capture.root.resolve()),
        "inputs": {"scene": _scene_hash(capture), "frames": _frames_hash(capture, frames)},
        "frames": list(frames),
        "versions": {"toile": __version__, "numpy": np.__version__},
        "settings": config.model_dump(mode="json"),
    }
    path = run / "config.toml"
    if (
        run.exists()
        and not path.exists()
        and any(not p.name.startswith((".lock", ".config.toml")) for p in run.iterdir())
    ):
        raise UserError(f"{run}: the folder is not empty and holds no run")
    with locked(run):
        if path.exists():
            found = tomllib.loads(path.read_text(encoding="utf-8"))
            if retry and isinstance(found.get("inputs"), dict):
                found["inputs"]["frames"] = asked["inputs"]["frames"]
            if found != tomllib.loads(tomli_w.dumps(asked)):
                raise UserError(f"{path}: this run was made from another capture, other frames or other settings")
        write_text(path, tomli_w.dumps(asked))


def _scene_hash(capture):
    """sha256 over the scene's files."""
    digest = hashlib.sha256()
    for path in sorted(
        p for p in capture.root.rglob("*") if p.is_file() and "frames" not in p.parts and "truth" not in p.parts
    ):
        digest.update(path.relative_to(capture.root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _frames_hash(capture, frames):
    """sha256 over names and sizes of the frames' files."""
    digest = hashlib.sha256()
    for number in frames:
        folder = capture.root / "frames" / f"{number:06d}"
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            digest.update(f"{path.relative_to(capture.root).as_posix()} {path.stat().st_size}\n".encode())
    return digest.hexdigest()
