"""Scans: the outer surface as a reconstruction gives it. Seen points, Poisson, decimation; then noise and holes."""

from __future__ import annotations

import numpy as np

from .surface import smooth_noise, vertex_normals

DIRECTIONS = 22  # parallel views that sample the surface
SPACING = 0.005  # m between rays of one view
GRAZING = 0.3  # smallest cosine between ray and normal that counts as seen
POINTS = 100_000  # oriented points given to Poisson
DEPTH = 8  # octree depth, cells of about 8 mm; 9 halves the error (0.2 mm on the torso) at three times the time
TRIM = 0.02  # share of Poisson vertices with the least support that are cut away
HOLE_RADIUS = (0.012, 0.04)  # m
CORRELATION = 0.02  # m, of half of the noise


def scan(outer, faces, noise, holes, rng):
    """A scan of `outer`: V (s,3) float32 [m], F (t,3) with about `faces` triangles before `holes` (share of the area)
    are cut. `noise` [m] is the standard deviation along the normal, half of its variance white."""
    V, F = poisson(*seen_points(outer, rng), faces)
    V = V + (scan_noise(V, noise, rng)[:, None] * vertex_normals(V, F) if noise > 0 else 0)
    F = cut_holes(V, F, holes, rng)
    used, F = np.unique(F, return_inverse=True)
    return V[used].astype(np.float32), F.reshape(-1, 3).astype(np.int32)


def seen_points(outer, rng):
    """First hits of parallel rays from DIRECTIONS sides: points (p,3) and outward normals (p,3)."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    V, F, N = outer.vertices, outer.faces, outer.normals
    scene.add_triangles(o3d.core.Tensor(V.astype(np.float32)), o3d.core.Tensor(F.astype(np.uint32)))
    low, high = V.min(0), V.max(0)
    centre, radius = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low)
    points, normals = [], []
    for d in view_directions():
        x = np.cross(d, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        y = np.cross(d, x)
        extent = [(V - centre) @ x, (V - centre) @ y]
        a, b = (np.arange(e.min(), e.max(), SPACING) + rng.uniform(0, SPACING) for e in extent)
        origin = centre - 1.1 * radius * d + (a[:, None, None] * x + b[None, :, None] * y)
        rays = np.concatenate([origin, np.broadcast_to(d, origin.shape)], 2).reshape(-1, 6).astype(np.float32)
        hit = scene.cast_rays(o3d.core.Tensor(rays), nthreads=1)
        t = hit["t_hit"].numpy()
        ok = np.isfinite(t)
        f, uv = F[hit["primitive_ids"].numpy()[ok]], hit["primitive_uvs"].numpy()[ok].astype(np.float64)
        b3 = np.stack([1 - uv.sum(1), uv[:, 0], uv[:, 1]], 1)
        n = np.einsum("pc,pcd->pd", b3, N[f])
        n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
        facing = -(n @ d)
        seen = facing > GRAZING
        points.append(np.einsum("pc,pcd->pd", b3, V[f])[seen])
        normals.append(n[seen])
    P, N = np.concatenate(points), np.concatenate(normals)
    pick = np.sort(rng.permutation(len(P))[:POINTS])
    return P[pick], N[pick]


def view_directions():
    """Looking directions (DIRECTIONS,3) on a spiral from 60 degrees above to 35 degrees below the horizon."""
    i = np.arange(DIRECTIONS)
    up = np.sin(np.radians(60)) + (i + 0.5) / DIRECTIONS * (np.sin(np.radians(-35)) - np.sin(np.radians(60)))
    turn = i * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - up**2)
    return -np.stack([flat * np.cos(turn), flat * np.sin(turn), up], 1)


def poisson(P, N, faces):
    """Screened Poisson surface of oriented points, decimated by quadrics: V, F."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(P))
    cloud.normals = o3d.utility.Vector3dVector(N)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh, density = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=DEPTH, n_threads=1)
    density = np.asarray(density)
    mesh.remove_vertices_by_mask(density < np.quantile(density, TRIM))
    mesh = mesh.simplify_quadric_decimation(faces)
    mesh.remove_degenerate_triangles()
    return np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int32)


def scan_noise(V, noise, rng):
    """Displacement (s,) [m]: half the variance white, half correlated over CORRELATION."""
    return noise * np.sqrt(0.5) * (rng.standard_normal(len(V)) + smooth_noise(V, CORRELATION, rng, 96))


def cut_holes(V, F, holes, rng):
    """Removes balls of triangles until `holes` of the area is gone."""
    if holes <= 0:
        return F
    centre = V[F].mean(1)
    area = 0.5 * np.linalg.norm(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), axis=1)
    keep = np.ones(len(F), bool)
    while area[~keep].sum() < holes * area.sum():
        at = centre[rng.choice(len(F), p=area / area.sum())]
        keep &= np.linalg.norm(centre - at, axis=1) > rng.uniform(*HOLE_RADIUS)
    return F[keep]
