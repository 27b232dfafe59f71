"""An avatar driven by a motion: poses to layers, garments out of the body, shadows from what moves, pictures and a film."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ...frame_numbers import frame_ranges, rate_of
from ...io.animation import (
    AnimatedLayer,
    AnimatedSkeleton,
    layer_file,
    mesh_file,
    picture_file,
    skeleton_file,
    texture_file,
)
from ...io.files import save_record, whole_folder, write_text
from ...io.image import read_image, write_image
from ...io.mesh import write_mesh
from ...io.motion import Motion
from ...io.run_folder import body_model_of
from ...io.video import VideoWriter
from ...pipeline.workers import Workers, check_workers, everywhere
from ...scene import Mesh
from ..model.assets import training_poses
from ..model.checkpoint import load_avatar, read_facts
from ..model.poses import joints_apart, leaning, leans, nearest_poses
from ..model.recorded import decoder, repeatable
from .apart import check_face, motion_of, take
from .cameras import asked_cameras, camera_path
from .draping import Draping, doubts, outdated, relieved, worn_cloths
from .driver import FILE, hardly_foretold, load_driver, make_track, one_thread, reader_of, stride_at
from .layering import GarmentLayering
from .lending import lend

FAR = 1.5  # a pose this many times farther from the training poses than they are from one another is warned of
BACKGROUND = 1.0


@dataclass(frozen=True)
class Animation:
    """What was made."""

    frames: int
    intersections_before: int  # triangle pairs of garments and what lies under them, as decoded
    intersections_left: int
    warnings: tuple[str, ...]
    limbs: dict | None = None  # see `Apart.facts`; None where they go as given
    hung: tuple[str, ...] = ()  # garments that hung as cloth
    dent: float = 0.0  # [m] by which skin gave way at most to cloth that had no room


class DrivenAvatar:
    """A trained avatar and the codes of its garments for every frame of a motion."""

    def __init__(self, folder, motion, device=None, seed=0, physics=False, garments=(), apart=False, frames=None):
        """`motion`: a Motion, or the path of one. `physics`: which garments hang as cloth, see `worn_cloths`. `garments` {name: folder of
        the avatar whose garment it wears}. `apart`: as `take` takes it. `frames`: numbers of those that are shown, all by default; of
        others nothing is warned."""
        self.folder, self.facts = Path(folder), read_facts(folder)
        self.device = device or torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.avatar = load_avatar(folder)
        scene = self.avatar.scene
        self.model = body_model_of(self.facts["run"], scene.body_model, scene.up)
        poses = training_poses(folder)
        self.motion = motion if isinstance(motion, Motion) else take(folder, motion, apart).motion
        check_face(self.avatar, self.motion, "the motion")
        self.rows = self.motion.rows_of(frames)
        self.lent = lend(self.avatar, dict(garments), folder, self.model.skin_faces)
        self.measured = {}
        self.latents = self._latents(seed)
        absent = sorted(set(frames or ()) - set(self.motion.frames.tolist()))
        self.warnings = [*lacking(absent, self.motion), *self._warnings(poses), *hardly_foretold(self.measured)]
        self.avatar.to(self.device)
        self.decoded = decoder(self.avatar)
        self.layering = GarmentLayering(self.avatar, self.model.skin_faces)
        self.dent = 0.0  # [m] by which skin gave way to cloth at most, in what was decoded so far
        cloths = self._cloths(physics)
        self.warnings += doubts(cloths) + outdated(self.folder, self.avatar.layers, physics)
        self.draping = self.draped(cloths, np.arange(len(self.motion))) if cloths else None

    def _cloths(self, physics):
        lent = {one.name for one in self.lent}
        cloths = worn_cloths(self.folder, [layer for layer in self.avatar.layers if layer.name not in lent], physics)
        for one in self.lent:
            cloths |= one.cloth(physics)
        return cloths

    def draped(self, cloths, rows):
        """A Draping of these rows of the motion."""
        times, rotations = self.motion.frames[rows] / self.motion.fps, self.motion.rotations[rows]
        readers = dict.fromkeys(cloths, self.avatar) | {one.name: one.lender for one in self.lent}
        frame = lambda k: (self.geometry(rows[k]), self.unseen(rows[k]))
        return Draping(self.avatar, cloths, self.layering, times, rotations, frame, readers)

    def hold(self, motion, seed=0):
        """Takes another motion in place of the one there was."""
        self.motion = motion
        self.latents = self._latents(seed)

    def _latents(self, seed):
        """{layer: (T,Z)} by the temporal models of those that they were taught with."""
        face_mean = getattr(self.avatar, "face_mean", None)
        face_mean = None if face_mean is None else face_mean.cpu()
        return self._own_latents(seed) | {one.name: one.latents(self.motion, face_mean) for one in self.lent}

    def _own_latents(self, seed):
        """{layer: (T,Z)} by the temporal model; of a single-layer baseline without one a draw from the unit Gaussian."""
        count, lent = len(self.motion), {one.name for one in self.lent}
        kinds = {layer.name: layer.kind for layer in self.avatar.layers if layer.name not in lent}
        if "surface" in kinds.values() and not (self.folder / FILE).exists():
            generator = torch.Generator().manual_seed(seed)
            sizes = {name: self.avatar.model(name).code_size for name in kinds}
            return {name: torch.randn(1, n, generator=generator).expand(count, n) for name, n in sizes.items()}
        if set(kinds.values()) == {"body"}:
            return {}
        driver, stride, self.measured = load_driver(self.folder)
        motion = self.motion
        stride = stride_at(motion.fps, stride, self.avatar.scene.fps)
        with torch.no_grad():
            track = make_track(
                reader_of(self.folder, self.avatar), motion.frames, motion.rotations, motion.face, stride, motion.fps
            )
            return driver.latents(track)

    def _warnings(self, poses):
        """What a user should know of this motion: joints it lacks, and how far it leaves the training poses."""
        warnings = self.motion.unfollowed(self.rows)
        warnings += self._far_from(poses, "the training's poses")
        lean = leans(self.motion.rotations[self.rows], poses["rotations"], self.avatar.up.cpu().numpy())
        warnings += leaning(self.motion.frames[self.rows], lean, "the training's poses")
        for one in self.lent:
            taught = f"the poses that {one.name} of {one.folder} was taught with"
            warnings += [*one.warnings, *self._far_from(one.poses, taught)]
        return warnings

    def _far_from(self, poses, whose):
        distance, alone = nearest_poses(self.motion.rotations[self.rows], poses["rotations"])
        frames, warnings = self.motion.frames[self.rows], []
        far = distance > FAR * poses["usual"]
        if far.any():
            worst = int(distance.argmax())
            warnings.append(
                f"{far.sum()} of {len(distance)} poses are far from {whose}: frame {frames[worst]} is "
                f"{distance[worst]:.1f} degrees a joint from the nearest, those are {poses['usual']:.1f} from one another"
            )
        return warnings + joints_apart(frames, alone, self.model.joint_names[1:], whose)

    def batch(self, i, camera, index=-1):
        """Frame i seen by a camera, `index` among the avatar's own, as `Avatar.decode` takes it."""
        motion = self.motion
        points = self.avatar.face_mean.cpu().numpy() if hasattr(self.avatar, "face_mean") else np.zeros((0, 3))
        face = np.full(points.shape, np.nan) if motion.face is None else motion.face[i]
        seen = np.isfinite(face).all(-1)
        values = {
            "rotations": motion.rotations[i], "translation": motion.translation[i],
            "face": np.where(seen[:, None], face, 0), "face_seen": seen,
            "K": camera.K, "T_camera_world": camera.T_camera_world,
        }  # fmt: skip
        batch = {
            name: torch.as_tensor(np.asarray(value, np.float32), device=self.device)[None]
            for name, value in values.items()
        }
        return batch | {"camera": torch.tensor([index], device=self.device)}

    def unseen(self, i):
        """`batch` of frame i where no camera matters."""
        return self.batch(i, self.avatar.cameras[0])

    @torch.no_grad()
    def geometry(self, i):
        """{layer: Decoded} of frame i by its codes, without textures."""
        return self.decoded(self.unseen(i), self._codes(i), texture=False)

    def _codes(self, i):
        return {name: z[i : i + 1].to(self.device) for name, z in self.latents.items()}

    @torch.no_grad()
    def decode(self, i, batch):
        """({layer: Decoded} with garments out of the body and of one another, pairs before, pairs left, share of what hangs that is
        shown as cloth)."""
        decoded, share = self.decoded(batch, self._codes(i)), 1.0
        if self.draping:
            found, share = self.draping.clear(i, decoded, batch)
        else:
            found = self.layering(decoded, batch)
        self.dent = max(self.dent, self.layering.dent(decoded, found[0]))
        return *found, share

    @torch.no_grad()
    def picture(self, decoded, batch, size):
        """(H,W,3) uint8: the layers shaded by one another, before a white wall."""
        with repeatable():
            seen = self.avatar.compose(decoded, batch, size)[0]
        image = seen.image + BACKGROUND * (1 - seen.mask)
        return (image.clamp(0, 1) * 255).round().to(torch.uint8).permute(1, 2, 0).cpu().numpy()


