"""Reads a registered run, lazily and without torch. `layout` says what the store holds, `run_writer` fills it.

run = toile.open_run("run")
V, F = run.track.at(run.ok[0]), run.track.faces
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from ..errors import UserError, first_line
from ..scene import BodyModel
from .bounded import check_file, read_json
from .camera import first_error
from .capture import Capture, open_capture
from .facts import changed_facts, facts_of
from .inputs import differ
from .layout import (
    DIAGNOSTICS,
    DOUBTFUL,
    IDENTITY,
    OK,
    STORE,
    VERDICT,
    VERSION,
    WRONG,
    Attributes,
    Stored,
    StoredGarment,
    layout_of,
)
from .run_folder import (
    body_model_of,
    capture_folder,
    note_of,
    read_config,
    read_diagnostics,
    scans_folder,
    scene_note_of,
)
from .status import Status

NAMED = 4  # things in a message
LARGEST = 2**31  # bytes of one chunk: a larger one is no person's


class FrameArray:
    """An array whose first axis is the run's frames, read when indexed by rows; `at` takes a frame's number."""

    def __init__(self, run: Run, key: str):
        self._run, self._key = run, key

    @property
    def shape(self) -> tuple[int, ...]:
        return self._run.array(self._key).shape

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: int | np.integer | slice | Iterable[int]) -> np.ndarray:
        """One row, or those of a slice, of a list of rows or of a mask (T,) such as `run.done == 1`. IndexError: neither, or out of range."""
        if isinstance(rows, slice):
            rows = range(*rows.indices(len(self)))
            if len(rows) == len(self):
                try:
                    return self._run.checked(self._key, self._run.read(self._key))
                except UserError:
                    pass  # row by row, the error names the frame
        asked = self._asked(rows)
        if asked.ndim == 0:
            return self._row(int(asked))
        found = [self._row(row) for row in asked.tolist()]
        return np.stack(found) if found else np.zeros((0, *self.shape[1:]), self._run.array(self._key).dtype)

    def _asked(self, rows: Any) -> np.ndarray:
        """Rows as whole numbers, () or (k,)."""
        asked = np.asarray(rows if np.isscalar(rows) or isinstance(rows, np.ndarray) else list(rows))
        if asked.dtype == bool and asked.shape == (len(self),):
            return np.flatnonzero(asked)
        if isinstance(rows, tuple) or asked.ndim > 1 or not (asked.dtype.kind in "iu" or asked.size == 0):
            raise IndexError(f"{self._key}: expected rows of frames or a mask of {len(self)} of them")
        return asked

    def at(self, frame: int) -> np.ndarray:
        """The values of the frame of this number."""
        return self[self._run.row(frame)]

    def _row(self, row: int) -> np.ndarray:
        return self._run.checked(self._key, self._run.read(self._key, row)[None], [row])[0]


class RegisteredSurface:
    """A surface in one topology: `vertices` (T,n,3) float64 [m] and `confidence` (T,n) uint8, read a frame at a time."""

    def __init__(self, run: Run, place: str, name: str):
        self._run, self._place, self.name = run, place, name
        self.vertices, self.confidence = FrameArray(run, f"{place}/vertices"), run.confidence[name]

    @cached_property
    def faces(self) -> np.ndarray:
        """(m,3) int32."""
        return self._run.read(f"{self._place}/faces")

    def at(self, frame: int) -> np.ndarray:
        """Vertices (n,3) [m] of the frame of this number."""
        return self.vertices.at(frame)


class RegisteredGarment(RegisteredSurface):
    """A garment: `label` is its id, `loops` {name: vertex indices in a cycle} its openings."""

    def __init__(self, run: Run, garment: StoredGarment):
        super().__init__(run, f"garment/{garment.name}", garment.name)
        self.label = garment.label
        self.loops = {name: np.array(loop, np.int64) for name, loop in garment.loops.items()}

    @cached_property
    def uv(self) -> np.ndarray:
        """(t,2) float64, v up."""
        return self._run.read(f"{self._place}/uv")

    @cached_property
    def face_uv(self) -> np.ndarray:
        """(m,3) int32 into uv."""
        return self._run.read(f"{self._place}/face_uv")

    @cached_property
    def skin(self) -> np.ndarray:
        """(g,K) float64 skinning weights; rows sum to 1."""
        return self._run.read(f"{self._place}/skin")


class Pose:
    """`rotations` (T,K,3) about world axes relative to the parent [rad], `translation` (T,3) of the root [m]."""

    def __init__(self, run: Run):
        self.rotations, self.translation = FrameArray(run, "pose/rotations"), FrameArray(run, "pose/translation")

    def at(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (K,3) and translation (3,) of the frame of this number."""
        return self.rotations.at(frame), self.translation.at(frame)


