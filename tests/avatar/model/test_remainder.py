"""What a code leaves of an encoded shape: harmonics, and what they change."""

import numpy as np
import pytest
import torch

from tests.support.small_avatar import BODY, SHIRT, SURFACE, avatar, awake, batch, settings
from toile import kernels
from toile.avatar.model.remainder import manifold_harmonics


def displaced(model, b, moves):
    """The batch with a shirt whose unposed vertices lie `moves` (B,n,3) beside what its code decodes."""
    shirt = model.model("shirt")
    transforms = model.skeleton(b["rotations"], b["translation"])
    at = shirt.rest + moves
    return b | {"vertices.shirt": shirt.skin.pose(at, *transforms)}


def test_harmonics_are_orthonormal_by_mass_and_begin_with_a_constant():
    H, mass = manifold_harmonics(SHIRT.rest, SHIRT.faces, 12)
    assert H.shape == (len(SHIRT.rest), 12)
    assert np.allclose(H.T @ (mass[:, None] * H), np.eye(12), atol=1e-8)
    assert np.ptp(H[:, -1]) < 1e-8 or np.ptp(H[:, 0]) < 1e-8


def test_no_functions_of_as_many_numbers_are_smoother():
    """Against a dense solver: the span of the least eigenvalues."""
    from scipy.linalg import eigh

    H, mass = manifold_harmonics(SHIRT.rest, SHIRT.faces, 9)
    L = -kernels.cotangent_laplacian(SHIRT.rest, SHIRT.faces).toarray()
    exact = eigh(L, np.diag(mass))[1][:, :9]
    assert np.allclose(H @ (H.T @ (mass[:, None] * exact)), exact, atol=1e-6)


def test_vertices_without_a_face_stay():
    V = np.concatenate([np.full((3, 3), 9.0), SHIRT.rest])
    H, mass = manifold_harmonics(V, SHIRT.faces + 3, 5)
    assert not H[:3].any() and not mass[:3].any() and mass[3:].all()


@pytest.mark.parametrize("count", [0, 1, 2, 50])
def test_a_mesh_of_few_vertices_gives_as_many_as_it_has(count):
    V = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    H, _ = manifold_harmonics(V, np.array([[0, 1, 2], [0, 2, 3]], np.int32), count)
    assert H.shape == (4, min(count, 2))


def test_a_face_of_no_area_does_no_harm():
    V = np.concatenate([SHIRT.rest, SHIRT.rest[:1]])
    F = np.concatenate([SHIRT.faces, [[0, 1, len(V) - 1]]]).astype(np.int32)
    assert np.isfinite(manifold_harmonics(V, F, 5)[0]).all()


def test_a_shape_that_no_code_knows_is_encoded_where_it_is_smooth():
    model = awake(avatar())
    b = batch(model)
    H, _ = model.model("shirt").harmonics
    smooth = torch.einsum("nr,brx->bnx", H, 0.004 * torch.randn(len(b["rotations"]), H.shape[1], 3))
    b = displaced(model, b, smooth)
    coarse = model.decode(b, model.means(model.encode(b)))["shirt"].unposed
    fine = model.decode(b, model.encoded(b))["shirt"].unposed
    target, mass = model.unposed(b, "shirt"), model.model("shirt").harmonics[1]
    before, after = ((mass * (x - target) ** 2).sum() for x in (coarse, fine))
    assert after < 0.02 * before
    rough = displaced(model, b, 0.01 * torch.randn_like(smooth))
    codes = model.means(model.encode(rough)), model.encoded(rough)
    coarse, fine = (model.decode(rough, z)["shirt"].unposed for z in codes)
    target = model.unposed(rough, "shirt")
    assert (mass * (fine - target) ** 2).sum() < (mass * (coarse - target) ** 2).sum()


def test_no_network_sees_it():
    model = awake(avatar())
    b = batch(model)
    z, whole = model.means(model.encode(b)), model.encoded(b)
    assert torch.equal(whole["shirt"][:, : model.model("shirt").code_size], z["shirt"])
    before, after = model.decode(b, z)["shirt"], model.decode(b, whole)["shirt"]
    assert torch.equal(before.mean_texture, after.mean_texture) and not torch.equal(before.unposed, after.unposed)


def test_bodies_and_single_layers_have_none_nor_has_who_asks_for_none():
    single = awake(avatar((SURFACE,)))
    b = batch(single)
    assert torch.equal(single.encoded(b)["surface"], single.means(single.encode(b))["surface"])
    bare = avatar((BODY,))
    assert bare.encoded(batch(bare)) == {}
    without = awake(avatar(options=settings(remainder=0)))
    b = batch(without)
    assert torch.equal(without.encoded(b)["shirt"], without.means(without.encode(b))["shirt"])
