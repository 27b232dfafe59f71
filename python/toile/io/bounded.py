"""Files from outside, read within bounds: ordinary files only, of a size and a depth that fit in memory.

Every refusal is a UserError that names the file. Pipes and devices are refused unopened, for reading one may wait for ever.
"""

from __future__ import annotations

import json
import math
import os
import stat
import tomllib
import zipfile
import zlib
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Anything

TEXT_BYTES = 256 << 20
XML_BYTES = 64 << 20
ARRAY_BYTES = 2 << 30  # of all arrays of one .npz, inflated
MESH_BYTES = 1 << 30


def check_file(path: Path | str, most: int | None = None) -> Path:
    """The path of an ordinary file of at most `most` bytes, or a UserError."""
    path = Path(path)
    try:
        found = os.stat(path)
    except FileNotFoundError:
        raise UserError(f"{path}: the file is missing") from None
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read: {reason_of(error)}") from None
    if not stat.S_ISREG(found.st_mode):
        raise UserError(f"{path}: not an ordinary file")
    if most is not None and found.st_size > most:
        raise UserError(f"{path}: {found.st_size} bytes, at most {most} are read")
    return path


def read_bytes(path: Path | str, most: int = TEXT_BYTES) -> bytes:
    """The bytes of an ordinary file."""
    try:
        return check_file(path, most).read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {reason_of(error)}") from None


def read_text(path: Path | str, most: int = TEXT_BYTES) -> str:
    """UTF-8 text without a byte order mark, which editors of Windows write, its line ends as they are."""
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from None


def read_json(path: Path | str, kind: Any = None) -> Any:
    """What a JSON file holds; with `kind` (dict, list) that and nothing else. A name that stands twice in one object is refused."""
    text = read_text(path)
    try:
        value = json.loads(text, object_pairs_hook=_once)
    except RecursionError:
        raise UserError(f"{path}: not JSON: nested too deeply") from None
    except ValueError as error:
        raise UserError(f"{path}: not JSON: {error}") from None
    if kind is not None and not isinstance(value, kind):
        raise UserError(f"{path}: holds a {type(value).__name__}, expected a {kind.__name__}")
    return value


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"{max(names, key=names.count)!r} stands twice in one object")
    return table


def read_toml(path: Path | str) -> dict[str, Any]:
    """The tables of a TOML file."""
    text = read_text(path)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise UserError(f"{path}: not TOML: nested too deeply") from None
    except ValueError as error:
        raise UserError(f"{path}: not TOML: {error}") from None


def read_xml(path: Path | str) -> Element:
    """The root of an XML file, which may declare no entities."""
    from xml.etree import ElementTree

    text = read_bytes(path, XML_BYTES)
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise UserError(f"{path}: declares a document type or entities, which is not read")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError, RecursionError) as error:
        raise UserError(f"{path}: not XML: {reason_of(error)}") from None


def read_npz(path: Path | str, most: int = ARRAY_BYTES, names: Any = None) -> dict[str, Anything]:
    """{name: array} of a .npz file without pickles, of `names` only if given.

    The sizes that the archive and each array's header give are checked before anything is inflated.
    """
    check_file(path, most + (1 << 20))
    try:
        with zipfile.ZipFile(path) as archive:
            members = {m.filename.removesuffix(".npy"): m for m in archive.infolist() if m.filename.endswith(".npy")}
            members = {name: m for name, m in members.items() if names is None or name in names}
            total = sum(m.file_size for m in members.values())
            if total > most:
                raise UserError(f"{path}: its arrays have {total} bytes, at most {most} are read")
            return {name: _array(path, name, archive, member) for name, member in members.items()}
    except UserError:
        raise
    except (OSError, ValueError, EOFError, RuntimeError, SyntaxError, zlib.error, zipfile.BadZipFile) as error:
        raise UserError(f"{path}: not a .npz of plain arrays: {reason_of(error)}") from None


def _array(path: Any, name: str, archive: Any, member: Any) -> Anything:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise UserError(f"{path}: {name}: an unknown compression")
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise UserError(f"{path}: {name}: not an array of numbers or text")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, by_columns, dtype = read(file)
        if dtype.hasobject:
            raise UserError(f"{path}: {name}: holds pickled objects, expected plain arrays")
        if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != member.file_size - file.tell():
            raise UserError(f"{path}: {name}: {dtype} {shape} is not what its {member.file_size} bytes hold")
        values = np.empty(math.prod(shape), dtype)
        if values.nbytes:
            values.view(np.uint8)[:] = np.frombuffer(
                file.read(), np.uint8
            )  # to its end, where the checksum is compared
        return values.reshape(shape, order="F" if by_columns else "C")


def reason_of(error: BaseException) -> str:
    """What an exception says, in one line: an OSError's without its number and file."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return (text or type(error).__name__).splitlines()[0]
