"""Garments of a driven avatar as cloth that hangs on its body: the second driver, beside learnt codes (docs/method/drape.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from pydantic import ValidationError

from ...errors import UserError
from ...io.camera import first_error
from ...io.files import identity_of, load_record, save_record
from ...io.inputs import contents
from ...kernels import DrapeSolver
from ..model.assets import CheckedArrays
from ..settings import ClothSettings
from .driver import FILE
from .residual import CLOTH, CODES, JOINED, MEAN, MIXED, Residual, moving

GRAVITY = 9.81  # [m/s^2], against the scene's up
GAIN = 0.95  # a garment hangs unasked if what is shown then misses at most so much of what codes alone miss
TORN = 1.0  # strain of an edge beyond which something has drawn the cloth along; 0.7 to 0.8 where shirts hung right
LOST = 2.0  # strain at which none of it is shown
RINGS = 4  # of edges about such a place that go with it, and as many over which the rest goes over into it
CAUGHT = 0.2  # share of a garment that is not shown from which on it begins anew
RETURN = 0.5  # [s] in which cloth is shown in full again
WAIST = "waist"  # the opening that a waistband holds: skirts and trousers fall without
VERSION = 7  # of how cloth is simulated and what is kept of it


@dataclass(frozen=True)
class Cloth:
    """What is known of a garment as cloth. In AVATAR/cloth.NAME.npz."""

    lengths: np.ndarray  # (e,) of its edges at rest [m]
    margin: float  # [m] kept from the body
    residual: Residual
    settings: dict  # of ClothSettings, what it was measured with

    @property
    def asked(self):
        return ClothSettings(**self.settings)

    @property
    def helps(self):
        """Whether, mixed with codes, it lay nearer in frames left out than codes alone, and by itself nearer than its mean shape."""
        missed = self.residual.missed
        return CODES in missed and missed[CLOTH] < missed[MEAN] and missed[MIXED] <= GAIN * missed[CODES]


def cloth_file(folder, name):
    return Path(folder) / f"cloth.{name}.npz"


def forget_cloths(folder):
    """Removes what was measured of garments as cloth: from now on codes drive all."""
    for path in Path(folder).glob(cloth_file("", "*").name):
        path.unlink()


def carry_cloths(folder, out):
    """Gives AVATAR `out`, a copy of `folder` that moves as it does, what was measured of its garments as cloth since it was trained."""
    made = made_of(folder)
    for path in Path(folder).glob(cloth_file("", "*").name):
        if (identity := identity_of(path)).startswith(made):
            cloth = load_record(path, Cloth, residual=Residual)
            save_record(Path(out) / path.name, cloth, made_of(out) + identity.removeprefix(made))


def made_of(folder, settings=None):
    """What a cloth is made of, for `identity_of`; without ClothSettings the beginning of it."""
    files = (Path(folder) / name for name in ("avatar.json", "avatar.safetensors", FILE))
    trained = "".join(contents(path) for path in files if path.exists())
    return f"{VERSION} {trained}" + (settings.model_dump_json() if settings else "")


def worn_cloths(folder, layers, physics):
    """{garment: Cloth} of those of an avatar's layers that hang. `physics`: True all, False none, None those that were measured on this
    avatar as it is trained and are nearer so, see `Cloth.helps`."""
    if physics is None:
        identity = made_of(folder)
        measured = [one for one in layers if identity_of(cloth_file(folder, one.name)).startswith(identity)]
        return {name: cloth for name, cloth in load_cloths(folder, measured).items() if cloth.helps}
    return load_cloths(folder, layers) if physics else {}


def outdated(folder, layers, physics):
    """What a user should know of garments that would be asked whether they hang, but were measured before the last training."""
    if physics is not None:
        return []
    files = [cloth_file(folder, one.name) for one in layers if one.kind == "garment"]
    made = {file: identity_of(file) for file in files if file.exists()}
    again = "codes drive the garment; `toile train RUN AVATAR --temporal` or `animate --physics` measures it anew"
    old = "was measured before the avatar was trained as it is, or by an older toile"
    why = lambda identity: old if identity else "cannot be read"
    return [f"{file}: {why(one)}: {again}" for file, one in made.items() if not one.startswith(made_of(folder))]


def load_cloths(folder, layers):
    """{garment: Cloth} of an avatar's layers. UserError names the file and the field."""
    cloths = {}
    for layer in layers:
        if layer.kind != "garment":
            continue
        path = cloth_file(folder, layer.name)
        if not path.exists():
            raise UserError(f"{path}: the file is missing: `toile animate --physics` makes it while the run is there")
        cloths[layer.name] = cloth = load_record(path, Cloth, residual=Residual)
        check_cloth(path, cloth, len(layer.rest))
    return cloths


