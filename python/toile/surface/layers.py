"""The surfaces of a registered run, unposed: the body and each garment, or the tracked surface as one."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..io.body import load_body_model
from ..io.capture import open_capture
from ..io.run import OK
from ..scene import blended_transforms
from .sampling import evenly

BLEND = 8  # joints that move one vertex of a garment, at most


SHAPES = 512  # frames, evenly spread, that principal modes are taken of


@dataclass(frozen=True)
class Layer:
    """One surface of the avatar; UVs have a topology of their own, v up."""

    name: str  # "body", a garment's name, or "surface", the baseline's only layer
    kind: str  # "body", "garment" or "surface"
    rest: np.ndarray  # (n,3) mean unposed shape [m]
    faces: np.ndarray  # (m,3)
    uv: np.ndarray  # (t,2)
    face_uv: np.ndarray  # (m,3) into uv
    skin_idx: np.ndarray  # (n,B) joints
    skin_val: np.ndarray  # (n,B) rows sum to 1
    label: int  # id in the scene's label table; -1 for body and surface
    loops: dict[str, np.ndarray] = field(default_factory=dict)  # a garment's open loops as vertex cycles
    modes: np.ndarray | None = None  # (M,n,3) principal modes of the unposed shape, of one standard deviation each [m]


@dataclass(frozen=True)
class RunBody:
    """A registered run as the avatar reads it: its store, the body model, and the person's rest joints J (K,3)."""

    path: Path
    store: object  # zarr group
    model: object  # scene.BodyModel
    J: np.ndarray

    def rows(self, frames=None):
        """Rows of the store of the registered frames, of those in `frames` if given."""
        good = np.flatnonzero(self.store["done"][:] == OK)
        return good if frames is None else good[np.isin(self.store["frames"][:][good], list(frames))]

    def unposed(self, name, skin_idx, skin_val, row):
        """The vertices `name` of a row of the store, unposed (n,3)."""
        pose = self.store["pose/rotations"][row], self.store["pose/translation"][row]
        A, b = blended_transforms(self.J, *self.model.joint_transforms(self.J, *pose), skin_idx, skin_val)
        return np.linalg.solve(A, (self.store[name][row] - b)[..., None])[..., 0]

    def shapes(self, name, skin_idx, skin_val, frames, modes):
        """Over frames, of the vertices `name`, unposed: the mean (n,3) and at most `modes` principal modes (M,n,3)."""
        total, kept, rows = 0.0, [], self.rows(frames)
        if len(rows) == 0:
            raise UserError(f"{self.path}: none of the frames asked for is registered")
        spread = set(evenly(range(len(rows)), SHAPES)) if modes else ()
        for i, row in enumerate(rows):
            shape = self.unposed(name, skin_idx, skin_val, row)
            total = total + shape
            if i in spread:
                kept.append(shape.astype(np.float32))
        mean = total / len(rows)
        return mean, principal_modes(np.array(kept) - mean, modes) if modes else None


def open_body(run):
    """The RunBody of a folder made by `toile register`."""
    import zarr

    run = Path(run)
    if not (run / "registered.zarr").exists():
        raise UserError(f"{run}: no registered.zarr; is it a run of `toile register`?")
    store = zarr.open_group(str(run / "registered.zarr"), mode="r")
    name = store.attrs["body_model"]
    model = body_model_of(run, name, store.attrs["scene"]["up"])
    if model.uv is None:
        raise UserError(f"{name}: uv: the body model has none, an avatar needs them")
    for array in ("track/vertices", "pose/rotations", "pose/translation", "confidence/track", "track/faces", "shape"):
        _need(run, store, array)
    if (
        len(model.parents) != store["pose/rotations"].shape[1]
        or len(model.v_template) != store["track/vertices"].shape[1]
    ):
        raise UserError(f"{run}/registered.zarr: pose and vertices do not fit the body model {name}")
    return RunBody(run, store, model, model.rest(store["shape"][:])[1])


def body_model_of(run, name, up):
    """The body model of this name: a packaged one, or a .npz inside the capture that the run was made of."""
    return load_body_model(capture_folder(run) / name if name.endswith(".npz") else name, up=up)


def capture_folder(run):
    """The folder of the capture that a run was made of."""
    path = Path(run) / "config.toml"
    try:
        return Path(tomllib.loads(path.read_text(encoding="utf-8"))["capture"])
    except (OSError, KeyError, tomllib.TOMLDecodeError) as error:
        raise UserError(f"{path}: {error}") from None


