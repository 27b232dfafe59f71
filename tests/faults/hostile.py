"""The table of hostile inputs: a name -> what is spoilt, the command that meets it, and what its message must name."""

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
DEEP = "[" * 100_000
FRAME = "frames/000000"
INF, NAN = float("inf"), float("nan")


@dataclass(frozen=True)
class Case:
    """`spoil(folder)` damages a copy of a `kind` (capture, run, avatar, motion); `command` is given "IN" for the folder, and
    "RUN", "OUT", and "AVATAR" for others; each of `said` stands in the message."""

    kind: str
    spoil: object
    command: tuple
    said: tuple = ()
    slow: bool = False


REGISTER = ("register", "IN", "OUT", "--quality", "draft")
EVALUATE, REPORT = ("evaluate", "IN"), ("report", "IN")
ANIMATE = ("animate", "IN", "MOTION", "OUT")
DRIVE, BVH = (("animate", "AVATAR", f"IN/motion.{kind}", "OUT") for kind in ("npz", "bvh"))
ALIGN = ("align", "IN", "OUT")
TEMPLATE = ("template", "IN", "OUT.obj", "--name", "shirt", "--label", "tshirt")
TRAIN = ("train", "IN", "OUT", "--quality", "draft", "--steps", "1,1,1")
CASES = {}


def add(name, kind, spoil, command, *said, slow=False):
    assert name not in CASES, name
    CASES[name] = Case(kind, spoil, command, said, slow)


# Any file, damaged in the ways that need no knowledge of it ------------------------------------------------------


def removed(path):
    path.unlink()


def emptied(path):
    path.write_bytes(b"")


def garbled(path):
    path.write_bytes(bytes(np.random.default_rng(0).integers(0, 256, 4000, dtype=np.uint8)))


