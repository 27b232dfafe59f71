"""Samples of a run: what they hold, whence, and a cache that is made once."""

import json
import shutil
import tomllib

import cv2
import numpy as np
import pytest
import torch
from PIL import Image
from torch.utils.data import default_collate

from tests.support.small_disk import largest_file
from toile.avatar.settings import DataSettings
from toile.avatar.train.data import AvatarData
from toile.errors import UserError
from toile.io.run import open_run

SETTINGS = DataSettings(texture_size=64, image=(160, 120), pixel_scale=1.5, crop="garment")


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def data(sample_run, cache):
    return AvatarData(sample_run, SETTINGS, cache, frames=[0, 2])


def files(data):
    return {p.relative_to(data.folder): p.read_bytes() for p in sorted(data.folder.rglob("*")) if p.is_file()}


@pytest.fixture
def other(sample_run, tmp_path):
    """A copy of the run and of its capture, to be spoilt."""
    run, capture = tmp_path / "run", tmp_path / "capture"
    shutil.copytree(sample_run, run)
    shutil.copytree(open_run(sample_run).capture.root, capture)
    config = run / "config.toml"
    text = config.read_text()
    config.write_text(text.replace(tomllib.loads(text)["capture"], str(capture)))
    return run, capture


def test_light_is_told_from_what_it_falls_on_where_asked(data, sample_run, cache):
    assert data.light.shape == (8, 3) and np.isfinite(data.light).all()
    assert {name: of.shape for name, of in data.mean_light.items()} == {"body": (3, 64, 64), "tshirt": (3, 64, 64)}
    assert all(of.min() > 0 for of in data.mean_light.values())
    without = AvatarData(sample_run, SETTINGS.model_copy(update={"light": False}), cache, frames=[0, 2])
    assert without.light is None and without.mean_light is None
    assert without.folder == data.folder  # what is prepared is the same
    one = AvatarData(sample_run, SETTINGS, cache, frames=[2], known=[0, 2])
    assert not one.light.any() and all((of == 1).all() for of in one.mean_light.values())


def test_a_cache_that_a_disk_does_not_take_is_told_by_its_file_and_goes_on_to_the_same(data, sample_run, tmp_path):
    with largest_file(2000), pytest.raises(OSError, match="File too large: .*camera.*safetensors"):
        AvatarData(sample_run, SETTINGS, tmp_path, frames=[0, 2])
    assert not list(tmp_path.rglob(".*.part"))
    assert files(AvatarData(sample_run, SETTINGS, tmp_path, frames=[0, 2])) == files(data)


def test_a_sample_has_what_its_users_were_promised(data):
    batch = default_collate([data[0], data[9]])
    n, g, q = 13718, len(data.layers[1].rest), len(data.face_mean)
    shapes = {
        "frame": (), "camera": (), "rotations": (104, 3), "translation": (3,), "face": (q, 3), "face_seen": (q,),
        "vertices.body": (n, 3), "vertices.tshirt": (g, 3), "confidence.body": (n,), "confidence.tshirt": (g,),
        "image": (3, 160, 120), "mask": (160, 120), "labels": (160, 120), "K": (3, 3), "T_camera_world": (4, 4),
    }  # fmt: skip
    for name in ("body", "tshirt"):
        shapes |= {f"{t}texture.{name}": (3, 64, 64) for t in ("", "mean_")}
        shapes |= {f"texel_weight.{name}": (1, 64, 64), f"mean_weight.{name}": (1, 64, 64)}
    assert {name: tuple(value.shape) for name, value in batch.items()} == {
        name: (2, *shape) for name, shape in shapes.items()
    }
    for name, value in batch.items():
        assert value.dtype == (torch.int64 if name in ("frame", "camera", "labels") else torch.float32), name
        assert torch.isfinite(value).all(), name
    assert (
        len(data) == 2 * 8
        and data.frames == [0, 2]
        and batch["frame"].tolist() == [0, 2]
        and batch["camera"].tolist() == [0, 1]
    )


def test_confidence_textures_and_masks_lie_between_0_and_1(data):
    for sample in (data[i] for i in range(len(data))):
        for name, value in sample.items():
            if name.split(".")[0] in ("texture", "mean_texture", "texel_weight", "confidence", "image", "mask"):
                assert value.min() >= 0 and value.max() <= 1, name
        assert set(sample["confidence.tshirt"].unique().tolist()) <= {0, 0.5, 1}


