"""A tube of two joints in a sleeve, bent and shaken over time."""

import numpy as np

from tests.support.shapes import tube
from toile.config.stages import MotionSettings
from toile.scene import OBSERVED, BodyModel, Dressed, GarmentTemplate, Person, Tracked
from toile.stages.motion import Smoother

VERTICES = 108


def smoother():
    """A Smoother of a tube of two joints in a sleeve."""
    V, F = tube(9, 12, 0.1, 1.0)
    upper = np.clip(3 * V[:, 2] - 1, 0, 1)
    weights, J = np.stack([1 - upper, upper], 1), np.array([[0, 0, 0.0], [0, 0, 0.5]])
    index = np.tile([0, 1], (len(V), 1))
    basis = np.zeros((len(V), 3, 0)), np.zeros((2, 3, 0))
    model = BodyModel(V, F, J, np.array([-1, 0]), index, weights, *basis, ("root", "head"))
    sleeve = GarmentTemplate("sleeve", 3, tube(9, 12, 0.12, 1.0)[0], F, np.zeros((0, 2)), F, weights, (), ())
    return Smoother(model, Person(np.zeros(0), V, J), (sleeve,), MotionSettings(), fps=30.0)


def posed(smoother, bends, body=0.0, sleeve=0.0, confidence=OBSERVED):
    """Frames at these angles of the bend; `body` and `sleeve` (T,n,3) are added to what the pose gives."""
    frames, model, rest = [], smoother.model, smoother.templates[0].rest
    n = len(rest)
    body, sleeve = (np.broadcast_to(x, (len(bends), n, 3)) for x in (body, sleeve))
    seen = np.broadcast_to(np.asarray(confidence, np.uint8), (len(bends), n))
    for t, bend in enumerate(bends):
        turns, move = np.array([[0, 0, 0.1 * bend], [bend, 0, 0]]), np.array([0.3 * bend, 0, 1])
        V, S = (model.skin(r, model.J, turns, move) for r in (model.v_template, rest))
        face = np.full((1, 3), 0.2)
        tracked = Tracked(V + body[t], turns, move, face, seen[t], {})
        frames.append((tracked, {"sleeve": Dressed(S + sleeve[t], seen[t], {})}))
    return frames
