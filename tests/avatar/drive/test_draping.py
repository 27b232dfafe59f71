"""Garments that hang as cloth on a driven avatar: what is measured of them, that they follow, what is refused."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.cloths import ball, sheet, solver
from toile.avatar.command import say_cloths
from toile.avatar.drive.animate import DrivenAvatar, animate
from toile.avatar.drive.cloths import ensure_cloths
from toile.avatar.drive.draping import (
    RINGS,
    cloth_file,
    doubts,
    forget_cloths,
    load_cloths,
    made_of,
    outdated,
    relieved,
    whole,
    worn_cloths,
)
from toile.avatar.drive.residual import ALIKE, CLOTH, CODES, JOINED, MEAN, MIXED, Residual, teach
from toile.avatar.drive.teaching import train_temporal
from toile.avatar.edit.editing import Change, edit
from toile.avatar.measure.evaluation import evaluate_avatar
from toile.avatar.model.checkpoint import load_avatar
from toile.avatar.settings import ClothSettings, TemporalSettings
from toile.errors import UserError
from toile.io.files import save_record
from toile.io.mesh import read_mesh
from toile.io.run import open_run
from toile.kernels import intersecting_pairs, unique_edges


@pytest.fixture(scope="module")
def avatar_folder(sample_avatar, sample_run):
    folder = sample_avatar.parent / "hanging"
    shutil.copytree(sample_avatar, folder)
    train_temporal(folder, TemporalSettings(window=2, channels=8, steps=20))
    with pytest.raises(UserError, match=r"cloth.tshirt.npz: the file is missing: `toile animate --physics`"):
        DrivenAvatar(folder, sample_run, physics=True)
    ensure_cloths(folder)
    return folder


@pytest.fixture(scope="module")
def driven(avatar_folder, sample_run):
    return DrivenAvatar(avatar_folder, sample_run, physics=True)


def test_lengths_are_the_means_of_the_frames_that_were_trained_on(driven, avatar_folder, sample_run):
    cloth = load_cloths(avatar_folder, driven.avatar.layers)["tshirt"]
    garment = open_run(sample_run).garments["tshirt"]
    i, j = unique_edges(garment.faces).T
    of_frame = [np.linalg.norm(garment.vertices.at(n)[i] - garment.vertices.at(n)[j], axis=1) for n in (0, 1, 2)]
    assert np.allclose(cloth.lengths, np.mean(of_frame, axis=0))
    assert 0.001 <= cloth.margin < 0.02


def test_over_the_training_frames_cloth_lies_on_average_where_it_was_registered(driven, sample_run):
    """But for the first of the three, from which cloth only goes."""
    garment, error, spread = open_run(sample_run).garments["tshirt"], 0, 0
    for row in (1, 2):
        batch = driven.unseen(row)
        shown = driven.draping.at(row, driven.geometry(row), batch)["tshirt"].vertices
        transforms = driven.avatar.skeleton(batch["rotations"], batch["translation"])
        unpose = driven.avatar.model("tshirt").skin.unpose
        truth = shown.new_tensor(garment.vertices.at(row))[None]
        difference = (unpose(shown, *transforms) - unpose(truth, *transforms))[0].numpy()
        error, spread = error + difference / 2, spread + np.linalg.norm(difference, axis=1).mean() / 2
    assert np.linalg.norm(error, axis=1).max() < 1e-4 < spread


def test_what_was_measured_is_forgotten_where_codes_shall_drive(avatar_folder, tmp_path):
    folder = shutil.copytree(avatar_folder, tmp_path / "avatar")
    layers = load_avatar(folder).layers
    forget_cloths(folder)
    assert not list(folder.glob("cloth.*")) and worn_cloths(folder, layers, None) == {}
    assert outdated(folder, layers, None) == []


def test_frames_in_any_order_give_the_same_bits(driven):
    def at(row):
        return driven.decode(row, driven.unseen(row))[0]["tshirt"].vertices.numpy()

    last, first = at(3), at(0)
    assert np.array_equal(at(3), last) and np.array_equal(at(0), first)
    assert not np.array_equal(first, last)


def test_a_waistband_goes_where_codes_place_it_and_the_rest_hangs(driven, monkeypatch):
    avatar, shirt = driven.avatar, driven.avatar.layer("tshirt")
    waist = shirt.loops["neck"]
    skirt = replace(shirt, loops={"waist": waist, "hem": shirt.loops["hem"]})
    layers = [skirt if layer is shirt else layer for layer in avatar.layers]
    monkeypatch.setattr(avatar, "layers", layers)
    draping, decoded = driven.draped(driven.draping.cloths, np.arange(4)), driven.geometry(3)
    draping.at(3, decoded, driven.unseen(3))
    off = np.linalg.norm(draping.fallen["tshirt"] - decoded["tshirt"].vertices[0].double().numpy(), axis=1)
    assert off[waist].max() < 1e-9 and np.delete(off, waist).mean() > 1e-4


def test_an_animation_by_physics_is_another_and_leaves_no_pair(avatar_folder, sample_run, tmp_path):
    options = dict(frames=[2, 3], height=32)
    learnt = animate(avatar_folder, sample_run, tmp_path / "learnt", **options)
    hung = animate(avatar_folder, sample_run, tmp_path / "hung", physics=True, **options)
    assert hung.frames == learnt.frames == 2 and hung.intersections_left == 0
    body, shirt, other = (
        read_mesh(tmp_path / place / "000003.ply")
        for place in ("hung/meshes/body", "hung/meshes/tshirt", "learnt/meshes/tshirt")
    )
    assert len(intersecting_pairs(shirt.vertices, shirt.faces, body.vertices, body.faces)) == 0
    moved = np.linalg.norm(shirt.vertices - other.vertices, axis=1)
    assert 1e-4 < moved.mean() < 0.05


def test_cloth_that_lies_farther_off_than_the_mean_shape_is_said(avatar_folder, driven):
    cloth = load_cloths(avatar_folder, driven.avatar.layers)["tshirt"]
    of = lambda still, hung: {
        "tshirt": replace(cloth, residual=replace(cloth.residual, missed={MEAN: still, CLOTH: hung}))
    }
    assert doubts(of(0.02, 0.012)) == []
    said = "tshirt as cloth lies 39 mm from where it was registered, its mean shape 23 mm: physics does not help it"
    assert doubts(of(0.023, 0.039)) == [said]


def test_where_codes_drive_in_place_of_cloth_is_said(avatar_folder, sample_run, tmp_path, monkeypatch):
    assert relieved({}, 0.8) == []
    (said,) = relieved({4: 0.5, 7: 0.25}, 2.1)
    words = "codes drive 75.0 % of it in frame 7, as much or less in 1 others: an edge had been stretched to 3.1 times"
    assert words in said
    assert "cloth could not be led out of the body" in relieved({4: 0.0}, 0.7)[0]
    monkeypatch.setattr("toile.avatar.drive.draping.TORN", -1.0)  # any strain is too much
    done = animate(avatar_folder, sample_run, tmp_path / "torn", frames=[1], height=32, physics=True)
    assert any("codes drive 100.0 % of it in frame 1: an edge" in one for one in done.warnings)
    result = evaluate_avatar(avatar_folder, [3], sheets=False, driven=True, physics=True)
    assert any("codes drive 100.0 % of it in frame 3: an edge" in one for one in result["warnings"])
    assert result["all"]["driven"]["physics"]["shares"] == {3: 0.0}


def test_codes_take_over_about_an_edge_that_is_drawn_out_and_nowhere_else():
    edges, x = np.stack([np.arange(40), np.arange(1, 41)]), np.arange(41.0)
    drawn = lambda by: np.stack([np.where(np.arange(41) > 20, x + by, x), 0 * x, 0 * x], 1)  # the edge from 20 to 21
    assert (whole(drawn(1.0), edges, np.ones(40)) == 1).all()
    for by, left in ((1.5, 0.5), (1.75, 0.25), (2.0, 0.0), (9.0, 0.0)):
        held = whole(drawn(by), edges, np.ones(40))
        assert np.allclose(held[[20, 21]], left)
        assert (held[: 20 - 2 * RINGS] == 1).all() and (held[22 + 2 * RINGS :] == 1).all()
        assert (np.diff(held[:21]) <= 1e-12).all() and (np.diff(held[21:]) >= -1e-12).all()


def test_a_garment_of_which_much_is_caught_begins_anew_and_comes_back_within_half_a_second(driven):
    one = driven.draped(driven.draping.cloths, np.arange(4))
    one.times, begun = np.arange(4) * 0.25, []
    shape = lambda row: driven.geometry(row)["tshirt"].vertices[0].double().numpy()
    little, much = shape(1), shape(2) * 4.0
    little[0] += 0.3

    def start(V, under):
        begun.append(one.row)
        return SimpleNamespace(V=V, strain=0.0)

    def at(row):
        decoded = driven.geometry(row)
        shown = one.at(row, decoded, driven.unseen(row))["tshirt"].vertices
        return one.shares["tshirt"], (shown - decoded["tshirt"].vertices)[0].norm(dim=1).numpy()

    steps = iter((little, much, shape(3) + 0.01))
    one._solver = lambda *_: SimpleNamespace(start=start, step=lambda *_: SimpleNamespace(V=next(steps), strain=0.0))
    assert (at(0)[0] == 1).all() and begun == [0]
    share, off = at(1)
    assert share[0] == 0 and off[0] < 1e-6 and 0.9 < share.mean() < 1 and begun == [0]
    share, off = at(2)
    assert (share == 0).all() and off.max() < 1e-6 and begun == [0, 2]
    share, off = at(3)
    assert np.allclose(share, 0.5) and off.mean() > 1e-3 and begun == [0, 2]


def test_cloth_that_cannot_be_led_out_of_the_body_gives_way_to_codes(driven):
    one, decoded, batch = driven.draped(driven.draping.cloths, np.arange(4)), driven.geometry(2), driven.unseen(2)
    cloth = one.at(2, decoded, batch)["tshirt"].vertices
    away = lambda shown: float((shown["tshirt"].vertices - decoded["tshirt"].vertices).norm())
    whole = away({"tshirt": replace(decoded["tshirt"], vertices=cloth)})
    for most, share in ((whole, 1.0), (0.9 * whole, 0.0), (-1.0, 1.0)):
        one.layering = lambda shown, _, most=most: (shown, 9, 0 if away(shown) <= most * 1.001 else 5)
        (shown, before, left), told = one.clear(2, decoded, batch)
        assert told == share and before == 9 and left == (5 if most < 0 else 0)
        assert abs(away(shown) - share * whole) < 1e-3 * whole


@pytest.fixture
def told(avatar_folder, driven, tmp_path):
    """A function: a copy of the avatar whose shirt was found to be so far off by codes alone, mixed with cloth, and by cloth alone [m]."""

    def told(codes, mixed, hung=0.015):
        folder = tmp_path / "told"
        shutil.copytree(avatar_folder, folder, dirs_exist_ok=True)
        cloth = load_cloths(folder, driven.avatar.layers)["tshirt"]
        missed = {MEAN: 0.02, CLOTH: hung, JOINED: 0.012, CODES: codes, MIXED: mixed}
        record = replace(cloth, residual=replace(cloth.residual, missed=missed))
        save_record(cloth_file(folder, "tshirt"), record, made_of(folder, ClothSettings()))
        return folder

    return told


def test_unasked_a_garment_hangs_where_that_is_nearer(told, driven, sample_run, tmp_path):
    def at(folder, physics):
        one = DrivenAvatar(folder, sample_run, physics=physics)
        return one.decode(3, one.unseen(3))[0]["tshirt"].vertices.numpy()

    asked = (
        (0.014, 0.010),
        (0.014, 0.0139),
        (0.014, 0.010, 0.021),
    )  # the last by itself farther off than the mean shape
    near, far, slid = (worn_cloths(told(*missed), driven.avatar.layers, None) for missed in asked)
    assert near.keys() == {"tshirt"} and far == slid == {}
    folder = told(0.014, 0.010)
    assert np.array_equal(at(folder, None), at(folder, True)) and not np.array_equal(
        at(folder, None), at(folder, False)
    )
    done = animate(folder, sample_run, tmp_path / "hung", frames=[1], height=32)
    assert done.hung == ("tshirt",)
    folder = told(0.014, 0.0139)
    assert np.array_equal(at(folder, None), at(folder, False))
    assert animate(folder, sample_run, tmp_path / "told_by_poses", frames=[1], height=32).hung == ()


def test_near_the_poses_of_the_training_cloth_and_codes_are_mixed_and_far_from_them_cloth_is_alone(driven):
    (cloth,), pose = driven.draping.cloths.values(), driven.draping.poses["tshirt"][3]
    decoded, batch = driven.geometry(3), driven.unseen(3)
    nothing = dict(
        swings=np.zeros((1, 0)), weights=np.zeros((1, 0)), modes=np.zeros((0, *cloth.residual.registered.shape))
    )

    def shown(at, trust):
        residual = replace(cloth.residual, poses=at[None], share=1.0, trust=trust, **nothing)
        one = driven.draped({"tshirt": replace(cloth, residual=residual)}, np.arange(4))
        return one.at(3, decoded, batch)["tshirt"].vertices

    alone, far, near = shown(pose, 1.0), shown(pose + 9.0, 0.5), shown(pose, 0.5)
    assert np.allclose(far, alone, atol=1e-7)
    assert np.allclose(near, (alone + decoded["tshirt"].vertices) / 2, atol=1e-6)
    assert np.allclose(shown(pose, 0.0), decoded["tshirt"].vertices, atol=1e-6)


def test_what_drives_a_garment_is_said_with_both_figures(told, capsys):
    for mixed, driver in ((0.010, "it hangs as cloth"), (0.0139, "codes drive it")):
        say_cloths(told(0.014, mixed))
        off = f"mean shape 20.0, cloth 15.0, joined 12.0, codes 14.0, mixed {1e3 * mixed:.1f}"
        said = f"tshirt: {driver} when it is driven; off in training frames left out [mm]: {off}"
        assert said in capsys.readouterr().out


@pytest.mark.parametrize("file", ["avatar.json", "temporal.safetensors"])
def test_cloth_of_an_avatar_that_was_trained_again_does_not_hang_unasked(told, driven, file):
    folder = told(0.014, 0.010)
    with open(folder / file, "a") as trained:
        trained.write("\n")
    layers = driven.avatar.layers
    assert worn_cloths(folder, layers, None) == {}
    (said,) = outdated(folder, layers, None)
    assert (
        "cloth.tshirt.npz: was measured before the avatar was trained as it is, or by an older toile: codes drive the garment"
        in said
    )
    assert outdated(folder, layers, False) == outdated(folder, layers, True) == []


def test_an_edited_avatar_hangs_its_garments_as_before(told, driven, tmp_path):
    folder, layers = told(0.014, 0.010), driven.avatar.layers
    edit(folder, tmp_path / "green", Change("tshirt", scale="0.25,1.5,0.25"), sheet=False)
    assert worn_cloths(tmp_path / "green", layers, None).keys() == {"tshirt"}
    with open(folder / "temporal.safetensors", "a") as trained:
        trained.write("\n")
    edit(folder, tmp_path / "red", Change("tshirt", scale="1.5,0.25,0.25"), sheet=False)
    assert not cloth_file(tmp_path / "red", "tshirt").exists()  # measured before it was trained as it is


def test_cloth_whose_swings_do_not_count_is_read_back(told, driven):
    folder = told(0.014, 0.010)
    cloth = load_cloths(folder, driven.avatar.layers)["tshirt"]
    teacher = teach(
        np.arange(16.0)[:, None] * [[1.0, 0.0]],
        np.repeat(cloth.residual.simulated[None], 16, 0),
        np.arange(16.0)[:, None, None] + cloth.residual.registered,
    )
    assert teacher.swing_reach == ALIKE
    save_record(cloth_file(folder, "tshirt"), replace(cloth, residual=teacher), made_of(folder, ClothSettings()))
    assert load_cloths(folder, driven.avatar.layers)["tshirt"].residual.swing_reach == ALIKE


def test_garments_without_a_cloth_go_as_they_are_decoded(driven, sample_run):
    decoded, batch = driven.geometry(2), driven.unseen(2)
    bare = driven.draped({}, np.arange(4)).at(2, decoded, batch)
    assert all(np.array_equal(bare[name].vertices, decoded[name].vertices) for name in decoded)


def test_cloths_are_measured_once_and_checked_when_read(avatar_folder, driven, tmp_path):
    path = cloth_file(avatar_folder, "tshirt")
    before = path.stat().st_mtime_ns
    ensure_cloths(avatar_folder, run=tmp_path / "gone")
    assert path.stat().st_mtime_ns == before
    spoiled = tmp_path / "avatar"
    shutil.copytree(avatar_folder, spoiled)
    cloth, residual = load_cloths(spoiled, driven.avatar.layers)["tshirt"], Residual.none(2)
    for spoilt, said in [
        (replace(cloth, margin=np.nan), "margin is not finite"),
        (replace(cloth, residual=residual), "residual.registered is float64 .2, 3., expected"),
        (replace(cloth, residual=replace(cloth.residual, weights=np.zeros((1, 2)))), "residual.weights is float64"),
        (
            replace(cloth, residual=replace(cloth.residual, missed={MEAN: 0.1})),
            "residual.missed is {'mean shape': 0.1}",
        ),
        (replace(cloth, settings={"bending": -1.0}), "bending"),
        (replace(cloth, settings={"bent": 1.0}), "bent"),
    ]:
        save_record(cloth_file(spoiled, "tshirt"), spoilt)
        with pytest.raises(UserError, match=f"cloth.tshirt.npz: {said}"):
            load_cloths(spoiled, driven.avatar.layers)
    np.savez(cloth_file(spoiled, "tshirt"), lengths=np.ones(3), margin=0.1, residual=np.zeros((2, 3)))
    with pytest.raises(UserError, match="cloth.tshirt.npz: residual.registered is missing"):
        load_cloths(spoiled, driven.avatar.layers)
    cloth_file(spoiled, "tshirt").unlink()
    with pytest.raises(UserError, match="its run .*gone is not there"):
        ensure_cloths(spoiled, run=tmp_path / "gone")
    retrained = tmp_path / "retrained"
    shutil.copytree(avatar_folder, retrained)
    with open(retrained / "avatar.json", "a") as file:
        file.write("\n")
    with pytest.raises(UserError, match="its run .*gone is not there"):  # what was measured for another is not taken
        ensure_cloths(retrained, run=tmp_path / "gone")


def test_other_settings_of_cloth_are_measured_anew_and_move_it(avatar_folder, driven, sample_run, tmp_path):
    stiff = tmp_path / "stiff"
    shutil.copytree(avatar_folder, stiff)
    ensure_cloths(stiff, settings=ClothSettings(bending=1e-3))
    hung = DrivenAvatar(stiff, sample_run, physics=True)
    assert load_cloths(stiff, driven.avatar.layers)["tshirt"].asked.bending == 1e-3
    ensure_cloths(stiff, run=tmp_path / "gone")  # of any settings
    with pytest.raises(UserError, match="its run .*gone is not there"):
        ensure_cloths(stiff, run=tmp_path / "gone", settings=ClothSettings())
    shown = [d.draping.at(1, d.geometry(1), d.unseen(1)) and d.draping.fallen["tshirt"] for d in (driven, hung)]
    assert np.linalg.norm(shown[0] - shown[1], axis=1).mean() > 1e-4


def test_cloth_is_not_measured_on_a_run_that_was_registered_anew(avatar_folder, sample_run, tmp_path):
    import zarr

    folder, run = shutil.copytree(avatar_folder, tmp_path / "avatar"), shutil.copytree(sample_run, tmp_path / "run")
    (folder / "cloth.tshirt.npz").unlink(missing_ok=True)
    store = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    store["garment/tshirt/vertices"][:] = store["garment/tshirt/vertices"][:] + 1e-3
    with pytest.raises(UserError, match="run: its registration is not the one that .* was trained on"):
        ensure_cloths(folder, run=run)


def test_cloth_comes_to_rest_within_four_seconds_on_a_body_that_stands_still():
    V, F = sheet(across=17, along=17, size=(0.6, 0.6), height=0.22)
    body_V, body_F = ball()
    cloth = solver(V, F, body_V, body_F, **ClothSettings().solver())
    cloth.start(V, body_V)
    for k in range(1, 16):
        cloth.step(body_V + [0.02 * k, 0, 0], 1 / 30)
    for _ in range(120):
        before = cloth.step(body_V + [0.3, 0, 0], 1 / 30).V
    speed = np.linalg.norm(cloth.step(body_V + [0.3, 0, 0], 1 / 30).V - before, axis=1).mean()
    assert speed < 1e-4  # [m a frame]; 0.4e-4, without drag 1.2e-4
