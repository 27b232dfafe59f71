"""What a run leaves on disk: the registered store, the state that lets a killed run go on, and its status lines.

Every file is written under another name first and renamed, so a run that is killed at any instant leaves whole files.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import fields, is_dataclass

import numpy as np

PENDING, OK, FAILED = 0, 1, 2


def replace_file(path, write):
    """Calls `write(temporary path)` and renames the result to `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    write(temporary)
    os.replace(temporary, path)


def write_text(path, text):
    replace_file(path, lambda p: p.write_text(text, encoding="utf-8"))


def save_record(path, record):
    """A dataclass of arrays, strings, numbers, dictionaries of numbers and such dataclasses, as .npz without pickles."""
    arrays = _arrays(record)

    def write(p):
        with open(p, "wb") as file:
            np.savez(file, **arrays)

    replace_file(path, write)


def load_record(path, kind, tuples=(), **records):
    """The dataclass `kind` back; fields named in `tuples` are tuples of index arrays, `records` names dataclasses."""
    with np.load(path, allow_pickle=False) as data:
        return _record(data, kind, "", tuples, records)


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


class Status:
    """status.jsonl: one line a stage and frame."""

    def __init__(self, path):
        self.path = path

    def add(self, **line):
        with open(self.path, "a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    def lines(self):
        """All whole lines; a run that was killed may have left the last one cut."""
        for text in self.path.read_text(encoding="utf-8").splitlines() if self.path.exists() else []:
            try:
                yield json.loads(text)
            except ValueError:
                continue

    def warnings(self):
        """What was warned of, each once."""
        return list(dict.fromkeys(line["warning"] for line in self.lines() if "warning" in line))


class Registered:
    """RUN/registered.zarr: one zarr 3 group, a chunk a frame, `done` written last."""

    def __init__(self, path):
        import zarr

        self.group = zarr.open_group(str(path), mode="r+")
        self.row = {int(f): i for i, f in enumerate(self.group["frames"][:])}

    @staticmethod
    def create(path, frames, fixed, per_frame, attributes):
        """A store with arrays `fixed` {name: array} and, NaN or zero until written, `per_frame` {name: (shape, dtype)}."""
        import zarr

        part = path.with_name(f".{path.name}.part")
        if part.exists():
            shutil.rmtree(part)
        group = zarr.open_group(str(part), mode="w", zarr_format=3)
        group.attrs.update(attributes)
        for name, values in {"frames": np.asarray(frames, np.int64), **fixed}.items():
            group.create_array(name, data=np.asarray(values))
        config = {"write_empty_chunks": True}
        for name, (shape, dtype) in {**per_frame, "done": ((), "uint8")}.items():
            fill = np.nan if np.dtype(dtype).kind == "f" else 0
            group.create_array(
                name, shape=(len(frames), *shape), chunks=(1, *shape), dtype=dtype, fill_value=fill, config=config
            )
        os.replace(part, path)
        return Registered(path)

    def done(self, frame):
        return int(self.group["done"][self.row[frame]])

    def write(self, frame, values, done):
        """One frame: its arrays first, `done` last."""
        row = self.row[frame]
        for name, value in values.items():
            self.group[name][row] = value
        self.group["done"][row] = done

    def write_diagnostics(self, table):
        """`diagnostics/STAGE/NAME (T,)` from {frame: {stage: {name: number}}}, NaN where a frame has none; once all frames
        are done. `whole` tells whether this has been."""
        names = sorted({(stage, name) for stages in table.values() for stage, values in stages.items() for name in values})
        group = self.group.create_group("diagnostics", overwrite=True)
        for stage, name in names:
            column = [table.get(frame, {}).get(stage, {}).get(name, np.nan) for frame in self.row]
            group.create_array(f"{stage}/{name}", data=np.array(column, np.float64))
        group.attrs["whole"] = True

    def reopen(self):
        """Failed frames become pending, and the store is no longer whole."""
        failed = np.flatnonzero(self.group["done"][:] == FAILED)
        if len(failed):
            if "diagnostics" in self.group:
                self.group["diagnostics"].attrs["whole"] = False
            for row in failed:
                self.group["done"][row] = PENDING

    @property
    def whole(self):
        return "diagnostics" in self.group and bool(self.group["diagnostics"].attrs.get("whole"))
