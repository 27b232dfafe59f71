"""Problems and scores of biharmonic, mrf and untangle, on surfaces like those that the stages give them."""

import numpy as np

from .loop import edges_of

LABELS = 5
MARGIN, CLEAR = 0.002, 0.9  # m asked for, and the share of it that counts as clear


def patch(vertices, seed=0):
    """A shirt-like tube, dented, with two open loops of which each is moved smoothly: V, F, known, D_known."""
    rng = np.random.default_rng(seed)
    around = int(np.sqrt(1.5 * vertices))
    along = vertices // around
    i, j = np.meshgrid(np.arange(around), np.arange(along), indexing="xy")
    angle, z = 2 * np.pi * (i + 0.5 * (j % 2)) / around, 0.6 * j / (along - 1)
    r = 0.18 + 0.02 * np.sin(3 * angle + 9 * z) + 0.03 * np.cos(5 * z)
    V = np.stack([r * np.cos(angle), 0.7 * r * np.sin(angle), z], -1).reshape(-1, 3)
    V += rng.normal(size=V.shape) * 0.1 * 0.6 / along
    at = lambda di, dj: (j[:-1] + dj) * around + (i[:-1] + di) % around
    odd = (j[:-1] % 2).astype(bool)
    low, high = np.where(odd, at(1, 1), at(0, 1)), at(0, 0)
    below = np.stack([high, at(1, 0), low], -1)
    above = np.stack([np.where(odd, high, at(1, 0)), np.where(odd, low, at(1, 1)), np.where(odd, at(0, 1), low)], -1)
    F = np.concatenate([below.reshape(-1, 3), above.reshape(-1, 3)])
    known = np.r_[np.arange(around), np.arange(around) + (along - 1) * around]
    turn = np.arctan2(V[known, 1], V[known, 0])
    D = 0.02 * np.stack([np.cos(2 * turn), np.sin(turn), np.cos(3 * turn)], -1)
    return dict(V=V, F=F.astype(np.int32), known=known.astype(np.int32), D_known=D)


def harmonic_reference(problem):
    """The solution by scipy's LU with refined residuals: x_u = -Q_uu^-1 Q_uk D."""
    import igl
    import scipy.sparse as sp
    from scipy.sparse.linalg import splu

    V, F = problem["V"], problem["F"].astype(np.int64)
    L, M = igl.cotmatrix(V, F), igl.massmatrix(V, F, igl.MASSMATRIX_TYPE_VORONOI)
    Q = (L @ sp.diags(1 / M.diagonal()) @ L).tocsr()
    known = problem["known"]
    free = np.setdiff1d(np.arange(len(V)), known)
    A, b = Q[free][:, free].tocsc(), -Q[free][:, known] @ problem["D_known"]
    lu = splu(A)
    x = lu.solve(b)
    for _ in range(3):
        x += lu.solve(b - A @ x)
    D = np.zeros_like(V)
    D[known], D[free] = problem["D_known"], x
    return D


def score_biharmonic(D, problem):
    """error: largest difference to the reference over the largest displacement."""
    if "D" not in problem:
        return {}
    return dict(error=float(np.abs(D - problem["D"]).max() / np.abs(problem["D"]).max()))


def labelling(V, F, seed=0):
    """Five regions of a surface from votes of which two in five are wrong: unary (n,5), edges (E,2), weights (E,)."""
    rng = np.random.default_rng(seed)
    E, _, _ = edges_of(F)
    centres = V[rng.choice(len(V), LABELS, replace=False)]
    truth = np.linalg.norm(V[:, None] - centres, axis=2).argmin(1)
    vote = np.where(rng.random(len(V)) < 0.4, rng.integers(LABELS, size=len(V)), truth)
    sure = rng.uniform(0.4, 0.95, len(V))
    p = np.full((len(V), LABELS), ((1 - sure) / (LABELS - 1))[:, None])
    p[np.arange(len(V)), vote] = sure
    length = np.linalg.norm(V[E[:, 0]] - V[E[:, 1]], axis=1)
    return dict(unary=-np.log(p), edges=E.astype(np.int32), weights=1.2 * np.exp(-length / length.mean()))


def score_mrf(labels, problem):
    """energy of Potts, by this code."""
    E, w = problem["edges"], problem["weights"]
    unary = problem["unary"][np.arange(len(labels)), labels].sum()
    return dict(energy=float(unary + w[labels[E[:, 0]] != labels[E[:, 1]]].sum()))


def shirt_through_body(person, vertices, seed=0):
    """Cloth about trunk and upper arms that waves from 12 mm outside to 10 mm inside of the body."""
    from .problems import compact, target_surface

    rng = np.random.default_rng(seed)
    J = person.joints
    body = person.template("14k")
    V, F = target_surface(person, person.rest, int(vertices * 2.9), rng)
    low, high = J["upperleg01.L"][2], J["neck01"][2] - 0.02
    reach = 0.8 * abs(J["lowerarm01.L"][0])
    c = V[F].mean(1)
    V, F = compact(V, F[(c[:, 2] > low) & (c[:, 2] < high) & (abs(c[:, 0]) < reach)])
    N = np.zeros_like(V)
    np.add.at(N, F.ravel(), np.repeat(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), 3, axis=0))
    N /= np.linalg.norm(N, axis=1, keepdims=True)
    wave = np.cos(V @ rng.normal(size=(3, 6)) * 20 + rng.uniform(0, 2 * np.pi, 6)).sum(1) / np.sqrt(3)
    lift = np.clip(0.005 + 0.005 * wave, -0.010, 0.012)
    return dict(cloth_v=V + lift[:, None] * N, cloth_f=F.astype(np.int32),
                body_v=body.points @ person.rest, body_f=body.faces.astype(np.int32))  # fmt: skip


def score_untangle(V, problem):
    """short: vertices nearer than CLEAR x MARGIN or inside; worst_mm: the most that one lacks of the margin; pairs:
    triangle pairs that intersect, by exact predicates (CGAL through libigl); moved_mm: mean displacement."""
    import igl
    from igl.copyleft.cgal import intersect_other

    body_v, body_f, cloth_f = problem["body_v"], problem["body_f"].astype(np.int64), problem["cloth_f"].astype(np.int64)
    distance = igl.signed_distance(V, body_v, body_f, sign_type=igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER)[0]
    pairs = len(intersect_other(body_v, body_f, V, cloth_f, detect_only=True)[0])
    return dict(short=int((distance < CLEAR * MARGIN).sum()), worst_mm=1e3 * max(0.0, MARGIN - float(distance.min())),
                pairs=pairs, moved_mm=1e3 * float(np.linalg.norm(V - problem["cloth_v"], axis=1).mean()))  # fmt: skip