class Diagnostics(Mapping[str, dict[str, np.ndarray]]):
    """What the stages measured of themselves: {stage: {name: (T,) float64, NaN where a frame has none}}."""

    def __init__(self, run: Run):
        self._run = run

    @cached_property
    def _names(self) -> dict[str, list[str]]:
        if DIAGNOSTICS not in self._run.group:
            return {}
        return {stage: sorted(group.array_keys()) for stage, group in sorted(self._run.group[DIAGNOSTICS].groups())}

    def __getitem__(self, stage: str) -> dict[str, np.ndarray]:
        return {name: self._run.read(f"{DIAGNOSTICS}/{stage}/{name}") for name in self._names[stage]}

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def at(self, frame: int) -> dict[str, Any]:
        """{stage: {name: number}} of one frame as it was done, {"reason": why} of one that failed; {} before."""
        return read_diagnostics(self._run.path, frame)


class Run:
    """A run opened for reading. Nothing of a frame is read before it is asked for; `done` is as it was when first read.

    `frames` (T,) int64 numbers; `done` (T,) uint8; `verdict` (T,) uint8 or None; `track`, `inner` (None without garments)
    and `garments` {name: RegisteredGarment} inner to outer; `pose`; `face` (T,q,3) or None; `labels` (T,n) or None;
    `confidence` {"track", "inner", garment: (T,n)}; `diagnostics`; `scene`; `body_model`; `capture`; `holdout`, first and
    last number of the frames that no other one's results have read, or (). A *row* is the place of a frame along the first axis. UserError: one line that names the run and what is missing or broken.
    """

    def __init__(self, path: Path, group: Any, attributes: Attributes):
        self.path, self.group = path, group
        self.scene, self.joint_names = attributes.scene, tuple(attributes.joint_names)
        self.body_model_name, self.holdout = attributes.body_model, attributes.holdout
        names = [g.name for g in self.scene.garments]
        self.confidence = {name: FrameArray(self, f"confidence/{name}") for name in self._layers(names)}
        self.pose, self.diagnostics, self.status = Pose(self), Diagnostics(self), Status.of(path)
        self.track = RegisteredSurface(self, "track", "track")
        self.inner = RegisteredSurface(self, "inner", "inner") if names else None
        self.garments = {g.name: RegisteredGarment(self, g) for g in self.scene.garments}

    def __reduce__(self) -> tuple[Any, ...]:
        return open_run, (self.path,)  # another process opens its own

    @staticmethod
    def _layers(names: list[str]) -> list[str]:
        return ["track", "inner", *names] if names else ["track"]

    def array(self, key: str) -> Any:
        """The zarr array of this key, unread."""
        try:
            found = self.group[key]
            shape, chunk = found.shape, int(np.prod(found.chunks)) * found.dtype.itemsize
        except KeyError:
            raise UserError(f"{self.path / STORE}: {key} is missing") from None
        except Exception as error:  # zarr raises whatever a damaged file leads it to
            raise UserError(f"{self.path / STORE}: {key}: cannot be read: {first_line(error)}") from None
        if chunk > LARGEST or not shape:
            raise UserError(f"{self.path / STORE}: {key}: a chunk of shape {found.chunks}, refused")
        return found

    def read(self, key: str, row: int | None = None) -> np.ndarray:
        """All of an array, or one row of it."""
        array = self.array(key)
        try:
            return array[:] if row is None else array[row]
        except Exception as error:  # codecs raise as they like
            where = key if row is None else f"{key}: frame {self.frames[row]}"
            raise UserError(f"{self.path / STORE}: {where}: cannot be read: {first_line(error)}") from None

    def damaged(self, frames: Iterable[int]) -> dict[int, str]:
        """{frame: what is wrong} of those of the registered frames of which an array is missing or is not what was written."""
        found = {}
        keys = [key for key, stored in self._arrays() if stored.per_frame and key in self.group]
        for row in self.rows(frames).tolist():
            try:
                for key in keys:
                    self._check_chunk(key, row)
            except UserError as error:
                found[int(self.frames[row])] = str(error)
        return found

    def _arrays(self) -> Iterable[tuple[str, Stored]]:
        layout = layout_of([garment.name for garment in self.scene.garments], "face" in self.group)
        return ((key, stored) for key, (stored, _) in layout.items())

    def _check_chunk(self, key: str, row: int) -> None:
        """UserError: a row cannot be read, or it was never written: of integers a missing chunk reads as zeros."""
        self.checked(key, self.read(key, row)[None], [row])
        array = self.array(key)
        if self.resumable and array.dtype.kind != "f":  # older stores left zeros out
            if not file_of(self.path / STORE, key, array, row).exists():
                raise UserError(f"{self.path / STORE}: {key}: frame {self.frames[row]}: its chunk is missing")

    def checked(self, key: str, values: np.ndarray, rows: Sequence[int] | slice = slice(None)) -> np.ndarray:
        """The values (r, ...) of rows, unless one of a registered frame is NaN throughout: its chunk was lost."""
        if values.dtype.kind == "f" and values.size and key != "face":
            lost = np.isnan(values.reshape(len(values), -1)).all(1) & (self.done[rows] == OK)
            if lost.any():
                number = self.frames[rows][int(lost.argmax())]
                raise UserError(f"{self.path / STORE}: {key}: frame {number}: its chunk is missing")
        return values

    def framed_bytes(self) -> int:
        """Bytes on the disk of the arrays that have a row a frame."""
        framed = layout_of([*self.garments], "face" in self.group)
        return sum(self.array(key).nbytes_stored() for key, (stored, _) in framed.items() if stored.per_frame)

    @property
    def resumable(self) -> bool:
        """Does it say what its frames were made of? Stores of older versions do not."""
        return IDENTITY in self.group

    # Frames -----------------------------------------------------------------------------------------------------------

    @cached_property
    def frames(self) -> np.ndarray:
        return self.read("frames")

    @cached_property
    def done(self) -> np.ndarray:
        return FrameArray(self, "done")[:]

    @cached_property
    def verdict(self) -> np.ndarray | None:
        return FrameArray(self, VERDICT)[:] if VERDICT in self.group else None

    @cached_property
    def identity(self) -> np.ndarray | None:
        """(T,) uint64: what each frame was made of; None where `resumable` is not."""
        return FrameArray(self, IDENTITY)[:] if self.resumable else None

    @cached_property
    def _row(self) -> dict[int, int]:
        return {int(number): row for row, number in enumerate(self.frames)}

    def row(self, frame: int) -> int:
        """The row of the frame of this number."""
        if frame not in self._row:
            raise UserError(f"{self.path}: frame {frame} is not in the run")
        return self._row[frame]

    def rows(self, frames: Iterable[int] | None = None) -> np.ndarray:
        """Rows of the registered frames, of those among the numbers `frames` if given."""
        good = np.flatnonzero(self.done == OK)
        return good if frames is None else good[np.isin(self.frames[good], list(frames))]

    @property
    def ok(self) -> list[int]:
        """Numbers of the registered frames, in the run's order."""
        return self.frames[self.rows()].tolist()

    @property
    def judgement(self) -> str:
        """In words, how many of the registered frames are judged wrong or doubtful; "" where none is, or the run is older than verdicts."""
        levels = [] if self.verdict is None else self.verdict[self.rows()].tolist()
        counts = [(levels.count(WRONG), "wrong"), (levels.count(DOUBTFUL), "doubtful")]
        told = " and ".join(f"{count} {level}" for count, level in counts if count)
        return told and f"{self.path}: of {len(levels)} frames {told}: see toile report {self.path}"

    @cached_property
    def pictured(self) -> list[int]:
        """Numbers of the registered frames that have pictures."""
        return [number for number in self.ok if self.capture.pictured(number)]

    # Layers and what they hang on -------------------------------------------------------------------------------------

    @property
    def body(self) -> RegisteredSurface:
        """The inner surface; the tracked one of a run without garments."""
        return self.inner or self.track

    @cached_property
    def face(self) -> FrameArray | None:
        return FrameArray(self, "face") if "face" in self.group else None

    @cached_property
    def labels(self) -> FrameArray | None:
        return FrameArray(self, "labels") if self.garments else None

    @cached_property
    def shape(self) -> np.ndarray:
        """Coefficients (S,) of the person's shape."""
        return self.read("shape")

    @cached_property
    def body_model(self) -> BodyModel:
        """The BodyModel that the run was registered with, whose arrays fit the run's."""
        model = body_model_of(self.path, self.body_model_name, self.scene.up)
        n, K = self.track.vertices.shape[1], self.pose.rotations.shape[1]
        if (len(model.v_template), len(model.parents)) != (n, K):
            raise UserError(f"{self.path / STORE}: pose and vertices do not fit the body model {self.body_model_name}")
        return model

    @cached_property
    def rest_joints(self) -> np.ndarray:
        """Rest joints (K,3) of the person [m]."""
        return self.body_model.rest(self.shape)[1]

    @cached_property
    def config(self) -> dict[str, Any]:
        """What the run was asked for."""
        return read_config(self.path)

    @cached_property
    def capture(self) -> Capture:
        """The Capture that the run was made of, with the scans that the run made."""
        return replace(open_capture(capture_folder(self.path)), made=scans_folder(self.path))

    def changed(self, frame: int) -> bool:
        """Whether the capture's files of a frame are no more those that were registered; False where that was not noted."""
        path = note_of(self._reader, frame)
        files = read_json(path, dict).get("files", {}) if path.exists() else {}
        return bool(files) and differ(self.capture.root, self.capture.inputs(frame), files)

    @property
    def outdated(self) -> str:
        """In words, what the capture holds beside its frames, such as "cameras.cam00", and is no more what was registered; "" where
        nothing is, or that was not noted."""
        path = scene_note_of(self._reader)
        then = read_json(path, dict).get("facts", {}) if path.exists() else {}
        names = list(changed_facts(facts_of(self.capture), then)) if then else []
        more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
        told = f"{', '.join(names[:NAMED])}{more}: no more as {self.path} was registered with"
        return f"{self.capture.root}: {told}" if names else ""

    @property
    def _reader(self) -> Path:
        """The run that read the capture: this one, or the one that it was aligned from."""
        return Path(self.config["align"]["run"]) if "align" in self.config else self.path


