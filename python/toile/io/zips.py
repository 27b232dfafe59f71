"""Files out of a .zip, by the names that are asked for: nothing is unpacked, and no size is believed that does not fit."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path, PurePosixPath

from ..errors import UserError
from .bounded import check_file, reason_of

MEMBER_BYTES = 1 << 30


class Zip:
    """An archive whose members all lie inside it. UserError names the archive and the member."""

    def __init__(self, path: Path) -> None:
        self.path = check_file(path)
        try:
            self.archive = zipfile.ZipFile(path)
        except (OSError, ValueError, zipfile.BadZipFile) as error:
            raise UserError(f"{path}: not a zip: {reason_of(error)}") from None
        self.members = {member.filename: member for member in self.archive.infolist()}
        for name in self.members:
            parts = PurePosixPath(name.replace("\\", "/")).parts
            if ".." in parts or name.startswith(("/", "\\")) or ":" in name:
                raise UserError(f"{path}: {name!r}: a path that leaves the archive")

    def read(self, name: str) -> bytes:
        """The bytes of a member."""
        member = self.members.get(name)
        if member is None:
            raise UserError(f"{self.path}: no {name} in it")
        if member.file_size > MEMBER_BYTES:
            raise UserError(f"{self.path}: {name}: {member.file_size} bytes, at most {MEMBER_BYTES} are read")
        try:
            return self.archive.read(member)
        except (OSError, ValueError, RuntimeError, NotImplementedError, zlib.error, zipfile.BadZipFile) as error:
            raise UserError(f"{self.path}: {name}: cannot be read: {reason_of(error)}") from None