def test_known_points_project_through_a_samples_K_where_the_real_camera_sees_them(data, sample_run):
    """The capture's cameras are distorted; OpenCV takes that out of their pixels independently."""
    points = data[0]["vertices.tshirt"].double().numpy()[::50]
    for i, camera in enumerate(open_run(sample_run).capture.cameras.values()):
        assert np.abs(camera.distortion).max() > 1e-3
        sample, (seen, _) = data[i], camera.project(points)
        ideal = cv2.undistortPoints(seen[:, None], camera.K, camera.distortion)[:, 0]
        p = (
            points @ sample["T_camera_world"][:3, :3].double().numpy().T
            + sample["T_camera_world"][:3, 3].double().numpy()
        )
        assert np.abs(p[:, :2] / p[:, 2:] - ideal).max() < 2e-5
        K = sample["K"].double().numpy()
        uv = ideal @ K[:2, :2].T + K[:2, 2]
        shift = uv - (ideal @ camera.K[:2, :2].T + camera.K[:2, 2]) / 1.5
        assert np.abs(shift - np.rint(shift[0])).max() < 2e-3  # a window cut at whole pixels of the scaled picture


def test_registered_vertices_fall_on_the_mask_and_the_garment_on_its_label(data):
    on_label = []
    for sample in (data[i] for i in range(8)):
        p = sample["vertices.tshirt"] @ sample["T_camera_world"][:3, :3].T + sample["T_camera_world"][:3, 3]
        column, row = ((p @ sample["K"].T)[:, :2] / p[:, 2:]).long().T
        inside = (row >= 0) & (column >= 0) & (row < 160) & (column < 120)
        assert inside.float().mean() > 0.98  # the window is about the garment
        row, column = row[inside], column[inside]
        assert sample["mask"][row, column].mean() > 0.95
        on_label.append(float((sample["labels"][row, column] == 3).float().mean()))
    assert np.mean(on_label) > 0.8, on_label  # the rest lies behind arms


def test_a_camera_without_a_picture_gives_no_sample_and_a_view_without_labels_none_of_the_scenes(data, other, tmp_path):
    run, capture = other
    (capture / "frames" / "000000" / "images" / "cam05.jpg").unlink()
    (capture / "frames" / "000002" / "labels" / "cam03.png").unlink()
    some = AvatarData(run, SETTINGS, tmp_path / "cache", frames=[0, 2])
    assert len(some) == 15 and some.rows_of(0) == list(range(7)) and len(some.rows_of(2)) == 8
    assert [int(some[i]["camera"]) for i in some.rows_of(0)] == [0, 1, 2, 3, 4, 6, 7]
    labels = some[some.rows_of(2)[3]]["labels"]
    assert not set(labels.unique().tolist()) & set(some.scene.labels.values()) and labels.max() > 0
    assert torch.equal(some[some.rows_of(2)[2]]["labels"], data[8 + 2]["labels"])


def test_a_picture_in_which_nothing_tells_where_the_person_is_is_refused(other, tmp_path):
    run, capture = other
    frame = capture / "frames" / "000002"
    (frame / "masks" / "cam03.png").unlink()
    assert len(AvatarData(run, SETTINGS, tmp_path / "cache", frames=[2])) == 8  # by its labels
    (frame / "labels" / "cam03.png").unlink()
    with pytest.raises(UserError, match="000002/images/cam03.jpg: neither a mask nor a label image"):
        AvatarData(run, SETTINGS, tmp_path / "cache", frames=[2])


def test_a_view_and_the_mean_over_views_agree_where_one_view_alone_saw_a_texel(data):
    samples = [data[i] for i in range(8)]
    for name in data.names:
        weights = torch.stack([s[f"texel_weight.{name}"][0] for s in samples])
        assert torch.allclose(weights.sum(0), samples[0][f"mean_weight.{name}"][0], atol=9 / 256)
        once = (weights > 0).sum(0) == 1
        assert once.any()
        for weight, sample in zip(weights, samples):
            own = once & (weight > 0)
            difference = sample[f"texture.{name}"][:, own] - sample[f"mean_texture.{name}"][:, own]
            assert (difference.abs() < 1e-6).all()


def test_means_over_the_frames_are_filled_and_masked(data):
    for layer in data.layers:
        mean, valid = data.mean_texture[layer.name], data.valid[layer.name]
        assert mean.shape == (3, 64, 64) and mean.dtype == np.float32 and 0.05 < valid.mean() < 0.9
        assert np.isfinite(mean).all() and mean.min() >= 0 and mean.max() <= 1
        seen = sum(
            float(data[i][f"texel_weight.{layer.name}"][0][torch.as_tensor(~valid)].sum()) for i in range(len(data))
        )
        assert seen == 0
    assert 0 < data.texture_std < 0.3
    assert data.layers[1].rest.shape == data[0]["vertices.tshirt"].shape


