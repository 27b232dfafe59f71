"""Decoded garments out of the body: a limb that has come through the cloth is led there from rest."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from toile.avatar.drive.layering import STRETCH, TURN, GarmentLayering, shares
from toile.avatar.model.skinning import Skeleton, Skin
from toile.kernels import intersecting_pairs
from toile.surface.layering import Layered

ELBOW = 0.3  # [m] from the shoulder, along x


@dataclass(frozen=True)
class Decoded:
    vertices: torch.Tensor


def tube(radius, first, last, around=24, along=40, capped=False):
    """A tube about the x axis; capped: by two points on the axis."""
    angle, x = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.linspace(first, last, along))
    V = np.stack([x, radius * np.cos(angle), radius * np.sin(angle)], -1).reshape(-1, 3)
    i, k = np.meshgrid(np.arange(around), np.arange(along - 1))
    a, b = (k * around + i).ravel(), (k * around + (i + 1) % around).ravel()
    F = np.concatenate([np.stack([a, b, a + around], 1), np.stack([b, b + around, a + around], 1)])[:, ::-1]
    if capped:
        ring, n, end = np.arange(around), len(V), (along - 1) * around
        low = np.stack([np.full(around, n), (ring + 1) % around, ring], 1)
        high = np.stack([np.full(around, n + 1), end + ring, end + (ring + 1) % around], 1)
        V, F = np.concatenate([V, [[first, 0, 0], [last, 0, 0]]]), np.concatenate([F, low[:, ::-1], high[:, ::-1]])
    return V, np.ascontiguousarray(F, np.int32)


def layer(name, V, F, lower):
    """`lower` (n,) of 0 to 1: how much the lower arm carries it."""
    skin = np.tile([0, 1], (len(V), 1)), np.stack([1 - lower, lower], 1)
    kind = "body" if name == "body" else "garment"
    return SimpleNamespace(name=name, kind=kind, rest=V, faces=F, skin_idx=skin[0], skin_val=skin[1])


def arm(bend, reach=0.06):
    """An arm bent by an angle [rad], in a sleeve that the upper arm carries to `reach` [m] past the elbow."""
    body, sleeve = tube(0.04, 0, 0.6, along=60, capped=True), tube(0.055, 0.08, ELBOW + reach, along=30)
    lower = np.clip((body[0][:, 0] - ELBOW) / 0.04 + 0.5, 0, 1)
    layers = [layer("body", *body, lower), layer("shirt", *sleeve, np.zeros(len(sleeve[0])))]
    skeleton = Skeleton(np.array([[0.0, 0, 0], [ELBOW, 0, 0]]), [-1, 0])
    skins = {one.name: SimpleNamespace(skin=Skin(one)) for one in layers}
    avatar = SimpleNamespace(layers=layers, skeleton=skeleton, model=skins.__getitem__)
    pose = {"rotations": torch.tensor([[[0.0, 0.3, 0], [0, 0, bend]]]), "translation": torch.zeros(1, 3)}
    transforms = skeleton(pose["rotations"], pose["translation"])
    posed = lambda one: skins[one.name].skin.pose(torch.tensor(one.rest, dtype=torch.float32)[None], *transforms)
    return GarmentLayering(avatar, body[1]), {one.name: Decoded(posed(one)) for one in layers}, pose


@pytest.mark.parametrize("bend", [1.2, -1.6])
def test_a_forearm_that_has_come_through_a_sleeve_goes_out_by_its_end(bend):
    layering, decoded, pose = arm(bend)
    body, shirt = (decoded[name].vertices[0].double().numpy() for name in ("body", "shirt"))
    at_once = layering.layering.solve(body, {"shirt": shirt})
    stretch = layering._stretch({"shirt": shirt}, at_once.vertices)
    assert at_once.intersections_left > 0 or stretch > STRETCH  # through the wall it cannot come
    moved, before, left = layering(decoded, pose)
    V = moved["shirt"].vertices[0].double().numpy()
    assert before > 0 and left == 0
    assert len(intersecting_pairs(V, layering.garments[0].faces, body, layering.skin_faces)) == 0
    assert layering._stretch({"shirt": shirt}, {"shirt": V}) < min(stretch, 0.05)
    assert np.array_equal(moved["body"].vertices, decoded["body"].vertices)


@pytest.mark.parametrize("bend", [1.2, -1.6])
def test_a_shape_that_meets_even_the_resting_body_comes_from_the_garments_rest_shape(bend):
    """A straight arm in a sleeve that the codes have bent past its elbow."""
    layering, decoded, pose = arm(0.0)
    body = decoded["body"].vertices[0].double().numpy()
    root = pose["rotations"] * torch.tensor([1.0, 0.0])[None, :, None]
    turned = layering.avatar.skeleton(root + torch.tensor([[[0.0, 0, 0], [0, 0, bend]]]), pose["translation"])
    past = layering.garments[0].rest[:, 0] > ELBOW
    skin = layer("shirt", layering.garments[0].rest, layering.garments[0].faces, past.astype(float))
    shirt = Skin(skin).pose(torch.tensor(skin.rest, dtype=torch.float32)[None], *turned)
    aside = {"shirt": shirt[0].double().numpy()}
    at_once = layering._stretch(aside, layering.layering.solve(body, aside).vertices)
    moved, before, left = layering(decoded | {"shirt": Decoded(shirt)}, pose)
    V = moved["shirt"].vertices[0].double().numpy()
    assert before > 0 and left == 0 and layering._stretch(aside, {"shirt": V}) < 0.75 * at_once
    assert len(intersecting_pairs(V, layering.garments[0].faces, body, layering.skin_faces)) == 0


@pytest.mark.parametrize("width, gives_way", [(0.078, True), (0.04, False)])
def test_where_cloth_finds_no_room_the_skin_gives_way_unless_it_lies_deep(monkeypatch, width, gives_way):
    layering, decoded, pose = arm(0.0)
    name, F = "shirt", layering.garments[0].faces
    V = decoded[name].vertices * torch.tensor([1, width / 2 / 0.055, 1])  # flat: it cuts two sides of the arm
    pairs = lambda V, skin: len(intersecting_pairs(V[0].double(), F, skin[0].double(), layering.skin_faces))
    before = pairs(V, decoded["body"].vertices)
    stuck = Layered({name: V[0].double().numpy()}, {}, before, before)
    monkeypatch.setattr(layering.layering, "solve", lambda *_: stuck)
    moved, *counted = layering(decoded | {name: Decoded(V)}, pose)
    left = pairs(V, moved["body"].vertices)
    assert before > 0 and counted == [before, left] and torch.equal(moved[name].vertices, V)
    assert (left == 0) == gives_way == (0 < layering.dent(decoded, moved) < 0.01)


def test_what_comes_out_at_first_is_not_touched_again(monkeypatch):
    layering, decoded, pose = arm(0.3)
    monkeypatch.setattr(layering, "_ways", lambda *_: (pytest.fail("led there") for _ in "1"))
    assert layering(decoded, pose)[2] == 0


def test_what_is_clear_keeps_its_bits():
    layering, decoded, pose = arm(0.0)
    moved, before, left = layering(decoded, pose)
    assert before == left == 0 and torch.equal(moved["shirt"].vertices, decoded["shirt"].vertices)


def test_the_way_from_rest_goes_in_small_turns_and_leaves_the_root():
    turns = torch.tensor([[[3.0, 0, 0], [0, 0.5, 0], [0, 0, 0.93]]])
    found = shares(turns)
    assert found[0] == 0 and found[-1] == 1 and 0.93 * np.diff(found).max() <= TURN < 0.93 * 2 * np.diff(found).min()
    assert shares(turns[:, :1]).tolist() == [1.0]
