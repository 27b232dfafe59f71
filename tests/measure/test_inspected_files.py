"""Files of a capture that lack, are not read or show nothing, and what inspect says of each."""

import shutil

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageCms

from tests.support.inspected import PICTURED, texts
from tests.support.synthetic_run import SAMPLE
from toile.measure.inspection import inspect
from toile.measure.inspection.files import unpadded


def test_files_that_lack_or_are_not_read_are_named(capture):
    frames = capture / "frames"
    shutil.rmtree(frames / "000011")
    (frames / "31").mkdir()
    (frames / "000007" / "images" / "cam2.jpg").unlink()
    Image.new("RGB", (512, 512)).save(frames / "000014" / "images" / "cam1.jpg")
    Image.new("L", (512, 512)).save(frames / "000021" / "masks" / "cam4.png")
    for number in PICTURED:
        path = frames / f"{number:06d}" / "images" / "cam3.jpg"
        Image.fromarray((np.asarray(Image.open(path)) // 5).astype(np.uint8)).save(path)
    said = texts(capture, serious=False)
    for words in (
        "frames: 1 numbers are missing: 11", "frames/31 are not read; six digits: frames/000031",
        "cam2: no images in 1 frames: 7", "cam1: frame 14 is black", "cam4: frame 21 has an empty mask", "cam3: about",
    ):  # fmt: skip
        assert any(words in text for text in said), words
    assert not texts(capture, serious=True)


def test_frames_that_hold_nothing_are_named(walk):
    (walk / "frames" / "000030").mkdir()
    (walk / "frames" / "000031" / "images").mkdir(parents=True)
    assert texts(walk) == ["frames: 2 hold nothing that is read: 30-31"]


def test_pictured_frames_without_masks_or_scan_are_named_where_others_have_them(tmp_path):
    root = shutil.copytree(SAMPLE, tmp_path / "capture", ignore=shutil.ignore_patterns("truth", "labels", "00000[345]"))
    shutil.rmtree(root / "frames" / "000001" / "masks")
    (root / "frames" / "000002" / "scan.ply").unlink()
    assert [text for text in texts(root) if text.startswith("frames:")] == [
        "frames: 1 with pictures have no masks, as others have: 1",
        "frames: 1 with pictures have no scan, as others have: 2",
    ]
    shutil.rmtree(root / "frames" / "000002" / "images")
    shutil.rmtree(root / "frames" / "000001" / "images")
    assert not [text for text in texts(root) if text.startswith("frames:")]


def test_where_no_frame_can_be_read_nothing_is_said_of_labels(capture):
    for mask in capture.glob("frames/*/masks/cam0.png"):
        Image.open(mask).convert("RGB").save(mask)
    said = texts(capture, serious=True)
    assert len(said) == len(PICTURED) and all("masks/cam0.png: mode RGB" in text for text in said)


def test_a_capture_of_pictures_alone_is_said_to_lack_who_it_shows(capture):
    for path in (*capture.glob("frames/*/masks"), *capture.glob("frames/*/labels")):
        shutil.rmtree(path)
    for path in capture.glob("frames/*/keypoints.json"):
        path.unlink()
    assert any("no scans, keypoints or masks" in text and "toile detect" in text for text in texts(capture))


def test_a_camera_that_stood_still_is_named_with_its_first_frame(capture):
    before, after = (capture / "frames" / f"{number:06d}" / "images" / "cam2.jpg" for number in (7, 14))
    shutil.copy(before, after)
    assert texts(capture) == [
        "cam2: in 1 of 30 frames the same to the bit as in the frame before, first in 14: did it stand still?"
    ]


def test_pictures_that_cannot_be_read_are_findings_wherever_they_lie(capture):
    for number in (0, 7):
        path = capture / "frames" / f"{number:06d}" / "images" / "cam2.jpg"
        path.unlink()
        path.symlink_to(capture / "gone.jpg")
    assert any("000000/images/cam2.jpg" in text for text in texts(capture, serious=True))


def test_pictures_that_other_programs_turn_are_named(capture):
    assert not any("EXIF" in text for text in texts(capture, serious=False))
    for name, orientation in (("cam1", 6), ("cam2", 1), ("cam3", 3)):
        path, note = capture / "frames" / "000000" / "images" / f"{name}.jpg", Image.Exif()
        note[ExifTags.Base.Orientation] = orientation
        Image.open(path).save(path, exif=note)
    (told,) = [text for text in texts(capture, serious=False) if "EXIF" in text]
    assert told.startswith("cam1, cam3: their pictures ask to be turned (EXIF), and are read as they are stored")


def test_pictures_in_other_colours_than_srgb_are_named_by_their_space(capture):
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    at = srgb.index(b"s\0R\0G\0B")  # of the description, two bytes a letter
    for name, profile in (("cam1", srgb.replace(srgb[at : at + 7], b"W\0I\0D\0E")), ("cam2", srgb)):
        path = capture / "frames" / "000000" / "images" / f"{name}.jpg"
        Image.open(path).save(path, icc_profile=profile)
    (told,) = [text for text in texts(capture, serious=False) if "sRGB" in text]
    assert told.startswith("cam1: their pictures are in colours of 'WIDE")


def test_a_frame_of_seven_digits_is_offered_no_number_of_another(tmp_path):
    (tmp_path / "frames" / "1000009").mkdir(parents=True)
    (found,) = unpadded(tmp_path)
    assert "frames/1000009 are not read" in found.text and "000009;" not in found.text and found.serious


def test_a_folder_whose_number_another_has_in_six_digits_is_not_to_take_its_name_unasked(tmp_path):
    for name in ("12", "000012", "000013"):
        (tmp_path / "frames" / name).mkdir(parents=True)
    (found,) = unpadded(tmp_path)
    assert found.text.endswith("six digits: frames/000012, which is there too: which of them is frame 12?")


def test_files_of_a_frame_that_nothing_reads_are_named_with_what_is_expected(capture):
    for number in PICTURED:
        folder = capture / "frames" / f"{number:06d}"
        (folder / "masks").rename(folder / "mask")
        for path in sorted((folder / "images").iterdir()):
            Image.open(path).save(path.with_suffix(".bmp"))
            path.unlink()
        for name in ("scan.obj", f"pose_{number}.json", "Scan.PLY", "notes.txt", "labels/cam1.npy"):
            (folder / name).write_text("")
    (capture / "frames" / "000007" / "scan.ply").write_text("")
    all_of = "images, masks, labels, scan.ply, keypoints.json, keypoints3d.json"
    assert sorted(text for text in texts(capture, serious=False) if "not read" in text) == [
        "frames/000000/Scan.PLY and 4 more: not read, expected scan.ply",
        "frames/000000/images/cam0.bmp and 24 more: not read, expected CAM.png or CAM.jpg",
        "frames/000000/labels/cam1.npy and 4 more: not read, expected CAM.png or CAM.jpg",
        "frames/000000/mask and 4 more: not read, expected masks",
        f"frames/000000/notes.txt and 4 more: not read, expected {all_of}",
        "frames/000000/pose_0.json and 4 more: not read, expected keypoints.json, keypoints3d.json",
        "frames/000000/scan.obj and 4 more: not read, expected scan.ply",
    ]


def test_what_systems_leave_in_frames_is_passed_over(capture):
    for name in (".DS_Store", "Thumbs.db", "desktop.ini", ".keypoints.json.0123.part"):
        for folder in ("", "images", "masks"):
            (capture / "frames" / "000000" / folder / name).write_text("")
    (capture / "frames" / "000000" / "@eaDir").mkdir()
    assert not texts(capture)


def test_a_garment_whose_label_is_seen_nowhere_stops(capture):
    scene = capture / "scene.toml"
    scene.write_text(scene.read_text() + '[[garment]]\nname = "skirt"\nlabel = "skirt"\n')
    said = texts(capture, serious=True)
    assert len(said) == 1 and said[0].startswith("garment skirt: its label 'skirt' is seen nowhere")


def test_masks_that_are_all_empty_stop_in_one_line(capture):
    for path in capture.glob("frames/*/masks/*.png"):
        Image.fromarray(np.asarray(Image.open(path)) // 3).save(path)
    assert texts(capture, serious=True) == [
        "masks: all that were looked at are empty, or nearly: above 127 is the person"
    ]
    assert not any("empty mask" in text for text in texts(capture))


def test_masks_saved_as_booleans_are_masks(capture):
    for path in capture.glob("frames/*/masks/*.png"):
        Image.fromarray(np.asarray(Image.open(path)) // 255).save(path)
    assert texts(capture) == []


def test_a_mask_of_a_few_specks_is_all_but_empty_and_blames_no_calibration(capture):
    for name in ("cam1", "cam2"):
        path = capture / "frames" / "000000" / "masks" / f"{name}.png"
        mask = np.zeros_like(np.asarray(Image.open(path)))
        mask[5, 5:12] = 255
        Image.fromarray(mask).save(path)
    said = "cam1, cam2: frame 0 has a mask that is all but empty, of 7 pixels"
    blank = [text for text in texts(capture) if text != said]
    assert said in texts(capture) and texts(capture, serious=True) == [] and blank == []


@pytest.mark.parametrize("way", ("inverted", "full"))
def test_masks_that_show_the_corners_of_their_pictures_stop(capture, way):
    for path in capture.glob("frames/*/masks/*.png"):
        mask = 255 - np.asarray(Image.open(path))
        Image.fromarray(mask if way == "inverted" else np.full_like(mask, 255)).save(path)
    assert any("25 of 25 that were looked at show all corners" in text for text in texts(capture, serious=True))


def test_what_cannot_be_opened_or_read_is_a_finding(capture, tmp_path):
    assert inspect(tmp_path / "nothing").wasted
    (capture / "frames" / "000000" / "images" / "cam0.jpg").write_bytes(b"no picture")
    assert any("cam0.jpg: cannot be read" in text for text in texts(capture, serious=True))
