"""Laws of the inner kernel on the packaged body under a synthetic shirt: recovery, one-sidedness, invariance, bits."""

import pickle
from copy import deepcopy
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.memory import peak_mb
from toile.io.body import load_body_model
from toile.kernels import InnerSolver, InnerSums, InputError, self_intersections, vertex_normals

FRAMES = 4


@pytest.fixture(scope="module")
def scene():
    """Four frames of a body with smooth offsets up to 8 mm, poses known, under a shirt 3 to 25 mm off it, which swings the more
    the farther it hangs."""
    model = load_body_model()
    rng = np.random.default_rng(7)
    shape = rng.normal(0, 0.7, 16)
    rest, J = model.rest(shape)
    N = vertex_normals(rest, model.f)
    bumps = np.sin(rest @ rng.normal(0, 9, (3, 4)) + rng.uniform(0, 6, 4)).sum(1) / 4
    body = rest + 0.008 * bumps[:, None] * N
    covered = np.zeros(len(rest), bool)
    covered[model.segments["torso"]] = True
    faces = model.f[covered[model.f].all(1)]
    frames, hang = [], np.random.default_rng(8).normal(0, 6, 3)
    for i in range(FRAMES):
        rotations = np.zeros((104, 3))
        for k, name in enumerate(model.joint_names):
            if name.startswith(("spine", "upperarm01", "lowerarm01", "neck01")):
                rotations[k] = rng.uniform(-0.15, 0.15, 3)
        swing = 0.6 + 0.4 * np.sin(rest @ rng.normal(0, 6, 3) + i)
        slack = 0.003 + 0.022 * np.sin(rest @ hang) ** 2 * swing
        shirt = model.skin(body + slack[:, None] * N, J, rotations, np.zeros(3))
        tracked = model.skin(body, J, rotations, np.zeros(3))
        truth = tracked.copy()
        tracked[covered] = shirt[covered]
        frames.append((rotations, np.zeros(3), tracked, (~covered).astype(float), [(shirt, faces)], truth))
    return SimpleNamespace(model=model, shape=shape, J=J, body=body, covered=covered, frames=frames)


def arguments(scene):
    return [f[:5] for f in scene.frames]


def error(a, b, where):
    return np.linalg.norm(a - b, axis=1)[where].mean()


def test_body_under_cloth_is_found_to_millimetres_from_a_wrong_shape(scene):
    inflated = scene.shape + np.r_[0.8, -0.8, 0.5, np.zeros(13)]
    solver = InnerSolver(scene.model, inflated, scene.J)
    fused = solver.fuse(arguments(scene))
    model_alone = scene.model.rest(inflated)[0]
    assert error(fused.rest, scene.body, scene.covered) < 7e-3
    assert error(fused.rest, scene.body, scene.covered) < 0.5 * error(model_alone, scene.body, scene.covered)
    for f in scene.frames:
        result = solver.solve(fused.rest, *f[:5])
        assert error(result.V, f[5], scene.covered) < 7e-3 and error(result.V, f[5], ~scene.covered) < 1e-3
        assert result.depth_after < 2e-3
        assert np.array_equal(result.V[result.skin == 1], f[2][result.skin == 1])
        assert 1 <= result.factorisations <= result.iterations


def test_a_second_solve_keeps_the_analysis_and_its_bits(scene):
    solver, frame = InnerSolver(scene.model, scene.shape, scene.J), scene.frames[0][:5]
    fused, again = solver.fuse(arguments(scene)[:1]), solver.fuse(arguments(scene)[:1])
    first, second = (solver.solve(fused.rest, *frame) for _ in range(2))
    assert fused.analyses == 0 and first.analyses == second.analyses <= 1 <= second.factorisations  # of a part at most
    assert np.array_equal(fused.rest, again.rest) and np.array_equal(first.V, second.V)


def test_more_frames_bound_the_body_more_tightly(scene):
    solver = InnerSolver(scene.model, scene.shape, scene.J)
    one, all_frames = solver.fuse(arguments(scene)[:1]), solver.fuse(arguments(scene))
    assert error(all_frames.rest, scene.body, scene.covered) <= error(one.rest, scene.body, scene.covered) + 1e-4
    assert min(all_frames.bounded, one.bounded) > 500