@dataclass(frozen=True)
class Shot:
    """What every frame of an animation is made with: rows of the motion, the camera of each, and where it goes."""

    driven: DrivenAvatar
    rows: list[int]
    path: Callable  # see `camera_path`
    out: Path
    meshes: bool

    @classmethod
    def of(cls, folder, motion, out, frames, camera, height, meshes, seed, physics, garments):
        """UserError: what is asked does not fit the avatar."""
        with one_thread():
            driven = DrivenAvatar(folder, motion, seed=seed, physics=physics, garments=garments, frames=frames)
        return cls(driven, driven.rows, camera_path(driven, camera, height), out, meshes)

    @property
    def size(self):
        """(height, width) of the pictures."""
        return self.path(self.rows[0])[0].size

    def make(self, i):
        """Writes the picture and meshes of one row; yields (row, pairs before, pairs left, share of cloth, its strain so far, how far
        [m] skin gave way so far, whether the camera sees of the person)."""
        with one_thread():
            yield i, *self._make(i)

    def _make(self, i):
        driven, (seen_by, index) = self.driven, self.path(i)
        batch = driven.batch(i, seen_by, index)
        decoded, before, left, share = driven.decode(i, batch)
        number = int(driven.motion.frames[i])
        write_image(picture_file(self.out, number), driven.picture(decoded, batch, seen_by.size))
        for layer in driven.avatar.layers if self.meshes else ():
            V = decoded[layer.name].vertices[0].cpu().numpy()
            write_mesh(mesh_file(self.out, layer.name, number), Mesh(V, layer.faces))
        if self.meshes and i == self.rows[0]:
            write_still(self.out, driven, decoded, self.rows)
        strain = driven.draping.strain if driven.draping else 0.0
        seen = any(seen_by.sees(one.vertices[0].cpu().numpy()).any() for one in decoded.values())
        return int(before), int(left), share, strain, driven.dent, seen


