"""What the network of labels is trained on: pictures of a ball in a larger half ball, whose classes are known."""

import cv2
import numpy as np
import pytest
import trimesh

pytest.importorskip("torch")

from tests.support.segmenters import by_colour
from toile.errors import UserError
from toile.studio.segmenter import CLASSES
from toile.studio.segmenter import looks as drawing
from toile.studio.segmenter.batches import read_photographs
from toile.studio.segmenter.looks import Looks
from toile.studio.segmenter.people import DressedPerson, painted
from toile.studio.segmenter.views import view

SIZE = 64
SKIN, TOP = CLASSES.index("skin"), CLASSES.index("top")


@pytest.fixture(scope="module")
def person():
    ball = trimesh.creation.icosphere(3, 0.5)
    V, F = np.array(ball.vertices), np.array(ball.faces)
    half = F[(V[F][:, :, 2] > 0).all(1)]
    bare = painted(np.random.default_rng(0), True, True) | {"shoe": -9.0, "hair": 9.0}
    return DressedPerson(
        np.concatenate([V, 1.05 * V]),
        np.concatenate([F, half + len(V)]).astype(np.int32),
        np.concatenate([np.zeros(len(F), int), np.ones(len(half), int)]),
        {1: TOP},
        np.concatenate([V, 1.05 * V]),
        np.column_stack([np.zeros((len(V), 2)), np.full(len(V), -1.0)]),
        bare,
    )


@pytest.fixture(scope="module")
def views(person):
    rng = np.random.default_rng(1)
    return [view(person, SIZE, rng) for _ in range(12)]


def test_a_view_shows_the_classes_where_they_are(views):
    for seen in views:
        on = seen.cover == 255
        height = seen.place[..., 2].astype(float)
        assert (seen.classes[on & (height > 0.2)] == TOP).all()
        assert (seen.classes[on & (height < -0.2)] == SKIN).all()
        assert (seen.classes[seen.cover == 0] == 0).all()
        assert (seen.normal[on][:, 2] <= 0).all()  # towards the camera
        assert np.abs(np.linalg.norm(seen.normal[on] / 127.0, axis=1) - 1).max() < 0.02
    assert {0, SKIN, TOP} <= {int(c) for seen in views for c in np.unique(seen.classes)}