def fused_of(solver, blocks):
    """The fused shape of blocks of frames, each gathered by itself and added in order; `blocks` gives them anew."""
    fusion = solver.fusion()
    while not fusion.done:
        total = solver.gather((), fusion.guess)
        for part in [solver.gather(block, fusion.guess) for block in blocks()]:
            total += part
        fusion.step(total)
    return fusion.fused


def test_blocks_of_frames_add_up_to_the_fused_shape_of_all(scene):
    solver, frames = InnerSolver(scene.model, scene.shape, scene.J), arguments(scene)
    together, apart = solver.fuse(frames), fused_of(solver, lambda: [frames[:1], iter(frames[1:])])
    assert np.abs(together.rest - apart.rest).max() < 1e-9 and np.allclose(together.shape, apart.shape, atol=1e-9)
    assert (apart.observed, apart.bounded) == (together.observed, together.bounded)
    twice = fused_of(solver, lambda: [frames, frames])  # a quantile of few values knows how many there are, a little
    assert np.abs(together.rest - twice.rest).mean() < 1e-5 and np.abs(together.rest - twice.rest).max() < 1e-3


def test_one_frame_of_ten_that_takes_cloth_for_skin_leaves_the_fused_body_as_it_is(scene):
    """A patch of the shirt's front, up to 20 mm off the body, called skin in one frame alone."""
    solver, frames = InnerSolver(scene.model, scene.shape, scene.J), [arguments(scene)[i % FRAMES] for i in range(10)]
    chest = scene.model.J[scene.model.joint("spine02")] + [0, -0.3, 0]
    on_shirt = np.flatnonzero(scene.covered)
    patch = on_shirt[np.argsort(np.linalg.norm(scene.body[on_shirt] - chest, axis=1))[:60]]
    rotations, translation, tracked, visible, garments = frames[3]
    strayed = visible.copy()
    strayed[patch] = 1
    stray = [*frames[:3], (rotations, translation, tracked, strayed, garments), *frames[4:]]
    moved = np.linalg.norm(solver.fuse(stray).rest - solver.fuse(frames).rest, axis=1)
    assert moved.max() < 1e-3


def test_sums_outlive_a_file_and_another_solver(scene):
    solver, other = (InnerSolver(scene.model, scene.shape, scene.J) for _ in range(2))
    guess = pickle.loads(pickle.dumps(solver.fusion().guess))
    sums = other.gather(arguments(scene)[:1], guess)
    copy = InnerSums(*(np.array(x) for x in (sums.position, sums.weight, sums.skin, sums.room)), sums.frames)
    copy += solver.gather(arguments(scene)[1:2], guess)
    both = solver.gather(arguments(scene)[:2], guess)
    assert copy.frames == both.frames == 2 and np.array_equal(copy.room, both.room)
    assert np.allclose(copy.position, both.position, atol=1e-12)


def test_the_bound_is_a_low_quantile_of_the_room_over_the_frames(scene):
    """Eleven shirts, 4 to 24 mm off the body: a tenth of them is closer than 6 mm, less the gap of 2 mm."""
    (rotations, translation, _, visible, ((_, faces),)) = arguments(scene)[0]
    truth, frames = scene.frames[0][5], []
    N = vertex_normals(truth, scene.model.f)
    for slack in np.linspace(0.004, 0.024, 11):
        shirt = truth + slack * N
        tracked = np.where(visible[:, None] > 0, truth, shirt)
        frames.append((rotations, translation, tracked, visible, [(shirt, faces)]))
    fused = InnerSolver(scene.model, scene.shape, scene.J).fuse(frames)
    inner = np.isfinite(fused.bound) & scene.covered
    off = ((scene.body - fused.rest) * vertex_normals(scene.body, scene.model.f)).sum(1)
    assert abs(np.median((fused.bound - off)[inner]) - 0.004) < 5e-4


@pytest.mark.slow
def test_fusing_ten_times_the_frames_takes_no_more_memory(scene):
    """Frames of their own arrays, of 1.3 MB each."""
    solver = InnerSolver(scene.model, scene.shape, scene.J)
    frames = lambda count: (deepcopy(arguments(scene)[i % FRAMES]) for i in range(count))
    fused_of(solver, lambda: [frames(2)])
    few, many = (peak_mb(lambda: fused_of(solver, lambda: [frames(count)])) for count in (20, 200))
    assert many - few < 20, f"{few:.0f} and {many:.0f} MB"
    held = peak_mb(lambda: fused_of(solver, lambda: [list(frames(200))]))
    assert held > many + 100, "the measure sees frames that are held"