def test_the_shirts_texture_has_no_skin(data):
    """The bundled shirt is blue: its red stays under its blue wherever it was seen, but for its white print."""
    mean, valid = data.mean_texture["tshirt"], data.valid["tshirt"]
    red, green, blue = mean[:, valid]
    assert ((red > blue + 0.05).mean()) < 0.002


def test_the_cache_is_made_once_and_goes_on_where_it_was_cut(sample_run, data, cache, tmp_path):
    calls = []
    again = AvatarData(sample_run, SETTINGS, cache, frames=[0, 2], progress=lambda *a: calls.append(a))
    assert again.folder == data.folder and not calls
    before = files(data)
    (data.folder / "000002" / "whole").unlink()
    next((data.folder / "000002").glob("camera.*")).write_bytes(b"half")
    AvatarData(sample_run, SETTINGS, cache, frames=[0, 2], progress=lambda *a: calls.append(a))
    assert calls == [(2, 2)] and files(data) == before


@pytest.mark.parametrize("name", ["frame", "camera.cam03"])
def test_a_cache_file_that_is_cut_or_missing_is_told_by_its_name(sample_run, data, tmp_path, name):
    shutil.copytree(data.folder, tmp_path / data.folder.name)
    path = tmp_path / data.folder.name / "000002" / f"{name}.safetensors"
    for spoil in (lambda: path.write_bytes(path.read_bytes()[:-9]), path.unlink):
        spoil()
        with pytest.raises(UserError, match=f"000002/{name}.safetensors: cannot be read: .*prepared anew"):
            spoilt = AvatarData(sample_run, SETTINGS, tmp_path, frames=[0, 2])
            spoilt[spoilt.rows_of(2)[3]]


def test_the_cache_depends_on_what_it_was_made_of(sample_run, data, cache, other):
    geometry = AvatarData(sample_run, SETTINGS.model_copy(update={"geometry_size": 32}), cache, frames=[0, 2])
    assert geometry.folder == data.folder
    import zarr

    moved = AvatarData(other[0], SETTINGS, cache, frames=[2])
    zarr.open_group(str(other[0] / "registered.zarr"), mode="r+")["garment/tshirt/vertices"][2, 7, 1] += 0.001
    assert AvatarData(other[0], SETTINGS, cache, frames=[2]).folder != moved.folder != data.folder


@pytest.mark.parametrize("field", ["K", "distortion", "T_camera_world"])
def test_pictures_of_a_camera_that_was_calibrated_anew_are_prepared_anew(field, other, cache):
    run, capture = other
    before = AvatarData(run, SETTINGS, cache, frames=[2])
    cameras = json.loads((capture / "cameras.json").read_text())
    value = cameras["cameras"][3][field]
    row = value if field == "distortion" else value[0]
    row[-1 if field == "T_camera_world" else 0] += 0.01
    (capture / "cameras.json").write_text(json.dumps(cameras))
    assert AvatarData(run, SETTINGS, cache, frames=[2]).folder != before.folder


def test_the_single_layer_sees_the_same_windows(sample_run, data, cache):
    single = AvatarData(sample_run, SETTINGS, cache, frames=[0], layered=False)
    assert single.names == ["surface"]
    for i in range(8):
        for name in ("image", "K", "labels", "T_camera_world"):
            assert torch.equal(single[i][name], data[i][name])


def test_frames_without_pictures_are_left_out(other):
    run, capture = other
    shutil.rmtree(capture / "frames" / "000001" / "images")
    assert open_run(run).pictured == [0, 2, 3]
    for frame in (0, 2, 3):
        shutil.rmtree(capture / "frames" / f"{frame:06d}" / "images")
    with pytest.raises(UserError, match="pictures"):
        AvatarData(run, SETTINGS, run / "cache")


def test_a_capture_whose_garments_have_changed_is_refused(other):
    run, capture = other
    scene = capture / "scene.toml"
    scene.write_text(scene.read_text().replace('name = "tshirt"', 'name = "jacket"'))
    with pytest.raises(UserError, match="garments"):
        AvatarData(run, SETTINGS, run / "cache")


def test_a_changed_picture_is_prepared_anew(other, tmp_path):
    run, capture = other
    before = AvatarData(run, SETTINGS, tmp_path / "cache", frames=[0])
    same = AvatarData(run, SETTINGS, tmp_path / "cache", frames=[0])
    path = capture / "frames" / "000000" / "images" / "cam03.jpg"
    path.write_bytes((path.parent / "cam04.jpg").read_bytes())
    after = AvatarData(run, SETTINGS, tmp_path / "cache", frames=[0])
    assert before.folder == same.folder != after.folder
    assert not torch.equal(before[3]["image"], after[3]["image"])


