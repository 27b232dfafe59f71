"""HeldOutPicture sheets: their rows, their boxes, their files."""

import dataclasses

import numpy as np
import pytest
from PIL import Image

from tests.support.pictures import SHIRT, pictures
from toile.avatar.measure.sheet import GAP, LINE, TILE, loop_box, sheet, write_sheets
from toile.measure.page import HEAT


@pytest.fixture(scope="module")
def shown():
    return list(pictures())


def test_a_sheet_has_five_columns_and_a_row_a_loop(shown):
    picture = shown[0]
    image = sheet(picture)
    assert image.shape == (LINE + TILE + GAP + LINE + TILE * 3 // 4 + GAP + LINE, 5 * (TILE + GAP), 3)
    assert sheet(dataclasses.replace(picture, loops={})).shape[0] == LINE + TILE + GAP + LINE
    alone = dataclasses.replace(picture, rendered={"layered": picture.captured})
    assert sheet(alone).shape[1] == 3 * (TILE + GAP)


def test_errors_are_blue_where_there_is_none_and_red_where_it_is_large(shown):
    picture = shown[0]
    half = picture.captured.copy()
    columns = np.arange(half.shape[1]) > half.shape[1] // 2
    half[:, columns] = 1 - half[:, columns]
    image = sheet(dataclasses.replace(picture, rendered={"layered": half}, loops={}))
    errors = image[LINE : LINE + TILE, 2 * (TILE + GAP) : 3 * (TILE + GAP) - GAP].reshape(-1, 3)
    left, right = np.split(errors.reshape(TILE, TILE, 3), 2, axis=1)
    near = lambda part, colour: int((np.abs(part.astype(int) - colour).max(-1) < 12).sum())
    assert near(left, HEAT[0]) > 500 and near(left, HEAT[-1]) < 20
    assert near(right, HEAT[-1]) > 500 and near(right, HEAT[0]) < 20


def test_a_box_lies_about_its_loop_and_inside_the_picture():
    points = np.array([[40.0, 50], [80, 50], [80, 60], [40, 60]])
    left, top, right, bottom = loop_box(points, (200, 200))
    assert 0 <= left < 40 and 80 < right <= 200 and top < 50 and bottom > 60
    assert (right - left) / (bottom - top) == pytest.approx(4 / 3, abs=0.05)
    left, top, right, bottom = loop_box(points - [40, 45], (200, 200))
    assert (left, top) == (0, 0) and right > 40 and bottom > 15


@pytest.mark.parametrize(
    "points",
    [
        np.full((6, 2), 50.0),
        np.array([[-90.0, 50], [-80, 50], [20, 60]]),
        np.full((6, 2), np.nan),
        np.zeros((0, 2)),
        np.array([[190.0, 190], [260, 190], [260, 240]]),
    ],
    ids=["a point", "mostly outside", "behind the camera", "none", "at a corner"],
)
def test_a_loop_that_the_picture_does_not_show_has_no_box(points):
    assert loop_box(points, (200, 200)) is None


def test_a_frames_sheet_is_of_the_camera_that_shows_most_of_the_border(shown, tmp_path):
    bare = dataclasses.replace(shown[0], labels=np.where(shown[0].labels > 0, SHIRT, 0))
    (path,) = write_sheets(tmp_path / "sheets", [[bare, shown[1]]], [SHIRT])
    assert path.name == "000000_cam03.png"
    assert (np.asarray(Image.open(path)) == sheet(shown[1])).all()


def test_unseen_views_have_a_strip_of_their_own(shown, tmp_path):
    views = [picture.captured for picture in shown]
    paths = write_sheets(tmp_path, [], [SHIRT], unseen=(3, views))
    assert [p.name for p in paths] == ["000003_unseen.png"]
    assert np.asarray(Image.open(paths[0])).shape == (LINE + TILE + GAP, 2 * (TILE + GAP), 3)


def test_sheets_of_an_earlier_evaluation_go(shown, tmp_path):
    write_sheets(tmp_path, [[shown[0]]], [SHIRT])
    write_sheets(tmp_path, [[dataclasses.replace(shown[0], frame=7)]], [SHIRT])
    assert [p.name for p in tmp_path.iterdir()] == ["000007_cam00.png"]


def test_empty_and_white_pictures_draw_a_sheet(shown):
    picture = dataclasses.replace(shown[0], mask=np.zeros_like(shown[0].mask))
    assert sheet(picture).dtype == np.uint8
    white = {"layered": np.full_like(picture.captured, 7.0), "baseline": np.full_like(picture.captured, -3.0)}
    assert sheet(dataclasses.replace(shown[0], rendered=white)).dtype == np.uint8