def test_loose_cloth_says_nothing_and_cloth_inside_pushes_the_body_in(scene):
    model, (rotations, translation, _, visible, ((_, faces),), truth) = scene.model, scene.frames[0]
    solver = InnerSolver(model, scene.shape, scene.J)
    N = vertex_normals(truth, model.f)
    without = solver.solve(scene.body, rotations, translation, truth, visible, [])
    loose = solver.solve(scene.body, rotations, translation, truth, visible, [(truth + 0.04 * N, faces)])
    moved = np.linalg.norm(loose.V - without.V, axis=1)  # folds of the body come near the cloth of their neighbours
    assert moved.max() < 1e-3 and moved.mean() < 1e-5
    tight = solver.solve(scene.body, rotations, translation, truth, visible, [(truth - 0.005 * N, faces)])
    assert tight.outside_before > 500 and tight.depth_before > 0.004
    assert (
        tight.outside_after < tight.outside_before / 10 and tight.depth_after < 0.003
    )  # skin at the hem holds its place
    assert ((tight.V - truth) * N).sum(1)[scene.covered].mean() < -0.003


def test_cloth_beyond_the_middle_of_an_arm_does_not_fold_the_arm_through_itself(scene):
    """A sleeve a tenth as thick as the upper arm, in every frame: its nearer side asks for more than half of the arm."""
    rest, J = scene.model.rest(np.zeros(16))
    start, end = (J[scene.model.joint(name)] for name in ("upperarm01.R", "lowerarm01.R"))
    axis = (end - start) / np.linalg.norm(end - start)
    inside = start + ((rest - start) @ axis)[:, None] * axis
    strongest = scene.model.weights_idx[np.arange(len(rest)), scene.model.weights_val.argmax(1)]
    arm = strongest == scene.model.joint("upperarm02.R")
    sleeve, faces = inside + 0.1 * (rest - inside), scene.model.f[arm[scene.model.f].all(1)]
    tracked = np.where(arm[:, None], sleeve, rest)
    frames = [(np.zeros((104, 3)), np.zeros(3), tracked, (~arm).astype(float), [(sleeve, faces)])] * FRAMES
    folds = lambda **options: len(
        self_intersections(InnerSolver(scene.model, np.zeros(16), J, **options).fuse(frames).rest, faces)
    )
    assert folds(inward=1) > 10 and folds() == 0


def test_a_turn_of_the_world_turns_the_frame_and_leaves_the_fused_shape(scene):
    R, t = Rotation.from_rotvec([0.3, -1.0, 2.0]), np.array([3.0, -2.0, 1.0])
    solver = InnerSolver(scene.model, scene.shape, scene.J)

    def turned(rotations, translation, tracked, visible, garments):
        rotations = rotations.copy()
        rotations[0] = (R * Rotation.from_rotvec(rotations[0])).as_rotvec()
        root = scene.J[0]
        return (
            rotations,
            R.apply(root + translation) + t - root,
            R.apply(tracked) + t,
            visible,
            [(R.apply(V) + t, F) for V, F in garments],
        )

    plain = solver.fuse(arguments(scene)[:2])
    moved = solver.fuse([turned(*f) for f in arguments(scene)[:2]])
    assert np.abs(plain.rest - moved.rest).max() < 1e-4
    a, b = solver.solve(plain.rest, *arguments(scene)[0]), solver.solve(plain.rest, *turned(*arguments(scene)[0]))
    assert np.abs(R.apply(a.V.copy()) + t - b.V).max() < 1e-4


def test_bits_do_not_depend_on_threads(scene, threads):
    solver = InnerSolver(scene.model, scene.shape, scene.J)
    results = []
    for n in (1, 2, 3, 8):
        threads(n)
        fused = solver.fuse(arguments(scene)[:2])
        results.append((fused.rest, solver.solve(fused.rest, *arguments(scene)[1]).V))
    for rest, V in results[1:]:
        assert np.array_equal(rest, results[0][0]) and np.array_equal(V, results[0][1])


