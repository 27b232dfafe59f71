"""Captures at the edges of what `toile register` may be given, made from the bundled one: spoiled files, other cameras, other
poses. Each function changes a capture's folder; its truth, where it has one, is changed along."""

import json
import shutil
from pathlib import Path

import numpy as np
import zarr
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from toile import kernels
from toile.io.mesh import read_mesh, write_mesh
from toile.scene import Mesh

SAMPLE = Path(__file__).parents[1] / "data_samples" / "tshirt-talk"
KINDS = ("images", "masks", "labels")
SKIN, SHIRT = 1, 3  # label ids of the bundled scene


def bundled(folder):
    return Path(shutil.copytree(SAMPLE, folder))


def frames(capture):
    return sorted((capture / "frames").iterdir())


def cameras(capture, change):
    """`change` [camera tables] -> [camera tables]; the files of those that are gone go too."""
    path = capture / "cameras.json"
    kept = change(json.loads(path.read_text())["cameras"])
    path.write_text(json.dumps({"cameras": kept}))
    names = {camera["name"] for camera in kept}
    for file in (p for f in frames(capture) for kind in KINDS for p in (f / kind).glob("*") if p.stem not in names):
        file.unlink()
    keypoints(capture, lambda points, *_: {name: found for name, found in points.items() if name in names})


def keypoints(capture, change):
    """`change({camera: (k,3)}, rng)` of every frame."""
    rng = np.random.default_rng(0)
    for path in (capture / "frames").glob("*/keypoints.json"):
        table = json.loads(path.read_text())
        points = change({name: np.array(found, float) for name, found in table["points"].items()}, rng)
        table["points"] = {name: np.asarray(found).tolist() for name, found in points.items()}
        path.write_text(json.dumps(table))


def scans(capture, change):
    """`change(Mesh, rng) -> Mesh` of every frame."""
    rng = np.random.default_rng(0)
    for path in sorted((capture / "frames").glob("*/scan.ply")):
        write_mesh(path, change(read_mesh(path), rng))


def template(capture, change):
    """`change(Mesh) -> Mesh`."""
    path = capture / "templates" / "tshirt.obj"
    write_mesh(path, change(read_mesh(path)))


def scene(capture, old, new):
    path = capture / "scene.toml"
    text = path.read_text()
    assert old in text, old
    path.write_text(text.replace(old, new))


# Cameras and pictures -------------------------------------------------------------------------------------------------


def alone(capture):
    """Its first frame alone."""
    for folder in frames(capture)[1:]:
        shutil.rmtree(folder)


