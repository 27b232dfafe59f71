"""Ambient occlusion against closed forms and brute force."""

import numpy as np
import pytest
import trimesh

from toile import kernels
from toile.kernels import ambient_occlusion


def sheet(n=21, side=4.0):
    """A square in z = 0 that faces up; its middle vertex is n * n // 2."""
    x = np.linspace(-side / 2, side / 2, n)
    V = np.stack([*np.meshgrid(x, x, indexing="xy"), np.zeros((n, n))], -1).reshape(-1, 3)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return V, np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])


def ball(radius, centre, fine=4):
    mesh = trimesh.creation.icosphere(fine, radius)
    return mesh.vertices + centre, mesh.faces


def together(*meshes):
    starts = np.cumsum([0, *(len(V) for V, _ in meshes)])
    return np.concatenate([V for V, _ in meshes]), np.concatenate([F + s for (_, F), s in zip(meshes, starts)])


def test_an_open_sheet_sees_the_whole_sky():
    assert np.array_equal(ambient_occlusion(*sheet()), np.ones(441))


def test_a_convex_body_is_open_outside_and_shut_inside():
    V, F = ball(1.0, np.zeros(3))
    assert ambient_occlusion(V, F).min() == 1
    assert ambient_occlusion(V, F[:, ::-1]).max() == 0


@pytest.mark.parametrize("height, radius", [(1.0, 0.5), (0.5, 0.4), (2.0, 0.3)])
def test_under_a_sphere_the_sky_lost_is_the_squared_sine_of_its_half_angle(height, radius):
    V, F = together(sheet(), ball(radius, [0, 0, height]))
    found = ambient_occlusion(V, F, rays=4096)[220]
    assert found == pytest.approx(1 - (radius / height) ** 2, abs=4e-3)


def test_beside_a_long_wall_half_of_the_sky_is_lost():
    """The form factor of an endless half plane at right angles is a half."""
    V, F = sheet(41, 8.0)
    wall_V, wall_F = sheet(3, 200.0)
    wall_V = np.stack([np.full(len(wall_V), -1e-3), wall_V[:, 1], wall_V[:, 0] + 100 - 1e-3], 1)
    found = ambient_occlusion(*together((V, F), (wall_V, wall_F)), rays=4096, relative_offset=1e-7)[840]
    assert found == pytest.approx(0.5, abs=0.01)


def test_the_mean_over_seeds_is_that_of_brute_force_rays():
    rng = np.random.default_rng(0)
    V, F = together(sheet(9, 2.0), ball(0.3, [0.2, 0.1, 0.6], 2), ball(0.2, [-0.4, 0.3, 0.3], 2))
    mean = np.mean([ambient_occlusion(V, F, rays=256, seed=s)[:81] for s in range(8)], axis=0)
    uv = rng.random((20_000, 2))
    r, a = np.sqrt(uv[:, 0]), 2 * np.pi * uv[:, 1]
    rays = np.stack([r * np.cos(a), r * np.sin(a), np.sqrt(1 - uv[:, 0])], 1)
    mesh = trimesh.Trimesh(V, F, process=False)
    for v in (40, 20, 60):
        hit = mesh.ray.intersects_any(np.repeat(V[None, v] + [0, 0, 1e-4], len(rays), 0), rays)
        assert mean[v] == pytest.approx(1 - hit.mean(), abs=0.012)


def test_reach_bounds_what_casts_shade():
    V, F = together(sheet(), ball(0.5, [0, 0, 1.0]))
    assert ambient_occlusion(V, F, reach=0.4)[:441].min() == 1
    assert ambient_occlusion(V, F, reach=0.6)[220] < 1


def test_it_is_the_same_for_any_threads_and_turns_with_the_seed(threads):
    V, F = together(sheet(), ball(0.5, [0, 0, 1.0]))
    answers = []
    for n in (1, 2, 3, 8):
        threads(n)
        answers.append(ambient_occlusion(V, F, rays=33))
    assert all(np.array_equal(answers[0], a) for a in answers)
    assert not np.array_equal(answers[0], ambient_occlusion(V, F, rays=33, seed=1))


def test_of_some_vertices_it_is_what_it_is_of_all():
    V, F = together(sheet(), ball(0.5, [0, 0, 1.0]))
    of = np.array([440, 3, 220, 3])
    assert np.array_equal(ambient_occlusion(V, F, rays=33, of=of), ambient_occlusion(V, F, rays=33)[of])


def test_it_does_not_change_under_scale_and_rigid_motion_beyond_its_noise():
    V, F = together(sheet(), ball(0.5, [0, 0, 1.0]))
    R = trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.6, 0.3]))[:3, :3]
    a, b = ambient_occlusion(V, F, rays=1024), ambient_occlusion(1e3 * V @ R.T + [1e4, 0, 0], F, rays=1024)
    assert np.abs(a - b).max() < 0.03


def test_vertices_without_a_normal_are_open():
    V, F = sheet()
    V = np.concatenate([V, [[0, 0, -1], [0, 0, 5]]])
    F = np.concatenate([F, [[441, 441, 441]]])
    assert ambient_occlusion(V, F)[441:].tolist() == [1, 1]


@pytest.mark.parametrize(
    "change, said",
    [
        ({"rays": 0}, "rays"), ({"rays": 100_000}, "rays"), ({"relative_offset": 0.0}, "relative_offset"), ({"relative_offset": np.nan}, "relative_offset"),
        ({"reach": -1.0}, "reach"), ({"reach": np.inf}, "reach"), ({"V": np.full((441, 3), np.nan)}, r"V\[0\]"),
        ({"F": np.array([[0, 1, 441]])}, "F"), ({"of": [441]}, "of"), ({"of": [-1]}, "of"), ({"of": []}, "of"), ({"V": np.zeros((0, 3))}, "V"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_by_name(change, said):
    V, F = sheet()
    with pytest.raises(kernels.InputError, match=f"occlusion: {said}"):
        ambient_occlusion(**({"V": V, "F": F} | change))
