"""Motions that drive an avatar: a registered run, a BVH file, or an `.npz` without pickles, toile's own or of the SMPL family."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import RoomError, UserError
from ..kernels.arrays import Anything
from ..scene import BodyModel
from .between_frames import ROUNDED, BetweenFrames
from .bounded import read_npz
from .bvh import read_bvh
from .memory import free_memory
from .retargeting import facing, floor_path, matches, retarget, stance_of_model, standing, starts_at
from .run import is_run, open_run
from .smpl_motion import (
    FIELDS,
    figure_of,
    followed,
    is_smpl,
    not_followed,
    retarget_with_fingers,
    smpl_motion,
    with_smpl_roles,
)
from .strays import strays

OWN = ("rotations", "translation", "face", "fps", "frames", "up")  # fields of toile's own .npz
MAX_FRAMES = 1_000_000
ROOM = 1024  # bytes of memory that driving an avatar takes a joint and frame
FARTHEST = 1e4  # [m] from the origin: beyond, single precision places a person by millimetres
LARGEST_TURN = 1e3  # [rad] of the root's rotation vector, which may count its turns
LARGEST_BEND = 2 * np.pi  # [rad] of any other joint's
HEAD = 1.0  # [m] from the head joint: no face lies farther


@dataclass(frozen=True)
class Motion:
    """Poses of a body model in a row, `fps` a second; `frames` numbers them.

    `missing` names joints that the source lacks and that rest, `notes` says what else of the source is to be known. `strays` {bone of the source: degrees (T,)}: the body lies so far
    otherwise than the source leads it, see `strays`.
    """

    frames: np.ndarray  # (T,) int
    rotations: np.ndarray  # (T,K,3) rotation vectors about world axes, relative to the parent [rad]
    translation: np.ndarray  # (T,3) [m]
    face: np.ndarray | None  # (T,q,3) facial keypoints in the head joint's frame [m], NaN where unseen
    fps: float
    missing: tuple[str, ...] = ()
    strays: dict[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.frames)

    def rows_of(self, frames: Iterable[int] | None) -> list[int]:
        """Rows of these frame numbers, all for None. UserError: the motion has none of them."""
        if frames is None:
            return list(range(len(self)))
        rows = np.flatnonzero(np.isin(self.frames, list(frames))).tolist()
        if not rows:
            there = f"{self.frames[0]} to {self.frames[-1]}"
            raise UserError(f"--frames: the motion has frames {there}, none of those asked for")
        return rows

    def unfollowed(self, rows: list[int]) -> list[str]:
        """What a user should know of joints that do not follow the source in these rows."""
        said = [f"the motion lacks {', '.join(self.missing)}: they rest"] if self.missing else []
        said += self.notes
        for bone, off in self.strays.items():
            worst = rows[int(off[rows].argmax())]
            if off[worst] > 0:
                frame = self.frames[worst]
                said.append(
                    f"{bone} lies up to {off[worst]:.0f} degrees off where the motion leads it, most in frame {frame}"
                )
        return said


def read_motion(
    path: Path | str, model: BodyModel, J: Anything, fps: float, translation: Anything, up: str = "z"
) -> Motion:
    """A Motion for a BodyModel with rest joints `J` (K,3), its up the axis `up` ("x", "y", "z"), at `fps`.

    `path`: a run (its registered frames, as they are numbered), a .bvh file (retargeted by joint names, played at `fps`,
    started facing as the model does at rest with the root's translation `translation` (3,) [m]), or a .npz
    `{rotations (T,K,3), translation (T,3), face (T,q,3)?, fps, frames (T,)?, up?}` (in the model's axes; frames counted
    from 0, as far apart as `frames` numbers them), or a .npz of the SMPL family (`poses`, `trans`, `mocap_framerate`), which is
    retargeted as a .bvh file is. Instants of `fps` between two of a file's frames are turned and moved between
    these. UserError names the file and the field.
    """
    path = Path(path)
    if is_run(path):
        return _of_run(path, model.joint_names, up)
    fields = _fields(path)
    if _of_a_body(fields):
        return _of_npz(path, fields, len(J), fps, up)
    return _retargeted(path, fields, model, J, fps, translation, up, None)


def retargeted_motion(
    path: Path | str,
    model: BodyModel,
    J: Anything,
    fps: float,
    translation: Anything,
    up: str = "z",
    lowest: float | None = None,
) -> Motion:
    """`read_motion` of a .bvh file or a .npz of the SMPL family alone, upper arms lifted to hang at most `lowest` [rad] below their
    rest. UserError, too: the file holds poses of a body model."""
    path = Path(path)
    fields = {"rotations": None} if is_run(path) else _fields(path)
    if _of_a_body(fields):
        words = "holds poses of a body model, which are not retargeted: toile export writes those of a run as a .bvh"
        raise UserError(f"{path}: {words}")
    return _retargeted(path, fields, model, J, fps, translation, up, lowest)


def _fields(path):
    """Those of a .npz that are read, None of a .bvh. UserError: it is neither."""
    if not path.exists():
        raise UserError(f"{path}: no such file or folder")
    if not path.is_file() or path.suffix.lower() not in (".bvh", ".npz"):
        raise UserError(f"{path}: neither a run, nor a .bvh or .npz file")
    return None if path.suffix.lower() == ".bvh" else read_npz(path, names=(*OWN, *FIELDS))


def _of_a_body(fields):
    """Whether the fields of a .npz are toile's own: poses of a body model."""
    return fields is not None and ("rotations" in fields or not is_smpl(fields))


def _retargeted(path, fields, model, J, fps, translation, up, lowest):
    asked = model, J, fps, translation, up, lowest
    return _sane(path, _of_bvh(path, *asked) if fields is None else _of_smpl(path, fields, *asked))


def _sane(path, motion, places="translation", turned="rotations"):
    """The Motion. UserError: it has places or turns, which the file calls so, or a face, that are no person's."""
    turns, face = np.linalg.norm(motion.rotations, axis=2), np.zeros((len(motion), 0, 3))
    if motion.face is not None:
        face = np.where(np.isnan(motion.face), 0, np.abs(motion.face))  # NaN: unseen
    for name, values, largest, unit in (
        (places, np.abs(motion.translation).max(1), FARTHEST, "m"),
        (turned, turns[:, 0], LARGEST_TURN, "rad"),
        (turned, turns[:, 1:].max(1, initial=0), LARGEST_BEND, "rad (are they in degrees?)"),
        ("face", face.max((1, 2), initial=0), HEAD, "m from the head joint"),
    ):
        if (values > largest).any():
            row = int(values.argmax())
            words = f"{values[row]:.3g} {unit} in frame {motion.frames[row]}, expected at most {largest:g}"
            raise UserError(f"{path}: {name}: {words}")
    return motion


def _of_run(path, joint_names, up):
    run = open_run(path)
    check_up(path, run.scene.up, up)
    rows, rotations = run.rows(), run.pose.rotations
    if rotations.shape[1:] != (len(joint_names), 3):
        raise UserError(f"{path}: the run's poses have {rotations.shape[1]} joints, the avatar has {len(joint_names)}")
    for k, (theirs, ours) in enumerate(zip(run.joint_names, joint_names)):
        if theirs != ours:
            raise UserError(
                f"{path}: joint {k} of the run is {theirs}, of the avatar {ours}: they are of different body models"
            )
    if not len(rows):
        raise UserError(f"{path}: no frame is registered")
    face = None if run.face is None else run.face[rows]
    return Motion(run.frames[rows], rotations[rows], run.pose.translation[rows], face, run.scene.fps)


def _of_bvh(path, model, J, fps, translation, up, lowest):
    figure = read_bvh(path)
    found, missing = matches(figure)
    if "root" not in found:
        raise UserError(f"{path}: no joint named like Hips")
    by = partial(retarget, lowest=lowest)
    motion = _followed(path, standing(path, figure, found), found, by, model, J, fps, translation, up)
    return replace(motion, missing=tuple(missing))


def _of_smpl(path, fields, model, J, fps, translation, up, lowest):
    given, model = smpl_motion(path, fields), with_smpl_roles(model)
    asked = Motion(np.arange(len(given.trans)), given.rotations, given.trans, None, given.fps)
    _sane(path, asked, "trans", "poses")
    _instants(path, len(asked), given.fps, fps, len(J))  # refused before the figure takes memory
    figure, said = figure_of(path, given, model, J @ stance_of_model(model, J, up))
    found, missing = followed(figure, model)
    by = partial(retarget_with_fingers, lowest=lowest)
    motion = _followed(path, figure, found, by, model, J, fps, translation, up)
    return replace(motion, missing=missing, notes=(*said, *not_followed(given, figure, found, model)))


def _followed(path, figure, found, by, model, J, fps, translation, up):
    """The Motion of a body that follows a figure, `found` {role: its joint}, `by` one of the retargetings."""
    from scipy.spatial.transform import Rotation

    start = starts_at(figure)
    count = len(figure) - start
    at = BetweenFrames.of(_instants(path, count, 1 / figure.frame_time, fps, len(J)), np.arange(count))
    S = stance_of_model(model, J, up)
    poses = lambda pick: by(facing(figure, pick, found), figure, model, J @ S, found)
    moves = lambda pick: translation + floor_path(figure, pick, model, J @ S, found) @ S.T
    vectors = lambda R: Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(*R.shape[:3]) @ S.T
    below, above = at.below + start, at.above + start
    R = poses(below)
    apart = strays(figure, below, found, model, J @ S, R)
    rotations, shifts = vectors(R), moves(below)
    if at.share.any():
        rotations, shifts = at.turned(rotations, vectors(poses(above))), at.moved(shifts, moves(above))
    return Motion(np.arange(len(below)), rotations, shifts, None, fps, strays=apart)


def check_up(path, found, up):
    """UserError: the motion at `path` is about axes of which another is up."""
    if found != up:
        raise UserError(f"{path}: up is {found} there, {up} in the avatar's scene: its turns are about other axes")


def _of_npz(path, fields, joints, fps, up):
    if "rotations" not in fields:
        raise UserError(f"{path}: rotations is missing, and so is poses, as of AMASS")
    for name in ("translation", "fps"):
        if name not in fields:
            raise UserError(f"{path}: {name} is missing")
    T = len(np.atleast_1d(fields["translation"]))
    shapes = {"rotations": (T, joints, 3), "translation": (T, 3), "fps": ()}
    if "face" in fields:
        shapes["face"] = (T, fields["face"].shape[1] if fields["face"].ndim == 3 else -1, 3)
    for name, shape in shapes.items():
        value = fields[name]
        if value.shape != shape or value.dtype.kind not in "fiu":
            raise UserError(f"{path}: {name} is {value.dtype} {value.shape}, expected numbers {shape}")
        if name != "face" and not np.isfinite(value).all():
            raise UserError(f"{path}: {name} is not finite")
    own = float(fields["fps"])
    if not 0 < own <= 10_000 or not 0 < T <= MAX_FRAMES:
        raise UserError(f"{path}: {T} frames at fps {own:g}")
    if "up" in fields:
        check_up(path, str(fields["up"]), up)
    numbers = _numbers(path, fields.get("frames", np.arange(T)), T)
    at = BetweenFrames.of(_instants(path, numbers[-1] + 1, own, fps, joints), numbers)
    given = {name: fields[name].astype(np.float64) for name in shapes if name != "fps"}
    as_given = Motion(numbers, given["rotations"], given["translation"], given.get("face"), own)
    _sane(path, as_given)  # turns between them hide too large ones
    about = {name: (values[at.below], values[at.above]) for name, values in given.items()}
    face = at.moved(*about["face"]) if "face" in about else None
    frames = np.arange(len(at.below))
    return Motion(frames, at.turned(*about["rotations"]), at.moved(*about["translation"]), face, fps)


def _numbers(path, frames, T):
    """(T,) numbers of a .npz's frames, from 0 on."""
    if frames.shape != (T,) or frames.dtype.kind not in "iu" or (np.diff(frames.astype(np.int64)) < 1).any():
        raise UserError(f"{path}: frames is {frames.dtype} {frames.shape}, expected ({T},) rising whole numbers")
    return frames.astype(np.int64) - frames[0].astype(np.int64)


def _instants(path, count, own, fps, joints):
    """Instants 0, 1/fps, 2/fps, ... of `count` frames at `own` a second, in frames. UserError: these are too many, in themselves or for
    the memory that is free."""
    last = int((count - 1) * fps / own + ROUNDED)
    words = f"{path}: {count} frames at {own:g} a second are {last + 1:.3g} at {fps:g}"
    if last >= MAX_FRAMES:
        raise UserError(f"{words}, expected at most {MAX_FRAMES}")
    free, needed = free_memory(), (last + 1) * joints * ROOM
    if free is not None and needed > free:
        raise RoomError(f"{words}: they take {needed / 2**30:.0f} GiB of memory, {free / 2**30:.0f} are free")
    return np.minimum(np.arange(last + 1) * own / fps, count - 1)