def only(count):
    return lambda capture: cameras(capture, lambda all_: all_[:: max(len(all_) // count, 1)][:count])


def sixty(capture):
    """The eight cameras, each seven or eight times."""

    def copies(all_):
        for i in range(8, 60):
            of, name = all_[i % 8]["name"], f"copy{i}"
            for file in list((capture / "frames").glob(f"*/*/{of}.*")):
                shutil.copy(file, file.with_stem(name))
            all_.append({**all_[i % 8], "name": name})
        return all_

    cameras(capture, copies)
    keypoints(capture, lambda points, _: points | {f"copy{i}": points[f"cam{i % 8:02d}"] for i in range(8, 60)})


def pictures_of(size):
    """All pictures resampled to size x size pixels."""

    def change(capture):
        scale = size / 360

        def table(all_):
            for camera in all_:
                camera["width"] = camera["height"] = size
                camera["K"] = (np.diag([scale, scale, 1]) @ camera["K"]).tolist()
            return all_

        cameras(capture, table)
        for path in (p for kind in KINDS for p in (capture / "frames").glob(f"*/{kind}/*")):
            way = Image.Resampling.BILINEAR if path.parent.name == "images" else Image.Resampling.NEAREST
            Image.open(path).resize((size, size), way).save(path)
        keypoints(capture, lambda points, _: {n: p * [scale, scale, 1] for n, p in points.items()})

    return change


def four_of_4096(capture):
    """Four pictures of 4096 x 4096 pixels of the first frame."""
    alone(capture)
    only(4)(capture)
    pictures_of(4096)(capture)


def cropped(capture):
    """Pictures that end above the hem."""
    height = 200

    def table(all_):
        return [{**camera, "height": height} for camera in all_]

    cameras(capture, table)
    for path in (p for kind in KINDS for p in (capture / "frames").glob(f"*/{kind}/*")):
        image = Image.open(path)
        image.crop((0, 0, image.width, height)).save(path)
    keypoints(capture, lambda points, _: {n: np.where(p[:, 1:2] < height, p, [0, 0, 0]) for n, p in points.items()})


def wrong_labels(capture, share=0.3, side=12):
    """Squares of another label, each picture its own."""
    rng = np.random.default_rng(0)
    for path in sorted((capture / "frames").glob("*/labels/*.png")):
        labels = np.array(Image.open(path))
        tiles = rng.uniform(size=(labels.shape[0] // side + 1, labels.shape[1] // side + 1)) < share
        other = rng.integers(1, 6, tiles.shape)
        spread = lambda t: np.kron(t, np.ones((side, side), t.dtype))[: labels.shape[0], : labels.shape[1]]
        Image.fromarray(np.where(spread(tiles) & (labels > 0), spread(other), labels).astype(np.uint8)).save(path)


# Keypoints, scans, frames ---------------------------------------------------------------------------------------------


def outliers(capture, share=0.4):
    def change(points, rng):
        for found in points.values():
            out = (rng.uniform(size=len(found)) < share) & (found[:, 2] > 0)
            found[out] = np.c_[rng.uniform(0, 360, (out.sum(), 2)), np.full(out.sum(), 0.9)]
        return points

    keypoints(capture, change)


def no_keypoints(capture):
    for path in (capture / "frames").glob("*/keypoints.json"):
        path.unlink()


def decimated(count):
    def change(mesh, _):
        import pymeshlab

        work = pymeshlab.MeshSet()
        work.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces))
        work.meshing_decimation_quadric_edge_collapse(targetfacenum=count)
        made = work.current_mesh()
        return Mesh(made.vertex_matrix(), made.face_matrix().astype(np.int32))

    return lambda capture: scans(capture, change)


def two_million(capture):
    import trimesh

    def change(mesh, _):
        V, F = mesh.vertices, mesh.faces
        while len(F) < 2_000_000:
            V, F = trimesh.remesh.subdivide(V, F)
        return Mesh(np.array(V), np.array(F, np.int32))

    scans(capture, change)


def holes(capture, share=0.5):
    def change(mesh, rng):
        centres = mesh.vertices[mesh.faces].mean(1)
        tree, gone = cKDTree(centres), np.zeros(len(centres), bool)
        while gone.mean() < share:
            gone[tree.query_ball_point(centres[rng.integers(len(centres))], rng.uniform(0.02, 0.08))] = True
        return Mesh(mesh.vertices, mesh.faces[~gone])

    scans(capture, change)


def noise(capture, sigma=0.005):
    scans(capture, lambda mesh, rng: Mesh(mesh.vertices + rng.normal(0, sigma, mesh.vertices.shape), mesh.faces))


def beside(capture):
    scans(capture, lambda mesh, _: Mesh(mesh.vertices + [0.3, 0, 0], mesh.faces))


def second_person(capture):
    def change(mesh, _):
        V = np.concatenate([mesh.vertices, mesh.vertices * [-1, 1, 1] + [0.9, 0.2, 0]])
        return Mesh(V, np.concatenate([mesh.faces, mesh.faces[:, ::-1] + len(mesh.vertices)]).astype(np.int32))

    scans(capture, change)


def out_of_step(capture):
    """Frame 1 has the scan of frame 5."""
    shutil.copy(capture / "frames" / "000005" / "scan.ply", capture / "frames" / "000001" / "scan.ply")


def missing(capture):
    """Frame 1 is gone, frame 2 has lost its scan and its keypoints."""
    shutil.rmtree(capture / "frames" / "000001")
    for name in ("scan.ply", "keypoints.json"):
        (capture / "frames" / "000002" / name).unlink()


def turned(axis, angle):
    """The world turned under the person: cameras, scans and truth alike."""

    def change(capture):
        R = Rotation.from_euler(axis, angle, degrees=True).as_matrix()
        T = np.eye(4)
        T[:3, :3] = R.T
        cameras(
            capture, lambda all_: [{**c, "T_camera_world": (np.array(c["T_camera_world"]) @ T).tolist()} for c in all_]
        )
        scans(capture, lambda mesh, _: Mesh(mesh.vertices @ R.T, mesh.faces))
        group = zarr.open_group(str(capture / "truth" / "truth.zarr"), mode="r+")
        for name in ("body/vertices", "joints", "garment/tshirt/vertices", "keypoints"):
            group[name][:] = group[name][:] @ R.T

    return change


# Templates and garments -----------------------------------------------------------------------------------------------


def moved(change):
    return lambda capture: template(capture, lambda m: Mesh(change(m.vertices), m.faces, m.uv, m.face_uv))


def inside_out(capture):
    template(capture, lambda m: Mesh(m.vertices, m.faces[:, ::-1], m.uv, m.face_uv[:, ::-1]))


def remeshed(edge):
    return lambda capture: template(capture, lambda m: Mesh(*kernels.remesh(m.vertices, m.faces, edge)))


def with_button(capture):
    """A closed box on the shirt's front."""

    def change(mesh):
        import trimesh

        box = trimesh.creation.box((0.012, 0.004, 0.012))
        front = mesh.vertices[(np.abs(mesh.vertices[:, 0]) < 0.02) & (mesh.vertices[:, 1] < 0)]
        at = front[np.abs(front[:, 2] - 0.5).argmin()]
        V = np.concatenate([mesh.vertices, np.array(box.vertices) + at - [0, 0.004, 0]])
        return Mesh(V, np.concatenate([mesh.faces, np.array(box.faces) + len(mesh.vertices)]).astype(np.int32))

    template(capture, change)


def not_worn(capture):
    """A coat that some pixels alone are taken for."""
    scene(capture, "shoes = 5", "shoes = 5\ncoat = 6")
    coat = '[[garment]]\nname = "coat"\ntemplate = "templates/tshirt.obj"\nlabel = "coat"\n\n[cameras]'
    scene(capture, "[cameras]", coat)
    rng = np.random.default_rng(0)
    for path in sorted((capture / "frames").glob("*/labels/*.png")):
        labels = np.array(Image.open(path))
        labels[(rng.uniform(size=labels.shape) < 0.01) & (labels == SHIRT)] = 6
        Image.fromarray(labels).save(path)


def not_named(capture):
    text = (capture / "scene.toml").read_text()
    start, end = text.index("[[garment]]"), text.index("[cameras]")
    (capture / "scene.toml").write_text(text[:start] + text[end:])
