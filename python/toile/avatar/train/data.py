"""What an avatar is trained on: (frame, camera) samples of a registered run and its pictures, prepared once into a cache."""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.numpy import load_file, save
from torch.utils.data import Dataset

from ...errors import UserError
from ...frame_numbers import evenly
from ...io.bounded import reason_of
from ...io.files import replace_file, write_text
from ...io.holdout import kept_apart
from ...io.inputs import files_under, stamps
from ...io.layout import OK
from ...io.registration import registration
from ...io.run import Run, open_run
from ...kernels import vertex_normals
from ...measure.empty_masks import misses_body
from ...surface.layers import read_layers, registered_surface, surface_layer
from ...surface.uv import UvMap
from ...vision.unwrapping import Unwrapper, crop_about, filled, mean_texture, pinhole, undistorted, undistorted_crop
from ..model.checkpoint import topology
from ..model.light import SIZE, TERMS, explained, fit_light, irradiance, irradiance_basis
from ..model.networks import resize
from ..model.poses import usual_distance

HEAD_REACH = 0.12  # the head lies this near to its facial keypoints [m]
THREADS = min(8, os.cpu_count() or 1)  # frames prepared at a time
LIT, TELLING = 64, 2000  # frames, and texels of a layer, that tell of the light: about so many at most
VERSION = 4  # of the cache's files
REGISTERED = ("rotations", "translation", "face", "face_seen", "vertices", "confidence")  # a frame file's plain tensors


def shown(run, settings, row):
    """Vertices (n,3) of a row of a Run that crops are about: of its head, its garments or all; the same for the baseline's
    single layer."""
    garments = list(run.garments.values())
    if settings.crop == "head":
        head = run.body_model.face_vertices(HEAD_REACH)
        if not len(head):
            raise UserError('crop = "head": the body model names no facial keypoints')
        return run.track.vertices[row][head]
    surfaces = garments if garments and settings.crop == "garment" else [run.track, *garments]
    return np.concatenate([surface.vertices[row] for surface in surfaces])


def registration_of(run, frames):
    """`registration` of what an avatar is taught: the tracked surface and all garments."""
    return registration(run, frames, [run.track, *run.garments.values()])


def check_registration(run, folder, facts):
    """UserError where a Run is not as AVATAR `folder` of these facts was taught; an avatar of an older toile does not know."""
    known, frames = facts.get("registration"), facts["frames"]
    if known and (len(run.rows(frames)) < len(frames) or registration_of(run, frames) != known):
        raise UserError(f"{run.path}: its registration is not the one that {folder} was trained on")


