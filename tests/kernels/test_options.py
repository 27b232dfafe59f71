"""Laws of all options and results: unknown names are refused, every option is told in its face, one list of reasons to stop."""

import numpy as np
import pytest
import trimesh

from tests.support.textured_plane import cameras
from toile import _core, kernels
from toile.io.body import load_body_model

BALL = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
V, F = np.array(BALL.vertices), np.array(BALL.faces)
BODY = load_body_model()
CALLS = {
    "Nricp": (kernels.NricpSolver, (V, F)),
    "Biharmonic": (kernels.BiharmonicSolver, (V, F, [0])),
    "Mrf": (kernels.mrf, (np.zeros((2, 2)), [[0, 1]], [1.0])),
    "Untangle": (kernels.UntangleSolver, (F, len(V), F, len(V))),
    "Drape": (kernels.DrapeSolver, (F, len(V), np.ones(len(kernels.unique_edges(F))), F, len(V))),
    "Skeleton": (kernels.SkeletonSolver, (BODY,)),
    "Inner": (kernels.InnerSolver, (BODY,)),
    "Raster": (kernels.raster, (V + [0, 0, 2], F, np.diag([9.0, 9, 1]), (4, 4))),
    "Occlusion": (kernels.ambient_occlusion, (V, F)),
    "Remesh": (kernels.remesh, (V, F, 0.1)),
    "Odds": (kernels.view_odds, ([], V, V, 1, 0, np.zeros(len(V), np.int32))),
    "Stereo": (kernels.StereoSolver, (cameras(2),)),
    "Fuse": (kernels.fuse_depths, (cameras(2), *(np.zeros((2, 4, 4, *n)) for n in ((), (3,), ())))),
    "Edge": (kernels.view_edges, ([], V[:3], V[:3], 1, [-0.01, 0, 0.01])),
}


def options_of(kernel):
    return [name for name in dir(getattr(_core, f"{kernel}Options")) if not name.startswith("_")]


def test_every_kernel_with_options_stands_in_this_table():
    assert {f"{name}Options" for name in CALLS} == {name for name in dir(_core) if name.endswith("Options")}


@pytest.mark.parametrize("kernel", CALLS)
def test_an_unknown_option_is_a_type_error_that_names_it(kernel):
    call, arguments = CALLS[kernel]
    for name in ("no_such_option", "__doc__", options_of(kernel)[0] + "s"):
        with pytest.raises(TypeError, match=name):
            call(*arguments, **{name: 1})


@pytest.mark.parametrize("kernel", CALLS)
def test_a_number_of_another_type_is_a_type_error_that_names_the_option_and_what_is_usual(kernel):
    call, arguments = CALLS[kernel]
    usual = {name: getattr(getattr(_core, f"{kernel}Options")(), name) for name in options_of(kernel)}
    for name, value in usual.items():
        if isinstance(value, int | float):
            with pytest.raises(TypeError, match=rf": {name} is '7', expected {type(value).__name__} like "):
                call(*arguments, **{name: "7"})


@pytest.mark.parametrize("kernel", CALLS)
def test_every_option_is_told_in_the_docstring_of_its_face(kernel):
    call, _ = CALLS[kernel]
    assert not [name for name in options_of(kernel) if name not in call.__doc__]


def test_the_reasons_to_stop_are_those_of_the_core():
    assert [stop.value for stop in kernels.Stop] == _core.stop_names
    result = kernels.mrf(np.zeros((2, 2)), [[0, 1]], [1.0])
    assert result.stop == "converged" and result.stop == kernels.Stop.converged


def test_a_tensor_that_numpy_cannot_read_is_refused_by_its_argument():
    import torch

    with pytest.raises(kernels.InputError, match="vertex_normals: V is not an array: .*requires grad"):
        kernels.vertex_normals(torch.tensor(V, requires_grad=True), F)
    plain = torch.tensor(V), torch.tensor(F)
    assert np.array_equal(kernels.vertex_normals(*plain), kernels.vertex_normals(V, F))