@pytest.mark.parametrize("size", [SIZE, SIZE // 2])
def test_a_picture_keeps_the_view_s_classes_but_where_something_hides_them(views, size, monkeypatch):
    for name, value in {"BOXED": 0, "BLANKED": 0, "ZOOM": (1, 1), "TURN": 0, "SHIFT": 0, "STRETCH": 0}.items():
        monkeypatch.setattr(drawing, name, value)
    looks = Looks(SIZE, np.random.default_rng(2))
    looks.size = size
    kept = []
    for seen in views:
        picture, classes = looks.picture([getattr(seen, name) for name in seen.__dataclass_fields__])
        assert picture.shape == (size, size, 3) and picture.dtype == np.uint8 and classes.shape == (size, size)
        assert set(np.unique(classes)) <= set(np.unique(seen.classes)) | {0}
        if size == SIZE:
            same = [(classes == seen.classes[:, ::step]).mean() for step in (-1, 1)]
            kept.append(max(same))
    assert not kept or np.median(kept) == 1


def test_a_picture_shows_a_window_of_the_view(views, monkeypatch):
    """A turned and stretched window: each pixel's class is that of the view where the window says."""
    for name in ("BOXED", "BLANKED"):
        monkeypatch.setattr(drawing, name, 0)
    looks = Looks(SIZE, np.random.default_rng(5))
    looks.hide = lambda image, classes: None
    for seen in views[:6]:
        state = looks.rng.bit_generator.state
        inside, rows, columns = looks.window(seen.cover)
        looks.rng.bit_generator.state = state
        _, classes = looks.picture([getattr(seen, name) for name in seen.__dataclass_fields__])
        assert (classes[inside] == seen.classes[rows, columns][inside]).all() and not classes[~inside].any()
        steps = np.hypot(*(np.diff(v.astype(float), axis=1)[:, ::8].sum(1) for v in (rows, columns)))
        assert np.ptp(steps) <= 6  # the same everywhere but for rounding


def test_most_windows_hold_the_whole_person_as_large_as_networks_are_shown_it(views, monkeypatch):
    for name, value in {"BOXED": 1, "BLANKED": 0, "TURN": 0}.items():
        monkeypatch.setattr(drawing, name, value)
    looks, high = Looks(SIZE, np.random.default_rng(8)), []
    looks.hide = lambda image, classes: None
    for seen in views:
        _, classes = looks.picture([getattr(seen, name) for name in seen.__dataclass_fields__])
        high.append(max(np.ptp(at) + 1 for at in np.nonzero(classes)) / SIZE)
    assert abs(np.median(high) - 1 / drawing.PADDING) < 0.08


def test_a_mask_is_about_the_person_and_off_it_all_is_blank(views, monkeypatch):
    monkeypatch.setattr(drawing, "BLANKED", 1)
    looks, same = Looks(SIZE, np.random.default_rng(9)), []
    for seen in views:
        masks = []
        looks.mask = lambda on: masks.append((on, Looks.mask(looks, on))) or masks[-1][1]
        picture, classes = looks.picture([getattr(seen, name) for name in seen.__dataclass_fields__])
        ((on, mask),) = masks
        assert (picture[~mask] == drawing.BLANK).all() and not classes[~mask].any()
        assert (classes > 0)[mask].sum() == (on & mask).sum()
        same.append((on & mask).sum() / max((on | mask).sum(), 1))
    assert np.median(same) > 0.7 and np.mean(same) < 0.995  # as good as masks are, and not better


@pytest.mark.parametrize("photographs", [(), [np.random.default_rng(0).integers(0, 256, (60, 90, 3), np.uint8)] * 2])
def test_rooms_are_pictures(photographs):
    rng = np.random.default_rng(6)
    prints = np.stack([drawing.printed(rng, photographs) for _ in range(4)])
    rooms = [drawing.background(SIZE, rng, prints, photographs) for _ in range(40)]
    assert all(room.shape == (SIZE, SIZE, 3) and 0 <= room.min() and room.max() <= 1 for room in rooms)
    assert np.median([room.std() for room in rooms]) > 0.1


def test_photographs_are_read_from_a_folder_and_told_where_there_are_none(tmp_path):
    colour = np.zeros((40, 1600, 3), np.uint8)
    colour[..., 2] = 200  # red, in OpenCV's order
    cv2.imwrite(str(tmp_path / "a.png"), colour)
    (tmp_path / "b.txt").write_text("no picture")
    (photograph,) = read_photographs(tmp_path)
    assert photograph.shape == (20, 800, 3) and (photograph == [200, 0, 0]).all()
    (tmp_path / "a.png").unlink()
    with pytest.raises(UserError, match="--photographs: no pictures in"):
        read_photographs(tmp_path)


def test_a_person_is_told_from_what_is_behind(views, monkeypatch):
    """On a plain background the mask is where the picture changes: colours and classes belong together."""
    monkeypatch.setattr(drawing, "BLANKED", 0)
    looks = Looks(SIZE, np.random.default_rng(3))
    looks.behind = lambda: np.zeros((SIZE, SIZE, 3), np.float32)
    looks.hide = lambda image, classes: None
    looks.seen = lambda image: image
    for seen in views[:4]:
        image, classes = looks.picture([getattr(seen, name) for name in seen.__dataclass_fields__])
        assert (image[classes > 0].max(-1) > 0).mean() > 0.95 and (image.max(-1) > 0)[classes == 0].mean() < 0.2


def test_the_network_gives_a_number_a_class_and_pixel_and_learns():
    import torch

    from toile.studio.segmenter.network import Clothes
    from toile.studio.segmenter.train import loss

    torch.manual_seed(0)
    network, picture = Clothes(), torch.randn(2, 3, 64, 64)
    classes = (picture[:, 0] > 0).long()
    optimizer, losses = torch.optim.Adam(network.parameters(), 5e-3), []
    for _ in range(8):
        logits = network(picture)
        losses.append(loss(logits, classes))
        optimizer.zero_grad()
        losses[-1].backward()
        optimizer.step()
    assert logits.shape == (2, len(CLASSES), 64, 64) and losses[-1] < 0.8 * losses[0]
    assert sum(p.numel() for p in network.parameters()) * 2 < 3e6  # bytes as they are stored


def test_a_written_network_says_the_same_and_can_be_trained_on(tmp_path):
    import onnxruntime
    import torch

    from toile.studio.segmenter.export import COUNTED, export, read_network
    from toile.studio.segmenter.network import Clothes

    torch.manual_seed(1)
    network = Clothes()
    with torch.no_grad():
        for weights in network.parameters():
            weights += 0.05 * torch.randn_like(weights)
    for _ in range(20):
        network(torch.randn(8, 3, 64, 64))  # for the normalisations
    export(network, tmp_path / "a.onnx", 64)
    picture = torch.randn(1, 3, 64, 64)
    with torch.no_grad():
        meant = network.eval()(picture).numpy()
    said = onnxruntime.InferenceSession(tmp_path / "a.onnx").run(None, {"image": picture.numpy()})[0]
    assert np.abs(said - meant).max() < 0.01 * np.abs(meant).max()
    assert (tmp_path / "a.onnx").stat().st_size < 3e6
    again = read_network(tmp_path / "a.onnx").state_dict()
    for name, value in network.state_dict().items():
        assert name.endswith(COUNTED) or torch.allclose(again[name], value, rtol=1e-3, atol=1e-6)
    with pytest.raises(UserError, match="b.onnx: not the weights of this network"):
        read_network(by_colour(tmp_path / "b.onnx"))


def test_an_interrupted_training_goes_on_where_it_was(tmp_path):
    import torch

    from toile.studio.segmenter.train import Course

    torch.manual_seed(2)
    first = Course(tmp_path / "a.pt", 100.0)
    batch = torch.randn(4, 3, 64, 64), torch.randint(0, 7, (4, 64, 64))
    for _ in range(3):
        first.learn(*batch)
    first.spent = 40.0
    first.save()
    second = Course(tmp_path / "a.pt", 100.0)
    assert (second.step, second.spent) == (3, 40.0)
    assert first.learn(*batch) == second.learn(*batch)
    for a, b in zip(first.mean.parameters(), second.mean.parameters()):
        assert torch.equal(a, b)


def test_the_temperature_is_found_and_mends_the_certainty():
    import torch

    from toile.studio.segmenter.check import calibration_error, temperature

    torch.manual_seed(3)
    logits = 2 * torch.randn(4, len(CLASSES), 48, 48)
    drawn = torch.distributions.Categorical(logits=logits.permute(0, 2, 3, 1)).sample()
    heat = temperature(3 * logits, drawn)
    assert 2.7 < heat < 3.3
    assert calibration_error(3 * logits / heat, drawn) < 0.06 < 0.2 < calibration_error(3 * logits, drawn)


def test_overlaps_are_intersections_over_unions():
    import torch

    from toile.studio.segmenter.check import overlaps

    truth, found = torch.zeros(2, 10, 10, dtype=torch.long), torch.zeros(2, 10, 10, dtype=torch.long)
    truth[:, 2:6, 2:6], found[:, 2:6, 2:6] = TOP, SKIN  # another class, the same outline
    found[:, 2:6, 4:6] = TOP
    assert overlaps(found, truth)["top"] == 0.5 and overlaps(found, truth)["outline"] == 1
    found[:, 2:6, 6:10] = TOP
    assert overlaps(found, truth)["top"] == 0.25 and overlaps(found, truth)["outline"] == 0.5
