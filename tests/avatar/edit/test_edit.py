"""Edits of a garment's texture: what they change and leave, where pictures lie, the baseline's marking, refusals."""

import hashlib
import json
import shutil
import sys

import numpy as np
import pytest
import torch
from PIL import Image

from tests.support import small_avatar
from toile.avatar.drive.animate import animate
from toile.avatar.edit import paint
from toile.avatar.edit.editing import Change, edit
from toile.avatar.edit.marking import edit_of_surface, mark
from toile.avatar.edit.sheet import border_distances
from toile.avatar.measure.sheet import GAP, TILE
from toile.avatar.model.checkpoint import load_avatar
from toile.avatar.model.edits import Edit, LayerEdits, apply_edits, load_edits, save_edits
from toile.cli import main
from toile.errors import UserError
from toile.surface.uv import UvMap

UP, FRONT = np.array([0.0, 0, 1]), np.array([0.0, -1, 0])
SHIRT, SURFACE = small_avatar.SHIRT, small_avatar.SURFACE


def scale(*factors, layer="shirt", cover=None):
    cover = np.full((32, 32), 255, np.uint8) if cover is None else cover
    return Edit(layer, "shirt", "scale", cover, scale=np.array(factors))


def paint_of(value, size=32):
    return Edit(
        "shirt",
        "shirt",
        "paint",
        np.full((size, size), 255, np.uint8),
        colour=np.full((size, size, 3), value, np.uint8),
    )


def decoded(avatar):
    batch = small_avatar.batch(avatar)
    with torch.no_grad():
        return avatar.decode(batch, {name: torch.zeros(2, 4) for name in avatar.names}), batch


# Textures ------------------------------------------------------------------------------------------------------------


def test_a_scale_multiplies_the_garment_and_leaves_the_body_to_the_bit():
    avatar = small_avatar.awake(small_avatar.avatar())
    before, _ = decoded(avatar)
    apply_edits(avatar, [scale(0.5, 2, 0)])
    after, _ = decoded(avatar)
    factor = torch.tensor([0.5, 2, 0])[:, None, None]
    for name in ("mean_texture", "texture"):
        assert torch.equal(getattr(after["body"], name), getattr(before["body"], name))
        assert torch.allclose(getattr(after["shirt"], name), factor * getattr(before["shirt"], name), atol=1e-6)
    for layer in ("body", "shirt"):
        assert torch.equal(after[layer].vertices, before[layer].vertices)


def test_edits_act_in_their_order():
    avatar = small_avatar.awake(small_avatar.avatar())
    apply_edits(avatar, [scale(0.5, 1, 1), scale(0.5, 4, 1)])
    twice, _ = decoded(avatar)
    apply_edits(avatar, [scale(0.25, 4, 1)])
    once, _ = decoded(avatar)
    assert torch.allclose(twice["shirt"].texture, once["shirt"].texture, atol=1e-6)
    apply_edits(avatar, [scale(0, 0, 0), paint_of(200)])
    painted, _ = decoded(avatar)
    apply_edits(avatar, [paint_of(200), scale(0, 0, 0)])
    black, _ = decoded(avatar)
    assert painted["shirt"].mean_texture.min() > 0.1 and black["shirt"].mean_texture.abs().max() == 0


def test_paint_takes_the_decoded_brightness_and_what_the_view_adds():
    mean = torch.full((3, 32, 32), 0.4)
    layer = LayerEdits([paint_of(128)], mean, torch.ones(1, 32, 32))
    m, seen = layer(0.5 * mean[None], 0.5 * mean[None] + 0.07)
    assert torch.allclose(m, torch.full_like(m, 0.5 * 128 / 255), atol=1e-6)
    assert torch.allclose(seen, m + 0.07, atol=1e-6)


def test_a_print_that_slips_is_no_shading():
    mean = torch.full((3, 256, 256), 0.8)
    mean[:, 120:124] = 0.1  # a stroke of 2 cm of a shirt, that slips by as much
    slipped = mean.roll(4, 1)
    layer = LayerEdits([paint_of(255, 256)], mean, torch.ones(1, 256, 256))
    m, _ = layer(slipped[None], slipped[None])
    assert (m - 1).abs().max() < 0.45 and (m - 1).abs().mean() < 0.02 and (slipped / mean - 1).abs().max() > 6


def test_what_is_not_covered_stays():
    cover = np.zeros((32, 32), np.uint8)
    cover[:, :16] = 255
    avatar = small_avatar.awake(small_avatar.avatar())
    before, _ = decoded(avatar)
    apply_edits(avatar, [scale(0, 0, 0, cover=cover)])
    after, _ = decoded(avatar)
    assert after["shirt"].texture[..., :16].abs().max() == 0
    assert torch.allclose(after["shirt"].texture[..., 16:], before["shirt"].texture[..., 16:], atol=1e-6)


