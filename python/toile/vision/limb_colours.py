"""Cloth that a network of labels calls skin: the skin of one person has the colours of head and hands, wherever it is.

A network knows skin by its colours and by where it is; brown trousers look to it like bare legs. What it cannot know is this
person: where the skin of a limb has other colours than that of head and hands, and the scene names what covers the limb, its word is
taken for that garment's. The same where the colours are alike and the scene names what covers the legs for certain.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from ..kernels.arrays import Array, Bools
from ..scene import BodyModel, Frame, Scene
from .colours import ColourModel, counted_colours, lightness_and_chroma
from .visibility import DepthView

REFERENCE = ("head", "hands")  # where cloth is rare
PARTS = {  # of the body, by the roles of joints that skin most of a vertex
    "head": ("head", "jaw", "neck"),
    "hands": ("wrist", "metacarpal", "finger"),
    "upper arms": ("upperarm",),
    "lower arms": ("lowerarm",),
    "upper legs": ("upperleg",),
    "lower legs": ("lowerleg",),
}
LONG = ("trousers", "pants", "jeans", "leggings")  # cover the upper legs, and may cover the lower ones
SHORT = ("shorts", "skirt", "dress")  # a scene that has one of them may show bare upper legs
COVERS = {"upper legs": (*LONG, "shorts", "skirt"), "lower legs": LONG}  # by labels' names, the first that a scene has
WORN = 0.5  # share of a part of the body that is labelled skin, from which it is taken for bare
SEEN_BARE = 0.15  # the same of upper legs by a network, where the scene has trousers: from there on it is in error
COLOUR = 0.08  # of chroma over lightness, by default; bare limbs of one person are up to 0.075 off head and hands
SAMPLES = 60  # of the skin of a part
SURE = 0.8  # certainty from which on a label of head and hands is skin
SPECKS = 0.05  # share of limbs: less that is called skin is nothing to speak of
MOST = 4000  # pixels of a part that are read in a picture
AROUND = 7  # px, over which colours are averaged before a pixel is told


@dataclass(frozen=True)
class LimbCloth:
    """What is cloth of the skin of limbs: `label`, that of skin; `instead` (n,) uint8, the label of what covers a vertex of the
    tracked surface, 0 where skin is skin; `colours` of the two, skin first, None where they are alike; `share` of what is seen of
    these limbs is called skin."""

    label: int
    instead: Array
    colours: ColourModel | None
    share: float

    def words(self, scene: Scene) -> str | None:
        """What is said of it, nothing of specks."""
        if self.share < SPECKS:
            return None
        names = ", ".join(repr(name) for name, label in scene.labels.items() if label in self.instead)
        alike = "look no other than skin, but the scene has them worn"
        why = alike if self.colours is None else "have other colours than head and hands"
        return f"labels: the network calls {100 * self.share:.0f} % of the legs 'skin', which is taken for {names}: they {why}"


def parts_of(model: BodyModel) -> dict[str, Bools]:
    """{part of the body: bool (n,), its vertices}."""
    roles = np.array([role.partition(".")[0].rstrip("0123456789-") for role in model.joint_roles])[model.mover]
    return {part: np.isin(roles, names) for part, names in PARTS.items()}


def odd_parts(colours: Mapping[str, Array], limit: float = COLOUR) -> list[str]:
    """Limbs whose skin has a chroma farther than `limit` from that of head and hands: `colours` {part: RGB (k,3) uint8 of its skin},
    medians count. None where neither head nor hands show enough."""
    chroma = {part: lightness_and_chroma(of)[1] for part, of in colours.items() if len(of) >= SAMPLES}
    middle = {part: np.median(of, axis=0) for part, of in chroma.items()}
    known = [middle.pop(part) for part in REFERENCE if part in middle]
    far = {part: min((float(np.linalg.norm(of - skin)) for skin in known), default=0.0) for part, of in middle.items()}
    return [part for part, distance in far.items() if distance > limit]


def surely_covered(scene: Scene) -> str | None:
    """The label of the scene that covers the upper legs for certain."""
    if any(name in scene.labels for name in SHORT):
        return None
    return next((name for name in LONG if name in scene.labels), None)


def cover_of(scene: Scene, part: str) -> str | None:
    """The scene's label of what covers a part of the body."""
    return next((name for name in COVERS.get(part, ()) if name in scene.labels), None)


