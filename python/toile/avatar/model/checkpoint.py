"""What a training leaves on disk: checkpoints that go on to the bit, and the avatar. safetensors, JSON and .npz; no pickles.

Every file is written under another name first and renamed, so a killed training leaves whole files.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from pydantic import ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from ...errors import UserError
from ...frame_numbers import frame_ranges
from ...io.bounded import check_file, read_json, reason_of
from ...io.camera import first_error
from ...io.files import replace_file, save_record, write_text
from ..settings import AvatarSettings
from .assets import read_assets

FACTS = {  # of AVATAR/avatar.json
    "settings": dict, "run": str, "frames": list, "holdout": list, "steps": dict, "architecture": dict,
}  # fmt: skip
FRAMES = ("frames", "holdout")  # lists of frame numbers among them
ALIGNED = "aligned"  # in AVATAR: the run that `toile train` laid still
BASELINE = "baseline"  # in AVATAR: the single-layer avatar
DIGEST = re.compile("[0-9a-f]{64}")  # which tells a reader nothing
KEPT = 2  # checkpoints; older ones are removed
MODEL, OPTIMISER = "model.", "optimiser."
TRAINED = OPTIMISER + "trained"  # numbers of the parameters that have moments: a phase does not train all
MOMENTS = "step", "exp_avg", "exp_avg_sq"  # of AdamW, by parameter


def write_tensors(path, tensors, facts):
    """One safetensors file whose header carries `facts` as JSON."""
    whole = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    replace_file(path, lambda part: part.write_bytes(save(whole, {"json": json.dumps(facts)})))


def read_tensors(path):
    """-> ({name: tensor}, facts)."""
    check_file(path)
    try:
        with safe_open(path, framework="pt") as file:
            facts = json.loads(file.metadata()["json"])
            if not isinstance(facts, dict):
                raise ValueError("its facts are no table")
            return {name: file.get_tensor(name) for name in file.keys()}, facts
    except (SafetensorError, KeyError, TypeError, ValueError, RecursionError, OSError) as error:
        raise UserError(f"{path}: not a file of toile's tensors: {reason_of(error)}") from None


class Checkpoints:
    """AVATAR/checkpoints/00000123.safetensors: weights, buffers, the optimiser's moments and where the training stood."""

    def __init__(self, folder):
        self.folder = Path(folder)
        for part in self.folder.glob(".*.part"):  # of a killed process
            part.unlink()

    def numbers(self):
        return sorted(int(path.stem) for path in self.folder.glob("*.safetensors") if path.stem.isdecimal())

    def write(self, number, model, optimiser, facts):
        """`number` orders the checkpoints; later ones of an abandoned course are removed, and all but the last two."""
        states = optimiser.state_dict()["state"]
        moments = {f"{OPTIMISER}{i}.{name}": value for i, state in states.items() for name, value in state.items()}
        moments[TRAINED] = torch.tensor(sorted(states), dtype=torch.int64)
        weights = {MODEL + name: value for name, value in model.state_dict().items()}
        write_tensors(self._path(number), weights | moments, facts)
        earlier = [n for n in self.numbers() if n < number]
        for other in self.numbers():
            if other > number or other in earlier[: 1 - KEPT]:
                self._path(other).unlink()

    def latest(self):
        """(tensors, facts) of the newest, None where there is none."""
        path = self.newest()
        try:
            return read_tensors(path) if path else None
        except UserError as error:
            raise UserError(f"{error}; without this file the training goes on from the checkpoint before") from None

    def newest(self):
        """Its path, None where there is none."""
        numbers = self.numbers()
        return self._path(numbers[-1]) if numbers else None

    def _path(self, number):
        return self.folder / f"{number:08d}.safetensors"


def load_model(model, tensors, path="checkpoint"):
    """Weights and buffers of a checkpoint into a model of the same architecture."""
    weights = {name.removeprefix(MODEL): value for name, value in tensors.items() if name.startswith(MODEL)}
    expected = {name: tuple(value.shape) for name, value in model.state_dict().items()}
    found = {name: tuple(value.shape) for name, value in weights.items()}
    for name in sorted(expected.keys() | found.keys()):
        if expected.get(name) != found.get(name):
            raise UserError(f"{path}: {name}: shape {found.get(name)}, this avatar has {expected.get(name)}")
        if weights[name].is_floating_point() and not weights[name].isfinite().all():
            raise UserError(f"{path}: {name}: is not finite")
    model.load_state_dict(weights)


