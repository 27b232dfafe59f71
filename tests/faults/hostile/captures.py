"""Captures with a spoilt file, or one that says something impossible."""

import json
import shutil

import numpy as np
from PIL import Image

from tests.faults.hostile.cases import DEEP, FRAME, INF, NAN, REGISTER, add, archive, damage, text

damage("capture", "scene.toml", REGISTER, ("halved",))
damage("capture", "cameras.json", REGISTER)
damage("capture", "templates/tube.obj", REGISTER)
damage("capture", "body.npz", REGISTER)
damage("capture", f"{FRAME}/keypoints.json", REGISTER, ("removed",))
damage("capture", f"{FRAME}/scan.ply", REGISTER, ("removed",))
damage("capture", f"{FRAME}/images/cam00.jpg", REGISTER, ("removed",))
damage("capture", f"{FRAME}/labels/cam01.png", REGISTER, ("removed",))
damage("capture", f"{FRAME}/masks/cam02.png", REGISTER, ("removed",))

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
