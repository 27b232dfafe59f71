"""The person of the problems: anny's body as the cage of a smooth surface, three templates on it, poses and shapes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse import csgraph
from scipy.spatial.transform import Rotation

from toile.io.body import load_body_model

from .loop import edges_of, limit_surface

SUBDIVISIONS = 2  # of the cage: edges of 4-6 mm on the torso, 0.04 mm of sagitta
ESCAPE, RAYS = 0.04, 256  # a face is exterior where this share of the rays over its hemisphere gets away
LIMBS = ["upperleg01", "lowerleg01", "foot", "clavicle", "upperarm01", "lowerarm01", "wrist"]
JOINTS = ["spine04", "spine03", "spine02", "neck01", "head"] + [f"{b}.{side}" for b in LIMBS for side in "LR"]
MARKED = ["upperarm01", "lowerarm01", "wrist", "lowerleg01", "foot"]
LANDMARKS = ["head", "spine03"] + [f"{b}.{side}" for b in MARKED for side in "LR"]
HAND = ("wrist", "finger", "metacarpal")


@dataclass(frozen=True)
class SyntheticTemplate:
    """A template mesh on the person's surface: vertices are `points @ cage`."""

    points: sp.csr_matrix  # (n, cage)
    faces: np.ndarray  # (m,3)
    exterior: np.ndarray  # (n,) bool, where a scanner sees: errors are counted there
    hand: np.ndarray  # (n,) bool


class SyntheticPerson:
    """anny's body, skin component. A cage is (n,3) posed vertices [m], z up, facing -y."""

    def __init__(self):
        import torch
        import warp

        warp.config.log_level = warp.LOG_ERROR
        import anny

        torch.set_num_threads(2)
        self.model = anny.Anny().to(torch.float64)
        self.bones = list(self.model.bone_labels)
        self.phenotypes = list(self.model.phenotype_labels)
        self.rest = self.pose()
        self.all_faces = load_body_model("anny").f.astype(np.int64)  # anny's own depend on the processor
        self.faces = largest_part(self.all_faces, len(self.rest))

    def pose(self, rotations=None, phenotype=None, translation=(0, 0, 0)):
        """Cage of rotations {bone: rotation vector [degree]} and phenotype {name: 0..1}."""
        import torch

        T = np.tile(np.eye(4), (1, len(self.bones), 1, 1))
        for bone, degrees in (rotations or {}).items():
            T[0, self.bones.index(bone), :3, :3] = Rotation.from_rotvec(np.radians(degrees)).as_matrix()
        with torch.no_grad():
            out = self.model(pose_parameters=torch.tensor(T), phenotype_kwargs=phenotype or {})
        return out["vertices"][0].numpy() + np.asarray(translation)

    @cached_property
    def joints(self):
        """{bone: position (3,)} at rest."""
        import torch

        with torch.no_grad():
            return dict(zip(self.bones, self.model()["rest_bone_heads"][0].numpy()))

    @cached_property
    def hand_weight(self):
        """(n,) share of each cage vertex's skinning that hand bones have."""
        hand = np.array([b.startswith(HAND) for b in self.bones])
        return (self.model.vertex_bone_weights.numpy() * hand[self.model.vertex_bone_indices.numpy()]).sum(1)

    @cached_property
    def fine(self):
        """The smooth surface of the skin: rows on the cage, faces, and each face's cage face."""
        return limit_surface(self.faces, len(self.rest), SUBDIVISIONS)

    @cached_property
    def exterior_faces(self):
        """(m,) bool over `faces`: the outside in one piece, without mouth, nostrils and the like."""
        seen = sky(self.rest, self.faces) >= ESCAPE
        _, edge, _ = edges_of(self.faces)
        keep = np.flatnonzero(seen)
        sides = sp.coo_matrix((np.ones(3 * len(keep)), (np.repeat(np.arange(len(keep)), 3), edge[keep].ravel())))
        label = csgraph.connected_components(sides @ sides.T, directed=False)[1]
        out = np.zeros(len(seen), bool)
        out[keep[label == np.bincount(label).argmax()]] = True
        return out

    def surface(self, cage, fine=True):
        """V, F of the outside of a cage's limit surface: smooth, or with the cage's own faces."""
        return self._outside[fine][0] @ cage, self._outside[fine][1]

    @cached_property
    def _outside(self):
        """[coarse, fine] rows on the cage and faces of the exterior."""
        out = []
        for N, F, cage_face in (limit_surface(self.faces, len(self.rest), 0), self.fine):
            used, faces = np.unique(F[self.exterior_faces[cage_face]], return_inverse=True)
            out.append((N[used], faces.reshape(-1, 3)))
        return out

    def template(self, name):
        """'14k': the cage's own vertices; '53k': one subdivision; '3k': decimated; 'full': with eyes and tongue."""
        return {"14k": self._native, "53k": self._subdivided, "3k": self._decimated, "full": self._full}[name]()

    def _native(self):
        used = np.unique(self.faces)
        points = limit_surface(self.faces, len(self.rest), 0)[0][used]
        seen = np.isin(used, self.faces[self.exterior_faces])
        return SyntheticTemplate(points, np.searchsorted(used, self.faces), seen, self.hand_weight[used] > 0.5)

    def _full(self):
        points = limit_surface(self.all_faces, len(self.rest), 0)[0]
        seen = np.isin(np.arange(len(self.rest)), self.faces[self.exterior_faces])
        return SyntheticTemplate(points, self.all_faces, seen, self.hand_weight > 0.5)

    def _subdivided(self):
        points, F, cage_face = limit_surface(self.faces, len(self.rest), 1)
        used = np.unique(F)
        inside = np.unique(F[~self.exterior_faces[cage_face]])
        seen = ~np.isin(used, inside)
        points = points[used]
        return SyntheticTemplate(points, np.searchsorted(used, F), seen, points @ self.hand_weight > 0.5)

    def _decimated(self, vertices=3000):
        import igl
        import pymeshlab

        N, F, cage_face = self.fine
        V = N @ self.rest
        native = self._native()
        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(pymeshlab.Mesh(native.points @ self.rest, native.faces))
        meshes.meshing_decimation_quadric_edge_collapse(
            targetfacenum=2 * vertices, preservetopology=True, preserveboundary=True, qualitythr=0.5
        )
        coarse = meshes.current_mesh()
        _, face, at = igl.point_mesh_squared_distance(coarse.vertex_matrix(), V, F)[:3]
        bary = barycentric(at, V[F[face]])
        rows = np.repeat(np.arange(len(face)), 3)
        points = sp.coo_matrix((bary.ravel(), (rows, F[face].ravel())), shape=(len(face), len(V))) @ N
        seen = self.exterior_faces[cage_face[face]]
        return SyntheticTemplate(
            points.tocsr(), coarse.face_matrix().astype(np.int64), seen, points @ self.hand_weight > 0.5
        )


