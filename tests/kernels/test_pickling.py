"""Results, solvers and meshes pickle and copy: what comes back gives the same bits."""

import copy
import pickle

import numpy as np
import pytest

from tests.support.kernel_calls import CALLS, SOLVERS, ball, bits, mrf, raster
from toile import kernels
from toile.io.body import load_body_model
from toile.scene import Mesh

RESULTS = [call for call in SOLVERS if call.__name__ not in ("closest", "biharmonic")] + [mrf, raster]
WAYS = [lambda value: pickle.loads(pickle.dumps(value)), copy.deepcopy, copy.copy]


@pytest.mark.parametrize("call", RESULTS, ids=lambda call: call.__name__)
def test_a_result_comes_back_with_the_same_bits(call):
    result = call(CALLS[call]())
    for way in WAYS:
        back = way(result)
        assert type(back) is type(result) and bits(back) == bits(result)


@pytest.mark.parametrize("call", SOLVERS, ids=lambda call: call.__name__)
def test_a_solver_comes_back_and_solves_to_the_same_bits(call):
    solver = SOLVERS[call]()
    once = bits(call(solver))
    for way in WAYS[:2]:
        assert bits(call(way(solver))) == once


def test_a_solver_is_pickled_as_it_was_made_not_as_the_callers_arrays_are_now():
    V, F = ball()
    solver = kernels.NricpSolver(V, F, "draft")
    before = bits(solver.solve(*ball()))
    V *= 2
    F[:] = F[::-1]
    assert bits(pickle.loads(pickle.dumps(solver)).solve(*ball())) == before


def test_a_factor_says_what_to_do_instead():
    with pytest.raises(TypeError, match="CholeskyFactor does not pickle: send the matrix"):
        pickle.dumps(kernels.CholeskyFactor())


def test_a_mesh_and_a_body_model_leave_what_is_made_from_them():
    mesh, body = Mesh(*ball()), load_body_model()
    size = len(pickle.dumps(mesh)), len(pickle.dumps(body))
    assert mesh.index and mesh.normals is not None and body.core and body.skin_faces is not None
    assert (len(pickle.dumps(mesh)), len(pickle.dumps(body))) == size
    for way in WAYS:
        back = way(mesh)
        assert np.array_equal(back.vertices, mesh.vertices) and np.array_equal(back.faces, mesh.faces)
        assert "index" not in vars(back) and np.array_equal(back.normals, mesh.normals)
        assert way(body).joint_names == body.joint_names and "core" not in vars(way(body))
