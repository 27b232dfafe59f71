"""Captures of other poses than the bundled one's, and of garments cut otherwise: scans with labels, keypoints of eight cameras
and the truth, for what `toile register` makes of people who cross their arms or wear a dress."""

import json
import shutil

import numpy as np
import zarr
from scipy.spatial.transform import Rotation

from toile import kernels
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.io.mesh import read_mesh
from toile.scene import Mesh
from toile.surface.transfer import transfer_skin

from .pipeline_captures import SAMPLE, SHIRT

CHILD = {"upperarm01": "lowerarm01", "lowerarm01": "wrist", "upperleg01": "lowerleg01", "lowerleg01": "foot"}
CROSSED = {"upperarm01.L": (0.35, -0.45, -0.8), "lowerarm01.L": (-0.85, -0.5, 0.15),
           "upperarm01.R": (-0.35, -0.4, -0.85), "lowerarm01.R": (0.85, -0.3, 0.0)}  # fmt: skip
POCKETS = {"upperarm01.L": (0.3, 0.1, -0.95), "lowerarm01.L": (-0.1, -0.3, -0.95),
           "upperarm01.R": (-0.3, 0.1, -0.95), "lowerarm01.R": (0.1, -0.3, -0.95)}  # fmt: skip
CURLED = {"upperleg01.L": (0.15, -0.9, 0.35), "lowerleg01.L": (0.0, 0.25, -0.95), "upperleg01.R": (-0.15, -0.9, 0.35),
          "lowerleg01.R": (0.0, 0.25, -0.95), "upperarm01.L": (0.4, -0.8, -0.4), "lowerarm01.L": (-0.5, -0.8, -0.2),
          "upperarm01.R": (-0.4, -0.8, -0.4), "lowerarm01.R": (0.5, -0.8, -0.2)}  # fmt: skip


def front(V):
    """Of a shirt, where a jacket is open."""
    return (np.abs(V[:, 0]) < 0.03) & (V[:, 1] < -0.02)


def posed(directions, bend=0.0, hidden=(), bare=None, also=(), skirt=0.0):
    """Two frames on the way into a pose: limbs that point along `directions` {joint: (3,)}, the spine bent forward by
    `bend` [rad]. `hidden` segments are missing in the scans. The garment: a shirt, without the vertices of `bare(rest
    vertices)` (g,), with what carries the labels `also`, its hem drawn down by `skirt` [m]."""

    def change(capture):
        model, shirt, known = (
            load_body_model("anny"),
            read_mesh(SAMPLE / "templates" / "tshirt.obj"),
            open_capture(SAMPLE),
        )
        skin = transfer_skin(model, shirt.vertices, shirt.faces, 10)
        shirt, skin = _with_skirt(shirt, skin, skirt) if skirt else (shirt, skin)
        label = zarr.open_group(str(SAMPLE / "truth" / "truth.zarr"), mode="r")["labels"][:]
        worn = shirt.faces if bare is None else shirt.faces[~bare(shirt.vertices)[shirt.faces].any(1)]
        gone = np.concatenate([[], *(model.segments[name] for name in hidden)]).astype(int)
        shutil.rmtree(capture / "frames")
        shutil.rmtree(capture / "truth")
        made = []
        for number, share in enumerate((0.7, 1.0)):
            rotations = share * _rotations(model, directions, bend)
            made.append(_skinned(model, shirt.vertices, skin, rotations))
            folder = capture / "frames" / f"{number:06d}"
            folder.mkdir(parents=True)
            body, cloth, joints = made[-1]
            _write_points(folder / "keypoints.json", model, body, joints, known.cameras, number)
            shown = model.f[~np.isin(model.f, gone).any(1)]
            ids = np.concatenate([np.where(np.isin(label, also), SHIRT, label)[shown[:, 0]], np.full(len(worn), SHIRT)])
            outer = Mesh(np.concatenate([body, cloth]), np.concatenate([shown, worn + len(body)]).astype(np.int32))
            _write_scan(folder / "scan.ply", outer, ids, np.random.default_rng(number))
        _write_truth(capture / "truth" / "truth.zarr", model, label, made, worn, also)

    return change


