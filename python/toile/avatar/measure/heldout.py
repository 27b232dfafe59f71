"""The avatars of a folder on held-out frames: what they decode and show there, and what is true there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import default_collate

from ... import kernels
from ...errors import UserError
from ...frame_numbers import evenly, frame_ranges
from ...io.run import is_run, open_run
from ...measure.truth import millimetres, open_truth
from ...scene import HIDDEN
from ..drive.layering import GarmentLayering
from ..model.checkpoint import check_same, load_avatar, read_facts, topology
from ..model.poses import nearest_poses
from ..train.data import AvatarData, check_registration
from .face import Facial
from .photometric import photometric

CROP = (
    "frame",
    "camera",
    "image",
    "mask",
    "labels",
    "K",
    "T_camera_world",
)  # of a sample: both avatars show the same
VIEW = ("camera", "K", "T_camera_world")  # of a sample: what it is seen by
MIXED = 2  # pixels beside the mask that may still show something of the person
SAMPLES = 2  # of a pixel, each way: captured silhouettes are no stairs either
PAPER = 248 / 255  # behind a view that no camera took


@dataclass(frozen=True)
class HeldOutPicture:
    """One camera's picture of a held-out frame; `rendered` and what was captured have values 0..1."""

    frame: int
    camera: str
    captured: np.ndarray  # (H,W,3)
    mask: np.ndarray  # (H,W) bool
    labels: np.ndarray  # (H,W)
    face: np.ndarray  # (H,W) bool
    rendered: dict[str, np.ndarray]  # by avatar (H,W,3), over the picture's background
    loops: dict[str, np.ndarray]  # a garment's open loops in this picture (k,2) [px]
    mm_per_pixel: float  # at the person's distance


def run_of(folder, facts, run=None):
    """Where the run of AVATAR `folder` of these facts is, or is said to be by --run. UserError: it is no more where it was."""
    path = Path(run or facts["run"])
    if run is None and not is_run(path):
        raise UserError(f"{folder}: its run {path} is not there: give its place by --run")
    return path