def load_optimiser(optimiser, tensors, path="checkpoint"):
    """The moments of a checkpoint that was written after a step, into an AdamW over the same parameters. UserError: they are missing,
    those of others, or not finite."""
    parameters = [parameter for group in optimiser.param_groups for parameter in group["params"]]
    found, state = {name: value for name, value in tensors.items() if name.startswith(OPTIMISER)}, {}
    told = found.pop(TRAINED, None)  # which older checkpoints lack
    trained = set() if told is None else set(told.flatten().tolist())
    for i, parameter in enumerate(parameters):
        shapes = dict(zip(MOMENTS, ((), parameter.shape, parameter.shape)))
        own = {moment: found.pop(f"{OPTIMISER}{i}.{moment}", None) for moment in MOMENTS}
        if i not in trained and all(value is None for value in own.values()):
            continue
        for moment, value in own.items():
            if value is None or value.shape != shapes[moment] or not value.isfinite().all():
                raise UserError(f"{path}: {OPTIMISER}{i}.{moment}: is missing, not finite or of another shape")
        state[i] = own
    if found:
        raise UserError(f"{path}: {min(found)}: this avatar has no such weight")
    if not state:
        raise UserError(f"{path}: {OPTIMISER}*: is missing: without the moments training would go on another way")
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})


def topology(layers, scene, cameras):
    """What makes an avatar's weights fit a run, each as a hash: the scene, and each layer's faces and UVs."""
    facts = {"scene": json.dumps([scene.name, scene.labels, [asdict(g) for g in scene.garments]]).encode()}
    facts["cameras"] = json.dumps([camera.name for camera in cameras]).encode()
    for layer in layers:
        arrays = (layer.faces.astype(np.int32), layer.uv.astype(np.float32), layer.face_uv.astype(np.int32))
        facts[f"layer {layer.name}"] = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    return {name: hashlib.sha256(value).hexdigest() for name, value in facts.items()}


def begin(folder, asked):
    """Notes what is asked of a training in AVATAR/avatar.json, or checks that it asks for the same; True if unfinished. A run that was
    moved is known by its registration."""
    path = Path(folder) / "avatar.json"
    if not path.exists():
        write_text(path, json.dumps(asked | {"steps": None}, indent=1))
        return True
    found = asked_before(folder)
    if found.get("settings"):  # what an older version did not know has its default
        found["settings"] = found["settings"].model_dump(mode="json")
    found.setdefault("pictures", asked.get("pictures"))  # nor did it keep what tells them
    known, new = found.get("registration"), asked.get("registration")
    if known and known == new and found.get("run") != asked["run"]:  # the same, at another place
        found["run"] = asked["run"]
        write_text(path, json.dumps(found, indent=1))
    check_same(path, found if known else found | {"registration": new}, asked)
    return found.get("steps") is None


def asked_before(folder):
    """What AVATAR/avatar.json says was asked of a training, finished or not: its facts with `settings` as AvatarSettings; {} where
    there is none."""
    path = Path(folder) / "avatar.json"
    facts = read_json(path, dict) if path.exists() else {}
    return moved_along(path.parent, facts) | {"settings": _settings(path, facts)} if facts else {}


def _settings(path, facts):
    try:
        return AvatarSettings(**facts["settings"]) if isinstance(facts.get("settings"), dict) else None
    except ValidationError as error:
        raise first_error(path, error, "settings") from None


def check_same(path, found, asked, prefix=""):
    """UserError that names the first thing in which what a file holds differs from what is asked."""
    for name, value in asked.items():
        other = found.get(name)
        if isinstance(value, dict) and isinstance(other, dict):
            check_same(path, other, value, f"{prefix}{name}.")
        elif other != value:
            what = different_frames if name in FRAMES and numbers(other) and numbers(value) else different
            raise UserError(f"{path}: {prefix}{name}: {what(other, value)}: take another folder")


def numbers(value):
    """Whether it is a list of whole numbers."""
    return isinstance(value, list) and all(type(one) is int for one in value)


