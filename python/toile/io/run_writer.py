"""Fills RUN/registered.zarr, laid out as `layout` says. A killed process leaves a store that another one goes on with:
the store appears whole under its name, and of a frame the arrays are written first, `done` last.

A file holds a group of frames, a zarr shard, and is replaced as a whole: `groups` says which frames share one, and those
are written by one process, best in one go, see `together`."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..scene import BodyModel, Dressed, GarmentTemplate, Inner, Person, Scene, Segmented, Tracked
from .files import copy_folder, replace_file
from .holdout import Span
from .layout import (
    DIAGNOSTICS,
    FAILED,
    GOOD,
    IDENTITY,
    OK,
    PENDING,
    STORE,
    VERDICT,
    VERSION,
    WRONG,
    Attributes,
    StoredGarment,
    StoredScene,
    layout_of,
)
from .run import Run, file_of

GROUP = 50  # frames of a file
FILE = 2**26  # bytes of a file before compression, where a frame has no more

KEPT = ("done", VERDICT, IDENTITY)  # rows that a failed frame has


class RunWriter:
    """The store of the run in a folder, opened for writing. Processes may write at once, each groups of its own."""

    def __init__(self, store: Path):
        import zarr

        self.store, self.group = store, zarr.open_group(str(store), mode="r+")
        self._row = {int(number): row for row, number in enumerate(self.group["frames"][:])}
        self._kept: dict[str, dict[int, Any]] | None = None

    @staticmethod
    def of(run: Path) -> RunWriter:
        """The writer of a run's folder."""
        return RunWriter(run / STORE)

    @staticmethod
    def create(
        run: Path,
        frames: Sequence[int],
        scene: Scene,
        model: BodyModel,
        person: Person,
        templates: Sequence[GarmentTemplate] = (),
        identity: str = "",
        holdout: Span = (),
    ) -> RunWriter:
        """Makes RUN/registered.zarr over `frames`, all pending; `templates` inner to outer. `identity`: what these are of.
        `holdout`: the frames that nothing which others are made from reads."""
        import zarr
        from zarr.codecs import ZstdCodec

        names = [t.name for t in templates]
        values = _fixed_values(frames, model, person, templates)
        sizes = {"T": len(frames), "n": len(model.v_template), "K": len(model.parents)}
        sizes["q"] = len(model.face_names)
        part = run / f".{STORE}.part"
        if part.exists():
            shutil.rmtree(part)
        group = zarr.open_group(str(part), mode="w", zarr_format=3)
        group.attrs.update(_attributes(scene, model, templates, identity, holdout).model_dump())
        vertices = {t.name: len(t.rest) for t in templates}
        layout = layout_of(names, scene.face_keypoints)
        largest = 8 * 3 * max(sizes["n"], *vertices.values(), 1)  # bytes of a frame's largest array
        rows = min(max(FILE // largest, 1), GROUP)
        for key, (stored, garment) in layout.items():
            if not stored.per_frame:
                data = np.ascontiguousarray(values[key], stored.dtype)
                group.create_array(key, data=data, chunks=tuple(max(size, 1) for size in data.shape))
                continue
            axes = sizes | ({"g": vertices[garment]} if garment else {})
            shape = tuple(int(axes.get(axis, axis)) for axis in stored.axes.split())
            frame = tuple(max(size, 1) for size in shape[1:])
            group.create_array(
                key,
                shape=shape,
                chunks=(1, *frame),
                shards=(rows, *frame),
                dtype=stored.dtype,
                fill_value=np.nan if np.dtype(stored.dtype).kind == "f" else 0,
                compressors=[ZstdCodec(checksum=True)],  # a chunk that is cut or changed cannot be read
            )
        os.replace(part, run / STORE)
        return RunWriter.of(run)

    def pending(self, frames: Iterable[int]) -> tuple[int, ...]:
        """Those of the frames that are neither ok nor failed."""
        done = self.group["done"][:]
        return tuple(number for number in frames if number not in self._row or done[self._row[number]] == PENDING)

    def made_of(self, identities: Callable[[int], int]) -> frozenset[int]:
        """The frames that are ok or failed, and made of what `identities(frame)` says."""
        if IDENTITY not in self.group:
            return frozenset()
        done, found = self.group["done"][:], self.group[IDENTITY][:]
        behind = (number for number, row in self._row.items() if done[row] != PENDING)
        return frozenset(number for number in behind if int(found[self._row[number]]) == identities(number))

    def groups(self, frames: Iterable[int]) -> list[tuple[int, ...]]:
        """The frames, those together that lie in the same files."""
        found: dict[int, list[int]] = {}
        for frame in frames:
            found.setdefault(self._row[frame] // _rows(self.group["done"]), []).append(frame)
        return [tuple(group) for group in found.values()]

    @contextmanager
    def together(self) -> Iterator[None]:
        """What is written inside is kept until the end, however that comes, and then each file is written once."""
        self._kept = {}
        try:
            yield
        finally:
            kept, self._kept = self._kept, None
            self._let_go(sorted(kept.get("done", ())))
            for key in sorted(kept, key=lambda key: key == "done"):  # `done` is the last
                for rows in _runs(sorted(kept[key])):
                    self._array(key)[rows[0] : rows[-1] + 1] = np.stack([kept[key][row] for row in rows])

    def write(
        self,
        frame: int,
        tracked: Tracked,
        segmented: Segmented | None = None,
        dressed: dict[str, Dressed] | None = None,
        layer: Inner | None = None,
        verdict: int = GOOD,
        identity: int = 0,
    ) -> None:
        """A registered frame, made of what `identity` says; `segmented`, `dressed` and `layer` where the scene names a garment."""
        values = {
            "track/vertices": tracked.vertices,
            "pose/rotations": tracked.rotations,
            "pose/translation": tracked.translation,
            "confidence/track": tracked.confidence,
        }
        if "face" in self.group:
            values["face"] = tracked.face
        if segmented is not None and dressed is not None and layer is not None:
            values |= {
                "labels": segmented.vertices,
                "inner/vertices": layer.vertices,
                "confidence/inner": layer.confidence,
            }
            for name, vertices in layer.garments.items():
                values |= {f"garment/{name}/vertices": vertices, f"confidence/{name}": dressed[name].confidence}
        self._replace(frame, values, OK, verdict, identity)

    def fail(self, frame: int, identity: int = 0) -> None:
        """Records a frame as failed; what it had before goes."""
        had = int(self.group["done"][self._row[frame]]) != PENDING
        arrays = {key: self.group[key] for key in self._framed() if had and key not in KEPT}
        self._replace(frame, {k: a.fill_value for k, a in arrays.items()}, FAILED, WRONG, identity)

    def copy(self, frame: int, other: RunWriter) -> None:
        """A frame that another store of the same layout has."""
        row = other._row[frame]
        values = {key: other.group[key][row] for key in other._framed()}
        done, verdict, identity = (int(values.pop(key)) for key in ("done", VERDICT, IDENTITY))
        self._replace(frame, values if done == OK else {}, done, verdict, identity)

    def _framed(self) -> list[str]:
        """The arrays that have a row a frame."""
        names = [garment["name"] for garment in self.group.attrs["scene"]["garments"]]
        return [key for key, (stored, _) in layout_of(names, "face" in self.group).items() if stored.per_frame]

    def _replace(self, frame: int, values: dict[str, Any], done: int, verdict: int, identity: int) -> None:
        """Nobody takes a frame for whole while its arrays change."""
        self._put("done", frame, PENDING)
        for key, value in values.items():
            self._put(key, frame, value)
        self._judge(frame, verdict)
        if IDENTITY in self.group:
            self._put(
                IDENTITY, frame, np.uint64(identity)
            )  # Python's, larger and smaller ones stacked, would be rounded
        self._put("done", frame, done)

    def _let_go(self, rows: Sequence[int]) -> None:
        """Rows that other values are about to replace become pending: a process that is killed leaves none half old."""
        if rows and (self.group["done"][rows[0] : rows[-1] + 1] != PENDING).any():
            for run in _runs(rows):
                self._array("done")[run[0] : run[-1] + 1] = PENDING

    def _judge(self, frame: int, verdict: int) -> None:
        if VERDICT in self.group:  # not in a store of an older version that is gone on with
            self._put(VERDICT, frame, verdict)

    def _put(self, key: str, frame: int, value: Any) -> None:
        if self._kept is None:
            self._array(key)[self._row[frame]] = value
        else:
            self._kept.setdefault(key, {})[self._row[frame]] = value

    def _array(self, key: str) -> Any:
        """The array, which keeps chunks of nothing but the fill value too: one that is not there is damage."""
        return self.group[key].with_config({"write_empty_chunks": True})

    def write_garment(self, frame: int, name: str, vertices: np.ndarray, confidence: np.ndarray) -> None:
        """Another surface (g,3) [m] and confidence (g,) uint8 of a garment in a frame that is ok."""
        self._put(f"garment/{name}/vertices", frame, vertices)
        self._put(f"confidence/{name}", frame, confidence)

    def write_diagnostics(self, table: dict[int, dict[str, dict[str, float]]]) -> None:
        """`diagnostics/STAGE/NAME (T,)` from {frame: {stage: {name: number}}}, NaN where a frame has none; once all frames
        are done. `whole` tells whether this has been."""
        names = sorted(
            {(stage, name) for stages in table.values() for stage, values in stages.items() for name in values}
        )
        group = self.group.create_group(DIAGNOSTICS, overwrite=True)
        for stage, name in names:
            column = [table.get(frame, {}).get(stage, {}).get(name, np.nan) for frame in self._row]
            group.create_array(f"{stage}/{name}", data=np.array(column, np.float64))
        group.attrs["whole"] = True

    def begin(self) -> None:
        """The store is no longer whole."""
        if DIAGNOSTICS in self.group:
            self.group[DIAGNOSTICS].attrs["whole"] = False

    def reopen(self, frames: Iterable[int]) -> None:
        """These frames become pending, and the store is no longer whole."""
        frames = list(frames)
        if frames:
            self.begin()
        with self.together():
            for frame in frames:
                self._put("done", frame, PENDING)
        self._drop_unreadable({self._row[frame] for frame in frames})

    def _drop_unreadable(self, pending: set[int]) -> None:
        """Removes files of these frames of which no frame can be read: zarr writes to none whose index it cannot read."""
        for key, array in self.group.members(max_depth=None):
            if getattr(array, "shards", None) is None or key == "done":
                continue
            for group in {row // _rows(array) for row in pending}:
                rows = range(group * _rows(array), min((group + 1) * _rows(array), array.shape[0]))
                if not any(_readable(array, row) for row in rows):
                    file_of(self.store, key, array, rows[0]).unlink(missing_ok=True)

    @property
    def identity(self) -> str:
        """What the arrays that all frames share were made of."""
        return str(self.group.attrs.get("identity", ""))

    @property
    def whole(self) -> bool:
        return DIAGNOSTICS in self.group and bool(self.group[DIAGNOSTICS].attrs.get("whole"))


def copy_store(run: Run, folder: Path, change: Callable[[RunWriter], None]) -> None:
    """Copies a run's store into another folder, where it appears once `change(writer)` has been made."""

    def write(path: Path) -> None:
        if path.exists():
            shutil.rmtree(path)
        copy_folder(run.path / STORE, path)
        change(RunWriter(path))

    for left in folder.glob(f".{STORE}.*.part"):
        shutil.rmtree(left)
    replace_file(folder / STORE, write)


def _rows(array: Any) -> int:
    """Frames of one file."""
    return int((array.shards or array.chunks)[0])


def _readable(array: Any, row: int) -> bool:
    try:
        array[row]
    except Exception:  # codecs raise as they like
        return False
    return True


def _runs(rows: Sequence[int]) -> list[list[int]]:
    """The rows, in order, cut where one does not follow the other."""
    cuts = [0, *(i + 1 for i, (a, b) in enumerate(pairwise(rows)) if b != a + 1), len(rows)]
    return [list(rows[a:b]) for a, b in pairwise(cuts)]


def _fixed_values(
    frames: Sequence[int], model: BodyModel, person: Person, templates: Sequence[GarmentTemplate]
) -> dict[str, Any]:
    values: dict[str, Any] = {"frames": frames, "shape": person.shape, "track/faces": model.f, "inner/faces": model.f}
    for t in templates:
        for name in ("faces", "uv", "face_uv", "skin"):
            values[f"garment/{t.name}/{name}"] = getattr(t, name)
    return values


def _attributes(
    scene: Scene, model: BodyModel, templates: Sequence[GarmentTemplate], identity: str, holdout: Span
) -> Attributes:
    garments = []
    for t in templates:
        loops = {name: [int(v) for v in loop] for name, loop in zip(t.loop_names, t.loops)}
        garments.append(StoredGarment(name=t.name, label=t.label, loops=loops))
    known = StoredScene(name=scene.name, fps=scene.fps, up=scene.up, labels=scene.labels, garments=garments)
    joints = list(model.joint_names)
    made = Attributes(version=VERSION, scene=known, joint_names=joints, body_model=scene.body_model)
    return made.model_copy(update={"identity": identity, "holdout": holdout})
