"""toile's kernels as methods: every preset; by landmarks or from a skeleton fit where the motion is large."""

from functools import partial

from .method import Method

PRESETS = ("draft", "standard", "fine")
LANDMARK_SIGMA = 0.005  # m
PASSES = 3  # of a large pose that starts from landmarks alone


def register(preset, problem, start=None, with_landmarks=False, **options):
    from toile.kernels import NricpSolver

    solver = NricpSolver(problem["src_v"], problem["src_f"], preset, **options)
    marks = landmarks(problem) if with_landmarks else None
    first = None if start is None else problem[start]
    return lambda frame: solver.solve(frame["tgt_v"], frame["tgt_f"], start=first, landmarks=marks).V


def landmarks(problem):
    """The 12 landmarks as `solve` takes them: W (12,n) sparse, P (12,3), sigma."""
    import scipy.sparse as sp

    v = problem["lm_v"]
    W = sp.csr_matrix(([1.0] * len(v), (range(len(v)), v)), shape=(len(v), len(problem["src_v"])))
    return W, problem["lm_p"], LANDMARK_SIGMA


def follow(preset, template):
    """A sequence: each frame starts where the last one ended."""
    from toile.kernels import NricpSolver

    solver = NricpSolver(template["src_v"], template["src_f"], preset)
    return lambda frame: solver.solve(frame["tgt_v"], frame["tgt_f"], start=frame["start"]).V


def biharmonic(problem):
    from toile.kernels import BiharmonicSolver

    solver = BiharmonicSolver(problem["V"], problem["F"], problem["known"])
    return lambda frame: solver.solve(frame["D_known"])


def mrf(frame):
    from toile.kernels import mrf as solve

    return solve(frame["unary"], frame["edges"], frame["weights"]).labels


def untangle(problem):
    from toile.kernels import UntangleSolver

    solver = UntangleSolver(problem["cloth_f"], len(problem["cloth_v"]), problem["body_f"], len(problem["body_v"]))
    return lambda frame: solver.solve(frame["cloth_v"], frame["body_v"]).V


def methods():
    for preset in PRESETS:
        by_landmarks = partial(register, preset, with_landmarks=True, passes=PASSES)
        from_skeleton = partial(register, preset, start="fit_v", rebase=True)
        yield Method(f"toile {preset}", "register", "toile", partial(register, preset), levels=(1, 2, 3, 4))
        yield Method(f"toile {preset} + landmarks", "register", "toile", by_landmarks, levels=(5,))
        yield Method(f"toile {preset} + skeleton", "register", "toile", from_skeleton, levels=(5,))
    for preset in PRESETS[:2]:  # `fine` is not for sequences
        yield Method(f"toile {preset}", "sequence", "toile", partial(follow, preset))
    floor = partial(register, "fine", start="gt_v")
    yield Method("floor: toile fine from the truth", "register", "toile", floor, oracle=True)
    yield Method("toile", "biharmonic", "toile", biharmonic)
    yield Method("toile", "mrf", "toile", lambda problem: mrf)
    yield Method("toile", "untangle", "toile", untangle)