def different(found, asked):
    if all(isinstance(one, str) and DIGEST.fullmatch(one) for one in (found, asked)):
        return "it was trained with another one than there is now"
    return f"holds {shortened(json.dumps(found))}, asked is {shortened(json.dumps(asked))}"


def different_frames(found, asked):
    """The frames that only one of two lists has: of two long lists the beginnings may be alike."""
    left, new = (shortened(frame_ranges(sorted(set(a) - set(b)))) for a, b in ((found, asked), (asked, found)))
    words = [f"holds frames {left}, which are not asked for"] * bool(left) + [f"asked are frames {new} too"] * bool(new)
    return ", ".join(words)


def shortened(text, length=60):
    return text if len(text) <= length else f"{text[: length - 3]}..."


def moved_along(folder, facts):
    """The facts of AVATAR or AVATAR/baseline; where its run lies in AVATAR, as `toile train` aligns one, that run's place now, for AVATAR
    may have been moved or copied."""
    run, inside = Path(str(facts.get("run"))), [folder / ALIGNED]
    if folder.resolve().name == BASELINE or not run.exists():
        inside.append(folder.parent / ALIGNED)
    if run.name == ALIGNED:
        return facts | {"run": next((str(path.resolve()) for path in inside if path.is_dir()), facts["run"])}
    return facts


def save_assets(folder, data):
    """What an avatar needs besides its weights: layers, skeleton, cameras, scene, mean textures."""
    assets = Path(folder) / "assets"
    for i, layer in enumerate(data.layers):
        save_record(assets / f"layer{i}.npz", layer)
    maps = {f"mean_texture.{name}": value for name, value in data.mean_texture.items()}
    maps |= {f"valid.{name}": value for name, value in data.valid.items()}
    maps |= {f"mean_light.{name}": value for name, value in (data.mean_light or {}).items()}
    rig = {"J": data.J, "parents": data.parents, "face_mean": data.face_mean, "head": data.head, "light": data.light}
    rig |= data.poses
    maps |= {name: value for name, value in rig.items() if value is not None}

    def write(part):
        with open(part, "wb") as file:
            np.savez_compressed(file, **{name: np.asarray(value) for name, value in maps.items()})

    replace_file(assets / "maps.npz", write)
    write_text(assets / "scene.json", json.dumps(asdict(data.scene), indent=1))
    write_text(assets / "cameras.json", json.dumps({"cameras": [_plain_camera(camera) for camera in data.cameras]}))


def save_avatar(folder, avatar, facts):
    """AVATAR/avatar.safetensors, then avatar.json with the steps taken: then the training has finished."""
    folder = Path(folder)
    write_tensors(folder / "avatar.safetensors", avatar.state_dict(), {})
    write_text(folder / "avatar.json", json.dumps(facts, indent=1))


def read_facts(folder):
    """AVATAR/avatar.json of a trained avatar: settings, scene, run, frames, held-out frames, steps, architecture."""
    path = Path(folder) / "avatar.json"
    if not path.exists():
        missing = "the file is missing: the folder holds no avatar of `toile train`"
        raise UserError(f"{path}: {missing}" if path.parent.is_dir() else f"{path.parent}: no such folder")
    facts = read_json(path, dict)
    if facts.get("steps") is None:
        raise UserError(f"{path}: the training has not finished: the same `toile train` goes on with it")
    settings = _settings(path, facts)
    for name, kind in FACTS.items():
        if not isinstance(facts.get(name), kind):
            raise UserError(f"{path}: {name}: expected a {kind.__name__}, the file is not an avatar's")
    return moved_along(path.parent, facts) | {"settings": settings}


def load_avatar(folder):
    """The trained avatar of a folder, with its edits, ready to decode, on the CPU."""
    from .avatar import Avatar
    from .edits import apply_edits, load_edits

    folder, facts = Path(folder), read_facts(folder)
    avatar = Avatar(facts["settings"], **read_assets(folder, facts))
    tensors, _ = read_tensors(folder / "avatar.safetensors")
    load_model(avatar, {MODEL + name: value for name, value in tensors.items()}, folder / "avatar.safetensors")
    apply_edits(avatar, load_edits(folder))
    return avatar.eval()


def _plain_camera(camera):
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in asdict(camera).items()}