class HeldOut:
    """AVATAR and, where it is there, AVATAR/baseline, with their data of the chosen frames."""

    def __init__(self, folder, frames=None, run=None):
        facts = read_facts(folder)
        path = run_of(folder, facts, run)
        self.registered = RegisteredRun(path)
        check_registration(self.registered.run, folder, facts)
        self.truth, self.garment_labels = self.registered.truth, self.registered.garment_labels
        self.frames, self.warnings = _chosen(folder, facts, frames, self.registered.run.pictured)
        self.warnings += [f"edited: {words}" for words in facts.get("edits", ())]
        self.trained = sorted(set(facts["frames"]) & set(self.registered.run.frames.tolist()))
        folders = {"layered" if facts["layered"] else "baseline": folder}
        if (folder / "baseline" / "avatar.json").exists():
            folders["baseline"] = folder / "baseline"
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.avatars, self.data, self.folders = {}, {}, folders
        for name, place in folders.items():
            self.avatars[name] = load_avatar(place).to(self.device)
            self.data[name] = self._data(place, name == "layered")
        self.warnings += next(iter(self.data.values())).warnings
        self.shown = {name: name for name in folders}  # what pictures show, and the avatar of each
        self.layering, self.intersections = None, {}  # by frame: pairs of triangles before and after untangling
        self.dent = 0.0  # [m] by which skin gave way at most
        if "layered" in self.avatars:
            faces = self.registered.run.body_model.skin_faces
            self.layering = GarmentLayering(self.avatars["layered"], faces)
        self.decoded = {name: {} for name in folders}  # by what is shown and frame, {layer: (n,3)}; see `_asked_again`
        self._occlusion = {}  # by what is shown, a frame and its ambient occlusion

    def _data(self, folder, layered):
        facts, pictured = read_facts(folder), set(self.registered.run.pictured)
        data = AvatarData(
            self.registered.run,
            facts["settings"].data,
            folder=folder / "evaluation",
            frames=self.frames,
            layered=layered,
            known=sorted({*self.frames, *pictured.intersection(facts["holdout"])}),
            left_out=facts["holdout"],
        )
        check_same(folder, facts["topology"], topology(data.layers, data.scene, data.cameras))
        return data

    @property
    def count(self):
        return len(next(iter(self.data.values())))

    def from_training(self):
        """`nearest_poses` of the frames among those trained on that the run has."""
        poses, rows = self.registered.rotations, self.registered.run.rows
        return nearest_poses(poses[rows(self.frames)], poses[rows(self.trained)])

    def pictures(self):
        """Every held-out picture as both avatars show it."""
        return (self.picture(i) for i in range(self.count))

    def shown_in(self, i):
        """Of `shown`, what the i-th picture shows."""
        return self.shown

    def picture(self, i):
        """The i-th of them, cameras running fastest."""
        first = next(iter(self.data))
        sample = self.data[first][i]
        samples = {name: data[i] | {key: sample[key] for key in CROP} for name, data in self.data.items()}
        frame, camera = int(sample["frame"]), self.data[first].cameras[int(sample["camera"])].name
        captured, mask = _last(sample["image"]), sample["mask"].numpy() > 0.5
        plate = background(captured, mask)
        seen = {name: self._show(name, samples[of]) for name, of in self.shown_in(i).items()}
        rendered = {name: _last(s.image.cpu() + plate * (1 - s.mask.cpu())) for name, s in seen.items()}
        K, T = (sample[key].numpy().astype(np.float64) for key in ("K", "T_camera_world"))
        return HeldOutPicture(
            frame, camera, captured, mask,
            self.registered.labels(frame, K, T, sample["labels"].numpy()), self.registered.face(frame, K, T, mask.shape),
            rendered, self._loops(sample, K, T),
            1e3 * float(np.median(_body(sample) @ T[2, :3] + T[2, 3])) / K[0, 0],
        )  # fmt: skip

    @torch.no_grad()
    def _show(self, name, sample):
        """Rendered: what is shown of a sample's frame in its view."""
        avatar, frame = self.avatars[self.shown[name]], int(sample["frame"])
        decoded = self._decode(name, sample)
        if self._occlusion.get(name, (None,))[0] != frame:  # no camera changes the geometry
            self._occlusion[name] = frame, avatar.ambient_occlusion(decoded)
        shaded = avatar.shade(decoded, self._occlusion[name][1])
        batch = {key: sample[key][None].to(self.device) for key in VIEW}
        return avatar.compose(shaded, batch, sample["image"].shape[-2:], shadow=False, samples=SAMPLES)[0]

    def sources(self, errors):
        """{avatar: what is shown of it that its figures are of}, given the PictureErrors of all that was shown."""
        return {name: name for name in self.avatars}

    def _decode(self, name, sample):
        """{layer: Decoded}: the frame encoded, the mean of its code decoded, garments out of the body."""
        avatar, frame = self.avatars[name], int(sample["frame"])
        batch = {key: value.to(self.device) for key, value in default_collate([sample]).items()}
        decoded = avatar.decode(batch, avatar.encoded(batch))
        placed = self._keep(name, frame, decoded, batch)
        return {layer: replace(one, vertices=self._tensor(placed[layer])) for layer, one in decoded.items()}

    def _tensor(self, V):
        return torch.as_tensor(V, dtype=torch.float32, device=self.device)[None]

    def _keep(self, name, frame, decoded, pose):
        """{layer: vertices (n,3)} of a frame, which no camera changes; the layered avatar's garments out of the body."""
        if frame not in self.decoded[name]:
            if self.shown[name] == "layered":
                cleared, *self.intersections[frame] = self.cleared(frame, decoded, pose)
                self.dent = max(self.dent, self.layering.dent(decoded, cleared))
                decoded = cleared
            if not self._asked_again(name):
                self.decoded[name].clear()
            self.decoded[name][frame] = {layer: d.vertices[0].cpu().numpy() for layer, d in decoded.items()}
        return self._vertices(name, frame)

    def _vertices(self, name, frame):
        """{layer: (n,3)} of a frame that was decoded, as double precision measures it."""
        return {layer: V.astype(np.float64) for layer, V in self.decoded[name][frame].items()}

    def _asked_again(self, name):
        """Whether a frame of what is shown is asked for once its pictures are drawn, so that all frames are kept: for the truth."""
        return self.truth is not None

    def cleared(self, frame, decoded, pose):
        """({layer: Decoded} with garments out of the body, pairs before, pairs left)."""
        return self.layering(decoded, pose)

    def intersecting(self):
        """Pairs of triangles of garments and what lies under them, over the decoded frames, and how far skin gave way to cloth at most;
        None without an avatar of layers."""
        if not self.intersections:
            return None
        before, left = np.sum(list(self.intersections.values()), axis=0)
        pairs = {"before": int(before), "left": int(left), "frames": len(self.intersections)}
        return pairs | {"dent_mm": 1e3 * self.dent}

    def piercing(self):
        """What a user should know of pairs that are left."""
        left = {frame: int(left) for frame, (_, left) in self.intersections.items() if left}
        if not left:
            return []
        worst = max(left, key=left.get)
        of = f"in {len(left)} of {len(self.intersections)} frames, most in frame {worst}"
        return [f"{sum(left.values())} pairs of triangles of garments and what lies under them still intersect, {of}"]

    def unseen_views(self, frame, count=4):
        """Pictures (H,W,3) of a frame by the first avatar from `count` places between the cameras', where none stands."""
        of, data = next(iter(self.data.items()))
        name = next(shown for shown, avatar in self.shown.items() if avatar == of)
        step, views = np.pi / max(len(data.cameras), 6), []
        up = self.registered.run.capture.scene.up
        for i in evenly(data.rows_of(frame), count):
            sample = data[int(i)]
            moved = sample["T_camera_world"] @ _turned(_body(sample).mean(0), step, up)
            seen = self._show(name, sample | {"T_camera_world": moved, "camera": torch.tensor(-1)})
            views.append(_last(seen.image + PAPER * (1 - seen.mask)))
        return views

    def _loops(self, sample, K, T):
        """Pixels of the registered garments' loops, {name: (k,2)}."""
        loops = {}
        for garment, named in self.registered.loops.items():
            V = self.registered.garment(garment, int(sample["frame"])) @ T[:3, :3].T + T[:3, 3]
            for loop, at in named.items():
                p = V[at] @ K.T
                title = loop if len(self.registered.loops) == 1 else f"{garment} {loop}"
                loops[title] = np.where(p[:, 2:] > 0, p[:, :2] / np.maximum(p[:, 2:], 1e-9), np.nan)
        return loops

    def photometric(self):
        """{avatar: the photometric check of what it was trained on}, see `photometric.py`."""
        garments = list(self.garment_labels.values())
        return {name: photometric(data, garments) for name, data in self.data.items()}

    def geometry_errors(self, frame, sources):
        """{avatar: {measure: mm}} of what was decoded in a frame; `sources` {avatar: what is shown of it}."""
        layers = {name: {layer.name: layer for layer in data.layers} for name, data in self.data.items()}
        return {
            name: self.registered.errors(frame, self._vertices(shown, frame), layers[name])
            for name, shown in sources.items()
        }


