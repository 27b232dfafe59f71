"""Cloth out of a body."""

import numpy as np
import pytest

from toile import kernels


def sphere(radius=1.0, subdivisions=3):
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32)


def tube(radius, height, around=96, along=40):
    """An open cylinder about z, outward faces."""
    angle, z = np.meshgrid(2 * np.pi * np.arange(around) / around, np.linspace(-height / 2, height / 2, along))
    V = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(along - 1))
    a, b = j * around + i, j * around + (i + 1) % around
    F = np.concatenate([np.stack([a, b, b + around], -1).reshape(-1, 3), np.stack([a, b + around, a + around], -1).reshape(-1, 3)])
    return V, F.astype(np.int32)


def limbs():
    """A trunk with an arm beside it, closed, 30 mm of room between them."""
    import trimesh

    trunk = trimesh.creation.capsule(height=0.5, radius=0.15, count=[48, 48])
    arm = trimesh.creation.capsule(height=0.4, radius=0.05, count=[32, 32])
    V = np.vstack([trunk.vertices - [0, 0, 0.25], arm.vertices + [0.23, 0, -0.2]])
    F = np.vstack([trunk.faces, arm.faces + len(trunk.vertices)])
    return V, F.astype(np.int32)


def assert_clear(result, cloth_F, body_V, body_F, clearance):
    assert result.stop == "clear" and result.reason == ""
    assert result.intersections_left == 0 and result.vertices_left == 0
    assert len(kernels.intersecting_pairs(result.V, cloth_F, body_V, body_F)) == 0
    assert kernels.signed_distance(result.V, body_V, body_F).min() >= clearance


def test_cloth_that_is_clear_is_returned_bit_for_bit():
    V, F = sphere()
    result = kernels.untangle(1.1 * V, F, V, F)
    assert np.array_equal(result.V, 1.1 * V) and result.iterations == 0 and result.stop == "clear"


def test_a_shell_shrunk_into_a_sphere_comes_out_to_the_margin():
    V, F = sphere(0.2)
    result = kernels.untangle(0.95 * V, F, V, F)
    assert_clear(result, F, V, F, 0.0018)
    assert np.allclose(result.depth_before, kernels.signed_distance(0.95 * V, V, F).clip(max=0) * -1)
    assert result.depth_after.max() == 0
    assert (np.linalg.norm(result.V, axis=1) < 0.2 + 0.006).all()  # no further than it must


@pytest.mark.parametrize("push", [0.01, 0.03])
def test_untangle_leaves_no_vertex_inside_a_trunk_beside_an_arm(push):
    body_V, body_F = limbs()
    V, F = tube(0.153 - push, 0.5)
    result = kernels.untangle(V, F, body_V, body_F)
    assert result.intersections_before > 0 or result.depth_before.max() > 0
    assert_clear(result, F, body_V, body_F, 0.0017)