def check_cloth(path, cloth, n):
    """UserError names the field of a Cloth that does not fit a garment of n vertices."""
    residual = vars(cloth.residual) if isinstance(cloth.residual, Residual) else {}
    fields = CheckedArrays(path, vars(cloth) | {f"residual.{name}": value for name, value in residual.items()})
    fields.get("lengths", (None,)), fields.get("margin", ())
    fields.get("residual.registered", (n, 3)), fields.get("residual.simulated", (n, 3))
    for name in ("reach", "swing_reach", "share", "trust"):
        fields.get(f"residual.{name}", ())
    poses, modes = fields.get("residual.poses", (None, None)), fields.get("residual.modes", (None, n, 3))
    fields.get("residual.weights", (len(poses), len(modes))), fields.get("residual.swings", (len(poses), len(modes)))
    missed = residual.get("missed")
    lengths = {MEAN, CLOTH, JOINED}
    named = isinstance(missed, dict) and set(missed) in (set(), lengths, lengths | {CODES, MIXED})
    if not named or not all(isinstance(one, float) and np.isfinite(one) for one in missed.values()):
        raise UserError(
            f"{path}: residual.missed is {missed!r}, expected lengths of {MEAN}, {CLOTH}, {JOINED}, {CODES} and {MIXED}"
        )
    try:
        ClothSettings(**(cloth.settings or {}))
    except ValidationError as error:
        raise first_error(path, error) from None


def doubts(cloths):
    """What a user should know of {garment: Cloth}: where physics tells less than no physics."""
    warnings = []
    for name, cloth in cloths.items():
        missed = cloth.residual.missed
        if missed and missed[CLOTH] > missed[MEAN]:
            hung, still = 1e3 * missed[CLOTH], 1e3 * missed[MEAN]
            words = f"{name} as cloth lies {hung:.0f} mm from where it was registered, its mean shape {still:.0f} mm"
            warnings.append(f"{words}: physics does not help it")
    return warnings


def relieved(shares, strain):
    """What a user should know of the shares {frame: of a garment that is shown as cloth, where it is not all} and of the largest strain of
    an edge while cloth was simulated."""
    if not shares:
        return []
    worst = min(shares, key=shares.get)
    taken = f"{100 * (1 - shares[worst]):.1f} % of it in frame {worst}"
    others = f", as much or less in {len(shares) - 1} others" if len(shares) > 1 else ""
    drawn = f"an edge had been stretched to {1 + strain:.1f} times its length"
    caught = "cloth could not be led out of the body"
    why = f"{drawn}, or {caught}" if strain > TORN else caught
    return [f"cloth: codes drive {taken}{others}: {why}; with --no-physics they drive all"]