def test_finer_maps_than_the_decoders_are_drawn_under_its_shadow():
    avatar = small_avatar.awake(small_avatar.avatar())
    apply_edits(avatar, [scale(1, 1, 1), paint_of(200, 128)])
    shown, batch = decoded(avatar)
    assert shown["shirt"].texture.shape[-1] == 128 and shown["body"].texture.shape[-1] == 32
    shaded = avatar.shade(shown)["shirt"]
    assert shaded.shaded.shape == shaded.texture.shape and not torch.equal(shaded.shaded, shaded.texture)
    (picture, _) = avatar.compose(shown, batch, small_avatar.SIZE)
    assert torch.isfinite(picture.image).all() and picture.mask.any()


def test_edits_come_back_from_their_files(tmp_path):
    edits = [scale(0.5, 1, 2), *[paint_of(value, 64) for value in range(10)]]
    save_edits(tmp_path, edits)
    found = load_edits(tmp_path)
    assert [edit.words for edit in found] == ["scale"] + ["paint"] * 10
    assert found[0].scale.tolist() == [0.5, 1, 2] and [edit.colour[0, 0, 0] for edit in found[1:]] == list(range(10))
    (tmp_path / "assets" / "edit3.npz").write_bytes(b"rubbish")
    with pytest.raises(UserError, match="edit3.npz: not an edit"):
        load_edits(tmp_path)
    with pytest.raises(UserError, match="the avatar has no layer shirt"):
        apply_edits(small_avatar.avatar(layers=(small_avatar.BODY,)), edits)


# Pictures on cloth ---------------------------------------------------------------------------------------------------


def test_a_checkerboard_has_its_squares():
    colour = paint.checkered(SHIRT, 4, 64).colour[..., 0]
    assert set(np.unique(colour)) == set(paint.TONES)
    assert (colour[:16, :16] == colour[0, 0]).all() and (np.diff(colour[0].astype(int)) != 0).sum() == 3
    assert colour[0, 0] == colour[16, 16] != colour[0, 16]


def quadrants():
    """A picture whose red grows to the right and whose green grows downwards."""
    x, y = np.meshgrid(np.linspace(0, 255, 64), np.linspace(0, 255, 32))
    return np.stack([x, y, 0 * x, 0 * x + 255], -1).astype(np.uint8)


@pytest.mark.parametrize("place", ["front", "at"])
def test_a_picture_lies_upright_and_unmirrored(place):
    if place == "front":
        place = paint.place_in_front(SHIRT, FRONT, 0.2, UP)
        assert abs(place.centre[0]) < 0.01 and place.centre[1] < -0.1 and place.normal @ FRONT > 0.95
    else:
        u = 0.1 + 0.8 * 0.75  # at the angle of the front, -y
        place = paint.place_at(SHIRT, (u, 0.5), 0.2, UP)
        assert np.linalg.norm(place.centre - [0, -0.12, 0.3]) < 0.02
    made = paint.placed(SHIRT, quadrants(), "image", place, 256)
    shown = made.cover > 250
    offset = UvMap(SHIRT, 256).texels(SHIRT.rest)[shown] - place.centre
    red, green = (made.colour[shown][:, k].astype(float) for k in (0, 1))
    assert np.corrcoef(offset[:, 0], red)[0, 1] > 0.99  # who faces -y has x = his left on the viewer's right
    assert np.corrcoef(-offset[:, 2], green)[0, 1] > 0.99
    assert np.ptp(offset[:, 2]) == pytest.approx(place.width / 2, rel=0.1)  # as wide as asked, twice as wide as tall
    assert np.ptp(offset[:, 0]) == pytest.approx(place.width, rel=0.1)


def test_sizes_are_shares_of_the_square():
    metres = paint.metres_per_uv(SHIRT)
    area = 2 * np.pi * 0.12 * 0.4  # onto 0.8 x 0.8 of the square
    assert metres == pytest.approx(np.sqrt(area) / 0.8, rel=0.05)


def test_the_front_is_where_left_and_right_say():
    J = np.array([[0.0, 0, 1], [0.2, 0.1, 1.2], [-0.2, 0.1, 1.2]])
    assert np.allclose(paint.front_of(J, ("root", "arm.L", "arm.R"), UP), FRONT)
    with pytest.raises(UserError, match="give --at U,V"):
        paint.front_of(J, ("root", "a", "b"), UP)


