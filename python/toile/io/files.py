"""Files that are there whole or not at all, and dataclasses of arrays as files.

Every file is written under another name first and renamed, so a process that is killed at any instant leaves whole files.
"""

from __future__ import annotations

import glob
import json
import os
import re
import shutil
import tempfile
import uuid
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np

from ..errors import UserError, first_line
from .bounded import read_npz, reason_of
from .inputs import files_under
from .locks import BUSY, abandoned, at_work

IDENTITY = "made.of"  # the name of a record's identity among its arrays


@contextmanager
def naming(path):
    """Within it an OSError that names no file, as that of a full disk, names this one."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None


def _part_of(path):
    """Another name beside `path`; processes of two machines may share a number, so it is drawn."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}.part")


def replace_file(path, write):
    """Calls `write(temporary path)` and renames the result to `path`. An OSError names `path`, and leaves nothing behind."""
    temporary = _part_of(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        os.replace(temporary, path)
    except BaseException as error:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        elif temporary.exists():
            temporary.unlink()
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror or str(error), str(path)) from None
        raise


@contextmanager
def called(part, path):
    """Within it errors call the temporary file or folder `part`, which nobody knows, `path`, and so does an OSError that names no file."""
    try:
        yield
    except UserError as error:
        raise type(error)(str(error).replace(str(part), str(path))) from None
    except OSError as error:
        name = str(error.filename or part).replace(str(part), str(path))
        raise OSError(error.errno, error.strerror or str(error), name) from None


@contextmanager
def part_folder(path):
    """A new folder beside `path` to write into, gone at the end unless it was renamed; those that killed processes left for the same
    `path` go too. UserError: it cannot be made."""
    _remove_abandoned(path)
    folder = _part_of(path)
    new = folder.with_suffix(".new")  # until it is held: another writer takes what nobody holds for abandoned
    try:
        new.mkdir(parents=True)
    except OSError as error:
        raise UserError(f"{path}: cannot be made: {error.strerror or first_line(error)}") from None
    try:
        with at_work(new, False, ""), called(folder, path):
            new.rename(folder)
            yield folder
    finally:
        for left in (new, folder):
            shutil.rmtree(left, ignore_errors=True)


def _remove_abandoned(path):
    name = re.compile(re.escape(f".{path.name}.") + r"[0-9a-f]{12}\.part")
    for left in path.parent.glob(f".{glob.escape(path.name)}.*.part"):
        if name.fullmatch(left.name) and abandoned(left):
            shutil.rmtree(left, ignore_errors=True)


@contextmanager
def whole_folder(path):
    """A new folder to write into, renamed to `path` at the end, gone after an exception. It is made at once, so that a place that cannot
    be written to is known before any work; two writers of one place do not meet. UserError: `path` holds something, or cannot be made."""
    path = Path(path).resolve()
    _refuse_full(path)
    with part_folder(path) as folder:
        yield folder
        _refuse_full(path)  # another writer was first
        (folder / BUSY).unlink(missing_ok=True)
        os.replace(folder, path)


def _refuse_full(path):
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise UserError(f"{path}: exists already and is not empty")


def output_file(path):
    """The path of a file that will be written at the end of long work, in a folder that is there. UserError: it cannot be."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror or first_line(error)}") from None
    if path.is_dir():
        raise UserError(f"{path}: cannot be written: it is a folder")
    return path


def copy_file(source, path):
    """A whole copy of a file; an OSError names `path`."""
    replace_file(path, lambda part: shutil.copyfile(source, part))


def copy_folder(source, path):
    """`copy_file` of every file in a folder and below."""
    for file in files_under(source):
        copy_file(file, path / file.relative_to(source))


def write_text(path, text):
    """`text` as a whole file of UTF-8."""
    replace_file(path, lambda p: p.write_text(text, encoding="utf-8"))


def save_record(path, record, identity=""):
    """A dataclass of arrays, strings, numbers, dictionaries of numbers and such dataclasses, as .npz without pickles.
    `identity`: what it was made of, for `identity_of`."""
    arrays = _arrays(record) | ({IDENTITY: np.array(identity)} if identity else {})

    def write(p):
        with open(p, "wb") as file:
            np.savez(file, **arrays)

    replace_file(path, write)


def identity_of(path, whole=False):
    """The identity that a record was saved with; "" where there is no such file, or one that cannot be read: with `whole`
    all of it is."""
    try:
        return str(read_npz(path, names=None if whole else {IDENTITY})[IDENTITY])
    except (UserError, KeyError):
        return ""


def load_record(path, kind, tuples=(), only=None, **records):
    """The dataclass `kind` back, or a UserError that names the file; fields named in `tuples` are tuples of index arrays, `records` names dataclasses.
    Of the fields `only` if given; the others are None."""
    data = read_npz(path, names=only and {name for field in only for name in (field, f"json.{field}")})
    try:
        return _record(data, kind, "", tuples, records)
    except (ValueError, TypeError, RecursionError) as error:
        raise UserError(f"{path}: not a {kind.__name__}: {reason_of(error)}") from None


def _arrays(record, prefix=""):
    arrays = {}
    for field in fields(record):
        value, name = getattr(record, field.name), prefix + field.name
        if is_dataclass(value):
            arrays |= _arrays(value, f"{name}.")
        elif isinstance(value, (dict, tuple, str)):
            arrays[f"json.{name}"] = np.array(json.dumps(value, default=_plain))
        elif value is not None:
            arrays[name] = np.asarray(value)
    return arrays


def _record(data, kind, prefix, tuples, records):
    values = {}
    for field in fields(kind):
        name = prefix + field.name
        values[field.name] = None
        if name in data:
            values[field.name] = data[name].item() if data[name].ndim == 0 else data[name]
        elif f"json.{name}" in data:
            value = json.loads(str(data[f"json.{name}"]))
            if field.name in tuples:
                value = [np.array(v, dtype=np.int32) for v in value]
            values[field.name] = tuple(value) if isinstance(value, list) else value
        elif field.name in records and any(key.startswith(f"{name}.") for key in data):
            values[field.name] = _record(data, records[field.name], f"{name}.", tuples, records)
    return kind(**values)


def _plain(value):
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value.item() if isinstance(value, np.generic) else value