class AvatarData(Dataset):
    """Samples (frame, camera) of `frames` of a run, cameras running fastest; nothing of other frames is read.

    `settings`: DataSettings. `folder`: where the cache goes, a folder a setting of it; at 512 texels and a crop of 320 x
    320 px it takes about 1 MB a sample. Frames are prepared on threads, each file is written whole, and a preparation that
    was cut goes on. `known`: the frames whose cache it is, by default `frames`, which are some of them. `layered=False`: the tracked surface alone, for the baseline.
    `left_out`: frames that the training holds out, beside the run's own; no other frame's window reads them. `progress(done, total)`.

    A sample is a dict of float32 tensors, unless said, that torch's default collation stacks:
      frame, camera int64; rotations (K,3), translation (3,), face (q,3) with 0 where unseen, face_seen (q,)
      vertices.LAYER (n,3) registered, posed [m]; confidence.LAYER (n,) 0..1
      texture.LAYER (3,T,T) 0..1 from this view, texel_weight.LAYER (1,T,T)
      mean_texture.LAYER (3,T,T), mean_weight.LAYER (1,T,T) over this frame's views
      image (3,H,W) 0..1, mask (H,W), labels (H,W) int64, K (3,3), T_camera_world (4,4) of the undistorted crop
      window.rotations (L,K,3), window.face (L,q,3), window.face_seen (L,q) with settings.window

    Cameras without a picture of a frame give no sample of it, nor do those of `faulty`. UserError: no frame has pictures; a picture has neither mask nor labels;
    topologies and UVs that do not fit.
    """

    def __init__(self, run, settings, folder, frames=None, layered=True, progress=None, known=None, left_out=()):
        run = run if isinstance(run, Run) else open_run(run)
        self.run, self.capture, self.settings, self.left_out = run, run.capture, settings, left_out
        self.scene, self.J, self.parents = self.capture.scene, run.rest_joints, run.body_model.parents
        named = list(run.garments)
        if named != [g.name for g in self.scene.garments]:
            raise UserError(f"{run.path}: registered garments {named}, {self.capture.root}/scene.toml names others")
        pictured = run.pictured
        self.frames = pictured if frames is None else sorted(set(pictured) & set(frames))
        if not self.frames:
            raise UserError(
                f"{run.path}: none of the frames asked for is registered and has pictures in {self.capture.root}"
            )
        shapes = run, self.frames, settings.modes
        self.layers = read_layers(*shapes) if layered else [surface_layer(*shapes)]
        self.cameras = [pinhole(c, settings.pixel_scale) for c in self.capture.cameras.values()]
        names = list(self.capture.cameras)
        self.samples = [(n, names.index(name)) for n in self.frames for name in self.capture.pictured(n)]
        self._check_outlines()
        self.known = self.frames if known is None else list(known)
        self.folder = Path(folder) / self._key(layered)
        self._prepare(progress or (lambda done, total: None))
        told = {n: self._whole(n).read_text(encoding="utf-8").split("\n") for n in self.frames}
        self.faulty = [(n, c) for n, c in self.samples if names[c] in told[n]]  # see `_outlining`
        self.samples = [(n, c) for n, c in self.samples if names[c] not in told[n]]
        self._summarise()

    def __len__(self):
        return len(self.samples)

    def rows_of(self, number):
        """Samples of a frame, one a picture."""
        return [i for i, (frame, _) in enumerate(self.samples) if frame == number]

    def __getitem__(self, i):
        number, camera = self.samples[i]
        out = {"frame": torch.tensor(number), "camera": torch.tensor(camera)}
        file = _load(self._path(number))
        out |= {name: torch.from_numpy(file[name]) for name in file if name.split(".")[0] in REGISTERED}
        out |= self.pose_window(number)
        for name in self.names:
            out[f"mean_texture.{name}"], out[f"mean_weight.{name}"] = self._maps(file, name, "mean_")
        file = _load(self._path(number, camera))
        for name in self.names:
            out[f"texture.{name}"], out[f"texel_weight.{name}"] = self._maps(file, name)
        out["image"] = torch.from_numpy(file["image"]).permute(2, 0, 1).float() / 255
        out["mask"], out["labels"] = torch.from_numpy(file["mask"]).float(), torch.from_numpy(file["labels"]).long()
        out["K"], out["T_camera_world"] = torch.from_numpy(file["K"]), torch.from_numpy(file["T_camera_world"])
        return out

    @property
    def warnings(self):
        """What a user should know of the pictures."""
        if not self.faulty:
            return []
        counts = Counter(self.cameras[c].name for _, c in self.faulty)
        each = ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
        told = f"masks are empty in {len(self.faulty)} pictures that the registered body lies in"
        return [f"{self.capture.root}: {told}, these are left out: {each}"]

    @property
    def names(self):
        """Of the layers."""
        return [layer.name for layer in self.layers]

    def _key(self, layered):
        """The cache's folder: what its files depend on. Of the pictures these are names, sizes and times."""
        settings = self.settings.model_dump(mode="json", exclude={"geometry_size", "window", "modes", "light"})
        fitting = topology(self.layers, self.scene, self.cameras)
        parts = [VERSION, layered, settings, str(self.run.path.resolve()), fitting]
        digest = hashlib.sha256(json.dumps(parts).encode())
        for camera in self.capture.cameras.values():
            for value in (camera.size, camera.K, camera.distortion, camera.T_camera_world):
                digest.update(np.asarray(value, np.float64).tobytes())
        digest.update(self.pictures.encode())
        for number in self.known:
            for values in self._registered(number).values():
                digest.update(values.tobytes())
        return digest.hexdigest()[:16]

    @cached_property
    def pictures(self):
        """A digest of names, sizes and times of the files that the samples are made of."""
        root = self.capture.root
        folders = [root / "frames" / f"{n:06d}" / kind for n in self.known for kind in ("images", "masks", "labels")]
        found = stamps(root, [path for folder in folders for path in files_under(folder)])
        return hashlib.sha256(json.dumps(found).encode()).hexdigest()

    @cached_property
    def unlabelled(self):
        """The id of a person's pixels in pictures without labels: none of the scene's, 0 where it has all."""
        return np.uint8(next((i for i in range(1, 256) if i not in self.scene.labels.values()), 0))

    def _path(self, number, camera=None):
        name = "frame" if camera is None else f"camera.{self.cameras[camera].name}"
        return self.folder / f"{number:06d}" / f"{name}.safetensors"

    def _whole(self, number):
        """Is there once a frame is prepared, and names the cameras whose pictures are left out, one a line."""
        return self.folder / f"{number:06d}" / "whole"

    @cached_property
    def poses(self):
        """rotations (F,K,3) and translation (F,3) of the frames; usual: their `usual_distance`, neighbours nearer than a second."""
        rows = [self.run.row(n) for n in self.frames]
        rotations, translation = self.run.pose.rotations[rows], self.run.pose.translation[rows]
        usual = usual_distance(rotations, np.array(self.frames), self.scene.fps)
        return {"rotations": rotations, "translation": translation, "usual": usual}

    def pose_window(self, number):
        """Poses and faces of the last `settings.window` registered frames up to `number`, pictured or not; {} without."""
        if not self.settings.window:
            return {}
        rotations, face, first = self._tracked
        at = self.run.row(number)
        rows = np.maximum(np.arange(at + 1 - self.settings.window, at + 1), first[at])
        values = {
            "rotations": rotations[rows],
            "face": np.nan_to_num(face[rows]),
            "face_seen": np.isfinite(face[rows]).all(-1),
        }
        return {f"window.{name}": torch.from_numpy(value.astype(np.float32)) for name, value in values.items()}

    @cached_property
    def _tracked(self):
        """Rotations and faces of all rows of the run, and where each row's stretch of neighbouring frames begins."""
        rotations = self.run.pose.rotations[:]
        face = np.zeros((len(rotations), 0, 3)) if self.run.face is None else self.run.face[:]
        steps, good = np.diff(self.run.frames), self.run.done == OK
        usual = np.bincount(steps).argmax() if len(steps) else 1
        held_out = np.isin(self.run.frames, kept_apart(self.run.holdout, self.left_out))
        begins = np.r_[True, (steps != usual) | ~good[:-1] | (held_out[:-1] & ~held_out[1:])]
        return rotations, face, np.maximum.accumulate(np.where(begins, np.arange(len(begins)), 0))

    def _check_outlines(self):
        """UserError: of a picture neither a mask nor a label image tells where the person is."""
        for number in self.frames:
            outlined = {*self.capture.masked(number), *self.capture.labelled(number)}
            for name, path in self.capture.picture_files(number, "images").items():
                if name not in outlined:
                    raise UserError(
                        f"{path}: neither a mask nor a label image tells where the person is: `toile detect` makes masks"
                    )

    # Preparation -----------------------------------------------------------------------------------------------------

    def _prepare(self, progress):
        left = [n for n in self.frames if not self._whole(n).exists()]
        if not left:
            return
        maps = [UvMap(layer, self.settings.texture_size) for layer in self.layers]
        garments = [layer.label for layer in self.layers if layer.kind == "garment"]
        with ThreadPoolExecutor(THREADS) as pool:  # each frame has files of its own
            for k, _ in enumerate(pool.map(lambda n: self._prepare_frame(n, Unwrapper(maps, garments)), left)):
                progress(len(self.frames) - len(left) + k + 1, len(self.frames))

    def _prepare_frame(self, number, unwrapper):
        frame = self.capture.pictures(number)
        values, shown = self._registered(number), self._shown(number)
        confidence = [values[f"confidence.{name}"] for name in self.names]
        unwrapper.frame([values[f"vertices.{name}"].astype(np.float64) for name in self.names], confidence)
        cameras = [self.samples[i][1] for i in self.rows_of(number)]
        masks = self._outlining(number, frame, cameras)
        seen = [self._prepare_view(number, c, frame, mask, unwrapper, shown) for c, mask in masks.items()]
        for name, views in zip(self.names, zip(*seen)):
            values |= self._packed(name, mean_texture(views, self.settings.texture_size), "mean_")
            values[f"confidence.{name}"] = values[f"confidence.{name}"].astype(np.float32) / 2
        _save(self._path(number), values)
        left_out = [self.cameras[c].name for c in cameras if c not in masks]
        write_text(self._whole(number), "\n".join(left_out))

    def _outlining(self, number, frame, numbers):
        """{camera: mask (H,W) of the person} of a frame's pictures by these cameras, but for those that miss the body; where most do, it may not be
        there, and all are kept."""
        cameras, V, masks = list(self.capture.cameras.values()), self.run.track.at(number), {}
        for c in numbers:
            name = cameras[c].name
            masks[c] = frame.silhouette(name)
        kept = {c: mask for c, mask in masks.items() if not misses_body(mask, cameras[c], V)}
        return kept if 2 * len(kept) >= len(masks) else masks

    def _prepare_view(self, number, c, frame, mask, unwrapper, shown):
        """Writes one view; returns its Unwrapped layers."""
        name, camera = list(self.capture.cameras.items())[c]
        labels = frame.labels.get(name)
        flat = None if labels is None else undistorted(camera, labels, True)
        whole = undistorted(camera, frame.images[name]), undistorted(camera, mask.astype(np.uint8), True) > 0
        unwrapped = unwrapper.view(pinhole(camera), *whole, flat)
        crop = crop_about(camera, shown, self.settings.image, self.settings.pixel_scale)
        picture = undistorted_crop(camera, frame.images[name], mask, labels, self.settings.pixel_scale, crop)
        values = {
            "image": picture.image, "mask": picture.mask,
            "labels": picture.mask * self.unlabelled if picture.labels is None else picture.labels,
            "K": picture.camera.K.astype(np.float32), "T_camera_world": picture.camera.T_camera_world.astype(np.float32),
        }  # fmt: skip
        for layer, texels in zip(self.names, unwrapped):
            values |= self._packed(layer, texels)
        _save(self._path(number, c), values)
        return unwrapped

    def _shown(self, number):
        return shown(self.run, self.settings, self.run.row(number))

    def _registered(self, number):
        """Pose, face, vertices and confidence of a frame as the run has them."""
        rotations, translation = self.run.pose.at(number)
        values = {"rotations": rotations.astype(np.float32), "translation": translation.astype(np.float32)}
        face = np.zeros((0, 3)) if self.run.face is None else self.run.face.at(number)
        values["face"] = np.nan_to_num(face).astype(np.float32)
        values["face_seen"] = np.isfinite(face).all(-1).astype(np.float32)
        for layer in self.layers:
            surface = registered_surface(self.run, layer)
            values[f"vertices.{layer.name}"] = surface.at(number).astype(np.float32)
            values[f"confidence.{layer.name}"] = surface.confidence.at(number)
        return values

    def _packed(self, name, unwrapped, prefix=""):
        """Bits of the texels that were seen, their colours by channel and their weights (in 256ths)."""
        bits = np.zeros(self.settings.texture_size**2, bool)
        bits[unwrapped.texels] = True
        return {
            f"{prefix}texels.{name}": np.packbits(bits),
            f"{prefix}colours.{name}": np.ascontiguousarray(unwrapped.colours.T),
            f"{prefix}weights.{name}": np.clip(np.ceil(256 * unwrapped.weights), 1, 65535).astype(np.uint16),
        }

    def _maps(self, file, name, prefix=""):
        """Texture (3,T,T) in 0..1 and weight (1,T,T) of a cache file's arrays."""
        size = self.settings.texture_size
        seen = np.flatnonzero(np.unpackbits(file[f"{prefix}texels.{name}"], count=size * size))
        maps = np.zeros((4, size * size), np.float32)
        for channel, values in zip(maps, file[f"{prefix}colours.{name}"]):
            channel[seen] = values * np.float32(1 / 255)
        maps[3, seen] = file[f"{prefix}weights.{name}"] * np.float32(1 / 256)
        maps = torch.from_numpy(maps).unflatten(1, (size, size))
        return maps[:3], maps[3:]

    # Means over the frames -------------------------------------------------------------------------------------------

    def _summarise(self):
        """mean_texture {layer: (3,T,T)} in 0..1, unseen texels filled; valid {layer: (T,T)}, seen in some view; texture_std,
        of seen texels about their mean; face_mean (q,3) in the head joint's frame."""
        size = self.settings.texture_size
        total = {layer.name: np.zeros((4, size, size)) for layer in self.layers}
        squared, faces = 0.0, []
        for number in self.frames:
            file = _load(self._path(number))
            faces.append(np.where(file["face_seen"][:, None] > 0, file["face"], np.nan))
            for name in self.names:
                texture, weight = (x.numpy() for x in self._maps(file, name, "mean_"))
                total[name] += np.concatenate([texture * weight, weight])
                squared += float((weight * texture**2).sum(dtype=np.float64))
        self.mean_texture, self.valid, explained = {}, {}, 0.0
        for name, sums in total.items():
            mean = sums[:3] / np.maximum(sums[3], 1e-9)
            self.valid[name] = sums[3] > 0
            explained += float((sums[3] * mean**2).sum())
            self.mean_texture[name] = (
                filled(mean.transpose(1, 2, 0), self.valid[name]).transpose(2, 0, 1).astype(np.float32)
            )
        weights = sum(float(sums[3].sum()) for sums in total.values())
        self.texture_std = float(np.sqrt(max(squared - explained, 0) / max(3 * weights, 1e-9)))
        self.face_mean, self.head = self._face(np.array(faces))

    @property
    def light(self):
        """(8,3) of `model.light`; None where it is not to be told from what it falls on."""
        return self._lit[0] if self.settings.light else None

    @property
    def mean_light(self):
        """{layer: (3,s,s)} of `model.light`, None without."""
        return self._lit[1] if self.settings.light else None

    @property
    def light_explains(self):
        """`explained` of the frames by their light, which is none where this is not positive; None without."""
        return self._lit[2] if self.settings.light else None

    @cached_property
    def _lit(self):
        size, known = min(self.settings.texture_size, SIZE), evenly(self.frames, LIT)
        files, turned, observed = [_load(self._path(number)) for number in known], {}, []
        for layer in self.layers:
            texels = UvMap(layer, size)
            normals = [vertex_normals(f[f"vertices.{layer.name}"].astype(np.float64), layer.faces) for f in files]
            Y = np.stack([texels.texels(irradiance_basis(n))[texels.valid] for n in normals])
            colours, seen = (
                np.stack(x) for x in zip(*(self._coarse(f, layer.name, size, texels.valid) for f in files))
            )
            some = slice(None, None, max(colours.shape[1] // TELLING, 1))
            turned[layer.name] = texels.valid, Y, seen
            observed.append((colours[:, some], seen[:, some], Y[:, some]))
        share = explained(observed)
        light = fit_light(observed) if share > 0 else np.zeros((TERMS, 3))
        return light.astype(np.float32), {name: _mean_light(*of, light) for name, of in turned.items()}, share

    def _coarse(self, file, name, size, valid):
        """Colours (P,3) of the `valid` texels of a frame's mean texture at another size, and whether each was seen (P,)."""
        texture, weight = self._maps(file, name, "mean_")
        known = (weight > 0).float()
        share = resize(known[None], size)[0, 0]
        colours = resize((texture * known)[None], size)[0] / share.clamp(min=1e-6)
        return colours.numpy()[:, valid].T.astype(np.float64), share.numpy()[valid] > 0.5

    def _face(self, faces):
        """Mean facial keypoints, and the head joint's index; (None, None) where none shall drive, the scene has no face, or none was seen."""
        head = self.run.body_model.joint("head")
        seen = np.isfinite(faces).all(-1).any(0) if faces.size else np.zeros(0, bool)
        if not (self.settings.face and self.scene.face_keypoints and seen.any()) or head is None:
            return None, None
        mean = np.zeros(faces.shape[1:])
        mean[seen] = np.nanmean(faces[:, seen], axis=0)
        return mean, head


def _mean_light(valid, basis, seen, light):
    """(3,s,s): E' of texels over the frames that saw them, or over all where none did; 1 where no texel is `valid`."""
    E = irradiance(basis, light)
    weight = np.where(seen.any(0), seen, True)[..., None]
    mean = np.ones((*valid.shape, 3), np.float32)
    mean[valid] = (E * weight).sum(0) / weight.sum(0)
    return mean.transpose(2, 0, 1)


def _load(path):
    try:
        return load_file(path)
    except (SafetensorError, OSError) as error:
        raise UserError(
            f"{path}: cannot be read: {reason_of(error)}; without the folder {path.parent} it is prepared anew"
        ) from None


def _save(path, values):
    whole = save({name: np.ascontiguousarray(value) for name, value in values.items()})
    replace_file(path, lambda part: part.write_bytes(whole))