def animate(
    folder,
    motion,
    out,
    frames=None,
    camera=None,
    height=None,
    meshes=True,
    seed=0,
    progress=lambda *_: None,
    workers=1,
    scheduler=None,
    physics=None,
    garments=(),
    apart=True,
):
    """Drives AVATAR `folder` by `motion` (a run, .bvh or .npz) into the new folder `out`, which appears once it is whole:
    pictures/, meshes/LAYER/, animation.mp4 and animation.json. `frames`: numbers of the motion's frames, all by default; the film
    shows them as far apart as their numbers by the motion's rate say.
    `camera`: a name of the avatar's cameras (its first by default), "orbit", or a cameras.json whose cameras are taken in
    turn. `height` [px]. `physics`: which garments hang as cloth, see `worn_cloths`; True after `ensure_worn`. `garments` {name: folder of another avatar}: those
    that it wears of others. `apart`: as `take` takes it. `workers` processes share the frames, or those of a running dask `scheduler`.
    Returns an Animation. UserError: what is asked does not fit the avatar."""
    check_workers(workers, scheduler)
    place, lent = (
        everywhere(Path(folder), scheduler),
        {n: everywhere(Path(p), scheduler) for n, p in dict(garments).items()},
    )
    if camera and Path(camera).is_file():
        camera = str(everywhere(Path(camera), scheduler))
    with whole_folder(out) as out:
        check_asked(folder, motion, frames, camera, height, garments)
        hangs = physics
        if hangs is None:
            hangs = any(worn_cloths(one, load_avatar(one).layers, None) for one in (folder, *dict(garments).values()))
        taken = take(folder, motion, apart, dict(garments), hangs, frames, progress)  # once, for all workers
        arguments = frames, camera, height, meshes, seed, physics, lent
        with Workers(workers, Shot.of, place, taken.motion, out, *arguments, scheduler=scheduler) as pool:
            pool.start()
            shot = pool.prepared()
            driven, rows = shot.driven, shot.rows
            numbers = driven.motion.frames[rows]
            with VideoWriter(out / "animation.mp4", rate_of(numbers, driven.motion.fps)) as film:
                measured = filmed(pool.each(Shot.make, rows), shot, film, progress)
        before, left, shares, strains, dents, seen = zip(*(measured[row] for row in rows))
        before, left = sum(before), sum(left)
        less = {int(driven.motion.frames[row]): share for row, share in zip(rows, shares) if share < 1}
        unseen = [int(driven.motion.frames[row]) for row, one in zip(rows, seen) if not one]
        warnings = (*driven.warnings, *relieved(less, max(strains)), *out_of_sight(unseen, len(rows)))
        limbs = taken.apart and taken.apart.facts(rows)
        hung = tuple(driven.draping.cloths) if driven.draping else ()
        done = Animation(len(rows), before, left, warnings, limbs, hung, max(dents))
        facts = {"avatar": str(Path(folder).resolve()), "motion": str(Path(motion).resolve()), "fps": driven.motion.fps}
        facts["layers"] = [layer.name for layer in driven.avatar.layers] if meshes else []
        worn = {one.name: {"avatar": str(one.folder.resolve()), "strain_p95": one.strain} for one in driven.lent}
        write_text(out / "animation.json", json.dumps(facts | {"garments": worn} | done.__dict__, indent=1))
    return done