@pytest.mark.parametrize("value", [0, 255])
def test_black_and_white_pictures_give_finite_samples(other, value):
    run, capture = other
    for path in (capture / "frames" / "000000" / "images").iterdir():
        Image.fromarray(np.full((*Image.open(path).size[::-1], 3), value, np.uint8)).save(path)
    data = AvatarData(run, SETTINGS, run / "cache", frames=[0])
    assert all(torch.isfinite(v).all() for v in data[0].values()) and data.texture_std < 0.02
    assert abs(float(data.mean_texture["tshirt"].mean()) - value / 255) < 0.02


def emptied(folder, camera):
    for kind in ("masks", "labels"):
        for path in (folder / kind).glob(f"{camera}.*"):
            Image.fromarray(np.zeros(Image.open(path).size[::-1], np.uint8)).save(path)


def test_a_picture_whose_mask_misses_the_registered_body_is_left_out_and_told(other, tmp_path):
    run, capture = other
    for number in ("000000", "000002"):
        emptied(capture / "frames" / number, "cam03")
    emptied(capture / "frames" / "000002", "cam05")
    data = AvatarData(run, SETTINGS, tmp_path, frames=[0, 2])
    assert len(data) == 13 and (0, 3) not in data.samples and (2, 5) not in data.samples
    assert data.warnings == [
        f"{capture}: masks are empty in 3 pictures that the registered body lies in, these are left out: cam03 2, cam05 1"
    ]
    assert AvatarData(run, SETTINGS, tmp_path, frames=[0, 2]).warnings == data.warnings  # kept with the cache


def test_an_empty_mask_of_a_picture_that_the_body_does_not_lie_in_is_kept_in_silence(other, tmp_path):
    run, capture = other
    path = capture / "cameras.json"
    cameras = json.loads(path.read_text())
    cameras["cameras"][3]["K"][0][2] -= 2000  # it looks beside the person
    path.write_text(json.dumps(cameras))
    emptied(capture / "frames" / "000000", "cam03")
    data = AvatarData(run, SETTINGS, tmp_path, frames=[0])
    assert len(data) == 8 and not data.warnings and not data[3]["mask"].any()


def test_a_person_in_no_picture_gives_empty_finite_samples(other):
    run, capture = other
    for kind in ("masks", "labels"):
        for path in (capture / "frames" / "000003" / kind).glob("*"):
            Image.fromarray(np.zeros(Image.open(path).size[::-1], np.uint8)).save(path)
    data = AvatarData(run, SETTINGS, run / "cache", frames=[3])
    sample = data[0]
    assert all(torch.isfinite(v).all() for v in sample.values()) and sample["mask"].sum() == 0
    assert not data.valid["tshirt"].any() and (data.mean_texture["tshirt"] == 0.5).all() and data.texture_std == 0


def test_a_run_without_garments_is_a_body_on_its_tracked_surface(other):
    import zarr

    run, capture = other
    scene = (capture / "scene.toml").read_text()
    (capture / "scene.toml").write_text(scene[: scene.index("[[garment]]")] + scene[scene.index("[cameras]") :])
    store = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    store.attrs["scene"] = store.attrs["scene"] | {"garments": []}
    del store["inner"], store["garment"], store["labels"], store["confidence/inner"], store["confidence/tshirt"]
    data = AvatarData(run, SETTINGS, run / "cache", frames=[0, 1])
    assert data.names == ["body"] and np.array_equal(
        data[0]["vertices.body"], store["track/vertices"][0].astype(np.float32)
    )
    assert 0.05 < data.valid["body"].mean()


def test_a_crop_of_the_head_shows_it_in_its_middle(sample_run, tmp_path):
    settings = SETTINGS.model_copy(update={"crop": "head", "image": (64, 64)})
    found = AvatarData(sample_run, settings, tmp_path, frames=[0])
    model, sample = open_run(sample_run).body_model, found[0]
    head = sample["vertices.body"].numpy()[model.face_vertices(0.12)] @ sample["T_camera_world"].numpy()[:3, :3].T
    uv = (head + sample["T_camera_world"].numpy()[:3, 3]) @ sample["K"].numpy().T
    uv = uv[:, :2] / uv[:, 2:]
    assert np.abs(0.5 * (uv.min(0) + uv.max(0)) - 32).max() < 2


def test_without_facial_keypoints_no_face_drives(sample_run, tmp_path):
    found = AvatarData(sample_run, SETTINGS.model_copy(update={"face": False}), tmp_path, frames=[0])
    assert found.face_mean is None and found.head is None
