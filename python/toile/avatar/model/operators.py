"""Fixed linear operators on a layer's mesh, and what is made of them."""

from __future__ import annotations

import warnings

import numpy as np
import torch
from scipy.sparse import coo_matrix, diags
from torch import nn

from ...kernels import vertex_normals
from ...surface.operators import adjacency, neighbour_mean, sides

CANCELLED = 1e-6  # a share of the faces' area that rounding leaves where they face each other


class Linear(nn.Module):
    """A fixed sparse matrix (m,n) applied to every sample's (n,3); not part of the saved state.

    Kept as plain arrays, which can be copied and sent, and multiplied as CSR: a tenth of the time that COO takes.
    """

    def __init__(self, matrix):
        super().__init__()
        self.shape = matrix.shape
        for name, m in (("matrix", matrix.tocsr()), ("transposed", matrix.T.tocsr())):
            m.sort_indices()
            for part, dtype in (("indptr", np.int64), ("indices", np.int64), ("data", np.float32)):
                values = torch.from_numpy(getattr(m, part).astype(dtype))
                self.register_buffer(f"{name}_{part}", values, persistent=False)

    def sparse(self, name, shape):
        """The CSR tensor of this name."""
        parts = [getattr(self, f"{name}_{part}") for part in ("indptr", "indices", "data")]
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sparse (CSR tensor support|invariant checks)")
            return torch.sparse_csr_tensor(*parts, size=shape, check_invariants=False)

    def forward(self, x):
        m, n = self.shape
        with torch.autocast(x.device.type, enabled=False):
            columns, matrix = x.float().permute(1, 0, 2).reshape(n, -1), self.sparse("matrix", (m, n))
            if torch.is_grad_enabled() and x.requires_grad:
                y = Product.apply(matrix, self.sparse("transposed", (n, m)), columns)
            else:
                y = matrix @ columns
        return y.reshape(m, len(x), -1).permute(1, 0, 2)


class Product(torch.autograd.Function):
    """A x of a constant sparse A, whose transpose is at hand for the gradient."""

    @staticmethod
    def forward(ctx, matrix, transposed, x):
        ctx.transposed = transposed
        return matrix @ x

    @staticmethod
    def backward(ctx, gradient):
        return None, None, ctx.transposed @ gradient.contiguous()


class Facing(nn.Module):
    """The view code of a mesh: n.v of each vertex towards a camera. Without gradient: geometry shall not move to mend
    colours."""

    def __init__(self, faces):
        super().__init__()
        self.faces = np.asarray(faces, dtype=np.int32)
        self.register_buffer("corners", torch.as_tensor(self.faces.T.astype(np.int64)), persistent=False)  # (3,m)
        face = np.tile(np.arange(len(self.faces)), 3)
        self.about = Linear(coo_matrix((np.ones(len(face)), (self.faces.T.ravel(), face))))  # the faces about a vertex

    @torch.no_grad()
    def forward(self, vertices, centre, normals=None):
        """Vertices (B,n,3), camera centres (B,3) -> (B,n,1), -1 to 1; 0 where a vertex has no normal."""
        normals = self.normals(vertices) if normals is None else normals
        view = centre[:, None] - vertices
        length = view.square().sum(-1).clamp(min=1e-24).sqrt()
        return ((normals * view).sum(-1) / length)[..., None]

    @torch.no_grad()
    def normals(self, vertices):
        """(B,n,3) of vertices (B,n,3), unit or zero: by the core, on another device by torch."""
        if vertices.device.type != "cpu":
            return self.in_torch(vertices)
        normals = np.stack([vertex_normals(v, self.faces) for v in vertices.double().numpy()])
        return torch.from_numpy(normals).to(vertices)

    def in_torch(self, vertices):
        """As the core's `vertex_normals`, to rounding, without waiting for the host."""
        a, b, c = vertices[:, self.corners].double().unbind(1)
        area = torch.linalg.cross(b - a, c - a)
        sums = self.about(torch.cat([area, area.norm(dim=-1, keepdim=True)], -1))
        rest = vertices.shape[1] - sums.shape[1]  # vertices of no face
        sums = torch.cat([sums, sums.new_zeros(len(sums), rest, 4)], 1) if rest else sums
        length = sums[..., :3].norm(dim=-1, keepdim=True)
        return sums[..., :3] / length.masked_fill(length <= CANCELLED * sums[..., 3:], torch.inf)


def uniform_laplacian(faces, n):
    """L v = v - mean of its neighbours, as `Linear` (n,n): 0 for a vertex without neighbours, and for translations."""
    A = adjacency(sides(np.asarray(faces, dtype=np.int64)), n)
    connected = (np.asarray(A.sum(1)).ravel() > 0).astype(float)
    return Linear((diags(connected) - neighbour_mean(A)).tocsr())


def joint_centroids(skin_idx, skin_val, joints):
    """A (K,n) as `Linear`: the mean of the vertices by their skinning weights; 0 for a joint that moves no vertex."""
    n, width = skin_idx.shape
    rows, columns = np.asarray(skin_idx).ravel(), np.repeat(np.arange(n), width)
    weights = coo_matrix((np.asarray(skin_val, dtype=np.float64).ravel(), (rows, columns)), shape=(joints, n)).tocsr()
    sums = np.asarray(weights.sum(1)).ravel()
    return Linear((diags(np.where(sums > 1e-9, 1 / np.maximum(sums, 1e-9), 0)) @ weights).tocsr())
