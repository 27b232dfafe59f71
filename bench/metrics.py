"""The score of a registration: errors against truth over exterior vertices [mm], surface, and faces that went bad."""

import numpy as np

DEGENERATE = 1e-3  # of the true face's area


def score(V, problem):
    """Result V (n,3) of a problem (a mapping with gt_v, src_f, ext, and where it has them hand, clean_v, clean_f).

    mean, median, rmse, p95, max: distance of exterior vertices to their true places; hand_mean, hand_max: of those on
    the hands; mean_all: of every vertex; hidden_max: of the others, in cavities, eyes and tongue; surf: exterior
    vertices to the complete clean target;
    nan: vertices that are not finite (counted as 1 km off); flips, degenerate: over all faces, against the true ones.
    """
    gt, F, ext = problem["gt_v"], problem["src_f"], problem["ext"]
    if V.shape != gt.shape:
        raise ValueError(f"score: result has shape {V.shape}, truth {gt.shape}")
    finite = np.isfinite(V).all(1)
    V = np.where(finite[:, None], V, 1e3)
    error = 1e3 * np.linalg.norm(V - gt, axis=1)
    x = error[ext]
    out = dict(mean=x.mean(), median=np.median(x), rmse=np.sqrt((x**2).mean()), p95=np.percentile(x, 95), max=x.max(),
               mean_all=error.mean(), nan=int((~finite).sum()))  # fmt: skip
    if not ext.all():
        out["hidden_max"] = error[~ext].max()
    hand = problem["hand"] & ext
    if hand.any():
        out |= dict(hand_mean=error[hand].mean(), hand_max=error[hand].max())
    if "clean_v" in problem:
        out["surf"] = 1e3 * surface_distance(V[ext], problem["clean_v"], problem["clean_f"]).mean()
    return {k: float(v) if k != "nan" else v for k, v in out.items()} | bad_faces(V, gt, F)


def bad_faces(V, gt, F):
    """Faces whose area vanished, and faces that turned by more than a right angle against the truth."""
    n, true = (np.cross(P[F[:, 1]] - P[F[:, 0]], P[F[:, 2]] - P[F[:, 0]]) for P in (V, gt))
    flat = np.linalg.norm(n, axis=1) < DEGENERATE * np.linalg.norm(true, axis=1)
    return dict(flips=int((((n * true).sum(1) < 0) & ~flat).sum()), degenerate=int(flat.sum()))


def surface_distance(P, V, F):
    """Distances (k,) of points to a surface."""
    import igl

    return np.sqrt(igl.point_mesh_squared_distance(P, np.asarray(V, np.float64), np.asarray(F, np.int64))[0])