class RegisteredRun:
    """What evaluation reads of a run and of the truth behind it."""

    def __init__(self, path):
        self.run = open_run(path)
        self.outside = ~self.run.body_model.inside
        self.rotations = self.run.pose.rotations[:]
        self.garment_labels = {name: garment.label for name, garment in self.run.garments.items()}
        self.loops = {name: garment.loops for name, garment in self.run.garments.items()}
        self.truth = open_truth(self.run.capture, self.garment_labels)
        faces = {name: garment.faces for name, garment in self.run.garments.items()}
        self.mapped = {name: self.truth.maps(name, F) for name, F in faces.items()} if self.truth else {}
        self.borders = {name: self.truth.border_names(name, self.run.body_model) for name in self.mapped}
        self._outer = None, None  # a frame and its true outer surface
        self.facial = Facial(self.run.body_model)

    def garment(self, name, frame):
        return self.run.garments[name].at(frame)

    def labels(self, frame, K, T_camera_world, captured):
        """Label ids (H,W) of a pinhole picture: true ones where the true surface is, the captured ones without truth."""
        if self.truth is None or frame not in self.truth:
            return captured
        if self._outer[0] != frame:
            self._outer = frame, self.truth.outer(frame, self.garment_labels)
        V, F, label = self._outer[1]
        face = kernels.raster(V @ T_camera_world[:3, :3].T + T_camera_world[:3, 3], F, K, captured.shape).face
        return np.where(face >= 0, label[face], 0)

    def face(self, frame, K, T_camera_world, shape):
        """Pixels (H,W) bool that show the registered face."""
        V = self.run.track.at(frame) @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
        return self.facial.pixels(V, K, shape)

    def errors(self, frame, decoded, layers):
        """Measures of decoded layers {name: (n,3)} against the truth [mm]; None where the truth lacks the frame.

        outer_mm: the true outer surface's vertices to the nearest decoded layer, the same for every kind of avatar; face_mm,
        expression_mm: see `Facial.errors`.
        """
        if frame not in self.truth:
            return None
        measures = {"outer_mm": self._outer_error(frame, decoded, layers)}
        for name, V in decoded.items():
            if layers[name].kind == "garment":
                faces, told = self.run.garments[name].faces, (self.mapped[name], self.borders[name])
                found = self.truth.garment_errors(name, self.loops[name], V, faces, frame, *told)[0]
                measures.setdefault("garment", {})[name] = found
            elif layers[name].kind == "body":
                hidden = self.run.body.confidence.at(frame) == HIDDEN
                measures["body"] = self.truth.body_errors(V, hidden, self.outside, frame)
            if layers[name].kind != "garment":
                measures |= self.facial.errors(V, self.truth.keypoints(frame))
        return measures

    def _outer_error(self, frame, decoded, layers):
        V, F, _ = self.truth.outer(frame, self.garment_labels, bare=True)
        seen = np.zeros(len(V), bool)
        seen[F] = True
        seen[: len(self.outside)] &= self.outside
        distances = [kernels.SurfaceIndex(v, layers[name].faces).closest(V[seen])[3] for name, v in decoded.items()]
        return millimetres(np.min(distances, axis=0))


