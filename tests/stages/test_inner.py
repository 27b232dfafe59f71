"""The fused body says where a stray label drew it out of its surface."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from toile.config import Config
from toile.io.body import load_body_model
from toile.kernels import vertex_normals
from toile.scene import Mesh
from toile.stages.inner import Fusion, steepest_edge

SHIRT = 3


@pytest.mark.parametrize(("pull", "least", "steepest"), [(0.02, 0.001, 2.0), (0.02, 0.04, 0.5), (0.0, 0.001, 0.0)])
def test_the_steepest_edge_is_where_one_vertex_was_pulled_out(pull, least, steepest):
    """Edges of a plane are 10 mm long, diagonals longer."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(5), np.arange(5)))
    corner = (x + 5 * y)[(x < 4) & (y < 4)]
    faces = np.concatenate([np.c_[corner, corner + 1, corner + 6], np.c_[corner, corner + 6, corner + 5]])
    plane = Mesh(0.01 * np.c_[x, y, 0 * x].astype(float), faces.astype(np.int32))
    moved = plane.vertices + [0.3, 0, 0]
    moved[12, 2] += pull
    steepness, vertex = steepest_edge(plane, moved, least)
    assert abs(steepness - steepest) < 1e-12
    assert pull == 0 or 12 in plane.edges[(plane.edges == vertex).any(1)]


def test_cloth_taken_for_skin_in_one_frame_of_two_is_said():
    """A shirt 4 mm off the body, then 50 mm, where a patch of the chest has the label of skin."""
    model = load_body_model()
    rest, J = model.rest(np.zeros(16))
    N = vertex_normals(rest, model.f)
    covered = np.isin(np.arange(len(rest)), model.segments["torso"])
    template = SimpleNamespace(name="shirt", label=SHIRT, faces=model.f[covered[model.f].all(1)], rest=rest)
    right = np.where(covered, SHIRT, 0)
    chest = np.argsort(np.linalg.norm(rest - J[model.joint_names.index("spine02")] - [0, -0.3, 0], axis=1))
    wrong = right.copy()
    wrong[chest[covered[chest]][:60]] = 0

    def frame(off, labels):
        shirt = rest + off * N
        pose = {"rotations": np.zeros((len(J), 3)), "translation": np.zeros(3)}
        tracked = SimpleNamespace(**pose, vertices=np.where(covered[:, None], shirt, rest))
        return tracked, SimpleNamespace(vertices=labels), {"shirt": SimpleNamespace(vertices=shirt)}

    def fused(*frames):
        fusion = Fusion(model, SimpleNamespace(shape=np.zeros(16), J=J), [template], Config().inner)
        while not fusion.done:
            fusion.step([fusion.gather(fusion.guess, frames)])
        return fusion.shape()

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert fused(frame(0.004, right), frame(0.05, right)).diagnostics["steepest_edge"] < 0.5
    with pytest.warns(UserWarning, match="fused under the garments has a spike near spine0"):
        assert fused(frame(0.004, right), frame(0.05, wrong)).diagnostics["steepest_edge"] > 1
