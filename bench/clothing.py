"""Clothing problems from studio frames: the T-shirt's template, posed by a skeleton, to the scan's faces of the shirt.

python -m bench.clothing OUT [--capture data_samples/tshirt-talk] [--frames 0,3]    -> OUT/shirt_FRAME.npz

src_v is the template, 3 % too large, skinned in the true pose and carried from the mean body to the true one, as a good
body fit leaves it; tgt_v, tgt_f the scan's faces nearest to the shirt; gt_v where the template's vertices truly are;
clean_v, clean_f the true shirt; ext every vertex. Correspondence inside a shirt is weakly determined: read `surf`
beside `mean`.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from .person import largest_part
from .problems import compact

REACH = 0.05  # m: body displacements are averaged over this reach


def make(capture, number):
    """One frame of an opened capture that has truth, as a dict of arrays."""
    import igl
    import zarr

    from toile.io.body import load_body_model
    from toile.kinematics import blend_skinning
    from toile.surface.transfer import move_with_body

    truth = zarr.open_group(str(capture.root / "truth" / "truth.zarr"), mode="r")
    row = int(np.flatnonzero(truth["frames"][:] == number)[0])
    garment = truth["garment/tshirt"]
    shirt, F = garment["vertices"][row].astype(np.float64), garment["faces"][:].astype(np.int64)
    body, body_F = truth["body/vertices"][row].astype(np.float64), truth["body/faces"][:].astype(np.int64)
    template = capture.templates["tshirt"]
    gt = np.einsum("gk,gki->gi", garment["map_bary"][:], shirt[F[garment["map_face"][:]]])
    model = load_body_model("anny", up=capture.scene.up)
    near = cKDTree(model.v_template).query(template.vertices)[1]
    pose = truth["pose/rotations"][row], truth["pose/translation"][row]
    R, x = model.joint_transforms(model.J, *pose)
    posed = blend_skinning(template.vertices, model.J, R, x, model.weights_idx[near], model.weights_val[near])
    src = move_with_body(posed, model.skin(model.v_template, model.J, *pose), body, REACH)
    scan = capture.frame(number).scan
    centre = scan.vertices[scan.faces].mean(1)
    to_shirt, to_body = (igl.point_mesh_squared_distance(centre, *s)[0] for s in ((shirt, F), (body, body_F)))
    cloth = to_shirt < to_body
    tgt_v, tgt_f = compact(scan.vertices, scan.faces[cloth])
    return dict(src_v=src, src_f=template.faces, gt_v=gt, ext=np.ones(len(gt), bool), hand=np.zeros(len(gt), bool),
                tgt_v=tgt_v, tgt_f=tgt_f.astype(np.int32), clean_v=shirt, clean_f=F.astype(np.int32))  # fmt: skip


def pushed(folder, depth, number=0):
    """An untangling problem: a frame's true shirt pushed `depth` [m] along its normals into the true body."""
    import zarr

    from toile.kernels import vertex_normals

    truth = zarr.open_group(str(Path(folder) / "truth" / "truth.zarr"), mode="r")
    V, F = truth["garment/tshirt/vertices"][number].astype(np.float64), truth["garment/tshirt/faces"][:]
    body, body_F = truth["body/vertices"][number].astype(np.float64), truth["body/faces"][:]
    skin = largest_part(body_F, len(body)).astype(np.int32)
    return dict(cloth_v=V - depth * vertex_normals(V, F), cloth_f=F, body_v=body, body_f=skin)


def main():
    from toile.io.capture import open_capture

    parse = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parse.add_argument("out", type=Path)
    parse.add_argument("--capture", default="data_samples/tshirt-talk")
    parse.add_argument("--frames", default="0,3")
    arguments = parse.parse_args()
    write(arguments.out, open_capture(arguments.capture), [int(n) for n in arguments.frames.split(",")])


def write(out, capture, numbers):
    out.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        np.savez_compressed(out / f"shirt_{number:03d}.npz", **make(capture, number))


if __name__ == "__main__":
    main()