def halved(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def piped(path):
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def made_a_file(path):
    path.write_text("")
    return path


def made_a_folder(path):
    path.unlink()
    path.mkdir()


def looped(path):
    path.unlink()
    path.symlink_to(path.name)


def swollen(path):
    os.truncate(path, 1 << 40)


DAMAGES = {f.__name__: f for f in (removed, emptied, garbled, halved, piped, made_a_folder, looped, swollen)}


QUICK = ("removed", "garbled", "piped", "swollen")  # the others are variations of these


def damage(kind, path, command, without=()):
    for name, spoil in DAMAGES.items():
        if name not in without:
            named = Path(path).name.split(".")[0]
            add(f"{kind} {path} {name}", kind, _at(path, spoil), command, named, slow=name not in QUICK)


def _at(path, spoil):
    return lambda folder: spoil(folder / path)


damage("capture", "scene.toml", REGISTER, ("halved",))
damage("capture", "cameras.json", REGISTER)
damage("capture", "templates/tube.obj", REGISTER)
damage("capture", "body.npz", REGISTER)
damage("capture", f"{FRAME}/keypoints.json", REGISTER, ("removed",))
damage("capture", f"{FRAME}/scan.ply", REGISTER, ("removed",))
damage("capture", f"{FRAME}/images/cam00.jpg", REGISTER, ("removed",))
damage("capture", f"{FRAME}/labels/cam01.png", REGISTER, ("removed",))
damage("capture", f"{FRAME}/masks/cam02.png", REGISTER, ("removed",))
damage("run", "config.toml", EVALUATE, ("halved",))
damage("run", "registered.zarr/zarr.json", EVALUATE)
damage("avatar", "avatar.json", ANIMATE)
damage("avatar", "avatar.safetensors", ANIMATE)
damage("avatar", "assets/maps.npz", ANIMATE)
damage("avatar", "assets/layer0.npz", ANIMATE)
damage("avatar", "assets/scene.json", ANIMATE)
damage("avatar", "assets/cameras.json", ANIMATE)
damage("motion", "motion.npz", DRIVE)
damage("motion", "motion.bvh", BVH)


# Files that can be read and say something impossible -------------------------------------------------------------


def text(path, old, new):
    def spoil(folder):
        whole = (folder / path).read_text()
        assert old in whole, old
        (folder / path).write_text(whole.replace(old, new, 1))

    return spoil


for name, old, new, said in [
    ("nested", "[scene]", f"x = {DEEP}\n[scene]", "nested too deeply"),
    ("fps inf", "fps = 30", "fps = inf", "scene.fps"),
    ("fps nan", "fps = 30", "fps = nan", "scene.fps"),
    ("fps negative", "fps = 30", "fps = -1", "scene.fps"),
    ("fps text", "fps = 30", 'fps = "fast"', "scene.fps"),
    ("fps list", "fps = 30", "fps = []", "scene.fps"),
    ("units", 'units = "m"', 'units = "feet"', "scene.units"),
    ("up", 'up = "z"', 'up = "w"', "scene.up"),
    ("table missing", "[scene]", "[person]", "scene"),
    ("body unknown", 'model = "body.npz"', 'model = "smpl"', "body.model"),
    ("body outside", 'model = "body.npz"', 'model = "../body.npz"', "body.model"),
    ("body absolute", 'model = "body.npz"', 'model = "/etc/passwd.npz"', "body.model"),
    ("label zero", "shoes = 5", "shoes = 0", "labels.shoes"),
    ("label large", "shoes = 5", "shoes = 256", "labels.shoes"),
    ("label huge", "shoes = 5", "shoes = " + "9" * 30, "labels.shoes"),
    ("label twice", "shoes = 5", "shoes = 4", "labels"),
    ("label text", "shoes = 5", 'shoes = "x"', "labels.shoes"),
    ("garment track", 'name = "tshirt"', 'name = "track"', "garment.0.name"),
    ("garment body", 'name = "tshirt"', 'name = "body"', "garment.0.name"),
    ("garment path", 'name = "tshirt"', 'name = "../x"', "garment.0.name"),
    ("garment long", 'name = "tshirt"', f'name = "{"x" * 300}"', "garment.0.name"),
    ("garment empty", 'name = "tshirt"', 'name = ""', "garment.0.name"),
    ("garment unlabelled", 'label = "tshirt"', 'label = "cape"', "garment.0.label"),
    ("template outside", "templates/tube.obj", "../tube.obj", "garment.0.template"),
    ("template a folder", "templates/tube.obj", "templates", "garment.0.template"),
    ("template null", "templates/tube.obj", r"a\u0000b", "garment.0.template"),
    ("cameras outside", '"cameras.json"', '"../../cameras.json"', "cameras.file"),
    ("cameras a device", '"cameras.json"', '"/dev/zero"', "cameras.file"),
    ("unknown key", "fps = 30", "fps = 30\nfsp = 30", "scene.fsp"),
]:
    add(f"scene.toml {name}", "capture", text("scene.toml", old, new), REGISTER, said)


def not_utf8(folder):
    (folder / "scene.toml").write_bytes(b"# \xff\n" + (folder / "scene.toml").read_bytes())


add("scene.toml not UTF-8", "capture", not_utf8, REGISTER, "scene.toml")


def cameras(change):
    def spoil(folder):
        data = json.loads((folder / "cameras.json").read_text())
        result = change(data["cameras"])
        (folder / "cameras.json").write_text(json.dumps(data if result is None else result))

    return spoil


def put(field, value):
    return lambda entries: entries[0].__setitem__(field, value)


for name, change, said in [
    ("a list", lambda c: [], "cameras.json"),
    ("a number", lambda c: 7, "cameras.json"),
    ("nothing", lambda c: {"cameras": []}, "no such camera in cameras.json"),
    ("twice", lambda c: c.append(c[0]), "twice"),
    ("K short", put("K", [[1, 0, 0]]), "cameras.0.K"),
    ("K ragged", put("K", [[1, 0], [1], [1]]), "cameras.0.K"),
    ("K nan", put("K", [[NAN] * 3] * 3), "cameras.0.K"),
    ("K huge numbers", put("K", [[10**400, 0, 0], [0, 1, 0], [0, 0, 1]]), "cameras.0.K"),
    ("K no focal length", put("K", [[0, 0, 1], [0, 1, 0], [0, 0, 1]]), "cameras.0"),
    ("width zero", put("width", 0), "cameras.0"),
    ("width huge", put("width", 10**9), "cameras.0"),
    ("width text", put("width", "wide"), "cameras.0.width"),
    ("distortion short", put("distortion", [0.0]), "cameras.0.distortion"),
    ("pose no rotation", put("T_camera_world", np.diag([2.0, 2, 2, 1]).tolist()), "cameras.0.T_camera_world"),
    ("pose mirrored", put("T_camera_world", np.diag([-1.0, 1, 1, 1]).tolist()), "cameras.0.T_camera_world"),
    ("pose infinite", put("T_camera_world", np.diag([1.0, 1, 1, INF]).tolist()), "cameras.0.T_camera_world"),
    ("unknown key", put("lens", 1), "cameras.0.lens"),
    ("other size", put("width", 100), "pixels"),
]:
    add(f"cameras.json {name}", "capture", cameras(change), REGISTER, said)
add("cameras.json nested", "capture", lambda f: (f / "cameras.json").write_text(DEEP), REGISTER, "nested too deeply")


def keypoints(value):
    written = value if isinstance(value, str) else json.dumps(value)
    return lambda folder: (folder / FRAME / "keypoints.json").write_text(written)


for name, value in [
    ("nested", DEEP),
    ("a list", []),
    ("no points", {"names": ["nose"]}),
    ("points text", {"names": ["nose"], "points": {"cam00": "here"}}),
    ("too few", {"names": ["nose", "neck"], "points": {"cam00": [[1, 2, 1]]}}),
    ("ragged", {"names": ["nose"], "points": {"cam00": [[1, 2]]}}),
    ("nan", {"names": ["nose"], "points": {"cam00": [[NAN, 2, 1]]}}),
    ("infinite", {"names": ["nose"], "points": {"cam00": [[1, INF, 1]]}}),
    ("huge numbers", '{"names": ["nose"], "points": {"cam00": [[1' + "0" * 400 + ", 1, 1]]}}"),
    ("longest numbers", '{"names": ["nose"], "points": {"cam00": [[1' + "0" * 5000 + ", 1, 1]]}}"),
    ("no such camera", {"names": ["nose"], "points": {"cam99": [[1, 2, 1]]}}),
    ("deep rows", {"names": ["nose"], "points": {"cam00": json.loads("[" * 500 + "]" * 500)}}),
]:
    add(f"keypoints.json {name}", "capture", keypoints(value), REGISTER, "keypoints.json")


def ply(vertices=3, faces="3 0 1 2", at="0 0 0", count=None):
    head = f"ply\nformat ascii 1.0\nelement vertex {count or vertices}\nproperty float x\nproperty float y\nproperty float z\n"
    body = f"{at}\n1 0 0\n0 1 1\n" + faces + "\n"
    written = (
        head + f"element face {len(faces.splitlines())}\nproperty list uchar int vertex_indices\nend_header\n" + body
    )
    return lambda folder: (folder / FRAME / "scan.ply").write_text(written)


for name, spoil in [
    ("nan", ply(at="nan 0 0")),
    ("infinite", ply(at="inf 0 0")),
    ("index beyond", ply(faces="3 0 1 9")),
    ("index negative", ply(faces="3 0 1 -1")),
    ("no face", ply(faces="")),
    ("too small", ply(at="0.9 0.1 0.1\n0.95 0.1 0.1")),
    ("a claim of many vertices", ply(count=10**12)),
    ("kilometres", ply(at="9000 0 0")),
]:
    add(f"scan.ply {name}", "capture", spoil, REGISTER, "scan.ply")


def image(kind, path, **options):
    def spoil(folder):
        old = Image.open(folder / FRAME / path)
        made = options.get("mode", old.mode)
        size = options.get("size", old.size)
        Image.new(made, size).save(folder / FRAME / path, kind)

    return spoil


add("image a BMP", "capture", image("BMP", "images/cam00.jpg"), REGISTER, "cam00.jpg")
add("image a TIFF", "capture", image("TIFF", "images/cam00.jpg"), REGISTER, "cam00.jpg")
add("image small", "capture", image("JPEG", "images/cam00.jpg", size=(8, 8)), REGISTER, "cam00.jpg")
add("image a bomb", "capture", image("PNG", "images/cam00.jpg", size=(20_000, 9_000), mode="1"), REGISTER, "cam00.jpg")
add("mask of colours", "capture", image("PNG", "masks/cam00.png", mode="RGB"), REGISTER, "cam00.png")
add("labels of colours", "capture", image("PNG", "labels/cam00.png", mode="RGB"), REGISTER, "cam00.png")


def unknown_label(folder):
    path = folder / FRAME / "labels" / "cam00.png"
    Image.fromarray(np.full_like(np.asarray(Image.open(path)), 77)).save(path)


def strange_picture(folder):
    (folder / FRAME / "images" / "cam99.jpg").write_bytes((folder / FRAME / "images" / "cam00.jpg").read_bytes())


def a_file_of_images(folder):
    shutil.rmtree(folder / FRAME / "images")
    (folder / FRAME / "images").touch()


add("images a file", "capture", a_file_of_images, REGISTER, "images: not a folder")
add("labels unknown", "capture", unknown_label, REGISTER, "cam00.png", "77")
add("image of no camera", "capture", strange_picture, REGISTER, "cam99")

for name, lines, said in [
    ("words", "v a b c\n", "line 1"),
    ("nan", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "line 1"),
    ("index zero", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 2 3\n", "line 4"),
    ("index huge", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n", "line 4"),
    ("index before", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9\n", "line 4"),
    ("closed", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n", "open loops"),
    ("uv nan", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt nan 0\nf 1/1 2/1 3/1\n", "line 4"),
    ("uv outside", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 3 0\nf 1/1 2/1 3/1\n", "UV 0"),
    ("uv index", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/7\n", "line 5"),
    ("vertex twice", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 2\n", "face 0"),
]:
    spoil = lambda folder, lines=lines: (folder / "templates" / "tube.obj").write_text(lines)
    add(f"template {name}", "capture", spoil, REGISTER, "tube.obj", said)


def archive(path, **changes):
    """Arrays of a .npz changed; None removes one."""

    def spoil(folder):
        arrays = dict(np.load(folder / path))
        for name, value in changes.items():
            arrays.pop(name, None) if value is None else arrays.update({name: value})
        np.savez(folder / path, **arrays)

    return spoil


for name, changes in [
    ("pickled", {"v_template": np.array([{}], object)}),
    ("no faces", {"f": None}),
    ("faces beyond", {"f": np.full((4, 3), 10**6)}),
    ("nan", {"J": np.full((2, 3), NAN)}),
    ("parents a circle", {"parents": np.array([1, 0])}),
    ("text", {"v_template": np.array(["x"])}),
    ("correctives", {"posedirs": np.ones((3, 3))}),
]:
    add(f"body {name}", "capture", archive("body.npz", **changes), REGISTER, "body.npz")

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
for name, old, new in [
    ("channel", "Zrotation", "Wrotation"),
    ("time inf", "Frame Time: 0.033", "Frame Time: inf"),
    ("frames", "Frames: 2", "Frames: 900000000000"),
    ("numbers", "0.0 0.0", "zero 0.0"),
]:
    add(f"motion.bvh {name}", "motion", text("motion.bvh", old, new), BVH, "motion.bvh")


# Runs, avatars and their folders ---------------------------------------------------------------------------------


def written(path, value):
    return lambda folder: (folder / path).write_text(value if isinstance(value, str) else json.dumps(value))


def changed(path, change):
    """A JSON file, loaded, changed and written."""

    def spoil(folder):
        data = json.loads((folder / path).read_text())
        change(data)
        (folder / path).write_text(json.dumps(data))

    return spoil


def nothing(folder):
    pass


for name, spoil in [
    ("no capture", written("config.toml", "frames = [0]\n")),
    ("capture a number", written("config.toml", "capture = 3\n")),
    ("capture gone", written("config.toml", 'capture = "/nowhere/at/all"\n')),
    ("capture null", written("config.toml", 'capture = "a\\u0000b"\n')),
    ("nested", written("config.toml", f"capture = {DEEP}\n")),
]:
    for command in (EVALUATE, REPORT, ALIGN, TRAIN):
        said = "nowhere" if "gone" in name else "config.toml"
        add(f"config.toml {name} {command[0]}", "run", spoil, command, said)
add(
    "register into a garbled run",
    "run",
    written("config.toml", "capture = ["),
    ("register", SAMPLE, "IN"),
    "config.toml",
)
add("register into a capture", "capture", nothing, ("register", "IN", "IN"), "holds no run")
add("register into a file", "capture", nothing, ("register", "IN", "IN/scene.toml"), "scene.toml")
add("register below a file", "capture", nothing, ("register", "IN", "IN/scene.toml/run"), "scene.toml")
add("register into no file system", "capture", nothing, ("register", "IN", "/proc/run"), "/proc/run")
add("register into a long name", "capture", nothing, ("register", "IN", "x" * 300), "xxx")
add("register nothing", "capture", nothing, ("register", "IN/nothing", "OUT"), "nothing")
add("register a file", "capture", nothing, ("register", "IN/scene.toml", "OUT"), "scene.toml")
add("plan a pipe", "capture", lambda f: piped(f / "pipe"), ("plan", "IN/pipe"), "pipe")
add("frames missing", "capture", lambda f: (f / FRAME).rename(f / "frames" / "first"), REGISTER, "no frames")
add("frames a file", "capture", lambda f: (f / FRAME).rename(f / "x") and made_a_file(f / FRAME), REGISTER, "no frames")
for command in (EVALUATE, REPORT, ALIGN, TEMPLATE, TRAIN):
    gone = lambda folder: (folder / "registered.zarr").rename(folder / "elsewhere")
    add(f"no store {command[0]}", "run", gone, command, "registered.zarr")
    add(f"no run {command[0]}", "run", nothing, (command[0], "IN/nothing", *command[2:]), "nothing")
add("report into a file", "run", nothing, (*REPORT, "--out", "IN/config.toml/page.html"), "config.toml", slow=True)
add("report into no file system", "run", nothing, (*REPORT, "--out", "/proc/page.html"), "/proc", slow=True)
add("template below a file", "run", nothing, (*TEMPLATE[:2], "IN/config.toml/x.obj", *TEMPLATE[3:]), "config.toml")
add("template of no label", "run", nothing, (*TEMPLATE[:-1], "cape"), "--label cape")
add("align into its run", "run", nothing, ("align", "IN", "IN"), "folder of its own")
add(
    "align into a folder of others", "run", lambda f: (f / "x").mkdir(), ("align", "IN", "IN/registered.zarr"), "no run"
)

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
]:
    add(f"avatar {path} {name}", "avatar", archive(f"assets/{path}.npz", **changes), ANIMATE, f"{path}.npz")


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
