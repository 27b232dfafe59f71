"""What a hostile input is, and the ways to spoil a file that need no knowledge of it."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SAMPLE = Path(__file__).parents[3] / "data_samples" / "tshirt-talk"
DEEP = "[" * 100_000
FRAME = "frames/000000"
INF, NAN = float("inf"), float("nan")


@dataclass(frozen=True)
class Case:
    """`spoil(folder)` damages a copy of a `kind` (capture, run, avatar, motion); `command` is given "IN" for the folder, and
    "RUN", "OUT", and "AVATAR" for others; each of `said` stands in the message."""

    kind: str
    spoil: object
    command: tuple
    said: tuple = ()
    slow: bool = False


REGISTER = ("register", "IN", "OUT", "--quality", "draft")
EVALUATE, REPORT = ("evaluate", "IN"), ("report", "IN")
ANIMATE = ("animate", "IN", "MOTION", "OUT")
DRIVE, BVH = (("animate", "AVATAR", f"IN/motion.{kind}", "OUT") for kind in ("npz", "bvh"))
ALIGN = ("align", "IN", "OUT")
TEMPLATE = ("template", "IN", "OUT.obj", "--name", "shirt", "--label", "tshirt")
TRAIN = ("train", "IN", "OUT", "--quality", "draft", "--steps", "1,1,1", "--no-align")
CASES = {}


def add(name, kind, spoil, command, *said, slow=False):
    assert name not in CASES, name
    CASES[name] = Case(kind, spoil, command, said, slow)


def removed(path):
    path.unlink()


def emptied(path):
    path.write_bytes(b"")


def garbled(path):
    path.write_bytes(bytes(np.random.default_rng(0).integers(0, 256, 4000, dtype=np.uint8)))


def halved(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def piped(path):
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def made_a_file(path):
    path.write_text("")
    return path


def made_a_folder(path):
    path.unlink()
    path.mkdir()


def looped(path):
    path.unlink()
    path.symlink_to(path.name)


def swollen(path):
    os.truncate(path, 1 << 40)


DAMAGES = {f.__name__: f for f in (removed, emptied, garbled, halved, piped, made_a_folder, looped, swollen)}


QUICK = ("removed", "garbled", "piped", "swollen")  # the others are variations of these


def damage(kind, path, command, without=()):
    for name, spoil in DAMAGES.items():
        if name not in without:
            named = Path(path).name.split(".")[0]
            add(f"{kind} {path} {name}", kind, _at(path, spoil), command, named, slow=name not in QUICK)


def _at(path, spoil):
    return lambda folder: spoil(folder / path)


def text(path, old, new):
    def spoil(folder):
        whole = (folder / path).read_text()
        assert old in whole, old
        (folder / path).write_text(whole.replace(old, new, 1))

    return spoil


def archive(path, **changes):
    """Arrays of a .npz changed; None removes one."""

    def spoil(folder):
        arrays = dict(np.load(folder / path))
        for name, value in changes.items():
            arrays.pop(name, None) if value is None else arrays.update({name: value})
        np.savez(folder / path, **arrays)

    return spoil


def written(path, value):
    return lambda folder: (folder / path).write_text(value if isinstance(value, str) else json.dumps(value))


def changed(path, change):
    """A JSON file, loaded, changed and written."""

    def spoil(folder):
        data = json.loads((folder / path).read_text())
        change(data)
        (folder / path).write_text(json.dumps(data))

    return spoil


def nothing(folder):
    pass
