"""Decoded garments out of a body that runs through itself: what keeps pairs is tried once more with patience."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from tests.support.cloths import ball
from toile.avatar.drive.layering import GarmentLayering
from toile.kernels import intersecting_pairs


@dataclass(frozen=True)
class Decoded:
    vertices: torch.Tensor


def through_itself(radius, at):
    """A shell about a ball of 20 cm, and a second ball that runs through the first."""
    (a, F), (b, G) = ball(0.2), ball(radius, at=(at, 0, 0))
    body, skin = np.concatenate([a, b]), np.concatenate([F, G + len(a)]).astype(np.int32)
    cloth, cloth_F = ball(0.206)
    layers = [
        SimpleNamespace(name="body", kind="body", rest=body, faces=skin),
        SimpleNamespace(name="shirt", kind="garment", rest=cloth, faces=cloth_F),
    ]
    decoded = {layer.name: Decoded(torch.tensor(layer.rest, dtype=torch.float32)[None]) for layer in layers}
    return GarmentLayering(layers, skin), decoded, skin


@pytest.mark.parametrize("radius, at", [(0.15, 0.2), (0.2, 0.25)])
def test_cloth_deep_in_a_part_that_runs_through_another_comes_out(radius, at):
    layering, decoded, skin = through_itself(radius, at)
    points = [decoded[name].vertices[0].double().numpy() for name in ("body", "shirt")]
    assert (
        layering.layering.solve(points[0], {"shirt": points[1]}).intersections_left > 0
    )  # deeper than it goes at first
    moved, before, left = layering(decoded)
    assert before > 0 and left == 0
    V = moved["shirt"].vertices[0].numpy()
    assert len(intersecting_pairs(V, layering.garments[0].faces, points[0], skin)) == 0


def test_what_comes_out_at_first_is_not_touched_again(monkeypatch):
    layering, decoded, _ = through_itself(0.1, 0.15)
    monkeypatch.setattr(layering, "patient", None)
    assert layering(decoded)[2] == 0