def _need(run, store, name):
    if name not in store:
        raise UserError(f"{run}/registered.zarr: {name} is missing")
    return store[name]


def principal_modes(displacements, count):
    """At most `count` modes (M,n,3) of displacements (F,n,3) from their mean: orthogonal, strongest first, each as long as its
    standard deviation over the frames, positive in the frame that shows most of it. Modes of less than a ten-thousandth of
    the first's variance are left out."""
    flat = displacements.reshape(len(displacements), -1).astype(np.float64)
    variance, U = np.linalg.eigh(flat @ flat.T / len(flat))  # of frames by frames: the vertices are many more
    variance, U = variance[::-1][:count], U[:, ::-1][:, :count]
    U = U[:, variance > max(1e-4 * variance[0], 1e-12)]
    U = U * np.sign(U[np.abs(U).argmax(0), np.arange(U.shape[1])])  # an eigenvector's sign is nobody's choice
    return (U.T @ flat / len(flat) ** 0.5).reshape(-1, *displacements.shape[1:]).astype(np.float32)


def read_layers(run, frames=None, modes=0):
    """The layers of a run, inner to outer: the body, then each garment. `rest` is the mean over `frames` (all registered
    ones by default), and garments get `modes` principal modes. A run without garments has its tracked surface as the body."""
    body = open_body(run)
    inner = "inner/vertices" if "inner" in body.store else "track/vertices"
    garments = [_garment_layer(body, g, frames, modes) for g in body.store.attrs["scene"]["garments"]]
    return [_body_layer(body, "body", "body", inner, frames, 0), *garments]


def surface_layer(run, frames=None, modes=0):
    """The tracked, clothed surface as one layer: the baseline's."""
    return _body_layer(open_body(run), "surface", "surface", "track/vertices", frames, modes)


def _body_layer(body, name, kind, vertices, frames, modes):
    model, place = body.model, vertices.split("/")[0]
    skin = model.weights_idx, model.weights_val
    _need(body.path, body.store, f"confidence/{place}")
    if not np.array_equal(_need(body.path, body.store, f"{place}/faces")[:], model.f):
        raise UserError(f"{body.path}/registered.zarr: {place}/faces: not those of the body model")
    rest, found = body.shapes(vertices, *skin, frames, modes)
    return Layer(name, kind, rest, model.f, model.uv, model.f_uv, *skin, label=-1, modes=found)


def _garment_layer(body, garment, frames, modes):
    at = f"garment/{garment['name']}"
    names = "skin", "faces", "uv", "face_uv", "vertices"
    weights, faces, uv, face_uv, vertices = (_need(body.path, body.store, f"{at}/{name}") for name in names)
    n, sure = vertices.shape[1], _need(body.path, body.store, f"confidence/{garment['name']}")
    weights, faces, uv, face_uv = weights[:], faces[:], uv[:], face_uv[:]
    fits = len(weights) == n == sure.shape[1] and faces.shape == face_uv.shape and weights.shape[1] == len(body.J)
    if not fits or faces.min() < 0 or faces.max() >= n or face_uv.min() < 0 or face_uv.max() >= len(uv):
        raise UserError(f"{body.path}/registered.zarr: {at}: faces, UVs, skin and vertices do not fit one another")
    if not (np.isfinite(uv).all() and uv.min() >= 0 and uv.max() <= 1):
        raise UserError(f"{body.path}/registered.zarr: {at}/uv leaves the unit square")
    idx = np.argsort(-weights, axis=1, kind="stable")[:, :BLEND].astype(np.int32)
    val = np.take_along_axis(weights, idx.astype(np.int64), 1).astype(np.float64)
    val /= val.sum(1, keepdims=True)
    rest, found = body.shapes(f"{at}/vertices", idx, val, frames, modes)
    loops = {name: np.array(loop, np.int64) for name, loop in garment["loops"].items()}
    return Layer(garment["name"], "garment", rest, faces, uv, face_uv, idx, val, garment["label"], loops, found)


def capture_of(run):
    """The Capture that a run was made of."""
    return open_capture(capture_folder(run))


def pictured_frames(run):
    """Numbers of the registered frames that have pictures, in order."""
    body, capture = open_body(run), capture_of(run)
    numbers = [int(n) for n in body.store["frames"][:][body.rows()]]
    return [n for n in numbers if any((capture.root / "frames" / f"{n:06d}" / "images").glob("*"))]
