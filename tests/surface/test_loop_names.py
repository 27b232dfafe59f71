"""Loops are named by what goes through them, for any garment, skeleton and up axis."""

import numpy as np
import pytest

from tests.support.shapes import tube
from tests.support.smpl import smpl_fields
from toile import kernels
from toile.io.body import load_body_model
from toile.surface.loop_names import name_loops

RINGS = {  # an opening: joint that the bone comes from, where it goes, how far along, radius [m]
    "neck": ("spine01", "neck01", 0.9, 0.09),
    "high on the chest": ("spine02", "spine01", 0.7, 0.2),
    "waist": ("spine05", "spine04", 0.8, 0.17),
    "hips": ("spine05", "upperleg01", 0.7, 0.25),  # the mean of both sides: about both thighs
    "wide hem": ("spine05", "upperleg01", 0.9, 0.6),
    "armhole": ("clavicle", "upperarm01", 0.97, 0.09),
    "short sleeve": ("upperarm01", "lowerarm01", 0.6, 0.09),
    "cuff": ("lowerarm01", "wrist", 0.9, 0.06),
    "leg": ("upperleg01", "lowerleg01", 0.7, 0.08),
    "ankle": ("lowerleg01", "foot", 0.9, 0.07),
}
SIDED = ("armhole", "short sleeve", "cuff", "leg", "ankle")
GARMENTS = {
    "shirt": {"neck": "neck", "hips": "hem", "short sleeve": "sleeve"},
    "long-sleeved dress": {"neck": "neck", "wide hem": "hem", "cuff": "sleeve"},
    "tank top": {"neck": "neck", "waist": "hem", "armhole": "armhole"},
    "poncho": {"neck": "neck", "wide hem": "hem"},
    "trousers": {"waist": "waist", "ankle": "ankle"},
    "shorts": {"waist": "waist", "leg": "leg"},
    "skirt": {"waist": "waist", "wide hem": "hem"},
    "strapless dress": {"high on the chest": "neck", "wide hem": "hem"},
    "off the shoulder": {"high on the chest": "neck", "waist": "hem", "short sleeve": "sleeve"},
    "swimsuit": {"neck": "neck", "armhole": "armhole", "leg": "leg"},
    "socks": {"ankle": "ankle"},
}


def ring(model, opening, side):
    """An uneven circle (k,3) about a bone of the packaged model."""
    start, end, share, radius = RINGS[opening]

    def at(name):
        if name in model.joint_names:
            return model.J[model.joint_names.index(name)]
        sides = [model.J[model.joint_names.index(f"{name}.{s}")] for s in side or "LR"]
        return np.mean(sides, 0)

    way = at(end) - at(start)
    across = np.linalg.svd(way[None])[2][1:]
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    wave = radius * (1 + 0.1 * np.cos(3 * angle))[:, None]
    circle = wave * (np.cos(angle)[:, None] * across[0] + np.sin(angle)[:, None] * across[1])
    return at(start) + share * way + circle + 0.15 * radius * np.sin(2 * angle)[:, None] * way / np.linalg.norm(way)


def garment(model, loops):
    """Vertices, loops and the names that they should get."""
    curves, wanted = [], []
    for opening, name in loops.items():
        for side in "LR" if opening in SIDED else " ":
            curves.append(ring(model, opening, side.strip()))
            wanted.append(name + {"L": "_left", "R": "_right", " ": ""}[side])
    starts = np.cumsum([0, *map(len, curves)])
    return np.concatenate(curves), [np.arange(a, b) for a, b in zip(starts, starts[1:])], tuple(wanted)


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    """{kind: model}: the packaged one with two up axes, and another skeleton."""
    path = tmp_path_factory.mktemp("body") / "smpl.npz"
    np.savez(path, **smpl_fields())
    return {"z": load_body_model(up="z"), "y": load_body_model(up="y"), "smpl": load_body_model(path)}


@pytest.mark.parametrize("body", ["z", "y", "smpl"])
@pytest.mark.parametrize("kind", GARMENTS)
def test_loops_are_named_by_what_they_surround(kind, body, bodies):
    V, loops, wanted = garment(bodies["y" if body == "y" else "z"], GARMENTS[kind])
    assert name_loops(bodies[body], V, loops) == wanted
    turned = [np.roll(loop[::-1], 7) for loop in loops[::-1]]
    assert name_loops(bodies[body], V, turned) == wanted[::-1]


def test_loops_that_surround_nothing_or_the_same_keep_their_numbers(bodies):
    model = bodies["z"]
    V, loops, _ = garment(model, {"neck": "neck", "short sleeve": "sleeve", "cuff": "sleeve"})
    assert name_loops(model, V, loops) == ("neck", "loop1", "loop2", "loop3", "loop4")
    assert name_loops(model, V + [0, 2, 0], loops) == tuple(f"loop{i}" for i in range(5))  # a cape in the air


def test_a_body_whose_joints_are_not_known_names_no_loop(bodies):
    from dataclasses import replace

    V, F = tube()
    model = replace(bodies["z"], joint_roles=tuple(f"joint{k}" for k in range(104)))
    assert name_loops(model, V, kernels.boundary_loops(F)) == ("loop0", "loop1")
