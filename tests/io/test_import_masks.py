"""Masks beside a calibration, in every way in which programs save them."""

import numpy as np
import pytest
from PIL import Image

from tests.support.imported import imported, rig, save
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.image import read_image


def in_palette(mask):
    image = Image.fromarray((mask > 0).astype(np.uint8)).convert("P")
    image.putpalette([20, 0, 0, 200, 255, 0])
    return image


SAVED = {  # ways in which a mask of 0 and 255 is saved
    "in colour": lambda mask: Image.fromarray(np.dstack([0 * mask, mask, mask])),
    "in colour and opaque": lambda mask: Image.fromarray(np.dstack([mask, mask, mask, 0 * mask + 255])),
    "in a palette": in_palette,
    "as a picture's alpha": lambda mask: Image.fromarray(np.dstack([255 - mask // 2, mask, 0 * mask + 90, mask])),
    "as alpha of grey": lambda mask: Image.fromarray(np.dstack([0 * mask + 255, mask])),
}


@pytest.mark.parametrize("way", SAVED)
def test_a_mask_is_the_same_in_whatever_way_it_was_saved(tmp_path, way):
    for v in rig(tmp_path / "their", numbers=(0,)):
        mask = np.zeros((v.height, v.width), np.uint8)
        mask[10:40, 20:50] = 255
        path = tmp_path / "their" / "masks" / v.name / "0.png"
        path.parent.mkdir(parents=True)
        SAVED[way](mask).save(path)
    imported(tmp_path / "their", tmp_path / "ours")
    for mask in open_capture(tmp_path / "ours").frame(0).masks.values():
        assert mask[10:40, 20:50].all() and mask.sum() == 900


@pytest.mark.parametrize("mode", ["L", "RGB", "P"])
def test_png_masks_of_0_and_1_show_what_those_of_0_and_255_do(tmp_path, mode):
    for v in rig(tmp_path / "their", numbers=(0,)):
        mask = np.zeros((v.height, v.width), np.uint8)
        mask[10:40, 20:50] = 1
        path = tmp_path / "their" / "masks" / v.name / "0.png"
        path.parent.mkdir(parents=True)
        Image.fromarray(mask).convert(mode).save(path)
    imported(tmp_path / "their", tmp_path / "ours")
    for mask in open_capture(tmp_path / "ours").frame(0).masks.values():
        assert mask[10:40, 20:50].all() and mask.sum() == 900


def test_faint_values_of_a_mask_that_is_no_png_of_0_and_1_show_nobody(tmp_path):
    for suffix, brightest in (("jpg", 1), ("png", 2)):
        Image.new("L", (16, 16), brightest).save(tmp_path / f"mask.{suffix}")
        assert read_image(tmp_path / f"mask.{suffix}", (16, 16), "L").max() <= 2


def test_masks_in_jpeg_arrive_and_labels_in_jpeg_are_refused_by_name(tmp_path):
    for v in rig(tmp_path / "their", numbers=(0,)):
        mask = np.zeros((v.height, v.width), np.uint8)
        mask[16:48, 24:56] = 255
        for kind in ("masks", "labels"):
            path = tmp_path / "their" / kind / v.name / "0.jpg"
            path.parent.mkdir(parents=True)
            Image.fromarray(mask).save(path, quality=60)
    with pytest.raises(
        UserError, match=r"labels/cam 3/0\.jpg: a JPEG, which changes label ids at their borders: expected a PNG"
    ):
        imported(tmp_path / "their", tmp_path / "ours")
    (tmp_path / "their" / "labels").rename(tmp_path / "their" / "videos")
    imported(tmp_path / "their", tmp_path / "ours")
    for mask in open_capture(tmp_path / "ours").frame(0).masks.values():
        assert mask[16:48, 24:56].all() and mask.sum() == 32 * 32


@pytest.mark.parametrize("mode", ["RGB", "LA"])
def test_label_images_of_several_channels_are_refused_when_imported(tmp_path, mode):
    for v in rig(tmp_path / "their", numbers=(0,)):
        path = tmp_path / "their" / "labels" / v.name / "0.png"
        path.parent.mkdir(parents=True)
        Image.new(mode, (v.width, v.height)).save(path)
    with pytest.raises(UserError, match=rf"labels/cam 3/0\.png: mode {mode}, expected one channel of 8 bits"):
        imported(tmp_path / "their", tmp_path / "ours")


def test_a_mask_of_another_size_than_its_pictures_is_refused_by_both(tmp_path):
    for v in rig(tmp_path / "their", numbers=(0,)):
        save(tmp_path / "their" / "masks" / v.name / "0.png", (v.width // 2, v.height // 2), 200, mode="L")
    with pytest.raises(
        UserError, match=r"masks/cam 3/0\.png: \d+ x \d+ pixels, expected \d+ x \d+, as camera 'cam 3' has$"
    ):
        imported(tmp_path / "their", tmp_path / "ours")