def test_text_is_dark_on_bright_cloth_and_must_have_letters():
    dark, light = (paint.written("Jo 7", bright) for bright in (True, False))
    assert dark[..., 3].max() == 255 and dark[0, 0, 3] == 0 and dark[..., :3].max() < 60 and light[..., :3].min() > 200
    assert paint.written("Jo\n7", True).shape[0] > 1.5 * dark.shape[0]
    for text, said in (
        ("\u6771\u4eac", "no letter '\u6771'"),
        ("  ", "expected 1 to 200"),
        ("a" * 201, "201 letters"),
        ("a\tb", "no letter"),
    ):
        with pytest.raises(UserError, match=said):
            paint.written(text, True)


# The baseline --------------------------------------------------------------------------------------------------------


def test_the_baseline_is_marked_where_the_garment_lies():
    marked = mark(SURFACE, SURFACE.rest, SHIRT, SHIRT.rest, 128)
    texels = UvMap(SURFACE, 128)
    z = texels.texels(SURFACE.rest)[..., 2]
    inside, sure = texels.inside, np.abs(z - 0.1) + np.abs(z - 0.5) != 0
    assert marked.region[inside & (z > 0.11) & (z < 0.49)].all()
    assert not marked.region[inside & sure & ((z < 0.09) | (z > 0.51))].any() and not marked.region[~texels.valid].any()
    u = (np.arange(128) + 0.5) / 128
    at = marked.uv[marked.region & inside]
    expected = np.broadcast_to(u, (128, 128))[marked.region & inside]
    wrapped = np.abs(at[:, 0] - expected)
    assert np.quantile(wrapped, 0.99) < 0.02  # the same angle has the same u
    assert np.quantile(np.abs(at[:, 1] - (0.1 + 0.8 * (z[marked.region & inside] - 0.1) / 0.4)), 0.99) < 0.02


def test_an_arm_against_the_garment_is_not_marked():
    inward = small_avatar.tube("surface", "surface", 0.125)
    inward.faces[:] = inward.faces[:, ::-1]
    inward.face_uv[:] = inward.face_uv[:, ::-1]
    assert not mark(inward, inward.rest, SHIRT, SHIRT.rest, 64).region.any()
    far = small_avatar.tube("surface", "surface", 0.16)
    assert not mark(far, far.rest, SHIRT, SHIRT.rest, 64).region.any()


def test_the_baseline_gets_the_garments_picture():
    marked = mark(SURFACE, SURFACE.rest, SHIRT, SHIRT.rest, 128)
    made = paint.covering(SHIRT, quadrants(), "q.png", 128)
    edited = edit_of_surface(made, SURFACE, marked)
    assert edited.layer == "surface" and edited.garment == "shirt"
    assert (edited.cover[marked.region] > 250).all() and (edited.cover[~marked.region] == 0).all()
    red = edited.colour[..., 0][marked.region].astype(float) / 255
    assert np.quantile(np.abs(red - marked.uv[marked.region][:, 0]), 0.99) < 0.02


def test_borders_that_lie_apart_are_measured():
    foreground = np.ones((20, 40), bool)
    a, b = (np.arange(40)[None] < k + np.zeros((20, 1)) for k in (10, 13))
    assert np.allclose(border_distances(a, b, foreground), 3) and len(border_distances(a, b, foreground)) == 40
    assert np.allclose(border_distances(a, a, foreground), 0)
    assert len(border_distances(a, np.zeros_like(a), foreground)) == 0
    foreground[:, 10:] = False  # the silhouette is no border
    assert len(border_distances(a, a, foreground)) == 0


# The command ---------------------------------------------------------------------------------------------------------


def green(picture):
    return (picture[..., 1] > picture[..., 0] + 40) & (picture[..., 1] > picture[..., 2] + 40)


def hashes(folder):
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


@pytest.fixture(scope="module")
def source(driven_avatar, tmp_path_factory):
    return shutil.copytree(driven_avatar, tmp_path_factory.mktemp("to_edit") / "to_edit")


@pytest.fixture(scope="module")
def edited(source, tmp_path_factory):
    before, out = hashes(source), tmp_path_factory.mktemp("edited") / "green"
    done = edit(source, out, Change("tshirt", scale="0.25,1.5,0.25"), frames=[0, 3])
    assert hashes(source) == before
    return out, done


