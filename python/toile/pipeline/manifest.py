"""What a run was asked for, as RUN/config.toml keeps it; only the same request goes on with a run."""

from __future__ import annotations

import json
import tomllib

import numpy as np

from ..errors import UserError
from ..io.bounded import read_json
from ..io.files import write_text
from ..io.inputs import contents, files_under, stamps
from ..io.run_folder import config_file, read_config
from .blocks import locked

OWN = (".lock", ".config.toml")  # what a run that was killed at once may have left
SCENE = "scene"


def begin_run(run, capture, config, frames, verify=False, again=()):
    """Writes config.toml, or checks that it asks for the same and that no input has changed since it was read: its name,
    size and time, with `verify` its contents. The frames `again` may have been mended. UserError names what has changed."""
    from .. import __version__

    asked = {
        "capture": str(capture.root.resolve()),
        "frames": list(frames),
        "versions": {"toile": __version__, "numpy": np.__version__},
        "settings": config.model_dump(mode="json"),
    }
    claim(run, asked, "this run was made from another capture, other frames or other settings")
    for number in again:
        _noted(run, f"{number:06d}").unlink(missing_ok=True)
    _note(run, capture.root, SCENE, capture.files, verify)
    for number in frames:
        if _noted(run, f"{number:06d}").exists():
            note_frame(run, capture, number, verify)


def note_frame(run, capture, number, verify=False):
    """Keeps what a frame's files are in RUN/inputs, or checks that they are still the same; see `begin_run`."""
    _note(run, capture.root, f"{number:06d}", files_under(capture.folder(number)), verify)


def claim(run, asked, refusal):
    """Makes the folder `run` with a config.toml that holds the table `asked`, or checks that its own is the same; else
    UserError: `refusal`."""
    import tomli_w

    path, text = config_file(run), tomli_w.dumps(asked)
    if run.exists() and not path.exists() and any(not p.name.startswith(OWN) for p in run.iterdir()):
        raise UserError(f"{run}: the folder is not empty and holds no run")
    with locked(run):
        if path.exists() and read_config(run) != tomllib.loads(text):
            raise UserError(f"{path}: {refusal}")
        write_text(path, text)


def _noted(run, name):
    """{file: [bytes, time [ns], sha256]} of the scene, or of the frame of this number."""
    return run / "inputs" / f"{name}.json"


def _note(run, root, name, paths, verify):
    """Writes the note of these files, or checks them against it. A time alone does not make a change."""
    path, now = _noted(run, name), stamps(root, paths)
    if not path.exists():
        write_text(path, json.dumps({file: [*stamp, contents(root / file)] for file, stamp in now.items()}, indent=1))
        return
    then = {file: tuple(known) for file, known in read_json(path, dict).items() if isinstance(known, list)}
    for file in sorted(then.keys() | now.keys()):
        if file not in now or file not in then:
            what = "is gone" if file not in now else "was not there"
        elif now[file] == then[file][:2] and not verify:
            continue
        elif now[file][0] == then[file][0] and contents(root / file) == then[file][-1]:
            continue
        else:
            what = "has changed"
        raise UserError(f"{root / file}: {what} since {run} read it: register into another folder")
