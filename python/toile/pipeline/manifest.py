"""What a run was asked for, as RUN/config.toml keeps it; only the same request goes on with a run."""

from __future__ import annotations

import hashlib
import tomllib

import numpy as np

from ..errors import UserError
from ..io.files import write_text
from ..io.run_folder import config_file, read_config
from .blocks import locked


def begin_run(run, capture, config, frames, retry):
    """Writes config.toml, or checks that it asks for the same; a retry takes frames whose files were mended."""
    from .. import __version__

    asked = {
        "capture": str(capture.root.resolve()),
        "inputs": {"scene": _scene_hash(capture), "frames": _frames_hash(capture, frames)},
        "frames": list(frames),
        "versions": {"toile": __version__, "numpy": np.__version__},
        "settings": config.model_dump(mode="json"),
    }

    def mended(found):
        if retry and isinstance(found.get("inputs"), dict):
            found["inputs"]["frames"] = asked["inputs"]["frames"]
        return found

    claim(run, asked, "this run was made from another capture, other frames or other settings", mended)


def claim(run, asked, refusal, mended=lambda found: found):
    """Makes the folder `run` with a config.toml that holds the table `asked`, or checks that its own, `mended`, is the same;
    else UserError: `refusal`."""
    import tomli_w

    path, text = config_file(run), tomli_w.dumps(asked)
    if (
        run.exists()
        and not path.exists()
        and any(not p.name.startswith((".lock", ".config.toml")) for p in run.iterdir())
    ):
        raise UserError(f"{run}: the folder is not empty and holds no run")
    with locked(run):
        if path.exists() and mended(read_config(run)) != tomllib.loads(text):
            raise UserError(f"{path}: {refusal}")
        write_text(path, text)


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
