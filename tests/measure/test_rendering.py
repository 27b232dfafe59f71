"""Shaded pictures: what is shown where, whichever axis is up."""

import numpy as np
import pytest

from toile.io.body import load_body_model
from toile.measure.rendering import SIZE, facing, render

COLOURS = {"face": (255, 0, 0), "hand_left": (0, 255, 0), "hand_right": (0, 0, 255), "": (90, 90, 90)}


def shown(model, up, turn, angle):
    """Pixels (k,2), row and column, of the face, the left and the right hand of a body turned by a rotation vector (3,)."""
    rotations = np.zeros((len(model.parents), 3))
    rotations[0] = turn
    V, F = model.skin(model.v_template, model.J, rotations, np.zeros(3)), model.skin_faces
    of = {"face": model.face_vertices(0.02), **{name: model.segments[name] for name in ("hand_left", "hand_right")}}
    parts = {name: np.isin(F, vertices).all(1) for name, vertices in of.items()}
    parts[""] = ~np.any(list(parts.values()), axis=0)
    picture = render([(V, F[part], COLOURS[name]) for name, part in parts.items()], angle, up).astype(int)
    return [np.argwhere(picture[..., k] > 2 * np.delete(picture, k, 2).max(2) + 20) for k in range(3)]


@pytest.mark.parametrize("up", "xyz")
@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
def test_a_person_is_seen_from_the_front_upright_and_unmirrored(up, heading):
    model, middle = load_body_model("anny", up=up), SIZE[1] / 2
    turn = heading * np.eye(3)["xyz".index(up)]
    face, left, right = shown(model, up, turn, facing(turn, up))
    assert right[:, 1].max() < middle < left[:, 1].min() and face[:, 0].max() < min(left[:, 0].min(), right[:, 0].min())
    behind, left, right = shown(model, up, turn, facing(turn, up) + np.pi)
    assert len(behind) < 0.1 * len(face) and left[:, 1].max() < middle < right[:, 1].min()
