"""A shirt over trousers, from the studio to the animation: every stage takes both, and they never go through each other."""

import json

import numpy as np
import pytest

pytestmark = pytest.mark.slow(seconds=300)


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """(capture, run, avatar, animation) of a tiny capture."""
    pytest.importorskip("newton")
    pytest.importorskip("anny")
    from toile.avatar.drive.animate import animate
    from toile.avatar.drive.teaching import train_temporal
    from toile.avatar.settings import DataSettings, NetworkSettings, TemporalSettings
    from toile.avatar.settings import preset as avatar_preset
    from toile.avatar.train.make import Request, make_avatar
    from toile.config import preset
    from toile.pipeline.run import register
    from toile.studio import garment, motion
    from toile.studio.make import StudioOptions, make_capture

    folder = tmp_path_factory.mktemp("two")
    capture, run, avatar, out = (folder / name for name in ("capture", "run", "avatar", "out"))
    options = dict(
        frames=4,
        cameras=6,
        size=256,
        seed=5,
        motion="talk",
        garment="cut",
        trousers=True,
        scan_faces=20_000,
        truth="plain",
    )
    with pytest.MonkeyPatch.context() as patch:  # short preludes
        patch.setattr(garment, "SETTLING", 4)
        patch.setattr(motion, "RAMP", 8)
        make_capture(capture, StudioOptions(**options))
    assert register(capture, run, preset("draft")).ok == (0, 1, 2, 3)
    sizes = dict(
        data=DataSettings(geometry_size=64, texture_size=64, image=(64, 64), pixel_scale=4.0),
        network=NetworkSettings(latent=8, width=8, least_width=4, ao_rays=4, ao_size=32),
        body_steps=2, garment_steps=2, joint_steps=2,
    )  # fmt: skip
    settings = avatar_preset("draft").model_copy(update=sizes)
    make_avatar(Request(run, settings, say=lambda _: None), avatar)
    train_temporal(avatar, TemporalSettings(window=2, channels=8, steps=20))
    return capture, run, avatar, (out, animate(avatar, run, out, frames=[1, 3], height=64))


def test_both_garments_are_registered_and_measured(chain):
    from toile.measure.evaluate import evaluate
    from toile.measure.report import write_report

    found = evaluate(chain[1])["all"]
    assert list(found["garment"]) == ["trousers", "tshirt"]
    assert found["intersections_left"] <= 4
    for name, measures in found["garment"].items():
        assert found["label_iou"][name] > 0.9
        assert measures["surface_mm"] < 6
    boundary = found["garment"]["trousers"]["boundary_mm"]
    assert max(boundary["ankle_left"], boundary["ankle_right"]) < 15  # a pixel is 9 mm
    assert boundary["waist"] < 60  # hidden
    page = write_report(chain[1]).read_text()
    assert "body, trousers, tshirt" in page and "trousers waist to true border" in page


def test_both_garments_are_trained_and_measured(chain):
    from toile.avatar.measure.evaluation import evaluate_avatar
    from toile.avatar.model.checkpoint import load_avatar

    assert [layer.name for layer in load_avatar(chain[2]).layers] == ["body", "trousers", "tshirt"]
    found = json.dumps(evaluate_avatar(chain[2]))
    assert "trousers" in found and "tshirt" in found and "NaN" not in found


def test_driven_garments_stay_out_of_the_body_and_of_each_other(chain):
    from toile.io.mesh import read_mesh
    from toile.kernels import intersecting_pairs

    out, done = chain[3]
    body, legs, shirt = (read_mesh(out / "meshes" / n / "000003.ply") for n in ("body", "trousers", "tshirt"))
    assert done.intersections_left == 0
    assert len(intersecting_pairs(shirt.vertices, shirt.faces, legs.vertices, legs.faces)) == 0
    assert np.isfinite(legs.vertices).all() and np.isfinite(body.vertices).all()


@pytest.mark.parametrize("helps", [False, True])
def test_the_outer_garment_is_measured_as_cloth_over_the_inner_one_as_that_is_shown(
    chain, tmp_path, monkeypatch, helps
):
    """As cloth where that helps, by codes where it does not: what falls off the body carries nothing."""
    from shutil import copytree

    from toile.avatar.drive import cloths
    from toile.avatar.drive.draping import Cloth

    asked, measure = [], cloths._left_over
    spy = lambda run, driven, under, name, *rest: (
        asked.append((name, list(under))) or measure(run, driven, under, name, *rest)
    )
    monkeypatch.setattr(cloths, "_left_over", spy)
    monkeypatch.setattr(Cloth, "helps", helps)
    folder = copytree(chain[2], tmp_path / "avatar")
    cloths.ensure_cloths(folder)
    assert asked == [("trousers", []), ("tshirt", ["trousers"] if helps else [])]
    assert all((folder / f"cloth.{name}.npz").exists() for name in ("trousers", "tshirt"))
