"""Spoilt avatars, and motions and pictures for them."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from tests.faults.hostile.cases import (
    ANIMATE,
    BVH,
    DEEP,
    DRIVE,
    INF,
    NAN,
    add,
    archive,
    changed,
    damage,
    nothing,
    piped,
    text,
    written,
)

damage("avatar", "avatar.json", ANIMATE)
damage("avatar", "avatar.safetensors", ANIMATE)
damage("avatar", "assets/maps.npz", ANIMATE)
damage("avatar", "assets/layer0.npz", ANIMATE)
damage("avatar", "assets/scene.json", ANIMATE)
damage("avatar", "assets/cameras.json", ANIMATE)
damage("motion", "motion.npz", DRIVE)
damage("motion", "motion.bvh", BVH)

for name, changes in [
    ("no fps", {"fps": None}),
    ("fps inf", {"fps": INF}),
    ("fps zero", {"fps": 0.0}),
    ("joints", {"rotations": np.zeros((3, 2, 3))}),
    ("nan", {"translation": np.full((3, 3), NAN)}),
    ("none", {"translation": np.zeros((0, 3)), "rotations": np.zeros((0, 104, 3))}),
    ("pickled", {"rotations": np.array([{}], object)}),
]:
    add(f"motion {name}", "motion", archive("motion.npz", **changes), DRIVE, "motion.npz")
AMASS = {"rotations": None, "poses": np.zeros((3, 156)), "trans": np.zeros((3, 3)), "mocap_framerate": 120.0}
for name, changes in [
    ("lies", {"poses": np.tile([0, 0, 1.5, *[0] * 153], (3, 1))}),
    ("width", {"poses": np.zeros((3, 100))}),
    ("no rate", {"mocap_framerate": None}),
    ("rate nan", {"mocap_framerate": NAN}),
    ("nan", {"trans": np.full((3, 3), NAN)}),
    ("none", {"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}),
    ("degrees", {"poses": np.full((3, 156), 40.0)}),
    ("huge", {"poses": np.full((3, 156), 1e300)}),
    ("surface", {"surface_model_type": np.zeros(3)}),
    ("up", {"up": np.zeros(2)}),
    ("pickled", {"poses": np.array([{}], object)}),
]:
    add(f"motion of AMASS {name}", "motion", archive("motion.npz", **AMASS | changes), DRIVE, "motion.npz")
for name, old, new in [
    ("channel", "Zrotation", "Wrotation"),
    ("time inf", "Frame Time: 0.033", "Frame Time: inf"),
    ("frames", "Frames: 2", "Frames: 900000000000"),
    ("numbers", "0.0 0.0", "zero 0.0"),
]:
    add(f"motion.bvh {name}", "motion", text("motion.bvh", old, new), BVH, "motion.bvh")


for name, change, said in [
    ("a list", lambda facts: facts.clear(), "avatar.json"),
    ("settings gone", lambda facts: facts.pop("settings"), "avatar.json"),
    ("settings text", lambda facts: facts.update(settings="x"), "avatar.json"),
    ("settings unknown", lambda facts: facts["settings"].update(x=1), "settings"),
    ("texture huge", lambda facts: facts["settings"]["data"].update(texture_size=10**7), "avatar.json"),
    ("texture negative", lambda facts: facts["settings"]["data"].update(texture_size=-4), "avatar.json"),
    ("texture other", lambda facts: facts["settings"]["data"].update(texture_size=32), "maps.npz"),
    ("latent huge", lambda facts: facts["settings"]["network"].update(latent=10**9), "avatar.json"),
    ("run a number", lambda facts: facts.update(run=3), "avatar.json"),
    ("steps null", lambda facts: facts.update(steps=None), "not finished"),
]:
    add(f"avatar.json {name}", "avatar", changed("avatar.json", change), ANIMATE, said)
for name, change in [
    ("no labels", lambda scene: scene.pop("labels")),
    ("garments text", lambda scene: scene.update(garments="x")),
    ("fps text", lambda scene: scene.update(fps="x")),
]:
    add(f"avatar scene.json {name}", "avatar", changed("assets/scene.json", change), ANIMATE, "scene.json")
for path in ("avatar.json", "assets/scene.json", "assets/cameras.json"):
    add(f"avatar {path} nested", "avatar", written(path, DEEP), ANIMATE, Path(path).name)
for name, path, changes in [
    ("faces beyond", "layer0", {"faces": np.full((4, 3), 10**6)}),
    ("rest gone", "layer0", {"rest": None}),
    ("rest nan", "layer0", {"rest": np.full((4, 3), NAN)}),
    ("skin beyond", "layer0", {"skin_idx": np.full((4, 2), 10**6, np.int32)}),
    ("uv text", "layer0", {"uv": np.array(["x"])}),
    ("joints gone", "maps", {"J": None}),
    ("joints text", "maps", {"J": np.array(["x"])}),
    ("parents a circle", "maps", {"parents": np.ones(104, int)}),
    ("texture gone", "maps", {"mean_texture.surface": None}),
    ("texture of another size", "maps", {"mean_texture.surface": np.zeros((3, 2, 2), np.float32)}),
    ("poses gone", "maps", {"rotations": None}),
    ("light of another size", "maps", {"light": np.zeros((3, 8)), "mean_light.surface": None}),
    ("light's mean gone", "maps", {"light": np.zeros((8, 3)), "mean_light.surface": None}),
    ("light's mean of another size", "maps", {"light": np.zeros((8, 3)), "mean_light.surface": np.ones((3, 2, 2))}),
]:
    add(f"avatar {path} {name}", "avatar", archive(f"assets/{path}.npz", **changes), ANIMATE, f"{path}.npz")
gone = lambda folder: (folder / "assets" / "layer0.npz").unlink()
add("avatar layer0 gone", "avatar", gone, ANIMATE, "layer0.npz: the file is missing")


def header(length, said=b""):
    """A safetensors file that claims a header of so many bytes."""
    return lambda folder: (folder / "avatar.safetensors").write_bytes(length.to_bytes(8, "little") + said)


def tensors(**claims):
    said = json.dumps({"__metadata__": {"json": "{}"}, **claims}).encode()
    return header(len(said), said)


for name, spoil in [
    ("header huge", header(1 << 60)),
    ("header beyond", header(100_000)),
    ("header nested", header(len(DEEP), DEEP.encode())),
    ("shape huge", tensors(x={"dtype": "F32", "shape": [1 << 40], "data_offsets": [0, 1 << 42]})),
    ("shape other", tensors(x={"dtype": "F32", "shape": [4], "data_offsets": [0, 4]})),
    ("nothing inside", tensors()),
]:
    add(f"avatar.safetensors {name}", "avatar", spoil, ANIMATE, "avatar.safetensors")
add("animate into a file", "avatar", nothing, (*ANIMATE[:3], "IN/avatar.json/x"), "avatar.json")
add("animate into no file system", "avatar", nothing, (*ANIMATE[:3], "/proc/x"), "/proc")
add("animate nothing", "avatar", nothing, ("animate", "IN/nothing", "MOTION", "OUT"), "nothing")
add("animate by a folder", "avatar", nothing, (*ANIMATE[:2], "IN", "OUT"), "neither a run")
EDIT = ("edit", "IN", "OUT", "--garment", "tshirt", "--no-sheet")
for name, path, spoil in [
    ("a pipe", "picture.png", lambda f: piped(f / "picture.png")),
    ("nothing", "picture.png", nothing),
    ("a text", "avatar.json", nothing),
    ("a bomb", "p.png", lambda f: Image.new("1", (20_000, 9_000)).save(f / "p.png")),
    ("a GIF", "p.png", lambda f: Image.new("RGB", (9, 9)).save(f / "p.png", "GIF")),
]:
    add(f"edit by {name}", "layered", spoil, (*EDIT, "--image", f"IN/{path}"), path)