def test_an_edit_is_an_avatar_of_its_own(source, edited):
    out, done = edited
    assert sorted(p.name for p in out.iterdir()) == [
        "assets", "avatar.json", "avatar.safetensors", "baseline", "edit.json", "edit.png", "temporal.safetensors",
    ]  # fmt: skip
    for name in ("avatar.safetensors", "baseline/avatar.safetensors", "assets/maps.npz", "baseline/assets/maps.npz"):
        assert (out / name).read_bytes() == (source / name).read_bytes()
    assert json.loads((out / "avatar.json").read_text())["edits"] == ["tshirt: scale 0.25,1.5,0.25"]
    assert done.baseline and [p.name for p in out.parent.iterdir()] == ["green"]
    before, after = load_avatar(source), load_avatar(out)
    assert before.model("tshirt").edits is None and after.model("body").edits is None
    m = before.model("tshirt").mean_texture[None]
    shown, _ = after.model("tshirt").edits(m, m)
    assert torch.allclose(shown, m * torch.tensor([0.25, 1.5, 0.25])[:, None, None], atol=1e-6)


def test_the_sheet_and_its_numbers(edited):
    out, done = edited
    found = json.loads((out / "edit.json").read_text())
    assert found["frames"] == [0, 3] and [row["frame"] for row in found["per_frame"]] == [0, 3]
    for name in ("layered", "baseline"):
        assert 0 < found[name]["border_mm"] < found[name]["border95_mm"] < 200 and 0 < found[name]["area_share"] < 0.5
    assert found["layered"] == done.measured["layered"]
    picture = np.asarray(Image.open(out / "edit.png").convert("RGB")).astype(int)
    width = picture.shape[1] // 3
    share = green(picture).reshape(len(picture), 3, width).mean((0, 2))
    assert share[0] < 0.01 and share[1] > 0.1 and share[2] > 0.1  # captured, layered, single layer


def test_editing_an_edited_avatar_adds_to_it(edited, tmp_path):
    done = edit(edited[0], tmp_path / "both", Change("tshirt", text="Hi"), sheet=False)
    edits = json.loads((tmp_path / "both" / "avatar.json").read_text())["edits"]
    assert edits == ["tshirt: scale 0.25,1.5,0.25", "tshirt: text 'Hi'"] and done.measured is None
    for folder, layer in ((tmp_path / "both", "tshirt"), (tmp_path / "both" / "baseline", "surface")):
        assert [edit.layer for edit in load_edits(folder)] == [layer, layer]
        assert 0 < (load_edits(folder)[1].cover > 0).mean() < 0.1
    assert not (tmp_path / "both" / "edit.png").exists()


def test_an_edited_avatar_animates_and_its_body_does_not_change(source, edited, sample_run, tmp_path):
    pictures = []
    for name, folder in (("plain", source), ("edited", edited[0]), ("base", edited[0] / "baseline")):
        animate(folder, sample_run, tmp_path / name, frames=[2], height=90, meshes=False)
        pictures.append(np.asarray(Image.open(tmp_path / name / "pictures" / "000002.png")).astype(int))
    plain, changed, base = pictures
    other = (plain != changed).any(2)
    assert 0.02 < other.mean() < 0.5 and green(changed)[other].mean() > 0.8 and not green(plain).any()
    assert (plain[~other] == changed[~other]).all() and (
        (plain < 250).any(2) & ~other
    ).mean() > 0.02  # skin and trousers
    assert green(base).mean() > 0.02


def test_evaluation_says_that_an_avatar_is_edited(edited):
    from toile.avatar.measure.evaluation import evaluate_avatar

    assert "edited: tshirt: scale 0.25,1.5,0.25" in evaluate_avatar(edited[0], frames=[3], sheets=False)["warnings"]
    shutil.rmtree(edited[0] / "evaluation")
    shutil.rmtree(edited[0] / "baseline" / "evaluation")


