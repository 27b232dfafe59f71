"""What the network of labels is trained on: pictures of a ball in a larger half ball, whose classes are known."""

import numpy as np
import pytest
import trimesh

pytest.importorskip("torch")

from toile.studio.segmenter import CLASSES
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
def test_a_picture_keeps_the_view_s_classes_but_where_something_hides_them(views, size):
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


def test_a_person_is_told_from_what_is_behind(views):
    """On a plain background the mask is where the picture changes: colours and classes belong together."""
    looks = Looks(SIZE, np.random.default_rng(3))
    looks.behind = lambda: np.zeros((SIZE, SIZE, 3))
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
    network, picture = Clothes(), torch.randn(2, 3, 32, 32)
    classes = (picture[:, 0] > 0).long()
    optimizer, losses = torch.optim.Adam(network.parameters(), 5e-3), []
    for _ in range(8):
        logits = network(picture)
        losses.append(loss(logits, classes))
        optimizer.zero_grad()
        losses[-1].backward()
        optimizer.step()
    assert logits.shape == (2, len(CLASSES), 32, 32) and losses[-1] < 0.8 * losses[0]
    assert sum(p.numel() for p in network.parameters()) * 4 < 3e6  # bytes
