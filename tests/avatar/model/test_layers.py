"""Layers as a run holds them, and skinning in torch against the core's."""

import json
import shutil

import numpy as np
import pytest
import torch
import zarr

from toile.avatar.model.skinning import Skeleton, Skin, rotation_matrices
from toile.errors import UserError
from toile.io.body import load_body_model
from toile.io.run import open_run
from toile.surface.layers import read_layers, surface_layer


def tensors(*arrays):
    return (torch.tensor(np.asarray(a), dtype=torch.float32)[None] for a in arrays)


def test_rotation_matrices_equal_scipy_and_are_smooth_at_zero():
    from scipy.spatial.transform import Rotation

    r = np.r_[np.random.default_rng(0).normal(size=(50, 3)), [[0, 0, 0], [1e-7, 0, 0], [0, np.pi, 0]]]
    R = rotation_matrices(torch.tensor(r)).numpy()
    assert np.abs(R - Rotation.from_rotvec(r).as_matrix()).max() < 1e-9
    zero = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    rotation_matrices(zero)[2, 1].backward()
    assert zero.grad.tolist() == [1, 0, 0]


def test_skeleton_and_skin_equal_the_body_model_to_float32(sample_run):
    run = open_run(sample_run)
    J, model, (layer, shirt) = run.rest_joints, run.body_model, read_layers(run)
    rotations, translation = run.pose.at(1)
    R, t = Skeleton(J, model.parents)(*tensors(rotations, translation))
    posed = model.skin(layer.rest, J, rotations, translation)
    skin = Skin(layer)
    assert np.abs(skin.pose(*tensors(layer.rest), R, t)[0].numpy() - posed).max() < 2e-6
    assert np.abs(skin.unpose(*tensors(posed), R, t)[0].numpy() - layer.rest).max() < 4e-6
    back = Skin(shirt).unpose(Skin(shirt).pose(*tensors(shirt.rest), R, t), R, t)
    assert np.abs(back[0].numpy() - shirt.rest).max() < 4e-6


def test_forward_kinematics_of_a_batch_equals_each_alone():
    model = load_body_model("anny")
    skeleton = Skeleton(model.J, model.parents)
    r = torch.randn(3, len(model.parents), 3, generator=torch.Generator().manual_seed(0)) * 0.3
    together = skeleton(r, torch.zeros(3, 3))
    for i in range(3):
        alone = skeleton(r[i : i + 1], torch.zeros(1, 3))
        assert all(torch.allclose(a[i], b[0], atol=1e-6) for a, b in zip(together, alone))


def test_layers_are_the_runs_and_rest_is_the_mean_of_the_frames_asked_for(sample_run):
    run = open_run(sample_run)
    body, shirt = read_layers(run)
    assert (body.name, body.kind, shirt.name, shirt.kind) == ("body", "body", "tshirt", "garment")
    assert np.array_equal(shirt.faces, run.garments["tshirt"].faces) and np.array_equal(
        shirt.uv, run.garments["tshirt"].uv
    )
    assert shirt.label == 3 and {"neck", "hem"} <= set(shirt.loops)
    for layer in (body, shirt):
        assert np.allclose(layer.skin_val.sum(1), 1, atol=1e-12) and np.isfinite(layer.rest).all()
    one, other = (read_layers(run, [n])[1].rest for n in (0, 1))
    assert np.allclose(read_layers(run, [0, 1])[1].rest, 0.5 * (one + other), atol=1e-12)
    surface = surface_layer(run)
    assert surface.kind == "surface" and np.abs(surface.rest - body.rest).max() > 1e-3


@pytest.mark.parametrize(
    "spoil, message",
    [
        (lambda g: g.__delitem__("confidence/tshirt"), "confidence/tshirt"),
        (lambda g: g.__delitem__("garment/tshirt/uv"), "garment/tshirt/uv"),
        (lambda g: g["garment/tshirt/uv"].__setitem__((0, 0), 1.5), "garment tshirt: uv"),
        (lambda g: g["garment/tshirt/face_uv"].__setitem__((0, 0), 10**6), "garment tshirt: faces, UVs"),
        (lambda g: g["inner/faces"].__setitem__(0, [2, 1, 0]), "inner/faces"),
        (lambda g: g["done"].__setitem__(slice(None), 2), "none of the frames"),
    ],
    ids=["no confidence", "no uv", "uv outside", "face_uv outside", "other topology", "nothing registered"],
)
def test_a_run_that_does_not_fit_is_refused_in_one_line(sample_run, tmp_path, spoil, message):
    run = tmp_path / "run"
    shutil.copytree(sample_run, run)
    spoil(zarr.open_group(str(run / "registered.zarr"), mode="r+"))
    with pytest.raises(UserError, match=message) as caught:
        read_layers(open_run(run))
    assert "\n" not in str(caught.value)


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(UserError, match="registered.zarr"):
        open_run(tmp_path)


def test_a_body_model_file_is_found_in_the_capture(sample_run, tmp_path):
    """[body] model = "person.npz" is a path inside the capture."""
    run, capture = tmp_path / "run", tmp_path / "capture"
    shutil.copytree(sample_run, run)
    capture.mkdir()
    from toile.io.body import PACKAGED

    shutil.copy(PACKAGED["anny"], capture / "person.npz")
    zarr.open_group(str(run / "registered.zarr"), mode="r+").attrs["body_model"] = "person.npz"
    (run / "config.toml").write_text(f"capture = {json.dumps(str(capture))}\n")
    assert len(read_layers(open_run(run))) == 2


def test_principal_modes_are_orthogonal_and_one_standard_deviation_long():
    from toile.surface.layers import principal_modes

    rng = np.random.default_rng(7)
    truth = rng.normal(size=(3, 40, 3)) * np.array([3.0, 2.0, 1.0])[:, None, None] * 1e-3
    amplitudes = rng.normal(size=(20, 3))
    shapes = np.einsum("fk,knd->fnd", amplitudes - amplitudes.mean(0), truth)
    modes = principal_modes(shapes, 16).reshape(-1, 120).astype(np.float64)
    assert len(modes) == 3
    product = modes @ modes.T
    assert np.abs(product - np.diag(np.diag(product))).max() < 1e-5 * product.max()
    found = shapes.reshape(20, -1) @ (modes / np.diag(product)[:, None]).T
    np.testing.assert_allclose(found.std(0), 1, rtol=1e-5)
    assert (found[np.abs(found).argmax(0), np.arange(3)] > 0).all()
    np.testing.assert_allclose(found @ modes, shapes.reshape(20, -1), atol=1e-7)
    assert principal_modes(np.zeros((1, 40, 3)), 4).shape == (0, 40, 3)