def check_asked(folder, motion, frames, camera, height=None, garments=()):
    """What can be refused before any long work. UserError: the motion is none for this avatar, has none of these frames, a garment of
    another avatar cannot be worn, or a camera is asked for that is not there, or whose pictures `height` pixels high cannot be drawn."""
    avatar = load_avatar(folder)
    asked_cameras(avatar.cameras, camera, height)
    motion_of(folder, motion).rows_of(frames)
    if garments:
        model = body_model_of(read_facts(folder)["run"], avatar.scene.body_model, avatar.scene.up)
        lend(avatar, dict(garments), folder, model.skin_faces)


def lacking(absent, motion):
    """What a user should know of frames that were asked for and that the motion has not."""
    if not absent:
        return []
    there = f"frames {motion.frames[0]} to {motion.frames[-1]} at {motion.fps:g} a second"
    return [f"--frames: the motion has {there}, of those asked for not {frame_ranges(absent, most=5)}"]


def out_of_sight(unseen, count):
    """What a user should know of frames whose pictures show nothing of the person."""
    if not unseen:
        return []
    words = f"{len(unseen)} of {count} pictures show nothing of the person, frame {unseen[0]} first"
    return [f"{words}: are the motion's places metres, and near where the cameras stand?"]


def filmed(shots, shot, film, progress):
    """{row: (pairs before, pairs left, share of cloth, strain, dent, seen)} of the rows as they are made; their pictures go to the film in the rows'
    order."""
    waiting, by_row = deque(shot.rows), {}
    for row, *measured in shots:
        by_row[row] = measured
        while waiting and waiting[0] in by_row:
            file = picture_file(shot.out, int(shot.driven.motion.frames[waiting.popleft()]))
            film.add(read_image(file, shot.size, "RGB"))
        progress("animate", len(by_row), len(shot.rows))
    return by_row


def write_still(out, driven, decoded, rows):
    """What of an animation's layers does not move, their textures as `decoded` in one frame, and the skeleton's motion."""
    for layer in driven.avatar.layers:
        parts = layer.faces, layer.uv, layer.face_uv, layer.skin_idx, layer.skin_val
        save_record(layer_file(out, layer.name), AnimatedLayer(*parts))
        texture = decoded[layer.name].mean_texture[0].permute(1, 2, 0)
        pixels = (texture.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()
        write_image(texture_file(out, layer.name), pixels)
    motion, skeleton, model = driven.motion, driven.avatar.skeleton, driven.model
    J, up = skeleton.J.cpu().numpy().astype(np.float64), driven.avatar.scene.up
    moved = motion.frames[rows], motion.rotations[rows], motion.translation[rows], float(motion.fps), up
    save_record(skeleton_file(out), AnimatedSkeleton(model.joint_names, np.asarray(model.parents), J, *moved))
