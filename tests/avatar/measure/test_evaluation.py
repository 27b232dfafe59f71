"""Errors added up over pictures, and the shape of what `toile evaluate AVATAR --json` prints."""

import dataclasses
import json

import numpy as np
import pytest

from tests.support.pictures import SHIRT, pictures
from toile.avatar.measure.evaluation import COUNTED, PictureErrors
from toile.errors import UserError
from toile.measure.truth import mean_measures

MEASURES = {
    "mse",
    "ssim",
    "psnr",
    "band_mse",
    "band_ssim",
    "band_psnr",
    "garment_mse",
    "body_mse",
    "silhouette_mse",
    "face_mse",
    "face_ssim",
    "ms_ssim",
    "gradient_similarity",
    "legibility",
    *COUNTED.values(),
}


@pytest.fixture(scope="module")
def shown():
    return list(pictures())


def errors(shown, garments=(SHIRT,)):
    out = PictureErrors(garments)
    for picture in shown:
        out.add(picture)
    return out


def test_more_blur_is_worse_in_every_measure(shown):
    sums = errors(shown)
    sharp, blurred = sums.measures("layered"), sums.measures("baseline")
    assert sharp.keys() - {"cameras"} == MEASURES
    for name in MEASURES - set(COUNTED.values()):
        assert (sharp[name] < blurred[name]) == name.endswith("mse"), name


def test_the_mean_over_cameras_weighs_pixels(shown):
    found = errors(shown).measures("layered")
    cameras = found["cameras"].values()
    assert found["pixels"] == sum(p.mask.sum() for p in shown) == sum(c["pixels"] for c in cameras)
    assert found["mse"] == pytest.approx(sum(c["mse"] * c["pixels"] for c in cameras) / found["pixels"])
    assert found["ssim"] == pytest.approx(sum(c["ssim"] * c["pixels"] for c in cameras) / found["pixels"])


def test_several_garments_are_measured_each_by_itself_too(shown):
    both = PictureErrors((SHIRT, SHIRT + 40), ("shirt", "trousers"))
    split = [
        np.where((p.labels == SHIRT) & (np.arange(p.labels.shape[1]) % 2 > 0), SHIRT + 40, p.labels) for p in shown
    ]
    for picture, labels in zip(shown, split):
        both.add(dataclasses.replace(picture, labels=labels))
    found, pixels = both.measures("layered"), [sum((l == i).sum() for l in split) for i in (SHIRT, SHIRT + 40)]
    assert min(pixels) > 0 and set(found["garments"]) == {"shirt", "trousers"}
    each = found["garments"]["shirt"], found["garments"]["trousers"]
    assert found["garment_mse"] == pytest.approx(np.average(each, weights=pixels))
    assert "garments" not in errors(shown).measures("layered")


def test_a_frame_by_itself_is_measured_like_its_pictures_alone(shown):
    other = [dataclasses.replace(p, frame=1, rendered={k: v * 0.5 for k, v in p.rendered.items()}) for p in shown]
    both = errors([*shown, *other])
    assert both.measures("layered", 0) == errors(shown).measures("layered")
    assert both.measures("layered", 1) == errors(other).measures("layered")
    assert both.measures("layered", 0)["mse"] < both.measures("layered")["mse"] < both.measures("layered", 1)["mse"]


def test_what_lies_outside_the_foreground_does_not_count(shown):
    def spoilt(picture, value):
        outside = ~picture.mask[..., None]
        return dataclasses.replace(
            picture, rendered={name: np.where(outside, value, image) for name, image in picture.rendered.items()}
        )

    assert errors([spoilt(p, 1.0) for p in shown]).measures("layered") == errors(shown).measures("layered")


def test_a_perfect_picture_has_no_error(shown):
    perfect = [dataclasses.replace(p, rendered={"layered": p.captured}) for p in shown]
    found = errors(perfect).measures("layered")
    assert found["mse"] == found["band_mse"] == 0 and found["ssim"] == pytest.approx(1) and found["psnr"] is None


def test_without_a_garment_there_is_no_band(shown):
    found = errors(shown, garments=()).measures("layered")
    assert found["band_mse"] is None and found["garment_mse"] is None
    assert found["body_mse"] == pytest.approx(found["mse"], rel=0.2)
    json.dumps(found, allow_nan=False)


def test_empty_foreground_is_null_in_json(shown):
    empty = [dataclasses.replace(p, mask=np.zeros_like(p.mask)) for p in shown]
    found = errors(empty).measures("layered")
    assert all(found[name] is None for name in MEASURES - set(COUNTED.values())) and found["pixels"] == 0
    assert json.loads(json.dumps(found, allow_nan=False))["mse"] is None


def test_colours_beyond_the_sensor_are_clipped(shown):
    bright = [
        dataclasses.replace(p, captured=np.ones_like(p.captured), rendered={"layered": np.full_like(p.captured, 9.0)})
        for p in shown
    ]
    assert errors(bright).measures("layered")["mse"] == 0


def test_a_picture_that_is_not_finite_is_refused(shown):
    image = shown[0].captured.copy()
    image[0, 0, 0] = np.nan
    with pytest.raises(UserError, match="frame 0, camera cam00.*not finite"):
        errors([dataclasses.replace(shown[0], rendered={"layered": image})])


def test_the_mean_of_measures_leaves_out_what_is_missing():
    values = [{"a": 1.0, "b": {"c": None}}, {"a": 3.0, "b": {"c": 2.0}}, None]
    assert mean_measures(values) == {"a": 2.0, "b": {"c": 2.0}}
    assert mean_measures([None, None]) is None and mean_measures([]) is None
