"""What joints are called: names of other skeletons (SMPL, game engines, BVH) as roles, which are the packaged model's own
joint names ("upperarm01.L"), so that one table of spreads, one list of hands and one retargeting serve them all."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import Any

OWN = re.compile(
    r"(root|head|spine0\d|neck0\d)"
    r"|(pelvis|upperleg0\d|lowerleg0\d|foot|toe\d-\d|clavicle|shoulder01|upperarm0\d|lowerarm0\d|wrist|eye"
    r"|metacarpal\d|finger\d-\d)\.[LR]"
)
MIDDLE = {  # role -> names, the preferred first; lower case, letters and digits alone
    "root": ("hips", "hip", "pelvis", "root"),
    "spine04": ("spine", "lowerback", "abdomen", "spine01"),
    "spine02": ("spine1", "chest", "spine2", "spine02"),
    "neck01": ("neck1", "neck", "neck01"),
    "head": ("head",),
    "jaw": ("jaw",),
}
BONES = {  # of either side, in skeletons that name bones
    "clavicle": ("shoulder", "collar", "clavicle"),
    "upperarm01": ("arm", "shldr", "upperarm"),
    "lowerarm01": ("forearm", "lowerarm"),
    "wrist": ("hand", "wrist"),
    "upperleg01": ("upleg", "thigh", "upperleg"),
    "lowerleg01": ("shin", "lowerleg", "calf", "leg"),
    "foot": ("foot",),
    "toe1-1": ("toebase", "toe", "toes", "ball"),
    "eye": ("eye", "eyesmplhf"),
}
# beside one of these a "leg" is the thigh; below another thigh it is the shank, and what is called so its twist
SHANKS = BONES["lowerleg01"][:-1]
LIMBS = {  # of either side, in skeletons that name the joints between bones, as SMPL does
    "clavicle": ("collar", "clavicle"),
    "upperarm01": ("shoulder",),
    "lowerarm01": ("elbow",),
    "wrist": ("wrist",),
    "upperleg01": ("hip",),
    "lowerleg01": ("knee",),
    "foot": ("ankle",),
    "toe1-1": ("foot", "toe", "toes"),
    "finger": ("hand",),
    "eye": ("eye", "eyesmplhf"),
}
FAMILIES = (  # roles of joints that no list names
    ("finger", r"thumb|index|middle|ring\d|pinky|little|finger"),
    ("toe", r"toe"),
    ("spine", r"spine|chest"),
    ("neck", r"neck"),
)
SIDES = (
    re.compile(r"(?P<side>left|right)[\W_]*(?P<stem>.+)", re.I),
    re.compile(r"(?P<side>[lr])[\W_]+(?P<stem>.+)", re.I),
    re.compile(r"(?P<side>[LRlr])(?P<stem>[A-Z].*)"),
    re.compile(r"(?P<stem>.+?)[\W_]+(?P<side>left|right|[lr])", re.I),
)


def joint_roles(names: Sequence[str]) -> tuple[str, ...]:
    """A role for each of the joints' names (K,), parents first: of those in MIDDLE, BONES and LIMBS every role goes to one joint; a finger,
    toe, spine or neck besides is called so; what is not known keeps its own name. Sided roles end in ".L" or ".R". What stands before
    every name, as "Character1_", counts where no hips are found with it."""
    spelled = [name.rpartition(":")[2] for name in names]
    roles, bare = _roles(spelled, names), _roles(_without_prefix(spelled), names)
    return bare if "root" in bare and "root" not in roles else roles


def _without_prefix(names: list[str]) -> list[str]:
    """Names less what all of them, but perhaps the first, begin with up to a space or sign."""
    prefix = re.match(r".*[\W_]|", os.path.commonprefix(names[1:]))[0]  # type: ignore[index]
    return [name.removeprefix(prefix) for name in names]


def _roles(spelled: list[str], names: Sequence[str]) -> tuple[str, ...]:
    """Roles of joints that are spelled so; their names where that tells none."""
    split = [_split(word) for word in spelled]
    stems = {stem for stem, side in split if side}
    sided = LIMBS if stems & {"elbow", "knee"} else BONES
    words_of = {own: sided | _legs([stem for stem, side in split if side == own]) for own in "LR"}
    roles = [word if OWN.fullmatch(word) else None for word in spelled]
    if "root" in roles and {("hips", ""), ("hip", ""), ("pelvis", "")}.intersection(split):
        roles[roles.index("root")] = "ground"  # of game engines: it stays where the person started
    wanted = [(role, words, "") for role, words in MIDDLE.items()]
    wanted += [(f"{role}.{side}", words, side) for side in "LR" for role, words in words_of[side].items()]
    for role, words, side in wanted:
        if role in roles:
            continue
        at = next((split.index((word, side)) for word in words if (word, side) in split), None)
        if at is not None and roles[at] is None:
            roles[at] = role
    return tuple(role or _family(*parts) or name for role, parts, name in zip(roles, split, names))


def _legs(stems: list[str]) -> dict[str, tuple[str, ...]]:
    """What thigh or shank is called on a side where these are names, parents first, and "leg" may be either; {} where it is the shank
    alone, or what a thigh hangs from."""
    if "leg" not in stems or not set(stems).intersection(SHANKS):
        return {}
    thighs = [i for i, stem in enumerate(stems) if stem in BONES["upperleg01"]]
    if not thighs:
        return {"upperleg01": ("leg",)}
    return {"lowerleg01": ("leg", *SHANKS)} if thighs[0] < stems.index("leg") else {}


def _split(name: str) -> Any:
    """A name's stem in lower case, letters and digits alone, and its side, "L", "R" or ""."""
    for pattern in SIDES:
        match = pattern.fullmatch(name)
        if match:
            return _plain(match["stem"]), match["side"][0].upper()
    plain = _plain(name)
    known = {word for table in (BONES, LIMBS) for words in table.values() for word in words}
    return (plain[1:], plain[0].upper()) if plain[:1] in ("l", "r") and plain[1:] in known else (plain, "")


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name.lower())


def _family(stem: str, side: str) -> Any:
    found = next((role for role, words in FAMILIES if re.search(words, stem)), None)
    return found and (f"{found}.{side}" if side else found)
