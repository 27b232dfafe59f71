"""How hard the truth is: what a capture of the studio does that the pipeline does not expect, each part by itself."""

from __future__ import annotations

from ..config import Settings, setting


class Hard(Settings):
    """Amounts; 0 or false leaves that part as the plain truth has it."""

    surface: float = setting(
        0.009, "m", "distance of the body from the best shape and pose of the model, mean over torso and limbs", ge=0,
        le=0.015,
    )  # fmt: skip
    joints: float = setting(0.0035, "m", "distance of the joints from the model's, 0.6 to 1.4 x this", ge=0, le=0.01)
    bulge: float = setting(0.005, "m", "of muscles at bent joints, 0.6 to 1.6 x this", ge=0, le=0.01)
    breath: float = setting(0.005, "m", "depth of a breath at the chest, every 3 s", ge=0, le=0.02)
    lasting_labels: bool = setting(True, "switch", "label errors keep their place on the surface over frames")
    keypoint_bias: float = setting(3.0, "px", "lasting error a keypoint and a view, half of it on hands and face", ge=0)
    hand_drops: float = setting(
        0.15, "1", "of the views of a hand: all its keypoints are missing for a while", ge=0, le=1
    )
    hand_swaps: float = setting(0.05, "1", "of the views: left and right hand are exchanged for a while", ge=0, le=1)
    floor: bool = setting(True, "switch", "scans have a piece of floor")
    clutter: int = setting(5, "count", "pieces beside the person in a scan", ge=0, le=100)
    webs: bool = setting(True, "switch", "scans have skins between arm and trunk")
    shoulders: bool = setting(True, "switch", "scans lack the tops of the shoulders")
    templates: bool = setting(True, "switch", "garment templates were never the true garment, see template")


PARTS = tuple(Hard.model_fields)
PLAIN = Hard(**{name: type(field.default)(0) for name, field in Hard.model_fields.items()})


def chosen(truth: str, amounts: Hard) -> Hard:
    """The amounts of a truth: "plain", "hard", or parts of it joined by "+"; the others are left plain. KeyError: the
    part that there is not."""
    if truth == "hard":
        return amounts
    parts = () if truth == "plain" else truth.split("+")
    asked = amounts.model_dump()
    return Hard(**PLAIN.model_dump() | {part: asked[part] for part in parts})
