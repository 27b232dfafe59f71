"""Body models of others become body model files, whole or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import UserError
from .body import load_body_model
from .files import replace_file
from .gltf import gltf_fields
from .makehuman import makehuman_fields
from .smpl import smpl_fields

GLTF, RIG = (".glb", ".gltf"), ".json"


def write_body_model(path: Path, out: Path, shapes: int = 10, mesh: Path | None = None) -> str:
    """Writes the body model `out` (.npz) from a file of SMPL's kind, with the first `shapes` of its shape basis, from a rigged
    figure in glTF, or from a rig of MakeHuman's (.json) and its base mesh `mesh`; says what it was. UserError names the file and the field, and leaves nothing behind."""
    if out.suffix != ".npz":
        raise UserError(f"{out}: expected a name that ends in .npz")
    if mesh is not None and path.suffix.lower() != RIG:
        raise UserError(f"{path}: --mesh {mesh}: only a rig of MakeHuman's (.json) takes a mesh beside it")
    if path.suffix.lower() == RIG:
        kind, fields = makehuman_fields(path, mesh)
    else:
        kind, fields = gltf_fields(path) if path.suffix.lower() in GLTF else smpl_fields(path, shapes)

    def write(part: Path) -> None:
        with open(part, "wb") as file:
            np.savez_compressed(file, **fields)
        try:
            load_body_model(part)
        except UserError as error:
            raise UserError(str(error).replace(str(part), str(path))) from None

    replace_file(out, write)
    shaped = fields["shapedirs"].shape[2] if "shapedirs" in fields else 0
    counts = f"{len(fields['v_template'])} vertices, {len(fields['parents'])} joints, {shaped} shapes"
    return f"{kind}: {counts}, {len(fields['keypoint_names'])} keypoints"