class Draping:
    """Garments of `avatar` as the cloths {name: Cloth} over the layers under them; those without one go as they are decoded.

    `frame(i)` gives {layer: Decoded} of frame i, whose garments matter only where cloth begins, and its batch; `times` (T,) [s] and
    `rotations` (T,K,3) of the frames; `readers` {name: the avatar by whose features a cloth's residual reads poses}. Cloth
    begins at rest on the first frame, out of the body by `layering`, and settles there. A waistband goes where codes place it. About edges that are drawn out beyond TORN more
    and more of the codes' shape is shown in its stead; a garment of which that takes CAUGHT begins anew.
    """

    def __init__(self, avatar, cloths, layering, times, rotations, frame, readers):
        self.avatar, self.cloths, self.layering, self.times, self.frame = avatar, cloths, layering, times, frame
        self.row, self.solvers, self.fallen, self.shares, self.strain = None, {}, {}, {}, 0.0
        rotations = torch.as_tensor(rotations, dtype=torch.float32)
        read = {one: moving(one.carried(rotations.to(one.up.device)).cpu().numpy(), times) for one in readers.values()}
        self.poses = {name: read[readers[name]] for name in cloths}
        self.held = {name: waistband(avatar.layer(name)) for name in cloths}

    @torch.no_grad()
    def at(self, i, decoded, batch):
        """`decoded` of frame i with the garments where cloth falls. Frames are simulated in order: going back begins anew."""
        if self.row is None or i < self.row:
            self._begin(*((decoded, batch) if i == 0 else self.frame(0)))
        while self.row < i:
            self._go_on(*((decoded, batch) if self.row + 1 == i else self.frame(self.row + 1)))
        transforms = self.avatar.skeleton(batch["rotations"], batch["translation"])
        cloth = {name: self._shown(name, V, decoded[name], transforms) for name, V in self.fallen.items()}
        return decoded | cloth

    def clear(self, i, decoded, batch):
        """(What `layering` gives of frame i, the share of cloth in the garment that has least of it); by codes alone, if cloth keeps pairs
        and these fewer."""
        layered = self.layering(self.at(i, decoded, batch), batch)
        share = min((float(of.mean()) for of in self.shares.values()), default=1.0)
        if layered[2] and share > 0:
            by_codes = self.layering(decoded, batch)
            if by_codes[2] < layered[2]:
                return by_codes, 0.0
        return layered, share

    def _shown(self, name, V, decoded, transforms):
        """The residual added and the codes' shape mixed in, where the body carries it."""
        skin, like, cloth = self.avatar.model(name).skin, decoded.vertices, self.cloths[name]
        pose = self.poses[name][self.row]
        unposed = skin.unpose(like.new_tensor(V)[None], *transforms)[0].double().cpu().numpy()
        by_codes = decoded.unposed[0].double().cpu().numpy()
        mixed = cloth.residual.mix(cloth.residual.add(unposed, pose), by_codes, pose)
        mixed = by_codes + self.shares[name][:, None] * (mixed - by_codes)
        return replace(decoded, vertices=skin.pose(like.new_tensor(mixed)[None], *transforms))

    def _begin(self, decoded, batch):
        clear = self.layering(decoded, batch)[0]
        self.row, self.solvers = 0, {}
        self.shares = {name: np.ones(decoded[name].vertices.shape[1]) for name in self.cloths}
        self._fall(decoded, lambda name, under: self.solvers[name].start(points(clear[name]), under))

    def _go_on(self, decoded, batch):
        dt = float(self.times[self.row + 1] - self.times[self.row])
        self.row += 1
        self._fall(decoded, lambda name, under: self._step(name, under, dt, decoded, batch))

    def _step(self, name, under, dt, decoded, batch):
        """A garment one step on; from the codes' shape, where too much of it had been drawn out."""
        moved = self.solvers[name].step(under, dt, points(decoded[name])[self.held[name]])
        self.strain = max(self.strain, moved.strain)
        sound = whole(moved.V, self.layering.edges[name], self.cloths[name].lengths)
        caught = sound.mean() < 1 - CAUGHT
        self.shares[name] = np.minimum(np.zeros_like(sound) if caught else sound, self.shares[name] + dt / RETURN)
        return self.solvers[name].start(points(self.layering(decoded, batch)[0][name]), under) if caught else moved

    def _fall(self, decoded, move):
        under_V, under_F = points(decoded[self.layering.body.name]), self.layering.layering.skin_faces
        for layer in self.layering.garments:
            V = points(decoded[layer.name])
            if layer.name in self.cloths:
                if layer.name not in self.solvers:
                    self.solvers[layer.name] = self._solver(layer, under_F, len(under_V))
                V = self.fallen[layer.name] = move(layer.name, under_V).V
            under_F = np.concatenate([under_F, np.asarray(layer.faces, np.int32) + len(under_V)])
            under_V = np.concatenate([under_V, V])

    def _solver(self, layer, under_F, under_n):
        cloth, gravity = self.cloths[layer.name], -GRAVITY * self.avatar.up.cpu().numpy().astype(np.float64)
        options = cloth.asked.solver() | {"gravity": gravity, "margin": float(cloth.margin)}
        held = self.held[layer.name]
        return DrapeSolver(layer.faces, len(layer.rest), cloth.lengths, under_F, under_n, held, **options)


def waistband(layer):
    """(h,) the vertices of a garment's waist, none of one that hangs from the shoulders."""
    return np.asarray(layer.loops.get(WAIST, ()), np.int32)


def whole(V, edges, lengths):
    """(n,) 1 where cloth V (n,3) hangs as it should, 0 within RINGS of an edge (2,e) drawn out to LOST of its length at rest (e,), and evenly
    between the two over as many more."""
    i, j = edges
    strain = np.linalg.norm(V[i] - V[j], axis=1) / lengths - 1
    sound, known = np.ones(len(V)), np.clip((LOST - strain) / (LOST - TORN), 0, 1)
    if known.min(initial=1) == 1:
        return sound
    np.minimum.at(sound, i, known)
    np.minimum.at(sound, j, known)
    for _ in range(RINGS):
        near = sound.copy()
        np.minimum.at(near, i, sound[j])
        np.minimum.at(near, j, sound[i])
        sound = near
    degree = 1 + np.bincount(edges.ravel(), minlength=len(V))
    for _ in range(RINGS):
        total = sound.copy()
        np.add.at(total, i, sound[j])
        np.add.at(total, j, sound[i])
        sound = total / degree
    return sound


def points(decoded):
    return decoded.vertices[0].double().cpu().numpy()
