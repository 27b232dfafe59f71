"""What installs from the package index and solves the same problems, each as its documentation says, at its defaults.

Point-set methods (CPD) hold dense matrices of template by target points: they are given SAMPLE and twice SAMPLE
points, and their displacement is carried to all vertices.
"""

import numpy as np

from .method import Method, once

SAMPLE = 1500
ROUNDS = 10  # of pushing cloth out of the body
MARGIN = 0.002  # m


def trimesh_amberg(frame, landmarks=False):
    """Optimal-step non-rigid ICP (Amberg et al. 2007) of trimesh."""
    import trimesh
    from trimesh.registration import nricp_amberg

    source = trimesh.Trimesh(frame["src_v"], frame["src_f"], process=False)
    target = trimesh.Trimesh(frame["tgt_v"], frame["tgt_f"], process=False)
    marks = dict(source_landmarks=frame["lm_v"], target_positions=frame["lm_p"]) if landmarks else {}
    return np.asarray(nricp_amberg(source, target, **marks))


def open3d_icp(frame):
    """Rigid point-to-plane ICP of open3d: what a rigid fit alone leaves."""
    import open3d as o3d

    source, target = o3d.geometry.PointCloud(), o3d.geometry.PointCloud()
    source.points = o3d.utility.Vector3dVector(frame["src_v"])
    target.points = o3d.utility.Vector3dVector(frame["tgt_v"])
    target.estimate_normals()
    plane = o3d.pipelines.registration.TransformationEstimationPointToPlane()
    T = o3d.pipelines.registration.registration_icp(source, target, 0.1, np.eye(4), plane).transformation
    return frame["src_v"] @ T[:3, :3].T + T[:3, 3]


def pycpd_deformable(frame):
    """Coherent point drift (Myronenko and Song 2010) of pycpd."""
    from pycpd import DeformableRegistration

    def fit(Y, X):
        return DeformableRegistration(X=X, Y=Y).register()[0]

    return by_samples(frame, fit)


def probreg_cpd(frame):
    """Coherent point drift of probreg."""
    from probreg import cpd

    def fit(Y, X):
        found = cpd.registration_cpd(Y, X, tf_type_name="nonrigid")
        return found.transformation.transform(Y)

    return by_samples(frame, fit)


def by_samples(frame, fit):
    """Fits samples of template and target in units of their spread; the displacement goes to all by the nearest 4."""
    from scipy.spatial import cKDTree

    from toile.surface.sampling import spread_points

    rng = np.random.default_rng(0)
    V, T = frame["src_v"], frame["tgt_v"]
    Y, X = V[spread_points(V, SAMPLE)], T[rng.permutation(len(T))[: 2 * SAMPLE]]
    centre, scale = X.mean(0), X.std()
    moved = scale * fit((Y - centre) / scale, (X - centre) / scale) + centre
    distance, near = cKDTree(Y).query(V, k=4)
    w = 1 / np.maximum(distance, 1e-9) ** 2
    return V + np.einsum("nk,nki->ni", w / w.sum(1, keepdims=True), (moved - Y)[near])


def igl_harmonic(frame):
    import igl

    return igl.harmonic(frame["V"], frame["F"].astype(np.int64), frame["known"].astype(np.int64), frame["D_known"], 2)


def gco_expansion(frame):
    import gco

    labels = frame["unary"].shape[1]
    potts = 1.0 - np.eye(labels)
    return np.asarray(gco.cut_general_graph(frame["edges"].astype(np.int32), frame["weights"], frame["unary"], potts))


def pymaxflow_expansion(frame):
    """Alpha-expansion for Potts, its cuts by PyMaxflow."""
    import maxflow

    unary, E, w = frame["unary"], frame["edges"], frame["weights"]
    n, labels = unary.shape
    x, nodes = unary.argmin(1), np.arange(n)
    energy, stale, alpha = potts_energy(x, frame), 0, 0
    while stale < labels:
        proposal = expand(maxflow, unary, E, w, x, nodes, alpha)
        lower = potts_energy(proposal, frame)
        stale = 0 if lower < energy - 1e-9 * abs(energy) else stale + 1
        if lower < energy:
            x, energy = proposal, lower
        alpha = (alpha + 1) % labels
    return x


