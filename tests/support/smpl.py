"""The packaged body under another skeleton: SMPL's 24 joints and names, without segments or keypoints."""

import numpy as np

from toile.io.body import load_body_model

JOINTS = {  # SMPL's joint -> the packaged model's
    "pelvis": "root", "left_hip": "upperleg01.L", "right_hip": "upperleg01.R", "spine1": "spine04",
    "left_knee": "lowerleg01.L", "right_knee": "lowerleg01.R", "spine2": "spine03", "left_ankle": "foot.L",
    "right_ankle": "foot.R", "spine3": "spine02", "left_foot": "toe1-1.L", "right_foot": "toe1-1.R", "neck": "neck01",
    "left_collar": "clavicle.L", "right_collar": "clavicle.R", "head": "head", "left_shoulder": "upperarm01.L",
    "right_shoulder": "upperarm01.R", "left_elbow": "lowerarm01.L", "right_elbow": "lowerarm01.R",
    "left_wrist": "wrist.L", "right_wrist": "wrist.R", "left_hand": "finger3-1.L", "right_hand": "finger3-1.R",
}  # fmt: skip


def smpl_fields():
    """Fields of a model file; each joint of the packaged model goes with the nearest kept one above it."""
    model = load_body_model()
    kept = [model.joint_names.index(name) for name in JOINTS.values()]
    hands = {f"{part}{i}.{side}": kept.index(model.joint(f"finger3-1.{side}")) for side in "LR"
             for part, count in (("finger", 5), ("metacarpal", 5)) for i in range(1, count + 1)}  # fmt: skip
    owner = []
    for k, name in enumerate(model.joint_names):
        stem, _, side = name.partition(".")
        hand = hands.get(f"{stem.split('-')[0]}.{side}")
        while k not in kept:
            k = model.parents[k]
        owner.append(kept.index(k) if hand is None else hand)
    weights = np.zeros((len(model.v_template), len(kept)))
    for idx, val in zip(model.weights_idx.T, model.weights_val.T):
        np.add.at(weights, (np.arange(len(weights)), np.array(owner)[idx]), val)
    wrists = {hand: kept.index(model.joint(f"wrist.{name[-1]}")) for name, hand in hands.items()}
    parents = [-1] + [wrists.get(i + 1, owner[model.parents[k]]) for i, k in enumerate(kept[1:])]
    return {
        "v_template": model.v_template,
        "f": model.f,
        "J": model.J[kept],
        "parents": np.array(parents),
        "weights": weights,
        "joint_names": np.array(list(JOINTS)),
        "up": "z",
    }
