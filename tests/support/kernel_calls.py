"""One call of every kernel on a small problem, large enough that several threads share it."""

import numpy as np
import scipy.sparse as sp
import trimesh

from tests.support import textured_plane
from tests.support.cloths import edge_lengths
from toile import kernels
from toile.io.body import load_body_model


def ball(radius=0.5, subdivisions=4):
    """A bumpy closed surface, 2562 vertices unless told otherwise."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    d = np.array(sphere.vertices)
    bumps = 1 + 0.1 * np.sin(4 * d[:, :1] + 1) * np.cos(3 * d[:, 1:2])
    return radius * d * bumps, np.array(sphere.faces, dtype=np.int32)


def tube(radius=0.52, height=0.4, around=96, along=20):
    """An open cylinder about z, 1920 vertices."""
    angle, z = np.meshgrid(2 * np.pi * np.arange(around) / around, np.linspace(-height / 2, height / 2, along))
    V = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(along - 1))
    a, b = (j * around + i).ravel(), (j * around + (i + 1) % around).ravel()
    return V, np.concatenate([np.c_[a, b, b + around], np.c_[a, b + around, a + around]]).astype(np.int32)


def nricp_solver():
    return kernels.NricpSolver(*ball(), preset="draft", labels=[1])


def nricp(solver):
    V, F = ball()
    return solver.solve(V + 0.02 * np.sin(3 * V[:, ::-1]), F)


def biharmonic_solver():
    return kernels.BiharmonicSolver(*tube(), known=np.arange(96), accuracy=1e-7)


def biharmonic(solver):
    return solver.solve(0.1 * np.sin(np.arange(288.0).reshape(96, 3)))


def untangle_solver():
    (cloth_V, cloth_F), (body_V, body_F) = tube(), ball()
    return kernels.UntangleSolver(cloth_F, len(cloth_V), body_F, len(body_V), margin=0.003)


def untangle(solver):
    return solver.solve(tube()[0], ball()[0])


def drape_solver():
    cloth_V, cloth_F = tube()
    body_V, body_F = ball()
    return kernels.DrapeSolver(cloth_F, len(cloth_V), edge_lengths(cloth_V, cloth_F), body_F, len(body_V))


def drape(solver):
    solver.start(tube()[0], ball()[0], settle=0.05)
    return solver.step(ball()[0] + [0.01, 0, 0], 1 / 30)


def skeleton_solver():
    return kernels.SkeletonSolver(load_body_model(), max_iterations=2)


def skeleton(solver):
    body = load_body_model()
    start = np.zeros((len(body.J), 3)), np.zeros(3), np.zeros(4)
    return solver.solve(body.v_template + [0.01, 0, 0], body.f, start=start)


def inner_solver():
    return kernels.InnerSolver(load_body_model(), np.zeros(4), rounds=1, max_iterations=2)


def inner(solver):
    body = load_body_model()
    covered = np.isin(np.arange(len(body.v_template)), body.segments["torso"])
    shirt = body.v_template + 0.01 * kernels.vertex_normals(body.v_template, body.f)
    pose = np.zeros((len(body.J), 3)), np.zeros(3)
    frame = *pose, np.where(covered[:, None], shirt, body.v_template), (~covered).astype(float), [(shirt, body.f)]
    fused = solver.fuse([frame])
    return fused, solver.solve(fused.rest, *frame)


def surface_index():
    return kernels.SurfaceIndex(*ball())


def closest(index):
    points = 0.6 * ball()[0]
    return (*index.closest(points), index.occluded(points, kernels.vertex_normals(*ball())))


def mrf(_):
    cells = np.arange(2500).reshape(50, 50)
    across, down = (cells[:, :-1], cells[:, 1:]), (cells[:-1], cells[1:])
    edges = np.concatenate([np.c_[a.ravel(), b.ravel()] for a, b in (across, down)])
    return kernels.mrf(np.sin(np.arange(7500.0) ** 2).reshape(2500, 3), edges, np.full(len(edges), 0.3))


def raster(_):
    V, F = ball()
    K = np.array([[200.0, 0, 128], [0, 200, 128], [0, 0, 1]])
    return kernels.raster(V + [0, 0, 2], F, K, (256, 256), barycentric=True)


def sight(_):
    V, F = ball()
    K = np.array([[200.0, 0, 128], [0, 200, 128], [0, 0, 1]])
    T = np.eye(4)
    T[2, 3] = 2
    seen = kernels.visibility(V, kernels.vertex_normals(V, F), K, np.zeros(5), T, raster(None).depth, 0.01, 0.1)
    return (*seen, kernels.bilinear(np.arange(256 * 256 * 3).reshape(256, 256, 3) % 251, seen[0]))


def geometry(_):
    V, F = ball()
    W, G = tube()
    pairs = kernels.intersecting_pairs(V, F, W, G), kernels.self_intersections(V, F)
    inside = kernels.winding_number(W, V, F), kernels.signed_distance(W, V, F)
    return *pairs, *inside, kernels.voronoi_mass(V, F), kernels.ambient_occlusion(V, F, rays=16)


def cholesky(_):
    V, F = ball()
    A = sp.csc_matrix(sp.eye(len(V)) - kernels.cotangent_laplacian(V, F))
    return kernels.CholeskyFactor().factorize(A).solve(V)


def stereo(_):
    cameras = textured_plane.cameras(2, size=(40, 48))
    pictures, ranges = [textured_plane.picture(c) for c in cameras], textured_plane.ranges(cameras)
    maps = kernels.StereoSolver(cameras).solve(pictures, None, ranges)
    return maps, kernels.fuse_depths(cameras, *maps)


SOLVERS = {  # what prepares once, and a call of it
    nricp: nricp_solver,
    biharmonic: biharmonic_solver,
    untangle: untangle_solver,
    drape: drape_solver,
    skeleton: skeleton_solver,
    inner: inner_solver,
    closest: surface_index,
}
CALLS = SOLVERS | dict.fromkeys([mrf, raster, sight, stereo, geometry, cholesky], lambda: None)


def bits(value):
    """All numbers of a result: of the arrays in a tuple, or of the attributes of a result's class."""
    if isinstance(value, (tuple, list)):
        return [bits(item) for item in value]
    if isinstance(value, (str, int, float)) or value is None:
        return value
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype.str, value.tobytes()
    return {name: bits(getattr(value, name)) for name in dir(value) if not name.startswith("_")}