def expand(maxflow, unary, E, w, x, nodes, alpha):
    """The best expansion of label alpha: E(b), b = 1 takes it and is the sink's side (Kolmogorov, Zabih 2004)."""
    i, j, n = E[:, 0], E[:, 1], len(x)
    A, B, C = w * (x[i] != x[j]), w * (x[i] != alpha), w * (x[j] != alpha)  # E(0,0), E(0,1), E(1,0); E(1,1) = 0
    take = unary[:, alpha] + np.bincount(i, C - A, n) - np.bincount(j, C, n)
    stay = unary[nodes, x]
    graph = maxflow.GraphFloat(n, len(E))
    graph.add_nodes(n)
    graph.add_edges(i, j, B + C - A, np.zeros(len(E)))
    low = np.minimum(take, stay)
    graph.add_grid_tedges(nodes, take - low, stay - low)
    graph.maxflow()
    return np.where(graph.get_grid_segments(nodes), alpha, x)


def potts_energy(x, problem):
    E, w = problem["edges"], problem["weights"]
    return problem["unary"][np.arange(len(x)), x].sum() + w[x[E[:, 0]] != x[E[:, 1]]].sum()


def open3d_push(frame):
    """Ten rounds: closest points on the body, signs by face normals, cloth that is short of the margin put there."""
    import open3d as o3d

    body_v, body_f, V = frame["body_v"], frame["body_f"], frame["cloth_v"].copy()
    scene = o3d.t.geometry.RaycastingScene(nthreads=2)
    scene.add_triangles(o3d.core.Tensor(body_v.astype(np.float32)), o3d.core.Tensor(body_f.astype(np.uint32)))
    for _ in range(ROUNDS):
        hit = scene.compute_closest_points(o3d.core.Tensor(V.astype(np.float32)), nthreads=2)
        N = hit["primitive_normals"].numpy().astype(np.float64)
        N /= np.linalg.norm(N, axis=1, keepdims=True)
        depth = ((V - hit["points"].numpy()) * N).sum(1)
        V += np.maximum(MARGIN - depth, 0)[:, None] * N
    return V


def trimesh_push(frame):
    """The same by trimesh's signed distance and closest points."""
    import trimesh

    body, V = trimesh.Trimesh(frame["body_v"], frame["body_f"], process=False), frame["cloth_v"].copy()
    for _ in range(ROUNDS):
        near, _, face = trimesh.proximity.closest_point(body, V)
        outside = -trimesh.proximity.signed_distance(body, V)
        N = body.face_normals[face]
        V = np.where((outside < MARGIN)[:, None], near + MARGIN * N, V)
    return V


def methods():
    yield Method("trimesh amberg", "register", "trimesh", once(trimesh_amberg))
    by_landmarks = once(lambda frame: trimesh_amberg(frame, True))
    yield Method("trimesh amberg + landmarks", "register", "trimesh", by_landmarks, levels=(5,))
    yield Method("open3d rigid ICP", "register", "open3d", once(open3d_icp))
    yield Method("pycpd", "register", "pycpd", once(pycpd_deformable), slow=True)
    yield Method("probreg cpd", "register", "probreg", once(probreg_cpd), slow=True)
    yield Method("trimesh amberg", "sequence", "trimesh", once(trimesh_amberg), slow=True)
    yield Method("igl.harmonic", "biharmonic", "igl", once(igl_harmonic))
    yield Method("gco", "mrf", "gco", once(gco_expansion))
    yield Method("PyMaxflow", "mrf", "maxflow", once(pymaxflow_expansion))
    yield Method("open3d rounds", "untangle", "open3d", once(open3d_push))
    yield Method("trimesh rounds", "untangle", "trimesh", once(trimesh_push), slow=True)