def test_bad_input_is_refused_by_name(scene):
    solver = InnerSolver(scene.model, scene.shape, scene.J)
    rotations, translation, tracked, visible, garments = arguments(scene)[0]
    with pytest.raises(InputError, match="inner: frames is empty"):
        solver.fuse([])
    fusion = solver.fusion()
    with pytest.raises(InputError, match="inner: frames is empty"):
        fusion.step(solver.gather([], fusion.guess))
    with pytest.raises(InputError, match="the fusion waits for the sums of another pass"):
        fusion.fused  # noqa: B018
    with pytest.raises(InputError, match="inner: sums of another body model"):
        fusion.step(InnerSums(np.zeros((3, 3)), np.zeros(3), np.zeros(3), np.zeros((3, 513), np.uint32), 1))
    bad = tracked.copy()
    bad[5] = np.nan
    with pytest.raises(InputError, match=r"inner: frames\[1\].tracked\[5\]"):
        solver.fuse([arguments(scene)[0], (rotations, translation, bad, visible, garments)])
    with pytest.raises(InputError, match=r"frame.visible\[3\]"):
        solver.solve(
            scene.body, rotations, translation, tracked, np.where(np.arange(len(visible)) == 3, -1, visible), garments
        )
    with pytest.raises(InputError, match="fused_rest has 3 rows"):
        solver.solve(scene.body[:3], rotations, translation, tracked, visible, garments)
    with pytest.raises(InputError, match="J has 2 rows"):
        InnerSolver(scene.model, scene.shape, scene.J[:2])
    with pytest.raises(TypeError, match="no option named 'lenght'"):
        InnerSolver(scene.model, lenght=1)


@pytest.fixture(scope="module")
def swinging(scene):
    """Eight frames of a body 10 mm off every shape of the model, outwards and inwards; the shirt lies on its front and swings
    behind, where it hangs three times as far off as its room varies."""
    model, rng = scene.model, np.random.default_rng(3)
    rest, _ = model.rest(scene.shape)
    N = vertex_normals(rest, model.f)
    body = rest + 0.014 * np.sin(rest @ rng.normal(0, 18, (3, 2)) + rng.uniform(0, 6, 2)).mean(1)[:, None] * N
    behind = 1 / (1 + np.exp(-(rest[:, 1] - rest[scene.covered, 1].mean()) / 0.02))
    frames = []
    for slack in 0.002 + np.linspace(0.5, 1.5, 8)[:, None] * 0.03 * behind:
        shirt = body + slack[:, None] * N
        tracked = np.where(scene.covered[:, None], shirt, body)
        frames.append(
            (
                np.zeros((104, 3)),
                np.zeros(3),
                tracked,
                (~scene.covered).astype(float),
                [(shirt, scene.frames[0][4][0][1])],
            )
        )
    return SimpleNamespace(
        body=body, frames=frames, front=scene.covered & (behind < 0.2), back=scene.covered & (behind > 0.8)
    )


def test_cloth_that_keeps_its_room_lies_on_a_body_that_the_model_misses_and_cloth_that_swings_hangs(scene, swinging):
    told, untold = (
        InnerSolver(scene.model, scene.shape, scene.J, **o).fuse(swinging.frames).rest for o in ({}, {"fit": 0})
    )
    for where, share in ((swinging.front, 0.5), (swinging.back, 0.8)):
        assert error(told, swinging.body, where) < share * error(untold, swinging.body, where)


def test_a_model_that_fits_the_seen_skin_is_trusted_under_cloth(scene):
    """The skin is the model's; the shirt keeps its room of 15 mm and would draw the body out to it."""
    rest, _ = scene.model.rest(scene.shape)
    shirt = rest + 0.015 * vertex_normals(rest, scene.model.f)
    tracked = np.where(scene.covered[:, None], shirt, rest)
    visible, faces = (~scene.covered).astype(float), scene.frames[0][4][0][1]
    frames = [(np.zeros((104, 3)), np.zeros(3), tracked, visible, [(shirt, faces)])] * 3
    trusted = InnerSolver(scene.model, scene.shape, scene.J).fuse(frames).rest
    drawn = InnerSolver(scene.model, scene.shape, scene.J, misfit=0, fit=1e12).fuse(frames).rest
    assert error(trusted, rest, scene.covered) < 1e-3 < 2e-3 < error(drawn, rest, scene.covered)
