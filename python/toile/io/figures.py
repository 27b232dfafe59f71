"""What readers of other programs' rigged figures share: the joints' order, their names, and which of them are keypoints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .body import load_body_model
from .joints import joint_roles


def parents_first(over: Sequence[int]) -> tuple[list[int], Any] | None:
    """An order of joints in which each comes after its parent `over[k]` (-1: none), and the parents (K,) in that order; further
    roots hang on the first. None where a joint is its own ancestor."""
    order: list[int] = []
    while len(order) < len(over):
        ready = [k for k in range(len(over)) if k not in order and (over[k] < 0 or over[k] in order)]
        if not ready:
            return None
        order += ready
    rank = {k: i for i, k in enumerate(order)}
    return order, np.array([-1 if i == 0 else rank.get(over[k], 0) for i, k in enumerate(order)])


def distinct(names: Sequence[str]) -> list[str]:
    """Each once: further ones get a number."""
    return [name if name not in names[:i] else f"{name}_{i}" for i, name in enumerate(names)]


def joint_keypoints(names: Sequence[str]) -> dict[str, Any]:
    """Fields of a body model file: the joints whose roles are keypoints of the packaged model."""
    known = set(load_body_model().keypoint_names)
    found: dict[str, int] = {}
    for k, role in enumerate(joint_roles(names)):
        if f"body.{role}" in known:
            found.setdefault(f"body.{role}", k)
    return {
        "keypoint_names": np.array(list(found), "U32"), "keypoint_joint": np.array(list(found.values()), np.int64),
        "keypoint_vertices": np.zeros(0, np.int64), "keypoint_starts": np.zeros(len(found) + 1, np.int64),
    }  # fmt: skip
