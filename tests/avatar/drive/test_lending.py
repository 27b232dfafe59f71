"""One avatar in another's garment: what is taken over, what stays, where it lies, what is refused."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from tests.support import small_avatar
from tests.support.small_avatar import BODY, JACKET, SHIRT
from toile.avatar.drive import lending
from toile.avatar.drive.animate import DrivenAvatar, animate
from toile.avatar.drive.cloths import ensure_worn
from toile.avatar.drive.draping import cloth_file
from toile.avatar.drive.posing import PosedAvatar
from toile.errors import UserError
from toile.io.files import load_record, save_record
from toile.io.motion import Motion
from toile.surface.layers import Layer


@pytest.fixture(scope="module")
def owner(driven_avatar, tmp_path_factory):
    return shutil.copytree(driven_avatar, tmp_path_factory.mktemp("owner") / "owner")


@pytest.fixture(scope="module")
def taller(owner):
    """The same person 4 % larger: another body under the same networks, without a temporal model."""
    folder = owner.parent / "taller"
    shutil.copytree(owner, folder)
    (folder / "temporal.safetensors").unlink()
    assets = folder / "assets"
    body = load_record(assets / "layer0.npz", Layer)
    save_record(assets / "layer0.npz", replace(body, rest=1.04 * body.rest))
    with np.load(assets / "maps.npz") as maps:
        fields = dict(maps)
    np.savez(assets / "maps.npz", **fields | {"J": 1.04 * fields["J"]})
    return folder


@pytest.fixture(scope="module")
def worn(owner, taller, sample_run):
    """The owner's shirt on the taller."""
    return DrivenAvatar(taller, sample_run, garments={"tshirt": owner})


def test_its_own_garment_changes_no_bit(owner, sample_run):
    """Nothing is refitted on the body that a garment was made on, and its codes are of the same poses."""
    plain, lent = (DrivenAvatar(owner, sample_run, garments=given) for given in ({}, {"tshirt": owner}))
    batch = plain.unseen(2)
    (first, *pairs), (second, *same) = (driven.decode(2, batch) for driven in (plain, lent))
    assert pairs == same and lent.lent[0].strain == 0
    for name in first:
        assert torch.equal(first[name].vertices, second[name].vertices)
        assert torch.equal(first[name].texture, second[name].texture)
    assert np.array_equal(plain.picture(first, batch, (64, 64)), lent.picture(second, batch, (64, 64)))


def test_codes_textures_and_folds_are_the_garments_own(owner, worn, sample_run):
    own = DrivenAvatar(owner, sample_run)
    assert torch.equal(own.latents["tshirt"], worn.latents["tshirt"])
    ours, theirs = (driven.decode(1, driven.unseen(1))[0]["tshirt"].mean_texture for driven in (worn, own))
    assert torch.equal(ours, theirs)
    folds = [driven.geometry(1)["tshirt"].unposed - driven.avatar.model("tshirt").rest for driven in (worn, own)]
    assert torch.allclose(*folds, atol=1e-6) and folds[0].abs().max() > 1e-4


def test_it_is_lit_by_the_wearers_lamps(owner, taller, sample_run):
    worn = DrivenAvatar(taller, sample_run, garments={"tshirt": owner})
    batch, avatar = worn.unseen(1), worn.avatar
    even, found = worn.decode(1, batch)[0]["tshirt"], avatar.light.clone()
    avatar.light.copy_(found + torch.tensor([0.0, 0, 0.4, 0, 0, 0, 0, 0])[:, None])  # a lamp above
    shown = worn.decode(1, batch)[0]["tshirt"]
    avatar.light.copy_(found)
    assert torch.equal(shown.mean_texture, even.mean_texture)
    assert not torch.allclose(shown.texture, even.texture, atol=1e-3)


