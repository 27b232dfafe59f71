"""Sleeves that a web of the scan joins to the trunk: the border of the two runs over both, and is no sleeve's opening."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..kernels.arrays import Bools, Floats
from ..scene import BodyModel
from .loops import LoopMatch, relaid

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

ROOTS = ("clavicle", "shoulder01", "upperarm01")  # the first of these roles that a model has begins the arm
OTHERS = ("neck01", "upperleg01.L", "upperleg01.R")
AWAY = 0.04  # m off its own arm
NEARER = 0.5  # of that distance or less from the trunk: where no sleeve's opening lies


class Sleeves:
    """Arms and trunk of one posed body that openings of sleeves are held against: vertices V (n,3), joints (K,3) [m]. Of models that
    do not name them, and of loops that by their names, of `surface.loop_names`, are no sleeves', nothing is said."""

    def __init__(self, model: BodyModel, V: Floats, joints: Floats):
        self.model, self.V, self.joints = model, V, joints

    def at_trunk(self, name: str, points: Floats) -> Bools | None:
        """Which points (k,3) [m] lie at the trunk, off the arm that the loop of this name is about; None of other loops."""
        opening, _, side = name.partition("_")
        arm = self._arms.get(side) if opening == "sleeve" else None
        if arm is None or self._trunk is None:
            return None
        off = arm[0].query(points)[0]
        there: Bools = (off > AWAY) & (self._trunk.query(points)[0] < NEARER * off)
        return there

    def parted(self, name: str, at: Floats, match: LoopMatch, settings: Any) -> LoopMatch:
        """The LoopMatch of the loop of this name at (k,3), without what of it lies at the trunk: there it moves along the arm only, by as
        much as its seen part does. `settings` are LoopSettings."""
        false = self.at_trunk(name, match.target)
        if false is None or not false.any():
            return match
        seen, axis = match.observed & ~false, self._arms[name.partition("_")[2]][1]
        along = (match.target - at)[seen].mean(0) @ axis if seen.any() else 0.0
        return relaid(at, match, false, at + along * axis, settings)

    @cached_property
    def _arms(self) -> dict[str, tuple[cKDTree, Floats]]:
        """{side: its vertices, and the unit direction (3,) from shoulder to elbow}."""
        arms = {}
        for side in ("left", "right"):
            shoulder, elbow = (self.model.joint(f"{role}.{side[0].upper()}") for role in ("upperarm01", "lowerarm01"))
            if shoulder is not None and elbow is not None:
                axis = self.joints[elbow] - self.joints[shoulder]
                arms[side] = self._tree(self.model.beyond(shoulder)), axis / max(np.linalg.norm(axis), 1e-12)
        return {side: (tree, axis) for side, (tree, axis) in arms.items() if tree is not None}

    @cached_property
    def _trunk(self) -> cKDTree | None:
        if self.model.joint("neck01") is None:
            return None
        trunk = np.ones(len(self.model.parents), bool)
        for names in (*([f"{role}.{side}" for role in ROOTS] for side in "LR"), *([role] for role in OTHERS)):
            first = next((k for k in map(self.model.joint, names) if k is not None), None)
            if first is not None:
                trunk &= ~self.model.beyond(first)
        return self._tree(trunk)

    def _tree(self, joints: Bools) -> cKDTree | None:
        from scipy.spatial import cKDTree

        of = joints[self.model.mover] & ~self.model.inside
        return cKDTree(self.V[of]) if of.any() else None