def _chosen(folder, facts, asked, pictured):
    """Frames to evaluate, rising and each once, and what is to be said about them."""
    frames = sorted(set(facts["holdout"] if asked is None else asked))
    if not frames:
        raise UserError(f"{folder}: nothing was held out of the training: name frames by --frames")
    left = [n for n in frames if n in set(pictured)]
    if not left:
        named = f"{folder}: frames" if asked is None else "--frames"
        raise UserError(f"{named} {frame_ranges(frames)}: none of them is registered and has pictures")
    warnings, trained = [], sorted(set(left) & set(facts["frames"]))
    if len(left) < len(frames):
        warnings.append(
            f"frames {frame_ranges(sorted(set(frames) - set(left)))}: not registered or without pictures, left out"
        )
    if trained:
        warnings.append(f"frames {frame_ranges(trained)}: the avatar was trained on them")
    return left, warnings


def _turned(centre, angle, up):
    """(4,4): the world turned about a vertical axis through `centre` (3,)."""
    from scipy.spatial.transform import Rotation

    R = Rotation.from_rotvec(angle * np.eye(3)["xyz".index(up)]).as_matrix()
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, centre - R @ centre
    return torch.as_tensor(T, dtype=torch.float32)


def background(captured, mask):
    """(3,H,W) what is behind the person in a picture (H,W,3): of each pixel the nearest that is surely none of the mask
    (H,W), for what the avatar leaves open and for the mixed pixels of its silhouette. Black where all is foreground."""
    from scipy.ndimage import binary_dilation, distance_transform_edt

    beside = ~binary_dilation(mask, iterations=MIXED)
    if not beside.any():
        return torch.zeros(3, *mask.shape)
    at = distance_transform_edt(~beside, return_distances=False, return_indices=True)
    return torch.as_tensor(captured[tuple(at)].transpose(2, 0, 1))


def _last(image):
    """(3,H,W) tensor -> (H,W,3) array."""
    return image.detach().cpu().numpy().transpose(1, 2, 0)


def _body(sample):
    """Registered vertices of the first layer."""
    return next(v for key, v in sample.items() if key.startswith("vertices.")).numpy().astype(np.float64)