def open_run(path: Path | str) -> Run:
    """Opens the run of a folder made by `toile register` or `toile align`, for reading."""
    import zarr

    path = Path(path)
    if not is_run(path):
        there = f"no {STORE}; is it a run of `toile register`?" if path.is_dir() else "no such folder"
        raise UserError(f"{path}: {there}")
    store = path / STORE
    check_file(store / "zarr.json")
    try:
        group = zarr.open_group(str(store), mode="r")
        attributes = Attributes(**group.attrs.asdict())
    except ValidationError as error:
        raise first_error(store, error) from None
    except Exception as error:  # zarr raises whatever a damaged file leads it to
        raise UserError(f"{store}: cannot be read: {first_line(error)}") from None
    if attributes.version not in (1, VERSION):
        raise UserError(f"{store}: version {attributes.version} of the layout, expected {VERSION} or 1")
    return Run(path, group, attributes)


def file_of(store: Path, key: str, array: Any, row: int) -> Path:
    """The file of an array that a row lies in."""
    rows = (array.shards or array.chunks)[0]
    return store / key / array.metadata.encode_chunk_key((row // rows, *(0,) * (array.ndim - 1)))


def is_run(path: Path | str) -> bool:
    """Does the folder hold a registered store?"""
    return (Path(path) / STORE).exists()