def largest_part(F, n):
    """Faces of the largest component: the skin, without eyes and tongue."""
    e = np.concatenate([F[:, :2], F[:, 1:]])
    label = csgraph.connected_components(sp.coo_matrix((np.ones(len(e)), e.T), shape=(n, n)), directed=False)[1]
    return F[label[F[:, 0]] == np.bincount(label[F[:, 0]]).argmax()]


def sky(V, F, seed=0):
    """(m,) share of RAYS rays over each face's hemisphere that leave the mesh."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=2)
    scene.add_triangles(o3d.core.Tensor(V.astype(np.float32)), o3d.core.Tensor(F.astype(np.uint32)))
    a, b, c = V[F].transpose(1, 0, 2)
    N = np.cross(b - a, c - a)
    N /= np.linalg.norm(N, axis=1, keepdims=True)
    start = (a + b + c) / 3 + 1e-5 * N
    directions = np.random.default_rng(seed).normal(size=(RAYS, 3))
    free = np.zeros(len(F))
    for d in directions / np.linalg.norm(directions, axis=1, keepdims=True):
        ray = np.where((N @ d)[:, None] > 0, d, -d)
        hit = scene.cast_rays(o3d.core.Tensor(np.hstack([start, ray]).astype(np.float32)), nthreads=2)["t_hit"]
        free += np.isinf(hit.numpy())
    return free / RAYS


def barycentric(P, T):
    """Weights (n,3) of points P (n,3) in triangles T (n,3,3), clipped to the triangle."""
    a, b, c = T.transpose(1, 0, 2)
    u, v, w = b - a, c - a, P - a
    uu, uv, vv, wu, wv = ((x * y).sum(1) for x, y in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    det = np.maximum(uu * vv - uv * uv, 1e-30)
    s, t = (vv * wu - uv * wv) / det, (uu * wv - uv * wu) / det
    weights = np.clip(np.c_[1 - s - t, s, t], 0, 1)
    return weights / weights.sum(1, keepdims=True)