def limb_cloth(
    scene: Scene,
    parts: Mapping[str, Bools],
    faces: Array,
    shown: Iterable[tuple[Frame, Mapping[str, DepthView]]],
    limit: float = COLOUR,
) -> LimbCloth | None:
    """Of labelled frames, each with the views of its tracked surface (triangles `faces` (m,3)): what a network took for skin.
    None where there is no such thing, or nothing to tell it by, or the `limit` of colours is 0."""
    asked = [part for part in parts if cover_of(scene, part)]
    if "skin" not in scene.labels or not asked or not limit:
        return None
    seen = _skin_of([*asked, *REFERENCE], scene.labels["skin"], parts, faces, shown)
    if not seen["upper legs"]:
        return None
    odd = odd_parts({part: np.concatenate([s.rgb for s in of]) for part, of in seen.items()}, limit)
    alike = not odd and surely_covered(scene) is not None and _share(seen["upper legs"]) > SEEN_BARE
    cloth = asked if alike else odd
    if not cloth:
        return None
    instead = np.zeros(len(next(iter(parts.values()))), np.uint8)
    for part in cloth:
        instead[parts[part]] = scene.labels[cover_of(scene, part)]
    share = _share([s for part in cloth for s in seen[part]])
    return LimbCloth(scene.labels["skin"], instead, None if alike else _colours(seen, odd), share)


def retold(frame: Frame, views: Mapping[str, DepthView], faces: Array, cloth: LimbCloth) -> Frame:
    """The frame with the labels that its network gave, told again on limbs that `cloth` covers; `views` show its tracked
    surface."""
    labels, covered = dict(frame.labels), cloth.instead[faces].min(1)
    for name in (name for name in views if name in frame.certainty):
        face = views[name].face
        over = np.where(face >= 0, covered[face], 0)
        wrong = (frame.labels[name] == cloth.label) & (over > 0)
        if cloth.colours is not None and wrong.any():
            wrong &= _cloth_rather(frame.images[name], wrong, cloth.colours)
        labels[name] = np.where(wrong, over, frame.labels[name])
    return replace(frame, labels=labels)


def _cloth_rather(image: Any, where: Bools, colours: ColourModel) -> Bools:
    """Pixels (H,W) whose colours, with those around them of `where`, are rather cloth's."""
    odds = np.zeros(where.shape, np.float32)
    odds[where] = np.diff(colours.evidence(image[where]), axis=1)[:, 0]
    return cv2.boxFilter(odds, -1, (AROUND, AROUND)) > 0


@dataclass(frozen=True)
class _Skin:
    """Of a part in a picture: pixels that show it, how many of them are labelled skin, and these pixels' colours."""

    shown: int
    carry: int
    rgb: Array  # (k,3) uint8


def _skin_of(
    names: list[str],
    label: int,
    parts: Mapping[str, Bools],
    faces: Array,
    shown: Iterable[tuple[Frame, Mapping[str, DepthView]]],
) -> dict[str, list[_Skin]]:
    """{part: what each picture with a network's labels shows of it}; of head and hands what is surely skin."""
    on = {part: parts[part][faces].all(1) for part in names}
    found: dict[str, list[_Skin]] = {part: [] for part in names}
    for frame, views in shown:
        for name in (name for name in views if name in frame.certainty and name in frame.images):
            face = views[name].face
            for part in names:
                there = (face >= 0) & on[part][face]
                skin = there & (frame.labels[name] == label)
                if part in REFERENCE:
                    skin &= frame.certainty[name] > 255 * SURE
                at = np.flatnonzero(skin)[:: max(1, int(skin.sum()) // MOST)]
                found[part].append(_Skin(int(there.sum()), int(skin.sum()), frame.images[name].reshape(-1, 3)[at]))
    return found


def _share(skin: list[_Skin]) -> float:
    """Of all that is shown, what is labelled skin."""
    return sum(s.carry for s in skin) / max(sum(s.shown for s in skin), 1)


def _colours(seen: Mapping[str, list[_Skin]], odd: list[str]) -> ColourModel:
    """Of skin, as on head and hands, and of what the odd parts show."""
    rgb = [np.concatenate([s.rgb for part in of for s in seen.get(part, [])]) for of in (REFERENCE, odd)]
    given = np.repeat([0, 1], [len(of) for of in rgb])
    return counted_colours(np.concatenate(rgb), given, np.arange(2))