def _with_skirt(shirt, skin, length, rings=30):
    """The shirt with a skirt of `length` [m] under its hem, which widens by half and hangs from the hem's joints."""
    hem = min(kernels.boundary_loops(shirt.faces), key=lambda loop: shirt.vertices[loop, 2].mean())
    V, W, F, above, n = [shirt.vertices], [skin], [shirt.faces], hem, len(shirt.vertices)
    middle, hanging = shirt.vertices[hem].mean(0), np.broadcast_to(skin[hem].mean(0), skin[hem].shape)
    for k in range(1, rings + 1):
        share = k / rings
        ring = middle + (shirt.vertices[hem] - middle) * [1 + 0.5 * share, 1 + 0.5 * share, 1] - [0, 0, length * share]
        below = n + np.arange(len(hem))
        a, b, c, d = above, np.roll(above, -1), np.roll(below, -1), below
        F += [np.stack([b, a, d], 1), np.stack([b, d, c], 1)]
        V, W, above, n = [*V, ring], [*W, hanging], below, n + len(hem)
    return Mesh(np.concatenate(V), np.concatenate(F).astype(np.int32)), np.concatenate(W)


def _rotations(model, directions, bend):
    R, r = [], np.zeros((len(model.J), 3))
    for k, p in enumerate(model.parents):
        parent, name = (np.eye(3) if p < 0 else R[p]), model.joint_names[k]
        own = np.eye(3)
        if name in directions:
            stem, side = name.split(".")
            rest = model.J[model.joint(f"{CHILD[stem]}.{side}")] - model.J[k]
            turn = Rotation.align_vectors([directions[name]], [rest])[0].as_matrix()
            own = parent.T @ turn
        elif name.startswith("spine"):
            own = Rotation.from_euler("x", bend / 5).as_matrix()
        r[k] = Rotation.from_matrix(own).as_rotvec()
        R.append(parent @ own)
    return r


def _skinned(model, rest, skin, rotations):
    R, x = model.joint_transforms(model.J, rotations, np.zeros(3))
    offset = x - np.einsum("kij,kj->ki", R, model.J)
    cloth = np.einsum("gk,kij,gj->gi", skin, R, rest) + skin @ offset
    return model.skin(model.v_template, model.J, rotations, np.zeros(3)), cloth, x


def _write_points(path, model, body, joints, cameras_, seed):
    rng, places = np.random.default_rng(seed), model.keypoints(body, joints)
    points = {}
    for name, camera in cameras_.items():
        at = camera.project(places)[0] + rng.normal(0, 2, (len(places), 2))
        inside = ((at >= 0) & (at < camera.size[::-1])).all(1)
        points[name] = np.c_[np.where(inside[:, None], at, 0), inside * 0.9].tolist()
    path.write_text(json.dumps({"names": list(model.keypoint_names), "points": points}))


def _write_scan(path, outer, ids, rng):
    """What is seen of a surface from without, by Poisson, with the labels of the nearest faces."""
    import trimesh

    from toile.studio.scans import scan

    V, F = scan(outer, 20_000, 0.001, 0.02, rng)
    mesh = trimesh.Trimesh(V, F, process=False)
    mesh.face_attributes["label"] = ids[outer.index.closest(V[F].mean(1).astype(float))[0]].astype(np.uint8)
    mesh.export(path)


def _write_truth(path, model, label, made, worn, also):
    group = zarr.open_group(str(path), mode="w", zarr_format=3)
    group.attrs["joint_names"] = list(model.joint_names)
    bodies, cloths, joints = (np.array(part) for part in zip(*made))
    more = model.f[np.isin(label, also)[model.f].all(1)] + cloths.shape[1]
    arrays = {
        "frames": np.arange(len(made)), "labels": label, "joints": joints, "body/vertices": bodies, "body/faces": model.f,
        "garment/tshirt/vertices": np.concatenate([cloths, bodies], 1), "garment/tshirt/faces": np.concatenate([worn, more]),
    }  # fmt: skip
    for name, values in arrays.items():
        group.create_array(name, data=np.ascontiguousarray(values))
