"""Registers a performance whose meshes share one topology as if it did not: frame 0 becomes the body model, the later
frames become scans of another connectivity, permuted, with holes, and what comes out is compared with what was known.

    python apps/crane.py FOLDER_WITH_mesh_*.obj OUT
"""

import argparse
import json
from pathlib import Path

import numpy as np

from toile import kernels
from toile.config import preset
from toile.console import progress_bars
from toile.io.body import load_body_model
from toile.io.mesh import read_mesh, write_mesh
from toile.io.run import open_run
from toile.pipeline.run import register
from toile.scene import Frame, Mesh
from toile.stages.track import Tracker, prepare

UP, FPS, SCAN_FACES, HOLES = "y", 15, 16000, 0.05
HOLE_RADIUS = (0.015, 0.05)  # m


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    paths = sorted(args.meshes.glob("mesh_*.obj"))
    truth = [read_mesh(path) for path in paths]
    capture = args.out / "capture"
    write_capture(capture, truth, np.random.default_rng(args.seed))
    with progress_bars() as progress:
        outcome = register(capture, args.out / "run", preset("standard"), progress=progress)
    print(json.dumps(compare(args.out / "run", truth) | {"failed": outcome.failed}, indent=1))


def write_capture(folder, truth, rng):
    """scene.toml, the body model made of frame 0, and one scan a later frame."""
    folder.mkdir(parents=True)
    (folder / "scene.toml").write_text(
        f'[scene]\nname = "crane"\nfps = {FPS}\nunits = "m"\nup = "{UP}"\n\n[body]\nmodel = "body.npz"\n',
        encoding="utf-8",
    )
    write_body_model(folder / "body.npz", truth[0])
    for number, mesh in enumerate(truth[1:], 1):
        frame = folder / "frames" / f"{number:06d}"
        frame.mkdir(parents=True)
        write_mesh(frame / "scan.ply", Mesh(*scan(mesh, rng)))


def write_body_model(path, mesh):
    """Frame 0 as the rest shape; joints and skinning weights from the packaged body fitted to it."""
    body = load_body_model("anny", up=UP)
    frame = Frame(0, mesh, None, {}, {}, {})
    settings = preset("standard").track
    person, _ = prepare(body, [(frame, None)], settings)
    tracked = Tracker(body, person, settings).track(frame, None)
    _, J = body.joint_transforms(person.J, tracked.rotations, tracked.translation)
    dense = np.zeros((len(body.v_template), len(body.parents)))
    np.put_along_axis(dense, np.asarray(body.weights_idx, np.int64), body.weights_val, axis=1)
    face, _, bary, _ = kernels.SurfaceIndex(tracked.vertices, body.f).closest(mesh.vertices)
    weights = np.einsum("nc,nck->nk", bary, dense[body.f[face]])
    np.savez_compressed(
        path, v_template=mesh.vertices, f=mesh.faces, parents=body.parents, J=J,
        weights=weights / weights.sum(1, keepdims=True), joint_names=np.array(body.joint_names),
    )  # fmt: skip


def scan(mesh, rng):
    """Another connectivity (points drawn on the surface, Poisson, decimated), holes, and vertices in random order."""
    from toile.studio.scans import cut_holes, poisson

    pick, bary = sample(mesh, 60_000, rng)
    points = np.einsum("kc,kci->ki", bary, mesh.vertices[mesh.faces[pick]])
    normals = kernels.vertex_normals(mesh.vertices, mesh.faces)
    V, F = poisson(points, np.einsum("kc,kci->ki", bary, normals[mesh.faces[pick]]), SCAN_FACES)
    used, F = np.unique(cut_holes(V, F, HOLES, rng), return_inverse=True)
    order = rng.permutation(len(used))
    place = np.argsort(order)
    return V[used][order].astype(np.float32), place[F.reshape(-1, 3)].astype(np.int32)


def sample(mesh, count, rng):
    """Points drawn evenly by area: faces (k,) and barycentric coordinates (k,3)."""
    area = kernels.face_areas(mesh.vertices, mesh.faces)
    return rng.choice(len(area), count, p=area / area.sum()), rng.dirichlet(np.ones(3), count)


def compare(run, truth):
    """Mean distance [mm] between registered vertices and the same vertices of the true meshes, a frame and overall."""
    found = open_run(run)
    error = {n: np.linalg.norm(found.track.at(n) - truth[n].vertices, axis=1) for n in found.ok}
    return {
        "correspondence_mm": float(1e3 * np.mean([e.mean() for e in error.values()])),
        "median_mm": float(1e3 * np.median(np.concatenate(list(error.values())))),
        "share_beyond_50_mm": float(np.mean(np.concatenate(list(error.values())) > 0.05)),
        "per_frame_mm": {n: round(float(1e3 * e.mean()), 2) for n, e in error.items()},
    }


if __name__ == "__main__":
    main()
