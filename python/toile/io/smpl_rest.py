"""SMPL's and SMPL-X's joints at rest: those of the mean shapes of their neutral models, as public simulators' humanoids give them.

Metres from the joint above; x left, y up, z front; arms level, palms down. Sources: of SMPL `smpl_humanoid.xml` of
NVlabs/ProtoMotions, its axes turned to these; of SMPL-X and of all fingers `smplx_humanoid.xml` of ZhengyiLuo/Omnigrasp.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..kernels.arrays import Floats
from .smpl import FINGERS, JOINTS

SMPL = {  # left, right, or the middle one
    "hip": ((0.0695, -0.0914, -0.0068), (-0.0677, -0.0905, -0.0043)),
    "knee": ((0.0343, -0.3752, -0.0045), (-0.0383, -0.3826, -0.0089)),
    "ankle": ((-0.0136, -0.3980, -0.0437), (0.0158, -0.3984, -0.0423)),
    "foot": ((0.0264, -0.0558, 0.1193), (-0.0254, -0.0481, 0.1233)),
    "spine1": (-0.0025, 0.1090, -0.0267),
    "spine2": (0.0055, 0.1352, 0.0011),
    "spine3": (0.0015, 0.0529, 0.0254),
    "neck": (-0.0028, 0.2139, -0.0429),
    "head": (0.0052, 0.0650, 0.0513),
    "collar": ((0.0788, 0.1217, -0.0341), (-0.0818, 0.1188, -0.0386)),
    "shoulder": ((0.0910, 0.0305, -0.0089), (-0.0960, 0.0326, -0.0091)),
    "elbow": ((0.2596, -0.0128, -0.0275), (-0.2537, -0.0133, -0.0214)),
    "wrist": ((0.2492, 0.0090, -0.0012), (-0.2553, 0.0078, -0.0056)),
    "hand": ((0.0840, -0.0082, -0.0149), (-0.0846, -0.0061, -0.0103)),
}
SMPLX = {
    "hip": ((0.0582, -0.0928, -0.0260), (-0.0633, -0.1039, -0.0213)),
    "knee": ((0.0547, -0.3788, -0.0094), (-0.0442, -0.3624, -0.0168)),
    "ankle": ((-0.0435, -0.4031, -0.0319), (0.0154, -0.4107, -0.0202)),
    "foot": ((0.0473, -0.0580, 0.1182), (-0.0388, -0.0583, 0.1190)),
    "spine1": (-0.0028, 0.1099, -0.0276),
    "spine2": (0.0094, 0.1319, -0.0059),
    "spine3": (-0.0113, 0.0522, 0.0284),
    "neck": (-0.0122, 0.1652, -0.0316),
    "head": (0.0248, 0.1605, 0.0207),
    "collar": ((0.0464, 0.0849, -0.0072), (-0.0477, 0.0843, -0.0134)),
    "shoulder": ((0.1192, 0.0577, -0.0155), (-0.1026, 0.0535, -0.0127)),
    "elbow": ((0.2541, -0.0722, -0.0425), (-0.2711, -0.0365, -0.0265)),
    "wrist": ((0.2520, 0.0232, -0.0025), (-0.2493, -0.0045, -0.0153)),
}
HAND = {  # of SMPL-H and SMPL-X
    "index1": ((0.1019, -0.0087, 0.0194), (-0.0999, -0.0118, 0.0196)),
    "index2": ((0.0319, 0.0022, 0.0030), (-0.0319, 0.0022, 0.0030)),
    "index3": ((0.0225, -0.0024, 0.0001), (-0.0225, -0.0023, 0.0001)),
    "middle1": ((0.1094, -0.0063, -0.0040), (-0.1074, -0.0094, -0.0037)),
    "middle2": ((0.0306, 0.0008, -0.0040), (-0.0306, 0.0008, -0.0040)),
    "middle3": ((0.0235, -0.0020, -0.0041), (-0.0235, -0.0020, -0.0041)),
    "pinky1": ((0.0840, -0.0145, -0.0437), (-0.0820, -0.0176, -0.0435)),
    "pinky2": ((0.0155, -0.0011, -0.0120), (-0.0155, -0.0011, -0.0120)),
    "pinky3": ((0.0155, -0.0017, -0.0112), (-0.0155, -0.0017, -0.0112)),
    "ring1": ((0.0974, -0.0093, -0.0273), (-0.0954, -0.0124, -0.0271)),
    "ring2": ((0.0280, 0.0015, -0.0053), (-0.0280, 0.0015, -0.0053)),
    "ring3": ((0.0228, -0.0015, -0.0071), (-0.0228, -0.0015, -0.0071)),
    "thumb1": ((0.0406, -0.0180, 0.0256), (-0.0386, -0.0211, 0.0259)),
    "thumb2": ((0.0170, 0.0010, 0.0250), (-0.0170, 0.0010, 0.0250)),
    "thumb3": ((0.0205, -0.0052, 0.0155), (-0.0205, -0.0052, 0.0155)),
}
TABLES: dict[str, dict[str, Any]] = {"smpl": SMPL, "smplh": SMPL | HAND, "smplx": SMPLX | HAND}
ABOVE = {  # the joint above, of the same side or in the middle
    "hip": "pelvis", "knee": "hip", "ankle": "knee", "foot": "ankle", "spine1": "pelvis", "spine2": "spine1",
    "spine3": "spine2", "neck": "spine3", "head": "neck", "collar": "spine3", "shoulder": "collar",
    "elbow": "shoulder", "wrist": "elbow", "hand": "wrist", "jaw": "head", "eye_smplhf": "head",
    **{f"{finger}{i}": f"{finger}{i - 1}" if i > 1 else "wrist" for finger in FINGERS for i in (1, 2, 3)},
}  # fmt: skip
KINDS = {"smpl": 24, "smplh": 52, "smplx": 55}
SIDES = ("left", "right")


def names_of(kind: str) -> tuple[str, ...]:
    """Joints of "smpl", "smplh" or "smplx", in the order of its poses."""
    return JOINTS[KINDS[kind]][1]


def parents_of(names: tuple[str, ...]) -> tuple[int, ...]:
    """The joint above each of these, -1 of the pelvis."""
    found = []
    for name in names:
        side, _, word = name.partition("_")
        above = ABOVE.get(word if side in SIDES else name)
        found.append(-1 if above is None else names.index(f"{side}_{above}" if f"{side}_{above}" in names else above))
    return tuple(found)


def offsets_of(kind: str, names: tuple[str, ...]) -> Floats:
    """(j,3) [m] of these joints of the mean shape from the joints above; 0 of the pelvis, the jaw and the eyes, which end no bone."""
    return np.array([_offset(TABLES[kind], name) for name in names])


def _offset(table: dict[str, Any], name: str) -> Any:
    side, _, word = name.partition("_")
    return table[word][SIDES.index(side)] if word in table else table.get(name, (0.0, 0.0, 0.0))
