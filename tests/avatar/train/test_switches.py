"""Parts that settings switch off are really gone: views, shadows, soft visibility, and a garment's encoder."""

import numpy as np
import pytest
import torch

from tests.support import small_avatar as small
from toile.avatar.model.avatar import Avatar
from toile.avatar.settings import DataSettings, LossWeights
from toile.avatar.train.data import AvatarData
from toile.avatar.train.objective import Objective

JOINT = 2  # the last of the phases


def parameters(model, part):
    return [name for name, _ in model.named_parameters() if f".{part}." in name]


def decode(model, batch):
    with torch.no_grad():
        return model.decode(batch, model.means(model.encode(batch)))


def test_without_view_a_texture_is_the_same_from_everywhere():
    model = small.awake(small.avatar(options=small.settings(view=False)))
    batch = small.batch(model)
    moved = batch | {"T_camera_world": batch["T_camera_world"].roll(1, 0)}
    assert not parameters(model, "view") and parameters(small.avatar(), "view")
    for name, one in decode(model, batch).items():
        assert torch.equal(one.texture, decode(model, moved)[name].texture) and torch.equal(
            one.texture, one.mean_texture
        )


def test_without_shadow_nothing_is_shaded_and_no_ray_is_cast(monkeypatch):
    model = small.awake(small.avatar(options=small.settings(shadow=False)))
    monkeypatch.setattr(Avatar, "ambient_occlusion", lambda *_: pytest.fail("ambient occlusion"))
    decoded = decode(model, small.batch(model))
    assert not parameters(model, "shadow") and parameters(small.avatar(), "shadow")
    for one in model.shade(decoded).values():
        assert one.shadow is None and torch.equal(one.shaded, one.texture)


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_without_weight_soft_visibility_is_neither_a_term_nor_drawn(weight, monkeypatch):
    model = small.avatar()
    settings = model.settings.model_copy(update={"weights": LossWeights(visibility=weight)})
    asked, compose = [], Avatar.compose

    def note(self, *args, layer_depth=False, **rest):
        asked.append(layer_depth)
        return compose(self, *args, layer_depth=layer_depth, **rest)

    monkeypatch.setattr(Avatar, "compose", note)
    terms = Objective(model, settings)(small.batch(model), list(settings.phases())[JOINT], 0.5)
    assert ("visibility" in terms) == (weight > 0) and asked == [weight > 0]


@pytest.fixture
def regressed():
    options = small.settings()
    model = small.awake(
        small.avatar(options=options.model_copy(update={"data": options.data.model_copy(update={"window": 3})}))
    )
    batch = small.batch(model)
    g = torch.Generator().manual_seed(1)
    batch["window.rotations"] = 0.3 * torch.randn(2, 3, 3, 3, generator=g)
    batch["window.face"], batch["window.face_seen"] = batch["face"][:, None].expand(-1, 3, -1, -1), torch.ones(2, 3, 2)
    model.projection.fit(model.window_features(batch).flatten(0, 1))
    return model, batch


def test_a_regressed_garment_follows_the_window_and_has_no_code(regressed):
    model, batch = regressed
    assert not parameters(model, "encoder") and model.encode(batch) == {}
    first, earlier = decode(model, batch), batch["window.rotations"].clone()
    earlier[:, 0] += 0.2
    other = decode(model, batch | {"window.rotations": earlier})
    assert not torch.allclose(first["shirt"].unposed, other["shirt"].unposed)
    assert not torch.allclose(first["shirt"].texture, other["shirt"].texture)
    assert torch.equal(first["body"].unposed, other["body"].unposed)


def test_a_regressed_garment_is_trained_end_to_end_without_kl(regressed):
    model, batch = regressed
    terms = Objective(model, model.settings)(batch, list(model.settings.phases())[JOINT], 0.5)
    assert "kl" not in terms
    sum(terms.values()).backward()
    gradients = [p.grad for name, p in model.named_parameters() if ".regressor." in name]
    assert gradients and all(g is not None and torch.isfinite(g).all() for g in gradients)
    assert any(g.abs().max() > 0 for g in gradients)


def test_windows_hold_the_frames_up_to_the_sample_s_own(sample_run, tmp_path):
    settings = DataSettings(geometry_size=64, texture_size=64, image=(64, 64), pixel_scale=4.0)
    usual = AvatarData(sample_run, settings, tmp_path, [0, 2])
    data = AvatarData(sample_run, settings.model_copy(update={"window": 3}), tmp_path, [0, 2])
    assert data.folder == usual.folder and "window.rotations" not in usual[0]
    poses = data.run.pose.rotations[:].astype(np.float32)
    found = {int(data[i]["frame"]): data[i]["window.rotations"].numpy() for i in range(len(data))}
    assert (found[2] == poses[:3]).all()  # frame 1 is not among the data's, its pose is known all the same
    assert (found[0] == poses[0]).all() and torch.equal(data[0]["window.face_seen"][2], data[0]["face_seen"])


def test_windows_of_other_frames_hold_none_that_the_training_holds_out(sample_run, tmp_path):
    settings = DataSettings(geometry_size=64, texture_size=64, image=(64, 64), pixel_scale=4.0, window=3)
    data = AvatarData(sample_run, settings, tmp_path, [0, 3], left_out=[1, 2])
    poses = data.run.pose.rotations[:].astype(np.float32)
    assert (data.pose_window(3)["window.rotations"].numpy() == poses[3]).all()
    assert (data.pose_window(2)["window.rotations"].numpy() == poses[:3]).all()  # held out, it may see what came before
    ends = AvatarData(sample_run, settings, tmp_path, [3], left_out=[0, 2])  # all between the first and the last
    assert (ends.pose_window(1)["window.rotations"].numpy() == poses[[0, 0, 1]]).all()
    assert (ends.pose_window(3)["window.rotations"].numpy() == poses[3]).all()


def test_features_of_windows_are_projected_as_the_training_frames_spread(sample_run, tmp_path):
    settings = DataSettings(geometry_size=64, texture_size=64, image=(64, 64), pixel_scale=4.0, window=2)
    data = AvatarData(sample_run, settings, tmp_path)
    options = small.settings().model_copy(update={"data": settings})
    names = ("layers", "J", "parents", "cameras", "scene", "mean_texture", "valid", "face_mean", "head")
    model = Avatar(options, **{name: getattr(data, name) for name in names})
    model.fit_projection(data)
    windows = [data.pose_window(n) for n in data.frames]
    features = model.window_features({name: torch.stack([w[name] for w in windows]) for name in windows[0]})[:, -1]
    projected = model.projection(features)
    assert projected.mean(0).abs().max() < 1e-3 and projected.var(0, correction=0).sum().sqrt() == pytest.approx(
        3, rel=1e-3
    )