def test_a_stopped_edit_leaves_no_folder_that_looks_whole(source, tmp_path):
    def stop(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        edit(source, tmp_path / "out", Change("tshirt", checker=8), frames=[0], progress=stop)
    assert not list(tmp_path.iterdir())
    edit(source, tmp_path / "out", Change("tshirt", checker=8), sheet=False)
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize(
    "options, said",
    [
        (dict(garment="skirt", checker=8), "--garment skirt: the avatar has tshirt"),
        (dict(garment="body", checker=8), "--garment body: the avatar has tshirt"),
        (dict(), "expected one of --scale, --checker, --image, --text: none is given"),
        (dict(checker=8, text="a"), "--checker and --text are given"),
        (dict(scale="1,2"), "--scale 1,2: expected three numbers R,G,B"),
        (dict(scale="1,2,x"), "--scale 1,2,x: expected three numbers R,G,B"),
        (dict(scale="1,2,nan"), "--scale 1,2,nan: expected three numbers R,G,B"),
        (dict(scale="1,2,-1"), "--scale 1,2,-1: expected factors from 0 to 16"),
        (dict(scale="1,1,1", at="0.5,0.5"), "--at 0.5,0.5: --scale changes the whole garment"),
        (dict(checker=8, size=0.5), "--size 0.5: --checker changes the whole garment"),
        (dict(checker=0), "--checker 0: expected 1 to 256 squares"),
        (dict(image="missing.png"), "missing.png: the file is missing"),
        (dict(image=__file__), "test_edit.py: cannot be read as a PNG or JPEG image"),
        (dict(text="a", at="0.5"), "--at 0.5: expected two numbers U,V"),
        (dict(text="a", at="0.5,1.5"), "--at 0.5,1.5: expected numbers from 0 to 1"),
        (dict(text="a", at="0,0"), "--at 0,0: tshirt has no cloth there, the nearest is at 0."),
        (dict(text="a", size=0.0), "--size 0: expected a share"),
        (dict(text="a", size=float("nan")), "--size nan: expected a share"),
    ],
)
def test_what_cannot_be_done_is_refused(source, tmp_path, options, said):
    with pytest.raises(UserError) as error:
        edit(source, tmp_path / "out", Change(**({"garment": "tshirt"} | options)))
    assert said in str(error.value) and "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_folders_that_do_not_fit_are_refused(source, edited, tmp_path):
    change = Change("tshirt", checker=8)
    with pytest.raises(UserError, match="exists already and is not empty"):
        edit(source, edited[0], change)
    with pytest.raises(UserError, match="edit the layered avatar, its baseline goes along"):
        edit(source / "baseline", tmp_path / "out", change)
    with pytest.raises(UserError, match="no registered.zarr"):
        edit(source, tmp_path / "out", change, run=tmp_path)
    with pytest.raises(UserError, match="^--frames 77: none of them is registered and has pictures"):
        edit(source, tmp_path / "out", change, frames=[77])
    assert not list(tmp_path.iterdir())


def test_an_avatar_whose_run_is_gone_asks_for_its_place_and_is_edited_without_a_sheet(source, tmp_path):
    lone, change = tmp_path / "lone", Change("tshirt", checker=8)
    shutil.copytree(source, lone, ignore=shutil.ignore_patterns("baseline", "cache"))
    facts = json.loads((lone / "avatar.json").read_text())
    (lone / "avatar.json").write_text(json.dumps(facts | {"run": str(tmp_path / "gone")}))
    with pytest.raises(UserError, match=f"^{lone}: its run {tmp_path}/gone is not there: give its place by --run$"):
        edit(lone, tmp_path / "out", change)
    assert not (tmp_path / "out").exists() and edit(lone, tmp_path / "out", change, sheet=False).words


def test_an_avatar_whose_run_was_registered_anew_is_named_and_not_the_folder_to_be_made(source, tmp_path):
    old = tmp_path / "old"
    shutil.copytree(source, old, ignore=shutil.ignore_patterns("baseline", "cache"))
    facts = json.loads((old / "avatar.json").read_text())
    (old / "avatar.json").write_text(json.dumps(facts | {"registration": "another"}))
    with pytest.raises(UserError, match=f"its registration is not the one that {old} was trained on$"):
        edit(old, tmp_path / "out", Change("tshirt", checker=8), frames=[0])
    assert [path.name for path in tmp_path.iterdir()] == ["old"]


def test_an_avatar_without_a_baseline_is_shown_alone(source, tmp_path):
    alone = tmp_path / "alone"
    shutil.copytree(source, alone, ignore=shutil.ignore_patterns("baseline", "cache"))
    done = edit(alone, tmp_path / "out", Change("tshirt", image=grey_picture(tmp_path), at="0.5,0.5"), frames=[0])
    assert not done.baseline and done.measured["baseline"] is None and done.measured["layered"]["border_mm"] > 0
    assert Image.open(tmp_path / "out" / "edit.png").width == 2 * (TILE + GAP)


def grey_picture(folder):
    Image.new("L", (30, 20), 128).save(folder / "grey.png")
    return folder / "grey.png"


def test_the_command_says_one_line_and_exits_with_1(source, tmp_path, monkeypatch, capsys):
    arguments = ["edit", str(source), str(tmp_path / "out"), "--garment", "tshirt", "--scale", "red"]
    monkeypatch.setattr(sys, "argv", ["toile", *arguments])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 1
    assert capsys.readouterr().err.strip() == "toile: --scale red: expected three numbers R,G,B"