def test_on_another_body_it_keeps_its_lengths_and_lies_outside(worn, owner, sample_run):
    lent = worn.lent[0]
    assert 0 < lent.strain < 0.05 and not any("hardly fits" in words for words in lent.warnings)
    for row in range(3):
        _, before, left, _ = worn.decode(row, worn.unseen(row))
        assert left == 0
    body = worn.avatar.layers[0]
    assert np.allclose(body.rest, 1.04 * lent.lender.layers[0].rest)  # the wearer's
    bare = DrivenAvatar(owner, sample_run).geometry(1)["body"].vertices
    assert (worn.geometry(1)["body"].vertices - bare).norm(dim=-1).max() > 0.02


def test_an_animation_says_whose_garment_it_shows(owner, taller, sample_run, tmp_path):
    done = animate(taller, sample_run, tmp_path / "out", frames=[1], height=32, garments={"tshirt": owner})
    said = json.loads((tmp_path / "out" / "animation.json").read_text())
    assert done.intersections_left == 0 and said["layers"] == ["body", "tshirt"]
    assert said["garments"]["tshirt"]["avatar"] == str(owner) and 0 < said["garments"]["tshirt"]["strain_p95"] < 0.05


@pytest.mark.slow(seconds=20)
def test_by_physics_it_hangs_as_the_cloth_that_it_is(owner, taller, sample_run, tmp_path):
    ensure_worn(taller, {"tshirt": owner})
    assert cloth_file(owner, "tshirt").exists() and not cloth_file(taller, "tshirt").exists()
    driven = DrivenAvatar(taller, sample_run, physics=True, garments={"tshirt": owner})
    decoded, _, left, _ = driven.decode(1, driven.unseen(1))
    by_codes = driven.geometry(1)["tshirt"].vertices
    assert left == 0 and 1e-4 < (decoded["tshirt"].vertices - by_codes).norm(dim=-1).mean() < 0.05
    done = animate(taller, sample_run, tmp_path / "hung", [1], height=32, physics=True, garments={"tshirt": owner})
    assert (
        done.hung == ("tshirt",) and not cloth_file(taller, "tshirt").exists()
    )  # what it does not wear is not asked for


def test_a_posed_avatar_wears_it_too(owner, taller, worn, sample_run):
    posed = PosedAvatar(taller, sample_run, {"tshirt": owner})
    decoded, *_ = worn.decode(1, worn.unseen(1))
    assert np.abs(posed.vertices(1, {})["tshirt"] - decoded["tshirt"].vertices[0].numpy()).max() < 1e-5


@pytest.mark.parametrize(
    "own, other, name, order",
    [
        ((BODY,), (BODY, SHIRT), "shirt", ["body", "shirt"]),
        ((BODY, SHIRT), (BODY, JACKET), "jacket", ["body", "shirt", "jacket"]),
        ((BODY, JACKET), (BODY, SHIRT, JACKET), "shirt", ["body", "shirt", "jacket"]),
        ((BODY, SHIRT, JACKET), (BODY, SHIRT), "shirt", ["body", "shirt", "jacket"]),
    ],
)
def test_it_takes_the_place_of_its_namesake_or_lies_under_what_goes_over_it(monkeypatch, own, other, name, order):
    wearer, lender = small_avatar.avatar(own), small_avatar.avatar(other, seed=1)
    monkeypatch.setattr(lending, "load_avatar", lambda folder: lender)
    networks = lender.model(name).networks
    lending.lend(wearer, {name: "other"}, "own", BODY.faces)
    assert wearer.names == [layer.name for layer in wearer.layers] == [model.name for model in wearer.models] == order
    assert wearer.model(name).networks is networks


def another_model():
    return replace(BODY, faces=BODY.faces[:-1], face_uv=BODY.face_uv[:-1])


@pytest.mark.parametrize(
    "own, other, up, said",
    [
        ((BODY, SHIRT), (BODY, SHIRT), "z", "--garment jacket=other: no garment jacket there: it has shirt"),
        ((BODY, SHIRT), (small_avatar.SURFACE,), "z", "--garment jacket=other: no garment jacket there: it has none"),
        ((small_avatar.SURFACE,), (BODY, JACKET), "z", "own: an avatar of a single layer"),
        ((BODY, SHIRT), (another_model(), JACKET), "z", r"its body model \(anny, 108 vertices, 3 joints\) is another"),
        ((BODY, SHIRT), (BODY, JACKET), "y", "--garment jacket=other: up is y there, z in own"),
    ],
)
def test_what_cannot_be_worn_is_refused(monkeypatch, own, other, up, said):
    wearer, lender = small_avatar.avatar(own), small_avatar.avatar(other)
    lender.scene = replace(lender.scene, up=up)
    monkeypatch.setattr(lending, "load_avatar", lambda folder: lender)
    with pytest.raises(UserError, match=said):
        lending.lend(wearer, {"jacket": "other"}, "own", BODY.faces)


@pytest.mark.parametrize("fps, stride", [(30, 6), (60, 3), (24, 8), (500, 1)])
def test_its_model_reads_poses_as_far_apart_in_time_and_faces_as_they_differ_from_the_mean(monkeypatch, fps, stride):
    """Taught on poses 6 frames apart, by a person whose face lies 1 cm higher in the head's frame."""
    read = {}

    def track(avatar, frames, rotations, face, stride, fps):
        read.update(face=face, stride=stride, fps=fps)

    monkeypatch.setattr(lending, "make_track", track)
    monkeypatch.setattr(
        lending, "load_driver", lambda folder: (SimpleNamespace(latents=lambda track: {"shirt": "codes"}), 6, {})
    )
    mean, up = torch.zeros(2, 3), torch.tensor([0, 0, 0.01])
    lender = SimpleNamespace(scene=SimpleNamespace(fps=fps), face_mean=mean + up)
    motion = Motion(np.arange(1), np.zeros((1, 3, 3)), np.zeros((1, 3)), np.full((1, 2, 3), 0.5), 30.0)
    lent = lending.Lent("shirt", Path("other"), lender, None, 0.0)
    assert lent.latents(motion, mean) == "codes"
    assert read["stride"] == stride and read["fps"] == 30 and np.allclose(read["face"], [0.5, 0.5, 0.51])
    lent.latents(motion, torch.zeros(5, 3))  # of other points: a face that rests
    assert read["face"] is None


def test_the_driver_of_a_lent_garment_is_read_once(monkeypatch):
    read, driver = [], SimpleNamespace(latents=lambda track: {"shirt": "codes"})
    monkeypatch.setattr(lending, "make_track", lambda *_: None)
    monkeypatch.setattr(lending, "load_driver", lambda folder: read.append(folder) or (driver, 6, {"held_out": 0.2}))
    lent = lending.Lent("shirt", Path("other"), SimpleNamespace(scene=SimpleNamespace(fps=30)), None, 0.0)
    motion = Motion(np.arange(1), np.zeros((1, 3, 3)), np.zeros((1, 3)), None, 30.0)
    assert lent.warnings == [] and lent.latents(motion, None) == lent.latents(motion, None) == "codes"
    assert read == [Path("other")]


def test_a_folder_without_an_avatar_is_refused(owner, sample_run, tmp_path):
    with pytest.raises(UserError, match="no such folder"):
        DrivenAvatar(owner, sample_run, garments={"tshirt": tmp_path / "nobody"})


def test_a_garment_that_hardly_fits_or_that_poses_hardly_foretell_is_warned_of(monkeypatch):
    warned = lambda strain: lending.Lent("tshirt", Path("small"), None, None, strain).warnings
    monkeypatch.setattr(lending, "load_driver", lambda folder: (None, 1, {"held_out": 0.2}))
    fits_not = "tshirt of small hardly fits: one edge in twenty is longer or shorter by more than 20 %"
    assert warned(0.2) == [fits_not] and warned(0.05) == []
    monkeypatch.setattr(lending, "load_driver", lambda folder: (None, 1, {"held_out": 1.386}))
    first, second = warned(0.2)
    assert first == fits_not and second.startswith("tshirt of small: poses foretell garments badly: ")
